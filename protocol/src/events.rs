//! `events`: findings of the simulation about eye, task and inputs.
//!
//! One table, [`EVENTS`], holds every kind of event; the enum and its lookups are made from it.

use crate::message::{Invalid, Message, all_finite, require};
use crate::time::Nanos;
use crate::wire::Wire;
use bytemuck::{Pod, Zeroable};
use serde::de::{Error, Unexpected, Visitor};
use serde::{Deserialize, Deserializer, Serialize, Serializer};

/// A row of [`EVENTS`].
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub struct EventInfo {
    /// Kind; its number on the wire is never used again.
    pub kind: EventKind,
    /// Name in scene and module files.
    pub name: &'static str,
    /// Unit of [`Event::value`] and [`Event::limit`]; empty if they have none.
    pub unit: &'static str,
    /// Severity of every event of the kind.
    pub severity: Severity,
    /// Short text for people.
    pub text: &'static str,
}

/// Makes the enum [`EventKind`] and the table [`EVENTS`] from rows of kind, number, name, unit,
/// severity and text.
macro_rules! events {
    ($($(#[$doc:meta])* $kind:ident = $number:literal, $name:literal, $unit:literal, $severity:ident, $text:literal;)*) => {
        /// Kind of an event. The last words of each doc are the quantity in [`Event::value`].
        #[derive(Debug, Clone, Copy, PartialEq, Eq)]
        #[repr(u32)]
        pub enum EventKind {
            $($(#[$doc])* $kind = $number,)*
        }

        /// Every kind of event, by number.
        pub const EVENTS: &[EventInfo] = &[$(EventInfo {
            kind: EventKind::$kind,
            name: $name,
            unit: $unit,
            severity: Severity::$severity,
            text: $text,
        }),*];
    };
}

events! {
    /// The tip came near the retina; clearance.
    RetinaGrazed = 1, "retina.grazed", "mm", Info, "instrument near the retina";
    /// The tip touches the retina; clearance.
    RetinaTouched = 2, "retina.touched", "mm", Warning, "instrument touches the retina";
    /// The tip is inside the retina; depth.
    RetinaPenetrated = 3, "retina.penetrated", "mm", Injury, "instrument in the retina";
    /// The tip left the retina; duration of the contact.
    RetinaLeft = 4, "retina.left", "s", Info, "instrument left the retina";
    /// The jaws hold tissue; nodes held.
    TissueGrabbed = 10, "tissue.grabbed", "nodes", Info, "tissue grabbed";
    /// The jaws let go; nodes released.
    TissueReleased = 11, "tissue.released", "nodes", Info, "tissue released";
    /// The grip slipped; force at which it did.
    GripSlipped = 12, "tissue.grip_slipped", "µN", Warning, "grip slipped";
    /// Tissue tore; springs torn in this step.
    TissueTorn = 13, "tissue.torn", "springs", Info, "tissue torn";
    /// The membrane pulls at the retina; force on its rim.
    RimForceHigh = 14, "membrane.rim_force_high", "µN", Warning, "membrane pulls at the retina";
    /// The rim came off the retina; force on it.
    RimDetached = 15, "membrane.rim_detached", "µN", Injury, "membrane rim came off";
    /// The collision image saw the membrane twice in a pixel; pixels.
    NotPiConvex = 20, "collision.not_pi_convex", "pixels", Info, "tissue folded in the collision volume";
    /// Triangles that a collision image cannot hold (too large, or a bad corner); count.
    TrianglesRefused = 21, "collision.triangles_refused", "triangles", Warning, "tissue too large for the collision image";
    /// Triangles without area in a collision image (degenerate, or seen edge-on); count.
    TrianglesFlat = 22, "collision.triangles_flat", "triangles", Info, "tissue seen from its edge in the collision image";
    /// A lost body is tracked again; time that it was lost.
    TrackingRegained = 30, "tracking.regained", "s", Info, "tracking regained";
    /// A body is lost and touches nothing.
    TrackingLost = 31, "tracking.lost", "", Warning, "tracking lost";
    /// Tissue was disabled because its numbers ran away; node.
    TissueDisabled = 40, "simulation.tissue_disabled", "node", Injury, "tissue disabled";
    /// Validation refused inputs; refused so far.
    InputRefused = 41, "simulation.input_refused", "", Warning, "input refused";
    /// The simulation resumed from a checkpoint; steps recomputed.
    Resumed = 42, "simulation.resumed", "steps", Warning, "simulation resumed from a checkpoint";
    /// The simulation stood still and passed over what it missed; for how long.
    Slept = 43, "simulation.slept", "ms", Warning, "simulation stood still";
    /// The vitrector cut membrane away; area in this step.
    TissueCut = 50, "membrane.cut", "mm²", Info, "membrane cut away";
    /// Hook or jaws lift the membrane from below; nodes.
    TissueHooked = 51, "membrane.hooked", "nodes", Info, "membrane lifted from below";
    /// The needle went through the membrane; force along the shaft.
    MembranePierced = 52, "membrane.pierced", "µN", Info, "needle through the membrane";
    /// The needle left the membrane.
    NeedleOut = 53, "membrane.needle_left", "", Info, "needle out of the membrane";
    /// The instrument has another tool; its number.
    ToolChanged = 54, "instrument.tool_changed", "", Info, "another tool in the hand";
    /// More of the membrane is off the retina; area in all.
    MembranePeeled = 60, "membrane.peeled", "mm²", Info, "membrane peeled";
    /// The whole membrane is off the retina; its area.
    MembraneOff = 61, "membrane.off", "mm²", Info, "the whole membrane is off";
    /// The membrane pulls hard at the retina under it; stress.
    RetinaPulled = 62, "retina.pulled", "Pa", Warning, "membrane pulls hard at the retina";
    /// The retina came off the choroid with the membrane; height.
    RetinaLifted = 63, "retina.lifted", "mm", Injury, "retina lifted with the membrane";
    /// Lifted retina tore; area in all.
    RetinaTorn = 64, "retina.torn", "mm²", Injury, "retina torn";
    /// A needle went through the retina; depth.
    RetinaPierced = 70, "retina.pierced", "mm", Info, "needle in the retina";
    /// A needle left the retina; volume that it injected.
    BlebFilled = 71, "retina.bleb_filled", "mm³", Info, "needle withdrawn";
    /// A needle in the retina moves along it too fast; speed.
    NeedleFast = 72, "retina.needle_fast", "mm/s", Warning, "needle tears at the retina";
    /// The whole retina ripped; springs torn in this step.
    RetinaRipped = 73, "retina.ripped", "springs", Injury, "retina ripped";
    /// The retina came off the choroid; nodes in this step.
    RetinaDetached = 74, "retina.detached", "nodes", Info, "retina lifts";
    /// Blebs became one; volume under it.
    BlebsMerged = 75, "retina.blebs_merged", "mm³", Info, "blebs merged";
    /// The retina lies on the choroid again; nodes in this step.
    RetinaReattached = 76, "retina.reattached", "nodes", Info, "retina lies on";
    /// The injection flows faster than advised; flow.
    InjectionFast = 77, "retina.injection_fast", "µl/min", Warning, "injection too fast";
    /// Air takes the place of fluid (1), or fluid that of air (0).
    AirExchange = 78, "retina.air_exchange", "", Info, "fluid–air exchange";
    /// A vitrector cut retina away; area at rest.
    RetinaCut = 79, "retina.cut", "mm²", Injury, "retina cut away";
    /// Another milestone of vitreous was removed; volume in all.
    VitreousRemoved = 80, "vitreous.removed", "ml", Info, "vitreous removed";
    /// The vitreous pulls at the retina; stress.
    VitreousTraction = 81, "vitreous.traction", "Pa", Warning, "vitreous pulls at the retina";
    /// The vitreous came off the retina; area in all.
    VitreousDetached = 82, "vitreous.detached", "mm²", Info, "vitreous came off the retina";
    /// The vitreous base is pulled so hard that the retina may tear; stress.
    BaseTraction = 83, "vitreous.base_traction", "Pa", Injury, "vitreous base pulled, the retina may tear";
    /// The jaws hold a rigid body; opening.
    BodyGripped = 90, "body.gripped", "rad", Info, "body gripped";
    /// The jaws let a rigid body go; distance of its centre from the retina.
    BodyReleased = 91, "body.released", "mm", Info, "body placed";
    /// A rigid body was stopped because its numbers ran away; times in this step.
    BodyStopped = 92, "body.stopped", "times", Injury, "body stopped: its state diverged";
    /// The tissue is too stiff for a whole substep; parts of each.
    TimeStepSplit = 100, "simulation.step_split", "parts", Info, "substeps split for stability";
    /// The attempt at a task began; time allowed.
    TaskStarted = 110, "task.started", "s", Info, "task begun";
    /// A goal of the task (`subject`) is reached; mean miss.
    GoalReached = 111, "task.goal_reached", "mm", Info, "goal reached";
    /// Every goal is reached; time since the start.
    TaskFinished = 112, "task.finished", "s", Info, "task finished";
    /// The time of the task is over; open goals.
    TaskTimedOut = 113, "task.timed_out", "goals open", Warning, "time is up";
    /// The tip left the tube around the path; distance outside.
    PathLeft = 114, "task.path_left", "mm", Warning, "tip outside the path";
    /// The tip is in the tube again; time outside.
    PathRegained = 115, "task.path_regained", "s", Info, "tip back on the path";
    /// A shaft touches the lens; depth.
    LensTouched = 116, "lens.touched", "mm", Injury, "instrument touches the lens";
    /// The shaft left the lens; duration of the contact.
    LensLeft = 117, "lens.left", "s", Info, "instrument left the lens";
    /// A tip left the microscope's field of view; distance beyond its rim.
    TipOutOfView = 118, "view.tip_left", "mm", Info, "instrument out of view";
    /// The tip is in the field of view again; time outside.
    TipInView = 119, "view.tip_regained", "s", Info, "instrument in view again";
    /// Score of the attempt (`subject`: version of the score).
    ScoreTotal = 120, "score.total", "points", Info, "score";
    /// Score of a category (`subject`).
    ScoreCategory = 121, "score.category", "points", Info, "score of a category";
    /// Dye coloured more of the membrane; share of its nodes.
    MembraneStained = 122, "membrane.stained", "%", Info, "membrane stained";
    /// A goal is done in part; share of it, in tenths.
    GoalProgress = 123, "task.goal_progress", "share", Info, "goal done in part";
}

impl EventKind {
    /// The kind with this number on the wire.
    pub fn from_wire(code: u32) -> Option<Self> {
        EVENTS.binary_search_by_key(&code, |e| e.kind as u32).ok().map(|i| EVENTS[i].kind)
    }

    /// The kind with this name, as in module files.
    pub fn from_name(name: &str) -> Option<Self> {
        EVENTS.iter().find(|e| e.name == name).map(|e| e.kind)
    }

    /// Its row of the table.
    pub fn info(self) -> &'static EventInfo {
        let row = EVENTS.binary_search_by_key(&(self as u32), |e| e.kind as u32);
        &EVENTS[row.expect("the table holds every kind, in order")]
    }
}

impl Serialize for EventKind {
    fn serialize<S: Serializer>(&self, serializer: S) -> Result<S::Ok, S::Error> {
        serializer.serialize_str(self.info().name)
    }
}

/// Reads a name, or a number as files had until names came.
impl<'de> Deserialize<'de> for EventKind {
    fn deserialize<D: Deserializer<'de>>(deserializer: D) -> Result<Self, D::Error> {
        struct NameOrNumber;
        impl Visitor<'_> for NameOrNumber {
            type Value = EventKind;

            fn expecting(&self, f: &mut std::fmt::Formatter<'_>) -> std::fmt::Result {
                f.write_str("the name of an event such as 'retina.bleb_filled', or its number")
            }

            fn visit_str<E: Error>(self, name: &str) -> Result<EventKind, E> {
                EventKind::from_name(name).ok_or_else(|| E::invalid_value(Unexpected::Str(name), &self))
            }

            fn visit_u64<E: Error>(self, code: u64) -> Result<EventKind, E> {
                let kind = u32::try_from(code).ok().and_then(EventKind::from_wire);
                kind.ok_or_else(|| E::invalid_value(Unexpected::Unsigned(code), &self))
            }

            fn visit_i64<E: Error>(self, code: i64) -> Result<EventKind, E> {
                match u64::try_from(code) {
                    Ok(code) => self.visit_u64(code),
                    Err(_) => Err(E::invalid_value(Unexpected::Signed(code), &self)),
                }
            }
        }
        deserializer.deserialize_any(NameOrNumber)
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

/// An event before its number, field and instant are known.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct EventDraft {
    /// What happened.
    pub kind: EventKind,
    /// Instrument or [`NO_INSTRUMENT`].
    pub instrument: u32,
    /// Node, body, goal or category concerned.
    pub subject: u32,
    /// In the unit of the kind.
    pub value: f64,
    /// Limit passed, 0 if none.
    pub limit: f64,
    /// Eye frame, mm.
    pub position_in_eye_mm: [f64; 3],
}

impl EventDraft {
    /// An event with a figure and nothing else.
    pub fn new(kind: EventKind, value: f64) -> Self {
        EventDraft {
            kind,
            instrument: NO_INSTRUMENT,
            subject: 0,
            value,
            limit: 0.0,
            position_in_eye_mm: [0.0; 3],
        }
    }

    /// About a subject.
    pub fn about(self, subject: u32) -> Self {
        EventDraft { subject, ..self }
    }

    /// By an instrument, at a place of the eye frame, mm.
    pub fn by(self, instrument: usize, position_in_eye_mm: [f64; 3]) -> Self {
        EventDraft { instrument: instrument as u32, position_in_eye_mm, ..self }
    }
}

/// One thing that happened.
#[repr(C)]
#[derive(Debug, Clone, Copy, PartialEq, Pod, Wire, Zeroable)]
pub struct Event {
    /// Counts up by one since the simulation began.
    #[wire(tag = 1)]
    pub seq: u64,
    /// Field of the step.
    #[wire(tag = 2)]
    pub field: u64,
    /// Exposure instant of the step.
    #[wire(tag = 3)]
    pub exposed_ns: Nanos,
    /// [`EventKind`] on the wire.
    #[wire(tag = 4)]
    pub kind: u32,
    /// [`Severity`] on the wire.
    #[wire(tag = 5)]
    pub severity: u32,
    /// Instrument or [`NO_INSTRUMENT`].
    #[wire(tag = 6)]
    pub instrument: u32,
    /// Node, triangle or body concerned; 0 if none.
    #[wire(tag = 7)]
    pub subject: u32,
    /// Figure of the event, in the unit of its kind.
    #[wire(tag = 8)]
    pub value: f64,
    /// Limit that was passed, in the same unit; 0 if none.
    #[wire(tag = 9)]
    pub limit: f64,
    /// Where, in the eye frame, mm.
    #[wire(tag = 10, columns = "x_in_eye_mm,y_in_eye_mm,z_in_eye_mm")]
    pub position_in_eye_mm: [f64; 3],
}

impl Event {
    /// Row of its kind; `None` for a number that no build ever sent.
    pub fn info(&self) -> Option<&'static EventInfo> {
        EventKind::from_wire(self.kind).map(EventKind::info)
    }

    /// In words: text and value with its unit.
    pub fn describe(&self) -> String {
        let (text, unit) = self.info().map_or(("unknown event", ""), |e| (e.text, e.unit));
        format!("{text}, {:.2} {unit}", self.value).trim_end().into()
    }
}

impl Message for Event {
    const CHANNEL: &'static str = "events";
    const VERSION: u32 = 1;
    const QUEUE: usize = 512;

    fn validate(&self) -> Result<(), Invalid> {
        let kind = f64::from(self.kind);
        require(EventKind::from_wire(self.kind).is_some(), "Event", "kind", "a known kind", kind)?;
        require(self.severity <= 2, "Event", "severity", "0 to 2", f64::from(self.severity))?;
        require(all_finite(&[self.value, self.limit]), "Event", "value", "finite", self.value)?;
        require(all_finite(&self.position_in_eye_mm), "Event", "position", "finite", f64::NAN)
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn the_table_is_sorted_and_every_name_leads_back() {
        assert!(EVENTS.windows(2).all(|w| (w[0].kind as u32) < w[1].kind as u32));
        for row in EVENTS {
            assert_eq!(row.kind.info(), row);
            assert_eq!(EventKind::from_name(row.name), Some(row.kind), "{}", row.name);
            assert_eq!(EventKind::from_wire(row.kind as u32), Some(row.kind));
        }
        assert_eq!((EventKind::from_name("retina"), EventKind::from_wire(5)), (None, None));
    }

    #[test]
    fn the_page_on_modules_lists_every_event() {
        let page = include_str!("../../docs/modules.md");
        for EventInfo { kind, name, unit, severity, .. } in EVENTS {
            let severity = format!("{severity:?}").to_lowercase();
            let row = format!("| {} | `{name}` | {unit} | {severity} |", *kind as u32);
            assert!(page.contains(&row), "{row}");
        }
    }

    #[test]
    fn names_and_numbers_are_read_and_names_written() {
        let kind = EventKind::BlebFilled;
        assert_eq!(serde_json::to_string(&kind).unwrap(), "\"retina.bleb_filled\"");
        for text in ["\"retina.bleb_filled\"", "71"] {
            assert_eq!(serde_json::from_str::<EventKind>(text).unwrap(), kind);
        }
        for text in ["\"retina.bleb\"", "5", "-1", "4294967367", "7.5"] {
            let problem = serde_json::from_str::<EventKind>(text).unwrap_err().to_string();
            assert!(problem.contains("the name of an event"), "{problem}");
        }
    }
}
