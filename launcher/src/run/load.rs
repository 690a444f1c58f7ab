//! How busy the machine was with other things while a run went on, by /proc/stat.

use serde::{Deserialize, Serialize};
use std::fs::read_to_string;

/// From this share of the processors on others can break a budget: with two, a fifth of one.
const LOADED_PERCENT: f64 = 10.0;

/// Time of all processors since the machine's start, in ticks, by what it went to.
#[derive(Debug, Clone, Copy, PartialEq)]
struct Ticks {
    busy: u64,
    /// Taken by the host of a virtual machine.
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

/// What the machine's processors did beside a run, in percent of all of them.
#[derive(Debug, Clone, Copy, PartialEq, Serialize, Deserialize)]
pub struct Load {
    /// Processors of the machine.
    pub processors: u64,
    /// Taken by other programs.
    pub others_percent: f64,
    /// Taken by the host of a virtual machine.
    pub stolen_percent: f64,
}

impl Load {
    /// True if others may have broken a budget.
    pub fn is_loaded(&self) -> bool {
        self.others_percent + self.stolen_percent >= LOADED_PERCENT
    }

    /// In words.
    pub fn text(&self) -> String {
        let Load { processors, others_percent, stolen_percent } = self;
        let others = format!("other programs took {others_percent:.0} % of the {processors} processors");
        if *stolen_percent < 0.5 {
            return others;
        }
        format!("{others}, the host of this machine {stolen_percent:.0} %")
    }
}

/// Measures the load from a first instant to the last.
#[derive(Debug, Default)]
pub(super) struct LoadAccount(Option<Ticks>);

impl LoadAccount {
    /// From now on.
    pub fn start(&mut self) {
        self.0 = Ticks::parse(&read_to_string("/proc/stat").unwrap_or_default());
    }

    /// Until now, where the run's own processes took `own_cores` processors on the average. `None`
    /// where the system does not tell, or no tick has passed.
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
        // 160 of 400 ticks busy, of which half a processor of two is the run's own.
        let found = load(&before, &after, 0.5).unwrap();
        assert_eq!(found, Load { processors: 2, others_percent: 15.0, stolen_percent: 5.0 });
        assert!(found.is_loaded() && found.text().contains("15 % of the 2") && found.text().ends_with("5 %"));
        let own = load(&before, &after, 0.9).unwrap();
        assert_eq!(own.others_percent, 0.0, "its own share is measured by other clocks");
        assert!(!own.is_loaded());
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
