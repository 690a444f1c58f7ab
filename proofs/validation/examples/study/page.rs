//! The page: tables in the form that documents have.

use crate::numbers::{deviation, effect, mean, range};
use crate::{CARELESS_BELOW, EXPERT_FROM, IDLE_UP_TO, Outcome, within};
use std::fmt::Write;
use surgeon::skill::Skill;
use training::score::Score;
use training::score::table::{CATEGORIES, Category, METRICS, PENALTIES, VERSION};

/// The scripted surgeons.
pub struct Part1<'a> {
    /// By module.
    pub outcomes: &'a [Outcome],
    /// Best first.
    pub surgeons: &'a [Skill],
    /// Attempts of each at each module.
    pub seeds: u64,
}

impl Part1<'_> {
    /// Points and effects.
    pub fn table(&self) -> String {
        let names: Vec<&str> = self.surgeons.iter().map(|s| s.name).collect();
        let effects: Vec<String> = names.windows(2).map(|w| format!("d {}–{}", w[0], w[1])).collect();
        let columns = [vec!["module"], names, effects.iter().map(String::as_str).collect()].concat();
        let mut out = format!("| {} |\n{}|\n", columns.join(" | "), "|---".repeat(columns.len()));
        for outcome in self.outcomes {
            let totals: Vec<Vec<f64>> = (0..self.surgeons.len()).map(|s| outcome.totals(s)).collect();
            let points = |t: &Vec<f64>| {
                let [low, high] = range(t);
                format!("{:.1} ± {:.1} ({low:.1} to {high:.1})", mean(t), deviation(t))
            };
            let mut cells: Vec<String> = totals.iter().map(points).collect();
            cells.extend(totals.windows(2).map(|w| format!("{:.1}", effect(&w[0], &w[1]))));
            let _ = writeln!(out, "| {} | {} |", outcome.module, cells.join(" | "));
        }
        out
    }

    /// Points by category, and how many attempts were finished.
    fn categories(&self) -> String {
        let mut out = String::from("| module | surgeon | finished | failed |");
        Category::ALL.iter().for_each(|c| {
            let _ = write!(out, " {} (of {}) |", c.name(), c.points());
        });
        let _ = writeln!(out, "\n{}|", "|---".repeat(4 + CATEGORIES));
        for outcome in self.outcomes {
            for (surgeon, scores) in self.surgeons.iter().zip(&outcome.scores) {
                let finished = scores.iter().filter(|s| s.finished).count();
                let failed = scores.iter().filter(|s| s.failed.is_some()).count();
                let (module, name, all) = (&outcome.module, surgeon.name, scores.len());
                let _ = write!(out, "| {module} | {name} | {finished} of {all} | {failed} |");
                for c in 0..CATEGORIES {
                    let _ = write!(out, " {:.1} |", of(scores, |s| s.categories[c]));
                }
                out.push('\n');
            }
        }
        out
    }

    /// For a person who tunes: categories in short, on demand every metric.
    pub fn details(&self, verbose: bool) -> String {
        let mut out = String::new();
        for outcome in self.outcomes {
            for (surgeon, scores) in self.surgeons.iter().zip(&outcome.scores) {
                let finished = scores.iter().filter(|s| s.finished).count();
                let c: Vec<String> =
                    (0..CATEGORIES).map(|c| format!("{:5.1}", of(scores, |s| s.categories[c]))).collect();
                let [low, high] = range(&scores.iter().map(|s| s.total).collect::<Vec<_>>());
                let (name, all) = (&outcome.module, scores.len());
                let _ = writeln!(
                    out,
                    "{name:<12} {:<9} {}  {low:5.1} to {high:5.1}, finished {finished} of {all}, failed {}, {:.1} s",
                    surgeon.name,
                    c.join(" "),
                    scores.iter().filter(|s| s.failed.is_some()).count(),
                    of(scores, |s| s.took_s)
                );
                if verbose {
                    metrics(&mut out, scores);
                }
            }
        }
        out
    }
}

fn of(scores: &[Score], f: impl Fn(&Score) -> f64) -> f64 {
    mean(&scores.iter().map(f).collect::<Vec<_>>())
}

fn metrics(out: &mut String, scores: &[Score]) {
    for (i, metric) in METRICS.iter().enumerate() {
        let (value, points) =
            (of(scores, |s| s.metrics[i].value.unwrap_or(0.0)), of(scores, |s| s.metrics[i].points));
        let most = of(scores, |s| s.metrics[i].of);
        let _ = writeln!(
            out,
            "    {:<32} {value:9.3} {:<20} {points:6.2} of {most:.1}",
            metric.name, metric.unit
        );
    }
    for (i, penalty) in PENALTIES.iter().enumerate() {
        let times = of(scores, |s| f64::from(s.injuries[i]));
        if times > 0.0 {
            let _ = writeln!(out, "    {:<32} {times:9.2} times", penalty.name);
        }
    }
}

/// The whole page.
pub fn page(part1: &Part1, level: u32, part2: &str) -> String {
    let (seeds, attempts) = (part1.seeds, part1.seeds as usize * part1.outcomes.len() * part1.surgeons.len());
    let fits = part1.outcomes.iter().filter(|o| o.holds(part1.surgeons)).count();
    let all = part1.outcomes.len();
    let names: Vec<&str> = part1.surgeons.iter().map(|s| s.name).collect();
    let good = |name: &str| {
        let place = names.iter().position(|n| *n == name);
        let own = part1.outcomes.iter().filter_map(|o| o.scores.get(place?)).flatten();
        own.filter(|score| within(&part1.surgeons[place.unwrap_or(0)], score)).count()
    };
    let (expert, careless, idle) = (good("expert"), good("careless"), good("idle"));
    let each = all * seeds as usize;
    format!(
        "# Study: does the score separate surgeons by skill?

This page shows how well the score (`docs/score.md`) separates surgeons of different skill, for readers who judge the
score. `make study STUDY=\"--level {level} --seeds {seeds}\"` writes it from {attempts} attempts without pixels: a scripted surgeon's script
and tremor, markers projected directly to blobs with noise, then tracker, simulation, task and score as in a live run
(`proofs/validation/src/pipeline.rs`). Score version {VERSION}, level {level} of each module, {seeds} seeds per surgeon.

Scripts and score come from the same authors, so part 1 shows that the score does what it is meant to, not that it
measures surgeons. Part 2 uses recorded hands from independent studies.

## Part 1: scripted surgeons

The surgeons are sets of parameters in `libs/surgeon/src/skill.rs`: {}. Idle hands
move once, which begins the attempt, and then rest until its time is over.

![Points of every attempt, by module and surgeon](study.png)

Each dot is an attempt, each line the mean of a surgeon. Grey lines: {EXPERT_FROM} and {CARELESS_BELOW} points.

The expert finished {expert} of {each} attempts with {EXPERT_FROM} points or more. The careless surgeon got less than {CARELESS_BELOW} points in {careless} of {each},
idle hands {IDLE_UP_TO} or less in {idle} of {each}. In {fits} of {all} modules every attempt is within these bounds, and the means have the order {}.

Points: mean ± standard deviation (minimum to maximum). d: Cohen's d, the difference of two means over their pooled
standard deviation.

{}
Means by category, points:

{}
{part2}",
        names.join(", "),
        names.join(" > "),
        part1.table(),
        part1.categories()
    )
}
