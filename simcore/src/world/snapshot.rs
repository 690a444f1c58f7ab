//! Copies of a world in memory: what a checkpoint is, without encoding it.
//!
//! A copy holds the state, and of what follows from scene and state that which would take longer to
//! derive than to copy. The rest is derived again, as after a checkpoint.

use super::World;
use crate::checkpoint::CheckpointError;
use crate::constants::MAX_MARKS;
use crate::state::State;
use protocol::handles::Tool;
use tissue::vitreous::{DerivedVitreous, Vitreous};

/// The state of a world at an instant.
#[derive(Debug, Clone)]
pub struct WorldSnapshot {
    state: State,
    vitreous: Option<DerivedVitreous>,
    /// Fingerprint of the scene.
    scene: u64,
}

impl WorldSnapshot {
    /// The state.
    pub fn state(&self) -> &State {
        &self.state
    }
}

impl World {
    /// A copy of the world as it stands between two steps.
    pub fn snapshot(&self) -> WorldSnapshot {
        let vitreous = self.vitreous.as_ref().map(Vitreous::derived);
        WorldSnapshot { state: self.state.clone(), vitreous, scene: self.fingerprint }
    }

    /// Goes on where this or another world of the same scene stood: to the same bits.
    ///
    /// # Errors
    /// [`CheckpointError::Scene`] for a copy of a world of another scene; nothing changes then.
    pub fn restore_snapshot(&mut self, snapshot: &WorldSnapshot) -> Result<(), CheckpointError> {
        if snapshot.scene != self.fingerprint {
            return Err(CheckpointError::Scene { expected: self.fingerprint, found: snapshot.scene });
        }
        self.take_state(snapshot.state.clone());
        self.resume_sheets();
        match (&mut self.vitreous, &self.state.vitreous, &snapshot.vitreous) {
            (Some(gel), Some(state), Some(derived)) => gel.refresh_from(state, derived),
            _ => self.refresh_vitreous(),
        }
        Ok(())
    }

    /// Takes over a state that fits the scene; everything else is to be derived from it.
    pub(super) fn take_state(&mut self, state: State) {
        self.state = state;
        self.state.marks.reserve_exact(MAX_MARKS - self.state.marks.len());
        for (image, instrument) in self.images.iter_mut().zip(&self.state.instruments) {
            if let Some(tool) = Tool::from_wire(instrument.tool) {
                image.set_tool(tool, &self.volume);
            }
        }
    }
}
