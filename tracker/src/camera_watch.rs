//! Cameras that were moved since the rig was calibrated: detected, left out, resected (their pose is
//! estimated from markers that the other cameras locate), and used again.
//!
//! | state of a camera | use of its fields | until |
//! |---|---|---|
//! | trusted | tracking | all markers of a field jump together, or residuals accumulate that only a moved camera explains |
//! | suspected | tracking, except fields that jump | several fields in a row jump, or several do not |
//! | left out | resection | the resected pose explains its newest fields |
//!
//! A camera is left out on trial: where the two that remain disagree, it is used again and another one is
//! left out. Two cameras alone do not show which of them was moved.

mod evidence;
mod jump;
mod resection;
mod saved;
mod sighting;

use crate::associate::{AssociationInput, PredictedBody};
use crate::constants as k;
use crate::pose_math::{Matrix6, Vector6};
use crate::projection::{camera_jacobian, moved_camera};
use crate::rig_model::RigModel;
pub use evidence::BodyUpdate;
use evidence::Evidence;
use nalgebra::{Matrix2x3, Point3, SMatrix, Vector3};
use protocol::limits::{BODIES, MAX_CAMERAS};
use resection::Resection;
use rig::camera::Camera;
use serde::{Deserialize, Serialize};
use std::collections::VecDeque;

/// Notices kept until they are taken.
const NOTICES: usize = 16;

/// Jacobian of a pixel by the turn and shift of its camera, in units of [`k::KNOCK_TURN_RAD`] and
/// [`k::KNOCK_SHIFT_MM`].
type CameraJacobian = SMatrix<f64, 2, 6>;

/// State of a camera.
#[derive(Debug, Clone, Copy, PartialEq, Serialize, Deserialize)]
enum State {
    Trusted,
    Suspected {
        /// Fields that jumped.
        jumped: u32,
        /// Fields since the last one that jumped.
        calm: u32,
    },
    LeftOut {
        since_ns: u64,
    },
}

/// A field whose markers lie off their predictions together.
#[derive(Debug, Clone, Copy, Serialize, Deserialize)]
struct Jump {
    at_ns: u64,
    px: f64,
}

impl State {
    /// After one more field.
    fn after(self, jumps: bool, calm_fields: u32) -> Self {
        match (self, jumps) {
            (State::Suspected { jumped, .. }, true) => State::Suspected { jumped: jumped + 1, calm: 0 },
            (_, true) => State::Suspected { jumped: 1, calm: 0 },
            (State::Suspected { jumped, calm }, false) if calm + 1 < calm_fields => {
                State::Suspected { jumped, calm: calm + 1 }
            }
            (_, false) => State::Trusted,
        }
    }
}

/// A change of a camera's state, for the log.
#[derive(Debug, Clone, Copy, PartialEq, Serialize, Deserialize)]
pub enum Notice {
    /// It was moved and is left out.
    Moved {
        /// Camera id.
        camera: usize,
        /// By how much its picture moved as far as was seen, px; 0 where that is not known.
        px: f64,
    },
    /// The others disagree without it too: it is used again as calibrated.
    Cleared {
        /// Camera id.
        camera: usize,
    },
    /// It was resected and is used again.
    TakenBack {
        /// Camera id.
        camera: usize,
        /// By how much its picture had moved, px.
        px: f64,
    },
    /// It goes on moving.
    StillMoving {
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
                let by = if *px > 0.0 { format!("{px:.1} px or more") } else { "too far".into() };
                write!(
                    f,
                    "camera {camera}'s blobs are {by} from where the other cameras place the markers; it is \
                     excluded, and its pose is estimated from the others"
                )
            }
            Notice::Cleared { camera } => {
                write!(
                    f,
                    "camera {camera} is used again with its pose in the rig file: the others disagree \
                     without it too"
                )
            }
            Notice::TakenBack { camera, px } => write!(
                f,
                "camera {camera} is used again with a pose estimated from the others; against its pose in the rig \
                 file, the picture shifts by {px:.1} px"
            ),
            Notice::StillMoving { camera } => {
                write!(f, "camera {camera}'s estimated pose keeps changing; it stays excluded")
            }
            Notice::Disagree { cameras } => {
                let ids: Vec<String> =
                    (0..32).filter(|c| cameras & (1 << c) != 0).map(|c| c.to_string()).collect();
                let ids = ids.join(", ");
                write!(f, "cameras {ids} disagree about where the markers are, whichever one is excluded")
            }
        }
    }
}

