//! How each body was tracked, in a line: shares, residuals by camera, the longest gap.

use crate::tracking::ratio;
use protocol::geometry::Validity;
use protocol::limits::{BODIES, MAX_CAMERAS};
use protocol::matches::{BlobUse, MatchFrame};
use protocol::poses::{BODY_NAMES, TrackerFrame};
use protocol::time::Nanos;
use serde::Serialize;
use std::collections::BTreeMap;
use std::fmt::Write;

/// Number and sum of squares, px².
#[derive(Debug, Clone, Copy, Default)]
struct Squares {
    count: u64,
    sum: f64,
}

impl Squares {
    fn add(&mut self, count: u64, sum: f64) {
        (self.count, self.sum) = (self.count + count, self.sum + sum);
    }

    fn rms(self) -> f64 {
        (self.sum / (self.count.max(1)) as f64).sqrt()
    }
}

/// What is summed up of a body.
#[derive(Debug, Clone, Default)]
struct BodySums {
    measured: u64,
    predicted: u64,
    /// Exposure of the last measured pose, ns.
    last_ns: Option<Nanos>,
    longest_gap_ns: u64,
    /// Of the frames' residuals.
    residuals: Squares,
    /// Of the blobs' residuals, by camera.
    by_camera: [Squares; MAX_CAMERAS],
}

/// Sums up how bodies were tracked.
#[derive(Debug, Clone)]
pub struct Summary {
    period_ns: u64,
    /// Exposures of the first and the newest frame, ns.
    span: Option<[Nanos; 2]>,
    bodies: [BodySums; BODIES],
}

/// How a body was tracked.
#[derive(Debug, Clone, Default, PartialEq, Serialize)]
pub struct BodySummary {
    /// Share of the frames due with a measured pose.
    pub measured_share: f64,
    /// Share of the frames due whose pose was only predicted.
    pub predicted_share: f64,
    /// Share of the frames due without a pose; a frame that is missing counts too.
    pub lost_share: f64,
    /// Longest time without a measured pose, s.
    pub longest_gap_s: f64,
    /// Root mean square of the distances of blobs from the fitted markers, px.
    pub residual_rms_px: f64,
    /// The same by camera; empty where matches were not recorded.
    pub camera_rms_px: BTreeMap<usize, f64>,
}

impl Summary {
    /// With the field period of a rig, ns.
    pub fn new(period_ns: u64) -> Self {
        Summary { period_ns, span: None, bodies: Default::default() }
    }

    /// Takes a frame of the tracker.
    pub fn note_frame(&mut self, frame: &TrackerFrame) {
        let exposed = frame.instants.exposed;
        let [start, newest] = self.span.unwrap_or([exposed; 2]);
        self.span = Some([start.min(exposed), newest.max(exposed)]);
        for (sums, body) in self.bodies.iter_mut().zip(&frame.bodies) {
            match body.validity() {
                Validity::Measured => {
                    sums.measured += 1;
                    let blobs = u64::from(body.blobs_used);
                    sums.residuals.add(blobs, blobs as f64 * body.residual_px * body.residual_px);
                    let since = exposed.saturating_sub(sums.last_ns.unwrap_or(start));
                    // Consecutive frames have no gap between them.
                    let regular = if sums.last_ns.is_some() { self.period_ns } else { 0 };
                    sums.longest_gap_ns = sums.longest_gap_ns.max(gap_ns(since, regular));
                    sums.last_ns = Some(exposed);
                }
                Validity::Predicted => sums.predicted += 1,
                Validity::Lost => {}
            }
        }
    }

    /// Takes what became of the blobs of a frame: those of markers that are seen whole, as in a body's own residual.
    pub fn note_matches(&mut self, matches: &MatchFrame) {
        for field in matches.fields().iter().filter(|f| (f.camera as usize) < MAX_CAMERAS) {
            for blob in field.blobs().iter().filter(|b| b.outcome() == BlobUse::Used) {
                let Some((body, _)) = blob.marker() else { continue };
                let [x, y] = [blob.residual_x_px, blob.residual_y_px].map(f64::from);
                self.bodies[body].by_camera[field.camera as usize].add(1, x * x + y * y);
            }
        }
    }

