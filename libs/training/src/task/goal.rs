//! Progress of one goal.

use super::Observation;
use nalgebra::Vector3;
use protocol::events::{Event, EventDraft, EventKind};
use protocol::handles::Tool;
use protocol::limits::INSTRUMENTS;
use protocol::time::Nanos;
use scene::Goal;
use serde::{Deserialize, Serialize};

/// A body lies still in its place if jaws do not hold it; it counts after this time, s.
const PLACED_S: f64 = 0.3;
/// A path is done when the tip is so near its end, mm along it.
const END_MM: f64 = 0.15;
/// A tip that left a tube goes on where it left it, and at most so far ahead, mm: no short cuts.
const AHEAD_MM: f64 = 1.0;

/// Progress of a goal.
#[derive(Debug, Clone, Default, PartialEq, Serialize, Deserialize)]
pub struct GoalState {
    /// It is reached.
    pub reached: bool,
    /// Since when its condition holds; 0 while it does not.
    since_ns: Nanos,
    /// Events counted.
    count: u32,
    /// Most of it that was done so far, in tenths; 10 is all.
    tenths: u32,
    /// Way along the path, mm.
    along_mm: f64,
    /// On the path at all.
    begun: bool,
    /// Since when the tip has been outside the tube; 0 inside.
    outside_ns: Nanos,
    /// Distances from the goal while its condition held: their sum, mm, and how many.
    sum_mm: f64,
    samples: u32,
}

impl GoalState {
    /// Mean distance from the goal while it was held, mm.
    pub fn mean_mm(&self) -> f64 {
        if self.samples == 0 { 0.0 } else { self.sum_mm / f64::from(self.samples) }
    }

    /// Way along the path, mm: for the picture.
    pub fn along_mm(&self) -> f64 {
        self.along_mm
    }

    pub(super) fn is_sound(&self) -> bool {
        self.along_mm.is_finite() && self.sum_mm.is_finite()
    }

    /// Notes that a share of it is done; the most so far counts.
    fn note_share(&mut self, share: f64) {
        // Sums of times are not exact; a share that is no number becomes none.
        self.tenths = self.tenths.max((share * 10.0 + 1e-6) as u32).min(9);
    }

    /// Tenths of it that are done, of a goal that is not reached.
    pub(super) fn tenths(&self) -> u32 {
        self.tenths
    }

    /// How long nothing has moved.
    pub(super) fn skip_gap(&mut self, gap_ns: u64) {
        let clocks = [&mut self.since_ns, &mut self.outside_ns];
        clocks.into_iter().filter(|since| **since > 0).for_each(|since| *since += gap_ns);
    }

    /// Counts events before the goal's turn, where it asks for that.
    pub(super) fn note_early(&mut self, goal: &Goal, events: &[Event]) {
        if let Goal::Event { early: true, .. } = goal {
            self.count_events(goal, events);
        }
    }

    fn count_events(&mut self, goal: &Goal, events: &[Event]) {
        let Goal::Event { event, at_least, .. } = goal else { return };
        let own = events.iter().filter(|e| e.kind == *event as u32 && e.value >= *at_least);
        self.count = self.count.saturating_add(own.count() as u32);
    }

    fn miss(&mut self, mm: f64) {
        self.sum_mm += mm;
        self.samples += 1;
    }

    fn forget(&mut self) {
        (self.since_ns, self.sum_mm, self.samples) = (0, 0.0, 0);
    }

    /// Its condition holds, `mm` off, and must for `hold_s`.
    fn hold(&mut self, now_ns: Nanos, mm: f64, hold_s: f64) {
        if self.since_ns == 0 {
            self.since_ns = now_ns;
        }
        self.miss(mm);
        let held_s = now_ns.saturating_sub(self.since_ns) as f64 * 1e-9;
        self.reached = held_s >= hold_s;
        self.note_share(held_s / hold_s);
    }
}

/// The inputs of a goal's check.
pub(super) struct Check<'a> {
    pub seen: &'a Observation<'a>,
    pub smooth_mm: &'a [Option<Vector3<f64>>; INSTRUMENTS],
    pub radius_mm: f64,
    pub axes: &'a [Vector3<f64>],
}

