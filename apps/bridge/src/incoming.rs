//! Transforms of another tracker become frames of ours. Pure: instants are arguments.
//!
//! Transforms that bear the same timestamp are of one frame, and so are those of nearly the same one: many servers
//! stamp each transform when they send it. A frame is complete when every body has come, and is given out without the
//! missing ones where the next begins, or nothing more comes. A body that did not come, or is not `OK`, is predicted
//! for a tenth of a second and lost then.

use crate::map::Map;
use crate::motion::Motion;
use bytemuck::Zeroable;
use igtl::{Content, Message, STATUS_OK};
use nalgebra::{Isometry3, Matrix3, Rotation3, Translation3, UnitQuaternion, Vector3};
use protocol::geometry::{Pose, Validity};
use protocol::limits::BODIES;
use protocol::poses::{BODY_NAMES, BodyState, BodyStatus, COVARIANCE_ENTRIES, EYE, TrackerFrame};
use protocol::predict::predict_body;
use protocol::time::Nanos;

/// Time for which a body without a measurement is predicted before it counts as lost, ns.
const PREDICTED_NS: u64 = 100_000_000;
/// A timestamp that lies farther from its arrival is of another clock, ns.
const SAME_CLOCK_NS: u64 = 500_000_000;
/// Timestamps of one frame are no farther apart than this, ns, and than half the time between two of a body.
const TOGETHER_NS: u64 = 25_000_000;
/// Metadata that say whether a body is seen: the key of PLUS and Slicer, and that of older ones.
pub const STATUS_KEYS: [&str; 2] = ["TransformStatus", "Status"];
/// How far rows of a rotation may be from unit length and right angles: numbers of 32 bits, and rounding on the way.
const ROTATION_ERROR: f64 = 1e-3;
/// Largest coordinate, mm.
const FARTHEST_MM: f64 = 1e5;
/// Entries of the covariance's diagonal, which is a triangle row by row.
const DIAGONAL: [usize; 6] = [0, 6, 11, 15, 18, 20];

/// What becomes of a message.
#[derive(Debug, Clone, PartialEq, Eq)]
pub enum Taken {
    /// It is part of a frame.
    Used,
    /// It is of no body that is mapped.
    Unknown(String),
    /// It makes no sense, for this reason.
    Refused(String),
}

/// A frame that is not complete.
#[derive(Debug, Clone, Copy)]
struct Pending {
    unix_ns: u64,
    exposed_ns: Nanos,
    poses: [Option<Isometry3<f64>>; BODIES],
    came: [bool; BODIES],
}

/// Collects transforms.
pub struct Incoming {
    map: Map,
    pending: Option<Pending>,
    motions: [Option<Motion>; BODIES],
    measured_ns: [Nanos; BODIES],
    /// Said by a status beside the transforms.
    is_absent: [bool; BODIES],
    /// When a transform of a body came last; 0 where none has.
    came_ns: [Nanos; BODIES],
    /// The newest timestamp of each body; 0 where none has come.
    stamped_ns: [u64; BODIES],
    /// Time between two timestamps of a body, ns; 0 where it is not known.
    period_ns: u64,
    field: u64,
    exposed_ns: Nanos,
}

impl Incoming {
    /// `first` is the number of the first frame, which must lie above all that were sent before.
    pub fn new(map: Map, first: u64) -> Self {
        Incoming {
            map,
            pending: None,
            motions: [None; BODIES],
            measured_ns: [0; BODIES],
            is_absent: [false; BODIES],
            came_ns: [0; BODIES],
            stamped_ns: [0; BODIES],
            period_ns: 0,
            field: first,
            exposed_ns: 0,
        }
    }

