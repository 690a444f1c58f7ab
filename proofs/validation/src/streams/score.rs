//! Tracker frames beside the truth.

use super::Stream;
use nalgebra::Isometry3;
use protocol::geometry::Validity;
use protocol::limits::INSTRUMENTS;
use protocol::poses::{BodyStatus, EYE, TrackerFrame};
use protocol::predict::predict;
use tracker::Tracker;
use tracker::assembler::FrameAssembler;
use tracker::camera_watch::Notice;
use tracker::tuning::Tuning;

/// What the tracker made of a stream.
#[derive(Default)]
pub struct Tracked {
    /// Its frames.
    pub frames: Vec<TrackerFrame>,
    /// When each was there, ns.
    out_ns: Vec<u64>,
    /// What it reported about cameras, with the instant in s.
    pub notices: Vec<(f64, Notice)>,
}

impl Tracked {
    /// Tracks a stream on its own clock.
    pub fn of(stream: &Stream) -> Self {
        Self::tuned(stream, &Tuning::default())
    }

    /// As [`Tracked::of`], with other constants of the tracker.
    pub fn tuned(stream: &Stream, tuning: &Tuning) -> Self {
        let mut assembler = FrameAssembler::new(&stream.rig);
        let mut tracker = Tracker::tuned(&stream.rig, true, tuning);
        let mut tracked = Tracked::default();
        for field in &stream.fields {
            assembler.add(field, field.blobs_out_ns, |used, closed| {
                tracked.push(tracker.track(used, &closed.reference), field.blobs_out_ns);
                let t_s = closed.reference.exposed_ns as f64 * 1e-9;
                while let Some(notice) = tracker.take_notice() {
                    tracked.notices.push((t_s, notice));
                }
            });
        }
        tracked
    }

    /// Instants in `from..to` at which an instrument in the eye was measured, s: those whose tips are scored.
    pub fn measured_s(&self, stream: &Stream, instrument: usize, from: f64, to: f64) -> Vec<f64> {
        let measured = |f: &&TrackerFrame| f.bodies[instrument].validity() == Validity::Measured;
        let instants = self.frames.iter().filter(measured).map(|f| f.instants.exposed as f64 * 1e-9);
        let scored = |t_s: &f64| {
            let there = stream.motion.at(*t_s).present[instrument];
            (from..to).contains(t_s) && there && stream.markers_seen(instrument, *t_s) >= 2
        };
        instants.filter(scored).collect()
    }

    /// Adds a frame that was there at `out_ns`.
    pub fn push(&mut self, frame: TrackerFrame, out_ns: u64) {
        self.frames.push(frame);
        self.out_ns.push(out_ns);
    }
}

/// Errors of a stretch of time.
#[derive(Debug, Clone, Default)]
pub struct Score {
    /// Distance of measured tips from the truth, µm.
    pub tips_um: Vec<f64>,
    /// Those with the status *tracked*.
    pub tracked_um: Vec<f64>,
    /// Distance of shown tips from the truth, µm: predicted to the instants of an 85 Hz display by a viewer
    /// that takes the newest frame 15 ms before.
    pub shown_um: Vec<f64>,
    /// Angle between the measured and the true eye, mrad.
    pub eye_mrad: Vec<f64>,
    /// Instruments in the eye, and eyes, of which two cameras see three markers, in all frames.
    pub wanted: usize,
    /// Those with a measured pose.
    pub measured: usize,
    /// Most frames in a row without a measured instrument of which two cameras see three markers.
    pub longest_gap: usize,
}

/// Rate of the display, Hz, and how long before a picture is shown its frame is taken, s.
const DISPLAY: (f64, f64) = (85.0, 0.015);

impl Score {
    /// Of the frames whose exposure lies in `from..to`, s.
    pub fn of(tracked: &Tracked, stream: &Stream, from: f64, to: f64) -> Self {
        let mut score = Score::default();
        let mut gaps = [0; INSTRUMENTS];
        for frame in &tracked.frames {
            let t_s = frame.instants.exposed as f64 * 1e-9;
            if (from..to).contains(&t_s) {
                score.add(frame, stream, t_s, &mut gaps);
            }
        }
        score.show(tracked, stream, from, to);
        score
    }

    fn add(&mut self, frame: &TrackerFrame, stream: &Stream, t_s: f64, gaps: &mut [usize; INSTRUMENTS]) {
        let truth = stream.motion.at(t_s);
        for (body, state) in frame.bodies.iter().enumerate().filter(|(body, _)| truth.present[*body]) {
            let measured = state.validity() == Validity::Measured;
            let seen = stream.markers_seen(body, t_s);
            if seen >= 3 {
                self.wanted += 1;
                self.measured += usize::from(measured);
                if let Some(gap) = gaps.get_mut(body) {
                    *gap = if measured { 0 } else { *gap + 1 };
                    self.longest_gap = self.longest_gap.max(*gap);
                }
            }
            if !measured || seen < 2 {
                continue;
            }
            let pose = state.world_from_body.isometry();
            if body == EYE {
                self.eye_mrad.push(pose.rotation.angle_to(&truth.bodies[EYE].rotation) * 1e3);
            } else {
                let um = apart_um(&pose, &truth.bodies[body]);
                self.tips_um.push(um);
                if state.status == BodyStatus::Tracked as u32 {
                    self.tracked_um.push(um);
                }
            }
        }
    }

    /// What a display shows.
    fn show(&mut self, tracked: &Tracked, stream: &Stream, from: f64, to: f64) {
        let (hz, lead_s) = DISPLAY;
        for k in (from * hz) as u64..(to * hz) as u64 {
            let at_s = k as f64 / hz;
            let there = tracked.out_ns.partition_point(|out| *out as f64 * 1e-9 <= at_s - lead_s);
            let (Some(frame), truth) = (tracked.frames[..there].last(), stream.motion.at(at_s)) else {
                continue;
            };
            for body in (0..INSTRUMENTS).filter(|body| truth.present[*body]) {
                let shown = predict(frame, body, (at_s * 1e9) as u64);
                if shown.validity != Validity::Lost {
                    self.shown_um.push(apart_um(&shown.world_from_body.isometry(), &truth.bodies[body]));
                }
            }
        }
    }

    /// Share of bodies that were measured.
    pub fn coverage(&self) -> f64 {
        self.measured as f64 / self.wanted.max(1) as f64
    }
}

fn apart_um(a: &Isometry3<f64>, b: &Isometry3<f64>) -> f64 {
    (a.translation.vector - b.translation.vector).norm() * 1e3
}

/// Root mean square; 0 of nothing.
pub fn rms(errors: &[f64]) -> f64 {
    let sum: f64 = errors.iter().map(|e| e * e).sum();
    libm::sqrt(sum / errors.len().max(1) as f64)
}
