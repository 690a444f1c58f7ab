//! Synthetic blobs of a rig's cameras: every marker of both instruments and of the eye in every field, first
//! at rest, then in a periodic motion. The true poses are known. Pure.
//!
//! A triple is the input of one tracker frame: one field of each camera that has one within the period of the
//! fastest camera that ends at the triple's instant. The fastest camera has a field in every triple, slower
//! ones in some.

use bytemuck::Zeroable;
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

/// Period of the motion, s.
pub const ROUND_S: f64 = 10.0;
/// Standard deviation of a blob's centre, px of the whole frame; blobs state its square as variance.
pub const NOISE_PX: f64 = 0.05;
/// Tolerance of genlock, ns: a field belongs to a triple if it is exposed no later than this after the
/// triple's instant, as in the tracker's assembler.
const GENLOCK_NS: u64 = 500_000;
/// Seed of the noise.
const SEED: u64 = 3124;

/// Motion of a tip, as waves per axis: periods per round, and amplitude in mm. The last two of each axis are
/// tremor.
const TIP_WAVES: [[(f64, f64); 4]; 3] = [
    [(1.0, 1.4), (4.0, 0.5), (97.0, 0.03), (103.0, 0.02)],
    [(2.0, 1.2), (3.0, 0.6), (91.0, 0.03), (107.0, 0.02)],
    [(1.0, 0.8), (3.0, 0.5), (95.0, 0.03), (109.0, 0.02)],
];
/// Rotation of the eye about each axis: periods per round, and amplitude in rad.
const EYE_WAVES: [(f64, f64); 3] = [(1.0, 0.06), (2.0, 0.05), (1.0, 0.03)];
/// Rotation of an instrument about its shaft: periods per round, and amplitude in rad.
const ROLL_WAVE: (f64, f64) = (2.0, 0.35);
/// Rest position of the tip of the instrument at positive x, mm in the eye frame.
const TIP_MM: [f64; 3] = [1.2, 0.4, -4.5];

/// Sine of `times` periods per round with zero initial value and zero initial velocity, at time `t_s`, s.
fn wave((times, amplitude): (f64, f64), t_s: f64) -> f64 {
    amplitude * (1.0 - (TAU * times * t_s / ROUND_S).cos())
}

/// Generates the fields of all cameras from known poses.
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
    /// Generator for a checked rig; the first `rest` triples are at rest.
    pub fn of(rig: &Rig, rest: u64) -> Self {
        let mut cameras = rig.cameras().into_iter().zip(rig.sensors()).collect::<Vec<_>>();
        // The field of the fastest camera completes a frame in the tracker, so it must be sent last.
        cameras.sort_by_key(|(_, sensor)| std::cmp::Reverse(sensor.period_ns));
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

    /// Number of cameras.
    pub fn cameras(&self) -> usize {
        self.cameras.len()
    }

    /// Field rates of the cameras, ascending, Hz.
    pub fn rates_hz(&self) -> Vec<f64> {
        self.cameras.iter().map(|(_, sensor)| 1e9 / sensor.period_ns as f64).collect()
    }

    /// Number of the field of camera `id` in a triple; `None` if it has none.
    pub fn field_of(&self, id: u32, number: u64) -> Option<u64> {
        self.cameras.iter().find(|(camera, _)| camera.id == id).and_then(|(_, s)| self.field_in(s, number))
    }

    /// Number of fields in a triple.
    pub fn fields_in(&self, number: u64) -> usize {
        self.cameras.iter().filter(|(_, sensor)| self.field_in(sensor, number).is_some()).count()
    }

    /// Number of the sensor's last field up to the triple's instant, unless that field belongs to an earlier
    /// triple.
    fn field_in(&self, sensor: &Sensor, number: u64) -> Option<u64> {
        let end_ns = number * self.period_ns + GENLOCK_NS;
        let field = end_ns / sensor.period_ns;
        (field * sensor.period_ns + self.period_ns > end_ns).then_some(field)
    }

    /// Number of markers of all bodies.
    pub fn markers(&self) -> usize {
        self.bodies.iter().map(Vec::len).sum()
    }

    /// Longest time from mid-exposure to the end of the read-out among the cameras, ns.
    pub fn read_out_ns(&self) -> u64 {
        self.read_out_ns
    }

    /// Period of the triples, ns.
    pub fn period_ns(&self) -> u64 {
        self.period_ns
    }

    /// True if the bodies are at rest in the triple.
    pub fn is_at_rest(&self, number: u64) -> bool {
        number < self.rest
    }

    /// `world_from_body` of each body at the instant of a triple, mm.
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

    /// Computes the fields of triple `number`, whose instant is `exposed_ns`, into `fields`, in the order in
    /// which they must be sent. `blobs_out_ns` is left for the sender.
    pub fn draw(&self, number: u64, exposed_ns: Nanos, fields: &mut Vec<BlobField>) {
        fields.clear();
        for (camera, sensor) in &self.cameras {
            let Some(own) = self.field_in(sensor, number) else { continue };
            // Exposure relative to the triple's instant: usually 0 or negative, at most the tolerance of genlock.
            let offset_ns = (own * sensor.period_ns) as i64 - (number * self.period_ns) as i64;
            let mut field = BlobField::zeroed();
            (field.field, field.camera, field.parity) = (own, camera.id, sensor.parity(own, 0));
            field.exposed_ns = exposed_ns.saturating_add_signed(offset_ns);
            field.read_out_ns = field.exposed_ns + sensor.read_out_ns();
            self.see_all(number, offset_ns as f64, (camera, sensor), &mut field);
            fields.push(field);
        }
    }

    /// Adds the blobs of all markers to a field that is exposed `offset_ns` after the instant of triple
    /// `number`.
    fn see_all(
        &self,
        number: u64,
        offset_ns: f64,
        (camera, sensor): (&Camera, &Sensor),
        field: &mut BlobField,
    ) {
        let placed = self.placed_after(number, offset_ns);
        let mut random = Random::new(SEED, number.wrapping_mul(64).wrapping_add(u64::from(camera.id)));
        for (body, markers) in self.bodies.iter().enumerate() {
            for marker in markers {
                let seen = |pose: &Isometry3<f64>| camera.project(&visible(camera, pose, marker));
                let Some(first) = seen(&placed[body]) else { continue };
                // A rolling shutter exposes each row at a different time.
                let delay_ns = sensor.row_delay_ns(first.y);
                let pose = match delay_ns == 0.0 {
                    true => placed[body],
                    false => self.placed_after(number, offset_ns + delay_ns)[body],
                };
                see(camera, &pose, marker, field, &mut random);
            }
        }
    }
}

