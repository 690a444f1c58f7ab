//! What a contact does to its parties: pushes them apart by their generalised inverse masses, and
//! takes back what would slide or roll, as far as friction holds it (Coulomb, on positions).

use super::contacts::{BATCH, Contact, Party};
use super::motion::turned;
use super::solve::{BodySolver, SolverParams, ToolMotion};
use super::state::BodyState;
use nalgebra::{Point3, Vector3};
use protocol::limits::INSTRUMENTS;

/// Lever of the resistance to rolling: how far before the middle of the contact the floor pushes
/// back, mm. A ball of 0.4 mm stays on slopes up to 14°, which is as far as 2.8 mm from the bottom
/// of an eye; soft tissue resists more than glass.
pub(super) const ROLLING_MM: f64 = 0.1;

/// Where the parties of a contact are at the begin of a round.
#[derive(Debug, Clone, Copy, Default)]
struct ContactPoints {
    /// The body's point, eye frame, mm.
    p: Point3<f64>,
    /// Its counterpart's.
    q: Point3<f64>,
    /// Where that was at the begin of the substep, if it moves.
    q_before: Option<Point3<f64>>,
}

impl BodySolver {
    /// Pushes contacts apart, and takes back sliding as far as friction holds. No body is in two of
    /// them, so all may go through each stage together: one is a long chain of roots and quotients,
    /// which a processor computes beside the others'.
    pub(super) fn solve_contacts(
        &self,
        bodies: &mut [BodyState],
        contacts: &mut [Contact],
        motions: &[ToolMotion; INSTRUMENTS],
        params: &SolverParams,
    ) {
        let mut points = [ContactPoints::default(); BATCH];
        for (points, contact) in points.iter_mut().zip(&mut *contacts) {
            *points = self.locate(bodies, contact, motions, params);
        }
        for (points, contact) in points.iter().zip(&mut *contacts) {
            let depth = (points.q - points.p).dot(&contact.normal);
            if depth > 0.0 {
                contact.push += self.shift(bodies, contact, [points.p, points.q], contact.normal * depth);
            }
        }
        for contact in contacts.iter_mut().filter(|c| c.push > 0.0 && c.other == Party::Retina) {
            self.resist_rolling(&mut bodies[contact.body], contact);
        }
        for (points, contact) in points.iter().zip(&mut *contacts).filter(|(_, c)| c.push > 0.0) {
            self.apply_friction(bodies, contact, motions, points);
        }
    }

    /// Where the parties are; turns the normal of a contact with the retina to the point of the
    /// sphere nearest to where the body is now.
    fn locate(
        &self,
        bodies: &[BodyState],
        contact: &mut Contact,
        motions: &[ToolMotion; INSTRUMENTS],
        params: &SolverParams,
    ) -> ContactPoints {
        let p = bodies[contact.body].eye_from_body * contact.in_body;
        let (q, q_before) = match contact.other {
            Party::Retina => {
                let far = p.coords.norm();
                contact.normal = if far > 1e-9 { -p.coords / far } else { contact.normal };
                (Point3::from(-contact.normal * params.retina_radius_mm), None)
            }
            Party::Instrument(h) => {
                (motions[h].pose * contact.in_other, Some(motions[h].before * contact.in_other))
            }
            Party::Body(other) => (
                bodies[other].eye_from_body * contact.in_other,
                Some(self.before[other].eye_from_body * contact.in_other),
            ),
        };
        ContactPoints { p, q, q_before }
    }

    /// Takes back what slides, as far as friction holds.
    fn apply_friction(
        &self,
        bodies: &mut [BodyState],
        contact: &mut Contact,
        motions: &[ToolMotion; INSTRUMENTS],
        points: &ContactPoints,
    ) {
        let b = contact.body;
        let p_before = self.before[b].eye_from_body * contact.in_body;
        let (p, q) = self.places(bodies, contact, motions, points.q);
        let way = (p - p_before) - points.q_before.map_or(Vector3::zeros(), |before| q - before);
        let sliding = way - contact.normal * way.dot(&contact.normal);
        let slid = sliding.norm();
        let left = contact.friction * contact.push - contact.friction_used;
        if slid < 1e-12 || left <= 0.0 {
            return;
        }
        // If the resistance to rolling bears the moment, the body is held as a whole, without
        // turning.
        let (mass, arm) =
            (self.models[b].mass_g(), (p.coords - bodies[b].eye_from_body.translation.vector).norm());
        let whole = slid * mass;
        let moment = whole * arm;
        if contact.other == Party::Retina
            && whole <= left
            && contact.rolling_used + moment <= ROLLING_MM * contact.push
        {
            bodies[b].eye_from_body.translation.vector -= sliding;
            (contact.friction_used, contact.rolling_used) =
                (contact.friction_used + whole, contact.rolling_used + moment);
            return;
        }
        // What the friction could take back at most, for this direction's mobility.
        let along = sliding / slid;
        let mobility = self.mobility(bodies, contact, [p, q], &along);
        let most = left * mobility;
        contact.friction_used += if slid > most {
            self.shift(bodies, contact, [p, q], -sliding * (most / slid))
        } else {
            self.apply_push(bodies, contact, [p, q], -along, slid / mobility)
        };
    }

