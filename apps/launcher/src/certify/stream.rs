//! What the cameras of a rig see while a latency is certified: every marker of both instruments and of the eye, in
//! every field, first at rest and then in a motion that repeats. Pure; where everything is is known.

use nalgebra::{Isometry3, Point3, Rotation3, Translation3, UnitQuaternion, Vector3};
use protocol::blobs::{BlobField, WHOLE_FRAME};
use protocol::geometry::shaft_pose;
use protocol::limits::{BODIES, INSTRUMENTS};
use protocol::poses::BODY_NAMES;
use protocol::random::Random;
use protocol::time::Nanos;
use rig::camera::Camera;
use rig::sensor::Sensor;
use rig::{MarkerKind, Rig, RigMarker};
use std::f64::consts::{FRAC_PI_4, TAU};

/// After so long the motion repeats, s.
pub const ROUND_S: f64 = 10.0;
/// Noise of a blob's centre, px of the frame; the variance that blobs state.
pub const NOISE_PX: f64 = 0.05;
/// Seed of the noise.
const SEED: u64 = 3124;

/// Waves of a tip, each axis: how often in a round, and amplitude in mm; the last two are tremor.
const TIP_WAVES: [[(f64, f64); 4]; 3] = [
    [(1.0, 1.4), (4.0, 0.5), (97.0, 0.03), (103.0, 0.02)],
    [(2.0, 1.2), (3.0, 0.6), (91.0, 0.03), (107.0, 0.02)],
    [(1.0, 0.8), (3.0, 0.5), (95.0, 0.03), (109.0, 0.02)],
];
/// The same of the eye's turn, rad.
const EYE_WAVES: [(f64, f64); 3] = [(1.0, 0.06), (2.0, 0.05), (1.0, 0.03)];
/// The same of an instrument's turn about its shaft, rad.
const ROLL_WAVE: (f64, f64) = (2.0, 0.35);
/// Where tips rest, mm in the eye frame, for the instrument at positive x.
const TIP_MM: [f64; 3] = [1.2, 0.4, -4.5];

/// A wave that begins with no speed.
fn wave((times, amplitude): (f64, f64), t_s: f64) -> f64 {
    amplitude * (1.0 - (TAU * times * t_s / ROUND_S).cos())
}

/// The fields of all cameras, and where the bodies are.
#[derive(Debug, Clone)]
pub struct Triples {
    cameras: Vec<(Camera, Sensor)>,
    bodies: [Vec<RigMarker>; BODIES],
    trocars: [Vector3<f64>; INSTRUMENTS],
    period_ns: u64,
    read_out_ns: u64,
    rest: u64,
}

impl Triples {
    /// For a checked rig; the first `rest` triples are at rest.
    pub fn of(rig: &Rig, rest: u64) -> Self {
        let cameras = rig.cameras().into_iter().zip(rig.sensors()).collect::<Vec<_>>();
        let markers = |i: usize| rig.body(BODY_NAMES[i]).map_or_else(Vec::new, |b| b.markers.clone());
        let trocar = |i: usize| {
            let side = if i == 0 { 1.0 } else { -1.0 };
            rig.trocar(BODY_NAMES[i]).map_or([8.0 * side, 4.5, 7.9], |t| t.p_eye).into()
        };
        Triples {
            read_out_ns: cameras.iter().map(|(_, sensor)| sensor.read_out_ns()).max().unwrap_or(0),
            cameras,
            bodies: std::array::from_fn(markers),
            trocars: std::array::from_fn(trocar),
            period_ns: rig.field_period_ns(),
            rest,
        }
    }

    /// Cameras of the rig.
    pub fn cameras(&self) -> usize {
        self.cameras.len()
    }

    /// Markers of all bodies.
    pub fn markers(&self) -> usize {
        self.bodies.iter().map(Vec::len).sum()
    }

    /// From the middle of the exposure until the last line has left the slowest camera, ns.
    pub fn read_out_ns(&self) -> u64 {
        self.read_out_ns
    }

    /// From one triple to the next, ns.
    pub fn period_ns(&self) -> u64 {
        self.period_ns
    }

    /// Whether a triple is one of those at rest.
    pub fn is_at_rest(&self, number: u64) -> bool {
        number < self.rest
    }

    /// `world_from_body` in the middle of the exposure of a triple.
    pub fn placed(&self, number: u64) -> [Isometry3<f64>; BODIES] {
        self.placed_after(number, 0.0)
    }

    fn placed_after(&self, number: u64, delay_ns: f64) -> [Isometry3<f64>; BODIES] {
        if self.is_at_rest(number) {
            return self.placed_at(0.0);
        }
        let round = (ROUND_S * 1e9) as u64;
        let since_ns = ((number - self.rest) * self.period_ns) % round;
        self.placed_at(((since_ns as f64 + delay_ns) * 1e-9).max(0.0))
    }

