//! Load of other programs during a run, from `/proc/stat`, and how much of an exceeded budget it explains.

use serde::{Deserialize, Serialize};
use std::fs::read_to_string;

/// Text for a load that the system does not report.
pub const NO_LOAD: &str = "the machine's other load is unknown";

/// Time of all processors since the machine's start, in clock ticks, by use.
#[derive(Debug, Clone, Copy, PartialEq)]
struct Ticks {
    busy: u64,
    /// Time taken by the host of a virtual machine.
    stolen: u64,
    all: u64,
    processors: u64,
}

impl Ticks {
    fn parse(stat: &str) -> Option<Self> {
        let total = stat.lines().find_map(|line| line.strip_prefix("cpu "))?;
        // user, nice, system, idle, iowait, irq, softirq, steal; guests are in user and nice.
        let fields: Vec<u64> = total.split_whitespace().take(8).map_while(|f| f.parse().ok()).collect();
        let [user, nice, system, idle, waiting, irq, soft, stolen] = fields.try_into().ok()?;
        let busy = user + nice + system + irq + soft;
        let processor = |line: &&str| {
            line.strip_prefix("cpu").is_some_and(|l| l.starts_with(|c: char| c.is_ascii_digit()))
        };
        let processors = stat.lines().filter(processor).count().max(1) as u64;
        Some(Ticks { busy, stolen, all: busy + stolen + idle + waiting, processors })
    }
}

/// Load on the machine's processors that the run did not cause, in percent of all processors.
#[derive(Debug, Clone, Copy, PartialEq, Serialize, Deserialize)]
pub struct Load {
    /// Number of processors of the machine.
    pub processors: u64,
    /// Share taken by other programs, percent.
    pub others_percent: f64,
    /// Share taken by the host of a virtual machine, percent.
    pub stolen_percent: f64,
}

impl Load {
    /// Share of processor time that was not available to the run, 0 to 0.99.
    fn share_taken(&self) -> f64 {
        (0.01 * (self.others_percent + self.stolen_percent)).clamp(0.0, 0.99)
    }

    /// Limit under this load, ms, for a duration with the budget `budget_ms` on an idle machine, as if the load
    /// slowed everything down evenly: `budget / (1 − share taken)`.
    pub fn allowed_ms(&self, budget_ms: f64) -> f64 {
        budget_ms / (1.0 - self.share_taken())
    }

    /// True if the load explains all of the excess: durations are within [`Self::allowed_ms`], and the share
    /// of frames below the lowest permitted tier is no larger than the share of processor time taken.
    pub fn explains(&self, judged: &Judged) -> bool {
        let within = |[took, budget]: [f64; 2]| budget <= 0.0 || took <= self.allowed_ms(budget);
        judged.times_ms.into_iter().all(within)
            && judged.below_floor as f64 <= self.share_taken() * judged.count as f64
    }

    /// The load as text.
    pub fn text(&self) -> String {
        let Load { processors, others_percent, stolen_percent } = self;
        let others = format!("other programs took {others_percent:.0} % of the {processors} processors");
        if *stolen_percent < 0.5 {
            return others;
        }
        format!("{others}, this machine's host {stolen_percent:.0} %")
    }
}

/// Figures of a stage that are compared with its budgets.
#[derive(Debug, Clone, Copy)]
pub struct Judged {
    /// Pairs of duration and budget (0 if there is none), ms: at the judged percentile, and of the mean.
    pub times_ms: [[f64; 2]; 2],
    /// Number of frames drawn at a quality tier too low for training.
    pub below_floor: u64,
    /// Number of all frames or durations of the stage.
    pub count: u64,
}

/// Measures the load between two times.
#[derive(Debug, Default)]
pub struct LoadAccount(Option<Ticks>);

impl LoadAccount {
    /// Starts the measurement.
    pub fn start(&mut self) {
        self.0 = Ticks::parse(&read_to_string("/proc/stat").unwrap_or_default());
    }

