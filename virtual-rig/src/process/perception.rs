//! The simulation's scenes and events on their way to the surgeon.

use crate::perception::ScenePerception;
use anyhow::Result;
use ipc::{BlockReceiver, Instance, Queue, Receiver};
use protocol::events::Event;
use protocol::scene::SceneHeader;
use surgeon::motion::MotionSource;

/// The channels that the surgeon perceives by, and what came last.
pub(super) struct PerceptionInput {
    scenes: BlockReceiver<SceneHeader>,
    events: Receiver<Event>,
    newest: ScenePerception,
    /// A scene has come.
    any: bool,
}

impl PerceptionInput {
    pub(super) fn open(instance: &Instance) -> Result<Self> {
        let (scenes, events) = (instance.block_receiver()?, instance.receiver(Queue::InOrder)?);
        Ok(PerceptionInput { scenes, events, newest: ScenePerception::default(), any: false })
    }

    /// Takes in the events and, where the surgeon reacts to anything now, the newest scene. Without a
    /// scene the script is played blindly.
    pub(super) fn show(&mut self, surgeon: &mut MotionSource, exposed_ns: u64) -> Result<()> {
        while let Some(event) = self.events.next_valid()? {
            self.newest.take_event(&event);
        }
        if !surgeon.perceives_now(exposed_ns) {
            return Ok(());
        }
        if let Some(sample) = self.scenes.receive()? {
            self.newest.take_scene(sample.header(), sample.payload());
            self.any = true;
        }
        if self.any {
            surgeon.see(exposed_ns, &self.newest);
        }
        Ok(())
    }
}
