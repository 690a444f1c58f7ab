//! The phases of an update: observe, associate, estimate, filter, acquire.

use super::{Group, ORDER, Reference, Tracker};
use crate::acquisition::AcquisitionInput;
use crate::associate::{Association, AssociationInput, PredictedBody};
use crate::body_filter::BodyFilter;
use crate::camera_watch::{BodyUpdate, CameraWatch, members};
use crate::fit::{BlobMatch, PoseFit, PoseProblem, TrocarInWorld, trocar_miss};
use crate::observation::FieldObservation;
use crate::pose_math::{Matrix6, box_minus, exp};
use crate::rig_model::RigModel;
use crate::track::Track;
use crate::{constants as k, roll_recovery};
use nalgebra::{Matrix3, Vector3};
use protocol::blobs::BlobField;
use protocol::limits::{BODIES, MAX_CAMERAS};
use protocol::poses::EYE;

/// Fits by body.
pub(super) type Fits = [Option<PoseFit>; BODIES];

/// Poses fitted to associated blobs.
pub(super) struct Estimate {
    pub association: Association,
    pub fits: Fits,
}

impl Group {
    pub(super) fn input<'a>(
        self,
        rig: &'a RigModel,
        fields: &'a [FieldObservation; MAX_CAMERAS],
        area_scales: &'a [f64; MAX_CAMERAS],
    ) -> AssociationInput<'a> {
        AssociationInput { rig, fields, cameras: self.cameras, time_ns: self.time_ns, area_scales }
    }
}

impl Tracker {
    /// Takes the fields of one instant into the observations. Tracks end where the stream has a
    /// gap. `None` where no field is of a camera of the rig.
    pub(super) fn observe(&mut self, fields: &[BlobField], reference: &Reference) -> Option<Group> {
        let with_reference = fields.iter().any(|f| f.exposed_ns == reference.exposed_ns);
        let time_ns = if with_reference { reference.exposed_ns } else { fields[0].exposed_ns };
        let mut cameras = 0u32;
        for field in fields {
            let Some(Some(camera)) = self.rig.cameras.get(field.camera as usize) else { continue };
            let refused = self.fields[field.camera as usize].fill(field, camera, &self.rig.tuning);
            self.blobs_refused = self.blobs_refused.saturating_add(u64::from(refused));
            cameras |= 1 << field.camera;
        }
        if cameras == 0 {
            return None;
        }
        if self.last_ns > 0 && time_ns.abs_diff(self.last_ns) > k::MAX_GAP_NS {
            self.forget_tracks();
            self.last_ns = 0;
        }
        // A field that came late is used at its own instant, from the newer state.
        self.last_ns = time_ns.max(self.last_ns);
        Some(Group { cameras, seen: cameras, time_ns: self.last_ns })
    }

    /// The group without the fields of cameras that are left out.
    pub(super) fn admit(&self, group: Group) -> Group {
        let input = group.input(&self.rig, &self.fields, &self.area_scales);
        let Some(watch) = self.watch.as_ref().filter(|w| w.left_out() != 0) else { return group };
        let (in_use, at_rate) = (watch.in_use(), &self.rig.at_rate);
        let is_short = |t: &Track| t.filter.is_some() && t.seeing(in_use, group.time_ns, at_rate) < 2;
        Group { cameras: watch.admit(&input, self.tracks.iter().any(is_short)), ..group }
    }

    /// Judges the evidence about the cameras, and resects those that are left out.
    pub(super) fn watch_cameras(&mut self, group: Group, used: &[BlobField]) {
        let Some(watch) = &mut self.watch else { return };
        watch.judge(group.seen, group.time_ns);
        let newly_left_out = watch.take_newly_left_out();
        if (watch.left_out() & group.seen) | newly_left_out != 0 {
            // The cameras may move.
            self.note_owed_matches(used);
            self.place_cameras(group, newly_left_out);
        }
    }