    fn placed_at(&self, t_s: f64) -> [Isometry3<f64>; BODIES] {
        let turn = Vector3::from_fn(|axis, _| wave(EYE_WAVES[axis], t_s));
        let eye = UnitQuaternion::from_rotation_matrix(&Rotation3::new(turn));
        let world_from_eye = Isometry3::from_parts(Translation3::identity(), eye);
        std::array::from_fn(|body| {
            let Some(trocar) = self.trocars.get(body) else { return world_from_eye };
            let side = trocar.x.signum();
            let mut tip =
                Vector3::from_fn(|axis, _| TIP_WAVES[axis].iter().map(|w| wave(*w, t_s)).sum::<f64>());
            tip += Vector3::from(TIP_MM);
            tip.x *= side;
            world_from_eye * shaft_pose(&tip, trocar, side * wave(ROLL_WAVE, t_s))
        })
    }

    /// Fills in what every camera sees of triple `number`, exposed at `exposed_ns`. When the blobs were sent is left
    /// to be stamped. `fields` has a place for each camera.
    pub fn draw(&self, number: u64, exposed_ns: Nanos, fields: &mut [BlobField]) {
        let placed = self.placed(number);
        for ((camera, sensor), field) in self.cameras.iter().zip(fields) {
            (field.field, field.camera, field.parity) = (number, camera.id, sensor.parity(number, 0));
            (field.exposed_ns, field.count, field.blobs_left_out) = (exposed_ns, 0, 0);
            field.read_out_ns = exposed_ns + sensor.read_out_ns();
            let mut random = Random::new(SEED, number.wrapping_mul(64).wrapping_add(u64::from(camera.id)));
            for (body, markers) in self.bodies.iter().enumerate() {
                for marker in markers {
                    let seen = |pose: &Isometry3<f64>| camera.project(&visible(camera, pose, marker));
                    let Some(first) = seen(&placed[body]) else { continue };
                    // A rolling shutter sees each line at an instant of its own.
                    let delay_ns = sensor.row_delay_ns(first.y);
                    let pose = match delay_ns == 0.0 {
                        true => placed[body],
                        false => self.placed_after(number, delay_ns)[body],
                    };
                    see(camera, &pose, marker, field, &mut random);
                }
            }
        }
    }
}

/// What of a marker is in the picture, in the world: the middle of a ball, or of a painted band's visible half.
fn visible(camera: &Camera, pose: &Isometry3<f64>, marker: &RigMarker) -> Point3<f64> {
    let on_axis = pose * Point3::from(marker.p);
    if marker.kind == MarkerKind::Sphere {
        return on_axis;
    }
    let shaft = pose.rotation * Vector3::z();
    let to_camera = camera.centre_in_world() - on_axis;
    let across = to_camera - shaft * shaft.dot(&to_camera);
    on_axis + across.try_normalize(1e-9).unwrap_or_default() * (FRAC_PI_4 * marker.r)
}

/// Adds the blob of a marker, with noise, where its centre is in the picture.
fn see(
    camera: &Camera,
    pose: &Isometry3<f64>,
    marker: &RigMarker,
    field: &mut BlobField,
    random: &mut Random,
) {
    let centre = visible(camera, pose, marker);
    let Some(mut blob) = camera.blob_of_ball(&centre, marker.r, marker.colour, field.parity) else { return };
    blob.x_px += NOISE_PX * random.normal();
    let squeeze = if field.parity == WHOLE_FRAME { 1.0 } else { 0.5 };
    blob.y_field_px += squeeze * NOISE_PX * random.normal();
    let [width, height] = camera.size_px.map(|n| f64::from(n) - 1.0);
    if (0.0..=width).contains(&blob.x_px) && (0.0..=squeeze * height).contains(&blob.y_field_px) {
        field.push(blob);
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use bytemuck::Zeroable;
    use protocol::message::Message;

    fn fields(triples: &Triples, number: u64) -> Vec<BlobField> {
        let mut fields = vec![BlobField::zeroed(); triples.cameras()];
        triples.draw(number, 1_000_000_000, &mut fields);
        fields
    }

    #[test]
    fn every_camera_sees_every_marker_at_rest_and_all_through_a_round() {
        for text in [super::super::RIG, include_str!("../../../../assets/rig.json")] {
            let rig = Rig::parse(text, "a rig").unwrap();
            let triples = Triples::of(&rig, 5);
            let round = ROUND_S as u64 * 1_000_000_000 / triples.period_ns();
            for number in (0..round).step_by(7) {
                for field in fields(&triples, number) {
                    assert_eq!(field.blobs().len(), triples.markers(), "triple {number}");
                    field.validate().unwrap();
                }
            }
        }
    }

    #[test]
    fn it_rests_then_moves_and_repeats() {
        let rig = Rig::parse(super::super::RIG, "a rig").unwrap();
        let triples = Triples::of(&rig, 5);
        assert_eq!(triples.placed(0), triples.placed(4));
        assert!(
            (triples.placed(305)[0].translation.vector - triples.placed(0)[0].translation.vector).norm()
                > 0.3
        );
        assert_eq!(triples.placed(305), triples.placed(305 + 2_000));
        let [a, b] = [3, 4].map(|number| fields(&triples, number)[0].blobs[0].x_px);
        assert!(a != b && (a - b).abs() < 8.0 * NOISE_PX, "noise of its own: {a} {b}");
    }
}
