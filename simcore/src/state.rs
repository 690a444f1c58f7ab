//! Everything the next step depends on. What is not in here cannot influence a result: the state
//! hash and the checkpoints are made from this structure as a whole.

use crate::bodies::state::BodiesState;
use crate::dose::DoseState;
use crate::ticks::TickState;
use crate::tools::ToolsState;
use collision::eyeball::RetinaContact;
use nalgebra::{Isometry3, Vector3};
use protocol::limits::{BODIES, INSTRUMENTS};
use protocol::time::Nanos;
use serde::{Deserialize, Serialize};
use tissue::retina::state::RetinaState;
use tissue::sheet::stain::StainState;
use tissue::sheet::state::SheetState;
use tissue::vitreous::state::VitreousState;
use training::score::Meter;
use training::task::TaskState;

/// The simulation's state.
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize)]
pub struct State {
    /// Steps done.
    pub step: u64,
    /// Field of the last step.
    pub field: u64,
    /// Tracker frame of the last step.
    pub frame: u64,
    /// Exposure of the last step; 0 before the first.
    pub exposed_ns: Nanos,
    /// Time by which the substeps lag behind `exposed_ns`, below one substep.
    pub remainder_ns: u64,
    /// Substeps done.
    pub substeps: u64,
    /// `seq` + 1 of the last handle state consumed.
    pub handles_below: u64,
    /// `seq` + 1 of the last pedal state consumed.
    pub pedals_below: u64,
    /// Number of the next event.
    pub next_event: u64,
    /// Inputs refused by the world itself.
    pub refused: u64,
    /// `world_from_eye`, the last that was tracked.
    pub world_from_eye: Isometry3<f64>,
    /// Whether the bodies are tracked, in the order of the tracker frame.
    pub tracking: [TrackingState; BODIES],
    /// The instruments.
    pub instruments: [InstrumentState; INSTRUMENTS],
    /// The membrane.
    pub membrane: SheetState,
    /// Rigid bodies, where the scene has some.
    pub bodies: Option<BodiesState>,
    /// The vitreous, where there is one.
    pub vitreous: Option<VitreousState>,
    /// The microscope and its pedal.
    pub microscope: MicroscopeState,
    /// Pump, blade and syringe.
    pub tools: ToolsState,
    /// Bleeding points on the retina.
    pub marks: Vec<MarkState>,
    /// Kind of the newest warning, 0 for none.
    pub notice_kind: u32,
    /// Until when (exposure) it is shown.
    pub notice_until_ns: Nanos,
    /// The whole retina, where the scene has it as tissue.
    pub retina: Option<RetinaState>,
    /// The attempt at the scene's task, and what its score is made from.
    pub task: Option<(TaskState, Meter)>,
    /// Lens, inverter and filter; `None` as long as the scene asks for none and no button was
    /// pressed.
    pub optics: Option<OpticsState>,
    /// Dye on the membrane, once a jet has reached it.
    pub stain: Option<StainState>,
    /// What has come together since the last tick. Saved beside the rest; hashed where something has.
    #[serde(skip)]
    pub ticks: TickState,
    /// Light on the retina, by place. Saved, but not hashed: no result depends on it.
    #[serde(skip, default = "DoseState::start")]
    pub dose: DoseState,
}

impl State {
    /// True while an instrument holds membrane or retina.
    pub fn holds_tissue(&self, instrument: usize) -> bool {
        self.sheets().any(|sheet| !sheet.held[instrument].is_empty())
    }

    /// The sheets there are.
    pub fn sheets(&self) -> impl Iterator<Item = &SheetState> {
        std::iter::once(&self.membrane).chain(self.retina.as_ref().map(|retina| &retina.sheet))
    }
}

/// Whether a body is tracked.
#[derive(Debug, Clone, Copy, Default, PartialEq, Eq, Serialize, Deserialize)]
pub struct TrackingState {
    /// It is, or is predicted from when it was.
    pub tracked: bool,
    /// Exposure at which it was lost; 0 while tracked or never seen.
    pub lost_ns: Nanos,
}

/// An instrument.
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize)]
pub struct InstrumentState {
    /// [`protocol::handles::Tool`] on the wire.
    pub tool: u32,
    /// Jaw opening at the last substep, rad.
    pub jaw_rad: f64,
    /// Jaw opening the handle asked for last, rad.
    pub jaw_target_rad: f64,
    /// `eye_from_instrument` at the last exposure.
    pub eye_from_instrument: Isometry3<f64>,
    /// `world_from_instrument` at the last exposure.
    pub world_from_instrument: Isometry3<f64>,
    /// Tip at the last substep, eye frame, mm.
    pub tip_in_eye_mm: Vector3<f64>,
    /// It is tracked, inside the eye, and may touch tissue.
    pub touches: bool,
    /// Contact with the retina.
    pub retina: RetinaContact,
    /// No fold is reported before this exposure.
    pub fold_quiet_ns: Nanos,
}

/// The microscope.
#[derive(Debug, Clone, Copy, PartialEq, Serialize, Deserialize)]
pub struct MicroscopeState {
    /// Point looked at, world frame, mm.
    pub target_in_world_mm: [f64; 3],
    /// Diameter of the field of view, mm.
    pub field_mm: f64,
    /// Height of the plane of focus over the target, mm.
    pub focus_mm: f64,
    /// Pedal axes, −1 to 1.
    pub axes: [f64; 2],
    /// Pedal mode.
    pub mode: u32,
}

/// What stands between microscope and eye.
#[derive(Debug, Clone, Copy, Default, PartialEq, Serialize, Deserialize)]
pub struct OpticsState {
    /// Buttons held at the last pedal state.
    pub buttons: u32,
    /// [`protocol::optics::Lens`] on the wire.
    pub lens: u32,
    /// The inverter is on.
    pub inverter: bool,
    /// [`protocol::optics::Filter`] of the lamp, on the wire.
    pub filter: u32,
}

/// A bleeding point.
#[derive(Debug, Clone, Copy, PartialEq, Serialize, Deserialize)]
pub struct MarkState {
    /// Eye frame, mm.
    pub position_mm: [f32; 3],
    /// mm.
    pub radius_mm: f32,
}