    /// Load since the start of the measurement. `own_cores` is the average number of processors that the
    /// run's own processes used. `None` if the system does not report it, or no tick has passed.
    pub fn load(&self, own_cores: f64) -> Option<Load> {
        let now = Ticks::parse(&read_to_string("/proc/stat").unwrap_or_default())?;
        load(&self.0?, &now, own_cores)
    }
}

fn load(from: &Ticks, to: &Ticks, own_cores: f64) -> Option<Load> {
    let percent = |a: u64, b: u64, all: u64| 100.0 * b.saturating_sub(a) as f64 / all as f64;
    let all = to.all.checked_sub(from.all).filter(|all| *all > 0)?;
    let own_percent = 100.0 * own_cores / to.processors as f64;
    Some(Load {
        processors: to.processors,
        others_percent: (percent(from.busy, to.busy, all) - own_percent).max(0.0),
        stolen_percent: percent(from.stolen, to.stolen, all),
    })
}

#[cfg(test)]
mod tests {
    use super::*;

    const BEFORE: &str = "cpu  100 20 30 1000 50 5 5 40 7 0\ncpu0 1 2 3\ncpu1 1 2 3\nintr 9\n";
    const AFTER: &str = "cpu  220 20 70 1200 70 5 5 60 7 0\ncpu0 1 2 3\ncpu1 1 2 3\nintr 9\n";

    #[test]
    fn what_is_neither_idle_nor_the_runs_own_is_others() {
        let (before, after) = (Ticks::parse(BEFORE).unwrap(), Ticks::parse(AFTER).unwrap());
        assert_eq!(before, Ticks { busy: 160, stolen: 40, all: 1250, processors: 2 });
        // 160 of 400 ticks were busy; half of one of the two processors was the run's own.
        let found = load(&before, &after, 0.5).unwrap();
        assert_eq!(found, Load { processors: 2, others_percent: 15.0, stolen_percent: 5.0 });
        assert!(found.text().contains("15 % of the 2") && found.text().ends_with("5 %"));
        let own = load(&before, &after, 0.9).unwrap();
        assert_eq!(own.others_percent, 0.0, "its own share is measured by other clocks");
    }

    #[test]
    fn a_load_explains_no_more_than_the_time_that_it_took() {
        let load = |others_percent, stolen_percent| Load { processors: 2, others_percent, stolen_percent };
        let quarter = load(20.0, 5.0);
        assert!((quarter.allowed_ms(15.0) - 20.0).abs() < 1e-9);
        let judged = |p99, mean| Judged { times_ms: [[p99, 15.0], [mean, 12.0]], below_floor: 0, count: 900 };
        assert!(quarter.explains(&judged(19.9, 15.9)));
        assert!(!quarter.explains(&judged(20.1, 10.0)) && !quarter.explains(&judged(10.0, 16.1)));
        assert!(
            !load(1.0, 0.0).explains(&judged(15.5, 10.0)) && load(4.0, 0.0).explains(&judged(15.5, 10.0))
        );
        // Without a budget nothing is exceeded; the share of frames below the floor does not depend on
        // durations.
        let floor = |below_floor| Judged { times_ms: [[90.0, 0.0], [90.0, 0.0]], below_floor, count: 900 };
        assert!(quarter.explains(&floor(225)) && !quarter.explains(&floor(226)));
        for beyond in [load(900.0, 0.0), load(-5.0, 0.0)] {
            assert!((15.0..1501.0).contains(&beyond.allowed_ms(15.0)));
        }
    }

    #[test]
    fn a_system_that_does_not_tell_is_no_load() {
        assert_eq!(Ticks::parse(""), None);
        assert_eq!(Ticks::parse("cpu  1 2 x 4 5 6 7 8"), None);
        let one = Ticks::parse(BEFORE).unwrap();
        assert_eq!(load(&one, &one, 0.0), None, "no tick has passed");
    }

    #[test]
    fn this_machine_is_measured() {
        let mut account = LoadAccount::default();
        assert_eq!(account.load(0.0), None, "not started");
        account.start();
        assert!(account.0.is_some_and(|t| t.all > 0 && t.processors > 0));
    }
}