impl Check<'_> {
    /// Advances a goal by one step; `index` is its number, for events.
    pub fn advance(&self, goal: &Goal, own: &mut GoalState, index: u32, emit: &mut dyn FnMut(EventDraft)) {
        match goal {
            Goal::Hold { instrument, at_in_eye_mm, radius_mm, hold_s } => {
                let off = self.off_mm(*instrument as usize, at_in_eye_mm);
                self.keep(own, off.filter(|(raw, _)| raw <= radius_mm).map(|(_, mm)| mm), *hold_s);
            }
            Goal::Near { instrument, towards_in_eye, radius_mm, clearance_mm, hold_s } => {
                let near = self.near_mm(*instrument as usize, towards_in_eye, *radius_mm, clearance_mm);
                self.keep(own, near, *hold_s);
            }
            Goal::Align { at_in_eye_mm, radius_mm, hold_s } => {
                let off =
                    [0, 1].map(|i| self.off_mm(i, &at_in_eye_mm[i]).filter(|(raw, _)| raw <= radius_mm));
                let both = off[0].zip(off[1]).map(|((_, a), (_, b))| 0.5 * (a + b));
                self.keep(own, both, *hold_s);
            }
            Goal::Follow { instrument, path_in_eye_mm, radius_mm } => {
                self.follow(*instrument as usize, path_in_eye_mm, *radius_mm, own, index, emit);
            }
            Goal::Grip { body, instrument } => {
                own.reached =
                    self.seen.bodies.get(*body as usize).is_some_and(|b| b.held_by == Some(*instrument));
            }
            Goal::Place { body, at_in_eye_mm, radius_mm, along_in_eye, within_rad } => {
                let placed = self.placed_mm(*body as usize, at_in_eye_mm, along_in_eye.as_ref(), *within_rad);
                self.keep(own, placed.filter(|mm| mm <= radius_mm), PLACED_S);
            }
            Goal::Gel { zone, removed_ml, .. } => {
                let share = self.seen.gel_ml.map_or(0.0, |ml| ml[*zone as usize] / removed_ml);
                own.reached = share >= 1.0;
                own.note_share(share);
            }
            Goal::Retina { turned_rad, loose_share, hold_s, .. } => {
                let there = self
                    .seen
                    .retina
                    .filter(|r| r.turned_rad.abs() >= *turned_rad && r.loose_share <= *loose_share);
                self.keep(own, there.map(|_| 0.0), *hold_s);
            }
            Goal::Event { count, .. } => {
                own.count_events(goal, self.seen.events);
                own.reached = own.count >= *count && !self.hurts_retina();
                own.note_share(f64::from(own.count.min(count - 1)) / f64::from(*count));
            }
        }
    }

    /// A tip is in the retina that has no business there; a needle's has. What is reached meanwhile
    /// counts once the tip is out.
    fn hurts_retina(&self) -> bool {
        let hurts = |(inside, tool): (&bool, &u32)| *inside && *tool != Tool::Needle as u32;
        self.seen.in_retina.iter().zip(&self.seen.tools).any(hurts)
    }

    fn keep(&self, own: &mut GoalState, off_mm: Option<f64>, hold_s: f64) {
        match off_mm {
            Some(mm) => own.hold(self.seen.now_ns, mm, hold_s),
            None => own.forget(),
        }
    }

    /// Distance of a tip from a point, mm: as it is, and smoothed.
    fn off_mm(&self, instrument: usize, at: &[f64; 3]) -> Option<(f64, f64)> {
        let at = Vector3::from(*at);
        let raw = (self.seen.tips[instrument]?.tip_in_eye_mm - at).norm();
        Some((raw, (self.smooth_mm[instrument]? - at).norm()))
    }

    /// Distance of a tip from the line over a point of the retina, mm, if it is in its place.
    fn near_mm(
        &self,
        instrument: usize,
        towards: &[f64; 3],
        radius_mm: f64,
        clearance: &[f64; 2],
    ) -> Option<f64> {
        let tip = self.seen.tips[instrument]?.tip_in_eye_mm;
        let towards = Vector3::from(*towards).try_normalize(1e-6)?;
        let beside = |p: &Vector3<f64>| (p - towards * p.dot(&towards)).norm();
        let height = self.radius_mm - tip.norm();
        let inside = (clearance[0]..=clearance[1]).contains(&height) && beside(&tip) <= radius_mm;
        inside.then(|| self.smooth_mm[instrument].map(|p| beside(&p)))?
    }

    /// Distance of a body from its place, mm, if it lies free and along the axis asked for.
    fn placed_mm(
        &self,
        body: usize,
        at: &[f64; 3],
        along: Option<&[f64; 3]>,
        within_rad: f64,
    ) -> Option<f64> {
        let axis = self.axes.get(body).copied().unwrap_or(Vector3::z());
        let body = self.seen.bodies.get(body).filter(|b| b.held_by.is_none())?;
        if let Some(along) = along {
            let wanted = Vector3::from(*along).try_normalize(1e-6)?;
            let cosine = (body.eye_from_body.rotation * axis).dot(&wanted).abs();
            if cosine < libm::cos(within_rad) {
                return None;
            }
        }
        Some((body.eye_from_body.translation.vector - Vector3::from(*at)).norm())
    }

    fn follow(
        &self,
        instrument: usize,
        path: &[[f64; 3]],
        radius_mm: f64,
        own: &mut GoalState,
        index: u32,
        emit: &mut dyn FnMut(EventDraft),
    ) {
        let Some(tip) = self.seen.tips[instrument].map(|t| t.tip_in_eye_mm) else { return };
        if !own.begun {
            if (tip - Vector3::from(path[0])).norm() > radius_mm {
                return;
            }
            own.begun = true;
        }
        let (along, off) = nearest_ahead(path, &tip, own.along_mm);
        let draft = |kind, value| EventDraft {
            limit: radius_mm,
            ..EventDraft::new(kind, value).about(index).by(instrument, tip.into())
        };
        if off > radius_mm {
            if own.outside_ns == 0 {
                own.outside_ns = self.seen.now_ns;
                emit(draft(EventKind::PathLeft, off - radius_mm));
            }
            return;
        }
        if own.outside_ns > 0 {
            let lasted_s = (self.seen.now_ns - own.outside_ns) as f64 * 1e-9;
            own.outside_ns = 0;
            emit(draft(EventKind::PathRegained, lasted_s));
        }
        own.along_mm = along;
        own.miss(self.smooth_mm[instrument].map_or(off, |p| nearest_ahead(path, &p, along - AHEAD_MM).1));
        own.reached = along >= length_mm(path) - END_MM;
        own.note_share(along / length_mm(path));
    }
}

