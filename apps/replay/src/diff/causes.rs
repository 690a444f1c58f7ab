//! Why two recordings differ: a cause of the catalogue ([`calibration::causes::catalogue`]), said of the second
//! as seen from the first, with what it rests on and how sure it is.

pub use calibration::causes::Cause;

use super::inputs::difference;
use serde::Serialize;

/// How sure a finding is.
#[derive(Debug, Clone, Copy, PartialEq, Eq, PartialOrd, Ord, Serialize)]
#[serde(rename_all = "lowercase")]
pub enum Confidence {
    /// One of several that explain it as well.
    Possible,
    /// It explains what was measured down to the noise, and nothing else of the catalogue does.
    Likely,
    /// It was read, not inferred.
    Certain,
}

/// A cause with what it rests on.
#[derive(Debug, Clone, PartialEq, Serialize)]
pub struct Finding {
    /// The cause.
    #[serde(flatten)]
    pub cause: Cause,
    /// How sure.
    pub confidence: Confidence,
    /// What it rests on.
    pub evidence: String,
}

impl Finding {
    /// A finding.
    pub fn new(cause: Cause, confidence: Confidence, evidence: impl Into<String>) -> Self {
        Finding { cause, confidence, evidence: evidence.into() }
    }

    /// True where something was inferred that is to be mended; what stands in a rig or a scene was written there.
    pub fn is_a_defect(&self) -> bool {
        let missing = matches!(self.cause, Cause::InputMissing { .. } | Cause::CameraLost { .. });
        self.confidence < Confidence::Certain || missing
    }

    /// In one line.
    pub fn text(&self) -> String {
        let sure = match self.confidence {
            Confidence::Possible => "possible",
            Confidence::Likely => "likely",
            Confidence::Certain => "certain",
        };
        format!("{} ({sure}: {})", self.cause, self.evidence)
    }
}

/// Seconds from one instant to another.
pub fn seconds(from_ns: u64, to_ns: u64) -> f64 {
    difference(from_ns, to_ns) as f64 * 1e-9
}