    /// Takes a message that came at `arrived_ns`; `offset_ns` is what is added to an instant to get the time since
    /// 1970. A frame that is complete by it, or was ended by it, is given to `send`.
    pub fn take(
        &mut self,
        message: &Message,
        arrived_ns: Nanos,
        offset_ns: u64,
        mut send: impl FnMut(&TrackerFrame),
    ) -> Taken {
        let Some(body) = self.map.body(&message.device) else {
            return Taken::Unknown(message.device.clone());
        };
        let rows = match &message.content {
            Content::Transform(rows) => rows,
            Content::Status { code, .. } => {
                self.is_absent[body] = *code != STATUS_OK;
                return Taken::Used;
            }
        };
        let is_there = status_of(message).map_or(!self.is_absent[body], |s| s.eq_ignore_ascii_case("OK"));
        let pose = match pose_of(rows) {
            Ok(pose) => pose,
            Err(problem) => return Taken::Refused(format!("{}: {problem}", message.device)),
        };
        self.came_ns[body] = arrived_ns;
        let together_ns = self.together_ns(body, message.unix_ns);
        let is_next = |p: &Pending| p.came[body] || p.unix_ns.abs_diff(message.unix_ns) > together_ns;
        if self.pending.as_ref().is_some_and(is_next) {
            self.close(arrived_ns, &mut send);
        }
        let pending = self.pending.get_or_insert_with(|| Pending {
            unix_ns: message.unix_ns,
            exposed_ns: exposed(message.unix_ns, arrived_ns, offset_ns),
            poses: [None; BODIES],
            came: [false; BODIES],
        });
        pending.came[body] = true;
        pending.poses[body] = is_there.then_some(pose);
        let whole = self.map.bodies.iter().zip(pending.came).all(|(mapped, came)| came || mapped.is_none());
        if whole {
            self.close(arrived_ns, &mut send);
        }
        Taken::Used
    }

    /// The bodies whose transform has not come since an instant, each with its transform's name.
    pub fn missing_since(&self, at: Nanos) -> Vec<String> {
        let bodies = self.map.bodies.iter().zip(BODY_NAMES).zip(self.came_ns);
        let missing = bodies.filter(|(_, came)| *came < at);
        let named = missing.filter_map(|((mapped, name), _)| Some((mapped.as_ref()?, name)));
        named.map(|(mapped, name)| format!("{} ({name})", mapped.transform)).collect()
    }

    /// How far timestamps of one frame may lie apart, where `body` has this one.
    fn together_ns(&mut self, body: usize, unix_ns: u64) -> u64 {
        let before_ns = std::mem::replace(&mut self.stamped_ns[body], unix_ns);
        if before_ns > 0 && unix_ns > before_ns {
            let between_ns = unix_ns - before_ns;
            // Where a body was missing in between, the period is no longer than before.
            let longest_ns =
                if self.period_ns > 0 { self.period_ns + self.period_ns / 8 } else { between_ns };
            self.period_ns = between_ns.min(longest_ns);
        }
        TOGETHER_NS.min(self.period_ns / 2)
    }

    /// Gives the frame that is pending out: nothing more of it has come for long.
    pub fn flush(&mut self, now: Nanos, mut send: impl FnMut(&TrackerFrame)) {
        self.close(now, &mut send);
    }

    /// Gives the frame that is pending out.
    fn close(&mut self, arrived_ns: Nanos, send: &mut impl FnMut(&TrackerFrame)) {
        let Some(pending) = self.pending.take() else { return };
        // One that is no newer than the last carries no news.
        if pending.exposed_ns <= self.exposed_ns {
            return;
        }
        self.exposed_ns = pending.exposed_ns;
        let mut frame = TrackerFrame::zeroed();
        frame.field = self.field;
        self.field += 1;
        let instants = &mut frame.instants;
        (instants.exposed, instants.read_out) = (pending.exposed_ns, pending.exposed_ns);
        (instants.blobs_out, instants.taken) = (pending.exposed_ns, arrived_ns.max(pending.exposed_ns));
        for body in 0..BODIES {
            frame.bodies[body] = self.body(body, pending.poses[body], pending.exposed_ns);
        }
        send(&frame);
    }

