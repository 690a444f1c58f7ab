//! `vitreo replay --verify` and what it must have compared: no check takes an exit code for a proof.

use crate::{Finished, json, vitreo};
use recording::Recording;
use serde_json::Value;
use std::path::{Path, PathBuf};

/// What verification says of fields that a tracker which was dead, slept or had no processor did not track.
pub const WITHOUT_FRAME: &str = "fields have no tracker frame";

/// A verification that is over.
#[derive(Debug)]
pub struct Verified {
    /// How the command ended.
    pub finished: Finished,
    /// Its report; null where it wrote none.
    pub report: Value,
}

/// Counts of one of the two proofs.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
#[allow(missing_docs)]
pub struct Proof {
    pub identical: u64,
    pub compared: u64,
    pub recorded: u64,
}

/// Verifies a recording.
pub fn verify(file: &Path) -> Verified {
    let folder = tempfile::tempdir().expect("folder");
    let report = folder.path().join("verify.json");
    let (file, path) = (file.display().to_string(), report.display().to_string());
    let finished = vitreo(&["replay", &file, "--lockstep", "--verify", "--report", &path]);
    let report = if report.exists() { json(&report) } else { Value::Null };
    Verified { finished, report }
}

/// What a run with these arguments records: its file, those of the attempts after the first, or what lies
/// beside the results store.
fn recordings(args: &[&str]) -> Vec<PathBuf> {
    let of =
        |option: &str| args.iter().position(|a| *a == option).and_then(|at| args.get(at + 1)).map(Path::new);
    let (folder, begins) = match (of("--record"), of("--store")) {
        (Some(file), _) => (file.parent(), file.file_stem()),
        (None, Some(store)) if of("--trainee").is_some() => (store.parent(), None),
        _ => return Vec::new(),
    };
    let folder = folder.map(|f| if begins.is_some() { f.to_owned() } else { f.join("recordings") });
    let Some(files) = folder.and_then(|folder| std::fs::read_dir(folder).ok()) else { return Vec::new() };
    let begins = begins.map(|name| name.to_string_lossy().into_owned()).unwrap_or_default();
    let own = |stem: &str| {
        let number = stem.strip_prefix(&begins).map(|rest| rest.strip_prefix('-').unwrap_or(rest));
        number.is_some_and(|n| begins.is_empty() || n.chars().all(|c| c.is_ascii_digit()))
    };
    let files = files.filter_map(|entry| Some(entry.ok()?.path()));
    let mcap = files.filter(|f| f.extension().is_some_and(|e| e == "mcap") && f.is_file());
    mcap.filter(|f| f.file_stem().is_some_and(|stem| own(&stem.to_string_lossy()))).collect()
}

/// Verifies what a run of a simulator left: the processes did what the engine does, to the bit, as far as
/// the recording determines that. Prints how much was compared.
///
/// # Panics
/// Where something differs.
pub fn verify_left_by(args: &[&str]) {
    for file in recordings(args) {
        let Ok(recording) = Recording::open(&file) else { continue };
        if recording.items_of(&["steps"]).next().is_none() {
            println!("{}: no step was recorded, nothing is verified", file.display());
            continue;
        }
        let verified = verify(&file);
        verified
            .holds([0, 0])
            .unwrap_or_else(|problem| panic!("left by vitreo {}: {problem}", args.join(" ")));
        let (poses, states) = (verified.poses(), verified.states());
        println!("{}: {poses:?}, {states:?}", file.display());
        assert!(poses.compared + states.compared > 0, "{}: {verified:?}", file.display());
    }
}

impl Verified {
    fn proof(&self, name: &str) -> Proof {
        let of = |count: &str| self.report["verify"][name][count].as_u64().expect("a count");
        Proof { identical: of("identical"), compared: of("compared"), recorded: of("recorded") }
    }

    /// Recorded blobs to poses, by this tracker.
    pub fn poses(&self) -> Proof {
        self.proof("poses")
    }

    /// Recorded poses to states, by this simulation.
    pub fn states(&self) -> Proof {
        self.proof("states")
    }

    /// Why not everything was verified.
    pub fn reasons(&self) -> Vec<String> {
        let reasons = self.report["verify"]["reasons"].as_array().expect("reasons");
        reasons.iter().map(|r| r.as_str().expect("words").to_owned()).collect()
    }

    /// Says why the verification does not hold: something differs, fewer poses or states than `least` were
    /// found identical, or exit code and counts do not agree.
    ///
    /// # Errors
    /// That.
    pub fn holds(&self, least: [u64; 2]) -> Result<(), String> {
        let Verified { finished, report } = self;
        if report["verify"].is_null() {
            return Err(format!("nothing was verified: {finished:?}"));
        }
        let (poses, states, reasons) = (self.poses(), self.states(), self.reasons());
        let desk = finished.stdout.contains("poses of a desk or of another tracker, without cameras");
        let whole = [poses, states].iter().skip(desk.into()).all(|p| p.identical == p.recorded);
        let agree = match finished.code {
            Some(0) => whole && reasons.is_empty(),
            Some(3) => !reasons.is_empty() && reasons.iter().all(|reason| finished.stdout.contains(reason)),
            _ => false,
        };
        let identical = [poses, states].iter().all(|p| p.identical == p.compared);
        let enough = poses.identical >= least[0] && states.identical >= least[1];
        if agree && identical && enough {
            return Ok(());
        }
        Err(format!("{poses:?}, {states:?}, at least {least:?}; {reasons:?}; {finished:?}"))
    }

    /// As [`Verified::holds`].
    ///
    /// # Panics
    /// Where it does not hold.
    #[track_caller]
    pub fn expect(self, least: [u64; 2]) -> Self {
        self.holds(least).unwrap_or_else(|problem| panic!("{problem}"));
        self
    }

    /// The same, and that nothing but reasons with one of these words is left out.
    ///
    /// # Panics
    /// Where it does not hold, or more was left out.
    #[track_caller]
    pub fn expect_but(self, least: [u64; 2], words: &[&str]) -> Self {
        let verified = self.expect(least);
        let strange = |reason: &&String| !words.iter().any(|word| reason.contains(word));
        let reasons = verified.reasons();
        assert_eq!(reasons.iter().find(strange), None, "{reasons:?}");
        verified
    }
}
