//! What a process does with a field, in phases: the names of the spans in the trace of a run
//! (`docs/field-trace.md`), and how pure code marks them without reading a clock.
//!
//! Code that computes marks the end of each phase on a [`Phases`] that its caller hands in. The caller reads
//! the clock there, or does nothing: with [`Unmarked`] the marks compile to nothing. Code that takes times
//! anyway, as the simulation's step does for its profile, takes them of a [`PhaseClock`].

use crate::health::Process;
use crate::time::Nanos;

/// Declares the phases: the process, then a variant, its name and its doc each.
macro_rules! phases {
    ($($process:ident { $($(#[$doc:meta])* $phase:ident = $name:literal,)* })*) => {
        /// A phase of the work on a field.
        #[derive(Debug, Clone, Copy, PartialEq, Eq, Hash, PartialOrd, Ord)]
        #[repr(u16)]
        pub enum Phase {
            $($($(#[$doc])* $phase,)*)*
        }

        impl Phase {
            /// All, by process in the order of the data path.
            pub const ALL: &[Phase] = &[$($(Phase::$phase,)*)*];

            /// Name of the span; one process has each name once.
            pub fn name(self) -> &'static str {
                match self {
                    $($(Phase::$phase => $name,)*)*
                }
            }

            /// The process whose phase it is.
            pub fn process(self) -> Process {
                match self {
                    $($(Phase::$phase => Process::$process,)*)*
                }
            }
        }
    };
}

phases! {
    VirtualRig {
        /// Hands, eye and optics at the exposure of one camera's field.
        Expose = "expose",
        /// Pixels of one camera's field, written in place and sent.
        Paint = "paint",
        /// Blobs of one camera's field without pixels.
        MakeBlobs = "make blobs",
        /// Blobs that were made without pixels leave when they are due.
        SendBlobs = "send blobs",
    }
    FpgaModel {
        /// Blobs of one camera's field.
        Scan = "scan",
        /// Blobs leave when the hardware would have sent them.
        SendScanned = "send blobs",
    }
    Tracker {
        /// One camera's field is taken in; it may close a frame.
        Assemble = "assemble",
        /// A frame from its fields to its message; the phases below lie in it.
        Track = "track",
        /// Blobs of an instant into the observations.
        Observe = "observe",
        /// Bodies at an instant, and at last at the exposure of the frame.
        Predict = "predict",
        /// Which blob is which marker.
        Associate = "associate",
        /// Most likely poses.
        Fit = "fit",
        /// Filters take the fits.
        Filter = "filter",
        /// Whether a camera was moved.
        WatchCameras = "watch cameras",
        /// Search for bodies that are lost.
        Acquire = "acquire",
        /// Drift of the rig.
        Drift = "drift",
        /// Poses, covariances and status into the message.
        WritePoses = "write poses",
        /// Poses leave.
        SendPoses = "send poses",
        /// What no pose of the frame waits for: what became of every blob, drift of the rig, and matches leave.
        FollowUp = "follow up",
        /// The tracker's state, every 2 s.
        SaveTracker = "checkpoint",
    }
    Simcore {
        /// A step from its inputs to its messages; the phases below lie in it.
        Step = "step",
        /// Handles and pedal are taken in.
        Inputs = "inputs",
        /// Contact of instruments with tissue and retina.
        Collision = "collision",
        /// Membrane and retina.
        Tissue = "tissue",
        /// Rigid bodies.
        Bodies = "bodies",
        /// Ports, needles, jaws, dye and light.
        Tools = "tools",
        /// Vitreous.
        Vitreous = "vitreous",
        /// Task and score.
        Task = "task",
        /// Hash of the state.
        Hash = "hash",
        /// The rest of the step: inputs, poses, events, microscope.
        Misc = "other",
        /// The scene block is written and sent.
        Scene = "scene block",
        /// Figures of the step, and events.
        SendStep = "send step",
        /// The simulation's state, every 2 s and after heavy steps.
        SaveState = "checkpoint",
    }
    Renderer {
        /// A scene is taken in.
        TakeScene = "take scene",
        /// A picture from its first command to the display, by the field of its scene; the phases below lie
        /// in it.
        Picture = "picture",
        /// Status, overlay and dose are laid over.
        Overlay = "overlay",
        /// Commands of the shadow map.
        EncodeShadow = "encode shadow",
        /// Commands of both channels.
        EncodePicture = "encode picture",
        /// Commands of the depth of field; all are closed.
        EncodeFocus = "encode focus",
        /// The newest pose is taken and predicted: from here on, the field of that pose.
        Latch = "latch",
        /// Uniforms and vertices are uploaded, the commands submitted.
        Submit = "submit",
        /// The device draws.
        Draw = "draw",
        /// The picture goes to the display.
        Present = "present",
        /// The instants of the picture.
        SendFrame = "send frame",
        /// Stills and film.
        WriteFiles = "write files",
        /// The device draws the shadow map.
        GpuShadow = "shadow",
        /// The device draws both channels.
        GpuPicture = "both channels",
        /// The device draws the depth of field.
        GpuFocus = "focus",
    }
    Desk {
        /// A field of a desk: inputs to poses, handles and pedal.
        Desk = "desk",
        /// What the person did since the last field.
        ReadInputs = "read inputs",
        /// Poses, handles and pedal.
        SendDesk = "send poses",
    }
}

/// By what a trace connects the spans of one field: those that take it from the stop before.
const STOPS: [Phase; 9] = [
    Phase::Paint,
    Phase::MakeBlobs,
    Phase::Scan,
    Phase::Assemble,
    Phase::Track,
    Phase::Step,
    Phase::Picture,
    Phase::Latch,
    Phase::Desk,
];

impl Phase {
    /// From the number in a file.
    pub fn from_wire(code: u16) -> Option<Self> {
        Self::ALL.get(usize::from(code)).copied()
    }

    /// True if it is a stop on the way of a field: a trace connects these.
    pub fn is_stop(self) -> bool {
        STOPS.contains(&self)
    }

    /// True if the graphics device does it, beside what the process does.
    pub fn is_on_gpu(self) -> bool {
        matches!(self, Phase::GpuShadow | Phase::GpuPicture | Phase::GpuFocus)
    }
}

/// Whoever wants to know when phases end. A phase begins where the one before it ended.
pub trait Phases {
    /// A phase has ended.
    fn ended(&mut self, phase: Phase);
}

/// No reader: the marks cost nothing.
#[derive(Debug, Clone, Copy, Default, PartialEq, Eq)]
pub struct Unmarked;

impl Phases for Unmarked {
    #[inline(always)]
    fn ended(&mut self, _phase: Phase) {}
}

/// A clock that is lent to a computation, and that may take note of each phase.
pub trait PhaseClock {
    /// The present instant, ns; never part of a result.
    fn read(&mut self) -> Nanos;

    /// A phase began and ended at these instants of [`PhaseClock::read`].
    fn lap(&mut self, _phase: Phase, _from_to: [Nanos; 2]) {}
}

impl<F: FnMut() -> Nanos + ?Sized> PhaseClock for &mut F {
    fn read(&mut self) -> Nanos {
        self()
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::steps::StepProfile;
    use std::collections::BTreeSet;

    #[test]
    fn numbers_name_phases_and_a_process_has_each_name_once() {
        let mut names = BTreeSet::new();
        for (code, &phase) in (0..).zip(Phase::ALL) {
            assert_eq!((phase as u16, Phase::from_wire(code)), (code, Some(phase)));
            assert!(names.insert((phase.process(), phase.name())), "{phase:?}");
        }
        assert_eq!(Phase::from_wire(Phase::ALL.len() as u16), None);
    }

    #[test]
    fn every_process_on_the_way_of_a_field_has_a_stop() {
        // Hands and feet go beside it.
        for process in Process::ALL.into_iter().filter(|p| *p != Process::Controls) {
            let stops = Phase::ALL.iter().filter(|p| p.process() == process && p.is_stop());
            assert!(stops.count() > 0, "{process:?}");
        }
    }

    #[test]
    fn the_phases_of_a_step_are_those_of_its_profile() {
        let mut profile = StepProfile::default();
        let of_step = Phase::ALL.iter().filter(|p| StepProfile::PHASES.contains(&p.name()));
        for (i, &phase) in (1..).zip(of_step) {
            *profile.time_of(phase) += 1 << i;
            let place = StepProfile::PHASES.iter().position(|name| *name == phase.name()).unwrap();
            assert_eq!(profile.phases_ns()[place], 1 << i, "{phase:?}");
        }
        // The transfer is timed by the shell, which sends the block.
        assert_eq!(profile.phases_ns().iter().filter(|ns| **ns > 0).count(), StepProfile::PHASES.len() - 1);
    }
}
