//! Wake-up latency of an idle thread at the same rate, in the same scheduling class and under the same load
//! (cyclictest, or a sleep loop if it is not installed). It is the lower limit of the tracker's latency on
//! the machine.

use crate::children::{REALTIME_PRIORITY, raise_this_thread};
use crate::run::Durations;
use anyhow::{Context, bail};
use ipc::clock::{now, sleep_until};
use ipc::logging::warn;
use std::io;
use std::process::Stdio;
use std::sync::Arc;
use std::sync::atomic::{AtomicBool, Ordering};

/// Longest wake-up latency in the histogram of cyclictest, µs.
const LONGEST_US: u64 = 100_000;
/// Time from the start of the loop to the first wake-up, ns.
const LEAD_NS: u64 = 20_000_000;

/// Parameters of a floor measurement.
#[derive(Debug, Clone, Copy)]
pub struct Wanted {
    /// Period of the wake-ups, ns.
    pub period_ns: u64,
    /// Number of wake-ups.
    pub count: u64,
    /// True to run the thread under the real-time scheduler.
    pub realtime: bool,
}

/// Result of a floor measurement.
#[derive(Debug)]
pub struct Floor {
    /// Latencies of the wake-ups.
    pub late: Durations,
    /// The tool, for the report.
    pub tool: String,
}

/// Measures the floor. Raising `stop` ends the sleep loop early.
///
/// # Errors
/// If cyclictest fails or its output is not understood, or the real-time scheduler refuses the thread.
pub async fn measure(wanted: Wanted, stop: Arc<AtomicBool>) -> anyhow::Result<Floor> {
    match cyclictest(wanted).await {
        Ok(floor) => return floor,
        Err(problem) if problem.kind() == io::ErrorKind::NotFound => {}
        Err(problem) => warn(&format!("cyclictest does not start: {problem}")),
    }
    let measured = tokio::task::spawn_blocking(move || own(wanted, &stop)).await?;
    let tool = "this command's own loop of absolute sleeps (cyclictest of rt-tests is not installed)";
    Ok(Floor { late: measured?, tool: tool.into() })
}

/// Measures with cyclictest. The outer error means that it cannot be started.
async fn cyclictest(wanted: Wanted) -> io::Result<anyhow::Result<Floor>> {
    let mut command = tokio::process::Command::new("cyclictest");
    let [interval, count, longest] =
        [wanted.period_ns / 1_000, wanted.count, LONGEST_US].map(|n| n.to_string());
    let class = if wanted.realtime { ["rr", REALTIME_PRIORITY] } else { ["other", "0"] };
    command.args(["--quiet", "--default-system", "--threads=1"]);
    command.arg(format!("--policy={}", class[0])).arg(format!("--priority={}", class[1]));
    command.args(["-i", &interval, "-l", &count, "-h", &longest]);
    command.stdin(Stdio::null()).kill_on_drop(true);
    let output = command.output().await?;
    let text = String::from_utf8_lossy(&output.stdout);
    if !output.status.success() {
        let why = String::from_utf8_lossy(&output.stderr).trim().to_owned();
        return Ok(Err(anyhow::anyhow!("cyclictest failed ({}): {why}", output.status)));
    }
    let tool = format!("cyclictest --policy={} --priority={}", class[0], class[1]);
    Ok(histogram(&text).map(|late| Floor { late, tool }))
}

/// Parses the histogram that cyclictest prints: one line `LATENCY COUNT` per µs, such as `000012 000345`, and
/// a summary in comments. Latencies beyond its end count as [`LONGEST_US`].
fn histogram(text: &str) -> anyhow::Result<Durations> {
    let mut late = Durations::default();
    for line in text.lines() {
        if let Some(summary) = line.strip_prefix('#') {
            let beyond = summary.trim().strip_prefix("Histogram Overflows:").map(str::trim);
            if let Some(count) = beyond.filter(|n| !n.is_empty()) {
                let count: u64 = count.parse().with_context(|| format!("cyclictest: {line}"))?;
                (0..count).for_each(|_| late.note(LONGEST_US * 1_000, 0));
            }
            continue;
        }
        let mut words = line.split_whitespace();
        let Some(us) = words.next() else { continue };
        let number = |word: Option<&str>| word.and_then(|w| w.parse::<u64>().ok());
        let (Some(us), Some(count), None) = (number(Some(us)), number(words.next()), words.next()) else {
            bail!("cyclictest: a line of its histogram was expected, found '{line}'");
        };
        (0..count).for_each(|_| late.note(us * 1_000, 0));
    }
    anyhow::ensure!(late.count() > 0, "cyclictest reported no wake-up");
    Ok(late)
}

/// Measures with a loop of absolute sleeps.
fn own(wanted: Wanted, stop: &AtomicBool) -> anyhow::Result<Durations> {
    if wanted.realtime {
        raise_this_thread()?;
    }
    let mut late = Durations::default();
    let begin = now() + LEAD_NS;
    for n in 0..wanted.count {
        if stop.load(Ordering::Relaxed) {
            break;
        }
        let due = begin + n * wanted.period_ns;
        sleep_until(due);
        late.note(now() - due, n);
    }
    Ok(late)
}

#[cfg(test)]
mod tests {
    use super::*;

    const PRINTED: &str = "# Histogram\n000000 000000\n000028 000001\n000029 000097\n000105 000001\n# Total: 000000099\n\
                        # Min Latencies: 00028\n# Histogram Overflows: 00001\n# Histogram Overflow at cycle number:\n\
                        # Thread 0: 00041\n\n";

    #[test]
    fn what_cyclictest_prints_is_read_with_what_is_beyond_its_end() {
        let late = histogram(PRINTED).unwrap();
        assert_eq!(late.count(), 100);
        assert!(
            (late.at_ms(50.0) - 0.029).abs() < 1e-4 && (late.at_ms(99.0) - 0.105).abs() < 1e-3,
            "{late:?}"
        );
        assert!((late.at_ms(100.0) - 100.0).abs() < 1e-6);
        for odd in
            ["", "T: 0 (1234) P:10 I:5000", "000001", "000001 000002 000003", "# Histogram Overflows: x"]
        {
            assert!(histogram(odd).is_err(), "{odd}");
        }
    }

    #[test]
    fn our_own_loop_wakes_as_often_as_asked() {
        let wanted = Wanted { period_ns: 1_000_000, count: 20, realtime: false };
        let late = own(wanted, &AtomicBool::new(false)).unwrap();
        assert_eq!(late.count(), 20);
        assert_eq!(own(wanted, &AtomicBool::new(true)).unwrap().count(), 0, "it can be ended");
    }
}
