//! From camera-fields to poses. Pure: the state depends on the consumed fields in their order only.

use crate::associate::{Associator, Group};
use crate::body::Track;
use crate::constants as k;
use crate::drift::{Drift, Report};
use crate::estimate::Estimate;
use crate::filter::exp;
use crate::fit::{Fit, MAX_MATCHES, Match, Problem, TrocarInWorld, trocar_miss};
use crate::hand::Pivot;
use crate::model::RigModel;
use crate::roll;
use crate::seed::{Scene, Searcher};
use crate::sight::View;
use bytemuck::Zeroable;
use nalgebra::{Matrix3, Vector3};
use protocol::blobs::BlobField;
use protocol::limits::{BODIES, MAX_CAMERAS, MAX_FIELDS_USED};
use protocol::poses::{BodyStatus, ClosedBy, EYE, FieldUsed, TrackerFrame};
use protocol::rig::Rig;

/// The exposure that a frame is for.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub struct Reference {
    /// Camera id.
    pub camera: u32,
    /// Field number of that camera.
    pub field: u64,
    /// Middle of the exposure.
    pub exposed_ns: u64,
}

/// Order of the fits: the eye carries the trocars.
const ORDER: [usize; BODIES] = [EYE, 0, 1];

/// The tracker.
pub struct Tracker {
    rig: RigModel,
    drift: Option<Drift>,
    tracks: [Track; BODIES],
    views: Box<[View; MAX_CAMERAS]>,
    area_scales: [f64; MAX_CAMERAS],
    matches: [Vec<Match>; BODIES],
    first_matches: [Vec<Match>; BODIES],
    fits: [Option<Fit>; BODIES],
    /// Fits of the newest update that were believed.
    updates: [Option<Fit>; BODIES],
    associator: Associator,
    searcher: Searcher,
    last_ns: u64,
    frame: u64,
    in_frame: u32,
    blobs_refused: u64,
}

impl Tracker {
    /// A fresh tracker for a checked rig.
    pub fn new(rig: &Rig) -> Self {
        Tracker::with(rig, true)
    }

    /// A fresh tracker that estimates how far the rig has drifted, or trusts the rig file.
    pub fn with(rig: &Rig, estimate_drift: bool) -> Self {
        let rig = RigModel::new(rig);
        Tracker {
            drift: estimate_drift.then(|| Drift::new(&rig)),
            rig,
            tracks: Default::default(),
            views: Box::new(std::array::from_fn(View::empty)),
            area_scales: [1.0; MAX_CAMERAS],
            matches: std::array::from_fn(|_| Vec::with_capacity(MAX_MATCHES)),
            first_matches: std::array::from_fn(|_| Vec::with_capacity(MAX_MATCHES)),
            fits: [None; BODIES],
            updates: [None; BODIES],
            associator: Associator::default(),
            searcher: Searcher::default(),
            last_ns: 0,
            frame: 0,
            in_frame: 0,
            blobs_refused: 0,
        }
    }

    /// Blobs ignored since the start: not finite, without size or far outside of the frame.
    pub fn blobs_refused(&self) -> u64 {
        self.blobs_refused
    }

    /// Forgets everything; the next frame has number 0.
    pub fn reset(&mut self) {
        self.forget();
        if let Some(drift) = &mut self.drift {
            drift.reset(&mut self.rig);
        }
        self.frame = 0;
    }

    /// How far the rig has drifted; `None` where that is not estimated.
    pub fn drift(&self) -> Option<&Report> {
        self.drift.as_ref().map(Drift::report)
    }

    fn forget(&mut self) {
        self.tracks = Default::default();
        self.area_scales = [1.0; MAX_CAMERAS];
        self.last_ns = 0;
        for view in self.views.iter_mut() {
            view.exposed_ns = 0;
        }
    }