    /// Sums up, by body, of the frames that should have been.
    pub fn bodies(&self, frames_due: u64) -> [BodySummary; BODIES] {
        self.bodies.each_ref().map(|sums| {
            let [measured_share, predicted_share] =
                [sums.measured, sums.predicted].map(|n| ratio(n, frames_due));
            let [start, end] = self.span.unwrap_or_default();
            let at_end = end.saturating_sub(sums.last_ns.unwrap_or(start));
            let seen = sums.by_camera.iter().enumerate().filter(|(_, s)| s.count > 0);
            let camera_rms_px: BTreeMap<usize, f64> = seen.map(|(id, s)| (id, s.rms())).collect();
            let mut all = Squares::default();
            sums.by_camera.iter().for_each(|s| all.add(s.count, s.sum));
            BodySummary {
                measured_share,
                predicted_share,
                lost_share: (1.0 - measured_share - predicted_share).max(0.0),
                longest_gap_s: sums.longest_gap_ns.max(at_end) as f64 * 1e-9,
                residual_rms_px: if all.count > 0 { all.rms() } else { sums.residuals.rms() },
                camera_rms_px,
            }
        })
    }

    /// A line a body, for people; none without a frame.
    pub fn lines(&self, frames_due: u64) -> Vec<String> {
        let bodies = self.bodies(frames_due);
        let lines = BODY_NAMES.iter().zip(&bodies).map(|(name, body)| body.line(name));
        lines.take(if self.span.is_some() { BODIES } else { 0 }).collect()
    }
}

/// What of the time between two measured poses is more than one period.
fn gap_ns(since_ns: u64, period_ns: u64) -> u64 {
    let over = since_ns.saturating_sub(period_ns);
    // Exposures vary a little.
    if over < period_ns / 2 { 0 } else { over }
}

impl BodySummary {
    /// In one line.
    fn line(&self, name: &str) -> String {
        let [measured, predicted, lost] =
            [self.measured_share, self.predicted_share, self.lost_share].map(|share| 100.0 * share);
        let mut line =
            format!("{name:<5} measured {measured:.1} %, predicted {predicted:.1} %, lost {lost:.1} %");
        if self.measured_share > 0.0 {
            let _ = write!(line, ", residual {:.2} px RMS", self.residual_rms_px);
        }
        let cameras: Vec<String> =
            self.camera_rms_px.iter().map(|(id, rms)| format!("camera {id} {rms:.2}")).collect();
        if !cameras.is_empty() {
            let _ = write!(line, " ({})", cameras.join(", "));
        }
        let _ = write!(line, ", longest gap {:.2} s", self.longest_gap_s);
        line
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use bytemuck::Zeroable;
    use protocol::matches::MatchedBlob;

    const PERIOD_NS: u64 = 20_000_000;

    /// A frame whose first body is as given; the others are lost.
    fn frame(n: u64, validity: Validity) -> TrackerFrame {
        let mut frame = TrackerFrame::zeroed();
        frame.instants.exposed = 1_000_000_000 + n * PERIOD_NS;
        frame.bodies.iter_mut().for_each(|body| body.validity = Validity::Lost as u32);
        frame.bodies[0].validity = validity as u32;
        (frame.bodies[0].residual_px, frame.bodies[0].blobs_used) = (0.1, 8);
        frame
    }

    #[test]
    fn shares_gaps_and_residuals_are_those_of_the_frames() {
        let mut summary = Summary::new(PERIOD_NS);
        assert!(summary.lines(0).is_empty());
        for n in 0..100 {
            // Frames 90 to 94 do not come.
            let validity = match n {
                0..10 => Validity::Lost,
                50..60 => Validity::Predicted,
                90..95 => continue,
                _ => Validity::Measured,
            };
            summary.note_frame(&frame(n, validity));
        }
        let [inst0, inst1, _] = summary.bodies(100);
        assert_eq!((inst0.measured_share, inst0.predicted_share), (0.75, 0.1));
        assert!((inst0.lost_share - 0.15).abs() < 1e-9);
        assert!((inst0.longest_gap_s - 0.2).abs() < 1e-9 && (inst1.longest_gap_s - 1.98).abs() < 1e-9);
        assert!((inst0.residual_rms_px - 0.1).abs() < 1e-9, "by the bodies' own residuals");
        let mut matches = MatchFrame { exposed_ns: 1, field_count: 2, ..Zeroable::zeroed() };
        for (camera, field) in (1..).zip(matches.fields_mut()) {
            field.camera = camera;
            let residual = camera as f32 * 0.3;
            field.push(MatchedBlob {
                residual_x_px: residual,
                residual_y_px: 0.4 * camera as f32,
                ..Zeroable::zeroed()
            });
            field.push(MatchedBlob { outcome: 2, residual_x_px: 9.0, ..Zeroable::zeroed() });
        }
        summary.note_matches(&matches);
        let lines = summary.lines(100);
        assert_eq!(
            lines[0],
            "inst0 measured 75.0 %, predicted 10.0 %, lost 15.0 %, residual 0.79 px RMS (camera 1 0.50, camera 2 \
             1.00), longest gap 0.20 s"
        );
        assert_eq!(lines[1], "inst1 measured 0.0 %, predicted 0.0 %, lost 100.0 %, longest gap 1.98 s");
    }
}
