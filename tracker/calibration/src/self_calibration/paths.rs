//! Motion of bodies as splines in time, for cameras that do not expose together.
//!
//! Where every camera has a clock of its own, no two cameras see a body in the same pose. Here a body follows, over a
//! stretch of some frames, a uniform cubic B-spline of its place and its rotation vector. The control points stand for
//! the poses in the bundle adjustment, and every blob is compared with the pose at the exposure of its own line
//! (Furgale, Barfoot and Sibley, Continuous-time batch estimation using temporal basis functions, 2012). A tremor of
//! 12 Hz is followed to 0.2 % with intervals of 15 ms.

use super::problem::{SUSPECT, SelfCalibrationProblem};
use super::spline::{Moving, Path, by_control_point};
use crate::bundle::Bundle;
use crate::median;
use crate::observations::{FrameObservations, MarkerObservation};
use crate::solve::{Column, Loss, NormalEquations, Problem, Unknown};
use crate::target_problem::Residual;
use nalgebra::{DVector, Matrix1, Vector2, Vector3};
use protocol::limits::BODIES;
use protocol::time::Nanos;
use std::ops::Range;

/// Length of an interval in frame periods, and its least length, s: shorter ones follow faster motion, and know less.
const INTERVAL: (f64, f64) = (0.75, 8e-3);
/// Frames of a stretch: its ends are known less well than its middle.
const FRAMES: usize = 8;
/// Exposures of a frame lie so far from its instant at most, in frame periods.
const REACH: f64 = 0.6;
/// Share of a stretch's frames that must have a pose of a body.
const PRESENT: f64 = 0.8;
/// By how much an interval may bend unlike the one before, rad and mm (a third difference of control points): some
/// times what a strong tremor does, so that exposures that are missing leave nothing open.
const BEND: (f64, f64) = (0.05, 0.5);

/// Frames that follow each other, and the intervals that reach over all their exposures.
struct Stretch {
    instants: Range<usize>,
    begin_ns: Nanos,
    intervals: usize,
}

/// The rig, and how bodies move.
#[derive(Clone)]
pub(super) struct Paths {
    pub rig: Bundle,
    of: Vec<[Option<Path>; BODIES]>,
}

fn since_s(at: Nanos, begin: Nanos) -> f64 {
    (at as f64 - begin as f64) * 1e-9
}

/// The bundle adjustment of a rig with paths instead of poses.
pub(super) struct PathProblem<'a> {
    /// What is free of the rig.
    pub rig: SelfCalibrationProblem<'a>,
    stretches: Vec<Stretch>,
    interval_s: f64,
    /// First own unknown of each body of a stretch, and their number.
    own: Vec<([usize; BODIES], usize)>,
}

/// `most` instants at most, in stretches of frames that follow each other, evenly spread; with the covariance of each
/// blob alone.
pub(super) fn in_stretches(
    instants: &[FrameObservations],
    most: usize,
) -> (Vec<FrameObservations>, Vec<Range<usize>>) {
    let period_s = period_s(instants).unwrap_or(0.0);
    let runs: Vec<&[FrameObservations]> = followed(instants, period_s).collect();
    let used = runs.len().min((most / FRAMES).max(1));
    let (mut chosen, mut stretches) = (Vec::new(), Vec::new());
    for run in (0..used).map(|i| runs[i * runs.len() / used]) {
        stretches.push(chosen.len()..chosen.len() + run.len());
        chosen.extend_from_slice(run);
    }
    for seen in chosen.iter_mut().flat_map(|i| &mut i.seen) {
        seen.covariance -= seen.carried;
        seen.carried.fill(0.0);
    }
    (chosen, stretches)
}

/// Usual time from one frame to the next.
fn period_s(instants: &[FrameObservations]) -> Option<f64> {
    median(instants.windows(2).map(|pair| since_s(pair[1].exposed_ns, pair[0].exposed_ns)))
}