    fn body(&mut self, body: usize, measured: Option<Isometry3<f64>>, at_ns: Nanos) -> BodyState {
        let Some(mapped) = &self.map.bodies[body] else { return still(at_ns) };
        let Some(tracker_from_tool) = measured else { return self.missing(body, at_ns) };
        let mut pose = self.map.world_from_tracker * tracker_from_tool * mapped.tool_from_tip;
        if body == EYE {
            // The world's origin is the eye's centre: of the eye the rotation counts.
            pose.translation = Translation3::identity();
        }
        let dt_s = at_ns.saturating_sub(self.measured_ns[body]) as f64 * 1e-9;
        let motion = self.motions[body].get_or_insert_with(|| Motion::at(pose));
        motion.note(pose, dt_s, self.map.noise, self.map.acceleration);
        self.measured_ns[body] = at_ns;
        state(motion, pose, self.map.noise, at_ns)
    }

    /// A mapped body that was not measured.
    fn missing(&self, body: usize, at_ns: Nanos) -> BodyState {
        let measured_ns = self.measured_ns[body];
        let Some(motion) = &self.motions[body] else {
            let mut lost = still(at_ns);
            (lost.validity, lost.status) = (Validity::Lost as u32, BodyStatus::Lost as u32);
            return lost;
        };
        let mut state = state(motion, motion.last(), self.map.noise, measured_ns);
        let since_ns = at_ns.saturating_sub(measured_ns);
        state.world_from_body = predict_body(&state, since_ns as f64 * 1e-9).world_from_body;
        let (validity, status) = if since_ns <= PREDICTED_NS {
            (Validity::Predicted, BodyStatus::Predicted)
        } else {
            (Validity::Lost, BodyStatus::Lost)
        };
        (state.validity, state.status) = (validity as u32, status as u32);
        state
    }
}

/// What the sender says of a body in the metadata of its transform.
fn status_of(message: &Message) -> Option<&str> {
    let of = |name: &str| message.metadata.iter().find(|(key, _)| key == name);
    STATUS_KEYS.into_iter().find_map(of).map(|(_, value)| value.as_str())
}

/// When a transform was measured: its timestamp, where that is of this machine's clock, else its arrival.
fn exposed(unix_ns: u64, arrived_ns: Nanos, offset_ns: u64) -> Nanos {
    let stamped = unix_ns.wrapping_sub(offset_ns);
    let is_ours = unix_ns > 0 && stamped <= arrived_ns && arrived_ns - stamped < SAME_CLOCK_NS;
    if is_ours { stamped } else { arrived_ns }
}

fn state(motion: &Motion, pose: Isometry3<f64>, noise: [f64; 2], at_ns: Nanos) -> BodyState {
    let mut state = still(at_ns);
    state.world_from_body = Pose::from_isometry(&pose);
    state.predictor.velocity_mm_s = motion.velocity_mm_s.into();
    state.predictor.angular_velocity_rad_s = motion.angular_rad_s.into();
    for (i, entry) in DIAGONAL.into_iter().enumerate() {
        let sigma = noise[usize::from(i >= 3)];
        state.covariance[entry] = sigma * sigma;
    }
    state
}

/// A body that stands where the world does, measured.
fn still(at_ns: Nanos) -> BodyState {
    let mut state = BodyState::zeroed();
    state.world_from_body = Pose::IDENTITY;
    state.measured_ns = at_ns;
    (state.validity, state.status) = (Validity::Measured as u32, BodyStatus::Tracked as u32);
    state
}

/// A rigid pose, or why it is none.
fn pose_of(rows: &[[f32; 4]; 3]) -> Result<Isometry3<f64>, String> {
    let at = |row: usize, column: usize| f64::from(rows[row][column]);
    let place = Vector3::from_fn(|row, _| at(row, 3));
    if let Some(far) = place.iter().find(|c| c.abs() > FARTHEST_MM) {
        return Err(format!("expected coordinates up to {FARTHEST_MM:e} mm, found {far}"));
    }
    let matrix = Matrix3::from_fn(at);
    let error = (matrix * matrix.transpose() - Matrix3::identity()).abs().max();
    if error > ROTATION_ERROR || matrix.determinant() < 0.0 {
        return Err(format!("expected a rotation, found {:?}", matrix.transpose().as_slice()));
    }
    let mut turn = UnitQuaternion::from_rotation_matrix(&Rotation3::from_matrix_unchecked(matrix));
    turn.renormalize();
    Ok(Isometry3::from_parts(place.into(), turn))
}

