//! Resection of a camera: its pose from markers that the other cameras locate, by a Gauss–Newton iteration
//! over its newest fields, one step per field, with Cauchy weights and the calibrated pose as a weak prior.

use super::{moved, scaled_jacobian, sighting, solve};
use crate::associate::{AssociationInput, PredictedBody};
use crate::checkpoint::{Done, Loader, Saver};
use crate::constants as k;
use crate::lines::BodyInField;
use crate::observation::{FieldObservation, camera_of};
use crate::pose_math::{Matrix6, Vector6};
use crate::projection::project_point;
use crate::tracker::{load_place, save_place};
use nalgebra::{Point3, Rotation3, Vector2, Vector3};
use protocol::limits::{BODIES, MAX_MARKERS};
use rig::camera::Camera;
use std::collections::VecDeque;

/// A marker's visible centre in the world, mm, and the blob of it, px.
type Sighting = (Point3<f64>, Vector2<f64>);

/// The resection of one camera.
#[derive(Debug, Clone)]
pub struct Resection {
    sightings: VecDeque<Sighting>,
    estimate: Option<Camera>,
    /// Fields taken, and those that are wanted.
    fields: u64,
    wanted: u64,
    /// Median offset of each of the newest fields from the estimate's images, px.
    offsets: VecDeque<Vector2<f64>>,
    overrun_noted: bool,
}

impl Default for Resection {
    fn default() -> Self {
        Resection {
            sightings: VecDeque::with_capacity(k::RESECTION_SIGHTINGS),
            estimate: None,
            fields: 0,
            wanted: 0,
            offsets: VecDeque::with_capacity(k::RESECTION_CHECKED),
            overrun_noted: false,
        }
    }
}

impl Resection {
    /// Starts again; `wanted` fields are needed.
    pub fn begin(&mut self, wanted: u64) {
        self.sightings.clear();
        self.offsets.clear();
        (self.estimate, self.fields, self.wanted, self.overrun_noted) = (None, 0, wanted, false);
    }

    /// Writes what was seen of the camera, and where it is estimated to stand.
    pub(super) fn save(&self, out: &mut Saver<'_>) -> Done {
        let Resection { sightings, estimate, fields, wanted, offsets, overrun_noted } = self;
        out.put(&(*fields, *wanted, overrun_noted, sightings.len() as u64, offsets.len() as u64))?;
        for (point, pixel) in sightings {
            out.numbers(point.coords.iter().chain(pixel))?;
        }
        out.numbers(offsets.iter().flatten())?;
        out.put(&estimate.is_some())?;
        estimate.as_ref().map_or(Ok(()), |camera| save_place(camera, out))
    }

    /// Takes over what was saved of a camera.
    pub(super) fn load(&mut self, calibrated: &Camera, from: &mut Loader<'_>) -> Done {
        (self.fields, self.wanted) = (from.count()?, from.count()?);
        self.overrun_noted = from.take()?;
        let sightings = from.below(k::RESECTION_SIGHTINGS as u64 + 1)?;
        let offsets = from.below(k::RESECTION_CHECKED as u64 + 1)?;
        self.sightings.clear();
        self.offsets.clear();
        for _ in 0..sightings {
            let (mut point, mut pixel) = (Point3::origin(), Vector2::zeros());
            from.numbers(point.coords.iter_mut().chain(&mut pixel))?;
            self.sightings.push_back((point, pixel));
        }
        for _ in 0..offsets {
            let mut offset = Vector2::zeros();
            from.numbers(&mut offset)?;
            self.offsets.push_back(offset);
        }
        self.estimate = None;
        if from.take()? {
            let mut estimate = calibrated.clone();
            load_place(&mut estimate, from)?;
            self.estimate = Some(estimate);
        }
        Ok(())
    }