/// A decision that the other cameras must bear out.
#[derive(Debug, Clone, Copy, Serialize, Deserialize)]
struct Trial {
    since_ns: u64,
    camera: usize,
    /// Cameras that were tried.
    tried: u32,
}

/// Watches the cameras of a rig.
#[derive(Clone)]
pub struct CameraWatch {
    calibrated: [Option<Camera>; MAX_CAMERAS],
    states: [State; MAX_CAMERAS],
    jumps: [Option<Jump>; MAX_CAMERAS],
    evidence: Box<[Evidence; MAX_CAMERAS]>,
    resections: [Option<Box<Resection>>; MAX_CAMERAS],
    /// How often each was taken back.
    returns: [u32; MAX_CAMERAS],
    estimated: u32,
    trial: Option<Trial>,
    /// No judgement before this instant, ns.
    quiet_until_ns: u64,
    /// The cameras count as in disagreement until this instant, ns.
    disagree_until_ns: u64,
    /// Time within which jumps of two cameras belong together, ns.
    together_ns: u64,
    notices: VecDeque<Notice>,
    /// Set of the cameras left out since the tracker asked last.
    newly_left_out: u32,
}

impl CameraWatch {
    /// For a rig as calibrated.
    pub fn new(rig: &RigModel) -> Self {
        CameraWatch {
            calibrated: rig.cameras.clone(),
            states: [State::Trusted; MAX_CAMERAS],
            jumps: [None; MAX_CAMERAS],
            evidence: Box::new(std::array::from_fn(|_| Evidence::default())),
            resections: std::array::from_fn(|c| rig.cameras[c].as_ref().map(|_| Box::default())),
            returns: [0; MAX_CAMERAS],
            estimated: 0,
            trial: None,
            quiet_until_ns: 0,
            disagree_until_ns: 0,
            together_ns: rig.at_rate.together_ns,
            notices: VecDeque::with_capacity(NOTICES),
            newly_left_out: 0,
        }
    }

    /// Set of the cameras that are left out.
    pub fn left_out(&self) -> u32 {
        self.set(|s| matches!(s, State::LeftOut { .. }))
    }

    /// Set of the cameras that stand where they were estimated to be, and not where the rig has them.
    pub fn estimated(&self) -> u32 {
        self.estimated
    }

    /// True while cameras disagree and leaving out one of them has not helped, or none does: poses may be far off.
    pub fn disagrees(&self, time_ns: u64) -> bool {
        let is_second = |trial: Trial| trial.tried.count_ones() > 1;
        time_ns < self.disagree_until_ns || self.trial.is_some_and(is_second)
    }

    /// The oldest change that was not taken yet.
    pub fn take_notice(&mut self) -> Option<Notice> {
        self.notices.pop_front()
    }

    /// Set of the cameras left out since the last call.
    pub fn take_newly_left_out(&mut self) -> u32 {
        std::mem::take(&mut self.newly_left_out)
    }

    fn note(&mut self, notice: Notice) {
        if self.notices.len() == NOTICES {
            self.notices.pop_front();
        }
        self.notices.push_back(notice);
    }

    fn set(&self, wanted: impl Fn(&State) -> bool) -> u32 {
        let bit = |(c, s): (usize, &State)| u32::from(wanted(s) && self.calibrated[c].is_some()) << c;
        self.states.iter().enumerate().map(bit).sum()
    }

    /// Set of the cameras that are not left out.
    pub fn in_use(&self) -> u32 {
        self.set(|s| !matches!(s, State::LeftOut { .. }))
    }

    /// Set of the cameras of a group whose fields are tracked, as far as they do not jump; `is_short` says that a
    /// tracked body is not seen by two cameras in use.
    pub fn admit(&self, input: &AssociationInput<'_>, is_short: bool) -> u32 {
        let provisional = if is_short || !self.two_send(input) { self.provisional(input) } else { 0 };
        input.cameras & (self.in_use() | provisional)
    }

    /// True if two cameras in use send fields.
    pub fn two_send(&self, input: &AssociationInput<'_>) -> bool {
        let sends = |c: &usize| {
            input.time_ns.saturating_sub(input.fields[*c].exposed_ns) < input.rig.at_rate.silent_ns
        };
        members(self.in_use()).filter(sends).count() >= 2
    }

