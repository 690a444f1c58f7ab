//! Moves the bodies over a substep: position-based dynamics of rigid bodies (Müller, Macklin, Chentanez, Jeschke and Kim 2020,
//! *Detailed rigid body simulation with extended position based dynamics*), with rigid contacts only.
//!
//! 1. Weight and damping change the velocities, the velocities the poses.
//! 2. Contacts are found once, at the predicted poses: with the instruments and with each other by parry3d, with the retina in
//!    closed form (a sphere from inside: the centre of a ball, the ends of a rod, the corners of a box).
//! 3. A few rounds push what is inside each other apart, both parties by their generalised inverse mass, and take back what
//!    would slide, as far as friction holds it (Coulomb, on positions).
//! 4. Velocities are what has become of the poses. Contacts do not bounce.

use super::state::{BodiesState, BodyState, Grip};
use crate::collision::rigid::{Convex, RigidBody, RigidContact};
use crate::collision::surface::Unusable;
use nalgebra::{Isometry3, Point3, UnitQuaternion, Vector3};
use protocol::limits::INSTRUMENTS;
use protocol::scene_file::{BodiesScene, BodyScene, BodyShape};

/// Lever of the resistance to rolling: how far before the middle of the contact the floor pushes back, mm. A ball of 0.4 mm stays
/// on slopes up to 14°, which is as far as 2.8 mm from the bottom of an eye; soft tissue resists more than glass.
const ROLLING_MM: f64 = 0.1;
/// Rounds over the contacts of a substep.
const ROUNDS: usize = 6;
/// Fastest a body moves, mm/s: what would be faster was thrown out of an overlap, not pushed.
pub const MAX_SPEED_MM_S: f64 = 200.0;
/// Fastest a body turns, rad/s.
pub const MAX_SPIN_RAD_S: f64 = 200.0;
/// A contact may hold that is so far from closing, mm: it keeps a resting body's friction from flickering.
const TOUCH_MM: f64 = 1e-4;

/// What does not change about a body.
#[derive(Debug, Clone)]
pub struct BodyModel {
    shape: BodyShape,
    half_mm: Vector3<f64>,
    /// 1/g.
    inverse_mass: f64,
    /// Along its axes, 1/(g·mm²).
    inverse_inertia: Vector3<f64>,
    friction: f64,
    solid: RigidBody,
}

impl BodyModel {
    /// The model of a scene's body: homogeneous.
    pub fn new(scene: &BodyScene) -> Result<Self, Unusable> {
        let [x, y, z] = scene.half_extents_mm;
        let (convex, inertia) = match scene.shape {
            BodyShape::Sphere => (Convex::Ball { radius_mm: x }, Vector3::repeat(0.4 * x * x)),
            BodyShape::Box => {
                let inertia = Vector3::new(y * y + z * z, x * x + z * z, x * x + y * y) / 3.0;
                (Convex::Cuboid { half_mm: [x, y, z] }, inertia)
            }
            BodyShape::Capsule => {
                (Convex::Capsule { half_mm: z - x, radius_mm: x }, capsule_inertia(x, z - x))
            }
        };
        Ok(BodyModel {
            shape: scene.shape,
            half_mm: Vector3::new(x, y, z),
            inverse_mass: 1.0 / scene.mass_g,
            inverse_inertia: inertia.map(|i| 1.0 / (i * scene.mass_g)),
            friction: scene.friction,
            solid: RigidBody::new(&[(convex, Isometry3::identity())])?,
        })
    }

    /// Mass, g.
    pub fn mass_g(&self) -> f64 {
        1.0 / self.inverse_mass
    }

    /// Its shape for contacts.
    pub fn solid(&self) -> &RigidBody {
        &self.solid
    }

    /// Points that can touch a sphere around it from inside, body frame, and how far its surface is from them.
    fn corners(&self) -> ([Vector3<f64>; 8], usize, f64) {
        let h = self.half_mm;
        let mut points = [Vector3::zeros(); 8];
        match self.shape {
            BodyShape::Sphere => (points, 1, h.x),
            BodyShape::Capsule => {
                (points[0], points[1]) = (Vector3::z() * (h.z - h.x), Vector3::z() * (h.x - h.z));
                (points, 2, h.x)
            }
            BodyShape::Box => {
                let side = |i: usize, bit: usize| if i >> bit & 1 == 0 { 1.0 } else { -1.0 };
                for (i, p) in points.iter_mut().enumerate() {
                    *p = Vector3::new(side(i, 0) * h.x, side(i, 1) * h.y, side(i, 2) * h.z);
                }
                (points, 8, 0.0)
            }
        }
    }
}