    /// Consumes `used` in this order and answers for the exposure `reference`. The shell fills in
    /// the instants but `exposed`, the wait, and how the frame was closed.
    pub fn track(&mut self, used: &[BlobField], reference: &Reference) -> TrackerFrame {
        let mut frame = TrackerFrame::zeroed();
        frame.field = reference.field;
        frame.camera = reference.camera;
        frame.frame = self.frame;
        frame.instants.exposed = reference.exposed_ns;
        self.frame += 1;
        self.in_frame = 0;
        self.updates = [None; BODIES];
        for track in &mut self.tracks {
            track.begin_frame();
        }
        let used = &used[..used.len().min(MAX_FIELDS_USED)];
        let mut rest = used;
        while !rest.is_empty() {
            let (group, after) = rest.split_at(self.group_len(rest));
            self.consume(group, reference);
            self.book(group, used.len() - rest.len(), &mut frame);
            rest = after;
        }
        self.learn_drift();
        self.advance(reference.exposed_ns);
        for (body, track) in self.tracks.iter_mut().enumerate() {
            frame.bodies[body] = track.state(&self.rig, body, reference.exposed_ns, self.in_frame);
        }
        frame
    }

    /// How many of the next fields belong to one instant: close together, each camera once.
    fn group_len(&self, fields: &[BlobField]) -> usize {
        let mut cameras = 0u32;
        for (i, field) in fields.iter().enumerate() {
            let bit = 1u32.checked_shl(field.camera).unwrap_or(0);
            let close = field.exposed_ns.abs_diff(fields[0].exposed_ns) <= k::GROUP_NS;
            if i > 0 && (!close || cameras & bit != 0) {
                return i;
            }
            cameras |= bit;
        }
        fields.len()
    }

    fn book(&self, group: &[BlobField], first: usize, frame: &mut TrackerFrame) {
        for (i, field) in group.iter().enumerate() {
            let view = self.views.get(field.camera as usize);
            let blobs_used = view.map_or(0, |v| v.taken.count_ones());
            frame.used[first + i] = FieldUsed {
                field: field.field,
                exposed_ns: field.exposed_ns,
                camera: field.camera,
                blobs_used,
            };
        }
        frame.used_count = (first + group.len()) as u32;
    }

    /// One update with the fields of one instant.
    fn consume(&mut self, group: &[BlobField], reference: &Reference) {
        let first_ns = group[0].exposed_ns;
        let with_reference = group.iter().any(|f| f.exposed_ns == reference.exposed_ns);
        let base_ns = if with_reference { reference.exposed_ns } else { first_ns };
        let mut cameras = 0u32;
        for field in group {
            let Some(Some(camera)) = self.rig.cameras.get(field.camera as usize) else { continue };
            let refused = self.views[field.camera as usize].fill(field, camera);
            self.blobs_refused = self.blobs_refused.saturating_add(u64::from(refused));
            cameras |= 1 << field.camera;
        }
        if cameras == 0 {
            return;
        }
        if self.last_ns > 0 && base_ns.abs_diff(self.last_ns) > k::MAX_GAP_NS {
            for track in &mut self.tracks {
                *track = Track::default();
            }
            self.last_ns = 0;
        }
        // A field that came late is used at its own instant, from the newer state.
        let base_ns = base_ns.max(self.last_ns);
        self.last_ns = base_ns;
        self.in_frame |= cameras;
        self.advance(base_ns);
        self.update(cameras, base_ns);
        self.search(base_ns);
    }

    /// Carries all bodies to an instant, the eye first: it carries the trocars.
    fn advance(&mut self, at_ns: u64) {
        for body in ORDER {
            let pivot = self.pivot(body, at_ns);
            self.tracks[body].advance(at_ns, pivot);
        }
    }

    /// Updates the bodies that are tracked: assign and fit, then again about the poses that were
    /// found where that changes the assignment; then take the result over.
    fn update(&mut self, cameras: u32, base_ns: u64) {
        self.fits = [None; BODIES];
        self.updates = [None; BODIES];
        let mut no_choice = self.assign(cameras, base_ns);
        if self.startle() {
            no_choice = self.assign(cameras, base_ns);
        }
        for body in ORDER {
            self.fits[body] = self.fit(body);
        }
        let rolled = self.find_rolls(cameras, base_ns);
        let no_choice = no_choice && rolled == [false; BODIES];
        if no_choice && self.fits.iter().flatten().all(|fit| fit.thrown_out == 0) {
            for body in ORDER {
                self.take(body, base_ns);
            }
            return;
        }
        std::mem::swap(&mut self.matches, &mut self.first_matches);
        self.assign(cameras, base_ns);
        for body in ORDER {
            if !rolled[body] && same_assignment(&self.first_matches[body], &self.matches[body]) {
                std::mem::swap(&mut self.matches[body], &mut self.first_matches[body]);
            } else {
                self.fits[body] = self.fit(body);
            }
            self.take(body, base_ns);
        }
    }

