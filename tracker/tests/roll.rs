//! A roll is not lost: however far and fast fingers turn a handle, and after markers were hidden.

use bytemuck::Zeroable;
use nalgebra::{Isometry3, Point3, Translation3, UnitQuaternion, Vector3};
use protocol::blobs::{BlobField, Colour};
use protocol::geometry::Validity;
use protocol::poses::{BODY_NAMES, BodyState, BodyStatus};
use rig::Rig;
use surgeon::script::minimum_jerk;
use tracker::{Reference, Tracker};

const FIELD_S: f64 = 0.02;

/// The instruments and the eye at rest but for a roll of `inst0`.
struct AcquisitionInput {
    rig: Rig,
    tip: Vector3<f64>,
    /// Between two cameras' exposures, s: 0 where they are genlocked.
    apart_s: f64,
}

impl AcquisitionInput {
    fn new(tip: [f64; 3]) -> Self {
        AcquisitionInput { rig: Rig::load_or_shipped(None).unwrap(), tip: tip.into(), apart_s: 0.0 }
    }

    fn pose(&self, body: usize, roll: f64) -> Isometry3<f64> {
        let Some(trocar) = self.rig.trocar(BODY_NAMES[body]) else { return Isometry3::identity() };
        let tip = if body == 0 { self.tip } else { Vector3::new(-3.0, 1.0, -4.0) };
        let axis = Vector3::from(trocar.p_eye) - tip;
        let upright = UnitQuaternion::rotation_between(&Vector3::z(), &axis).unwrap();
        let turn = UnitQuaternion::from_axis_angle(&Vector3::z_axis(), if body == 0 { roll } else { 0.5 });
        Isometry3::from_parts(Translation3::from(tip), upright * turn)
    }

    /// Field `number` of every camera, without noise.
    fn fields(
        &self,
        number: u64,
        roll: impl Fn(f64) -> f64,
        shown: impl Fn(f64, Colour) -> bool,
    ) -> Vec<BlobField> {
        let see = |(i, camera): (usize, &rig::camera::Camera)| {
            let t_s = number as f64 * FIELD_S + i as f64 * self.apart_s;
            let mut field = BlobField::zeroed();
            (field.camera, field.field, field.parity) = (camera.id, number, (number & 1) as u32);
            field.exposed_ns = 1_000_000_000 + (t_s * 1e9) as u64;
            for (body, name) in BODY_NAMES.iter().enumerate() {
                let pose = self.pose(body, roll(t_s));
                for marker in &self.rig.body(name).unwrap().markers {
                    let point = pose * Point3::from(Vector3::from(marker.p));
                    let blob = camera.blob_of_ball(&point, marker.r, marker.colour, field.parity);
                    if shown(t_s, marker.colour) {
                        field.push(blob.unwrap());
                    }
                }
            }
            field
        };
        self.rig.cameras().iter().enumerate().map(see).collect()
    }

    /// Tells every frame until `end_s`: its instant, s, what became of `inst0`, and how far its
    /// roll is off, rad.
    fn track(
        &self,
        end_s: f64,
        roll: impl Fn(f64) -> f64,
        shown: impl Fn(f64, Colour) -> bool,
        mut told: impl FnMut(f64, &BodyState, f64),
    ) {
        let mut tracker = Tracker::new(&self.rig);
        for number in 0..(end_s / FIELD_S) as u64 {
            let fields = self.fields(number, &roll, &shown);
            // The last exposure: the others are before it.
            let newest = fields.last().unwrap();
            let (camera, field, exposed_ns) = (newest.camera, newest.field, newest.exposed_ns);
            let frame = tracker.track(&fields, &Reference { camera, field, exposed_ns });
            let t_s = (exposed_ns - 1_000_000_000) as f64 * 1e-9;
            let truth = self.pose(0, roll(t_s));
            let found = frame.bodies[0].world_from_body.isometry();
            let off = (found.rotation * truth.rotation.inverse()).scaled_axis();
            told(t_s, &frame.bodies[0], off.dot(&(truth.rotation * Vector3::z())));
        }
    }
}