/// Inertia over mass of a homogeneous rod along z with round ends of radius `r`, the ends' centres `half` from the middle.
fn capsule_inertia(r: f64, half: f64) -> Vector3<f64> {
    let (cylinder, ball) = (2.0 * half, 4.0 / 3.0 * r);
    let (c, b) = (cylinder / (cylinder + ball), ball / (cylinder + ball));
    let along = c * 0.5 * r * r + b * 0.4 * r * r;
    // Half balls at the ends: their centre of mass is 3/8·r beyond `half` (parallel axes).
    let across =
        c * (r * r / 4.0 + cylinder * cylinder / 12.0) + b * (0.4 * r * r + half * half + 0.75 * half * r);
    Vector3::new(across, across, along)
}

/// An instrument in a substep.
#[derive(Debug, Clone, Copy)]
pub struct Hand {
    /// `eye_from_instrument` at its end.
    pub pose: Isometry3<f64>,
    /// The same at its begin.
    pub before: Isometry3<f64>,
    /// It may touch bodies.
    pub touches: bool,
}

/// What acts on all bodies in a substep.
#[derive(Debug, Clone, Copy)]
pub struct Surroundings {
    /// Weight of a gram, eye frame, mm/s².
    pub weight_mm_s2: Vector3<f64>,
    /// 1/s.
    pub damping_per_s: f64,
    /// mm.
    pub retina_radius_mm: f64,
    /// Most that jaws hold, µN.
    pub grip_un: f64,
    /// Length of the substep, s.
    pub dt_s: f64,
}

/// One party of a contact.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
enum Party {
    Body(usize),
    /// Yields to nothing.
    Hand(usize),
    Retina,
}

/// A contact: a point of a body and one of its counterpart, each in its own frame.
#[derive(Debug, Clone, Copy)]
struct Contact {
    body: usize,
    other: Party,
    in_body: Point3<f64>,
    in_other: Point3<f64>,
    /// Out of the counterpart, eye frame.
    normal: Vector3<f64>,
    /// Sum of pushes so far, g·mm.
    push: f64,
    /// What friction has used of its share of it, g·mm.
    rubbed: f64,
    /// What resistance to rolling has used of its share, g·mm².
    rolled: f64,
    friction: f64,
}

/// Work space of the solver.
#[derive(Debug, Default)]
pub struct BodySolver {
    models: Vec<BodyModel>,
    before: Vec<BodyState>,
    /// The bodies of the scene at its begin.
    begin: Vec<BodyState>,
    /// Bodies stopped because their numbers ran away, and the last of them.
    stopped: (u32, u32),
    contacts: Vec<Contact>,
    found: Vec<RigidContact>,
    /// Bodies that an instrument's jaws touch: which body, by which part, its normal in the eye frame.
    touched: Vec<Touched>,
    /// Sum of the pulls of each grip, eye frame, g·mm.
    pulls: [Vector3<f64>; INSTRUMENTS],
}

/// A body that an instrument touches.
#[derive(Debug, Clone, Copy)]
pub struct Touched {
    /// The instrument.
    pub hand: usize,
    /// Its part: 0 the shaft, 1 and 2 the jaws.
    pub part: usize,
    /// The body.
    pub body: usize,
    /// Out of the body, eye frame.
    pub normal: Vector3<f64>,
}

impl BodySolver {
    /// A solver for the bodies of a scene.
    pub fn new(scene: &BodiesScene) -> Result<Self, Unusable> {
        let models: Vec<BodyModel> = scene.body.iter().map(BodyModel::new).collect::<Result<_, _>>()?;
        let n = models.len();
        Ok(BodySolver {
            before: Vec::with_capacity(n),
            begin: BodiesState::start(scene).body,
            stopped: (0, 0),
            contacts: Vec::with_capacity(n * (8 + 3 * INSTRUMENTS + n)),
            found: Vec::with_capacity(8),
            touched: Vec::with_capacity(3 * INSTRUMENTS * n),
            pulls: [Vector3::zeros(); INSTRUMENTS],
            models,
        })
    }

