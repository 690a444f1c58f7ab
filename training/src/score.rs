//! The score: 100 points in five categories, from what happened and how the instruments moved. The
//! table of metrics is [`table`]; sums are kept by [`meter`]; a [`Score`] is made from them at any
//! time, and published when the attempt ends.

pub mod doc;
pub mod filter;
pub mod meter;
pub mod recording;
pub mod table;

pub use meter::{Meter, Scorer};

use meter::larger;
use protocol::events::{EventDraft, EventKind};
use serde::Serialize;
use table::{CATEGORIES, COUNT, Category, Id, METRICS, MOST_PENALTY, PENALTIES, VERSION};

/// Uncertainty of the tracker's own covariance: how far the noise taken from the tremor may be
/// wrong, as a share.
const NOISE_DOUBT: f64 = 0.2;
/// A field's period, by which begin and end of an attempt may be off, s.
const FIELD_S: f64 = 0.02;

/// A metric of an attempt.
#[derive(Debug, Clone, Copy, PartialEq, Serialize)]
pub struct Reading {
    /// Name for programs.
    pub key: &'static str,
    /// In the metric's unit; `None` where the task has nothing of the kind.
    pub value: Option<f64>,
    /// Deviation of the value by tracking noise.
    pub sigma: f64,
    /// Points it brings.
    pub points: f64,
    /// Points that it could bring: its weight, and its share of those of its category that the task
    /// has nothing for.
    pub of: f64,
}

/// The score of an attempt.
#[derive(Debug, Clone, PartialEq, Serialize)]
pub struct Score {
    /// [`VERSION`].
    pub version: u32,
    /// Points of 100, at least 0.
    pub total: f64,
    /// Deviation of the total by tracking noise.
    pub sigma: f64,
    /// Points by category, in the order of [`Category::ALL`]; the last may be below 0.
    pub categories: [f64; CATEGORIES],
    /// Every metric, in the order of [`METRICS`].
    pub metrics: [Reading; COUNT],
    /// Injuries that count, in the order of [`PENALTIES`].
    pub injuries: [u32; table::INJURIES],
    /// Every goal was reached in time.
    pub finished: bool,
    /// Time of the attempt, s.
    pub took_s: f64,
}

impl Scorer {
    /// The score of an attempt as it stands.
    pub fn score(&self, meter: &Meter) -> Score {
        let meter = &self.closed(meter);
        let figures = self.figures(meter);
        let metrics: [Reading; COUNT] = std::array::from_fn(|i| reading(&figures, i));
        let categories: [f64; CATEGORIES] = std::array::from_fn(|c| {
            let own = (0..COUNT).filter(|&i| METRICS[i].category as usize == c);
            own.map(|i| metrics[i].points).sum()
        });
        let sum: f64 = categories.iter().sum();
        Score {
            version: VERSION,
            total: if sum > 0.0 { sum } else { 0.0 },
            sigma: libm::sqrt((0..COUNT).map(|i| variance(&metrics[i], i, meter)).sum()),
            categories,
            metrics,
            injuries: meter.injuries.map(|t| t.count),
            finished: meter.finished,
            took_s: meter.elapsed_s(),
        }
    }

    /// Value and deviation of every metric; `None` where the task has nothing of the kind.
    fn figures(&self, m: &Meter) -> [Option<(f64, f64)>; COUNT] {
        let goals = self.task.goals.len() as f64;
        let share = f64::from(m.reached) / goals;
        let took_s = m.elapsed_s();
        let of_time = |s: f64| if took_s > 0.0 { s / took_s } else { 0.0 };
        let has_path = self.task.goals.iter().any(|g| matches!(g, scene::Goal::Follow { .. }));
        let aims = self.task.goals.iter().any(|g| g.radius_mm().is_some());
        let none = |id: Id| METRICS[id as usize].none_at;
        let n = f64::from(m.missed_count);
        let mut figures = [None; COUNT];
        figures[Id::Goals as usize] = Some((share, 0.0));
        figures[Id::Precision as usize] = aims.then(|| match m.missed_count {
            0 => (none(Id::Precision), 0.0),
            _ => (m.missed / n, libm::sqrt(m.missed_variance) / n),
        });
        figures[Id::OffPath as usize] = has_path.then(|| (of_time(m.off_path_s), of_time(FIELD_S)));
        let in_time = took_s / self.task.par_s;
        let time = if m.finished { in_time } else { larger(in_time, none(Id::Time)) };
        figures[Id::Time as usize] = Some((time, FIELD_S / self.task.par_s));
        figures[Id::Way as usize] = (self.task.par_mm > 0.0).then(|| {
            let way: f64 = m.instruments.iter().map(|h| h.way_mm).sum();
            if share > 0.0 { (way / (self.task.par_mm * share), 0.0) } else { (none(Id::Way), 0.0) }
        });
        figures[Id::Tremor as usize] = Some(self.tremor_um(m));
        let fastest = |of: fn(&meter::InstrumentStats) -> f64| m.instruments.iter().map(of).fold(0.0, larger);
        figures[Id::Speed as usize] = Some((fastest(|h| h.fastest_mm_s), 0.0));
        figures[Id::SpeedNearRetina as usize] = Some((fastest(|h| h.fastest_near_mm_s), 0.0));
        figures[Id::Grip as usize] = Some((f64::from(m.slips), 0.0));
        figures[Id::OutOfView as usize] = Some((of_time(m.out_of_view_s), 0.0));
        figures[Id::Unlit as usize] =
            self.lit.then(|| (if m.seen_s > 0.0 { m.unlit_s / m.seen_s } else { 0.0 }, 0.0));
        figures[Id::LightDose as usize] = self.lit.then_some((m.dose_mj_mm2, 0.0));
        figures[Id::Injuries as usize] = Some((penalty(m), 0.0));
        figures
    }

