//! `events`: what happened to the eye.

use crate::message::{FieldLayout, Invalid, Message, all_finite, require};
use crate::time::Nanos;
use bytemuck::{Pod, Zeroable};

/// What happened. `value` and `limit` of the event have the unit given here.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
#[repr(u32)]
pub enum EventKind {
    /// The tip came near the retina; mm of clearance.
    RetinaGrazed = 1,
    /// The tip touches the retina; mm of clearance.
    RetinaTouched = 2,
    /// The tip is inside the retina; mm of depth.
    RetinaPenetrated = 3,
    /// The tip left the retina; s that the contact lasted.
    RetinaLeft = 4,
    /// The jaws hold tissue; nodes held.
    TissueGrabbed = 10,
    /// The jaws let go; nodes released.
    TissueReleased = 11,
    /// The grip slipped; µN.
    GripSlipped = 12,
    /// Tissue tore; springs torn in this step.
    TissueTorn = 13,
    /// The membrane pulls at the retina: force on the rim near its limit; µN.
    RimForceHigh = 14,
    /// The rim lost its hold; µN.
    RimDetached = 15,
    /// An image pixel saw the membrane twice; pixels.
    NotPiConvex = 20,
    /// Triangles that a collision image cannot hold: too large, or with a bad corner; triangles.
    TrianglesRefused = 21,
    /// Triangles without area in a collision image: degenerate, or seen from their edge; triangles.
    TrianglesFlat = 22,
    /// A body that was lost is tracked again; s that it was lost.
    TrackingRegained = 30,
    /// A body is lost and touches nothing.
    TrackingLost = 31,
    /// The vitrector cut membrane away; mm² in this step.
    TissueCut = 50,
    /// Hook or jaws lift the membrane from below; nodes.
    TissueHooked = 51,
    /// The needle went through the membrane; µN along the shaft.
    MembranePierced = 52,
    /// The needle left the membrane.
    NeedleOut = 53,
    /// Another tool is in the hand; its number.
    ToolChanged = 54,
    /// Vitreous was removed, another milestone; ml in all.
    VitreousRemoved = 80,
    /// The vitreous pulls at the retina; Pa.
    VitreousTraction = 81,
    /// The vitreous came off the retina; mm² in all.
    VitreousDetached = 82,
    /// The vitreous base is pulled so hard that the retina may tear; Pa.
    BaseTraction = 83,
    /// A part of the tissue was disabled because its numbers ran away; node.
    TissueDisabled = 40,
    /// An input was refused by its validation.
    InputRefused = 41,
    /// The simulation resumed from a checkpoint; steps recomputed.
    Resumed = 42,
    /// More of the membrane is off the retina; mm² in all.
    MembranePeeled = 60,
    /// The whole membrane is off the retina; mm².
    MembraneOff = 61,
    /// The membrane pulls hard at the retina under it; Pa.
    RetinaPulled = 62,
    /// The retina came off the choroid and follows the membrane; mm of height.
    RetinaLifted = 63,
    /// Lifted retina tore; mm² in all.
    RetinaTorn = 64,
    /// The jaws hold a rigid body; rad of opening.
    BodyGripped = 90,
    /// The jaws let a rigid body go; mm from the retina to its centre.
    BodyReleased = 91,
    /// A rigid body was stopped because its numbers ran away; times in this step.
    BodyStopped = 92,
    /// A needle went through the retina; mm of depth.
    RetinaPierced = 70,
    /// A needle left the retina; mm³ that it injected.
    NeedleLeft = 71,
    /// A needle in the retina moves along it too fast; mm/s.
    NeedleFast = 72,
    /// The whole retina ripped; springs torn in this step.
    RetinaRipped = 73,
    /// The retina came off the choroid; nodes in this step.
    RetinaDetached = 74,
    /// Blebs became one; mm³ under it.
    BlebsMerged = 75,
    /// The retina lies on the choroid again; nodes in this step.
    RetinaLying = 76,
    /// The injection flows faster than advised; µl/min.
    InjectionFast = 77,
    /// Air takes the place of fluid (1), or fluid that of air (0).
    AirExchange = 78,
    /// A vitrector took retina; value: mm² at rest.
    RetinaCut = 79,
    /// The tissue is too stiff for a whole substep; parts into which each is split.
    TimeStepSplit = 100,
    /// The attempt at a task began; s allowed for it.
    TaskStarted = 110,
    /// A goal of the task is reached (`subject`); mm that it was missed by on average.
    GoalReached = 111,
    /// Every goal is reached; s since the begin.
    TaskFinished = 112,
    /// The time of the task is over; goals that are open.
    TaskTimedOut = 113,
    /// The tip left the tube; mm outside.
    PathLeft = 114,
    /// The tip is in the tube again; s outside.
    PathRegained = 115,
    /// A shaft touches the lens; mm of depth.
    LensTouched = 116,
    /// The shaft left the lens; s that the contact lasted.
    LensLeft = 117,
    /// A tip left the microscope's field of view; mm beyond its rim.
    TipOutOfView = 118,
    /// The tip is in the field of view again; s outside.
    TipInView = 119,
    /// The score of the attempt (`subject`: version of the score); points of 100.
    ScoreTotal = 120,
    /// The points of a category (`subject`); points.
    ScoreCategory = 121,
    /// Dye has coloured more of the membrane; percent of its nodes.
    MembraneStained = 122,
}

