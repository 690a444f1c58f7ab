//! Where bodies touch at their predicted poses: each other and the instruments by parry3d, the
//! retina in closed form (a sphere from inside: the centre of a ball, the ends of a rod, the
//! corners of a box). Found once in a substep.

use super::solve::{BodySolver, SolverParams, ToolMotion, TouchedBody};
use super::state::{BodyState, Grip};
use collision::rigid::{Compound, RigidContact};
use nalgebra::{Isometry3, Point3, Vector3};
use protocol::limits::INSTRUMENTS;

/// A contact may hold that is so far from closing, mm: it keeps a resting body's friction from
/// flickering.
const TOUCH_MM: f64 = 1e-4;

/// Contacts that are taken together at most.
pub(super) const BATCH: usize = 4;

/// How many of the first contacts have no body in common: in which order they are pushed apart
/// makes no difference.
pub(super) fn independent(contacts: &[Contact]) -> usize {
    let bodies = |c: &Contact| {
        let other = if let Party::Body(other) = c.other { Some(other) } else { None };
        std::iter::once(c.body).chain(other)
    };
    let shared =
        |i: &usize| bodies(&contacts[*i]).any(|b| contacts[..*i].iter().flat_map(bodies).any(|a| a == b));
    let most = contacts.len().min(BATCH);
    (1..most).find(shared).unwrap_or(most)
}

/// One party of a contact.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub(super) enum Party {
    Body(usize),
    /// Yields to nothing.
    Instrument(usize),
    Retina,
}

/// A contact: a point of a body and one of its counterpart, each in its own frame.
#[derive(Debug, Clone, Copy)]
pub(super) struct Contact {
    pub(super) body: usize,
    pub(super) other: Party,
    pub(super) in_body: Point3<f64>,
    pub(super) in_other: Point3<f64>,
    /// Out of the counterpart, eye frame.
    pub(super) normal: Vector3<f64>,
    /// Sum of pushes so far, g·mm.
    pub(super) push: f64,
    /// What friction has used of its share of it, g·mm.
    pub(super) friction_used: f64,
    /// What resistance to rolling has used of its share, g·mm².
    pub(super) rolling_used: f64,
    pub(super) friction: f64,
    /// Contacts of its body before it.
    turn: u32,
}

/// A contact that parry3d found between two parties at these poses. It lies at the other's deepest
/// point; its counterpart is on the body's surface.
fn contact(
    (body, other): (usize, Party),
    [pose, other_pose]: [&Isometry3<f64>; 2],
    found: &RigidContact,
    friction: f64,
) -> Contact {
    let normal = pose.rotation * found.normal.into_inner();
    let in_eye = pose * found.at_mm;
    let on_body = in_eye + normal * found.depth_mm;
    Contact {
        body,
        other,
        in_body: pose.inverse_transform_point(&on_body),
        in_other: other_pose.inverse_transform_point(&in_eye),
        normal: -normal,
        push: 0.0,
        friction_used: 0.0,
        rolling_used: 0.0,
        friction,
        turn: 0,
    }
}

impl BodySolver {
    /// Finds the contacts at the predicted poses.
    pub(super) fn find_contacts(
        &mut self,
        bodies: &[BodyState],
        grips: &[Option<Grip>; INSTRUMENTS],
        tools: &[Compound; INSTRUMENTS],
        motions: &[ToolMotion; INSTRUMENTS],
        params: &SolverParams,
    ) {
        self.contacts.clear();
        self.touched.clear();
        for (b, body) in bodies.iter().enumerate() {
            self.find_retina(b, body, params.retina_radius_mm);
            for (h, instrument) in motions.iter().enumerate() {
                let held = grips[h].is_some_and(|g| g.body as usize == b);
                if instrument.touches && !held {
                    self.find_tool(b, body, h, &tools[h], &instrument.pose);
                }
            }
            for (other, pose) in bodies.iter().enumerate().skip(b + 1) {
                self.find_pair([b, other], [&body.eye_from_body, &pose.eye_from_body]);
            }
        }
        self.interleave();
    }

    /// Takes contacts of the bodies in turn where no two bodies touch: nothing comes out
    /// differently, and more of them are [`apart`].
    fn interleave(&mut self) {
        if self.contacts.iter().any(|c| matches!(c.other, Party::Body(_))) {
            return;
        }
        let (mut turn, mut last) = (0, None);
        for contact in &mut self.contacts {
            turn = if last == Some(contact.body) { turn + 1 } else { 0 };
            (contact.turn, last) = (turn, Some(contact.body));
        }
        self.contacts.sort_unstable_by_key(|c| (c.turn, c.body));
    }

    fn find_retina(&mut self, b: usize, body: &BodyState, retina_radius_mm: f64) {
        let model = &self.models[b];
        let (corners, count, round) = model.corners();
        for corner in &corners[..count] {
            let p = body.eye_from_body * Point3::from(*corner);
            let far = p.coords.norm();
            if far + round < retina_radius_mm - TOUCH_MM || far < 1e-9 {
                continue;
            }
            let out = p.coords / far;
            let at = Point3::from(p.coords + out * round);
            self.contacts.push(Contact {
                body: b,
                other: Party::Retina,
                in_body: body.eye_from_body.inverse_transform_point(&at),
                in_other: Point3::from(out * retina_radius_mm),
                normal: -out,
                push: 0.0,
                friction_used: 0.0,
                rolling_used: 0.0,
                friction: model.friction,
                turn: 0,
            });
        }
    }

    fn find_tool(
        &mut self,
        b: usize,
        body: &BodyState,
        h: usize,
        tool: &Compound,
        instrument: &Isometry3<f64>,
    ) {
        let eye_from_body = &body.eye_from_body;
        let model = &self.models[b];
        model.solid.contacts(tool, &(eye_from_body.inverse() * instrument), &mut self.found);
        for found in &self.found {
            let normal = eye_from_body.rotation * found.normal.into_inner();
            self.touched.push(TouchedBody { instrument: h, part: found.instrument_part, body: b, normal });
            let parties = (b, Party::Instrument(h));
            self.contacts.push(contact(parties, [eye_from_body, instrument], found, model.friction));
        }
    }

    fn find_pair(&mut self, [b, other]: [usize; 2], [pose, other_pose]: [&Isometry3<f64>; 2]) {
        let (model, counterpart) = (&self.models[b], &self.models[other]);
        model.solid.contacts(&counterpart.solid, &(pose.inverse() * other_pose), &mut self.found);
        let friction = libm::sqrt(model.friction * counterpart.friction);
        for found in &self.found {
            self.contacts.push(contact((b, Party::Body(other)), [pose, other_pose], found, friction));
        }
    }
}
