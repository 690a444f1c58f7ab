//! A frame of the tracker as messages of OpenIGTLink. Pure.
//!
//! Six transforms of a frame, in mm, named `SourceToTarget` as 3D Slicer and PLUS name them: the instruments
//! and the eye in the world, the instruments in the eye, and the world in the eye. The origin of an instrument
//! is its tip, that of world and eye the eye's centre of rotation (`docs/conventions.md`).

use crate::incoming::STATUS_KEYS;
use igtl::{Content, HeaderVersion, Message, STATUS_NOT_PRESENT, STATUS_OK, TooLong};
use nalgebra::Isometry3;
use protocol::geometry::Validity;
use protocol::poses::{BodyState, BodyStatus, EYE, TrackerFrame};
use std::fmt::Write;

/// Transforms of a frame.
pub const TRANSFORMS: usize = 6;
/// Their names.
pub const NAMES: [&str; TRANSFORMS] = [
    "Instrument0ToWorld",
    "Instrument1ToWorld",
    "EyeToWorld",
    "Instrument0ToEye",
    "Instrument1ToEye",
    "WorldToEye",
];
/// Metadata of a transform: its status by both keys, the number of its field and the tracker's words for it.
const KEYS: [&str; 4] = [STATUS_KEYS[0], STATUS_KEYS[1], "Frame", "Tracking"];
/// Place of the field's number in [`KEYS`].
const FRAME: usize = 2;
/// Without metadata a status is sent when it changes and at least so often, ns.
const STATUS_EVERY_NS: u64 = 1_000_000_000;

/// What is known of a transform, in the words of PLUS, which takes a missing one for `OK`.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
enum ToolStatus {
    Ok,
    /// Its markers are seen by too few cameras.
    OutOfView,
    /// It is lost, or where it is predicted to be.
    Missing,
}

impl ToolStatus {
    fn of(body: &BodyState) -> Self {
        let few = BodyStatus::from_wire(body.status) == Some(BodyStatus::TooFewMarkers);
        match body.validity() {
            Validity::Measured => ToolStatus::Ok,
            Validity::Predicted | Validity::Lost if few => ToolStatus::OutOfView,
            Validity::Predicted | Validity::Lost => ToolStatus::Missing,
        }
    }

    fn word(self) -> &'static str {
        match self {
            ToolStatus::Ok => "OK",
            ToolStatus::OutOfView => "OUT_OF_VIEW",
            ToolStatus::Missing => "MISSING",
        }
    }
}

/// Turns frames into messages.
#[derive(Debug)]
pub struct Writer {
    version: HeaderVersion,
    id: u32,
    /// The messages of the last frame, whose texts are written over.
    messages: [Message; TRANSFORMS],
    /// What was last said of each transform, and when, where there is no metadata.
    last_status: [Option<(ToolStatus, u64)>; TRANSFORMS],
}

impl Writer {
    /// For a version of the protocol, 1 to 3.
    pub fn new(protocol: u8) -> Self {
        let version = if protocol >= 3 { HeaderVersion::Two } else { HeaderVersion::One };
        Writer { version, id: 0, messages: NAMES.map(empty), last_status: [None; TRANSFORMS] }
    }

    /// Appends the messages of a frame. `offset_ns` is what is added to its instants to get the time since 1970.
    ///
    /// # Errors
    /// None with the names of [`NAMES`], which are as short as the protocol asks.
    pub fn frame(&mut self, frame: &TrackerFrame, offset_ns: u64, to: &mut Vec<u8>) -> Result<(), TooLong> {
        let [first, second, eye] = frame.bodies.map(|body| body.world_from_body.isometry());
        let eye_from_world = eye.inverse();
        let transforms =
            [first, second, eye, eye_from_world * first, eye_from_world * second, eye_from_world];
        let [of_first, of_second, of_eye] = frame.bodies.map(|body| ToolStatus::of(&body));
        // Transforms of an instrument in the eye are valid only where both are tracked.
        let both = |instrument| if of_eye == ToolStatus::Ok { instrument } else { of_eye };
        let states = [of_first, of_second, of_eye, both(of_first), both(of_second), of_eye];
        let bodies = [Some(0), Some(1), Some(EYE), None, None, None];
        let unix_ns = frame.instants.exposed.wrapping_add(offset_ns);
        for i in 0..TRANSFORMS {
            self.id = self.id.wrapping_add(1);
            let message = &mut self.messages[i];
            (message.unix_ns, message.id) = (unix_ns, self.id);
            message.content = Content::Transform(rows(&transforms[i]));
            let tracking = bodies[i].map_or("", |body| status_text(&frame.bodies[body]));
            for ((_, text), value) in
                message.metadata.iter_mut().zip([states[i].word(), states[i].word(), "", tracking])
            {
                text.clear();
                text.push_str(value);
            }
            // Texts have room for it.
            let _ = write!(message.metadata[FRAME].1, "{}", frame.field);
            message.write(self.version, to)?;
            if self.version == HeaderVersion::One {
                self.tell(i, states[i], unix_ns, to)?;
            }
        }
        Ok(())
    }