impl EventKind {
    /// Every kind.
    pub const ALL: [EventKind; 59] = [
        EventKind::RetinaGrazed,
        EventKind::RetinaTouched,
        EventKind::RetinaPenetrated,
        EventKind::RetinaLeft,
        EventKind::TissueGrabbed,
        EventKind::TissueReleased,
        EventKind::GripSlipped,
        EventKind::TissueTorn,
        EventKind::RimForceHigh,
        EventKind::RimDetached,
        EventKind::NotPiConvex,
        EventKind::TrianglesRefused,
        EventKind::TrianglesFlat,
        EventKind::TrackingRegained,
        EventKind::TrackingLost,
        EventKind::TissueCut,
        EventKind::TissueHooked,
        EventKind::MembranePierced,
        EventKind::NeedleOut,
        EventKind::ToolChanged,
        EventKind::VitreousRemoved,
        EventKind::VitreousTraction,
        EventKind::VitreousDetached,
        EventKind::BaseTraction,
        EventKind::TissueDisabled,
        EventKind::InputRefused,
        EventKind::Resumed,
        EventKind::MembranePeeled,
        EventKind::MembraneOff,
        EventKind::RetinaPulled,
        EventKind::RetinaLifted,
        EventKind::RetinaTorn,
        EventKind::BodyGripped,
        EventKind::BodyReleased,
        EventKind::BodyStopped,
        EventKind::RetinaPierced,
        EventKind::NeedleLeft,
        EventKind::NeedleFast,
        EventKind::RetinaRipped,
        EventKind::RetinaDetached,
        EventKind::BlebsMerged,
        EventKind::RetinaLying,
        EventKind::InjectionFast,
        EventKind::AirExchange,
        EventKind::RetinaCut,
        EventKind::TimeStepSplit,
        EventKind::TaskStarted,
        EventKind::GoalReached,
        EventKind::TaskFinished,
        EventKind::TaskTimedOut,
        EventKind::PathLeft,
        EventKind::PathRegained,
        EventKind::LensTouched,
        EventKind::LensLeft,
        EventKind::TipOutOfView,
        EventKind::TipInView,
        EventKind::ScoreTotal,
        EventKind::ScoreCategory,
        EventKind::MembraneStained,
    ];

    /// From the wire.
    pub fn from_wire(code: u32) -> Option<Self> {
        Self::ALL.into_iter().find(|&k| k as u32 == code)
    }

