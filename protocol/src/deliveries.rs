//! How the pictures of live cameras came, for the report of a run. The process of the cameras keeps it as
//! a file of JSON in the instance's directory, once a second and when it ends.

use crate::time::Nanos;
use serde::{Deserialize, Serialize};
use std::collections::BTreeMap;

/// Name of the file in the instance's directory.
pub const DELIVERIES_FILE: &str = "cameras.json";

/// How the pictures of all cameras came.
#[derive(Debug, Clone, Default, PartialEq, Serialize, Deserialize)]
pub struct Deliveries {
    /// The instant at which the pictures with number 0 count as read out; 0 before.
    pub start_ns: Nanos,
    /// Each camera, in the order of the rig.
    pub cameras: Vec<Delivery>,
}

/// How the pictures of one camera came.
#[derive(Debug, Clone, Default, PartialEq, Serialize, Deserialize)]
pub struct Delivery {
    /// Its id in the rig.
    pub camera: u32,
    /// Where its pictures come from.
    pub source: String,
    /// Fields that were put out.
    pub fields: u64,
    /// Fields left out because they came too late.
    pub late: u64,
    /// Numbers for which no field was put out, late ones included.
    pub missing: u64,
    /// How often the source was opened and brought a picture.
    pub openings: u64,
    /// How late a field was there after it was read out, ms; 0 where it waited to be read.
    pub delay_ms: Delays,
    /// Fields left out because the camera is faster than the rig says.
    #[serde(default)]
    pub surplus: u64,
    /// Frames that a camera's driver lost or delivered damaged.
    #[serde(default)]
    pub lost: u64,
    /// How far a camera's stamps were from its pace, ms; zeros of what has no stamps.
    #[serde(default)]
    pub jitter_ms: Delays,
    /// What its camera was set to; empty where nothing was set.
    #[serde(default)]
    pub settings: String,
    /// How often what was wrong, by kind.
    pub troubles: BTreeMap<String, u64>,
    /// What is wrong at the end, in words; empty where nothing is.
    pub trouble: String,
}

/// Percentiles of a delay, ms.
#[derive(Debug, Clone, Copy, Default, PartialEq, Serialize, Deserialize)]
#[allow(missing_docs)]
pub struct Delays {
    pub p50: f64,
    pub p99: f64,
    pub max: f64,
}

impl Delivery {
    /// One line for a person.
    pub fn line(&self) -> String {
        let Delays { p50, p99, max } = self.delay_ms;
        let mut line = format!(
            "camera {} ({}): {} fields, {} missing, {} of them late; delay p50 {p50:.1}, p99 {p99:.1}, max {max:.1} ms",
            self.camera, self.source, self.fields, self.missing, self.late
        );
        if self.jitter_ms != Delays::default() {
            let Delays { p50, p99, max } = self.jitter_ms;
            line += &format!("; stamps jitter p50 {p50:.2}, p99 {p99:.2}, max {max:.2} ms");
        }
        for (count, what) in [(self.lost, "lost by its driver"), (self.surplus, "more than the rig's rate")] {
            if count > 0 {
                line += &format!("; {count} {what}");
            }
        }
        if !self.settings.is_empty() {
            line += &format!("; set to {}", self.settings);
        }
        let troubles: Vec<String> = self.troubles.iter().map(|(kind, n)| format!("{kind} {n} ×")).collect();
        if !troubles.is_empty() {
            line += &format!("; {}", troubles.join(", "));
        }
        if !self.trouble.is_empty() {
            line += &format!("; at the end: {}", self.trouble);
        }
        line
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn a_line_names_what_was_wrong_and_what_still_is() {
        let delay_ms = Delays { p50: 0.5, p99: 3.0, max: 7.25 };
        let sound =
            Delivery { camera: 2, source: "y4m:c".into(), fields: 9, delay_ms, ..Delivery::default() };
        let line = sound.line();
        assert!(
            line.starts_with("camera 2 (y4m:c): 9 fields, 0 missing") && line.ends_with("max 7.2 ms"),
            "{line}"
        );
        let jitter_ms = Delays { p50: 0.11, p99: 0.5, max: 1.0 };
        let settings = "gain 4".to_owned();
        let stamped = Delivery { jitter_ms, lost: 3, settings, ..sound.clone() };
        let end = "stamps jitter p50 0.11, p99 0.50, max 1.00 ms; 3 lost by its driver; set to gain 4";
        assert!(stamped.line().ends_with(end), "{}", stamped.line());
        let troubles = BTreeMap::from([("closed".to_owned(), 3), ("black".to_owned(), 1)]);
        let line = Delivery { troubles, trouble: "its pipe is closed".into(), ..sound }.line();
        assert!(line.ends_with("; black 1 ×, closed 3 ×; at the end: its pipe is closed"), "{line}");
    }
}
