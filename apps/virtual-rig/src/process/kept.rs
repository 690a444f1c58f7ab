//! What a restarted rig needs to go on where its predecessor stood: the time that had passed, kept
//! with every exposure, and the script with the reactions so far, kept when it changes. Both are
//! small files in the instance's private directory.

use serde::{Deserialize, Serialize};
use std::fs::{self, File};
use std::io;
use std::os::unix::fs::FileExt;
use std::path::{Path, PathBuf};
use surgeon::script::Script;

/// The script's state beside the time that has passed.
#[derive(Debug, Clone, Serialize, Deserialize)]
pub(super) struct Standing {
    /// The script, with the reactions so far.
    pub(super) script: Script,
    /// A bit for each goal that was seen reached.
    pub(super) reached: u64,
    /// End of the exposures, ns after the start.
    pub(super) duration_ns: u64,
    /// Everything stands still.
    pub(super) paused: bool,
}

/// The files.
pub(super) struct Keeper {
    time: File,
    standing: PathBuf,
    /// A failure was reported.
    failure_reported: bool,
}

fn names(directory: &Path) -> [PathBuf; 2] {
    ["virtual-rig.time", "virtual-rig.json"].map(|name| directory.join(name))
}

/// How the predecessor stood: nanoseconds since the start, and the rest. `None` where it left
/// nothing that can be read.
pub(super) fn predecessor(directory: &Path) -> Option<(u64, Standing)> {
    let [time, standing] = names(directory);
    let time = u64::from_le_bytes(fs::read(time).ok()?.try_into().ok()?);
    Some((time, serde_json::from_slice(&fs::read(standing).ok()?).ok()?))
}

impl Keeper {
    /// Opens the files in the instance's directory.
    pub(super) fn open(directory: &Path) -> io::Result<Self> {
        let [time, standing] = names(directory);
        let time = File::options().write(true).create(true).truncate(false).open(time)?;
        Ok(Keeper { time, standing, failure_reported: false })
    }

    /// Keeps the time of an exposure, ns after the start.
    pub(super) fn keep_time(&mut self, elapsed_ns: u64) {
        let kept = self.time.write_all_at(&elapsed_ns.to_le_bytes(), 0);
        self.tell(kept);
    }

    /// Keeps the rest, whole or not at all.
    pub(super) fn keep(&mut self, standing: &Standing) {
        self.tell(ipc::write_whole_json(&self.standing, standing));
    }

    fn tell(&mut self, kept: io::Result<()>) {
        if let (Err(problem), false) = (kept, self.failure_reported) {
            self.failure_reported = true;
            tracing::warn!("the script's state cannot be saved, so a restart would start it over: {problem}");
        }
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use scene::{DEFAULT_SCENE, SceneFile};

    #[test]
    fn a_successor_finds_how_its_predecessor_stood() {
        let folder = tempfile::tempdir().unwrap();
        assert!(predecessor(folder.path()).is_none());
        let mut keeper = Keeper::open(folder.path()).unwrap();
        let script = Script::new(&SceneFile::load(DEFAULT_SCENE).unwrap());
        keeper.keep(&Standing { script, reached: 5, duration_ns: u64::MAX, paused: true });
        assert!(predecessor(folder.path()).is_none(), "no field was exposed");
        [20_000_000, 40_000_000].into_iter().for_each(|t| keeper.keep_time(t));
        drop(Keeper::open(folder.path()).unwrap());
        let (time, standing) = predecessor(folder.path()).unwrap();
        assert_eq!((time, standing.reached, standing.paused), (40_000_000, 5, true));
        assert_eq!(standing.duration_ns, u64::MAX);
    }
}
