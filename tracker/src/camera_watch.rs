//! Cameras that were moved since the rig was calibrated: found, left out, estimated anew from what the
//! others see, and taken back.
//!
//! | standing of a camera | what becomes of its fields | until |
//! |---|---|---|
//! | trusted | they are tracked | a field as a whole lies beside the predictions, or small residuals that only a moved camera explains add up |
//! | suspected | those that lie beside are not used | calm again, or confirmed by several fields |
//! | left out | they serve to estimate where the camera is | the estimate explains them |
//!
//! Two cameras must stay; where they disagree, the choice was wrong, and the other is tried. A rig of
//! two cameras cannot say which one was moved.

mod evidence;
mod jump;
mod relocation;
mod sighting;

use crate::associate::{AssociationInput, PredictedBody};
use crate::constants as k;
use crate::pose_math::{Matrix6, Vector6};
use crate::projection::MarkerImage;
use crate::rig_model::RigModel;
pub use evidence::BodyUpdate;
use evidence::Evidence;
use nalgebra::{Matrix2x3, Point3, Rotation3, SMatrix, Vector3};
use protocol::camera::Camera;
use protocol::limits::{BODIES, MAX_CAMERAS};
use relocation::Relocation;

/// Jacobian of a pixel by the turn and shift of its camera, in units of [`k::KNOCK_TURN_RAD`] and
/// [`k::KNOCK_SHIFT_MM`].
type CameraJacobian = SMatrix<f64, 2, 6>;

/// How a camera stands.
#[derive(Debug, Clone, Copy, PartialEq)]
enum Standing {
    Trusted,
    /// Fields in a row that lay beside, and since then beside nothing.
    Suspected {
        beside: u32,
        calm: u32,
    },
    LeftOut {
        since_ns: u64,
    },
}

/// A field that lay beside the predictions as a whole.
#[derive(Debug, Clone, Copy)]
struct Jump {
    at_ns: u64,
    px: f64,
}

impl Standing {
    /// After one more field, which lay beside the predictions or not.
    fn after(self, jumped: bool) -> Self {
        match (self, jumped) {
            (Standing::Suspected { beside, .. }, true) => Standing::Suspected { beside: beside + 1, calm: 0 },
            (_, true) => Standing::Suspected { beside: 1, calm: 0 },
            (Standing::Suspected { beside, calm }, false) if calm + 1 < k::KNOCK_CALM_FIELDS => {
                Standing::Suspected { beside, calm: calm + 1 }
            }
            (_, false) => Standing::Trusted,
        }
    }
}

/// A change of a camera's standing, for people.
#[derive(Debug, Clone, Copy, PartialEq)]
pub enum Notice {
    /// It was moved and is left out.
    Moved {
        /// Camera id.
        camera: usize,
        /// By how much its picture moved as far as was seen, px; 0 where that is not known.
        px: f64,
    },
    /// It was estimated anew and is used again.
    TakenBack {
        /// Camera id.
        camera: usize,
        /// By how much its picture had moved, px.
        px: f64,
    },
    /// It goes on moving.
    Restless {
        /// Camera id.
        camera: usize,
    },
    /// Cameras disagree, and leaving out none of them helps.
    Disagree {
        /// Set of the cameras.
        cameras: u32,
    },
}

impl std::fmt::Display for Notice {
    fn fmt(&self, f: &mut std::fmt::Formatter<'_>) -> std::fmt::Result {
        match self {
            Notice::Moved { camera, px } => {
                let by =
                    if *px > 0.0 { format!("moved by {px:.1} px or more") } else { "lies elsewhere".into() };
                write!(
                    f,
                    "bad calibration of camera {camera}: its picture {by}; it is left out, and where it stands is estimated from the others"
                )
            }
            Notice::TakenBack { camera, px } => write!(
                f,
                "camera {camera} is used again where the others see it ({px:.1} px from where the rig file has it): calibrate anew"
            ),
            Notice::Restless { camera } => {
                write!(f, "camera {camera} goes on moving and stays left out: fasten it, then calibrate anew")
            }
            Notice::Disagree { cameras } => {
                let ids: Vec<String> =
                    (0..32).filter(|c| cameras & (1 << c) != 0).map(|c| c.to_string()).collect();
                let ids = ids.join(", ");
                write!(
                    f,
                    "cameras {ids} disagree, and leaving out none of them helps: more than one was moved; calibrate the rig anew"
                )
            }
        }
    }
}