    /// Adds a field of the camera, and improves the estimate by one step.
    pub fn add_field(
        &mut self,
        input: &AssociationInput<'_>,
        calibrated: &Camera,
        field: &FieldObservation,
        bodies: &[Option<PredictedBody>; BODIES],
    ) {
        let Some(last) = camera_of(input.rig, field) else { return };
        let camera = self.estimate.get_or_insert_with(|| last.clone()).clone();
        let known = self.offsets.len() == k::RESECTION_CHECKED;
        let reach = if known { k::RESECTION_REACH_PX } else { k::KNOCK_REACH_PX };
        let scale = input.area_scales[field.camera];
        let mut seen = [Vector2::zeros(); BODIES * MAX_MARKERS];
        let mut count = 0;
        for (body, placed) in bodies.iter().enumerate() {
            let Some(placed) = placed else { continue };
            let (rig, dt_s) = (input.rig, input.dt_s(field));
            let placed = BodyInField::new(rig, field.camera, &placed.pose, &placed.motion, dt_s);
            for s in sighting::of_body(rig, body, &placed, &camera, field, scale, reach) {
                push(&mut self.sightings, (s.image.point, s.image.pixel + s.offset), k::RESECTION_SIGHTINGS);
                seen[count] = s.offset;
                count += 1;
            }
        }
        if count >= k::KNOCK_JUMP_MARKERS {
            push(&mut self.offsets, median(&mut seen[..count]), k::RESECTION_CHECKED);
            self.fields += 1;
        }
        self.improve(&camera, calibrated);
    }

    fn improve(&mut self, camera: &Camera, calibrated: &Camera) {
        let mut information = Matrix6::zeros();
        let mut gradient = -between(calibrated, camera);
        for (point, seen) in &self.sightings {
            let Some(image) = project_point(point, camera) else { continue };
            let (r, a) = (seen - image.pixel, scaled_jacobian(camera, &image.jacobian, point));
            let scale = k::RESECTION_SCALE_PX;
            let weight = k::KNOCK_WEIGHT / (1.0 + r.norm_squared() / (scale * scale));
            information += a.transpose() * a * weight;
            gradient += a.transpose() * r * weight;
        }
        if let Some(delta) = solve(&information, &gradient) {
            self.estimate = Some(moved(camera, &delta));
        }
    }

    /// The camera after enough fields to be used where others are missing.
    pub fn provisional(&self) -> Option<Camera> {
        self.estimate.clone().filter(|_| self.fields >= k::RESECTION_PROVISIONAL_FIELDS)
    }

    /// The camera, once enough fields agree with it.
    pub fn accepted(&self) -> Option<Camera> {
        let enough = self.fields >= self.wanted && self.offsets.len() == k::RESECTION_CHECKED;
        let mean = self.offsets.iter().sum::<Vector2<f64>>() / self.offsets.len().max(1) as f64;
        let half = self.offsets.len() / 2;
        let part = |from: usize, to: usize| {
            self.offsets.range(from..to).sum::<Vector2<f64>>() / (to - from).max(1) as f64
        };
        let steady =
            half > 0 && (part(0, half) - part(half, self.offsets.len())).norm() < k::RESECTION_STEADY_PX;
        (enough && steady && mean.norm() < k::RESECTION_STEADY_PX).then(|| self.estimate.clone()).flatten()
    }

    /// True at the first call since the start.
    pub fn first_overrun(&mut self) -> bool {
        !std::mem::replace(&mut self.overrun_noted, true)
    }
}

/// The turn and shift that lead from one camera to another, in units of the prior.
fn between(from: &Camera, to: &Camera) -> Vector6 {
    let turn = Rotation3::from_matrix_unchecked(to.camera_from_world * from.camera_from_world.transpose());
    let shift = to.translation_mm - turn * from.translation_mm;
    let turn: Vector3<f64> = turn.scaled_axis() / k::KNOCK_TURN_RAD;
    let shift = shift / k::KNOCK_SHIFT_MM;
    Vector6::new(turn.x, turn.y, turn.z, shift.x, shift.y, shift.z)
}

/// Median of the offsets, by component.
fn median(seen: &mut [Vector2<f64>]) -> Vector2<f64> {
    let mut of = |axis: usize| {
        seen.sort_unstable_by(|a, b| a[axis].total_cmp(&b[axis]));
        seen[seen.len() / 2][axis]
    };
    Vector2::new(of(0), of(1))
}

/// Adds a value to a ring.
fn push<T>(ring: &mut VecDeque<T>, value: T, capacity: usize) {
    if ring.len() == capacity {
        ring.pop_front();
    }
    ring.push_back(value);
}
