//! Statistics of the poses that a subscriber reads. Pure: times are arguments.

use super::slowest::Slowest;
use super::stream::Triples;
use crate::run::Durations;
use nalgebra::{Isometry3, UnitQuaternion, Vector3};
use protocol::geometry::Validity;
use protocol::limits::BODIES;
use protocol::poses::{BODY_NAMES, ClosedBy, TrackerFrame};
use protocol::time::Nanos;
use serde::Serialize;

/// Sums for one body.
#[derive(Debug, Clone, Default)]
struct Body {
    /// Number of frames with validity *measured*.
    measured: u64,
    /// The first pose, `world_from_body`, from which all differences are taken.
    reference: Option<Isometry3<f64>>,
    resting: u64,
    /// Sums of the differences from the reference at rest: position, mm, and rotation vector, rad; below, the
    /// sums of their squared norms, mm² and rad².
    sum: [Vector3<f64>; 2],
    squares: [f64; 2],
    /// Sum of the differences between measured and true position at rest, mm.
    off: Vector3<f64>,
    /// Minimum and maximum of each coordinate, mm.
    range: Option<[Vector3<f64>; 2]>,
    /// Largest rotation from the reference, rad.
    turned: f64,
    moving: u64,
    /// Sums of squared errors in motion: position, mm², and angle, rad².
    errors: [f64; 2],
}

impl Body {
    fn note(&mut self, pose: &Isometry3<f64>, truth: &Isometry3<f64>, at_rest: bool) {
        self.measured += 1;
        let reference = *self.reference.get_or_insert(*pose);
        let position = pose.translation.vector;
        let turn = (reference.rotation.inverse() * pose.rotation).scaled_axis();
        if at_rest {
            let differences = [position - reference.translation.vector, turn];
            for (i, difference) in differences.into_iter().enumerate() {
                self.sum[i] += difference;
                self.squares[i] += difference.norm_squared();
            }
            self.off += position - truth.translation.vector;
            self.resting += 1;
        } else {
            self.errors[0] += (position - truth.translation.vector).norm_squared();
            self.errors[1] += angle_between(&pose.rotation, &truth.rotation).powi(2);
            self.moving += 1;
        }
        let [least, most] = self.range.unwrap_or([position; 2]);
        self.range = Some([least.inf(&position), most.sup(&position)]);
        self.turned = self.turned.max(turn.norm());
    }

    fn figures(&self, name: &'static str, frames: u64) -> BodyFigures {
        let resting = self.resting.max(1) as f64;
        let spread =
            |i: usize| (self.squares[i] / resting - (self.sum[i] / resting).norm_squared()).max(0.0).sqrt();
        let moving = self.moving.max(1) as f64;
        let [least, most] = self.range.unwrap_or_default();
        BodyFigures {
            body: name,
            measured_share: self.measured as f64 / frames.max(1) as f64,
            static_frames: self.resting,
            static_noise_um: 1e3 * spread(0),
            static_noise_mrad: 1e3 * spread(1),
            static_offset_um: 1e3 * (self.off / resting).norm(),
            range_mm: (most - least).into(),
            range_deg: self.turned.to_degrees(),
            moving_frames: self.moving,
            moving_error_um: 1e3 * (self.errors[0] / moving).sqrt(),
            moving_error_mrad: 1e3 * (self.errors[1] / moving).sqrt(),
        }
    }
}

fn angle_between(a: &UnitQuaternion<f64>, b: &UnitQuaternion<f64>) -> f64 {
    (a.inverse() * b).angle()
}

/// Figures of one body.
#[derive(Debug, Clone, PartialEq, Serialize)]
pub struct BodyFigures {
    /// Name of the body.
    pub body: &'static str,
    /// Share of the frames in which the body was measured, 0 to 1.
    pub measured_share: f64,
    /// Number of poses at rest.
    pub static_frames: u64,
    /// Root mean square distance of the positions at rest from their mean, µm. The position of an instrument
    /// is that of its tip.
    pub static_noise_um: f64,
    /// Root mean square distance of the orientations at rest from their mean, mrad.
    pub static_noise_mrad: f64,
    /// Distance of the mean position at rest from the truth, µm.
    pub static_offset_um: f64,
    /// Difference between maximum and minimum of each coordinate, mm.
    pub range_mm: [f64; 3],
    /// Largest rotation from the first pose, degrees.
    pub range_deg: f64,
    /// Number of poses in motion.
    pub moving_frames: u64,
    /// Root mean square position error in motion, µm.
    pub moving_error_um: f64,
    /// Root mean square orientation error in motion, mrad.
    pub moving_error_mrad: f64,
}

