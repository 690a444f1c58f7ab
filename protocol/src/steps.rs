//! `steps` and `checkpoints`: inputs, figures and state hash of a simulation step, and saved
//! states.

use crate::handles::{HandleState, PedalState};
use crate::message::{Invalid, Message, require};
use crate::phases::Phase;
use crate::poses::TrackerFrame;
use crate::time::{Instants, Nanos};
use crate::wire::Wire;
use bytemuck::{Pod, Zeroable};

/// Inputs of one step.
#[derive(Debug, Clone, Copy)]
pub struct StepInput<'a> {
    /// Poses.
    pub frame: &'a TrackerFrame,
    /// Handle states since the last step, in order.
    pub handles: &'a [HandleState],
    /// Pedal states since the last step, in order.
    pub pedals: &'a [PedalState],
}

/// A [`StepInput`] that owns its parts.
#[derive(Debug, Clone)]
pub struct StepInputs {
    /// Poses.
    pub frame: Box<TrackerFrame>,
    /// Handle states since the last step, in order.
    pub handles: Vec<HandleState>,
    /// Pedal states since the last step, in order.
    pub pedals: Vec<PedalState>,
}

impl StepInputs {
    /// As a step takes it.
    pub fn input(&self) -> StepInput<'_> {
        StepInput { frame: &self.frame, handles: &self.handles, pedals: &self.pedals }
    }
}

/// What a step consumed, so that whoever repeats it from a recording knows whether the recording holds the
/// same: two senders on one channel may reach two receivers in another order, and a queue may have been full
/// for one of them. All 0 in recordings of builds that did not compute it; the hash alone is 0 if poses were tracked
/// again, and only numbers can be compared.
#[derive(Debug, Clone, Copy, Default, PartialEq, Eq)]
pub struct InputsDigest {
    /// Hash of field, frame, exposure and bodies of the tracker frame, and of the handle and pedal states.
    pub hash: u64,
    /// Handle states consumed.
    pub handles: u32,
    /// Pedal states consumed.
    pub pedals: u32,
}

impl InputsDigest {
    /// How many handle and pedal states were consumed; `None` in recordings of builds that did not count them.
    pub fn taken(&self) -> Option<[u32; 2]> {
        (*self != Self::default()).then_some([self.handles, self.pedals])
    }

    /// True where `consumed` is the same, or cannot be compared.
    pub fn allows(&self, consumed: &InputsDigest) -> bool {
        self.hash == 0 || self == consumed
    }

    /// Of a step that is repeated with other poses: the numbers alone.
    pub fn without_poses(self) -> Self {
        InputsDigest { hash: 0, ..self }
    }
}

/// Time spent in each phase of a step, ns, as Box2D's `b2Profile`. Never part of the result.
///
/// Tags 1 to 4 are the phases that recordings have always had; there, tissue includes bodies, tools
/// and vitreous, and the rest includes task and hash.
#[repr(C)]
#[derive(Debug, Clone, Copy, Default, PartialEq, Eq, Pod, Wire, Zeroable)]
#[wire(name = "StepTimes")]
pub struct StepProfile {
    /// Contact of instruments with tissue and retina.
    #[wire(tag = 1)]
    pub collision_ns: u64,
    /// Membrane and retina.
    #[wire(tag = 2)]
    pub tissue_ns: u64,
    /// Writing the scene block.
    #[wire(tag = 3)]
    pub transfer_ns: u64,
    /// The rest of the step: inputs, poses, events, microscope.
    #[wire(tag = 4)]
    pub misc_ns: u64,
    /// Rigid bodies.
    #[wire(tag = 5, columns = "")]
    pub bodies_ns: u64,
    /// Ports, needles, jaws, dye and light.
    #[wire(tag = 6, columns = "")]
    pub tools_ns: u64,
    /// Vitreous.
    #[wire(tag = 7, columns = "")]
    pub vitreous_ns: u64,
    /// Task and score.
    #[wire(tag = 8, columns = "")]
    pub task_ns: u64,
    /// Hash of the state.
    #[wire(tag = 9, columns = "")]
    pub hash_ns: u64,
}

impl StepProfile {
    /// Names of the phases, in the order of [`StepProfile::phases_ns`]. The last is not called "misc": a report prints the
    /// paper's table beside them, whose "misc" is more than this phase ([`StepProfile::paper_phases_ns`]).
    pub const PHASES: [&str; 9] =
        ["collision", "tissue", "bodies", "tools", "vitreous", "task", "hash", "transfer", "other"];

    /// Where the time of a phase is added up, ns; that of any other than the step's own in the rest.
    pub fn time_of(&mut self, phase: Phase) -> &mut u64 {
        match phase {
            Phase::Collision => &mut self.collision_ns,
            Phase::Tissue => &mut self.tissue_ns,
            Phase::Bodies => &mut self.bodies_ns,
            Phase::Tools => &mut self.tools_ns,
            Phase::Vitreous => &mut self.vitreous_ns,
            Phase::Task => &mut self.task_ns,
            Phase::Hash => &mut self.hash_ns,
            _ => &mut self.misc_ns,
        }
    }

