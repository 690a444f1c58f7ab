//! Membrane and retina in a step: jaws carry them, ports draw and cut them, forces move them,
//! instruments push them.

use super::plan::{InstrumentPoses, StepPlan};
use super::tools::PlacedTools;
use super::{NO_MESH, World};
use crate::checkpoint::CheckpointError;
use crate::state::State;
use nalgebra::Vector3;
use protocol::events::{EventDraft, EventKind};
use protocol::handles::Tool;
use protocol::limits::INSTRUMENTS;
use tissue::retina::{Retina, RetinaCounts};
use tissue::sheet::body::SheetBody;
use tissue::sheet::collider::Pusher;
use tissue::sheet::grasp::{self, Grasp};
use tissue::sheet::state::SheetState;
use tissue::sheet::step_counts::SheetCounts;

/// A sheet of the eye.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub(super) enum SheetName {
    Membrane,
    Retina,
}

impl SheetName {
    /// Every sheet, from the inside of the eye.
    pub const ALL: [SheetName; 2] = [SheetName::Membrane, SheetName::Retina];
}

/// What happened to the sheets in a step.
#[derive(Debug, Default)]
pub(super) struct SheetsCounts {
    pub membrane: SheetCounts,
    pub retina: RetinaCounts,
    /// Area of the membrane that was parted before the step, mm².
    pub freed_before_mm2: f64,
}

impl SheetsCounts {
    /// Adds those of a later phase.
    pub fn merge(&mut self, later: &SheetsCounts) {
        self.membrane.merge(&later.membrane);
        self.retina.merge(&later.retina);
    }
}

impl World {
    /// What happened to the sheets in the phase that ends.
    fn take_sheet_counts(&mut self) -> SheetsCounts {
        SheetsCounts {
            membrane: self.membrane.as_mut().map_or_else(Default::default, SheetBody::take_counts),
            retina: self.retina.as_mut().map_or_else(Default::default, Retina::take_counts),
            freed_before_mm2: 0.0,
        }
    }

    /// A sheet and its state; `None` where the scene has no such tissue.
    pub(super) fn sheet_mut(&mut self, name: SheetName) -> Option<(&mut SheetBody, &mut SheetState)> {
        match name {
            SheetName::Membrane => Some((self.membrane.as_mut()?, &mut self.state.membrane)),
            SheetName::Retina => {
                Some((&mut self.retina.as_mut()?.body, &mut self.state.retina.as_mut()?.sheet))
            }
        }
    }

    /// One substep of membrane and retina.
    pub(super) fn move_sheets(&mut self, poses: &InstrumentPoses, tools: &PlacedTools) -> SheetsCounts {
        let pose = &poses.eye_from_instrument;
        if let Some(body) = &mut self.membrane {
            let sheet = &mut self.state.membrane;
            body.draw(sheet, &tools.ports, pose);
            for _ in 0..body.splits() {
                body.advance(sheet);
            }
        }
        self.move_retina(poses, tools);
        self.take_sheet_counts()
    }

    /// Jaws carry what they hold; they close, open or slip during substep `k`.
    pub(super) fn use_forceps(&mut self, plan: &StepPlan, poses: &InstrumentPoses, k: u64) {
        for i in 0..INSTRUMENTS {
            let instrument = &mut self.state.instruments[i];
            let (before, now) = (instrument.jaw_rad, plan.jaw(i, plan.share(k)));
            instrument.jaw_rad = now;
            if !plan.touches[i] || !grasp::has_jaws(instrument.tool) {
                continue;
            }
            self.carry(i, poses);
            match grasp::grasp(before, now, &self.scene.contact) {
                Some(Grasp::Closed) if !self.state.holds_tissue(i) => self.grab(i, poses),
                Some(Grasp::Opened) => self.let_go(i),
                _ => self.slip(i),
            }
        }
    }

    /// Moves what instrument `i` holds with it.
    fn carry(&mut self, i: usize, poses: &InstrumentPoses) {
        for name in SheetName::ALL {
            let Some((body, sheet)) = self.sheet_mut(name) else { continue };
            body.carry(sheet, i, &poses.eye_from_instrument[i]);
        }
    }

    /// Binds what is in the jaws, of the first sheet that has something there.
    fn grab(&mut self, i: usize, poses: &InstrumentPoses) {
        let (reach_mm, pose) = (self.scene.contact.grab_reach_mm, &poses.eye_from_instrument[i]);
        for name in SheetName::ALL {
            let Some((body, sheet)) = self.sheet_mut(name) else { continue };
            let held = body.grab(sheet, i, pose, reach_mm);
            if held > 0 {
                return self.emit_by(i, EventKind::TissueGrabbed, held as f64);
            }
        }
    }

    /// Opens the grip of instrument `i`, if it holds anything.
    pub(super) fn let_go(&mut self, i: usize) {
        for name in SheetName::ALL {
            let Some((body, sheet)) = self.sheet_mut(name) else { continue };
            let released = body.let_go(sheet, i);
            if released > 0 {
                self.emit_by(i, EventKind::TissueReleased, released as f64);
            }
        }
    }