    /// Forgets what is known of cameras that were left out just now, and resects those that are.
    fn place_cameras(&mut self, group: Group, newly_left_out: u32) {
        let Some(watch) = &mut self.watch else { return };
        if let Some(drift) = self.drift.as_mut().filter(|_| newly_left_out != 0) {
            drift.roll_back(newly_left_out, &mut self.rig);
        }
        let acquire_after_ns = self.rig.at_rate.acquire_after_ns;
        let fresh = |track: &Track| group.time_ns.saturating_sub(track.good_ns) <= acquire_after_ns;
        for camera in members(watch.left_out() & group.seen) {
            let input = group.input(&self.rig, &self.fields, &self.area_scales);
            // What is located with the camera's own provisional pose says nothing about it.
            let (in_use, any) = (watch.in_use(), !watch.two_send(&input));
            let by_others = |t: &Track| any || t.seeing(in_use, group.time_ns, &self.rig.at_rate) >= 2;
            let located = |t: &&Track| fresh(t) && by_others(t);
            let bodies = std::array::from_fn(|b| Some(&self.tracks[b]).filter(located)?.predicted());
            if let Some(found) = watch.resect(camera, &input, &bodies) {
                self.rig.cameras[camera] = Some(found);
                if let Some(drift) = &mut self.drift {
                    drift.rebase(camera, &self.rig);
                }
            }
        }
    }

    /// Assigns blobs to the markers of the tracked bodies, without the fields that jump. Where an
    /// instrument's blobs lie beside its markers, its covariance is inflated and the blobs are assigned
    /// again.
    pub(super) fn associate(&mut self, group: Group) -> (Group, Association) {
        let mut association = self.assign(group, &[None; BODIES]);
        let steady = Group { cameras: self.without_jumps(group, &association), ..group };
        self.cameras_in_frame |= steady.cameras;
        let dropped = steady.cameras != group.cameras;
        if dropped {
            self.associator.recycle(association);
            association = self.assign(steady, &[None; BODIES]);
        }
        if self.inflate_covariances(&association) {
            self.associator.recycle(association);
            association = self.assign(steady, &[None; BODIES]);
        }
        (steady, association)
    }

    /// Set of the cameras of a group whose fields do not jump.
    fn without_jumps(&mut self, group: Group, association: &Association) -> u32 {
        let Some(watch) = &mut self.watch else { return group.cameras };
        let mut matched = [0; MAX_CAMERAS];
        association.matches.iter().flatten().for_each(|m| matched[m.camera] += 1);
        let predicted = std::array::from_fn(|body| self.tracks[body].predicted());
        watch.without_jumps(&group.input(&self.rig, &self.fields, &self.area_scales), &matched, &predicted)
    }

    /// One assignment, about the fitted poses where there are some, else about the predicted ones.
    fn assign(&mut self, group: Group, fits: &Fits) -> Association {
        let rolls = self.rig.rolls();
        let predicted = std::array::from_fn(|body| {
            let track = &self.tracks[body];
            let mut predicted = if rolls { track.predicted_for_lines()? } else { track.predicted()? };
            if let Some(fit) = &fits[body] {
                if let Some(given) = &predicted.given {
                    let off = box_minus(&fit.pose, &predicted.pose);
                    predicted.motion = given.motion(&predicted.motion, &off);
                }
                (predicted.pose, predicted.covariance) = (fit.pose, fit.covariance);
            }
            Some(predicted)
        });
        let input = group.input(&self.rig, &self.fields, &self.area_scales);
        self.associator.associate(&input, &predicted)
    }

    /// Inflates the covariance of instruments whose blobs are beside their markers. True if there
    /// is one.
    fn inflate_covariances(&mut self, association: &Association) -> bool {
        let mut inflated = false;
        for body in (0..BODIES).filter(|b| *b != EYE && association.is_beside(*b)) {
            if let Some(BodyFilter::Instrument(filter)) = &mut self.tracks[body].filter {
                filter.inflate_covariance();
                inflated = true;
            }
        }
        inflated
    }

    /// Fits the tracked bodies to their blobs. Where there was a choice or an outlier, blobs are
    /// assigned again about the fitted poses, and bodies whose assignment changed are fitted again.
    pub(super) fn estimate(&mut self, group: Group, mut first: Association) -> Estimate {
        let mut fits: Fits = [None; BODIES];
        for body in ORDER {
            fits[body] = self.fit(body, None, &mut first.matches[body]);
        }
        let rolled = self.recover_rolls(group, &first, &mut fits);
        let unambiguous = first.unambiguous && rolled == [false; BODIES];
        if unambiguous && fits.iter().flatten().all(|fit| fit.outliers == 0) {
            return self.follow_manoeuvres(group, Estimate { association: first, fits });
        }
        let (association, _) = self.refit(group, &mut first, &mut fits, rolled);
        self.associator.recycle(first);
        self.follow_manoeuvres(group, Estimate { association, fits })
    }

