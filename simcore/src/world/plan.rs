//! What a step will do, from its inputs: by how much it advances, and on which ways the instruments
//! move.

use super::World;
use crate::constants::{MAX_TIP_RADII, MAX_TIP_SPEED_MM_S};
use crate::microscope;
use crate::state::{InstrumentState, TrackingState};
use crate::sweep::{Sweep, share};
use crate::ticks::{reaches, ticks_at};
use collision::eyeball::AWAY;
use nalgebra::{Isometry3, Vector3};
use protocol::events::{EventDraft, EventKind};
use protocol::geometry::Validity;
use protocol::handles::{HandleState, JAW_LENGTH_MM, PedalState, Tool};
use protocol::limits::{INSTRUMENTS, MAX_STEP_NS, SUBSTEP_NS, TICK_NS};
use protocol::message::Message;
use protocol::poses::{EYE, TrackerFrame};
use tissue::sheet::grasp;

/// A step's way from the last exposure to this one.
#[derive(Debug, Clone, Copy)]
pub struct StepPlan {
    /// Time between the two exposures; 0 for the first one, after a pause, and backwards.
    pub advance_ns: u64,
    /// Substeps to do.
    pub substeps: u64,
    /// Ticks before and after them: one more after a regular step at 50 Hz, and at most 11, since a longer
    /// gap is a pause.
    ticks: [u64; 2],
    /// Lag of the substeps at the start.
    remainder_ns: u64,
    /// Ways of the instruments in the eye frame.
    sweeps: [Sweep; INSTRUMENTS],
    /// Whether they touch anything on it.
    pub touches: [bool; INSTRUMENTS],
    /// Jaw openings at both ends, rad.
    jaws: [[f64; 2]; INSTRUMENTS],
}

impl StepPlan {
    /// Share of the way at the end of substep `k`.
    pub fn share(&self, k: u64) -> f64 {
        share(k, SUBSTEP_NS, self.remainder_ns, self.advance_ns)
    }

    /// Pose of an instrument at share `s`, eye frame.
    pub fn pose(&self, instrument: usize, s: f64) -> Isometry3<f64> {
        self.sweeps[instrument].pose(s)
    }

    /// Ticks that end in this step.
    pub fn ticks(&self) -> u64 {
        self.ticks[1] - self.ticks[0]
    }

    /// Their time, s.
    pub fn ticked_s(&self) -> f64 {
        (self.ticks() * TICK_NS) as f64 * 1e-9
    }

    /// True if what is done every so many ticks is done in this step.
    pub fn reaches(&self, every: u64) -> bool {
        reaches(every, self.ticks)
    }

    /// True where what was warned of may be warned of again: at a tick, and in a pause.
    pub fn rearms(&self) -> bool {
        self.ticks() > 0 || self.substeps == 0
    }

    /// Jaw opening at share `s`, rad.
    pub fn jaw(&self, instrument: usize, s: f64) -> f64 {
        let [from, to] = self.jaws[instrument];
        from + (to - from) * s
    }
}

/// An instrument that was never seen.
pub fn start_instrument(tool: Tool) -> InstrumentState {
    InstrumentState {
        tool: tool as u32,
        jaw_rad: 0.0,
        jaw_target_rad: 0.0,
        eye_from_instrument: Isometry3::identity(),
        world_from_instrument: Isometry3::identity(),
        tip_in_eye_mm: Vector3::zeros(),
        touches: false,
        retina: AWAY,
        fold_quiet_ns: 0,
    }
}

impl World {
    /// Takes the newest jaw opening and tool of each instrument.
    pub(super) fn apply_handles(&mut self, handles: &[HandleState]) {
        for handle in handles {
            if handle.validate().is_err() {
                self.refuse();
                continue;
            }
            let instrument = &mut self.state.instruments[handle.instrument as usize];
            if instrument.tool != handle.tool {
                let event = EventDraft::new(EventKind::ToolChanged, f64::from(handle.tool));
                self.log.emit(event.by(handle.instrument as usize, instrument.tip_in_eye_mm.into()));
                // Another shape is somewhere else: it has no way, and no contact.
                instrument.touches = false;
            }
            (instrument.tool, instrument.jaw_target_rad) = (handle.tool, handle.jaw_rad);
            self.state.handles_below = handle.seq.wrapping_add(1);
        }
        for i in 0..INSTRUMENTS {
            self.change_tool(i);
            if !grasp::has_jaws(self.state.instruments[i].tool) {
                self.let_go(i);
            }
        }
    }

    /// Gives the collision image the shape of what is in the hand.
    fn change_tool(&mut self, i: usize) {
        if let Some(tool) = Tool::from_wire(self.state.instruments[i].tool) {
            self.images[i].set_tool(tool, &self.volume);
        }
    }

    /// Takes the pedal's states in order; the last one counts.
    pub(super) fn apply_pedals(&mut self, pedals: &[PedalState]) {
        for pedal in pedals {
            if pedal.validate().is_err() {
                self.refuse();
                continue;
            }
            let state = &mut self.state;
            microscope::apply_pedal(&mut state.microscope, &mut state.optics, pedal, &self.scene);
            self.state.tools.press(pedal, &self.figures);
            self.state.pedals_below = pedal.seq.wrapping_add(1);
        }
    }

    fn refuse(&mut self) {
        self.state.refused += 1;
        let count = self.state.refused as f64;
        self.log.emit(EventDraft::new(EventKind::InputRefused, count));
    }