    /// Opens a grip that the tissue pulls out of.
    fn slip(&mut self, i: usize) {
        let limit = self.scene.contact.grip_un;
        for name in SheetName::ALL {
            let Some((body, sheet)) = self.sheet_mut(name) else { continue };
            let pull = body.pull_un(sheet, i);
            if pull > limit {
                body.let_go(sheet, i);
                let tip = self.state.instruments[i].tip_in_eye_mm.into();
                let event = EventDraft::new(EventKind::GripSlipped, pull).by(i, tip);
                self.log.emit(EventDraft { limit, ..event });
            }
        }
    }

    /// Raises an event of instrument `i` at its tip.
    pub(super) fn emit_by(&mut self, i: usize, kind: EventKind, value: f64) {
        let tip = self.state.instruments[i].tip_in_eye_mm.into();
        self.log.emit(EventDraft::new(kind, value).by(i, tip));
    }

    /// ZCOLL for every instrument near a sheet; jaws that hold tissue of it push none of it.
    pub(super) fn push_sheets(
        &mut self,
        plan: &StepPlan,
        poses: &InstrumentPoses,
        tools: &PlacedTools,
    ) -> SheetsCounts {
        for i in 0..INSTRUMENTS {
            let tool = Tool::from_wire(self.state.instruments[i].tool);
            let Some(tool) = tool.filter(|_| plan.touches[i]) else {
                self.leave_sheets(i);
                continue;
            };
            self.images[i].prepare(self.state.instruments[i].jaw_rad, &self.volume);
            let pusher = Pusher {
                instrument: i,
                tool,
                image: &self.images[i],
                eye_from_instrument: poses.eye_from_instrument[i],
                tip_step_mm: poses.tip_step_mm[i],
                travelled_mm: poses.travelled_mm[i],
                tip_from_mm: plan.pose(i, 0.0).translation.vector,
                needle: tools.needles[i],
            };
            let membrane = self.membrane.as_mut();
            let membrane = membrane.map(|membrane| membrane.push(&mut self.state.membrane, &pusher));
            let retina = self.retina.as_mut().zip(self.state.retina.as_mut());
            let retina = retina.map(|(retina, state)| retina.push(state, &pusher));
            membrane.iter().chain(&retina).for_each(|pushed| self.emit_push(i, pushed));
        }
        self.take_sheet_counts()
    }

    /// Instrument `i` touches no sheet.
    pub(super) fn leave_sheets(&mut self, i: usize) {
        for name in SheetName::ALL {
            if let Some((body, sheet)) = self.sheet_mut(name) {
                body.leave(sheet, i);
            }
        }
    }

    /// The last checks of a step, and the events of what happened to the sheets in it.
    pub(super) fn end_sheets(&mut self, plan: &StepPlan, mut counts: SheetsCounts) {
        if let Some(membrane) = &mut self.membrane {
            membrane.check_finite(&mut self.state.membrane);
        }
        if let (Some(model), Some(retina)) = (&mut self.retina, &mut self.state.retina) {
            model.end_step(retina);
        }
        counts.merge(&self.take_sheet_counts());
        self.emit_retina(&counts.retina, plan.rearms());
        self.emit_sheet_counts(SheetName::Membrane, &counts.membrane);
        self.emit_sheet_counts(SheetName::Retina, &counts.retina.sheet);
        self.emit_rim(&counts.membrane, plan.rearms());
        if plan.substeps > 0 {
            self.emit_traction(&counts.membrane.parting, plan.rearms());
            if counts.membrane.parting.broken > 0 {
                self.emit_peeled(counts.freed_before_mm2);
            }
        }
    }

    /// Refuses sheets that are not the scene's.
    pub(super) fn check_sheets(&self, state: &State) -> Result<(), CheckpointError> {
        let refuse = |sheet: &'static str| move |problem| CheckpointError::Sheet { sheet, problem };
        let membrane = match &self.membrane {
            Some(membrane) => membrane.check(&state.membrane),
            None => state.membrane.check(&NO_MESH),
        };
        membrane.map_err(refuse("membrane"))?;
        match (&self.retina, &state.retina) {
            (None, None) => Ok(()),
            (Some(model), Some(retina)) => model.check(retina).map_err(refuse("retina")),
            _ => Err(CheckpointError::Content("only one of scene and state has a retina")),
        }
    }

    /// Force with which the membrane in the jaws of an instrument pulls, µN.
    pub fn pull_un(&self, instrument: usize) -> f64 {
        self.membrane.as_ref().map_or(0.0, |body| body.pull_un(&self.state.membrane, instrument))
    }

    /// Place of a node in `f64`, eye frame, mm.
    pub(super) fn place_mm(sheet: &SheetState, node: usize) -> Vector3<f64> {
        sheet.position(node).map(f64::from)
    }
}