/// All statistics of one stream.
#[derive(Debug)]
pub struct Tally {
    /// First counted triple, and the number of counted triples.
    first: u64,
    triples: u64,
    /// Lowest triple number that is still accepted.
    next: u64,
    /// Number of triples with poses.
    pub seen: u64,
    /// Number of triples whose frame was closed before it had all of its fields.
    pub incomplete: u64,
    /// Time from the sending of the last blobs to the reading of the poses.
    pub latency: Durations,
    /// Parts of the latency, as named in [`PARTS`].
    pub parts: [Durations; 3],
    /// Breakdown of the longest latencies.
    pub slowest: Slowest,
    /// Time from mid-exposure to the reading of the poses.
    pub from_exposure: Durations,
    bodies: [Body; BODIES],
}

/// Index of the tracker's own time in [`Tally::parts`].
pub const TRACKING: usize = 1;
/// Names of [`Tally::parts`].
pub const PARTS: [&str; 3] =
    ["last blob sent → taken by the tracker", "taken → poses sent", "poses sent → read"];

impl Tally {
    /// Statistics of `triples` triples from number `first` on.
    pub fn of(first: u64, triples: u64) -> Self {
        Tally {
            first,
            triples,
            next: first,
            seen: 0,
            incomplete: 0,
            latency: Durations::default(),
            parts: Default::default(),
            slowest: Slowest::of(triples),
            from_exposure: Durations::default(),
            bodies: Default::default(),
        }
    }

    /// Adds a frame that was read at `read_ns`. Repeated, late and uncounted triples are ignored.
    pub fn note(&mut self, frame: &TrackerFrame, read_ns: Nanos, triples: &Triples) {
        let field = frame.field;
        if field < self.next || field - self.first >= self.triples {
            return;
        }
        self.next = field + 1;
        self.seen += 1;
        let whole = frame.closed_by == ClosedBy::Inputs as u32
            && frame.used().len() == triples.fields_in(field)
            && frame.used().iter().all(|used| triples.field_of(used.camera, field) == Some(used.field));
        self.incomplete += u64::from(!whole);
        let instants = &frame.instants;
        self.latency.note(read_ns.saturating_sub(instants.blobs_out), field);
        let ways = [instants.blobs_out, instants.taken, instants.tracked, read_ns];
        let parts_ns = std::array::from_fn(|part| ways[part + 1].saturating_sub(ways[part]));
        self.parts.iter_mut().zip(parts_ns).for_each(|(part, ns)| part.note(ns, field));
        self.slowest.note(field, instants.blobs_out, parts_ns);
        self.from_exposure.note(read_ns.saturating_sub(instants.exposed), field);
        let truth = triples.placed(field);
        for ((body, state), truth) in self.bodies.iter_mut().zip(&frame.bodies).zip(&truth) {
            if state.validity == Validity::Measured as u32 {
                body.note(&state.world_from_body.isometry(), truth, triples.is_at_rest(field));
            }
        }
    }

    /// Limits the counted triples to those sent. `sent` includes the triples before the first counted one.
    pub fn end_with(&mut self, sent: u64) {
        self.triples = self.triples.min(sent.saturating_sub(self.first));
    }

    /// True once the last counted triple has arrived.
    pub fn is_full(&self) -> bool {
        self.next == self.first + self.triples
    }

    /// Number of triples without poses.
    pub fn drops(&self) -> u64 {
        self.triples - self.seen
    }

    /// Number of counted triples.
    pub fn triples(&self) -> u64 {
        self.triples
    }

