//! Options that a process of the simulator takes and `vitreo run` hands on to it: declared once, read by
//! both, and written as they are read ([`Arguments`]).

use super::arrangement::Arrangement;
use super::fundus::FundusArgs;
use crate::blob_source::blob_source;
use std::path::PathBuf;

/// What a desk listens to where nothing is said: the window, and a gamepad where there is one.
pub const AUTO: &str = "auto";
/// The window alone: mouse and keyboard.
pub const MOUSE: &str = "mouse";
/// A gamepad, which must be there, and the keyboard.
pub const GAMEPAD: &str = "gamepad";

/// Arguments that are handed on.
#[derive(Debug, Clone, Default, PartialEq, Eq)]
pub struct Arguments(pub Vec<String>);

impl Arguments {
    /// Adds an option with its value, if it has one.
    pub fn value(&mut self, name: &str, value: Option<impl ToString>) {
        if let Some(value) = value {
            self.0.extend([name.into(), value.to_string()]);
        }
    }

    /// Adds an option without a value, if it is given.
    pub fn flag(&mut self, name: &str, given: bool) {
        if given {
            self.0.push(name.into());
        }
    }

    /// Adds a path, if there is one.
    pub fn path(&mut self, name: &str, path: Option<&PathBuf>) {
        self.value(name, path.map(|path| path.display()));
    }
}

/// What can stand in a field that is an option.
trait OptionValue {
    fn put(&self, name: &str, to: &mut Arguments);
}

impl OptionValue for bool {
    fn put(&self, name: &str, to: &mut Arguments) {
        to.flag(name, *self);
    }
}

impl OptionValue for u64 {
    fn put(&self, name: &str, to: &mut Arguments) {
        to.value(name, Some(self));
    }
}

impl OptionValue for Option<PathBuf> {
    fn put(&self, name: &str, to: &mut Arguments) {
        to.path(name, self.as_ref());
    }
}

/// Those that are written as they are read.
macro_rules! as_displayed {
    ($($value:ty),*) => {
        $(impl OptionValue for Option<$value> {
            fn put(&self, name: &str, to: &mut Arguments) {
                to.value(name, self.as_ref());
            }
        })*
    };
}
as_displayed!(String, u64, f64, Arrangement);

/// Implements `hand_on`: each field is an option of the field's name.
macro_rules! handed_on {
    ($args:ty: $($field:ident),* $(; $group:ident)?) => {
        impl $args {
            /// Adds the options as the process takes them.
            pub fn hand_on(&self, to: &mut Arguments) {
                $(to.0.extend(self.$group.arguments());)?
                $(self.$field.put(&format!("--{}", stringify!($field).replace('_', "-")), to);)*
            }
        }
    };
}

/// Cameras, markers and trocars.
#[derive(Debug, Clone, Default, clap::Args)]
pub struct RigArgs {
    /// Cameras, markers and trocars [default: the shipped rig].
    #[arg(long, value_name = "RIG.json")]
    pub rig: Option<PathBuf>,
}
handed_on!(RigArgs: rig);

/// What the camera hardware finds in pictures.
#[derive(Debug, Clone, Default, clap::Args)]
pub struct ExtractionArgs {
    /// What the cameras take for which colour: a file of vitreo commission or vitreo colours learn
    /// [default: the shipped colours].
    #[arg(long, value_name = "FILE.toml")]
    pub colours: Option<PathBuf>,
}
handed_on!(ExtractionArgs: colours);

/// What is in the eye.
#[derive(Debug, Clone, Default, clap::Args)]
pub struct SceneArgs {
    /// What is in the eye: a shipped scene's name or a scene file [default: peel].
    #[arg(long, value_name = "NAME|FILE")]
    pub scene: Option<String>,
}
handed_on!(SceneArgs: scene);

impl SceneArgs {
    /// Its name or file; `default` where none is given.
    pub fn name<'a>(&'a self, default: &'a str) -> &'a str {
        self.scene.as_deref().unwrap_or(default)
    }
}

/// What the virtual cameras see.
#[derive(Debug, Clone, Default, clap::Args)]
#[command(next_help_heading = "Virtual cameras")]
pub struct VirtualRigArgs {
    /// Seed of everything random in the virtual cameras and hands.
    #[arg(long, default_value_t = 1)]
    pub seed: u64,
    /// Lay a recorded hand's movement above 1 Hz over the script.
    #[arg(long, value_name = "FILE", conflicts_with = "blobs")]
    pub motion: Option<PathBuf>,
    /// Use all of the recorded movement, fitted to the workspace.
    #[arg(long, requires = "motion")]
    pub motion_full: bool,
    /// Take blobs in place of the cameras' pixels; needs their --rig. A file is played with its own
    /// spacing; a pipe, - (standard input) or tcp:[HOST:]PORT, on which a writer is waited for, is
    /// taken line by line as it comes. See docs/blob-stream.md.
    #[arg(long, value_name = "FILE|FIFO|-|tcp:PORT", conflicts_with = "direct", value_parser = blob_source)]
    pub blobs: Option<PathBuf>,
    /// Make blobs straight from the markers, without drawing pixels. With --cameras: the program
    /// publishes blobs.
    #[arg(long)]
    pub direct: bool,
    /// Let things go wrong in the cameras, from the seed: none, mild, hard, a fault by its name, or
    /// a file that ends in .toml.
    #[arg(long, value_name = "NAME[,NAME...]|FILE.toml", conflicts_with = "blobs")]
    pub faults: Option<String>,
    /// Write down what was done to which field, as JSON lines.
    #[arg(long, value_name = "FILE.jsonl", requires = "faults")]
    pub fault_log: Option<PathBuf>,
}
handed_on!(VirtualRigArgs: seed, motion, motion_full, blobs, direct, faults, fault_log);