    /// Assigns blobs about the fits, and fits bodies whose assignment has changed, or that are marked in `again`, once more.
    /// The matches of the others are taken over from `first`; which they are is returned.
    pub(super) fn refit(
        &mut self,
        group: Group,
        first: &mut Association,
        fits: &mut Fits,
        again: [bool; BODIES],
    ) -> (Association, [bool; BODIES]) {
        let (mut second, mut taken) = (self.assign(group, fits), [false; BODIES]);
        for body in ORDER {
            let (before, after) = (&mut first.matches[body], &mut second.matches[body]);
            taken[body] = !again[body] && same_assignment(before, after);
            if taken[body] {
                std::mem::swap(before, after);
            } else {
                fits[body] = self.fit(body, fits[body].as_ref(), after);
            }
        }
        (second, taken)
    }

    /// The most likely pose of a tracked body, sought from `start` or the prediction on.
    fn fit(&self, body: usize, start: Option<&PoseFit>, matches: &mut [BlobMatch]) -> Option<PoseFit> {
        let track = &self.tracks[body];
        let filter = track.filter.as_ref()?;
        let model = &self.rig.bodies[body];
        let problem = PoseProblem::of_filter(&self.rig, model, filter, track.variance_scale)?;
        let start = start.map_or(problem.prior, |f| f.pose);
        if matches.is_empty() { None } else { problem.solve(&start, matches) }
    }

    /// Finds instruments that rolled otherwise than predicted, by the markers beside their shafts,
    /// and turns their fits. True for those that did.
    fn recover_rolls(&mut self, group: Group, association: &Association, fits: &mut Fits) -> [bool; BODIES] {
        let input = group.input(&self.rig, &self.fields, &self.area_scales);
        std::array::from_fn(|body| {
            let track = &mut self.tracks[body];
            let (Some(mut predicted), Some(fit)) = (track.predicted(), &mut fits[body]) else {
                return false;
            };
            let Some(BodyFilter::Instrument(filter)) = &mut track.filter else { return false };
            (predicted.pose, predicted.covariance) = (fit.pose, fit.covariance);
            let Some(change) = roll_recovery::find(&input, body, &predicted, &association.matches) else {
                return false;
            };
            let since_ns = group.time_ns.saturating_sub(track.roll_ns);
            // One camera alone may see something else.
            if change.cameras < 2 && since_ns < input.rig.at_rate.acquire_after_ns {
                return false;
            }
            filter.inflate_roll_covariance(change.rad, since_ns as f64 * 1e-9);
            let axis = fit.pose.rotation * Vector3::z();
            fit.pose.rotation = exp(axis * change.rad) * fit.pose.rotation;
            let mut covariance = fit.covariance.fixed_view_mut::<3, 3>(3, 3);
            covariance += axis * axis.transpose() * (k::ROLL_AGREES_RAD * k::ROLL_AGREES_RAD);
            true
        })
    }

    /// Updates the filters with the fits; returns the fits that they accepted.
    pub(super) fn filter(&mut self, group: Group, estimate: &Estimate) -> Fits {
        let mut accepted: Fits = [None; BODIES];
        for body in ORDER {
            let filter = self.tracks[body].filter.as_ref();
            let Some(prior) = filter.and_then(|f| f.pose_covariance().cholesky()) else { continue };
            let prior_information = prior.inverse();
            self.add_evidence(group, estimate, body, prior_information);
            accepted[body] = self.filter_body(group, estimate, body, &prior_information);
        }
        accepted
    }

    /// Adds the evidence of a body about the cameras, before its filter is updated.
    fn add_evidence(&mut self, group: Group, estimate: &Estimate, body: usize, prior_information: Matrix6) {
        let (Some(watch), Some(filter)) = (&mut self.watch, &self.tracks[body].filter) else { return };
        let prior = filter.pose();
        let pose = estimate.fits[body].map_or(prior, |f| f.pose);
        let (motion, matches) = (filter.motion(), &estimate.association.matches[body]);
        let update = BodyUpdate { body, pose, prior, prior_information, motion, matches };
        let looked_at = Group { cameras: group.seen & watch.in_use(), ..group };
        watch.add(&looked_at.input(&self.rig, &self.fields, &self.area_scales), &update);
    }