/// Runs of frames without a gap.
fn followed(instants: &[FrameObservations], period_s: f64) -> impl Iterator<Item = &[FrameObservations]> {
    let next = move |a: &FrameObservations, b: &FrameObservations| {
        since_s(b.exposed_ns, a.exposed_ns) < 1.5 * period_s
    };
    instants.chunk_by(next).flat_map(|run| run.chunks(FRAMES)).filter(|chunk| 2 * chunk.len() > FRAMES)
}

impl<'a> PathProblem<'a> {
    /// The problem of instants of [`in_stretches`], and where it starts.
    pub fn new(rig: SelfCalibrationProblem<'a>, stretches: Vec<Range<usize>>) -> (Self, Paths) {
        let instants = rig.instants;
        let period_s = period_s(instants).unwrap_or(0.0);
        let interval_s = (INTERVAL.0 * period_s).max(INTERVAL.1);
        let stretch = |of: Range<usize>| {
            let (begin, end) = (instants[of.start].exposed_ns, instants[of.end - 1].exposed_ns);
            let begin_ns = begin.saturating_sub((REACH * period_s * 1e9) as Nanos);
            let length_s = since_s(end, begin_ns) + REACH * period_s;
            Stretch { instants: of, begin_ns, intervals: (length_s / interval_s).ceil() as usize }
        };
        let stretches: Vec<Stretch> = stretches.into_iter().map(stretch).collect();
        let path = |stretch: &Stretch, body: usize| {
            let own = &instants[stretch.instants.clone()];
            let known =
                |i: &FrameObservations| Some((since_s(i.exposed_ns, stretch.begin_ns), i.poses[body]?));
            let poses: Vec<_> = own.iter().filter_map(known).collect();
            let present = poses.len() as f64 >= PRESENT * own.len() as f64;
            Path::through(&poses, stretch.intervals, interval_s).filter(|_| present)
        };
        let of = stretches.iter().map(|s| std::array::from_fn(|body| path(s, body))).collect();
        let start = Paths { of, rig: rig.before.clone() };
        let layout = |paths: &[Option<Path>; BODIES]| {
            let (mut at, mut n) = ([0; BODIES], 0);
            for (body, path) in paths.iter().enumerate() {
                at[body] = n;
                n += path.as_ref().map_or(0, |p| p.points.len() * rig.own_of(body));
            }
            (at, n)
        };
        let own = start.of.iter().map(layout).collect();
        (PathProblem { rig, stretches, interval_s, own }, start)
    }

    /// A body at the exposure of a blob.
    fn moving(
        &self,
        state: &Paths,
        block: usize,
        instant: usize,
        seen: &MarkerObservation,
    ) -> Option<Moving> {
        let path = state.of[block][seen.body].as_ref()?;
        let frame_s = since_s(self.rig.instants[instant].exposed_ns, self.stretches[block].begin_ns);
        Some(path.at(frame_s + seen.dt_s - state.rig.late_s[seen.camera], self.interval_s))
    }

    /// Adds the equation of a blob; false where it lies behind its camera.
    fn add_blob(
        &self,
        state: &Paths,
        (block, instant, blob): (usize, usize, usize),
        own: &[usize; BODIES],
        columns: &mut Vec<Column<2>>,
        out: &mut NormalEquations,
    ) -> bool {
        let seen = &self.rig.instants[instant].seen[blob];
        let Some(moving) = self.moving(state, block, instant, seen) else { return true };
        let wanted = (!out.cost_only()).then_some(&mut *columns);
        let body = (&moving.pose, &moving.motion);
        let Some((residual, by_pose)) = self.rig.residual(&state.rig, (instant, blob), body, wanted) else {
            return false;
        };
        if !out.cost_only() {
            let by_point = by_control_point(&by_pose, &moving.by_vector);
            let dof = self.rig.own_of(seen.body);
            for (j, weight) in moving.weights.iter().enumerate() {
                let first = own[seen.body] + (moving.first + j) * dof;
                let slopes = by_point.column_iter().take(dof).enumerate();
                columns.extend(slopes.map(|(i, s)| (Unknown::Own(first + i), Vector2::from(s) * *weight)));
            }
        }
        out.add(&residual, columns, Loss::Cauchy(SUSPECT));
        true
    }

