//! Copies of a tracker in memory, and its share of a checkpoint.

use super::Tracker;
use crate::checkpoint::{Done, Loader, Saver, require};
use crate::constants as k;
use crate::rig_model::RigModel;
use crate::tuning::Tuning;
use protocol::limits::MAX_CAMERAS;
use protocol::message::fnv1a;
use rig::Rig;
use rig::camera::Camera;

/// Range of the running ratios of blob areas, which the tracker keeps.
const AREA_SCALES: (f64, f64) = (0.4, 2.5);

/// Everything that a tracker knew at an instant, in memory: what follows from the rig alone is shared
/// with it.
#[derive(Clone)]
pub struct TrackerSnapshot(pub(crate) Box<Tracker>);

/// Names a rig, whether its drift is estimated, and constants that are not the usual ones.
pub(super) fn fingerprint(rig: &Rig, estimate_drift: bool, tuning: &Tuning) -> u64 {
    let mut bytes = rig.to_json().into_bytes();
    bytes.push(u8::from(estimate_drift));
    if *tuning != Tuning::default() {
        bytes.extend(tuning.values().iter().flat_map(|value| value.to_bits().to_le_bytes()));
    }
    fnv1a(&bytes)
}

impl Tracker {
    /// A copy of everything that it knows.
    pub fn snapshot(&self) -> TrackerSnapshot {
        TrackerSnapshot(Box::new(self.clone()))
    }

    /// Goes on where it, or another tracker of the same rig, stood: to the same bits.
    pub fn restore_snapshot(&mut self, snapshot: &TrackerSnapshot) {
        self.take_over(Tracker::clone(&snapshot.0));
    }

    /// Becomes `other`, but for the work space, which is kept.
    pub(crate) fn take_over(&mut self, mut other: Tracker) {
        std::mem::swap(&mut self.associator, &mut other.associator);
        std::mem::swap(&mut self.acquisition, &mut other.acquisition);
        std::mem::swap(&mut self.matches, &mut other.matches);
        *self = other;
    }

    pub(crate) fn fingerprint(&self) -> u64 {
        self.fingerprint
    }

    /// Writes everything except what each frame initialises.
    pub(crate) fn save_state(&self, out: &mut Saver<'_>) -> Done {
        let Tracker { rig, fingerprint: _, drift, watch, without_eye, tracks, fields, .. } = self;
        let Tracker { area_scales, associator: _, acquisition: _, matches: _, last_ns, frame, .. } = self;
        let Tracker { cameras_in_frame: _, blobs_refused, owed, .. } = self;
        debug_assert!(owed.is_nothing(), "a frame is saved after it was followed up");
        for count in [u64::from(*without_eye), *last_ns, *frame, *blobs_refused] {
            out.put(&count)?;
        }
        out.numbers(area_scales)?;
        for (track, model) in tracks.iter().zip(&rig.bodies) {
            track.save(model, out)?;
        }
        for camera in rig.cameras.iter().flatten() {
            fields[camera.id as usize].save(out)?;
        }
        if let Some(drift) = drift {
            save_places(rig, out)?;
            drift.save(out)?;
        }
        watch.as_ref().map_or(Ok(()), |watch| watch.save(out))
    }

    /// Takes over what was saved; where that is refused, it is left in between.
    pub(crate) fn load_state(&mut self, from: &mut Loader<'_>) -> Done {
        self.without_eye = from.small_count()?;
        (self.last_ns, self.frame, self.blobs_refused) = (from.count()?, from.count()?, from.count()?);
        for scale in &mut self.area_scales {
            *scale = from.within(AREA_SCALES.0, AREA_SCALES.1)?;
        }
        for (track, model) in self.tracks.iter_mut().zip(&self.rig.bodies) {
            track.load(model, from)?;
            // Else the next prediction would take as long as it is late.
            let near = |time_ns: u64| self.last_ns > 0 && time_ns.abs_diff(self.last_ns) <= k::MAX_GAP_NS;
            let timely = track.filter.as_ref().is_none_or(|filter| near(filter.time_ns()));
            require(timely, "a filter is not of the time of the newest field")?;
        }
        for id in (0..MAX_CAMERAS).filter(|id| self.rig.cameras[*id].is_some()) {
            self.fields[id].load(from)?;
        }
        if let Some(drift) = &mut self.drift {
            load_places(&mut self.rig, from)?;
            drift.load(from)?;
        }
        self.watch.as_mut().map_or(Ok(()), |watch| watch.load(from))
    }
}

/// Writes where cameras and markers are.
fn save_places(rig: &RigModel, out: &mut Saver<'_>) -> Done {
    for camera in rig.cameras.iter().flatten() {
        save_place(camera, out)?;
    }
    let markers = rig.bodies.iter().flat_map(|body| &body.markers);
    markers.into_iter().try_for_each(|marker| out.numbers(marker.position.coords.as_slice()))
}

fn load_places(rig: &mut RigModel, from: &mut Loader<'_>) -> Done {
    for camera in rig.cameras.iter_mut().flatten() {
        load_place(camera, from)?;
    }
    let markers = rig.bodies.iter_mut().flat_map(|body| &mut body.markers);
    markers.into_iter().try_for_each(|marker| from.numbers(marker.position.coords.as_mut_slice()))
}

/// Writes where a camera stands.
pub(crate) fn save_place(camera: &Camera, out: &mut Saver<'_>) -> Done {
    out.numbers(camera.camera_from_world.as_slice())?;
    out.numbers(camera.translation_mm.as_slice())
}

/// Puts a camera where it stood.
pub(crate) fn load_place(camera: &mut Camera, from: &mut Loader<'_>) -> Done {
    camera.camera_from_world = from.rotation_matrix()?;
    from.numbers(camera.translation_mm.as_mut_slice())
}