/// A decision that the other cameras must bear out.
#[derive(Debug, Clone, Copy)]
struct Trial {
    since_ns: u64,
    camera: usize,
    /// Cameras that were tried.
    tried: u32,
}

/// Watches the cameras of a rig.
pub struct CameraWatch {
    calibrated: [Option<Camera>; MAX_CAMERAS],
    standing: [Standing; MAX_CAMERAS],
    jumps: [Option<Jump>; MAX_CAMERAS],
    evidence: Box<[Evidence; MAX_CAMERAS]>,
    relocations: [Option<Box<Relocation>>; MAX_CAMERAS],
    /// How often each was taken back.
    returns: [u32; MAX_CAMERAS],
    estimated: u32,
    trial: Option<Trial>,
    /// No judgement before this instant, ns.
    quiet_until_ns: u64,
    notice: Option<Notice>,
}

impl CameraWatch {
    /// For a rig as calibrated.
    pub fn new(rig: &RigModel) -> Self {
        CameraWatch {
            calibrated: rig.cameras.clone(),
            standing: [Standing::Trusted; MAX_CAMERAS],
            jumps: [None; MAX_CAMERAS],
            evidence: Box::new(std::array::from_fn(|_| Evidence::default())),
            relocations: std::array::from_fn(|c| rig.cameras[c].as_ref().map(|_| Box::default())),
            returns: [0; MAX_CAMERAS],
            estimated: 0,
            trial: None,
            quiet_until_ns: 0,
            notice: None,
        }
    }

    /// Set of the cameras that are left out.
    pub fn left_out(&self) -> u32 {
        self.set(|s| matches!(s, Standing::LeftOut { .. }))
    }

    /// Set of the cameras that stand where they were estimated to be, and not where the rig has them.
    pub fn estimated(&self) -> u32 {
        self.estimated
    }

    /// What changed since the last call.
    pub fn take_notice(&mut self) -> Option<Notice> {
        self.notice.take()
    }

    fn set(&self, wanted: impl Fn(&Standing) -> bool) -> u32 {
        let bit = |(c, s): (usize, &Standing)| u32::from(wanted(s) && self.calibrated[c].is_some()) << c;
        self.standing.iter().enumerate().map(bit).sum()
    }

    /// Set of the cameras that are not left out.
    pub fn in_use(&self) -> u32 {
        self.set(|s| !matches!(s, Standing::LeftOut { .. }))
    }

    /// The cameras of a group whose fields may be tracked. Those whose field as a whole lies beside the
    /// predictions are not.
    pub fn admit(
        &mut self,
        input: &AssociationInput<'_>,
        predicted: &[Option<PredictedBody>; BODIES],
    ) -> u32 {
        let rough = input.cameras & self.needed(input);
        let in_use = input.cameras & self.in_use();
        for field in input.fields().filter(|f| in_use & (1 << f.camera) != 0) {
            let px = jump::of_field(input, field, predicted);
            self.jumps[field.camera] = px.map(|px| Jump { at_ns: input.time_ns, px });
        }
        let mut admitted = in_use | rough;
        for camera in self.members(in_use) {
            let jump = self.jumps[camera].filter(|_| self.jumped_alone(camera, input.time_ns));
            if jump.is_some() {
                admitted &= !(1 << camera);
            }
            self.standing[camera] = self.standing[camera].after(jump.is_some());
            if let (Standing::Suspected { beside: k::KNOCK_FIELDS.., .. }, Some(jump)) =
                (self.standing[camera], jump)
            {
                self.accuse(camera, jump.px, input.time_ns);
            }
        }
        admitted
    }

    /// Set of the cameras that are left out and serve nevertheless, because fewer than two others send
    /// fields.
    fn needed(&self, input: &AssociationInput<'_>) -> u32 {
        let sends = |c: &usize| input.time_ns.saturating_sub(input.fields[*c].exposed_ns) < k::SILENT_NS;
        if self.left_out() == 0
            || self.trial.is_some()
            || self.members(self.in_use()).filter(sends).count() >= 2
        {
            return 0;
        }
        let roughly = |c: &usize| self.relocations[*c].as_ref().is_some_and(|r| r.rough().is_some());
        self.members(self.left_out()).filter(roughly).map(|c| 1 << c).sum()
    }