const _: () = assert!(DIAGONAL[5] == COVARIANCE_ENTRIES - 1);

#[cfg(test)]
mod tests {
    use super::*;
    use crate::transforms::Writer;
    use igtl::Reader;
    use proptest::prelude::*;
    use protocol::message::Message as _;

    const MS: u64 = 1_000_000;
    /// Time since 1970 less the instant.
    const OFFSET: u64 = 1_700_000_000_000_000_000;

    fn ours(ms: u64) -> TrackerFrame {
        let mut frame = TrackerFrame::zeroed();
        (frame.field, frame.instants.exposed) = (ms, 1_000 * MS + ms * MS);
        for (i, body) in frame.bodies.iter_mut().enumerate() {
            let turn = UnitQuaternion::from_scaled_axis(Vector3::new(0.1, 0.2 * i as f64, -0.3));
            let x = if i == EYE { 0.0 } else { 1.0 + 0.004 * ms as f64 };
            let place = Translation3::new(x, if i == EYE { 0.0 } else { -2.0 }, 0.0);
            body.world_from_body = Pose::from_isometry(&Isometry3::from_parts(place, turn));
            body.validity = Validity::Measured as u32;
        }
        frame
    }

    /// Hands the messages of a frame over, 3 ms after its instant.
    fn pass(incoming: &mut Incoming, writer: &mut Writer, frame: &TrackerFrame) -> Vec<TrackerFrame> {
        let (mut bytes, mut all, mut sent) = (Vec::new(), Vec::new(), Vec::new());
        writer.frame(frame, OFFSET, &mut bytes).unwrap();
        Reader::default().take(&bytes, |m| all.push(m.unwrap())).unwrap();
        for message in &all {
            incoming.take(message, frame.instants.exposed + 3 * MS, OFFSET, |f| sent.push(*f));
        }
        sent
    }

    /// A transform somewhere, with its timestamp and what is said of it.
    fn transform(device: &str, unix_ns: u64, said: &[(&str, &str)]) -> Message {
        let rows = [[1.0, 0.0, 0.0, 0.0], [0.0, 1.0, 0.0, 0.0], [0.0, 0.0, 1.0, 5.0]];
        let metadata = said.iter().map(|(key, value)| ((*key).into(), (*value).into())).collect();
        Message { device: device.into(), unix_ns, id: 0, metadata, content: Content::Transform(rows) }
    }

    #[test]
    fn what_we_send_comes_in_as_it_was() {
        for protocol in [1, 3] {
            let (mut incoming, mut writer) = (Incoming::new(Map::default(), 70), Writer::new(protocol));
            for i in 0..50 {
                let frame = ours(20 * i);
                let [got] = pass(&mut incoming, &mut writer, &frame)[..] else { panic!("one frame") };
                got.validate().unwrap();
                assert_eq!(got.field, 70 + i);
                assert!(got.instants.exposed.abs_diff(frame.instants.exposed) <= 1);
                for (a, b) in got.bodies.iter().zip(&frame.bodies) {
                    let between = a.world_from_body.isometry().inverse() * b.world_from_body.isometry();
                    assert!(between.translation.vector.norm() < 1e-5 && between.rotation.angle() < 1e-6);
                    assert_eq!(a.validity(), Validity::Measured);
                    assert!((a.covariance[0] - 0.01).abs() < 1e-9 && (a.covariance[20] - 4e-6).abs() < 1e-12);
                }
            }
            let [got] = pass(&mut incoming, &mut writer, &ours(1_000))[..] else { panic!("one frame") };
            let velocity = got.bodies[0].predictor.velocity_mm_s;
            assert!((velocity[0] - 4.0).abs() < 0.2 && velocity[1].abs() < 1e-3, "{velocity:?}");
        }
    }

