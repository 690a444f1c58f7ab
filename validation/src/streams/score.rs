//! Tracker frames beside the truth.

use super::Stream;
use super::motion::Motion;
use nalgebra::Vector3;
use protocol::geometry::Validity;
use protocol::limits::INSTRUMENTS;
use protocol::poses::{EYE, TrackerFrame};
use tracker::Tracker;
use tracker::assembler::FrameAssembler;
use tracker::camera_watch::Notice;

/// What the tracker made of a stream.
pub struct Tracked {
    /// Its frames.
    pub frames: Vec<TrackerFrame>,
    /// What it told of cameras, with the instant in s.
    pub notices: Vec<(f64, Notice)>,
}

impl Tracked {
    /// Tracks a stream on its own clock.
    pub fn of(stream: &Stream) -> Self {
        let (mut assembler, mut tracker) = (FrameAssembler::new(&stream.rig), Tracker::new(&stream.rig));
        let mut tracked = Tracked { frames: Vec::new(), notices: Vec::new() };
        for field in &stream.fields {
            assembler.add(field, field.blobs_out_ns, |used, closed| {
                tracked.frames.push(tracker.track(used, &closed.reference));
                let t_s = closed.reference.exposed_ns as f64 * 1e-9;
                while let Some(notice) = tracker.take_notice() {
                    tracked.notices.push((t_s, notice));
                }
            });
        }
        tracked
    }
}

/// Errors of a stretch of time.
#[derive(Debug, Clone, Default)]
pub struct Score {
    /// Distance of measured tips from the truth, µm.
    pub tips_um: Vec<f64>,
    /// Angle between the measured and the true eye, mrad.
    pub eye_mrad: Vec<f64>,
    /// Instruments in the eye, and eyes, in all frames.
    pub wanted: usize,
    /// Those with a measured pose.
    pub measured: usize,
    /// Frames without a measured instrument that is in the eye, longest run.
    pub longest_gap: usize,
}

impl Score {
    /// Of the frames whose exposure lies in `from..to`, s.
    pub fn of(frames: &[TrackerFrame], motion: &Motion, from: f64, to: f64) -> Self {
        let mut score = Score::default();
        let mut gaps = [0; INSTRUMENTS];
        for frame in frames {
            let t_s = frame.instants.exposed as f64 * 1e-9;
            if !(from..to).contains(&t_s) {
                continue;
            }
            let truth = motion.at(t_s);
            for (body, state) in frame.bodies.iter().enumerate() {
                if !truth.present[body] {
                    continue;
                }
                let measured = state.validity() == Validity::Measured;
                score.wanted += 1;
                score.measured += usize::from(measured);
                if body != EYE {
                    gaps[body] = if measured { 0 } else { gaps[body] + 1 };
                    score.longest_gap = score.longest_gap.max(gaps[body]);
                }
                if !measured {
                    continue;
                }
                let pose = state.world_from_body.isometry();
                if body == EYE {
                    let angle = pose.rotation.angle_to(&truth.bodies[EYE].rotation);
                    score.eye_mrad.push(angle * 1e3);
                } else {
                    let off: Vector3<f64> = pose.translation.vector - truth.bodies[body].translation.vector;
                    score.tips_um.push(off.norm() * 1e3);
                }
            }
        }
        score
    }

    /// Share of bodies that were measured.
    pub fn coverage(&self) -> f64 {
        self.measured as f64 / self.wanted.max(1) as f64
    }
}

/// Root mean square; 0 of nothing.
pub fn rms(errors: &[f64]) -> f64 {
    let sum: f64 = errors.iter().map(|e| e * e).sum();
    libm::sqrt(sum / errors.len().max(1) as f64)
}