    fn filter_body(
        &mut self,
        group: Group,
        estimate: &Estimate,
        body: usize,
        prior_information: &Matrix6,
    ) -> Option<PoseFit> {
        let fit = estimate.fits[body]?;
        let matches = &estimate.association.matches[body];
        let (track, beside) = (&mut self.tracks[body], estimate.association.beside(body));
        track.count_near_misses(beside);
        // The eye is predicted well: where its blobs lie beside its markers the camera was moved, and those that
        // match by chance would turn the eye. An instrument may have moved.
        let unexplained = fit.outliers + if body == EYE { beside as usize } else { 0 };
        if !track.update(&fit, unexplained, prior_information, matches, group.time_ns, &self.rig) {
            return None;
        }
        track.observe_roll(&self.rig.bodies[body], matches, group.time_ns);
        let area_step = self.rig.at_rate.area_scale_step;
        for m in matches.iter().filter(|m| !m.outlier) {
            self.fields[m.camera].assign(m.blob);
            let scale = &mut self.area_scales[m.camera];
            // The median: a step up or down, whatever the distance.
            *scale *= 1.0 + area_step * if m.area_ratio > *scale { 1.0 } else { -1.0 };
            *scale = scale.clamp(0.4, 2.5);
        }
        let strayed = self.trocar(body, &estimate.fits).is_some_and(|trocar| {
            trocar_miss(&fit.pose, &trocar.position).norm() > k::TROCAR_MISS_MM + 3.0 * trocar.sigma
        });
        if strayed {
            self.tracks[body].lose();
        }
        Some(fit)
    }

    /// Every tracked body as predicted at its filter's instant.
    pub(super) fn predictions(&self) -> [Option<PredictedBody>; BODIES] {
        std::array::from_fn(|body| self.tracks[body].predicted())
    }

    /// Where the trocar of a body is now, by the newest rotation of the eye.
    fn trocar(&self, body: usize, fits: &Fits) -> Option<TrocarInWorld> {
        let trocar = self.rig.bodies[body].trocar?;
        let eye = self.tracks[EYE].filter.as_ref()?;
        let (pose, covariance) = match &fits[EYE] {
            Some(fit) => (fit.pose, fit.covariance),
            None => (eye.pose(), eye.pose_covariance()),
        };
        let rotation: Matrix3<f64> = covariance.fixed_view::<3, 3>(3, 3).into();
        let variance = rotation.trace().max(0.0) / 3.0 * trocar.position_in_eye.coords.norm_squared();
        let sigma = libm::sqrt(trocar.sigma * trocar.sigma + variance);
        Some(TrocarInWorld { position: pose.rotation * trocar.position_in_eye, sigma })
    }

    /// Searches bodies that are lost, or soon will be, among the blobs that no body took.
    pub(super) fn acquire(&mut self, group: Group, used: &[BlobField]) {
        let input = group.input(&self.rig, &self.fields, &self.area_scales);
        let trusted = self.watch.as_ref().map_or(u32::MAX, |w| w.in_use() | w.provisional(&input));
        for body in ORDER {
            let needs_trocar =
                body != EYE && !self.rig.distinct_colours && self.trocar(body, &[None; BODIES]).is_none();
            if self.tracks[body].needs_acquisition(group.time_ns, &self.rig.at_rate)
                && !needs_trocar
                && let Some(fit) =
                    self.search(group, body, trusted).or_else(|| self.search_roughly(group, body, trusted))
            {
                if body == EYE && self.fits_badly(&fit) {
                    let found = self.find_eye_without_a_camera(group, used);
                    // Of two cameras, a third that is yet to come may show which one was moved.
                    if found || self.without_eye < self.rig.at_rate.without_eye_updates {
                        continue;
                    }
                }
                self.initiate(group, body, &fit, used);
            }
        }
        self.without_eye = if self.tracks[EYE].filter.is_some() { 0 } else { self.without_eye + 1 };
        if self.without_eye > 0 && self.without_eye.is_multiple_of(self.rig.at_rate.without_eye_updates) {
            self.find_eye_without_a_camera(group, used);
        }
        if self.without_eye == self.rig.at_rate.disagree_updates
            && self.sees_eye_markers(group.time_ns)
            && let Some(watch) = &mut self.watch
        {
            watch.disagree(group.time_ns);
        }
    }

    /// True if two cameras or more that are in use now see enough blobs of the eye's colours to find it.
    fn sees_eye_markers(&self, time_ns: u64) -> bool {
        let in_use = self.watch.as_ref().map_or(u32::MAX, CameraWatch::in_use);
        let is_fresh = |f: &&FieldObservation| {
            in_use & (1 << f.camera) != 0 && time_ns.saturating_sub(f.exposed_ns) < self.rig.at_rate.silent_ns
        };
        let markers = &self.rig.bodies[EYE].markers;
        let of_eye = |f: &FieldObservation| {
            f.blobs().iter().filter(|b| markers.iter().any(|m| m.colour == b.colour)).count()
        };
        self.fields.iter().filter(is_fresh).filter(|f| 2 * of_eye(f) > markers.len()).count() >= 2
    }