    #[test]
    fn a_body_that_is_missing_is_predicted_and_then_lost() {
        let (mut incoming, mut writer) = (Incoming::new(Map::default(), 0), Writer::new(3));
        for i in 0..100 {
            pass(&mut incoming, &mut writer, &ours(20 * i));
        }
        for (ms, expected) in
            [(2_000, Validity::Predicted), (2_060, Validity::Predicted), (2_400, Validity::Lost)]
        {
            let mut frame = ours(ms);
            frame.bodies[1].validity = Validity::Lost as u32;
            let [got] = pass(&mut incoming, &mut writer, &frame)[..] else { panic!("one frame") };
            assert_eq!((got.bodies[0].validity(), got.bodies[1].validity()), (Validity::Measured, expected));
            let x = got.bodies[1].world_from_body.position_mm[0];
            let limit = if expected == Validity::Predicted { 0.02 } else { 2.0 };
            assert!((x - (1.0 + 0.004 * ms as f64)).abs() < limit, "{ms}: {x}");
        }
        let [got] = pass(&mut incoming, &mut writer, &ours(2_420))[..] else { panic!("one frame") };
        assert_eq!(got.bodies[1].validity(), Validity::Measured, "it is back");
    }

    #[test]
    fn frames_without_a_body_wait_for_the_next_and_clocks_of_others_are_not_trusted() {
        let map = Map::read("[inst0]\ntransform = \"A\"\n[inst1]\ntransform = \"B\"\n").unwrap();
        let mut incoming = Incoming::new(map, 0);
        let identity = [[1.0, 0.0, 0.0, 0.0], [0.0, 1.0, 0.0, 0.0], [0.0, 0.0, 1.0, 5.0]];
        let message = |device: &str, unix_ns| Message {
            device: device.into(),
            unix_ns,
            id: 0,
            metadata: Vec::new(),
            content: Content::Transform(identity),
        };
        let mut sent = Vec::new();
        // A clock that is an hour off: stamps distinguish frames, instants are those of arrival.
        for (device, unix_ns, ms) in [("A", 7, 10), ("A", 8, 30), ("B", 8, 31), ("B", 9, 50)] {
            let taken = incoming.take(&message(device, unix_ns), ms * MS, OFFSET, |f| sent.push(*f));
            assert_eq!(taken, Taken::Used);
        }
        let seen: Vec<_> = sent.iter().map(|f| (f.instants.exposed / MS, f.bodies[1].validity())).collect();
        assert_eq!(seen, [(10, Validity::Lost), (30, Validity::Measured)]);
        assert_eq!(
            sent[0].bodies[EYE].validity(),
            Validity::Measured,
            "an eye that is not tracked stands still"
        );
        assert_eq!(incoming.missing_since(40 * MS), ["A (inst0)"]);
        assert_eq!(incoming.missing_since(50 * MS), ["A (inst0)"]);
        assert_eq!(incoming.missing_since(30 * MS), Vec::<String>::new());
        assert_eq!(incoming.take(&message("C", 1), 0, 0, |_| {}), Taken::Unknown("C".into()));
        let mut mirrored = message("A", 1);
        mirrored.content = Content::Transform([[-1.0, 0.0, 0.0, 0.0], identity[1], identity[2]]);
        let told = incoming.take(&mirrored, 0, 0, |_| {});
        assert!(matches!(&told, Taken::Refused(why) if why.contains("A: expected a rotation")), "{told:?}");
        let mut far = message("A", 1);
        far.content = Content::Transform([[1.0, 0.0, 0.0, 1e9], identity[1], identity[2]]);
        assert!(
            matches!(incoming.take(&far, 0, 0, |_| {}), Taken::Refused(why) if why.contains("coordinates"))
        );
    }