    /// Appends the messages for an input that has stopped: every transform is missing.
    ///
    /// # Errors
    /// None with the names of [`NAMES`].
    pub fn ended(&mut self, unix_ns: u64, to: &mut Vec<u8>) -> Result<(), TooLong> {
        for name in NAMES {
            self.id = self.id.wrapping_add(1);
            status(name, ToolStatus::Missing, "no simulator runs", unix_ns, self.id)
                .write(self.version, to)?;
        }
        self.last_status = [None; TRANSFORMS];
        Ok(())
    }

    /// Adds a status where it is due.
    fn tell(&mut self, i: usize, state: ToolStatus, unix_ns: u64, to: &mut Vec<u8>) -> Result<(), TooLong> {
        let is_due =
            |(last, at): (ToolStatus, u64)| last != state || unix_ns.saturating_sub(at) >= STATUS_EVERY_NS;
        if self.last_status[i].is_none_or(is_due) {
            self.last_status[i] = Some((state, unix_ns));
            status(NAMES[i], state, state.word(), unix_ns, self.id).write(self.version, to)?;
        }
        Ok(())
    }
}

fn status(name: &str, state: ToolStatus, text: &str, unix_ns: u64, id: u32) -> Message {
    let code = if state == ToolStatus::Ok { STATUS_OK } else { STATUS_NOT_PRESENT };
    let content = Content::Status { code, subcode: 0, name: state.word().into(), text: text.into() };
    Message { device: name.into(), unix_ns, id, metadata: Vec::new(), content }
}

/// A transform's message before its first frame.
fn empty(name: &str) -> Message {
    let of_body = NAMES[..=EYE].contains(&name);
    let keys = KEYS.into_iter().take(if of_body { KEYS.len() } else { KEYS.len() - 1 });
    let metadata = keys.map(|key| (key.into(), String::new())).collect();
    Message { device: name.into(), unix_ns: 0, id: 0, metadata, content: Content::Transform([[0.0; 4]; 3]) }
}

fn status_text(body: &BodyState) -> &'static str {
    BodyStatus::from_wire(body.status).map_or("unknown", BodyStatus::text)
}

fn rows(target_from_source: &Isometry3<f64>) -> [[f32; 4]; 3] {
    let matrix = target_from_source.to_homogeneous();
    std::array::from_fn(|row| std::array::from_fn(|column| matrix[(row, column)] as f32))
}

#[cfg(test)]
mod tests {
    use super::*;
    use bytemuck::Zeroable;
    use igtl::Reader;
    use nalgebra::{UnitQuaternion, Vector3};
    use protocol::geometry::Pose;

    fn frame() -> TrackerFrame {
        let mut frame = TrackerFrame::zeroed();
        (frame.field, frame.instants.exposed) = (42, 5_000_000_000);
        for (i, body) in frame.bodies.iter_mut().enumerate() {
            let turn = UnitQuaternion::from_scaled_axis(Vector3::new(0.1, -0.2, 0.3) * (i + 1) as f64);
            let place =
                if i == EYE { Vector3::zeros() } else { Vector3::new(1.0, 2.0, -3.0 * (i + 1) as f64) };
            body.world_from_body = Pose::from_isometry(&Isometry3::from_parts(place.into(), turn));
            body.validity = Validity::Measured as u32;
        }
        frame
    }