    /// True if a camera alone jumped, so that it and not the prediction is wrong, and two others stay.
    fn jumped_alone(&self, camera: usize, time_ns: u64) -> bool {
        let others = self.in_use() & !(1 << camera);
        let jumped =
            |c: usize| self.jumps[c].is_some_and(|j| time_ns.saturating_sub(j.at_ns) < k::KNOCK_TOGETHER_NS);
        time_ns >= self.quiet_until_ns && others.count_ones() >= 2 && !self.members(others).any(jumped)
    }

    /// Adds what an update of a body says about the cameras.
    pub fn add(&mut self, input: &AssociationInput<'_>, update: &BodyUpdate) {
        // What the filters have of the camera that was left out dies out first.
        let settling = |t: Trial| input.time_ns.saturating_sub(t.since_ns) < k::KNOCK_SETTLE_NS;
        if !self.trial.is_some_and(settling) {
            evidence::add(&mut self.evidence, input, update);
        }
    }

    /// Judges the evidence of the cameras in `group` (a set).
    pub fn judge(&mut self, group: u32, time_ns: u64) {
        if time_ns < self.quiet_until_ns {
            return;
        }
        let in_use = self.in_use();
        let verdict = self.verdict(in_use, group);
        match (self.trial, verdict) {
            (None, Some((camera, px))) if in_use.count_ones() >= 3 => self.accuse(camera, px, time_ns),
            (Some(trial), Some((_, px))) if in_use.count_ones() == 2 => {
                self.try_another(trial, in_use, px, time_ns);
            }
            (Some(trial), None) if time_ns.saturating_sub(trial.since_ns) > k::KNOCK_TRIAL_NS => {
                // Cameras that find no eye together do not agree; one that is silent says nothing.
                if self.members(in_use).any(|c| self.evidence[c].misses_eye()) {
                    self.try_another(trial, in_use, 0.0, time_ns);
                } else {
                    self.trial = None;
                }
            }
            _ => {}
        }
    }

    /// Of the cameras in use the one that was moved, with the shift of its picture, px: that without
    /// which most is explained, once it has come in `group`.
    fn verdict(&self, in_use: u32, group: u32) -> Option<(usize, f64)> {
        let gains = self.members(in_use).map(|c| (c, self.evidence[c].gain()));
        let (camera, _) = gains.max_by(|a, b| a.1.total_cmp(&b.1))?;
        let px = self.evidence[camera].verdict().filter(|_| group & (1 << camera) != 0)?;
        Some((camera, px))
    }

    /// Ids of a set of cameras.
    fn members(&self, set: u32) -> impl Iterator<Item = usize> + use<> {
        (0..MAX_CAMERAS).filter(move |c| set & (1 << c) != 0)
    }

    /// The cameras that stayed disagree: the one that is left out was the wrong one.
    fn try_another(&mut self, trial: Trial, in_use: u32, px: f64, time_ns: u64) {
        self.standing[trial.camera] = Standing::Trusted;
        let untried = self.members(in_use & !trial.tried).next();
        let Some(next) = untried else {
            self.disagree(time_ns);
            return;
        };
        let tried = trial.tried | 1 << next;
        self.trial = Some(Trial { since_ns: time_ns, camera: next, tried });
        self.leave_out(next, px, time_ns);
    }

    /// Gives up for a while: no choice of one camera helps.
    pub fn disagree(&mut self, time_ns: u64) {
        if let Some(trial) = self.trial.take() {
            self.standing[trial.camera] = Standing::Trusted;
        } else if self.left_out() != 0 {
            return;
        }
        self.clear_evidence();
        self.quiet_until_ns = time_ns + k::KNOCK_QUIET_NS;
        self.notice = Some(Notice::Disagree { cameras: self.in_use() });
    }

    /// Leaves out a camera, on trial.
    pub fn accuse(&mut self, camera: usize, px: f64, time_ns: u64) {
        self.trial = Some(Trial { since_ns: time_ns, camera, tried: 1 << camera });
        self.leave_out(camera, px, time_ns);
    }

    fn leave_out(&mut self, camera: usize, px: f64, time_ns: u64) {
        self.standing[camera] = Standing::LeftOut { since_ns: time_ns };
        if let Some(relocation) = &mut self.relocations[camera] {
            relocation.begin(k::RELOCATION_FIELDS << self.returns[camera].min(4));
        }
        self.clear_evidence();
        self.notice = Some(Notice::Moved { camera, px });
    }

