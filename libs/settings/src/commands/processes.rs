//! Options of the simulator's processes that `vitreo run` forwards. Each is declared once, parsed by `vitreo`
//! and by the process, and written between them in the form that the parser accepts ([`Arguments`]).

use super::arrangement::Arrangement;
use super::fundus::FundusArgs;
use crate::blob_source::blob_source;
use std::path::PathBuf;

/// Value of `--input`: the window, and a gamepad if one is connected.
pub const AUTO: &str = "auto";
/// Value of `--input`: only the window's mouse and keyboard.
pub const MOUSE: &str = "mouse";
/// Value of `--input`: a gamepad, which must be connected, and the keyboard.
pub const GAMEPAD: &str = "gamepad";

/// Arguments of a process.
#[derive(Debug, Clone, Default, PartialEq, Eq)]
pub struct Arguments(pub Vec<String>);

impl Arguments {
    /// Adds an option with its value, if there is a value.
    pub fn value(&mut self, name: &str, value: Option<impl ToString>) {
        if let Some(value) = value {
            self.0.extend([name.into(), value.to_string()]);
        }
    }

    /// Adds an option without a value, if `given`.
    pub fn flag(&mut self, name: &str, given: bool) {
        if given {
            self.0.push(name.into());
        }
    }

    /// Adds an option whose value is a path, if there is a path.
    pub fn path(&mut self, name: &str, path: Option<&PathBuf>) {
        self.value(name, path.map(|path| path.display()));
    }
}

/// Types of option fields that can be written as arguments.
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

/// Implements [`OptionValue`] for types whose `Display` is their command-line form.
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

/// Implements `hand_on` for a struct of options: each field is written as the option of the field's name.
macro_rules! handed_on {
    ($args:ty: $($field:ident),* $(; $group:ident)?) => {
        impl $args {
            /// Adds the options in the form that the process parses.
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
    /// Rig file: cameras, markers and trocars [default: the shipped rig].
    #[arg(long, value_name = "RIG.json")]
    pub rig: Option<PathBuf>,
}
handed_on!(RigArgs: rig);

/// Colour classes of the blob extraction.
#[derive(Debug, Clone, Default, clap::Args)]
pub struct ExtractionArgs {
    /// Colour classes, from vitreo commission or vitreo colours learn [default: the shipped classes].
    #[arg(long, value_name = "FILE.toml")]
    pub colours: Option<PathBuf>,
}
handed_on!(ExtractionArgs: colours);

/// Contents of the eye.
#[derive(Debug, Clone, Default, clap::Args)]
pub struct SceneArgs {
    /// Contents of the eye: a shipped scene or a scene file [default: peel].
    #[arg(long, value_name = "NAME|FILE")]
    pub scene: Option<String>,
}
handed_on!(SceneArgs: scene);

impl SceneArgs {
    /// The given name or file, or `default`.
    pub fn name<'a>(&'a self, default: &'a str) -> &'a str {
        self.scene.as_deref().unwrap_or(default)
    }
}

/// Input and faults of the virtual cameras.
#[derive(Debug, Clone, Default, clap::Args)]
#[command(next_help_heading = "Virtual cameras")]
pub struct VirtualRigArgs {
    /// Seed of the random numbers of virtual cameras and hands.
    #[arg(long, default_value_t = 1)]
    pub seed: u64,
    /// Add a recorded hand's motion above 1 Hz to the script.
    #[arg(long, value_name = "FILE", conflicts_with = "blobs")]
    pub motion: Option<PathBuf>,
    /// Use the whole recorded motion, fitted to the workspace.
    #[arg(long, requires = "motion")]
    pub motion_full: bool,
    /// Read blobs instead of pixels; needs the cameras' --rig. A file plays at its own timing; a pipe, -
    /// (standard input) or tcp:[HOST:]PORT, which waits for a writer, is read line by line as it arrives
    /// (docs/blob-stream.md).
    #[arg(long, value_name = "FILE|FIFO|-|tcp:PORT", conflicts_with = "direct", value_parser = blob_source)]
    pub blobs: Option<PathBuf>,
    /// Compute blobs directly from the markers, without drawing pixels. With --cameras PROGRAM: the program
    /// publishes blobs.
    #[arg(long)]
    pub direct: bool,
    /// Inject camera faults, drawn from the seed: none, mild, hard, a fault's name, or a file that ends in
    /// .toml (docs/faults.md).
    #[arg(long, value_name = "NAME[,NAME...]|FILE.toml", conflicts_with = "blobs")]
    pub faults: Option<String>,
    /// Log every injected fault, as JSON lines.
    #[arg(long, value_name = "FILE.jsonl", requires = "faults")]
    pub fault_log: Option<PathBuf>,
}
handed_on!(VirtualRigArgs: seed, motion, motion_full, blobs, direct, faults, fault_log);

/// Back end of collision detection.
#[derive(Debug, Clone, Default, clap::Args)]
pub struct CollisionArgs {
    /// Collision back end: auto (the faster, measured at start-up), cpu or gpu. Results do not depend on it.
    #[arg(long, value_name = "BACKEND", value_parser = ["auto", "cpu", "gpu"], hide_possible_values = true, help_heading = "Performance")]
    pub collision: Option<String>,
}
handed_on!(CollisionArgs: collision);

/// Inputs of a desk.
#[derive(Debug, Clone, Default, PartialEq, Eq, clap::Args)]
pub struct DeskArgs {
    /// Input device: auto (the window, and a gamepad if there is one), mouse or gamepad [default: auto].
    #[arg(long, value_name = "DEVICE", value_parser = [AUTO, MOUSE, GAMEPAD], hide_possible_values = true)]
    pub input: Option<String>,
    /// Play inputs from a file; needs no display (docs/play.md).
    #[arg(long, value_name = "FILE", conflicts_with = "input")]
    pub inputs: Option<PathBuf>,
}
handed_on!(DeskArgs: input, inputs);

/// Layout and outputs of the picture.
#[derive(Debug, Clone, Default, clap::Args)]
#[command(next_help_heading = "Picture")]
pub struct PictureArgs {
    /// The fundus photograph.
    #[command(flatten)]
    pub fundus: FundusArgs,
    /// Folder with instrument meshes to draw instead of the shipped ones: forceps.glb, light-pipe.glb,
    /// pick.glb, vitrector.glb, needle.glb.
    #[arg(long, value_name = "DIR", help_heading = "Fundus and instruments")]
    pub instruments: Option<PathBuf>,
    /// Stereo layout: side-by-side, anaglyph, interleaved, sequential (windows only), left or right.
    #[arg(long, value_enum, value_name = "LAYOUT", hide_possible_values = true)]
    pub arrange: Option<Arrangement>,
    /// Fill the monitor; F11 or F toggles, Escape leaves.
    #[arg(long)]
    pub full_screen: bool,
    /// Monitor to fill, by name or number.
    #[arg(long, value_name = "NAME|N", requires = "full_screen")]
    pub monitor: Option<String>,
    /// Overlay the retina's light dose; L toggles it.
    #[arg(long)]
    pub show_dose: bool,
    /// Save stereo stills in this folder.
    #[arg(long, value_name = "DIR")]
    pub stills: Option<PathBuf>,
    /// Save a film: .mp4 (H.264) or .y4m (uncompressed).
    #[arg(long, value_name = "FILE.mp4|FILE.y4m", value_parser = outputs::video_file)]
    pub video: Option<PathBuf>,
    /// Lose the graphics device once, after this many frames, to test recovery.
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
