//! `docs/score.md`, made from the table.

use super::table::{Category, KEPT_WHEN_FAILED, METRICS, PENALTIES, VERSION};
use std::fmt::Write;

const BEGIN: &str = "\
This page defines the score of an attempt at a training module, for trainees, instructors and reviewers. An attempt earns
up to 100 points in five categories, those that studies of the commercial device report (Vergmann et al. 2016,
doi 10.1111/aos.13209). Every figure is a pure function of a recording's contents: the tracker's poses with their
covariance, and the events. The simulation computes the score live, `vitreo score FILE.mcap` from a recording, both with
the same code. They agree to the bit, and the command reports whether they do.

`vitreo score --doc` writes this page from the table in `libs/training/src/score/table.rs`; a test keeps it current. A score
names the version of its table; scores of different versions are not compared. For many recordings at once, tables,
shards on a cluster and object stores see `docs/results.md` and `packaging/deploy/README.md`.
";

const HOW: &str = "\
## How points are computed

Each metric earns all of its points up to one threshold, none beyond the other, and a linear share between them. If a metric
does not apply to a task (no path, no light pipe), its points are distributed over the other metrics of its category. The
points of every other metric are multiplied by the value of *goals reached*, so an idle trainee earns nothing for still
hands and an uninjured retina.

An attempt begins (event 110) when the smoothed tip of an instrument has moved 0.5 mm from where it was first seen in the
eye, or when the pedal is pressed for suction, injection or air. It ends with the last goal (112) or when its time is over
(113), and is scored as it is then. A gap of more than 0.2 s between two poses of a recording (a pause, or lost tracking)
is not part of the attempt: it adds no time, path length, speed or tremor.

Tremor is measured in the hands that perform the task: those named by its goals, or both where both tips must be aligned.
For goals that name no hand (an event, vitreous, the retina, a body to be put down) these are the hands that do not begin
with a light pipe. A hand that only holds the light may rest, or follow a script beside the hand of a person or a
recording; its tremor would mask theirs. Its path length, speed and contacts count.

Positions are those of the tip in the eye frame. *Smoothed* positions follow the intended motion without the tremor, so
that tremor counts once, as tremor.

## Tracking noise

Values below the tracking noise do not count. The power in the tremor's band that the tracker's covariance explains is
subtracted from the tremor. A contact with retina or lens counts if it is deeper than its threshold by two standard
deviations of the tracked tip in that direction. Every total has a standard deviation (`±`), propagated from the figures
through the slopes below, with p(1 − p) for contacts that may or may not have happened. It covers tracking noise only, not
how a surgeon varies from day to day; for that see `docs/study.md`.
";

/// The page.
pub fn page() -> String {
    let mut text = format!("# The score, version {VERSION}\n\n{BEGIN}\n{HOW}\n## Metrics\n");
    for category in Category::ALL {
        let _ = write!(text, "\n### {}: {} points\n\n", capital(category.name()), category.points());
        text.push_str("| metric | key | unit | points | all up to | none from | formula |\n|---|---|---|---|---|---|---|\n");
        for m in METRICS.iter().filter(|m| m.category == category) {
            let (name, key, unit) = (m.name, m.key, m.unit);
            let _ = writeln!(
                text,
                "| {name} | `{key}` | {unit} | {} | {} | {} | {} |",
                m.points, m.full_at, m.none_at, m.formula
            );
        }
    }
    let _ = write!(
        text,
        "\n## Injuries\n\nEach injury takes its share of the points of all metrics together that earlier injuries left, so every further \
         injury costs points. The loss is subtracted from tissue treatment, which may fall below 0. A serious injury fails the attempt: \
         the attempt keeps {KEPT_WHEN_FAILED} of the remaining points, always less than {} points. The shares of lens contact, the two haemorrhages and the tear \
         have the proportions 346 : 125 : 106 : 90, to half a per cent: the points that the commercial device subtracted for an injured \
         lens, macular haemorrhages, retinal injuries elsewhere and tears of surgeons who trained on it (Deuchler et al. 2016, \
         PLoS ONE 11(3), e0150690, doi 10.1371/journal.pone.0150690). That study has no shallow contacts and no pulls; their shares are \
         lower. Which injuries fail an attempt, and by how much, is our judgement.\n\n",
        100.0 * KEPT_WHEN_FAILED
    );
    text.push_str("| injury | each takes | serious | what counts |\n|---|---|---|---|\n");
    for p in &PENALTIES {
        let serious = if p.serious { "yes" } else { "" };
        let _ = writeln!(text, "| {} | {:.1} % | {serious} | {} |", p.name, 100.0 * p.share, p.what);
    }
    text
}

fn capital(name: &str) -> String {
    let mut letters = name.chars();
    letters.next().map_or_else(String::new, |first| first.to_uppercase().chain(letters).collect())
}

#[cfg(test)]
mod tests {
    #[test]
    fn the_page_in_the_repository_is_current() {
        let path = concat!(env!("CARGO_MANIFEST_DIR"), "/../../docs/score.md");
        let there = std::fs::read_to_string(path).expect("docs/score.md");
        assert!(there == super::page(), "docs/score.md is old: vitreo score --doc > docs/score.md");
    }
}
