//! The latency budgets: one table, which a TOML file may override.

use crate::frames::FrameRecord;
use crate::poses::{ClosedBy, TrackerFrame};
use crate::steps::StepRecord;
use crate::time::{Instants, Nanos};
use serde::{Deserialize, Serialize};

/// A stage of the path from the sensor to the picture.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Hash, Serialize, Deserialize, PartialOrd, Ord)]
#[serde(rename_all = "kebab-case")]
pub enum Stage {
    /// `exposed` → `blobs_out`.
    Camera,
    /// Waiting for a late camera.
    CameraWait,
    /// `blobs_out` of the last field used → `tracked`.
    Tracking,
    /// `tracked` → `stepped`.
    Simulation,
    /// `frame_start` → `drawn`.
    Rendering,
    /// `exposed` → `displayed`.
    WholeSystem,
}

impl Stage {
    /// In the order of the data path.
    pub const ALL: [Stage; 6] = {
        use Stage::*;
        [Camera, CameraWait, Tracking, Simulation, Rendering, WholeSystem]
    };

    /// Name in tables, reports and budget files.
    pub fn name(self) -> &'static str {
        match self {
            Stage::Camera => "camera",
            Stage::CameraWait => "camera-wait",
            Stage::Tracking => "tracking",
            Stage::Simulation => "simulation",
            Stage::Rendering => "rendering",
            Stage::WholeSystem => "whole-system",
        }
    }

    /// From which instant to which.
    pub fn span(self) -> &'static str {
        match self {
            Stage::Camera => "exposed → blobs_out",
            Stage::CameraWait => "first field → last field",
            Stage::Tracking => "blobs_out → tracked",
            Stage::Simulation => "tracked → stepped",
            Stage::Rendering => "frame_start → drawn",
            Stage::WholeSystem => "exposed → displayed",
        }
    }
}

/// Time from one instant to a later one; `None` where either is missing or they are reversed.
fn between(from: Nanos, to: Nanos) -> Option<u64> {
    (from > 0 && to >= from).then(|| to - from)
}

/// Latency of the stages that a step record covers, ns.
pub fn step_latencies(step: &StepRecord) -> [(Stage, Option<u64>); 2] {
    let Instants { exposed, blobs_out, tracked, stepped, .. } = step.instants;
    [(Stage::Camera, between(exposed, blobs_out)), (Stage::Simulation, between(tracked, stepped))]
}

/// Latency of the stages that a tracker frame covers, ns. Where the frame was closed without
/// a camera that was waited for, the wait is the camera's, and tracking begins when it ended.
pub fn pose_latencies(frame: &TrackerFrame) -> [(Stage, Option<u64>); 2] {
    let Instants { blobs_out, taken, tracked, .. } = frame.instants;
    let begun = if frame.closed_by == ClosedBy::Inputs as u32 { blobs_out } else { taken };
    [(Stage::CameraWait, Some(frame.waited_ns)), (Stage::Tracking, between(begun, tracked))]
}

/// Latency of the stages that a frame record covers, ns.
pub fn frame_latencies(frame: &FrameRecord) -> [(Stage, Option<u64>); 2] {
    [
        (Stage::Rendering, between(frame.frame_start, frame.drawn)),
        (Stage::WholeSystem, between(frame.instants.exposed, frame.displayed)),
    ]
}

/// The limits of one stage. A limit of 0 is not asserted.
#[derive(Debug, Clone, Copy, PartialEq, Serialize, Deserialize)]
#[serde(deny_unknown_fields)]
pub struct Budget {
    /// The stage.
    pub stage: Stage,
    /// Limit of the chosen percentile, ms.
    pub limit_ms: f64,
    /// Limit of the mean, ms.
    #[serde(default)]
    pub mean_ms: f64,
}

/// All budgets.
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize)]
#[serde(deny_unknown_fields)]
pub struct Budgets {
    /// Percentile at which `limit_ms` is asserted, 0 to 100.
    pub percentile: f64,
    /// One entry a stage.
    pub budget: Vec<Budget>,
}

/// Why a budget file was refused.
#[derive(Debug, thiserror::Error)]
#[error("budget file {file}: {problem}")]
pub struct BudgetError {
    /// The file.
    pub file: String,
    /// What is wrong, with the line where the parser knows it.
    pub problem: String,
}

impl Default for Budgets {
    /// The design's figures: camera 2 ms half exposure + 20 ms read-out + 2 ms extraction + jitter;
    /// simulation and rendering from the paper, section 2.2; whole system: the paper's 50 ms mean.
    fn default() -> Self {
        let entry = |stage, limit_ms, mean_ms| Budget { stage, limit_ms, mean_ms };
        Budgets {
            percentile: 99.0,
            budget: vec![
                entry(Stage::Camera, 25.0, 0.0),
                entry(Stage::CameraWait, 3.0, 0.0),
                entry(Stage::Tracking, 1.0, 0.0),
                entry(Stage::Simulation, 8.5, 0.0),
                entry(Stage::Rendering, 15.0, 0.0),
                entry(Stage::WholeSystem, 65.0, 50.0),
            ],
        }
    }
}

/// Percent of the cameras' period that a step may take: the rest is for what is late.
const STEP_PERCENT: u64 = 80;

/// Extraction and jitter after the read-out of a field, as in the defaults, ms.
const AFTER_READ_OUT_MS: f64 = 4.5;