    /// Time of each phase, ns.
    pub fn phases_ns(&self) -> [u64; Self::PHASES.len()] {
        let &StepProfile { collision_ns, tissue_ns, bodies_ns, tools_ns, .. } = self;
        let &StepProfile { vitreous_ns, task_ns, hash_ns, transfer_ns, misc_ns, .. } = self;
        [collision_ns, tissue_ns, bodies_ns, tools_ns, vitreous_ns, task_ns, hash_ns, transfer_ns, misc_ns]
    }

    /// Phases of the paper's Table 4 that the simulation has, ns: collision detection, tissue
    /// simulation (membrane and retina alone) and misc, which is everything else that the
    /// simulation does. The transfer to the graphics device is the renderer's.
    pub fn paper_phases_ns(&self) -> [u64; 3] {
        let tools = [self.bodies_ns, self.tools_ns, self.vitreous_ns];
        let rest = [self.task_ns, self.hash_ns, self.transfer_ns, self.misc_ns];
        [self.collision_ns, self.tissue_ns, sum_of(&[sum_of(&tools), sum_of(&rest)])]
    }

    /// Time of the step itself, without the transfer, ns.
    pub fn step_ns(&self) -> u64 {
        sum_of(&self.phases_ns()).saturating_sub(self.transfer_ns)
    }
}

/// Any numbers may come in a block, whose times are not validated.
fn sum_of(times_ns: &[u64]) -> u64 {
    times_ns.iter().fold(0, |sum, ns| sum.saturating_add(*ns))
}

/// An input of the simulation, numbered by its sender.
pub trait Numbered {
    /// Counts up by one; from 0 again where the sender was started again.
    fn number(&self) -> u64;
    /// When it was sent, ns.
    fn sent_ns(&self) -> Nanos;
}

impl Numbered for HandleState {
    fn number(&self) -> u64 {
        self.seq
    }

    fn sent_ns(&self) -> Nanos {
        self.instant_ns
    }
}

impl Numbered for PedalState {
    fn number(&self) -> u64 {
        self.seq
    }

    fn sent_ns(&self) -> Nanos {
        self.instant_ns
    }
}

/// Place among `waiting`, which are in the order in which they came, of the last input that a step
/// consumed: all below number `before` were consumed before it, all below `below` are after it.
/// `None` if that input is not there, or nothing was consumed. Senders that were started again have
/// used the number several times: the step has seen those that were sent before it was done, at
/// `stepped_ns`.
pub fn last_consumed<'a, T: Numbered + 'a>(
    waiting: impl Iterator<Item = &'a T>,
    [before, below]: [u64; 2],
    stepped_ns: Nanos,
) -> Option<usize> {
    let of_number = waiting.enumerate().filter(|(_, input)| input.number().checked_add(1) == Some(below));
    let candidates: Vec<(usize, bool)> =
        of_number.map(|(at, input)| (at, input.sent_ns() <= stepped_ns)).collect();
    let seen = candidates.iter().rev().find(|(_, in_time)| *in_time);
    // Something was consumed; where the instants do not decide, it is the first of that number.
    let first = candidates.first().filter(|_| below != before);
    seen.or(first).map(|(at, _)| *at)
}

/// Version of [`StepRecord::state_hash`]: raised where the same inputs lead to another hash, so
/// that hashes of two builds are compared only where they mean the same.
pub const STATE_HASH_VERSION: u32 = 4;
/// The oldest version that hashes a scene alike that has neither a task nor a vitreous, at 50 Hz: version 3
/// changed the attempt's state alone, and version 4 what filters keep for it, and when the vitreous is looked at
/// after lost fields.
pub const STATE_HASH_OF_BARE_SCENES: u32 = 2;

/// One step: its inputs, its figures and the hash of the state it led to.
#[repr(C)]
#[derive(Debug, Clone, Copy, PartialEq, Eq, Pod, Wire, Zeroable)]
pub struct StepRecord {
    /// Counts up by one since the scene was loaded.
    #[wire(tag = 1)]
    pub step: u64,
    /// Field of the tracker frame consumed.
    #[wire(tag = 2)]
    pub field: u64,
    /// [`crate::poses::TrackerFrame::frame`] of the tracker frame consumed.
    #[wire(tag = 3)]
    pub frame: u64,
    /// Instants of the tracker frame, and `stepped`.
    #[wire(tag = 4)]
    pub instants: Instants,
    /// Handle states consumed so far have `seq` below this.
    #[wire(tag = 5)]
    pub handles_below: u64,
    /// Pedal states consumed so far have `seq` below this.
    #[wire(tag = 6)]
    pub pedals_below: u64,
    /// Time by which the state advanced, ns.
    #[wire(tag = 7)]
    pub advanced_ns: u64,
    /// Hash of the state after the step.
    #[wire(tag = 8, hash)]
    pub state_hash: u64,
    /// Time spent, by phase.
    #[wire(tag = 9, name = "times")]
    pub profile: StepProfile,
    /// Inputs refused by validation since the start.
    #[wire(tag = 10)]
    pub inputs_refused: u64,
    /// Tracker frames lost in the queue since the start.
    #[wire(tag = 11)]
    pub frames_lost: u64,
    /// Membrane that vitrectors have cut away, area at rest, µm².
    #[wire(tag = 12, columns = "")]
    pub membrane_cut_um2: u64,
    /// Retina that vitrectors have cut away, area at rest, µm².
    #[wire(tag = 13, columns = "")]
    pub retina_cut_um2: u64,
    /// Vitreous that vitrectors have removed, volume at rest, µm³.
    #[wire(tag = 14, columns = "")]
    pub vitreous_removed_um3: u64,
    /// Vitreous that is left, volume at rest, µm³.
    #[wire(tag = 15, columns = "")]
    pub vitreous_left_um3: u64,
    /// Pairs of an instrument and a sheet whose last collision image had colliding pixels. 0 also in
    /// recordings of builds that did not count them.
    #[wire(tag = 16, columns = "")]
    pub contacts: u64,
    /// [`InputsDigest::hash`] of what it consumed.
    #[wire(tag = 17, hash, columns = "")]
    pub inputs_hash: u64,
    /// Handle states consumed by this step.
    #[wire(tag = 18, columns = "")]
    pub handles_taken: u32,
    /// Pedal states consumed by this step.
    #[wire(tag = 19, columns = "")]
    pub pedals_taken: u32,
}