    /// Set of the cameras of a group whose fields do not jump. `matched` is the number of markers with a
    /// blob in their gate, by camera: where most have one, the field did not jump.
    pub fn without_jumps(
        &mut self,
        input: &AssociationInput<'_>,
        matched: &[u32; MAX_CAMERAS],
        predicted: &[Option<PredictedBody>; BODIES],
    ) -> u32 {
        let in_use = input.cameras & self.in_use();
        let of_body = |(body, p): (usize, &Option<_>)| {
            if p.is_some() { input.rig.bodies[body].markers.len() as u32 } else { 0 }
        };
        let markers: u32 = predicted.iter().enumerate().map(of_body).sum();
        for field in input.fields().filter(|f| in_use & (1 << f.camera) != 0) {
            let most = 4 * matched[field.camera] >= 3 * markers;
            let px = if most { None } else { jump::of_field(input, field, predicted) };
            self.jumps[field.camera] = px.map(|px| Jump { at_ns: input.time_ns, px });
        }
        let at_rate = &input.rig.at_rate;
        let mut steady = input.cameras;
        for camera in members(in_use) {
            let jump = self.jumps[camera].filter(|_| self.jumped_alone(camera, input.time_ns));
            if jump.is_some() {
                steady &= !(1 << camera);
            }
            self.states[camera] = self.states[camera].after(jump.is_some(), at_rate.calm_fields(camera));
            match (self.states[camera], jump) {
                (State::Suspected { jumped, .. }, Some(jump)) if jumped >= at_rate.jumping_fields(camera) => {
                    self.accuse(camera, jump.px, input.time_ns);
                }
                _ => {}
            }
        }
        steady
    }

    /// Set of the left-out cameras that have a provisional pose, with which they are tracked where the others do
    /// not suffice.
    pub fn provisional(&self, input: &AssociationInput<'_>) -> u32 {
        if !self.may_place(input.time_ns) {
            return 0;
        }
        let known = |c: &usize| self.resections[*c].as_ref().is_some_and(|r| r.provisional().is_some());
        members(self.left_out()).filter(known).map(|c| 1 << c).sum()
    }

    /// True if what the remaining cameras locate may be used to place another one.
    fn may_place(&self, time_ns: u64) -> bool {
        self.trial.is_none() && time_ns >= self.quiet_until_ns
    }

    /// True if a camera alone jumped, so that it and not the prediction is wrong, and two others remain.
    fn jumped_alone(&self, camera: usize, time_ns: u64) -> bool {
        let others = self.in_use() & !(1 << camera);
        let jumped =
            |c: usize| self.jumps[c].is_some_and(|j| time_ns.saturating_sub(j.at_ns) < self.together_ns);
        time_ns >= self.quiet_until_ns && others.count_ones() >= 2 && !members(others).any(jumped)
    }

    /// Adds what an update of a body says about the cameras.
    pub fn add(&mut self, input: &AssociationInput<'_>, update: &BodyUpdate<'_>) {
        // The filters need some time to forget the camera that was left out.
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
        let remaining = in_use.count_ones();
        match (self.trial, verdict) {
            (_, Some((camera, px))) if remaining >= 3 => self.accuse(camera, px, time_ns),
            (Some(trial), Some((_, px))) => self.try_another(trial, in_use, px, time_ns),
            (Some(trial), None) if time_ns.saturating_sub(trial.since_ns) > k::KNOCK_TRIAL_NS => {
                // Cameras that do not find the eye together disagree; a silent one does not count.
                if members(in_use).any(|c| self.evidence[c].misses_eye()) {
                    self.try_another(trial, in_use, 0.0, time_ns);
                } else {
                    self.trial = None;
                    self.disagree_until_ns = 0;
                }
            }
            _ => {}
        }
    }

    /// The camera with the largest gain and the shift of its picture, px, if it was moved and a field of it
    /// is in `group`.
    fn verdict(&self, in_use: u32, group: u32) -> Option<(usize, f64)> {
        let gains = members(in_use).map(|c| (c, self.evidence[c].gain()));
        let (camera, _) = gains.max_by(|a, b| a.1.total_cmp(&b.1))?;
        let px = self.evidence[camera].verdict().filter(|_| group & (1 << camera) != 0)?;
        Some((camera, px))
    }