/// Who looks for collisions.
#[derive(Debug, Clone, Default, clap::Args)]
pub struct CollisionArgs {
    /// Who looks for collisions with the membrane: auto (the faster one, measured at start-up), cpu
    /// or gpu. It changes no result.
    #[arg(long, value_name = "WHO", value_parser = ["auto", "cpu", "gpu"])]
    pub collision: Option<String>,
}
handed_on!(CollisionArgs: collision);

/// What a person at a desk works with.
#[derive(Debug, Clone, Default, PartialEq, Eq, clap::Args)]
pub struct DeskArgs {
    /// What to listen to: auto (the window, and a gamepad where there is one), mouse or gamepad
    /// [default: auto].
    #[arg(long, value_name = "WHAT", value_parser = [AUTO, MOUSE, GAMEPAD])]
    pub input: Option<String>,
    /// Play a file of inputs instead of a person's; needs no display. See docs/play.md.
    #[arg(long, value_name = "FILE", conflicts_with = "input")]
    pub inputs: Option<PathBuf>,
}
handed_on!(DeskArgs: input, inputs);

/// How the picture is drawn, and where it goes.
#[derive(Debug, Clone, Default, clap::Args)]
#[command(next_help_heading = "Picture")]
pub struct PictureArgs {
    /// The fundus photograph.
    #[command(flatten)]
    pub fundus: FundusArgs,
    /// Folder with the instruments' meshes (forceps.glb, light-pipe.glb, pick.glb, vitrector.glb,
    /// needle.glb) to draw instead of the shipped ones.
    #[arg(long, value_name = "DIR")]
    pub instruments: Option<PathBuf>,
    /// How the two channels share the picture: side-by-side, anaglyph, interleaved, sequential,
    /// left or right; of these, files take all but sequential.
    #[arg(long, value_enum, value_name = "HOW", hide_possible_values = true)]
    pub arrange: Option<Arrangement>,
    /// Fill the monitor; F11 or F switches, Escape leaves.
    #[arg(long)]
    pub full_screen: bool,
    /// The monitor to fill, by name or number.
    #[arg(long, value_name = "NAME|N", requires = "full_screen")]
    pub monitor: Option<String>,
    /// Draw the dose of light over the retina; L shows and hides it.
    #[arg(long)]
    pub show_dose: bool,
    /// Save stereo pictures.
    #[arg(long, value_name = "DIR")]
    pub stills: Option<PathBuf>,
    /// Save a film, by its ending: MP4 (H.264), or Y4M without compression.
    #[arg(long, value_name = "FILE.mp4|FILE.y4m", value_parser = outputs::video_file)]
    pub video: Option<PathBuf>,
    /// Lose the graphics device after so many frames, once, to see that the picture comes back.
    #[arg(long, value_name = "FRAMES", hide = true)]
    pub lose_device_after: Option<u64>,
}

handed_on!(
    PictureArgs: instruments, arrange, full_screen, monitor, show_dose, stills, video, lose_device_after; fundus
);

#[cfg(test)]
mod tests {
    use super::*;
    use clap::Parser;

    #[derive(Parser)]
    struct Line {
        #[command(flatten)]
        rig: RigArgs,
        #[command(flatten)]
        extraction: ExtractionArgs,
        #[command(flatten)]
        scene: SceneArgs,
        #[command(flatten)]
        cameras: VirtualRigArgs,
        #[command(flatten)]
        collision: CollisionArgs,
        #[command(flatten)]
        picture: PictureArgs,
    }

    #[test]
    fn what_is_handed_on_is_read_as_it_was_given() {
        let given = "--rig r.json --colours c.toml --scene peel --seed 7 --motion m.csv --motion-full --direct --faults mild \
                     --fault-log f.jsonl --collision cpu --fundus a.jpg --fundus-eye right --instruments d \
                     --arrange anaglyph --full-screen --monitor 1 --show-dose --stills s --video v.mp4 \
                     --lose-device-after 3";
        let words: Vec<&str> = given.split_whitespace().collect();
        let line = Line::try_parse_from(std::iter::once(&"x").chain(&words)).unwrap();
        let mut handed = Arguments::default();
        line.rig.hand_on(&mut handed);
        line.extraction.hand_on(&mut handed);
        line.scene.hand_on(&mut handed);
        line.cameras.hand_on(&mut handed);
        line.collision.hand_on(&mut handed);
        line.picture.hand_on(&mut handed);
        assert_eq!(handed.0, words);
    }
}