/// Centre of the visible part of a marker in the world, mm: the centre of a ball, or the middle of the
/// visible half of a painted band.
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

/// Adds the blob of a marker, with noise, if its centre is within the picture.
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
    use protocol::message::Message;

    fn fields(triples: &Triples, number: u64) -> Vec<BlobField> {
        let mut fields = Vec::new();
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

    #[test]
    fn every_camera_has_fields_at_its_own_rate_and_sees_each_where_things_are_at_its_exposure() {
        let mut rig = Rig::parse(super::super::RIG, "a rig").unwrap();
        // One camera has a field in every fourth triple; the fields of another are exposed between two
        // instants of triples.
        (rig.cameras[0].field_hz, rig.cameras[1].field_hz) = (Some(50.0), Some(80.0));
        let rig = Rig::parse(&rig.to_json(), "three rates").unwrap();
        let (triples, period_ns) = (Triples::of(&rig, 4), rig.field_period_ns());
        assert_eq!(triples.rates_hz(), [50.0, 80.0, 200.0]);
        let (mut sent, mut fields, begin_ns) = ([0; 3], Vec::new(), 1_000_000_000);
        for number in 0..400 {
            let instant_ns = begin_ns + number * period_ns;
            triples.draw(number, instant_ns, &mut fields);
            assert_eq!(fields.len(), triples.fields_in(number), "triple {number}");
            assert_eq!(
                fields.last().map(|field| field.camera),
                Some(rig.cameras[2].id),
                "the fastest is last"
            );
            for field in &fields {
                let camera = rig.cameras.iter().position(|c| c.id == field.camera).unwrap();
                let sensor = rig.sensors()[camera];
                assert_eq!(field.field, sent[camera], "no field is left out or sent twice");
                assert_eq!(triples.field_of(field.camera, number), Some(field.field));
                assert_eq!(field.exposed_ns, begin_ns + field.field * sensor.period_ns);
                let before_ns = instant_ns - field.exposed_ns;
                assert!(before_ns < period_ns, "in the triple's period: {before_ns} ns before its end");
                assert_eq!(field.blobs().len(), triples.markers());
                sent[camera] += 1;
            }
        }
        assert_eq!(sent, [100, 160, 400]);
        // In motion, a field exposed between two instants shows the pose of neither.
        let between =
            (100..200).find(|n| triples.field_of(rig.cameras[1].id, *n).is_some_and(|k| k % 2 == 1));
        let number = between.unwrap();
        let places = [-2.5e6, 0.0].map(|ns| triples.placed_after(number, ns)[0].translation.vector);
        assert!((places[0] - places[1]).norm() > 1e-3, "{places:?}");
        triples.draw(number, begin_ns, &mut fields);
        let field = fields.iter().find(|field| field.camera == rig.cameras[1].id).unwrap();
        assert_eq!(begin_ns - field.exposed_ns, 2_500_000);
    }
}