    /// Looks for instruments that rolled otherwise than foreseen, by the markers beside their shafts, and
    /// turns their fits there. True for those that did.
    fn find_rolls(&mut self, cameras: u32, base_ns: u64) -> [bool; BODIES] {
        let group =
            Group { rig: &self.rig, views: &self.views, cameras, base_ns, area_scales: &self.area_scales };
        std::array::from_fn(|body| {
            let track = &mut self.tracks[body];
            let (Some(mut expected), Some(fit)) = (track.expected(), &mut self.fits[body]) else {
                return false;
            };
            let Some(Estimate::Hand(hand)) = &mut track.filter else { return false };
            (expected.pose, expected.covariance) = (fit.pose, fit.covariance);
            let Some(turn) = roll::find(&group, body, &expected, &self.matches) else { return false };
            let since_ns = base_ns.saturating_sub(track.roll_ns);
            // One camera alone may see something else.
            if turn.cameras < 2 && since_ns < k::SEARCH_AFTER_NS {
                return false;
            }
            hand.startle_roll(turn.rad, since_ns as f64 * 1e-9);
            let axis = fit.pose.rotation * Vector3::z();
            fit.pose.rotation = exp(axis * turn.rad) * fit.pose.rotation;
            let mut doubt = fit.covariance.fixed_view_mut::<3, 3>(3, 3);
            doubt += axis * axis.transpose() * (k::ROLL_AGREES_RAD * k::ROLL_AGREES_RAD);
            true
        })
    }

    /// The drift learns from one body per frame, from the blobs of its newest update.
    fn learn_drift(&mut self) {
        let Some(drift) = &mut self.drift else { return };
        let body = drift.next_body();
        if let (Some(fit), Some(filter)) = (&self.updates[body], &self.tracks[body].filter) {
            drift.learn(&self.rig, body, &fit.pose, &filter.motion(), &self.matches[body]);
        }
        drift.step(&mut self.rig);
    }

    fn assign(&mut self, cameras: u32, base_ns: u64) -> bool {
        let expected = std::array::from_fn(|body| {
            let mut expected = self.tracks[body].expected()?;
            if let Some(fit) = &self.fits[body] {
                (expected.pose, expected.covariance) = (fit.pose, fit.covariance);
            }
            Some(expected)
        });
        let group =
            Group { rig: &self.rig, views: &self.views, cameras, base_ns, area_scales: &self.area_scales };
        self.associator.associate(&group, &expected, &mut self.matches)
    }

    fn fit(&mut self, body: usize) -> Option<Fit> {
        let track = &self.tracks[body];
        let filter = track.filter.as_ref()?;
        let problem = Problem::of_filter(&self.rig, &self.rig.bodies[body], filter, track.variance_scale)?;
        let start = self.fits[body].map_or(problem.prior, |f| f.pose);
        let matches = &mut self.matches[body];
        if matches.is_empty() { None } else { problem.solve(&start, matches) }
    }

    /// Where the trocar of a body is now, by the eye's newest rotation.
    fn trocar(&self, body: usize) -> Option<TrocarInWorld> {
        let trocar = self.rig.bodies[body].trocar?;
        let eye = self.tracks[EYE].filter.as_ref()?;
        let (pose, covariance) = match &self.fits[EYE] {
            Some(fit) => (fit.pose, fit.covariance),
            None => (eye.pose(), eye.pose_covariance()),
        };
        let turn: Matrix3<f64> = covariance.fixed_view::<3, 3>(3, 3).into();
        let doubt = turn.trace().max(0.0) / 3.0 * trocar.position_in_eye.coords.norm_squared();
        let sigma = libm::sqrt(trocar.sigma * trocar.sigma + doubt);
        Some((pose.rotation * trocar.position_in_eye, sigma))
    }

