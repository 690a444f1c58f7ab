//! The instant at which two recordings differ most: by the distance of a body's poses; where poses are the same, the
//! first event, state or other entry that differs.

use super::causes::seconds;
use super::comparison::{Comparison, StageDifference};
use super::inputs::difference;
use super::poses::{FramePair, both_measured, displacement_um};
use super::side::{FrameSeen, Side};
use protocol::geometry::Validity;
use protocol::limits::BODIES;
use protocol::poses::BODY_NAMES;
use protocol::time::Nanos;

/// How far a frame may lie from an instant that it stands for, ns.
const NEAR_NS: u64 = 500_000_000;

/// An instant, in both recordings.
#[derive(Debug, Clone)]
pub struct Instant {
    /// What is largest there, or first.
    pub why: String,
    /// Exposures in the first and in the second recording, ns.
    pub exposed_ns: [Nanos; 2],
    /// The same, s from the start of each recording.
    pub at_s: [f64; 2],
    /// Fields of the frames nearest to it, where there are frames.
    pub fields: [Option<u64>; 2],
    /// The bodies in these frames.
    pub bodies: Vec<BodyThere>,
    /// What else first differs at this instant.
    pub differs: Vec<String>,
}

/// A body at the instant.
#[derive(Debug, Clone)]
pub struct BodyThere {
    /// Name.
    pub body: &'static str,
    /// In words, in the first and in the second recording.
    pub poses: [String; 2],
    /// How far they are apart; none where not both measured it.
    pub apart_um: Option<f64>,
}

/// Where two recordings differ most; `None` where they do not, or nothing that differs has an instant.
pub fn of(c: &Comparison, a: &Side, b: &Side) -> Option<Instant> {
    let largest = c.poses.bodies.iter().filter(|body| body.max_um > 0.0);
    let largest = largest.max_by(|p, q| p.max_um.total_cmp(&q.max_um));
    let by_pose = largest.and_then(|body| {
        let pair = c.frames.iter().find(|pair| pair.a.field == body.max_field)?;
        let why = format!("{} is {:.2} µm apart, which is the largest distance", body.body, body.max_um);
        Some((why, [pair.a.exposed_ns, pair.b.exposed_ns]))
    });
    let (why, exposed_ns) = by_pose.or_else(|| of_events(c)).or_else(|| of_stages(c))?;
    let frames = [frame_near(&a.frames, exposed_ns[0]), frame_near(&b.frames, exposed_ns[1])];
    let starts = [a.start_ns(), b.start_ns()];
    let differs = c.stages.iter().filter(|stage| is_there(stage, seconds(starts[0], exposed_ns[0])));
    Some(Instant {
        why,
        exposed_ns,
        at_s: [0, 1].map(|side| seconds(starts[side], exposed_ns[side])),
        fields: frames.map(|frame| frame.map(|f| f.field)),
        bodies: bodies(frames),
        differs: differs.map(|stage| format!("{}: {}", stage.name(), stage.entry)).collect(),
    })
}

/// The first event that differs.
fn of_events(c: &Comparison) -> Option<(String, [Nanos; 2])> {
    let first = c.events.first.as_ref()?;
    let offset = c.fields.clock_offset_ns;
    let exposed = match first.only_in == Some('B') {
        true => [first.exposed_ns.saturating_add_signed(offset.saturating_neg()), first.exposed_ns],
        false => [first.exposed_ns, first.exposed_ns.saturating_add_signed(offset)],
    };
    Some((format!("the first event that differs, of field {}: {}", first.field, first.what), exposed))
}

/// The first entry of a stage that has an instant.
fn of_stages(c: &Comparison) -> Option<(String, [Nanos; 2])> {
    let (stage, at_s) = c.stages.iter().find_map(|stage| Some((stage, stage.at_s?)))?;
    let at_ns = c.start_ns.saturating_add((at_s.max(0.0) * 1e9) as Nanos);
    let why = format!("the first difference, in {}: {}", stage.name(), stage.entry);
    Some((why, [at_ns, at_ns.saturating_add_signed(c.fields.clock_offset_ns)]))
}

fn is_there(stage: &StageDifference, at_s: f64) -> bool {
    stage.at_s.is_some_and(|stage_s| (stage_s - at_s).abs() < 0.5e-9 * NEAR_NS as f64)
}

fn frame_near(frames: &[FrameSeen], at_ns: Nanos) -> Option<&FrameSeen> {
    let nearest = frames.iter().min_by_key(|frame| frame.exposed_ns.abs_diff(at_ns));
    nearest.filter(|frame| difference(at_ns, frame.exposed_ns).unsigned_abs() <= NEAR_NS)
}

fn bodies(frames: [Option<&FrameSeen>; 2]) -> Vec<BodyThere> {
    let of = |body: usize| {
        let words = |frame: Option<&FrameSeen>| {
            let Some(frame) = frame else { return "no frame".to_owned() };
            let [x, y, z] = frame.bodies[body].position_mm;
            match Validity::from_wire(frame.bodies[body].validity) {
                Some(Validity::Measured) => format!("{x:.4}, {y:.4}, {z:.4} mm"),
                Some(Validity::Predicted) => format!("{x:.4}, {y:.4}, {z:.4} mm, predicted"),
                _ => "lost".to_owned(),
            }
        };
        let apart_um = match frames {
            [Some(a), Some(b)] if both_measured(&FramePair { a: *a, b: *b }, body) => {
                Some(displacement_um(body, &a.bodies[body], &b.bodies[body]).norm())
            }
            _ => None,
        };
        BodyThere { body: BODY_NAMES[body], poses: frames.map(words), apart_um }
    };
    (0..BODIES).map(of).collect()
}