    /// In words, with the unit of the value.
    pub fn text(self) -> (&'static str, &'static str) {
        match self {
            EventKind::RetinaGrazed => ("instrument near the retina", "mm"),
            EventKind::RetinaTouched => ("instrument touches the retina", "mm"),
            EventKind::RetinaPenetrated => ("instrument in the retina", "mm"),
            EventKind::RetinaLeft => ("instrument left the retina", "s"),
            EventKind::TissueGrabbed => ("tissue grabbed", "nodes"),
            EventKind::TissueReleased => ("tissue released", "nodes"),
            EventKind::GripSlipped => ("grip slipped", "µN"),
            EventKind::TissueTorn => ("tissue torn", "springs"),
            EventKind::RimForceHigh => ("membrane pulls at the retina", "µN"),
            EventKind::RimDetached => ("membrane rim came off", "µN"),
            EventKind::NotPiConvex => ("tissue folded in the collision volume", "pixels"),
            EventKind::TrianglesRefused => ("tissue too large for the collision image", "triangles"),
            EventKind::TrianglesFlat => ("tissue seen from its edge in the collision image", "triangles"),
            EventKind::TrackingRegained => ("tracking regained", "s"),
            EventKind::TrackingLost => ("tracking lost", ""),
            EventKind::TissueCut => ("membrane cut away", "mm²"),
            EventKind::TissueHooked => ("membrane lifted from below", "nodes"),
            EventKind::MembranePierced => ("needle through the membrane", "µN"),
            EventKind::NeedleOut => ("needle out of the membrane", ""),
            EventKind::ToolChanged => ("another tool in the hand", ""),
            EventKind::VitreousRemoved => ("vitreous removed", "ml"),
            EventKind::VitreousTraction => ("vitreous pulls at the retina", "Pa"),
            EventKind::VitreousDetached => ("vitreous came off the retina", "mm²"),
            EventKind::BaseTraction => ("vitreous base pulled, the retina may tear", "Pa"),
            EventKind::TissueDisabled => ("tissue disabled", "node"),
            EventKind::InputRefused => ("input refused", ""),
            EventKind::TimeStepSplit => ("substeps split for stability", "parts"),
            EventKind::Resumed => ("simulation resumed from a checkpoint", "steps"),
            EventKind::MembranePeeled => ("membrane peeled", "mm²"),
            EventKind::MembraneOff => ("the whole membrane is off", "mm²"),
            EventKind::RetinaPulled => ("membrane pulls hard at the retina", "Pa"),
            EventKind::RetinaLifted => ("retina lifted with the membrane", "mm"),
            EventKind::RetinaTorn => ("retina torn", "mm²"),
            EventKind::BodyGripped => ("body gripped", "rad"),
            EventKind::BodyReleased => ("body placed", "mm"),
            EventKind::BodyStopped => ("body stopped, its numbers ran away", "times"),
            EventKind::RetinaPierced => ("needle in the retina", "mm"),
            EventKind::NeedleLeft => ("needle withdrawn", "mm³"),
            EventKind::NeedleFast => ("needle tears at the retina", "mm/s"),
            EventKind::RetinaRipped => ("retina ripped", "springs"),
            EventKind::RetinaDetached => ("retina lifts", "nodes"),
            EventKind::BlebsMerged => ("blebs merged", "mm³"),
            EventKind::RetinaLying => ("retina lies on", "nodes"),
            EventKind::InjectionFast => ("injection too fast", "µl/min"),
            EventKind::AirExchange => ("fluid–air exchange", ""),
            EventKind::RetinaCut => ("retina cut away", "mm²"),
            EventKind::TaskStarted => ("task begun", "s"),
            EventKind::GoalReached => ("goal reached", "mm"),
            EventKind::TaskFinished => ("task finished", "s"),
            EventKind::TaskTimedOut => ("time is over", "goals open"),
            EventKind::PathLeft => ("tip outside the path", "mm"),
            EventKind::PathRegained => ("tip back on the path", "s"),
            EventKind::LensTouched => ("instrument touches the lens", "mm"),
            EventKind::LensLeft => ("instrument left the lens", "s"),
            EventKind::TipOutOfView => ("instrument out of view", "mm"),
            EventKind::TipInView => ("instrument in view again", "s"),
            EventKind::ScoreTotal => ("score", "points"),
            EventKind::ScoreCategory => ("score of a category", "points"),
            EventKind::MembraneStained => ("membrane stained", "%"),
        }
    }
}

/// How serious it is.
#[derive(Debug, Clone, Copy, PartialEq, Eq, PartialOrd, Ord)]
#[repr(u32)]
pub enum Severity {
    /// For the record.
    Info = 0,
    /// The trainee should change something.
    Warning = 1,
    /// The eye was hurt, or the simulation is degraded.
    Injury = 2,
}

/// No instrument is concerned.
pub const NO_INSTRUMENT: u32 = u32::MAX;

/// One thing that happened.
#[repr(C)]
#[derive(Debug, Clone, Copy, PartialEq, Pod, Zeroable)]
pub struct Event {
    /// Counts up by one since the simulation began.
    pub seq: u64,
    /// Field of the step.
    pub field: u64,
    /// Exposure instant of the step.
    pub exposed_ns: Nanos,
    /// [`EventKind`] on the wire.
    pub kind: u32,
    /// [`Severity`] on the wire.
    pub severity: u32,
    /// Instrument or [`NO_INSTRUMENT`].
    pub instrument: u32,
    /// Node, triangle or body concerned; 0 if none.
    pub subject: u32,
    /// Figure of the event, in the unit of its kind.
    pub value: f64,
    /// Limit that was passed, in the same unit; 0 if none.
    pub limit: f64,
    /// Where, in the eye frame, mm.
    pub position_in_eye_mm: [f64; 3],
}

impl Message for Event {
    const CHANNEL: &'static str = "events";
    const VERSION: u32 = 1;
    const QUEUE: usize = 512;
    const FIELDS: &'static [FieldLayout] = crate::fields!(Event {
        seq,
        field,
        exposed_ns,
        kind,
        severity,
        instrument,
        subject,
        value,
        limit,
        position_in_eye_mm
    });

    fn validate(&self) -> Result<(), Invalid> {
        let kind = f64::from(self.kind);
        require(EventKind::from_wire(self.kind).is_some(), "Event", "kind", "a known kind", kind)?;
        require(self.severity <= 2, "Event", "severity", "0 to 2", f64::from(self.severity))?;
        require(all_finite(&[self.value, self.limit]), "Event", "value", "finite", self.value)?;
        require(all_finite(&self.position_in_eye_mm), "Event", "position", "finite", f64::NAN)
    }
}
