//! What came of two recordings: scores by category, and latencies by stage.

use super::side::Side;
use protocol::budget::Stage;
use serde::Serialize;
use std::collections::BTreeMap;
use training::score::Score;
use training::score::table::{Category, METRICS, PENALTIES};

/// A metric whose points differ.
#[derive(Debug, Clone, Serialize)]
pub struct MetricDifference {
    /// Name.
    pub name: &'static str,
    /// Unit of the values.
    pub unit: &'static str,
    /// Values in the first and the second recording.
    pub values: [Option<f64>; 2],
    /// Points.
    pub points: [f64; 2],
}

/// A category of the score.
#[derive(Debug, Clone, Serialize)]
pub struct CategoryDifference {
    /// Name.
    pub name: &'static str,
    /// Points in the first and the second recording.
    pub points: [f64; 2],
    /// The metrics that made the difference, largest first.
    pub made_by: Vec<MetricDifference>,
}

/// Scores of both recordings.
#[derive(Debug, Clone, Serialize)]
pub struct ScoreFigures {
    /// Points of 100.
    pub totals: [f64; 2],
    /// Deviations by tracking noise.
    pub sigmas: [f64; 2],
    /// Every category.
    pub categories: Vec<CategoryDifference>,
    /// Injuries that did not happen equally often: how often in the first and in the second.
    pub injuries_differ: BTreeMap<&'static str, [u32; 2]>,
}

/// Latency of a stage, ms.
#[derive(Debug, Clone, Serialize)]
pub struct LatencyFigures {
    /// The stage.
    pub stage: &'static str,
    /// How many were measured in the first and the second recording.
    pub counts: [u64; 2],
    /// Median.
    pub p50_ms: [f64; 2],
    /// 99 of 100 are below.
    pub p99_ms: [f64; 2],
}

/// Scores, where both scenes have a task and both were read with it.
pub fn scores(a: &Side, b: &Side) -> Option<ScoreFigures> {
    let scores = [&a.score.as_ref()?.score, &b.score.as_ref()?.score];
    Some(ScoreFigures {
        totals: scores.map(|s| s.total),
        sigmas: scores.map(|s| s.sigma),
        categories: Category::ALL.map(|category| of_category(category, scores)).into(),
        injuries_differ: injuries(scores),
    })
}

fn of_category(category: Category, scores: [&Score; 2]) -> CategoryDifference {
    let own = METRICS.iter().enumerate().filter(|(_, metric)| metric.category == category);
    let mut made_by: Vec<MetricDifference> = own
        .map(|(at, metric)| MetricDifference {
            name: metric.name,
            unit: metric.unit,
            values: scores.map(|s| s.metrics[at].value),
            points: scores.map(|s| s.metrics[at].points),
        })
        .filter(|m| m.points[0].to_bits() != m.points[1].to_bits())
        .collect();
    let points = scores.map(|s| s.categories[category as usize]);
    let size = |m: &MetricDifference| (m.points[1] - m.points[0]).abs();
    made_by.sort_by(|a, b| size(b).total_cmp(&size(a)));
    CategoryDifference { name: category.name(), points, made_by }
}

/// Kinds of injury that did not happen equally often.
fn injuries(scores: [&Score; 2]) -> BTreeMap<&'static str, [u32; 2]> {
    let counts = PENALTIES.iter().enumerate().map(|(at, p)| (p.name, scores.map(|s| s.injuries[at])));
    counts.filter(|(_, counts)| counts[0] != counts[1]).collect()
}

/// Latencies of the stages that one of the recordings measured.
pub fn latencies(a: &Side, b: &Side) -> Vec<LatencyFigures> {
    let percentile = |side: &Side, stage: Stage, share: f64| {
        let sorted = &side.latencies_us[stage as usize];
        let at = (sorted.len() as f64 * share).ceil() as usize;
        sorted.get(at.max(1) - 1).map_or(0.0, |us| f64::from(*us) * 1e-3)
    };
    let figures = Stage::ALL.map(|stage| LatencyFigures {
        stage: stage.name(),
        counts: [a, b].map(|side| side.latencies_us[stage as usize].len() as u64),
        p50_ms: [a, b].map(|side| percentile(side, stage, 0.5)),
        p99_ms: [a, b].map(|side| percentile(side, stage, 0.99)),
    });
    figures.into_iter().filter(|f| f.counts != [0, 0]).collect()
}