impl Budgets {
    /// The defaults for a rig whose fastest camera has a period, ns, and whose slowest one has been read out
    /// `read_out_ns` after mid-exposure. A step must be done before the next field, so its budget is [`STEP_PERCENT`] of
    /// the period where that is less. Cameras that need longer than the defaults' have what they need, and the
    /// whole system has that much more.
    pub fn of_rig(period_ns: u64, read_out_ns: u64) -> Self {
        let mut all = Budgets::default();
        let step_ms = (period_ns * STEP_PERCENT / 100) as f64 / 1e6;
        let camera_ms = read_out_ns as f64 / 1e6 + AFTER_READ_OUT_MS;
        let more_ms = (camera_ms - all.of(Stage::Camera).limit_ms).max(0.0);
        for budget in &mut all.budget {
            match budget.stage {
                Stage::Simulation => budget.limit_ms = budget.limit_ms.min(step_ms),
                Stage::Camera => budget.limit_ms += more_ms,
                Stage::WholeSystem => {
                    budget.limit_ms += more_ms;
                    budget.mean_ms += more_ms;
                }
                _ => {}
            }
        }
        all
    }

    /// Parses a budget file; stages that it leaves out keep their default.
    ///
    /// # Errors
    /// Where the text is no TOML, has an unknown key, or a limit or percentile out of its range.
    pub fn parse(text: &str, file: &str) -> Result<Self, BudgetError> {
        Budgets::default().overridden_by(text, file)
    }

    /// These with what a budget file says; stages that it leaves out stay.
    ///
    /// # Errors
    /// As [`Budgets::parse`].
    pub fn overridden_by(mut self, text: &str, file: &str) -> Result<Self, BudgetError> {
        #[derive(Deserialize)]
        #[serde(deny_unknown_fields)]
        struct Overrides {
            percentile: Option<f64>,
            #[serde(default)]
            budget: Vec<Budget>,
        }
        let fail = |problem: String| BudgetError { file: file.into(), problem };
        let overrides: Overrides = toml::from_str(text).map_err(|e| fail(e.to_string()))?;
        let all = &mut self;
        all.percentile = overrides.percentile.unwrap_or(all.percentile);
        if !(0.0..=100.0).contains(&all.percentile) {
            return Err(fail(format!("percentile: expected 0 to 100, found {}", all.percentile)));
        }
        for new in overrides.budget {
            if !(new.limit_ms >= 0.0 && new.mean_ms >= 0.0) {
                return Err(fail(format!("{}: expected limits ≥ 0, found {new:?}", new.stage.name())));
            }
            let old = all.budget.iter_mut().find(|b| b.stage == new.stage);
            *old.expect("the default table has every stage") = new;
        }
        Ok(self)
    }

    /// The budget of a stage.
    pub fn of(&self, stage: Stage) -> Budget {
        let found = self.budget.iter().find(|b| b.stage == stage);
        *found.expect("the table has every stage")
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn overrides_replace_single_stages() {
        let text = "percentile = 95\n[[budget]]\nstage = \"rendering\"\nlimit_ms = 40";
        let budgets = Budgets::parse(text, "b.toml").unwrap();
        assert_eq!(budgets.of(Stage::Rendering).limit_ms, 40.0);
        assert_eq!(budgets.of(Stage::Simulation).limit_ms, 8.5);
        assert_eq!(budgets.percentile, 95.0);
    }

    #[test]
    fn a_step_has_its_budget_of_the_paper_or_most_of_a_period_and_a_file_wins() {
        let step_ms = |period_ns| Budgets::of_rig(period_ns, 0).of(Stage::Simulation).limit_ms;
        assert_eq!([40_000_000, 20_000_000, 5_000_000, 2_000_000].map(step_ms), [8.5, 8.5, 4.0, 1.6]);
        assert_eq!(Budgets::of_rig(20_000_000, 20_432_000), Budgets::default());
        let text = "[[budget]]\nstage = \"simulation\"\nlimit_ms = 7";
        let budgets = Budgets::of_rig(5_000_000, 3_500_000).overridden_by(text, "b.toml").unwrap();
        assert_eq!(budgets.of(Stage::Simulation).limit_ms, 7.0);
        assert_eq!(budgets.of(Stage::Camera), Budgets::default().of(Stage::Camera));
    }

    #[test]
    fn cameras_that_are_read_out_for_longer_have_what_they_need() {
        let budgets = Budgets::of_rig(40_000_000, 36_560_000);
        let ms = |stage| (budgets.of(stage).limit_ms, budgets.of(stage).mean_ms);
        assert!((ms(Stage::Camera).0 - 41.06).abs() < 1e-9);
        let (limit, mean) = ms(Stage::WholeSystem);
        assert!((limit - 81.06).abs() < 1e-9 && (mean - 66.06).abs() < 1e-9, "{limit} {mean}");
        assert_eq!(ms(Stage::Simulation), (8.5, 0.0));
    }

    #[test]
    fn the_wait_for_a_camera_that_did_not_come_is_not_trackings() {
        let mut frame: TrackerFrame = bytemuck::Zeroable::zeroed();
        (frame.instants.blobs_out, frame.instants.taken, frame.instants.tracked) = (100, 3_100, 3_300);
        frame.waited_ns = 3_000;
        let latencies = |f: &TrackerFrame| pose_latencies(f).map(|(_, ns)| ns.unwrap());
        assert_eq!(latencies(&frame), [3_000, 3_200]);
        frame.closed_by = ClosedBy::TimeOut as u32;
        assert_eq!(latencies(&frame), [3_000, 200]);
    }

    #[test]
    fn bad_files_are_named() {
        for text in ["percentile = 120", "budgets = 1", "[[budget]]\nstage = \"x\"\nlimit_ms = 1"] {
            assert!(Budgets::parse(text, "b.toml").unwrap_err().to_string().contains("b.toml"));
        }
    }
}