/// Length of a path, mm.
pub fn length_mm(path: &[[f64; 3]]) -> f64 {
    path.windows(2).map(|w| (Vector3::from(w[1]) - Vector3::from(w[0])).norm()).sum()
}

/// The point of the path that is nearest to `p`, of those between `from_mm` and [`AHEAD_MM`]
/// further: its way along the path and its distance, mm.
fn nearest_ahead(path: &[[f64; 3]], p: &Vector3<f64>, from_mm: f64) -> (f64, f64) {
    let (mut best, mut begin) = ((from_mm, f64::INFINITY), 0.0);
    for ends in path.windows(2) {
        let (a, b) = (Vector3::from(ends[0]), Vector3::from(ends[1]));
        let length = (b - a).norm();
        let (low, high) = (from_mm - begin, from_mm + AHEAD_MM - begin);
        if length > 0.0 && high >= 0.0 && low <= length {
            let at = (p - a).dot(&(b - a)) / length;
            let at = at.clamp(low.clamp(0.0, length), high.clamp(0.0, length));
            let off = (a + (b - a) * (at / length) - p).norm();
            if off < best.1 {
                best = (begin + at, off);
            }
        }
        begin += length;
    }
    best
}

#[cfg(test)]
mod tests {
    use super::*;
    use proptest::prelude::*;

    const PATH: [[f64; 3]; 3] = [[0.0; 3], [2.0, 0.0, 0.0], [2.0, 2.0, 0.0]];

    #[test]
    fn the_path_is_found_ahead_and_never_cut_short() {
        assert!((length_mm(&PATH) - 4.0).abs() < 1e-12);
        let (along, off) = nearest_ahead(&PATH, &Vector3::new(0.5, 0.1, 0.0), 0.0);
        assert!((along - 0.5).abs() < 1e-12 && (off - 0.1).abs() < 1e-12);
        let (along, _) = nearest_ahead(&PATH, &Vector3::new(2.0, 2.0, 0.0), 0.2);
        assert!(along <= 0.2 + AHEAD_MM + 1e-12, "the end is not reached from the begin: {along}");
        let (along, off) = nearest_ahead(&PATH, &Vector3::new(2.1, 0.3, 0.0), 1.8);
        assert!((along - 2.3).abs() < 1e-12 && (off - 0.1).abs() < 1e-12, "round the corner");
    }

    proptest! {
        #[test]
        fn no_point_of_the_stretch_is_nearer(x in -1.0..3.0f64, y in -1.0..3.0f64, from in 0.0..3.9f64) {
            let p = Vector3::new(x, y, 0.2);
            let (along, off) = nearest_ahead(&PATH, &p, from);
            prop_assert!(along >= from - 1e-9 && along <= from + AHEAD_MM + 1e-9);
            for k in 0..=100 {
                let s = (from + AHEAD_MM * f64::from(k) / 100.0).min(4.0);
                let q = if s <= 2.0 { Vector3::new(s, 0.0, 0.0) } else { Vector3::new(2.0, s - 2.0, 0.0) };
                prop_assert!((q - p).norm() >= off - 1e-9);
            }
        }
    }
}
