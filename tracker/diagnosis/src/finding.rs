//! What is found wrong with a run, and the words for it.

use serde::Serialize;

/// Something that is wrong, for a person.
#[derive(Debug, Clone, PartialEq, Eq, PartialOrd, Ord, Serialize)]
pub struct Finding {
    /// What was noticed.
    pub what: String,
    /// Why that may be.
    pub cause: String,
    /// What to do or type.
    pub remedy: String,
    /// What it is about; findings of one subject continue each other. Not for people.
    #[serde(skip)]
    pub subject: String,
}

impl Finding {
    /// One sentence of all.
    pub fn text(&self) -> String {
        format!("{}: {}; {}", self.what, self.cause, self.remedy)
    }

    /// The camera (`camera 1`) from which nothing comes or in whose picture nothing is seen, where it says
    /// that. Its driver may know why.
    pub fn camera_without_picture(&self) -> Option<&str> {
        self.subject.strip_prefix(FIELDS_OF).or_else(|| self.subject.strip_prefix(PICTURE_OF))
    }
}

pub(crate) const MOVED: &str =
    "it or the others were moved or refocused, or the rig file is of other cameras";
pub(crate) const RECALIBRATE: &str =
    "record while both instruments are waved, then: vitreo calibrate waved RECORDING.mcap -o new-rig.json";
pub(crate) const FASTEN: &str =
    "fasten it; its pose is estimated from the others within seconds; then calibrate again";
/// What is said of cameras of which none is known to be the one that was moved.
pub(crate) const DISAGREE: &str = "the cameras disagree about where the markers are";
/// Ends what is said of a body of which there is no pose at all.
pub(crate) const NEVER: &str = "was never tracked";
/// Begins the subject of a camera that is used with an estimated pose.
pub(crate) const PLACE_OF: &str = "place of ";
/// With these begin the subjects of what a camera's driver may know better: nothing comes, nothing is seen.
pub(crate) const FIELDS_OF: &str = "fields of ";
pub(crate) const PICTURE_OF: &str = "picture of ";
pub(crate) const SILENT: &str = "it is switched off or unplugged, or its driver has ended";
pub(crate) const CHECK_CABLE: &str = "check power and cable; vitreo doctor lists the cameras";
pub(crate) const DARK: &str =
    "its lens is covered, its picture too dark, or the colours are not those of the markers";
pub(crate) const CHECK_LENS: &str =
    "check its picture: vitreo blobs PICTURE --overlay o.png shows what is found in it";
pub(crate) const HIDDEN: &str =
    "its markers are hidden or out of view, or their colours or places are not those of the rig file";
pub(crate) const CHECK_MARKERS: &str =
    "hold it in view of two or more cameras; compare its markers with --rig RIG.json";
pub(crate) const OTHER_RIG: &str = "the cameras or its markers are not as in the rig file";