    /// The models.
    pub fn models(&self) -> &[BodyModel] {
        &self.models
    }

    /// Which bodies the instruments touched in the last substep.
    pub fn touched(&self) -> &[Touched] {
        &self.touched
    }

    /// Force that the jaws of an instrument applied to what they hold in the last substep, eye frame, µN.
    pub fn pull_un(&self, hand: usize, dt_s: f64) -> Vector3<f64> {
        self.pulls[hand] / (dt_s * dt_s)
    }

    /// Moves the bodies over a substep.
    pub fn step(
        &mut self,
        bodies: &mut [BodyState],
        grips: &[Option<Grip>; INSTRUMENTS],
        tools: &[RigidBody; INSTRUMENTS],
        hands: &[Hand; INSTRUMENTS],
        around: &Surroundings,
    ) {
        self.before.clear();
        self.before.extend_from_slice(bodies);
        self.pulls = [Vector3::zeros(); INSTRUMENTS];
        bodies.iter_mut().for_each(|body| predict(body, around));
        self.find(bodies, grips, tools, hands, around);
        for _ in 0..ROUNDS {
            for (hand, grip) in grips.iter().enumerate() {
                if let Some(grip) = grip.filter(|_| hands[hand].touches) {
                    self.hold(bodies, &grip, hand, &hands[hand].pose, around);
                }
            }
            let mut contacts = std::mem::take(&mut self.contacts);
            for contact in &mut contacts {
                self.separate(bodies, contact, hands, around);
            }
            self.contacts = contacts;
        }
        for (b, (body, before)) in bodies.iter_mut().zip(&self.before).enumerate() {
            if !settle(body, before, around.dt_s) {
                stop(body, before, &self.begin[b]);
                self.stopped = (self.stopped.0 + 1, b as u32);
            }
        }
    }

    /// Bodies stopped since the last call because their numbers ran away, and the last of them.
    pub fn take_stopped(&mut self) -> Option<(u32, u32)> {
        Some(std::mem::take(&mut self.stopped)).filter(|s| s.0 > 0)
    }