    /// The two cameras that remain disagree: uses the one on trial again and leaves out another.
    fn try_another(&mut self, trial: Trial, in_use: u32, px: f64, time_ns: u64) {
        self.states[trial.camera] = State::Trusted;
        self.note(Notice::Cleared { camera: trial.camera });
        let untried = members(in_use & !trial.tried).next();
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
            self.states[trial.camera] = State::Trusted;
        }
        self.clear_evidence();
        self.quiet_until_ns = time_ns + k::KNOCK_QUIET_NS;
        self.disagree_until_ns = self.quiet_until_ns + k::KNOCK_AGAIN_NS;
        self.note(Notice::Disagree { cameras: self.in_use() });
    }

    /// Leaves out a camera, on trial.
    pub fn accuse(&mut self, camera: usize, px: f64, time_ns: u64) {
        self.trial = Some(Trial { since_ns: time_ns, camera, tried: 1 << camera });
        self.leave_out(camera, px, time_ns);
    }

    fn leave_out(&mut self, camera: usize, px: f64, time_ns: u64) {
        self.states[camera] = State::LeftOut { since_ns: time_ns };
        if let Some(resection) = &mut self.resections[camera] {
            resection.begin(k::RESECTION_FIELDS << self.returns[camera].min(4));
        }
        self.clear_evidence();
        self.newly_left_out |= 1 << camera;
        self.note(Notice::Moved { camera, px });
    }

    fn clear_evidence(&mut self) {
        self.evidence.iter_mut().for_each(|e| *e = Evidence::default());
    }

    /// Continues the resection of a camera that is left out with its newest field. Returns its pose, once
    /// that is known well enough to be used. The bodies are where the other cameras locate them.
    pub fn resect(
        &mut self,
        camera: usize,
        input: &AssociationInput<'_>,
        bodies: &[Option<PredictedBody>; BODIES],
    ) -> Option<Camera> {
        let State::LeftOut { since_ns } = self.states[camera] else { return None };
        let since_ns = input.time_ns.saturating_sub(since_ns);
        if since_ns < k::RESECTION_AFTER_NS || !input.rig.at_rate.looks_at_camera(camera, input.time_ns) {
            return None;
        }
        let may_place = self.may_place(input.time_ns);
        let resection = self.resections[camera].as_mut()?;
        resection.add_field(input, self.calibrated[camera].as_ref()?, &input.fields[camera], bodies);
        if let Some(found) = resection.accepted().filter(|_| may_place) {
            self.take_back(camera, &found);
            return Some(found);
        }
        let provisional = resection.provisional().filter(|_| may_place);
        if since_ns > k::RESECTION_LONGEST_NS && resection.first_overrun() {
            self.note(Notice::StillMoving { camera });
        }
        provisional
    }

    fn take_back(&mut self, camera: usize, found: &Camera) {
        let px = self.calibrated[camera].as_ref().map_or(0.0, |c| picture_shift(c, found));
        self.states[camera] = State::Trusted;
        self.returns[camera] += 1;
        self.estimated |= 1 << camera;
        self.clear_evidence();
        self.note(Notice::TakenBack { camera, px });
    }

    /// True if a camera may be left out for a search.
    pub fn may_leave_out(&self, camera: usize) -> bool {
        let in_use = self.in_use();
        self.left_out() == 0 && in_use & (1 << camera) != 0 && in_use.count_ones() >= 3
    }
}

/// Jacobian of an image by the turn and shift of its camera, in those units.
fn scaled_jacobian(camera: &Camera, by_point: &Matrix2x3<f64>, point: &Point3<f64>) -> CameraJacobian {
    let mut jacobian = camera_jacobian(camera, by_point, point);
    jacobian.fixed_view_mut::<2, 3>(0, 0).scale_mut(k::KNOCK_TURN_RAD);
    jacobian.fixed_view_mut::<2, 3>(0, 3).scale_mut(k::KNOCK_SHIFT_MM);
    jacobian
}

/// A camera after a turn and shift in those units.
fn moved(camera: &Camera, delta: &Vector6) -> Camera {
    let [turn, shift]: [Vector3<f64>; 2] = [0, 3].map(|row| delta.fixed_rows::<3>(row).into());
    moved_camera(camera, turn * k::KNOCK_TURN_RAD, shift * k::KNOCK_SHIFT_MM)
}

/// Mean distance of the images of points of the workspace in two cameras, px.
fn picture_shift(a: &Camera, b: &Camera) -> f64 {
    let at = [-8.0, 0.0, 8.0];
    let points = at.iter().flat_map(|x| at.iter().map(move |y| Point3::new(*x, *y, 0.0)));
    let apart = points.filter_map(|p| Some((a.project(&p)? - b.project(&p)?).norm()));
    let (sum, count) = apart.fold((0.0, 0), |(sum, n), px| (sum + px, n + 1));
    sum / f64::from(count.max(1))
}

/// Ids of a set of cameras.
pub fn members(set: u32) -> impl Iterator<Item = usize> {
    (0..MAX_CAMERAS).filter(move |c| set & (1 << c) != 0)
}

/// Solves (N + I)·x = b.
fn solve(information: &Matrix6, gradient: &Vector6) -> Option<Vector6> {
    (information + Matrix6::identity()).cholesky().map(|c| c.solve(gradient))
}