/// From rest to `by` within `took_s`, begun at half a second, as fingers turn a handle.
fn turned(by: f64, took_s: f64) -> impl Fn(f64) -> f64 {
    move |t_s| by * minimum_jerk((t_s - 0.5) / took_s)
}

const TIPS: [[f64; 3]; 4] = [[1.2, -0.9, -9.5], [-3.0, 2.0, -8.0], [2.5, 1.0, -4.0], [0.0, -3.0, -10.0]];
/// About the shaft, rad: an eighth, a quarter, and half of a round, and more than that.
const TURNS: [f64; 7] = [0.785, -0.785, 1.57, -1.57, 3.1, -3.1, 5.0];

/// Variance of the roll, rad².
fn roll_variance(state: &BodyState) -> f64 {
    let axis = state.world_from_body.isometry().rotation * Vector3::z();
    let cells = (0..6).flat_map(|r| (r..6).map(move |c| (r, c))).zip(state.covariance);
    let weight = |r: usize, c: usize| if r == c { 1.0 } else { 2.0 } * axis[r - 3] * axis[c - 3];
    cells.filter(|((r, _), _)| *r >= 3).map(|((r, c), cell)| weight(r, c) * cell).sum()
}

#[test]
fn a_handle_turned_fast_is_followed() {
    for (tip, by) in TIPS.iter().flat_map(|tip| TURNS.map(|by| (*tip, by))) {
        for took_s in [0.1, 0.2, 0.4, 1.5] {
            AcquisitionInput::new(tip).track(
                1.0 + took_s,
                turned(by, took_s),
                |_, _| true,
                |t_s, state, off| {
                    let case = format!("{by} rad in {took_s} s at {tip:?}, {t_s:.2} s");
                    assert!(off.abs() < 0.03, "{case}: {off} rad off");
                    assert_eq!(state.validity(), Validity::Measured, "{case}");
                    assert_eq!(state.status, BodyStatus::Tracked as u32, "{case}");
                },
            );
        }
    }
}

/// Free-running cameras see one after the other: none can be asked whether it agrees.
#[test]
fn it_is_found_again_by_free_running_cameras() {
    for (tip, by) in TIPS.iter().flat_map(|tip| TURNS.map(|by| (*tip, by))) {
        let scene = AcquisitionInput { apart_s: FIELD_S / 3.0, ..AcquisitionInput::new(tip) };
        scene.track(
            1.2,
            turned(by, 0.2),
            |_, _| true,
            |t_s, _, off| {
                let rests = !(0.5..=0.75).contains(&t_s);
                assert!(!rests || off.abs() < 0.03, "{by} rad at {tip:?}, {t_s:.2} s: {off} rad off");
            },
        );
    }
}

/// While the marker beside the shaft is hidden from all cameras the roll is reported as doubtful as it
/// is; it is found again in the first frame.
#[test]
fn a_hidden_roll_is_told_as_doubtful_and_found_at_once() {
    for (tip, by) in TIPS.iter().flat_map(|tip| TURNS.map(|by| (*tip, by))) {
        let hidden = |t_s: f64| (0.45..1.95).contains(&t_s);
        let shown = |t_s: f64, colour: Colour| colour != Colour::Yellow || !hidden(t_s);
        AcquisitionInput::new(tip).track(2.5, turned(by, 1.0), shown, |t_s, state, off| {
            let case = format!("{by} rad at {tip:?}, {t_s:.2} s: {off} rad off");
            if !hidden(t_s) {
                assert!(off.abs() < 0.03, "{case}");
                assert_eq!(state.status, BodyStatus::Tracked as u32, "{case}");
                return;
            }
            assert_eq!(state.status, BodyStatus::TooFewMarkers as u32, "{case}");
            let sigma = roll_variance(state).sqrt();
            assert!(off.abs() < 0.03 + 4.0 * sigma, "{case}, {sigma} rad of doubt");
            if t_s > 1.5 {
                assert_eq!(state.validity(), Validity::Predicted, "{case}, {sigma} rad of doubt");
            }
        });
    }
}