    #[test]
    fn transforms_that_are_stamped_one_by_one_are_of_one_frame() {
        for period_ms in [2, 5, 20] {
            let mut incoming = Incoming::new(Map::default(), 0);
            let mut sent = Vec::new();
            for i in 1..50 {
                for (body, name) in crate::transforms::NAMES[..3].iter().enumerate() {
                    // A third of the period passes while they are sent.
                    let at = 1_000 * MS + i * period_ms * MS + body as u64 * period_ms.min(6) * MS / 9;
                    let message = transform(name, at + OFFSET, &[]);
                    assert_eq!(incoming.take(&message, at + MS / 10, OFFSET, |f| sent.push(*f)), Taken::Used);
                }
            }
            assert_eq!(sent.len(), 49 + 2, "until the period is known, frames are in parts");
            assert!(sent[3..].iter().all(|f| f.bodies.iter().all(|b| b.validity() == Validity::Measured)));
            // A frame without its first body, and the next one without its second, are two.
            let at = (1_000 + 50 * period_ms) * MS;
            let before = sent.len();
            for (name, at) in [("Instrument1ToWorld", at), ("Instrument0ToWorld", at + period_ms * MS)] {
                incoming.take(&transform(name, at + OFFSET, &[]), at, OFFSET, |f| sent.push(*f));
            }
            assert_eq!(sent.len(), before + 1);
            incoming.flush(at + 200 * MS, |f| sent.push(*f));
            incoming.flush(at + 400 * MS, |f| sent.push(*f));
            assert_eq!(sent.len(), before + 2, "nothing more comes");
        }
    }

    #[test]
    fn the_status_of_plus_counts_before_that_of_others() {
        let (plus, older) = ("TransformStatus", "Status");
        for (status, expected) in [
            (&[(plus, "MISSING")][..], Validity::Lost),
            (&[(plus, "OUT_OF_VIEW"), (older, "OK")], Validity::Lost),
            (&[(plus, "OK")], Validity::Measured),
            (&[(plus, "ok")], Validity::Measured),
            (&[(older, "INVALID")], Validity::Lost),
            (&[("Frame", "7")], Validity::Measured),
        ] {
            let mut incoming = Incoming::new(Map::read("[inst0]\ntransform = \"A\"\n").unwrap(), 0);
            let mut sent = Vec::new();
            incoming.take(&transform("A", 7, status), MS, OFFSET, |f| sent.push(*f));
            assert_eq!(sent[0].bodies[0].validity(), expected, "{status:?}");
        }
    }

    proptest! {
        /// Whatever comes, in whatever order and with whatever stamps, frames make sense and their instants rise.
        #[test]
        fn any_messages_make_valid_frames(
            all in prop::collection::vec(
                (0usize..4, any::<u64>(), 0u64..40, prop::array::uniform3(-3.0f64..3.0), prop::array::uniform3(-1e5f32..1e5)),
                1..60,
            ),
        ) {
            let mut incoming = Incoming::new(Map::default(), 0);
            let (mut at, mut last) = (0, 0);
            for (which, stamp, wait, turn, place) in all {
                at += wait * MS;
                let device = crate::transforms::NAMES[which].into();
                let matrix = UnitQuaternion::from_scaled_axis(Vector3::from(turn)).to_rotation_matrix();
                let row = |r: usize| [matrix[(r, 0)] as f32, matrix[(r, 1)] as f32, matrix[(r, 2)] as f32, place[r]];
                let content = Content::Transform([row(0), row(1), row(2)]);
                let unix_ns = if stamp % 3 == 0 { OFFSET + at - stamp % (600 * MS) } else { stamp % 5 };
                let message = Message { device, unix_ns, id: 0, metadata: Vec::new(), content };
                let mut sent = Vec::new();
                let taken = incoming.take(&message, 1_000 * MS + at, OFFSET, |f| sent.push(*f));
                prop_assert!(!matches!(taken, Taken::Refused(_)), "{taken:?}");
                for frame in sent {
                    prop_assert!(frame.validate().is_ok() && frame.instants.exposed > last);
                    last = frame.instants.exposed;
                }
            }
        }
    }
}