    /// Adds what bends a path.
    fn add_bends(&self, path: &Path, first: usize, dof: usize, out: &mut NormalEquations) {
        for (at, points) in path.points.windows(4).enumerate() {
            for i in 0..dof {
                let (sigma, of) = if i < 3 { (BEND.0, 0) } else { (BEND.1, 1) };
                let value = |p: &[Vector3<f64>; 2]| p[of][i % 3];
                let [a, b, c, d] = [0, 1, 2, 3].map(|j| value(&points[j]));
                let off = d - a + 3.0 * (b - c);
                let column = |(j, weight): (usize, f64)| {
                    (Unknown::Own(first + (at + j) * dof + i), Matrix1::new(weight / sigma))
                };
                let columns = [(0, -1.0), (1, 3.0), (2, -3.0), (3, 1.0)].map(column);
                out.add(&Matrix1::new(off / sigma), &columns, Loss::Square);
            }
        }
    }

    /// Residuals (seen less computed); `sheet` is the instant.
    pub fn residuals(&self, state: &Paths) -> Vec<Residual> {
        let mut residuals = Vec::new();
        for (block, stretch) in self.stretches.iter().enumerate() {
            for sheet in stretch.instants.clone() {
                let residual = |seen: &MarkerObservation| {
                    let moving = self.moving(state, block, sheet, seen)?;
                    let error = seen.pixel - state.rig.image(&moving.pose, seen)?.pixel;
                    Some(Residual { camera: seen.camera, sheet, pixel: seen.pixel, error })
                };
                residuals.extend(self.rig.instants[sheet].seen.iter().filter_map(residual));
            }
        }
        residuals
    }
}

impl Problem for PathProblem<'_> {
    type State = Paths;

    fn shared(&self) -> usize {
        self.rig.shared()
    }

    fn name(&self, shared: usize) -> String {
        self.rig.name(shared)
    }

    fn near_enough(&self) -> f64 {
        self.rig.near_enough()
    }

    fn most_steps(&self) -> usize {
        self.rig.most_steps()
    }

    fn blocks(&self) -> usize {
        self.stretches.len()
    }

    fn own(&self, block: usize) -> usize {
        self.own[block].1
    }

    fn equations(&self, state: &Paths, block: usize, out: &mut NormalEquations) {
        let (own, _) = self.own[block];
        let mut columns = Vec::with_capacity(64);
        for instant in self.stretches[block].instants.clone() {
            for blob in 0..self.rig.instants[instant].seen.len() {
                if !self.add_blob(state, (block, instant, blob), &own, &mut columns, out) {
                    out.refuse();
                }
            }
        }
        for (body, path) in state.of[block].iter().enumerate() {
            if let Some(path) = path {
                self.add_bends(path, own[body], self.rig.own_of(body), out);
            }
        }
    }

    fn prior(&self, state: &Paths, out: &mut NormalEquations) {
        self.rig.prior(&state.rig, out);
    }

    fn moved(&self, state: &Paths, shared: &DVector<f64>, own: &[DVector<f64>]) -> Paths {
        let mut next = Paths { rig: self.rig.moved_rig(&state.rig, shared), of: state.of.clone() };
        for (block, (paths, step)) in next.of.iter_mut().zip(own).enumerate() {
            let (first, _) = self.own[block];
            for (body, path) in paths.iter_mut().enumerate() {
                let Some(path) = path else { continue };
                let dof = self.rig.own_of(body);
                for (point, step) in path.points.iter_mut().zip(step.as_slice()[first[body]..].chunks(dof)) {
                    step.iter().enumerate().for_each(|(i, change)| point[i / 3][i % 3] += change);
                }
            }
        }
        next
    }
}