    fn clear_evidence(&mut self) {
        self.evidence.iter_mut().for_each(|e| *e = Evidence::default());
    }

    /// Collects what the cameras that are left out see in a group, and takes back one whose place is
    /// known. Returns where one of them stands, as far as that is known. The bodies are where the other
    /// cameras see them.
    pub fn relocate(
        &mut self,
        input: &AssociationInput<'_>,
        bodies: &[Option<PredictedBody>; BODIES],
    ) -> Option<(usize, Camera)> {
        let out = self.left_out();
        for field in input.fields().filter(|f| out & (1 << f.camera) != 0) {
            let camera = field.camera;
            let Standing::LeftOut { since_ns } = self.standing[camera] else { continue };
            let since_ns = input.time_ns.saturating_sub(since_ns);
            let (Some(relocation), Some(calibrated)) =
                (&mut self.relocations[camera], &self.calibrated[camera])
            else {
                continue;
            };
            if since_ns < k::RELOCATION_AFTER_NS {
                continue;
            }
            relocation.collect(input, calibrated, field, bodies);
            if let Some(found) = relocation.place().filter(|_| self.trial.is_none()) {
                self.take_back(camera, &found);
                return Some((camera, found));
            }
            if since_ns > k::RELOCATION_LONGEST_NS && relocation.complain() {
                self.notice = Some(Notice::Restless { camera });
            }
            return relocation.rough().filter(|_| self.trial.is_none()).map(|rough| (camera, rough));
        }
        None
    }

    fn take_back(&mut self, camera: usize, found: &Camera) {
        let px = self.calibrated[camera].as_ref().map_or(0.0, |c| picture_shift(c, found));
        self.standing[camera] = Standing::Trusted;
        self.returns[camera] += 1;
        self.estimated |= 1 << camera;
        self.clear_evidence();
        self.notice = Some(Notice::TakenBack { camera, px });
    }

    /// True if a camera may be left out for a search.
    pub fn may_leave_out(&self, camera: usize) -> bool {
        let in_use = self.in_use();
        self.left_out() == 0 && in_use & (1 << camera) != 0 && in_use.count_ones() >= 3
    }
}

/// Jacobian of an image by the turn and shift of its camera.
fn camera_jacobian(camera: &Camera, image: &MarkerImage) -> CameraJacobian {
    jacobian(camera, &image.jacobian, &image.point)
}

/// The same from the Jacobian by the point in the world.
fn jacobian(camera: &Camera, by_point: &Matrix2x3<f64>, point: &Point3<f64>) -> CameraJacobian {
    let by_camera_point: Matrix2x3<f64> = by_point * camera.camera_from_world.transpose();
    let turning = -(by_camera_point * camera.in_camera(point).cross_matrix());
    let mut jacobian = CameraJacobian::zeros();
    jacobian.fixed_view_mut::<2, 3>(0, 0).copy_from(&(turning * k::KNOCK_TURN_RAD));
    jacobian.fixed_view_mut::<2, 3>(0, 3).copy_from(&(by_camera_point * k::KNOCK_SHIFT_MM));
    jacobian
}

/// A camera after a turn and shift in those units.
fn moved(camera: &Camera, delta: &Vector6) -> Camera {
    let turn = Rotation3::new(Vector3::new(delta[0], delta[1], delta[2]) * k::KNOCK_TURN_RAD);
    let shift = Vector3::new(delta[3], delta[4], delta[5]) * k::KNOCK_SHIFT_MM;
    Camera {
        camera_from_world: turn.matrix() * camera.camera_from_world,
        translation_mm: turn * camera.translation_mm + shift,
        ..camera.clone()
    }
}

/// Mean distance of the images of points of the workspace in two cameras, px.
fn picture_shift(a: &Camera, b: &Camera) -> f64 {
    let at = [-8.0, 0.0, 8.0];
    let points = at.iter().flat_map(|x| at.iter().map(move |y| Point3::new(*x, *y, 0.0)));
    let apart = points.filter_map(|p| Some((a.project(&p)? - b.project(&p)?).norm()));
    let (sum, count) = apart.fold((0.0, 0), |(sum, n), px| (sum + px, n + 1));
    sum / f64::from(count.max(1))
}

/// Solves (N + I)·x = b.
fn solve(information: &Matrix6, gradient: &Vector6) -> Option<Vector6> {
    (information + Matrix6::identity()).cholesky().map(|c| c.solve(gradient))
}