    /// Figures of each body.
    pub fn bodies(&self) -> Vec<BodyFigures> {
        self.bodies.iter().zip(BODY_NAMES).map(|(body, name)| body.figures(name, self.seen)).collect()
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use bytemuck::Zeroable;
    use nalgebra::Translation3;
    use protocol::geometry::Pose;
    use protocol::poses::FieldUsed;
    use rig::Rig;

    fn triples() -> Triples {
        Triples::of(&Rig::parse(super::super::RIG, "a rig").unwrap(), 20)
    }

    /// A complete frame whose positions differ from the truth by `off_mm` along x.
    fn frame(triples: &Triples, field: u64, off_mm: f64) -> TrackerFrame {
        let mut frame = TrackerFrame { field, used_count: 3, ..TrackerFrame::zeroed() };
        for (used, camera) in frame.used.iter_mut().zip(0..3) {
            *used = FieldUsed { field, camera, ..FieldUsed::zeroed() };
        }
        let instants = &mut frame.instants;
        (instants.exposed, instants.blobs_out, instants.taken, instants.tracked) =
            (1_000_000, 5_000_000, 5_030_000, 5_100_000);
        for (body, truth) in frame.bodies.iter_mut().zip(triples.placed(field)) {
            body.world_from_body = Pose::from_isometry(&(Translation3::new(off_mm, 0.0, 0.0) * truth));
            body.validity = Validity::Measured as u32;
        }
        frame
    }

    #[test]
    fn latencies_are_parted_and_what_is_missing_is_dropped() {
        let (triples, mut tally) = (triples(), Tally::of(2, 10));
        for field in (0..16).filter(|field| *field != 6) {
            tally.note(&frame(&triples, field, 0.0), 5_150_000, &triples);
            assert_eq!(tally.is_full(), field >= 11, "{field}");
        }
        tally.note(&frame(&triples, 11, 0.0), 9_000_000, &triples);
        assert_eq!((tally.seen, tally.drops(), tally.incomplete), (9, 1, 0));
        let us = |durations: &Durations| (durations.at_ms(50.0) * 1e3).round() as u64;
        assert_eq!(tally.parts.each_ref().map(us), [30, 70, 50]);
        assert_eq!((us(&tally.latency), us(&tally.from_exposure)), (150, 4_150));
        assert_eq!(tally.slowest.figures().parts_ms.map(|ms| (ms * 1e3).round() as u64), [30, 70, 50]);
        tally.end_with(12);
        assert_eq!((tally.triples(), tally.drops()), (10, 1), "all were sent");
        tally.end_with(11);
        tally.seen -= 1;
        assert_eq!((tally.triples(), tally.drops()), (9, 1), "no triple that was not sent is a drop");
        tally.end_with(1);
        assert_eq!(tally.triples(), 0);
        let mut late = frame(&triples, 2, 0.0);
        late.used_count = 2;
        let mut tally = Tally::of(2, 10);
        tally.note(&late, 5_150_000, &triples);
        assert_eq!((tally.seen, tally.incomplete), (1, 1));
    }

    #[test]
    fn noise_is_about_the_mean_offset_from_the_truth_and_range_of_the_motion() {
        let (triples, mut tally) = (triples(), Tally::of(0, 1_000));
        // Positions 3 µm to either side of an offset of 10 µm.
        (0..1_000).for_each(|n| {
            let off_mm = 0.010 + if n % 2 == 0 { 0.003 } else { -0.003 };
            tally.note(&frame(&triples, n, off_mm), 6_000_000, &triples);
        });
        let [tip, _, eye] = <[BodyFigures; 3]>::try_from(tally.bodies()).unwrap();
        assert_eq!((tip.static_frames, tip.moving_frames, tip.measured_share), (20, 980, 1.0));
        assert!(
            (tip.static_noise_um - 3.0).abs() < 1e-6 && (tip.static_offset_um - 10.0).abs() < 1e-6,
            "{tip:?}"
        );
        let expected = (10.0f64.powi(2) + 3.0f64.powi(2)).sqrt();
        assert!((tip.moving_error_um - expected).abs() < 1e-6 && tip.moving_error_mrad < 1e-3, "{tip:?}");
        assert!(tip.range_mm.iter().all(|mm| (1.0..8.0).contains(mm)) && tip.range_deg > 5.0, "{tip:?}");
        assert!(eye.range_mm[1] < 1e-9 && eye.range_deg > 3.0 && eye.static_noise_mrad < 1e-3, "{eye:?}");
    }
}
