//! Part 2: recorded hands that are not ours. The script is the expert's in every attempt; only the
//! hand's own movement above 1 Hz, in the place of the tremor, comes from the recording.

use crate::attempts::{self, Job};
use crate::numbers::{bootstrap, deviation, difference, effect, mean};
use anyhow::{Context, Result};
use scene::module::Module;
use std::fmt::Write;
use std::path::{Path, PathBuf};
use surgeon::motion::MotionUse;
use surgeon::motion::recorded::RecordedMotion;
use surgeon::skill::EXPERT;
use training::score::Score;
use training::score::table::{Category, Id};

/// The modules: the path in a tube, and targets to hold.
const MODULES: [&str; 2] = ["steady-path", "navigation"];
/// Attempts with each recording at each level.
const SEEDS: u64 = 3;

/// A recording: who, and what they did.
struct Recording {
    name: String,
    surgeon: bool,
    hand: RecordedMotion,
}

/// A figure of an attempt.
struct Figure {
    name: &'static str,
    of: fn(&Score) -> f64,
    /// Surgeons should have more of it.
    more: bool,
}

const FIGURES: [Figure; 4] = [
    Figure { name: "tremor, µm", of: |s| s.metrics[Id::Tremor as usize].value.unwrap_or(0.0), more: false },
    Figure {
        name: "instrument handling, points",
        of: |s| s.categories[Category::Instruments as usize],
        more: true,
    },
    Figure {
        name: "target achievement, points",
        of: |s| s.categories[Category::Target as usize],
        more: true,
    },
    Figure { name: "score, points", of: |s| s.total, more: true },
];

/// The recordings under the folder; file names begin with S for surgeons, N for novices.
fn recordings(folder: &Path) -> Result<Vec<Recording>> {
    let mut files: Vec<PathBuf> =
        std::fs::read_dir(folder)?.map(|e| Ok(e?.path())).collect::<std::io::Result<_>>()?;
    files.retain(|f| f.extension().is_some_and(|e| e == "csv"));
    files.sort();
    let read = |file: PathBuf| -> Result<Recording> {
        let name = file.file_stem().context("a name")?.to_string_lossy().into_owned();
        Ok(Recording { surgeon: name.starts_with("S_"), hand: RecordedMotion::load(&file)?, name })
    };
    files.into_iter().map(read).collect()
}

/// Plays it; the section of the page.
///
/// # Errors
/// If a recording or a module cannot be read.
pub fn study(threads: usize) -> Result<String> {
    let data = std::env::var_os("VITREO_DATA").map_or("../shared/data".into(), PathBuf::from);
    let folder = data.join("motion/m2s2_tremor");
    let mut out = String::from("## Part 2: recorded hands\n\n");
    if !folder.is_dir() {
        println!("part 2 skipped: no motion/m2s2_tremor under VITREO_DATA");
        out.push_str("Not made: no `motion/m2s2_tremor` under `VITREO_DATA`.\n");
        return Ok(out);
    }
    let recordings = recordings(&folder).with_context(|| format!("recordings in {}", folder.display()))?;
    let modules = MODULES.map(Module::load).into_iter().collect::<Result<Vec<_>, _>>()?;
    let mut jobs = Vec::new();
    for (module, file) in modules.iter().enumerate() {
        for recording in &recordings {
            for level in 1..=file.levels() {
                let hand = || Some(MotionUse::Tremor(recording.hand.clone()));
                let job = |seed| Job { module, level, surgeon: EXPERT, hand: hand(), seed };
                jobs.extend((1..=SEEDS).map(job));
            }
        }
    }
    let mut scores = attempts::scores(&modules, &jobs, threads)?.into_iter();
    let count = |surgeon: bool| recordings.iter().filter(|r| r.surgeon == surgeon).count();
    let _ = writeln!(
        out,
        "The hands were recorded by the M2S2 studies (pointing at and tracing a target under a microscope; {} recordings of
surgeons, {} of novices). The script is the expert's in every attempt; in the working hand, the recorded movement above 1 Hz
replaces the tremor. Each recording plays every level with {SEEDS} seeds; its figures are the means of these attempts, so each
recording counts once. d: Cohen's d, positive where surgeons are better, with the 95 % interval of 10,000 bootstrap
draws over the recordings in brackets.
",
        count(true),
        count(false)
    );
    for module in &modules {
        let each = module.levels() as usize * SEEDS as usize;
        let of: Vec<Vec<Score>> = recordings.iter().map(|_| scores.by_ref().take(each).collect()).collect();
        section(&mut out, &module.name, &recordings, &of);
    }
    out.push_str(LIMITS);
    println!("{out}");
    Ok(out)
}

const LIMITS: &str = "\
The recordings come from two surgeons and three novices, two of each person. The intervals treat recordings as
independent and are therefore too narrow. The hands pointed and traced; they did not operate, and only their movement
above 1 Hz is used. This shows whether the scored tremor separates these hands, not whether the score measures surgical
skill.
";

fn section(out: &mut String, module: &str, recordings: &[Recording], scores: &[Vec<Score>]) {
    let _ = writeln!(
        out,
        "### {module}\n\n| figure | surgeons | novices | difference | d |\n|---|---|---|---|---|"
    );
    let mut verdicts = Vec::new();
    for figure in &FIGURES {
        let group = |surgeon: bool| -> Vec<f64> {
            let own = recordings.iter().zip(scores).filter(|(r, _)| r.surgeon == surgeon);
            own.map(|(_, s)| mean(&s.iter().map(figure.of).collect::<Vec<_>>())).collect()
        };
        let (surgeons, novices) = (group(true), group(false));
        let sign = if figure.more { 1.0 } else { -1.0 };
        let [apart, ..] = bootstrap(&surgeons, &novices, difference);
        let [d, low, high] = bootstrap(&surgeons, &novices, effect).map(|d| sign * d);
        let (low, high) = if low < high { (low, high) } else { (high, low) };
        let cell = |v: &[f64]| format!("{:.1} ± {:.1}", mean(v), deviation(v));
        let _ = writeln!(
            out,
            "| {} | {} | {} | {apart:+.1} | {d:+.1} [{low:+.1}, {high:+.1}] |",
            figure.name,
            cell(&surgeons),
            cell(&novices)
        );
        verdicts.push((figure.name, low, high));
    }
    let sure = |better: bool| -> String {
        let names: Vec<&str> = verdicts
            .iter()
            .filter(|(_, l, h)| if better { *l > 0.0 } else { *h < 0.0 })
            .map(|v| v.0)
            .collect();
        if names.is_empty() { "none".into() } else { names.join("; ") }
    };
    let _ = writeln!(
        out,
        "\nFigures whose interval is above 0 (surgeons better): {}. Below 0 (novices better): {}.\n",
        sure(true),
        sure(false)
    );
    let _ = writeln!(
        out,
        "| recording | tremor, µm | instrument handling | score | finished |\n|---|---|---|---|---|"
    );
    for (recording, scores) in recordings.iter().zip(scores) {
        let of = |f: fn(&Score) -> f64| mean(&scores.iter().map(f).collect::<Vec<_>>());
        let finished = scores.iter().filter(|s| s.finished).count();
        let (tremor, handling, total) = (of(FIGURES[0].of), of(FIGURES[1].of), of(FIGURES[3].of));
        let (name, all) = (&recording.name, scores.len());
        let _ =
            writeln!(out, "| `{name}` | {tremor:.0} | {handling:.1} | {total:.1} | {finished} of {all} |");
    }
    out.push('\n');
}