    /// Searches a body in the fields of these cameras.
    fn search(&mut self, group: Group, body: usize, cameras: u32) -> Option<PoseFit> {
        self.search_in(group, body, cameras, cameras)
    }

    /// Searches an instrument in the fields of all cameras, where some are left out; its pose is that of the others.
    fn search_roughly(&mut self, group: Group, body: usize, cameras: u32) -> Option<PoseFit> {
        let left_out = self.watch.as_ref().map_or(0, CameraWatch::left_out) & !cameras;
        if body == EYE || left_out == 0 {
            None
        } else {
            self.search_in(group, body, cameras | left_out, cameras)
        }
    }

    fn search_in(&mut self, group: Group, body: usize, sought_in: u32, cameras: u32) -> Option<PoseFit> {
        let input = AcquisitionInput {
            rig: &self.rig,
            fields: &self.fields,
            cameras,
            sought_in,
            time_ns: group.time_ns,
            trocar: self.trocar(body, &[None; BODIES]),
            area_scales: &self.area_scales,
        };
        self.acquisition.search(&input, &self.rig.bodies[body])
    }

    /// Begins a track with the pose and the blobs found last.
    fn initiate(&mut self, group: Group, body: usize, fit: &PoseFit, used: &[BlobField]) {
        self.note_owed_matches(used);
        let pivot = self.pivot(body, group.time_ns);
        let matches = &self.acquisition.matches;
        let cameras = self.cameras_in_frame;
        self.tracks[body].initiate(fit, &self.rig.bodies[body], matches, group.time_ns, cameras, pivot);
        self.matches.note_found(&self.rig, &self.fields[..], body, &fit.pose, matches);
        for m in matches.iter().filter(|m| !m.outlier) {
            self.fields[m.camera].assign(m.blob);
        }
    }

    /// True if a camera may have been moved, and may be left out.
    fn fits_badly(&self, fit: &PoseFit) -> bool {
        let may_leave_out = |watch: &CameraWatch| members(watch.in_use()).any(|c| watch.may_leave_out(c));
        fit.rms_px() > k::WITHOUT_CAMERA_PX && self.watch.as_ref().is_some_and(may_leave_out)
    }

    /// The eye is always there. Where it is found without one of the cameras only, that one was moved: leaves it out, and
    /// begins a track of the eye. False if there is no such camera.
    fn find_eye_without_a_camera(&mut self, group: Group, used: &[BlobField]) -> bool {
        let mut found: [Option<f64>; MAX_CAMERAS] = std::array::from_fn(|camera| {
            let may = self.watch.as_ref().is_some_and(|w| w.may_leave_out(camera));
            may.then(|| self.search(group, EYE, !(1 << camera))).flatten().map(|fit| fit.rms_px())
        });
        let Some((camera, best)) = lowest(&found) else { return false };
        found[camera] = None;
        let next = lowest(&found).map_or(f64::MAX, |(_, px)| px);
        if best > k::WITHOUT_CAMERA_PX || next < k::WITHOUT_CAMERA_RATIO * best {
            return false;
        }
        let (Some(fit), Some(watch)) = (self.search(group, EYE, !(1 << camera)), &mut self.watch) else {
            return false;
        };
        watch.accuse(camera, 0.0, group.time_ns);
        self.initiate(group, EYE, &fit, used);
        true
    }
}

/// The lowest of those that there are, with its place.
fn lowest(found: &[Option<f64>]) -> Option<(usize, f64)> {
    let there = found.iter().enumerate().filter_map(|(i, v)| Some((i, (*v)?)));
    there.min_by(|a, b| a.1.total_cmp(&b.1))
}

/// True if the second assignment, about the fitted pose, is that of the first less its outliers.
fn same_assignment(first: &[BlobMatch], second: &[BlobMatch]) -> bool {
    let kept = first.iter().filter(|m| !m.outlier).count();
    let known = |m: &BlobMatch| {
        let same = |n: &&BlobMatch| (n.camera, n.marker, n.blob) == (m.camera, m.marker, m.blob);
        first.iter().find(same).is_some_and(|n| !n.outlier)
    };
    kept == second.len() && second.iter().all(known)
}
