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
use table::{CATEGORIES, COUNT, Category, Id, KEPT_WHEN_FAILED, METRICS, PENALTIES, VERSION};

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
    /// Name of the first serious injury in that order, which failed the attempt.
    pub failed: Option<&'static str>,
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
        let injuries = meter.injuries.map(|t| t.count);
        let done = self.share_done(meter);
        let mut metrics: [Reading; COUNT] = std::array::from_fn(|i| reading(&figures, i, done));
        let earned: f64 = metrics.iter().map(|m| m.points).sum();
        let kept = share_kept(&injuries);
        let lost = earned * (1.0 - kept);
        let unhurt = &mut metrics[Id::Injuries as usize];
        (unhurt.value, unhurt.points) = (Some(lost), unhurt.points - lost);
        let categories: [f64; CATEGORIES] = std::array::from_fn(|c| {
            let own = (0..COUNT).filter(|&i| METRICS[i].category as usize == c);
            own.map(|i| metrics[i].points).sum()
        });
        let sum: f64 = categories.iter().sum();
        Score {
            version: VERSION,
            total: if sum > 0.0 { sum } else { 0.0 },
            sigma: kept * libm::sqrt(variance(&metrics, done, earned, meter)),
            categories,
            metrics,
            injuries,
            failed: serious(&injuries),
            finished: meter.finished,
            took_s: meter.elapsed_s(),
        }
    }

    /// Value and deviation of every metric; `None` where the task has nothing of the kind.
    fn figures(&self, m: &Meter) -> [Option<(f64, f64)>; COUNT] {
        let share = self.share_done(m);
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
        figures[Id::Injuries as usize] = Some((0.0, 0.0));
        figures
    }

    /// Share of the goals that is done: each that is reached, and of others the part that was.
    fn share_done(&self, m: &Meter) -> f64 {
        let goals = self.task.goals.len();
        m.done.iter().take(goals).sum::<f64>() / goals as f64
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

/// Share of its points that an attempt with these injuries keeps. Each takes its share of what the
/// others left, so that one more always costs and nothing falls below 0.
fn share_kept(injuries: &[u32; table::INJURIES]) -> f64 {
    let of = |(p, n): (&table::Penalty, &u32)| libm::pow(1.0 - p.share, f64::from(*n));
    let kept: f64 = PENALTIES.iter().zip(injuries).map(of).product();
    if serious(injuries).is_some() { kept * KEPT_WHEN_FAILED } else { kept }
}

/// Name of the first serious injury among these.
fn serious(injuries: &[u32; table::INJURIES]) -> Option<&'static str> {
    let own = PENALTIES.iter().zip(injuries).find(|(p, n)| p.serious && **n > 0);
    own.map(|(p, _)| p.name)
}

/// Share of its points that a figure brings: 1 at `full_at` and better, 0 at `none_at` and worse.
fn ramp(metric: &table::Metric, value: f64) -> f64 {
    let share = (value - metric.none_at) / (metric.full_at - metric.none_at);
    // The sum makes a negative zero a plain one.
    share.clamp(0.0, 1.0) + 0.0
}

/// A metric's points, before those lost to injuries. All but the goals themselves bring the share of
/// their points that is `done` of the goals: who does nothing handles nothing well.
fn reading(figures: &[Option<(f64, f64)>; COUNT], i: usize, done: f64) -> Reading {
    let metric = &METRICS[i];
    let Some((value, sigma)) = figures[i] else {
        return Reading { key: metric.key, value: None, sigma: 0.0, points: 0.0, of: 0.0 };
    };
    // What a task has nothing for is shared out among the others of the category.
    let own = |j: &usize| METRICS[*j].category == metric.category;
    let points_where = |there: bool| {
        let those = (0..COUNT).filter(own).filter(|&j| figures[j].is_some() == there);
        those.map(|j| METRICS[j].points).sum::<f64>()
    };
    let (shared, there) = (points_where(false), points_where(true));
    let of = metric.points * (1.0 + if there > 0.0 { shared / there } else { 0.0 });
    let scale = if i == Id::Goals as usize { 1.0 } else { done };
    Reading { key: metric.key, value: Some(value), sigma, points: of * scale * ramp(metric, value), of }
}

/// Variance of the points earned: of the metrics by their slopes, and of injuries that may or may
/// not have been by what each takes.
fn variance(metrics: &[Reading; COUNT], done: f64, earned: f64, m: &Meter) -> f64 {
    let of_metric = |(metric, reading): (&table::Metric, &Reading)| {
        let share = reading.value.map_or(0.0, |v| ramp(metric, v));
        // Beyond a threshold a small doubt changes nothing.
        let inside = share > 0.0 && share < 1.0;
        let steep = if inside { done * reading.of / (metric.full_at - metric.none_at) } else { 0.0 };
        (steep * reading.sigma) * (steep * reading.sigma)
    };
    let of_injury = |(p, tally): (&table::Penalty, &meter::Tally)| {
        let fails = p.serious && tally.count == 0;
        let takes = 1.0 - (1.0 - p.share) * if fails { KEPT_WHEN_FAILED } else { 1.0 };
        (earned * takes) * (earned * takes) * tally.variance
    };
    let metrics: f64 = METRICS.iter().zip(metrics).map(of_metric).sum();
    metrics + PENALTIES.iter().zip(&m.injuries).map(of_injury).sum::<f64>()
}

#[cfg(test)]
mod tests;
