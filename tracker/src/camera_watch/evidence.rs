//! Evidence that a camera was moved: the decrease of χ² of its newest fields if its pose alone were free,
//! with the poses of the bodies eliminated (as in [`crate::drift`]).

use super::{scaled_jacobian, sighting, solve};
use crate::associate::AssociationInput;
use crate::checkpoint::{Done, Loader, Saver};
use crate::constants as k;
use crate::drift::pose_prior;
use crate::fit::BlobMatch;
use crate::lines::BodyInField;
use crate::observation::camera_of;
use crate::pose_math::{Matrix6, Vector6, box_minus};
use crate::projection::pose_jacobian;
use nalgebra::{Isometry3, Vector3};
use protocol::limits::{BODIES, MAX_CAMERAS};
use protocol::poses::EYE;

/// Normal equations of a camera's pose from one body.
#[derive(Debug, Clone, Copy, Default)]
struct Share {
    information: Matrix6,
    gradient: Vector6,
}

/// Evidence about one camera; older fields are forgotten exponentially.
#[derive(Debug, Clone, Default)]
pub struct Evidence {
    bodies: [Share; BODIES],
    /// Sum of JᵀJ, and number of blobs: turns a change of the camera into pixels.
    spread: Matrix6,
    blobs: f64,
    fields: f64,
    at_ns: u64,
}

/// An update of a body, with its prior.
pub struct BodyUpdate<'a> {
    /// Which body.
    pub body: usize,
    /// The fitted pose; the predicted one where no blob was near it.
    pub pose: Isometry3<f64>,
    /// The predicted pose.
    pub prior: Isometry3<f64>,
    /// Its information.
    pub prior_information: Matrix6,
    /// Velocity and angular velocity.
    pub motion: [Vector3<f64>; 2],
    /// Its blobs.
    pub matches: &'a [BlobMatch],
}

/// Adds an update to the evidence of its cameras.
pub fn add(evidence: &mut [Evidence; MAX_CAMERAS], input: &AssociationInput<'_>, update: &BodyUpdate<'_>) {
    // With the eye's predicted rotation as a prior, a saccade would look like a moved camera.
    let mut of_pose = if update.body == EYE { pose_prior(EYE) } else { update.prior_information };
    let mut pull = of_pose * box_minus(&update.prior, &update.pose);
    let mut cameras: [Option<OfCamera>; MAX_CAMERAS] = [const { None }; MAX_CAMERAS];
    for field in input.fields() {
        let Some(camera) = camera_of(input.rig, field) else { continue };
        let dt_s = input.dt_s(field);
        let placed = BodyInField::new(input.rig, field.camera, &update.pose, &update.motion, dt_s);
        let scale = input.area_scales[field.camera];
        let own = cameras[field.camera].get_or_insert_default();
        // The association's gates hide what was moved: markers without a match are searched further away.
        let seen = sighting::of_matches(input.rig, update, &placed, camera, field, scale);
        for s in seen {
            let Some(inverse) = s.covariance.try_inverse() else { continue };
            let weight = inverse / (1.0 + s.offset.norm_squared() / (k::KNOCK_SLOW_PX * k::KNOCK_SLOW_PX));
            let pose = placed.pose_at(s.image.pixel.y);
            let (a, j) =
                (scaled_jacobian(camera, &s.image.jacobian, &s.image.point), pose_jacobian(&s.image, &pose));
            let (aw, jw) = (a.transpose() * weight, j.transpose() * weight);
            of_pose += jw * j;
            pull += jw * s.offset;
            own.own += aw * a;
            own.mixed += aw * j;
            own.right += aw * s.offset;
            own.spread += a.transpose() * a;
            own.blobs += 1.0;
        }
    }
    let Some(inverse) = of_pose.cholesky().map(|c| c.inverse()) else { return };
    for (camera, own) in cameras.iter().enumerate() {
        let Some(own) = own else { continue };
        evidence[camera].take(update.body, own, &inverse, &pull, input.time_ns);
    }
}

