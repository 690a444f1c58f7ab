//! `docs/score.md`, made from the table.

use super::table::{Category, KEPT_WHEN_FAILED, METRICS, PENALTIES, VERSION};
use std::fmt::Write;

const BEGIN: &str = "\
An attempt at a module brings up to 100 points in five categories, those that studies of the commercial device report
(Vergmann et al. 2016, doi 10.1111/aos.13209). Every figure is a pure function of what a recording holds: the tracker's poses
with their covariance, and the events. `vitreo score FILE.mcap` computes it from a recording, the simulation computes it live, both by
the same code; they agree to the bit, and the command says so.

This page is made from the table in `libs/training/src/score/table.rs` by `vitreo score --doc`; a test keeps it current. A score names the
version of its table; scores of different versions are not compared. Many recordings at once, tables, shards on a cluster and object
stores: `docs/results.md` and `packaging/deploy/README.md`.
";

const HOW: &str = "\
## How points are made

Each metric brings all of its points up to one threshold, none beyond the other, and a share in a straight line between. What a task
has nothing for (no path, no light pipe) is shared out among the other metrics of the category. All metrics but the goals themselves
bring that share of their points that *goals reached* is: who does nothing gets nothing for still hands and an unhurt retina.
An attempt begins (event 110) when the smoothed tip of an instrument has moved 0.5 mm from where it was first seen in the eye, or the
pedal is pressed for suction, injection or air; it ends with the last goal (112) or with its time (113); what stands at its end counts.
A gap of more than 0.2 s between two poses of a recording (a pause, or a tracker that said nothing) is no part of the attempt: no time
passes in it, and no way, speed or tremor is taken across it.

Tremor is judged of the hands at the task: those that its goals name, both where both tips are to be aligned, and for goals that name
none (an event, vitreous, the retina, a body to be put down) those that do not begin with a light pipe. A hand that only holds the light
may rest, or be led by a script beside a person's or a recorded hand; its tremor would hide theirs. Its way, speed and contacts count.

Positions are those of the tip in the eye's frame. *Smoothed* keeps what a hand intends and drops its tremor, so that tremor is judged
once, as tremor.

## Tracking noise

What is below tracking noise does not count. The power that the tracker's covariance puts into the tremor's band is taken off the
tremor. A contact with retina or lens counts when it was deeper than its threshold by two deviations of the tracked tip along that
direction. Every total carries a deviation (`±`): that of the figures, carried through the slopes below, and p(1 − p) for contacts
that may or may not have been. It holds tracking noise only, not how a surgeon varies from day to day; for that see `docs/study.md`.
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
        "\n## Injuries\n\nEach injury takes its share of the points that all metrics bring together, and of what the injuries before it \
         left, so that each further one costs, however many there were; what is lost is taken off tissue treatment, which may fall below 0. \
         A serious injury fails the attempt: of what is left it keeps {KEPT_WHEN_FAILED}, always less than {} points. Lens contact, the two \
         haemorrhages and the tear are in the proportions 346 : 125 : 106 : 90, to half a per cent: so many points the commercial device took \
         off for an injured lens, macular haemorrhages, injured retina elsewhere and tears of surgeons who trained on it (Deuchler et al. 2016, \
         PLoS ONE 11(3), e0150690, doi 10.1371/journal.pone.0150690). Contacts that go into nothing and pulls are not in that study; they stand \
         below. Which injuries fail an attempt, and how much, is our judgement.\n\n",
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
