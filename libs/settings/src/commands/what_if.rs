//! Changes of a what-if, and the command lines of `vitreo sweep` and `vitreo settings`.

use super::diff::plot_file;
use outputs::Force;
use std::path::PathBuf;

/// A key with the value to set.
#[derive(Debug, Clone, PartialEq)]
pub struct Assignment {
    /// Key such as `tracker.gate` or `scene.membrane.stiffness_un_per_mm`.
    pub key: String,
    /// The value, in the unit of the key's suffix.
    pub value: f64,
}

/// Options of a replay that exclude a what-if. Its own options name them too: clap waives the requirement of `--output` where
/// one of these excludes it.
pub const NOT_WITH_OUTPUT: [&str; 10] = [
    "verify",
    "poses",
    "blobs",
    "report",
    "endless",
    "assert_tracking",
    "assert_no_warnings",
    "from",
    "until",
    "with",
];

/// Changes of a what-if.
#[derive(Debug, Clone, Default, clap::Args)]
pub struct WhatIfArgs {
    /// Track with this rig instead of the recorded one; needs --output.
    #[arg(long, value_name = "RIG.json", requires = "output", conflicts_with_all = NOT_WITH_OUTPUT, help_heading = "What if")]
    pub rig: Option<PathBuf>,
    /// Simulate this scene, shipped or from a file, instead of the recorded one; needs --output.
    #[arg(long, value_name = "NAME|FILE", requires = "output", conflicts_with_all = NOT_WITH_OUTPUT, help_heading = "What if")]
    pub scene: Option<String>,
    /// Change constants of the tracker (tracker.KEY) or the scene (scene.KEY); vitreo settings lists them. Needs --output.
    #[arg(long, value_name = "KEY=VALUE,…", value_delimiter = ',', value_parser = assignment,
        requires = "output", conflicts_with_all = NOT_WITH_OUTPUT, help_heading = "What if")]
    pub set: Vec<Assignment>,
    /// Record the result, computed from the recorded blobs, handles and pedal.
    #[arg(short, long, value_name = "OUT.mcap", help_heading = "What if",
        conflicts_with_all = NOT_WITH_OUTPUT)]
    pub output: Option<PathBuf>,
}

/// Arguments of `vitreo settings`.
#[derive(Debug, clap::Args)]
pub struct SettingsListArgs {
    /// Scene to list, shipped or from a file.
    #[arg(long, value_name = "NAME|FILE", default_value = "peel")]
    pub scene: String,
    /// Print JSON.
    #[arg(long)]
    pub json: bool,
}

/// A key with the values of a sweep.
#[derive(Debug, Clone, PartialEq)]
pub struct Range {
    /// Key such as `tracker.gate` or `scene.membrane.stiffness_un_per_mm`.
    pub key: String,
    /// Evenly spaced values, from the first to the last typed one.
    pub values: Vec<f64>,
}

/// Arguments of `vitreo sweep`.
#[derive(Debug, clap::Args)]
pub struct SweepArgs {
    /// The recordings.
    #[arg(value_name = "FILE.mcap", required = true)]
    pub files: Vec<PathBuf>,
    /// Constant to change, its first and last value, and the number of values.
    #[arg(long, value_name = "KEY=FROM:TO:COUNT", value_parser = range, required = true)]
    pub set: Range,
    /// Recordings to replay in parallel [default: one per processor].
    #[arg(long, value_name = "N", value_parser = super::numbers::whole::<u32>(1, 4096))]
    pub jobs: Option<u32>,
    /// Write the figures of all replays as Parquet.
    #[arg(long, value_name = "FILE.parquet")]
    pub parquet: Option<PathBuf>,
    /// Plot the distance from the recorded poses against the constant's value.
    #[arg(long, value_name = "FILE.svg|FILE.png", value_parser = plot_file)]
    pub plot: Option<PathBuf>,
    /// `--force`.
    #[command(flatten)]
    pub force: Force,
}

/// Maximum number of values in a sweep.
const MOST_VALUES: usize = 1000;

fn assignment(text: &str) -> Result<Assignment, String> {
    let expected = || format!("expected KEY=VALUE, found '{text}'");
    let (key, value) = text.split_once('=').ok_or_else(expected)?;
    let value: f64 = value.trim().parse().map_err(|_| expected())?;
    if key.trim().is_empty() || !value.is_finite() {
        return Err(expected());
    }
    Ok(Assignment { key: key.trim().into(), value })
}

fn range(text: &str) -> Result<Range, String> {
    let expected = || format!("expected KEY=FROM:TO:COUNT, found '{text}'");
    let (key, range) = text.split_once('=').ok_or_else(expected)?;
    let [from, to, count] = range.split(':').collect::<Vec<_>>()[..] else { return Err(expected()) };
    let number = |text: &str| text.trim().parse().ok().filter(|v: &f64| v.is_finite()).ok_or_else(expected);
    let (from, to) = (number(from)?, number(to)?);
    let count: usize = count.trim().parse().map_err(|_| expected())?;
    if key.trim().is_empty() || !(1..=MOST_VALUES).contains(&count) {
        return Err(format!("{}; COUNT is 1 to {MOST_VALUES}", expected()));
    }
    let step = (to - from) / count.saturating_sub(1).max(1) as f64;
    let values = (0..count).map(|n| match n {
        0 => from,
        n if n + 1 == count => to,
        n => readable(from + step * n as f64),
    });
    Ok(Range { key: key.trim().into(), values: values.collect() })
}

/// Rounds an interpolated value to 12 digits, so that binary arithmetic does not show: 0.9 instead of
/// 0.8999999999999999.
fn readable(value: f64) -> f64 {
    format!("{value:.11e}").parse().unwrap_or(value)
}

#[cfg(test)]
mod tests {
    use super::*;
    use proptest::prelude::*;

    proptest! {
        #[test]
        fn any_text_is_read_or_refused(text in "\\PC{0,40}", key in "[a-z.]{1,9}", a in -1e6..1e6f64, b in -1e6..1e6f64, n in 2usize..50) {
            let _ = (assignment(&text), range(&text), range(&format!("k={text}")));
            let read = range(&format!("{key}={a}:{b}:{n}")).unwrap();
            prop_assert_eq!((read.values.len(), read.values[0], read.values[n - 1]), (n, a, b));
            prop_assert_eq!(assignment(&format!("{key}={a}")).unwrap(), Assignment { key, value: a });
        }
    }

    #[test]
    fn assignments_and_ranges_are_read_and_odd_ones_refused() {
        assert_eq!(
            assignment("tracker.gate=2.5e1"),
            Ok(Assignment { key: "tracker.gate".into(), value: 25.0 })
        );
        for wrong in ["", "a", "a=", "=1", "a=b", "a=inf", "a=NaN"] {
            assert!(assignment(wrong).is_err(), "{wrong:?} was taken");
        }
        assert_eq!(range("a=1:2:3").unwrap().values, [1.0, 1.5, 2.0]);
        assert_eq!(range("a=0.3:1.2:4").unwrap().values, [0.3, 0.6, 0.9, 1.2]);
        assert_eq!(
            (range("a=4:9:1").unwrap().values, range("a=2:1:2").unwrap().values),
            (vec![4.0], vec![2.0, 1.0])
        );
        for wrong in ["a=1:2", "a=1:2:0", "a=1:2:1001", "=1:2:3", "a=x:2:3", "a=1:2:3:4", "a=1:2:-3"] {
            assert!(range(wrong).is_err(), "{wrong:?} was taken");
        }
    }
}