    /// The bytes of a frame.
    fn written(writer: &mut Writer, frame: &TrackerFrame, offset_ns: u64) -> Vec<u8> {
        let mut bytes = Vec::new();
        writer.frame(frame, offset_ns, &mut bytes).unwrap();
        bytes
    }

    fn read(bytes: &[u8]) -> Vec<Message> {
        let mut messages = Vec::new();
        Reader::default().take(bytes, |message| messages.push(message.unwrap())).unwrap();
        messages
    }

    /// The status by the key of PLUS, which is that of the other key.
    fn status_of(message: &Message) -> &str {
        let of = |name: &str| &*message.metadata.iter().find(|(key, _)| key == name).unwrap().1;
        assert_eq!(of("TransformStatus"), of("Status"));
        of("TransformStatus")
    }

    /// Point `p` by a transform.
    fn moved(message: &Message, p: Vector3<f64>) -> Vector3<f64> {
        let Content::Transform(rows) = &message.content else { panic!("a transform") };
        let row = |r: &[f32; 4]| f64::from(r[0]) * p.x + f64::from(r[1]) * p.y + f64::from(r[2]) * p.z;
        Vector3::from(rows.map(|r| row(&r) + f64::from(r[3])))
    }

    #[test]
    fn six_transforms_lead_from_each_frame_to_the_other() {
        let frame = frame();
        let messages = read(&written(&mut Writer::new(3), &frame, 1_000));
        assert_eq!(messages.iter().map(|m| &*m.device).collect::<Vec<_>>(), NAMES);
        assert!(messages.iter().all(|m| m.unix_ns == 5_000_001_000 && status_of(m) == "OK"));
        let p = Vector3::new(0.3, -0.7, 12.0);
        for i in [0, 1, EYE] {
            let expected = Vector3::from(frame.bodies[i].world_from_body.transform(p.into()));
            assert!((moved(&messages[i], p) - expected).norm() < 1e-5, "{}", NAMES[i]);
        }
        for i in [0, 1] {
            let around = moved(&messages[2], moved(&messages[3 + i], p));
            assert!((around - moved(&messages[i], p)).norm() < 1e-5, "through the eye");
        }
        assert!((moved(&messages[5], moved(&messages[2], p)) - p).norm() < 1e-5, "there and back");
    }

    #[test]
    fn a_body_that_is_not_measured_is_never_told_to_be() {
        let mut frame = frame();
        frame.bodies[0].validity = Validity::Predicted as u32;
        frame.bodies[EYE].validity = Validity::Lost as u32;
        frame.bodies[EYE].status = BodyStatus::TooFewMarkers as u32;
        let messages = read(&written(&mut Writer::new(3), &frame, 0));
        let states: Vec<&str> = messages.iter().map(status_of).collect();
        let out = "OUT_OF_VIEW";
        assert_eq!(states, ["MISSING", "OK", out, out, out, out]);
    }

    #[test]
    fn without_metadata_a_status_stands_beside_the_transforms() {
        let (mut writer, mut frame) = (Writer::new(2), frame());
        let statuses = |bytes: Vec<u8>| -> Vec<(String, u16)> {
            let code = |m: Message| match m.content {
                Content::Status { code, .. } => Some((m.device, code)),
                Content::Transform(_) => None,
            };
            read(&bytes).into_iter().filter_map(code).collect()
        };
        assert_eq!(statuses(written(&mut writer, &frame, 0)).len(), TRANSFORMS, "at first");
        frame.instants.exposed += 20_000_000;
        assert_eq!(statuses(written(&mut writer, &frame, 0)), []);
        frame.bodies[1].validity = Validity::Lost as u32;
        frame.instants.exposed += 20_000_000;
        let gone = |name: &str| (name.to_owned(), STATUS_NOT_PRESENT);
        let changed = statuses(written(&mut writer, &frame, 0));
        assert_eq!(changed, [gone("Instrument1ToWorld"), gone("Instrument1ToEye")]);
        frame.instants.exposed += STATUS_EVERY_NS;
        assert_eq!(statuses(written(&mut writer, &frame, 0)).len(), TRANSFORMS, "once a second");
        let mut bytes = Vec::new();
        writer.ended(0, &mut bytes).unwrap();
        assert_eq!(statuses(bytes), NAMES.map(gone));
    }
}