    /// Opens the gates of instruments whose blobs are beside where they should be. True if there is one.
    fn startle(&mut self) -> bool {
        let mut startled = false;
        for body in (0..BODIES).filter(|b| *b != EYE) {
            let beside = self.associator.strays[body] as usize;
            if beside < k::BESIDE || beside <= self.matches[body].len() {
                continue;
            }
            if let Some(Estimate::Hand(hand)) = &mut self.tracks[body].filter {
                hand.startle();
                startled = true;
            }
        }
        startled
    }

    /// The trocar that an instrument's shaft passes at `base_ns`, if the eye is tracked.
    fn pivot(&self, body: usize, base_ns: u64) -> Option<Pivot> {
        let trocar = self.rig.bodies[body].trocar?;
        let eye = self.tracks[EYE].filter.as_ref()?;
        let dt = base_ns.wrapping_sub(eye.time_ns()) as i64 as f64 * 1e-9;
        let position = eye.pose_after(dt).rotation * trocar.position_in_eye.coords;
        Some(Pivot { position, sigma: trocar.sigma, carried: true })
    }

    fn take(&mut self, body: usize, base_ns: u64) {
        let Some(fit) = self.fits[body] else { return };
        let track = &mut self.tracks[body];
        track.disturbed(self.associator.strays[body]);
        let Some(prior) = track.filter.as_ref().and_then(|f| f.pose_covariance().cholesky()) else { return };
        if !track.take_fit(&fit, &prior.inverse(), &self.matches[body], base_ns) {
            return;
        }
        track.note_roll(&self.rig.bodies[body], &self.matches[body], base_ns);
        self.updates[body] = Some(fit);
        for m in self.matches[body].iter().filter(|m| !m.out) {
            self.views[m.camera].take(m.blob);
            let scale = &mut self.area_scales[m.camera];
            // The median: a step up or down, whatever the distance.
            *scale *= 1.0 + k::AREA_SCALE_STEP * if m.area_ratio > *scale { 1.0 } else { -1.0 };
            *scale = scale.clamp(0.4, 2.5);
        }
        let strayed = self.trocar(body).is_some_and(|(trocar, sigma)| {
            trocar_miss(&fit.pose, &trocar).norm() > k::TROCAR_MISS_MM + 3.0 * sigma
        });
        if strayed {
            self.tracks[body].lose();
        }
    }

    /// Looks for bodies that are lost, or soon will be.
    fn search(&mut self, base_ns: u64) {
        self.fits = [None; BODIES];
        for body in ORDER {
            let trocar = self.trocar(body);
            let needs_trocar = body != EYE && !self.rig.colours_tell && trocar.is_none();
            if !self.tracks[body].wants_search(base_ns) || needs_trocar {
                continue;
            }
            let scene =
                Scene { rig: &self.rig, views: &self.views, base_ns, trocar, area_scales: &self.area_scales };
            let Some(fit) = self.searcher.search(&scene, &self.rig.bodies[body]) else { continue };
            let pivot = self.pivot(body, base_ns);
            let matches = &self.searcher.matches;
            self.tracks[body].take_seed(&fit, &self.rig.bodies[body], matches, base_ns, self.in_frame, pivot);
            for m in matches.iter().filter(|m| !m.out) {
                self.views[m.camera].take(m.blob);
            }
        }
    }
}

/// Notes how a frame was closed. Where the next field of the reference camera came first, the tracker
/// fell behind, and no body is better than that.
pub fn close(frame: &mut TrackerFrame, closed_by: ClosedBy) {
    frame.closed_by = closed_by as u32;
    if closed_by == ClosedBy::NextField {
        for body in frame.bodies.iter_mut().filter(|b| b.status != BodyStatus::Lost as u32) {
            body.status = BodyStatus::FellBehind as u32;
        }
    }
}

/// True if the second assignment, about the fitted pose, is that of the first less what was thrown out.
fn same_assignment(first: &[Match], second: &[Match]) -> bool {
    let kept = first.iter().filter(|m| !m.out).count();
    let known = |m: &Match| {
        let same = |n: &&Match| (n.camera, n.marker, n.blob) == (m.camera, m.marker, m.blob);
        first.iter().find(same).is_some_and(|n| !n.out)
    };
    kept == second.len() && second.iter().all(known)
}