    /// Decides what this step does and takes the poses in.
    pub(super) fn plan(&mut self, frame: &TrackerFrame) -> StepPlan {
        let (last, now) = (self.state.exposed_ns, frame.instants.exposed);
        let regular = last > 0 && now > last && now - last <= MAX_STEP_NS;
        let advance_ns = if regular { now - last } else { 0 };
        let lag_ns = self.state.remainder_ns + advance_ns;
        let substeps = lag_ns / SUBSTEP_NS;
        let mut plan = StepPlan {
            advance_ns,
            substeps,
            ticks: [self.state.substeps, self.state.substeps + substeps].map(ticks_at),
            remainder_ns: self.state.remainder_ns,
            sweeps: [Sweep::at(Isometry3::identity()); INSTRUMENTS],
            touches: [false; INSTRUMENTS],
            jaws: [[0.0; 2]; INSTRUMENTS],
        };
        self.state.remainder_ns = lag_ns % SUBSTEP_NS;
        (self.state.exposed_ns, self.state.field, self.state.frame) = (now, frame.field, frame.frame);
        let eye_tracked = self.note_tracking(frame, EYE);
        if eye_tracked {
            self.state.world_from_eye = frame.bodies[EYE].world_from_body.isometry();
        }
        for i in 0..INSTRUMENTS {
            let tracked = self.note_tracking(frame, i) && eye_tracked;
            self.plan_instrument(&mut plan, frame, i, tracked);
        }
        plan
    }

    fn plan_instrument(&mut self, plan: &mut StepPlan, frame: &TrackerFrame, i: usize, tracked: bool) {
        let reach = self.scene.eye.retina_radius_mm * MAX_TIP_RADII;
        let state = &self.state.instruments[i];
        let world_from_instrument = frame.bodies[i].world_from_body.isometry();
        let to = self.state.world_from_eye.inverse() * world_from_instrument;
        let present = tracked && to.translation.vector.norm() < reach;
        let way = Sweep { from: state.eye_from_instrument, to };
        let possible = MAX_TIP_SPEED_MM_S * plan.advance_ns as f64 * 1e-9;
        let sweeps = state.touches && present && plan.advance_ns > 0 && way.length_mm() <= possible;
        let torn_off = !present || (!sweeps && way.length_mm() > self.scene.contact.grab_reach_mm);
        if torn_off {
            self.let_go(i);
        }
        let state = &mut self.state.instruments[i];
        plan.jaws[i] = [state.jaw_rad, state.jaw_target_rad];
        plan.touches[i] = sweeps;
        state.touches = present;
        plan.sweeps[i] = if sweeps { way } else { Sweep::at(if present { to } else { way.from }) };
        if present {
            (state.eye_from_instrument, state.world_from_instrument) = (to, world_from_instrument);
        }
        if !sweeps {
            state.tip_in_eye_mm = plan.sweeps[i].to.translation.vector;
            plan.jaws[i][0] = state.jaw_target_rad;
            state.jaw_rad = state.jaw_target_rad;
            let open = state.jaw_rad > self.scene.contact.release_above_rad;
            self.leave_sheets(i);
            if open {
                self.let_go(i);
            }
        }
    }

    /// True if a body of the frame is tracked; raises an event when that changes.
    fn note_tracking(&mut self, frame: &TrackerFrame, body: usize) -> bool {
        let found = &frame.bodies[body];
        let tracked = found.validity() != Validity::Lost && found.world_from_body.is_valid();
        let state = &mut self.state.tracking[body];
        let before = *state;
        if tracked == before.tracked {
            return tracked;
        }
        let now = frame.instants.exposed;
        *state = TrackingState { tracked, lost_ns: if tracked { 0 } else { now } };
        let mut happening = EventDraft::new(EventKind::TrackingLost, 0.0);
        if tracked {
            let lost_s = now.saturating_sub(before.lost_ns) as f64 * 1e-9;
            happening = EventDraft::new(EventKind::TrackingRegained, lost_s);
        }
        if body < INSTRUMENTS {
            happening = happening.by(body, self.state.instruments[body].tip_in_eye_mm.into());
        }
        happening.subject = body as u32;
        // The first pose of all regains nothing.
        if !tracked || before.lost_ns > 0 {
            self.log.emit(happening);
        }
        tracked
    }

    /// Moves tips and jaws to the end of substep `k`; returns the poses in the eye frame.
    pub(super) fn move_instruments(&mut self, plan: &StepPlan, k: u64) -> InstrumentPoses {
        let s = plan.share(k);
        let poses: [Isometry3<f64>; INSTRUMENTS] = std::array::from_fn(|i| plan.pose(i, s));
        let mut tip_step_mm = [Vector3::zeros(); INSTRUMENTS];
        let mut travelled_mm = [0.0; INSTRUMENTS];
        for (i, pose) in poses.iter().enumerate() {
            let state = &mut self.state.instruments[i];
            tip_step_mm[i] = pose.translation.vector - state.tip_in_eye_mm;
            state.tip_in_eye_mm = pose.translation.vector;
            let jaws = plan.touches[i] && grasp::has_jaws(state.tool);
            let turn_rad = if jaws { (plan.jaw(i, s) - state.jaw_rad).abs() } else { 0.0 };
            travelled_mm[i] = tip_step_mm[i].norm() + 0.5 * turn_rad * JAW_LENGTH_MM;
        }
        InstrumentPoses { eye_from_instrument: poses, tip_step_mm, travelled_mm }
    }
}

/// Instruments at the end of a substep.
#[derive(Debug, Clone, Copy)]
pub struct InstrumentPoses {
    /// `eye_from_instrument`.
    pub eye_from_instrument: [Isometry3<f64>; INSTRUMENTS],
    /// Way of the tip in this substep, eye frame, mm.
    pub tip_step_mm: [Vector3<f64>; INSTRUMENTS],
    /// Way of tip and jaws in this substep, mm.
    pub travelled_mm: [f64; INSTRUMENTS],
}
