//! Handles and pedal as a process sends them that has both, or leaves one of them to another program.

use crate::clock::now;
use crate::{Instance, IpcError, Sender};
use bytemuck::Zeroable;
use protocol::handles::{ControlChannels, HandleState, PedalState, Tool};
use protocol::limits::INSTRUMENTS;
use protocol::time::Nanos;

/// The pedal is sent when it changes, and at least so often, ns: 10 times a second.
const PEDAL_EVERY_NS: u64 = 100_000_000;

/// The channels of handles and pedal, without those that are left to others.
pub struct ControlSender {
    handles: Option<Sender<HandleState>>,
    pedal: Option<Sender<PedalState>>,
    /// When the pedal is next due.
    pedal_due_ns: Nanos,
    /// The pedal as sent last, without number and instant.
    last_pedal: PedalState,
}

impl ControlSender {
    /// Opens the channels but those that are `left` to other programs.
    ///
    /// # Errors
    /// Where a channel cannot be opened.
    pub fn open(instance: &Instance, left: ControlChannels) -> Result<Self, IpcError> {
        Ok(ControlSender {
            handles: (!left.handles).then(|| instance.sender()).transpose()?,
            pedal: (!left.pedal).then(|| instance.sender()).transpose()?,
            pedal_due_ns: 0,
            last_pedal: PedalState::zeroed(),
        })
    }

    /// Blocks sent so far.
    pub fn sent(&self) -> u64 {
        self.handles.as_ref().map_or(0, Sender::sent) + self.pedal.as_ref().map_or(0, Sender::sent)
    }

    /// Sends tool and opening (rad) of each handle with the number of the field that they belong to.
    ///
    /// # Errors
    /// Where the channel fails.
    pub fn send_handles(
        &mut self,
        field: u64,
        tools: [Tool; INSTRUMENTS],
        jaws_rad: [f64; INSTRUMENTS],
    ) -> Result<(), IpcError> {
        let Some(handles) = &mut self.handles else { return Ok(()) };
        let instant_ns = now();
        for (i, (tool, jaw_rad)) in tools.into_iter().zip(jaws_rad).enumerate() {
            let (seq, instrument) = (handles.sent(), i as u32);
            let tool = tool as u32;
            handles.fill(|block| {
                *block = HandleState { seq, field, instant_ns, instrument, tool, jaw_rad };
            })?;
        }
        Ok(())
    }

    /// Sends the pedal where it has changed or is due again; number and instant are set here.
    ///
    /// # Errors
    /// Where the channel fails.
    pub fn send_pedal(&mut self, state: &PedalState) -> Result<(), IpcError> {
        let Some(pedal) = &mut self.pedal else { return Ok(()) };
        let instant_ns = now();
        if *state != self.last_pedal || instant_ns >= self.pedal_due_ns {
            self.pedal_due_ns = instant_ns + PEDAL_EVERY_NS;
            self.last_pedal = *state;
            let seq = pedal.sent();
            pedal.fill(|block| *block = PedalState { seq, instant_ns, ..*state })?;
        }
        Ok(())
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::{Queue, Receiver};
    use protocol::message::Message;

    #[test]
    fn what_is_left_to_others_is_not_sent() {
        for (name, handles, pedal) in
            [("ctl-both", false, false), ("ctl-pedal", true, false), ("ctl-hands", false, true)]
        {
            let instance = Instance::own(&format!("{name}{}", std::process::id() % 1_000_000)).unwrap();
            let mut hands: Receiver<HandleState> = instance.receiver(Queue::InOrder).unwrap();
            let mut pedals: Receiver<PedalState> = instance.receiver(Queue::InOrder).unwrap();
            let left = ControlChannels { handles, pedal };
            let mut sender = ControlSender::open(&instance, left).unwrap();
            sender.send_handles(3, [Tool::Vitrector, Tool::LightPipe], [0.0, 0.0]).unwrap();
            sender.send_pedal(&PedalState::zeroed()).unwrap();
            sender.send_pedal(&PedalState { buttons: 1, ..PedalState::zeroed() }).unwrap();
            let count = |left: bool| if left { 0 } else { 2 };
            let (hands, pedals) = (all(&mut hands), all(&mut pedals));
            assert_eq!((hands.len(), pedals.len()), (count(handles), count(pedal)));
            assert_eq!(sender.sent(), (count(handles) + count(pedal)) as u64);
            assert!(hands.iter().all(|h| h.field == 3) && pedals.iter().zip(0..).all(|(p, n)| p.seq == n));
        }
    }

    fn all<M: Message>(receiver: &mut Receiver<M>) -> Vec<M> {
        std::iter::from_fn(|| receiver.next_valid().unwrap()).collect()
    }
}
