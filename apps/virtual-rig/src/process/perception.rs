//! Feedback of the simulation's scenes and events to the surgeon.

use crate::perception::ScenePerception;
use anyhow::Result;
use ipc::{BlockReceiver, Instance, Queue, Receiver};
use protocol::events::Event;
use protocol::scene::SceneHeader;
use surgeon::motion::MotionSource;

/// The channels of the surgeon's perception, and its newest state.
pub(super) struct PerceptionInput {
    scenes: BlockReceiver<SceneHeader>,
    events: Receiver<Event>,
    newest: ScenePerception,
    /// True once a scene was received.
    any: bool,
}

impl PerceptionInput {
    /// `reached`: goals that are reached already, a bit for each.
    pub(super) fn open(instance: &Instance, reached: u64) -> Result<Self> {
        let (scenes, events) = (instance.block_receiver()?, instance.receiver(Queue::InOrder)?);
        let mut newest = ScenePerception::default();
        newest.take_goals(reached);
        Ok(PerceptionInput { scenes, events, newest, any: false })
    }

    /// A bit for each goal that is reached.
    pub(super) fn goals_reached(&self) -> u64 {
        self.newest.goals_reached()
    }

    /// Takes in the events and, where a reaction is due, the newest scene. Before the first scene
    /// the script is played without reactions. True if the surgeon's state may have changed.
    pub(super) fn show(&mut self, surgeon: &mut MotionSource, exposed_ns: u64) -> Result<bool> {
        let before = self.newest.goals_reached();
        while let Some(event) = self.events.next_valid()? {
            self.newest.take_event(&event);
        }
        let goals_changed = self.newest.goals_reached() != before;
        if !surgeon.perceives_now(exposed_ns) {
            return Ok(goals_changed);
        }
        if let Some(sample) = self.scenes.receive()? {
            self.newest.take_scene(sample.header(), sample.payload());
            self.any = true;
        }
        if self.any {
            surgeon.see(exposed_ns, &self.newest);
        }
        Ok(goals_changed || self.any)
    }
}