impl StepRecord {
    /// What it consumed.
    pub fn inputs(&self) -> InputsDigest {
        InputsDigest { hash: self.inputs_hash, handles: self.handles_taken, pedals: self.pedals_taken }
    }

    /// The same record with this for what it consumed.
    pub fn with_inputs(self, inputs: InputsDigest) -> Self {
        let InputsDigest { hash, handles, pedals } = inputs;
        StepRecord { inputs_hash: hash, handles_taken: handles, pedals_taken: pedals, ..self }
    }
}

impl Message for StepRecord {
    const CHANNEL: &'static str = "steps";
    /// 2: what vitrectors have taken. 3: one time a phase. 4: contacts. 5: digest of the inputs.
    const VERSION: u32 = 5;
    const QUEUE: usize = 512;

    fn validate(&self) -> Result<(), Invalid> {
        require(self.instants.exposed > 0, "StepRecord", "instants.exposed", "an instant", 0.0)
    }
}

/// Header of a checkpoint; the payload is the simulation's encoded state.
#[repr(C)]
#[derive(Debug, Clone, Copy, PartialEq, Eq, Pod, Wire, Zeroable)]
#[wire(name = "Checkpoint")]
pub struct CheckpointHeader {
    /// Step after which the state was taken.
    #[wire(tag = 1)]
    pub step: u64,
    /// Field of that step.
    #[wire(tag = 2)]
    pub field: u64,
    /// Handle states consumed have `seq` below this.
    #[wire(tag = 3)]
    pub handles_below: u64,
    /// Pedal states consumed have `seq` below this.
    #[wire(tag = 4)]
    pub pedals_below: u64,
    /// Hash of the state.
    #[wire(tag = 5, hash)]
    pub state_hash: u64,
    /// Bytes of the payload in use.
    #[wire(tag = 6, payload = "state")]
    pub bytes: u64,
}

impl Message for CheckpointHeader {
    const CHANNEL: &'static str = "checkpoints";
    const VERSION: u32 = 1;
    const QUEUE: usize = 1;

    fn validate(&self) -> Result<(), Invalid> {
        Ok(())
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn of_senders_that_began_anew_a_step_has_seen_those_before_it() {
        let sent = |seq, instant_ns| HandleState { seq, instant_ns, ..HandleState::zeroed() };
        // Three senders; the third is there when the step is done, the fourth is not.
        let waiting =
            [sent(7, 1), sent(0, 5), sent(1, 6), sent(0, 10), sent(1, 11), sent(0, 20), sent(1, 21)];
        let at = |below, stepped_ns| last_consumed(waiting.iter(), [7, below], stepped_ns);
        assert_eq!((at(2, 12), at(2, 8), at(2, 30)), (Some(4), Some(2), Some(6)));
        assert_eq!((at(8, 12), at(3, 12), at(0, 12)), (Some(0), None, None));
        assert_eq!(at(2, 0), Some(2), "instants without information: the first");
        let again = |stepped_ns| last_consumed(waiting[3..].iter(), [2, 2], stepped_ns);
        assert_eq!((again(12), again(9)), (Some(1), None), "a new sender has come as far as the one before");
    }

    #[test]
    fn times_that_no_clock_gave_are_summed_up_without_overflow() {
        let profile = StepProfile { tissue_ns: u64::MAX, bodies_ns: 1, misc_ns: 5, ..StepProfile::default() };
        assert_eq!(profile.paper_phases_ns(), [0, u64::MAX, 6]);
        assert_eq!(profile.step_ns(), u64::MAX);
        let usual = StepProfile { tissue_ns: 3, transfer_ns: 2, hash_ns: 4, ..StepProfile::default() };
        assert_eq!((usual.step_ns(), usual.paper_phases_ns()), (7, [0, 3, 6]));
    }
}
