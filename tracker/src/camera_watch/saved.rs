//! The watch over the cameras in a checkpoint.

use super::{CameraWatch, Jump, NOTICES, Notice, State, Trial};
use crate::checkpoint::{CheckpointError, Done, Loader, Saver, require};
use protocol::limits::MAX_CAMERAS;

/// Fields and counts from here on are damage.
const MOST: u32 = 1 << 30;

impl CameraWatch {
    /// Writes what is known of the rig's cameras, and what was not reported yet.
    pub(crate) fn save(&self, out: &mut Saver<'_>) -> Done {
        let CameraWatch { calibrated, states, jumps, evidence, resections, returns, estimated, .. } = self;
        let CameraWatch { trial, quiet_until_ns, disagree_until_ns, notices, newly_left_out, .. } = self;
        for camera in (0..MAX_CAMERAS).filter(|c| calibrated[*c].is_some()) {
            out.put(&(states[camera], jumps[camera], returns[camera]))?;
            evidence[camera].save(out)?;
            resections[camera].as_ref().map_or(Ok(()), |resection| resection.save(out))?;
        }
        out.put(&(estimated, trial, newly_left_out))?;
        out.put(quiet_until_ns)?;
        out.put(disagree_until_ns)?;
        out.put(&(notices.len() as u64))?;
        notices.iter().try_for_each(|notice| out.put(notice))
    }

    /// Takes over what was saved.
    pub(crate) fn load(&mut self, from: &mut Loader<'_>) -> Done {
        for (id, calibrated) in self.calibrated.iter().enumerate() {
            let Some(calibrated) = calibrated else { continue };
            (self.states[id], self.jumps[id], self.returns[id]) = from.take()?;
            check_camera(&self.states[id], self.jumps[id].as_ref(), self.returns[id])?;
            self.evidence[id].load(from)?;
            let resection = self.resections[id].as_mut();
            resection.map_or(Ok(()), |resection| resection.load(calibrated, from))?;
        }
        (self.estimated, self.trial, self.newly_left_out) = from.take()?;
        let there = |set: u32| (0..u32::BITS as usize).all(|c| set >> c & 1 == 0 || self.is_there(c));
        let sets = [self.estimated, self.newly_left_out, self.trial.map_or(0, |t| t.tried)];
        let trial = self.trial.is_none_or(|t: Trial| self.is_there(t.camera));
        require(trial && sets.into_iter().all(there), "a camera is not in the rig")?;
        self.quiet_until_ns = from.count()?;
        self.disagree_until_ns = from.count()?;
        self.notices.clear();
        for _ in 0..from.below(NOTICES as u64 + 1)? {
            let notice = from.take()?;
            self.check_notice(&notice)?;
            self.notices.push_back(notice);
        }
        Ok(())
    }

    fn is_there(&self, camera: usize) -> bool {
        self.calibrated.get(camera).is_some_and(Option::is_some)
    }

    fn check_notice(&self, notice: &Notice) -> Result<(), CheckpointError> {
        let (camera, px) = match *notice {
            Notice::Moved { camera, px } | Notice::TakenBack { camera, px } => (camera, px),
            Notice::Cleared { camera } | Notice::StillMoving { camera } => (camera, 0.0),
            Notice::Disagree { .. } => return Ok(()),
        };
        require(self.is_there(camera) && px.is_finite(), "a notice about a camera makes no sense")
    }
}

fn check_camera(state: &State, jump: Option<&Jump>, returns: u32) -> Done {
    let counted = match *state {
        State::Suspected { jumped, calm } => jumped < MOST && calm < MOST,
        State::Trusted | State::LeftOut { .. } => true,
    };
    let sound = jump.is_none_or(|jump| jump.px.is_finite());
    require(counted && sound && returns < MOST, "the state of a camera is out of range")
}
