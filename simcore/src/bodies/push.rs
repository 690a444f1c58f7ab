//! What a contact does to its parties: pushes them apart by their generalised inverse masses, and takes back what would slide or
//! roll, as far as friction holds it (Coulomb, on positions).

use super::contacts::{Contact, Party};
use super::motion::turned;
use super::solve::{BodySolver, Hand, Surroundings};
use super::state::BodyState;
use nalgebra::{Point3, Vector3};
use protocol::limits::INSTRUMENTS;

/// Lever of the resistance to rolling: how far before the middle of the contact the floor pushes back, mm. A ball of 0.4 mm stays
/// on slopes up to 14°, which is as far as 2.8 mm from the bottom of an eye; soft tissue resists more than glass.
pub(super) const ROLLING_MM: f64 = 0.1;

impl BodySolver {
    /// Pushes a contact apart, and takes back sliding as far as friction holds.
    pub(super) fn separate(
        &self,
        bodies: &mut [BodyState],
        contact: &mut Contact,
        hands: &[Hand; INSTRUMENTS],
        around: &Surroundings,
    ) {
        let b = contact.body;
        let p = bodies[b].eye_from_body * contact.in_body;
        let (q, q_before) = match contact.other {
            Party::Retina => {
                // The nearest point of the sphere to where the body is now.
                let far = p.coords.norm();
                contact.normal = if far > 1e-9 { -p.coords / far } else { contact.normal };
                let q = Point3::from(-contact.normal * around.retina_radius_mm);
                (q, q)
            }
            Party::Hand(h) => (hands[h].pose * contact.in_other, hands[h].before * contact.in_other),
            Party::Body(other) => (
                bodies[other].eye_from_body * contact.in_other,
                self.before[other].eye_from_body * contact.in_other,
            ),
        };
        let depth = (q - p).dot(&contact.normal);
        if depth > 0.0 {
            contact.push += self.shift(bodies, contact, [p, q], contact.normal * depth);
        }
        if contact.push > 0.0 {
            self.resist_rolling(&mut bodies[b], contact);
            let still = if contact.other == Party::Retina { None } else { Some(q_before) };
            self.rub(bodies, contact, hands, q, still);
        }
    }

    /// Takes back what slides, as far as friction holds. `q` is the counterpart's point, `q_before` where it was if it moves.
    fn rub(
        &self,
        bodies: &mut [BodyState],
        contact: &mut Contact,
        hands: &[Hand; INSTRUMENTS],
        q: Point3<f64>,
        q_before: Option<Point3<f64>>,
    ) {
        let b = contact.body;
        let p_before = self.before[b].eye_from_body * contact.in_body;
        let (p, q) = self.places(bodies, contact, hands, q);
        let way = (p - p_before) - q_before.map_or(Vector3::zeros(), |before| q - before);
        let sliding = way - contact.normal * way.dot(&contact.normal);
        let slid = sliding.norm();
        let left = contact.friction * contact.push - contact.rubbed;
        if slid < 1e-12 || left <= 0.0 {
            return;
        }
        // If the resistance to rolling bears the moment, the body is held as a whole, without turning.
        let (mass, arm) =
            (self.models[b].mass_g(), (p.coords - bodies[b].eye_from_body.translation.vector).norm());
        let whole = slid * mass;
        let moment = whole * arm;
        if contact.other == Party::Retina
            && whole <= left
            && contact.rolled + moment <= ROLLING_MM * contact.push
        {
            bodies[b].eye_from_body.translation.vector -= sliding;
            (contact.rubbed, contact.rolled) = (contact.rubbed + whole, contact.rolled + moment);
            return;
        }
        // What the friction could take back at most, for this direction's mobility.
        let most = left * self.mobility(bodies, contact, [p, q], &(sliding / slid));
        let back = if slid > most { most / slid } else { 1.0 };
        contact.rubbed += self.shift(bodies, contact, [p, q], -sliding * back);
    }

    /// Takes back rolling on the retina, with a moment of at most [`ROLLING_MM`] times the push: a ball stays where it lies on a gentle slope.
    fn resist_rolling(&self, body: &mut BodyState, contact: &mut Contact) {
        if contact.other != Party::Retina {
            return;
        }
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
        let most = (ROLLING_MM * contact.push - contact.rolled) * mobility;
        let back = if angle > most { most / angle } else { 1.0 };
        if back > 0.0 {
            contact.rolled += angle * back / mobility;
            body.eye_from_body.rotation = turned(&body.eye_from_body.rotation, &(-rolling * back));
        }
    }

    fn places(
        &self,
        bodies: &[BodyState],
        contact: &Contact,
        hands: &[Hand; INSTRUMENTS],
        q: Point3<f64>,
    ) -> (Point3<f64>, Point3<f64>) {
        let p = bodies[contact.body].eye_from_body * contact.in_body;
        let q = match contact.other {
            Party::Retina => q,
            Party::Hand(h) => hands[h].pose * contact.in_other,
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