/// Normal equations of a camera in one update.
#[derive(Debug, Clone, Default)]
struct OfCamera {
    own: Matrix6,
    mixed: Matrix6,
    right: Vector6,
    spread: Matrix6,
    blobs: f64,
}

impl Evidence {
    fn take(&mut self, body: usize, own: &OfCamera, of_pose: &Matrix6, pull: &Vector6, time_ns: u64) {
        let since = time_ns.saturating_sub(self.at_ns) as f64;
        if since > 0.0 {
            let kept = libm::exp(-since / k::KNOCK_MEMORY_NS);
            self.bodies.iter_mut().for_each(|b| {
                b.information *= kept;
                b.gradient *= kept;
            });
            self.spread *= kept;
            self.blobs *= kept;
            self.fields = self.fields * kept + 1.0;
            self.at_ns = time_ns;
        }
        let eliminated = own.mixed * of_pose;
        let share = &mut self.bodies[body];
        share.information += own.own - eliminated * own.mixed.transpose();
        share.gradient += own.right - eliminated * pull;
        self.spread += own.spread;
        self.blobs += own.blobs;
        if !(self.gradient().norm() + self.spread.norm()).is_finite() {
            *self = Evidence::default();
        }
    }

    /// Writes the evidence.
    pub(super) fn save(&self, out: &mut Saver<'_>) -> Done {
        let Evidence { bodies, spread, blobs, fields, at_ns } = self;
        for Share { information, gradient } in bodies {
            out.square(6, |r, c| information[(r, c)])?;
            out.numbers(gradient)?;
        }
        out.square(6, |r, c| spread[(r, c)])?;
        out.numbers([blobs, fields])?;
        out.put(at_ns)
    }

    /// Takes over what was saved.
    pub(super) fn load(&mut self, from: &mut Loader<'_>) -> Done {
        let Evidence { bodies, spread, blobs, fields, at_ns } = self;
        for Share { information, gradient } in bodies {
            from.square(6, |r, c, number| information[(r, c)] = number)?;
            from.numbers(gradient)?;
        }
        from.square(6, |r, c, number| spread[(r, c)] = number)?;
        from.numbers([blobs, fields])?;
        *at_ns = from.count()?;
        Ok(())
    }

    fn estimate(&self) -> Option<Vector6> {
        let information = self.bodies.iter().fold(Matrix6::zeros(), |sum, b| sum + b.information);
        solve(&information, &self.gradient())
    }

    fn gradient(&self) -> Vector6 {
        self.bodies.iter().fold(Vector6::zeros(), |sum, b| sum + b.gradient)
    }

    /// Decrease of χ² if the camera stood elsewhere.
    pub fn gain(&self) -> f64 {
        self.estimate().map_or(0.0, |delta| self.gradient().dot(&delta))
    }

    /// True if enough fields came to judge, but none showed the eye.
    pub fn misses_eye(&self) -> bool {
        self.fields >= k::KNOCK_LEAST_FIELDS && self.bodies[EYE].information.trace() == 0.0
    }