    /// Tremor of the worse of the hands at the task, less tracking noise, and its deviation, µm.
    fn tremor_um(&self, m: &Meter) -> (f64, f64) {
        let mut worst = (0.0, 0.0);
        let hands = m.instruments.iter().zip(self.at_task).filter(|(_, at_task)| *at_task);
        for (hand, _) in hands.filter(|(hand, _)| hand.tremor_samples > 0) {
            let n = f64::from(hand.tremor_samples);
            let (all, noise) = (hand.tremor_mm2 / n, hand.noise_mm2 / n);
            let own = if all > noise { libm::sqrt(all - noise) } else { 0.0 };
            // From own² = all − noise; where noise is all there is, the noise's own doubt remains.
            let doubt = NOISE_DOUBT * if own * own > noise { noise / own } else { libm::sqrt(noise) };
            if own * 1e3 >= worst.0 {
                worst = (own * 1e3, doubt * 1e3);
            }
        }
        worst
    }
}

impl Score {
    /// The events at the end of an attempt: every category, then the total.
    pub fn events(&self) -> [EventDraft; CATEGORIES + 1] {
        std::array::from_fn(|i| match i {
            CATEGORIES => {
                let total = EventDraft::new(EventKind::ScoreTotal, self.total).about(self.version);
                EventDraft { limit: self.sigma, ..total }
            }
            c => {
                let draft = EventDraft::new(EventKind::ScoreCategory, self.categories[c]).about(c as u32);
                EventDraft { limit: Category::ALL[c].points(), ..draft }
            }
        })
    }
}

/// Points lost to injuries.
fn penalty(m: &Meter) -> f64 {
    let of = |i: usize| {
        let all = f64::from(m.injuries[i].count) * PENALTIES[i].points;
        if all > PENALTIES[i].most { PENALTIES[i].most } else { all }
    };
    let sum: f64 = (0..PENALTIES.len()).map(of).sum();
    if sum > MOST_PENALTY { MOST_PENALTY } else { sum }
}

/// Share of its points that a figure brings: 1 at `full_at` and better, 0 at `none_at` and worse.
fn ramp(metric: &table::Metric, value: f64) -> f64 {
    let share = (value - metric.none_at) / (metric.full_at - metric.none_at);
    // The sum makes a negative zero a plain one.
    share.clamp(0.0, 1.0) + 0.0
}

fn reading(figures: &[Option<(f64, f64)>; COUNT], i: usize) -> Reading {
    let metric = &METRICS[i];
    let Some((value, sigma)) = figures[i] else {
        return Reading { key: metric.key, value: None, sigma: 0.0, points: 0.0, of: 0.0 };
    };
    // What a task has nothing for is shared out among the others of the category; injuries keep
    // their own scale.
    let own = |j: &usize| METRICS[*j].category == metric.category;
    let injuries = Id::Injuries as usize;
    let points_where = |there: bool| {
        let those = (0..COUNT).filter(own).filter(|&j| figures[j].is_some() == there);
        those.map(|j| METRICS[j].points).sum::<f64>()
    };
    let (shared, there) = (points_where(false), points_where(true));
    let of = metric.points * (1.0 + if there > 0.0 { shared / there } else { 0.0 });
    let points = if i == injuries { of - value } else { of * ramp(metric, value) };
    Reading { key: metric.key, value: Some(value), sigma, points, of }
}

/// Variance of a metric's points.
fn variance(reading: &Reading, i: usize, m: &Meter) -> f64 {
    let metric = &METRICS[i];
    if i == Id::Injuries as usize {
        let of = |k: usize| PENALTIES[k].points * PENALTIES[k].points * m.injuries[k].variance;
        return (0..PENALTIES.len()).map(of).sum();
    }
    let share = reading.value.map_or(0.0, |v| ramp(metric, v));
    // Beyond a threshold a small doubt changes nothing.
    let steep = if share > 0.0 && share < 1.0 { reading.of / (metric.full_at - metric.none_at) } else { 0.0 };
    (steep * reading.sigma) * (steep * reading.sigma)
}

#[cfg(test)]
mod tests;