    /// Takes back rolling on the retina, with a moment of at most [`ROLLING_MM`] times the push: a
    /// ball stays where it lies on a gentle slope.
    fn resist_rolling(&self, body: &mut BodyState, contact: &mut Contact) {
        let model = &self.models[contact.body];
        let before = &self.before[contact.body].eye_from_body.rotation;
        let turn = body.eye_from_body.rotation * before.inverse();
        let turn = turn.imag() * if turn.w < 0.0 { -2.0 } else { 2.0 };
        let rolling = turn - contact.normal * turn.dot(&contact.normal);
        let angle = rolling.norm();
        if angle < 1e-12 {
            return;
        }
        let local = body.eye_from_body.rotation.inverse() * (rolling / angle);
        let mobility = local.component_mul(&model.inverse_inertia).dot(&local);
        let most = (ROLLING_MM * contact.push - contact.rolling_used) * mobility;
        let back = if angle > most { most / angle } else { 1.0 };
        if back > 0.0 {
            contact.rolling_used += angle * back / mobility;
            body.eye_from_body.rotation = turned(&body.eye_from_body.rotation, &(-rolling * back));
        }
    }

    fn places(
        &self,
        bodies: &[BodyState],
        contact: &Contact,
        motions: &[ToolMotion; INSTRUMENTS],
        q: Point3<f64>,
    ) -> (Point3<f64>, Point3<f64>) {
        let p = bodies[contact.body].eye_from_body * contact.in_body;
        let q = match contact.other {
            Party::Retina => q,
            Party::Instrument(h) => motions[h].pose * contact.in_other,
            Party::Body(other) => bodies[other].eye_from_body * contact.in_other,
        };
        (p, q)
    }

    /// How far the parties move apart along a direction for a unit of push, 1/g.
    fn mobility(
        &self,
        bodies: &[BodyState],
        contact: &Contact,
        [p, q]: [Point3<f64>; 2],
        along: &Vector3<f64>,
    ) -> f64 {
        let of = |body: usize, at: &Point3<f64>| {
            let (model, pose) = (&self.models[body], &bodies[body].eye_from_body);
            let arm = (at.coords - pose.translation.vector).cross(along);
            let local = pose.rotation.inverse() * arm;
            model.inverse_mass + local.component_mul(&model.inverse_inertia).dot(&local)
        };
        of(contact.body, &p) + if let Party::Body(other) = contact.other { of(other, &q) } else { 0.0 }
    }

    /// Moves the body's point by `way` against its counterpart's; returns the push, g·mm.
    fn shift(
        &self,
        bodies: &mut [BodyState],
        contact: &Contact,
        [p, q]: [Point3<f64>; 2],
        way: Vector3<f64>,
    ) -> f64 {
        let size = way.norm();
        if size < 1e-15 {
            return 0.0;
        }
        let along = way / size;
        let push = size / self.mobility(bodies, contact, [p, q], &along);
        self.apply_push(bodies, contact, [p, q], along, push)
    }

    /// Gives both parties a push, g·mm, the body's along `along`; returns it.
    fn apply_push(
        &self,
        bodies: &mut [BodyState],
        contact: &Contact,
        [p, q]: [Point3<f64>; 2],
        along: Vector3<f64>,
        push: f64,
    ) -> f64 {
        self.push(&mut bodies[contact.body], contact.body, &p, &(along * push));
        if let Party::Body(other) = contact.other {
            self.push(&mut bodies[other], other, &q, &(-along * push));
        }
        push
    }

    fn push(&self, body: &mut BodyState, number: usize, at: &Point3<f64>, push: &Vector3<f64>) {
        let model = &self.models[number];
        let pose = &mut body.eye_from_body;
        let arm = at.coords - pose.translation.vector;
        let local = pose.rotation.inverse() * arm.cross(push);
        let turn = pose.rotation * local.component_mul(&model.inverse_inertia);
        pose.translation.vector += push * model.inverse_mass;
        pose.rotation = turned(&pose.rotation, &turn);
    }
}