    /// By how much the camera's picture moved, px, if it did.
    pub fn verdict(&self) -> Option<f64> {
        if self.fields < k::KNOCK_LEAST_FIELDS {
            return None;
        }
        let delta = self.estimate()?;
        let gain = self.gradient().dot(&delta);
        let px = libm::sqrt(delta.dot(&(self.spread * delta)).max(0.0) / self.blobs.max(1.0));
        let least = k::KNOCK_GAIN.max(k::KNOCK_GAIN_PER_BLOB * self.blobs);
        if gain < least || px < k::KNOCK_LEAST_PX {
            return None;
        }
        let mut agreeing = 0;
        for (body, share) in self.bodies.iter().enumerate().rev() {
            let expected = delta.dot(&(share.information * delta));
            // The decrease of this body's χ² alone.
            let gained = 2.0 * share.gradient.dot(&delta) - expected;
            let agrees = gained > 0.5 * expected;
            // A filter of an instrument may have followed the moved camera. The eye's centre is fixed.
            if body == EYE && agrees && gained > k::KNOCK_GAIN {
                return Some(px);
            }
            if expected > k::KNOCK_BODY_GAIN {
                if !agrees {
                    return None;
                }
                agreeing += 1;
            }
        }
        (agreeing >= 2).then_some(px)
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::adverse::{Adverse, STEPS, Seen};
    use nalgebra::{SMatrix, Vector2};
    use protocol::limits::FIELD_PERIOD_NS;
    use protocol::random::{nth, unit_interval};

    /// Jacobians of a marker; the same for every field, as those of a hand that holds still are.
    fn jacobian(of: u64, marker: u64) -> SMatrix<f64, 2, 6> {
        SMatrix::from_fn(|r, c| unit_interval(nth(of, marker * 12 + (r * 6 + c) as u64)) - 0.5)
    }

    /// What six markers at `offset`, px, add; one alone where little is seen.
    fn update(offset: Vector2<f64>, markers: u64) -> (OfCamera, Matrix6, Vector6) {
        let (mut own, mut of_pose, mut pull) = (OfCamera::default(), Matrix6::identity(), Vector6::zeros());
        for marker in 0..markers {
            let (a, j) = (jacobian(1, marker), jacobian(2, marker));
            of_pose += j.transpose() * j;
            pull += j.transpose() * offset;
            own.own += a.transpose() * a;
            own.mixed += a.transpose() * j;
            own.right += a.transpose() * offset;
            own.spread += a.transpose() * a;
            own.blobs += 1.0;
        }
        (own, of_pose.try_inverse().expect("it holds the identity"), pull)
    }

    #[test]
    fn many_blobs_off_by_less_than_their_deviation_show_no_moved_camera() {
        let mut seen = [0; 2];
        for tenths in 1..40 {
            let mut evidence = Evidence::default();
            let (own, of_pose, pull) = update(Vector2::new(0.1 * f64::from(tenths), 0.0), 6);
            for n in 1..100 {
                for body in [0, EYE] {
                    evidence.take(body, &own, &of_pose, &pull, n * FIELD_PERIOD_NS);
                }
            }
            let per_blob = evidence.gain() / evidence.blobs;
            if evidence.gain() > k::KNOCK_GAIN {
                let shown = per_blob > k::KNOCK_GAIN_PER_BLOB;
                assert_eq!(evidence.verdict().is_some(), shown, "{per_blob:.2} per blob");
                seen[usize::from(shown)] += 1;
            }
        }
        println!("compared {seen:?}");
        assert!(seen.iter().all(|n| *n >= 3), "{seen:?}");
    }

    #[test]
    fn evidence_stays_finite_symmetric_and_bounded_for_a_million_fields() {
        let mut checked = 0;
        for movement in Adverse::ALL {
            let mut evidence = Evidence::default();
            // Of everything seen at once, every field, forgotten as fast as constants say.
            let most = update(Vector2::zeros(), 6).0.own.trace()
                / (1.0 - libm::exp(-(FIELD_PERIOD_NS as f64) / k::KNOCK_MEMORY_NS));
            for n in 0..STEPS {
                let (position, seen) = movement.at(n);
                let markers = match seen {
                    Seen::Nothing => continue,
                    Seen::OneCamera => 1,
                    Seen::All => 6,
                };
                let (own, of_pose, pull) = update(position.xy() * 0.01, markers);
                let time_ns = n * FIELD_PERIOD_NS;
                evidence.take(n as usize % BODIES, &own, &of_pose, &pull, time_ns);
                if n % 1_000 != 0 {
                    continue;
                }
                let information = evidence.bodies.iter().fold(Matrix6::zeros(), |sum, b| sum + b.information);
                let asymmetry = (information - information.transpose()).norm();
                assert!(asymmetry <= 1e-9 * information.norm(), "{movement:?}, field {n}: {asymmetry}");
                assert!(information.trace() <= most, "{movement:?}, field {n}: {}", information.trace());
                assert!(evidence.gain().is_finite() && evidence.gain() >= 0.0, "{movement:?}, field {n}");
                checked += 1;
            }
        }
        println!("compared at {checked} of {} fields", 6 * STEPS);
        assert!(checked >= 600);
    }
}