    /// Finds the contacts at the predicted poses.
    fn find(
        &mut self,
        bodies: &[BodyState],
        grips: &[Option<Grip>; INSTRUMENTS],
        tools: &[RigidBody; INSTRUMENTS],
        hands: &[Hand; INSTRUMENTS],
        around: &Surroundings,
    ) {
        self.contacts.clear();
        self.touched.clear();
        for (b, body) in bodies.iter().enumerate() {
            self.find_retina(b, body, around.retina_radius_mm);
            for (h, hand) in hands.iter().enumerate() {
                let held = grips[h].is_some_and(|g| g.body as usize == b);
                if hand.touches && !held {
                    self.find_tool(b, body, h, &tools[h], &hand.pose);
                }
            }
            for (other, pose) in bodies.iter().enumerate().skip(b + 1) {
                self.find_pair([b, other], [&body.eye_from_body, &pose.eye_from_body]);
            }
        }
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
                rubbed: 0.0,
                rolled: 0.0,
                friction: model.friction,
            });
        }
    }

    fn find_tool(&mut self, b: usize, body: &BodyState, h: usize, tool: &RigidBody, hand: &Isometry3<f64>) {
        let eye_from_body = &body.eye_from_body;
        let model = &self.models[b];
        model.solid.contacts(tool, &(eye_from_body.inverse() * hand), &mut self.found);
        for found in &self.found {
            // The contact lies at the tool's deepest point; its counterpart is on the body's surface.
            let normal = eye_from_body.rotation * found.normal.into_inner();
            let in_tool = eye_from_body * found.at_mm;
            let on_body = in_tool + normal * found.depth_mm;
            self.touched.push(Touched { hand: h, part: found.instrument_part, body: b, normal });
            self.contacts.push(Contact {
                body: b,
                other: Party::Hand(h),
                in_body: eye_from_body.inverse_transform_point(&on_body),
                in_other: hand.inverse_transform_point(&in_tool),
                normal: -normal,
                push: 0.0,
                rubbed: 0.0,
                rolled: 0.0,
                friction: model.friction,
            });
        }
    }

    fn find_pair(&mut self, [b, other]: [usize; 2], [pose, other_pose]: [&Isometry3<f64>; 2]) {
        let (model, counterpart) = (&self.models[b], &self.models[other]);
        model.solid.contacts(&counterpart.solid, &(pose.inverse() * other_pose), &mut self.found);
        for found in &self.found {
            let normal = pose.rotation * found.normal.into_inner();
            let in_other = pose * found.at_mm;
            let on_body = in_other + normal * found.depth_mm;
            self.contacts.push(Contact {
                body: b,
                other: Party::Body(other),
                in_body: pose.inverse_transform_point(&on_body),
                in_other: other_pose.inverse_transform_point(&in_other),
                normal: -normal,
                push: 0.0,
                rubbed: 0.0,
                rolled: 0.0,
                friction: libm::sqrt(model.friction * counterpart.friction),
            });
        }
    }

    /// Pulls a held body to where the jaws have it, with no more force than they give.
    fn hold(
        &mut self,
        bodies: &mut [BodyState],
        grip: &Grip,
        hand: usize,
        pose: &Isometry3<f64>,
        around: &Surroundings,
    ) {
        let body = &mut bodies[grip.body as usize];
        let wanted = pose * grip.instrument_from_body;
        let mass = self.models[grip.body as usize].mass_g();
        let most = around.grip_un * around.dt_s * around.dt_s;
        let pull =
            self.pulls[hand] + (wanted.translation.vector - body.eye_from_body.translation.vector) * mass;
        let size = pull.norm();
        let pull = if size > most { pull * (most / size) } else { pull };
        body.eye_from_body.translation.vector += (pull - self.pulls[hand]) / mass;
        self.pulls[hand] = pull;
        // Flat jaws hold against turning better than against sliding.
        body.eye_from_body.rotation = wanted.rotation;
    }

    /// Pushes a contact apart, and takes back sliding as far as friction holds.
    fn separate(
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

/// A rotation after a small turn, eye frame, rad: first order, normalised; no transcendental functions.
fn turned(rotation: &UnitQuaternion<f64>, turn: &Vector3<f64>) -> UnitQuaternion<f64> {
    let small = nalgebra::Quaternion::from_parts(0.0, turn * 0.5);
    UnitQuaternion::new_normalize(rotation.into_inner() + small * rotation.into_inner())
}

fn predict(body: &mut BodyState, around: &Surroundings) {
    // Implicit damping: stable for any constant.
    let keep = 1.0 / (1.0 + around.damping_per_s * around.dt_s);
    body.velocity_mm_s = (body.velocity_mm_s + around.weight_mm_s2 * around.dt_s) * keep;
    body.spin_rad_s *= keep;
    body.eye_from_body.translation.vector += body.velocity_mm_s * around.dt_s;
    body.eye_from_body.rotation = turned(&body.eye_from_body.rotation, &(body.spin_rad_s * around.dt_s));
}

/// The velocities that lead from `before` to where the body is now, within their limits; `false` for a body whose numbers ran away.
fn settle(body: &mut BodyState, before: &BodyState, dt_s: f64) -> bool {
    let way = body.eye_from_body.translation.vector - before.eye_from_body.translation.vector;
    let turn = body.eye_from_body.rotation * before.eye_from_body.rotation.inverse();
    let sign = if turn.w < 0.0 { -2.0 } else { 2.0 };
    body.velocity_mm_s = within(way / dt_s, MAX_SPEED_MM_S);
    body.spin_rad_s = within(turn.imag() * (sign / dt_s), MAX_SPIN_RAD_S);
    body.is_sound()
}

/// A body whose numbers ran away stays where it was, at rest; where that is no place either, it goes to where it began.
fn stop(body: &mut BodyState, before: &BodyState, begin: &BodyState) {
    *body = BodyState { velocity_mm_s: Vector3::zeros(), spin_rad_s: Vector3::zeros(), ..*before };
    if !body.is_sound() {
        *body = *begin;
    }
}

fn within(v: Vector3<f64>, most: f64) -> Vector3<f64> {
    let size = v.norm();
    if size > most { v * (most / size) } else { v }
}

#[cfg(test)]
mod tests {
    use super::*;
    use protocol::handles::Tool;

    const DT_S: f64 = 1e-3;

    fn scene(shape: BodyShape, half_extents_mm: [f64; 3], at: [f64; 3], friction: f64) -> BodiesScene {
        let body = BodyScene {
            shape,
            half_extents_mm,
            position_in_eye_mm: at,
            mass_g: 0.002,
            friction,
            rgba: [1.0; 4],
        };
        BodiesScene { weight_mm_s2: 0.0, damping_per_s: 0.0, body: vec![body] }
    }

    fn around(weight_mm_s2: [f64; 3], damping_per_s: f64, retina_radius_mm: f64) -> Surroundings {
        let weight_mm_s2 = weight_mm_s2.into();
        Surroundings { weight_mm_s2, damping_per_s, retina_radius_mm, grip_un: 100.0, dt_s: DT_S }
    }

    fn away() -> Hand {
        Hand { pose: Isometry3::identity(), before: Isometry3::identity(), touches: false }
    }

    fn tools() -> [RigidBody; INSTRUMENTS] {
        [Tool::LightPipe; INSTRUMENTS].map(|t| RigidBody::instrument(t, 0.25, 20.0).unwrap())
    }

    /// The body after so many substeps without instruments.
    fn left_alone(scene: &BodiesScene, around: &Surroundings, substeps: usize) -> BodyState {
        let mut bodies = super::super::state::BodiesState::start(scene);
        let (mut solver, tools) = (BodySolver::new(scene).unwrap(), tools());
        for _ in 0..substeps {
            solver.step(&mut bodies.body, &bodies.grip, &tools, &[away(); INSTRUMENTS], around);
        }
        bodies.body[0]
    }

    #[test]
    fn a_falling_ball_reaches_the_speed_at_which_the_fluid_carries_it() {
        let scene = scene(BodyShape::Sphere, [0.5; 3], [0.0; 3], 0.3);
        let body = left_alone(&scene, &around([0.0, 0.0, -600.0], 12.0, 1e4), 2_000);
        assert!((body.velocity_mm_s - Vector3::new(0.0, 0.0, -50.0)).norm() < 1e-6, "weight / damping");
    }

    /// Resistance to rolling holds a ball where the slope's tangent is below lever / radius; where it rolls, it stops on such a slope.
    #[test]
    fn a_ball_comes_to_rest_on_the_retina() {
        for (x, stays) in [(1.0, true), (1.8, true), (5.0, false)] {
            let centre = [x, 0.0, -f64::sqrt(11.0 * 11.0 - x * x)];
            let scene = scene(BodyShape::Sphere, [0.5; 3], centre, 0.6);
            let body = left_alone(&scene, &around([0.0, 0.0, -5900.0], 12.0, 11.5), 4_000);
            let at = body.eye_from_body.translation.vector;
            assert!((at.norm() - 11.0).abs() < 1e-3 && body.velocity_mm_s.norm() < 0.05, "{at}");
            assert_eq!((at - Vector3::from(centre)).norm() < 0.02, stays, "{at} from {x}");
            let slope = at.x.hypot(at.y) / -at.z;
            assert!(slope < 1.1 * ROLLING_MM / 0.5, "{slope}");
        }
    }

    /// A box on a floor so wide that it is flat, the weight at a slope to it: it stays while the slope's tangent is below the friction,
    /// and else slides with the acceleration that Coulomb's friction leaves.
    #[test]
    fn a_box_slides_where_friction_says() {
        let (radius, g) = (1e5, 1_000.0);
        for (slope, friction) in [(0.2f64, 0.25), (0.4, 0.5), (0.4, 0.25), (0.5, 0.1), (0.3, 0.0)] {
            let scene = scene(BodyShape::Box, [1.0, 1.0, 0.2], [0.0, 0.0, -(radius - 0.2001)], friction);
            let weight = [g * slope.sin(), 0.0, -g * slope.cos()];
            let substeps = 200;
            let body = left_alone(&scene, &around(weight, 0.0, radius), substeps);
            let way = body.eye_from_body.translation.vector.x;
            let left = (slope.sin() - friction * slope.cos()).max(0.0);
            let t = substeps as f64 * DT_S;
            let expected = 0.5 * g * left * t * (t + DT_S);
            let error = (way - expected).abs();
            assert!(error < 0.01 + 0.03 * expected, "slope {slope}, friction {friction}: {way} {expected}");
        }
    }

    #[test]
    fn a_tip_pushes_a_ball_ahead_of_it() {
        let scene = scene(BodyShape::Sphere, [0.5; 3], [0.0, 0.0, -0.52], 0.3);
        let mut bodies = super::super::state::BodiesState::start(&scene);
        let (mut solver, tools) = (BodySolver::new(&scene).unwrap(), tools());
        let around = around([0.0; 3], 10.0, 1e4);
        let tip = |k: usize| Isometry3::translation(0.0, 0.0, -5.0 * DT_S * k as f64);
        for k in 1..=200 {
            let hand = Hand { pose: tip(k), before: tip(k - 1), touches: true };
            solver.step(&mut bodies.body, &bodies.grip, &tools, &[hand, away()], &around);
        }
        let body = bodies.body[0];
        // The flat end of the pipe is at −1 mm and touches the ball's top.
        assert!((body.eye_from_body.translation.vector.z + 1.5).abs() < 1e-3, "{body:?}");
        // In front of the tip, or just thrown clear of it by the fluid's grasp of a substep.
        assert!((body.velocity_mm_s.z + 5.0).abs() < 0.1, "{body:?}");
    }

    /// Held against its weight: the jaws' pull is m·g. Held by less than that: it slides out.
    #[test]
    fn a_grip_carries_what_it_can() {
        let scene = scene(BodyShape::Sphere, [0.5; 3], [0.0, 0.0, -3.0], 0.3);
        let (m, g) = (0.002, 6_000.0);
        for (grip_un, carried) in [(1.2 * m * g, true), (0.8 * m * g, false)] {
            let mut bodies = super::super::state::BodiesState::start(&scene);
            let hand = Hand { pose: Isometry3::identity(), before: Isometry3::identity(), touches: true };
            bodies.grip[0] = Some(super::super::grip::take(0, &bodies.body[0], &hand.pose, 0.3));
            let (mut solver, tools) = (BodySolver::new(&scene).unwrap(), tools());
            let around = Surroundings { grip_un, ..around([0.0, 0.0, -g], 0.0, 11.5) };
            for _ in 0..50 {
                solver.step(&mut bodies.body, &bodies.grip, &tools, &[hand, away()], &around);
            }
            let pull = solver.pull_un(0, DT_S);
            assert!((pull.z - grip_un.min(m * g)).abs() < 1e-3 * m * g, "{pull} of {grip_un}");
            let z = bodies.body[0].eye_from_body.translation.vector.z;
            assert_eq!((z + 3.0).abs() < 1e-6, carried, "{z}");
        }
    }

    /// Against a sum over small cubes.
    #[test]
    fn a_rods_inertia_is_that_of_its_matter() {
        let (r, half, n) = (0.5, 0.8, 60);
        let (mut mass, mut sum) = (0.0, Vector3::zeros());
        let at = |i: i32, size: f64| (f64::from(i) + 0.5) / f64::from(n) * size;
        for (i, j, k) in (-n..n).flat_map(|i| (-n..n).flat_map(move |j| (-n..n).map(move |k| (i, j, k)))) {
            let p = Vector3::new(at(i, r), at(j, r), at(k, half + r));
            let beyond = (p.z.abs() - half).max(0.0);
            if p.x * p.x + p.y * p.y + beyond * beyond < r * r {
                mass += 1.0;
                sum += Vector3::new(p.y * p.y + p.z * p.z, p.x * p.x + p.z * p.z, p.x * p.x + p.y * p.y);
            }
        }
        let (found, expected) = (capsule_inertia(r, half), sum / mass);
        assert!((found - expected).norm() < 2e-3 * expected.norm(), "{found} {expected}");
    }

    #[test]
    fn numbers_that_run_away_stop_the_body() {
        let scene = scene(BodyShape::Box, [0.5; 3], [0.0, 0.0, -3.0], 0.3);
        let mut bodies = super::super::state::BodiesState::start(&scene);
        let (mut solver, tools) = (BodySolver::new(&scene).unwrap(), tools());
        let bad = Hand {
            pose: Isometry3::translation(f64::NAN, 0.0, 0.0),
            before: Isometry3::identity(),
            touches: true,
        };
        bodies.grip[1] = Some(super::super::grip::take(0, &bodies.body[0], &Isometry3::identity(), 0.3));
        for weight in [0.0, f64::NAN, f64::INFINITY] {
            solver.step(
                &mut bodies.body,
                &bodies.grip,
                &tools,
                &[bad, bad],
                &around([0.0, 0.0, weight], 1.0, 11.5),
            );
            assert!(bodies.body[0].is_sound());
        }
    }
}
