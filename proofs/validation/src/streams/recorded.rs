//! Movement as another generator wrote it: a table of poses, and the spectra that follow from it.

use super::motion::{Held, Placed, Spectra};
use super::spectrum::bands;
use anyhow::Context;
use nalgebra::{Isometry3, Quaternion, Translation3, UnitQuaternion, Vector3};
use protocol::limits::{BODIES, INSTRUMENTS};
use protocol::poses::{BODY_NAMES, EYE};
use rig::Rig;
use std::path::Path;

/// Step of the samples that spectra are estimated from, s.
const STEP_S: f64 = 0.03;
/// Time beside an absence in which an instrument is taken out or put in, s: no part of what spectra describe.
const MOVED_OUT_S: f64 = 1.0;
/// Share of the presence of an instrument from which on it counts as in the eye.
const PRESENT: f64 = 0.999;

/// Truth of a stream as a table in the order of time.
#[derive(Debug, Clone)]
pub struct Recorded {
    t_s: Vec<f64>,
    placed: Vec<Placed>,
    trocars: [Vector3<f64>; INSTRUMENTS],
    pub(super) spectra: [Spectra; INSTRUMENTS],
}

impl Recorded {
    /// Reads `truth.csv` of the tracker streams: instants in ns, and of each body the position of its tip in mm (the
    /// eye's is the origin), its orientation and, of instruments, whether they are in the eye.
    ///
    /// # Errors
    /// If the file cannot be read, or a column or number is missing.
    pub(super) fn read(path: &Path, rig: &Rig) -> anyhow::Result<Self> {
        let text = std::fs::read_to_string(path).with_context(|| path.display().to_string())?;
        let mut lines = text.lines();
        let head: Vec<&str> = lines.next().context("no first line")?.split(',').collect();
        let rows: Option<Vec<(f64, Placed)>> = lines.map(|line| placed(&head, line)).collect();
        Ok(Self::of(rows.with_context(|| format!("{}: not a table of poses", path.display()))?, rig))
    }

    /// Of a table with equal steps.
    pub(super) fn of(rows: Vec<(f64, Placed)>, rig: &Rig) -> Self {
        let (t_s, placed) = rows.into_iter().unzip();
        let trocar = |i: usize| rig.trocar(BODY_NAMES[i]).map_or(Vector3::zeros(), |t| t.p_eye.into());
        let still = || Spectra { tip: Vec::new(), play: Vec::new(), roll: Vec::new() };
        let mut recorded = Recorded {
            t_s,
            placed,
            trocars: std::array::from_fn(trocar),
            spectra: std::array::from_fn(|_| still()),
        };
        recorded.spectra = std::array::from_fn(|i| recorded.estimated(i));
        recorded
    }

    /// Last instant, s.
    pub(super) fn end_s(&self) -> f64 {
        self.t_s.last().copied().unwrap_or(0.0)
    }

    pub(super) fn spectra(&self, instrument: usize) -> &Spectra {
        &self.spectra[instrument]
    }

    pub(super) fn held(&self, instrument: usize, t_s: f64) -> Held {
        let Placed { bodies, .. } = self.at(t_s);
        Held::of_pose(&bodies[instrument], &(bodies[EYE].rotation * self.trocars[instrument]))
    }

    /// Everything at an instant, between two rows or at the nearest one.
    pub(super) fn at(&self, t_s: f64) -> Placed {
        let next = self.t_s.partition_point(|t| *t <= t_s).clamp(1, self.t_s.len() - 1);
        let (a, b) = (&self.placed[next - 1], &self.placed[next]);
        let share = ((t_s - self.t_s[next - 1]) / (self.t_s[next] - self.t_s[next - 1])).clamp(0.0, 1.0);
        Placed {
            bodies: std::array::from_fn(|i| a.bodies[i].lerp_slerp(&b.bodies[i], share)),
            present: std::array::from_fn(|i| a.present[i] && b.present[i]),
        }
    }

    /// Spectra of an instrument, from the time in which it is in the eye and stays there.
    fn estimated(&self, instrument: usize) -> Spectra {
        let [from, to] = self.longest_stay_s(instrument);
        let count = ((to - from) / STEP_S) as usize;
        let mut signals = vec![Vec::new(); 7];
        for n in 0..count {
            let t_s = from + n as f64 * STEP_S;
            let held = self.held(instrument, t_s);
            let play = held.pivot - self.at(t_s).bodies[EYE].rotation * self.trocars[instrument];
            let before = signals[6].last().copied().unwrap_or(held.roll);
            let turn = (held.roll - before + std::f64::consts::PI).rem_euclid(std::f64::consts::TAU);
            let roll = before + turn - std::f64::consts::PI;
            let all = held.tip.iter().chain(&play).copied().chain([roll]);
            signals.iter_mut().zip(all).for_each(|(signal, value)| signal.push(value));
        }
        let of = |signals: &[Vec<f64>]| bands(signals, STEP_S);
        Spectra { tip: of(&signals[..3]), play: of(&signals[3..6]), roll: of(&signals[6..]) }
    }

    /// Begin and end of the longest time in the eye, without what is near an absence.
    fn longest_stay_s(&self, instrument: usize) -> [f64; 2] {
        let rows = self.t_s.iter().zip(self.placed.iter().map(|p| p.present[instrument]));
        let (mut longest, mut begin) = ([0.0, 0.0], None);
        let first = self.t_s.first().copied().unwrap_or(0.0);
        let mut close = |begin: Option<f64>, end: f64| {
            let Some(begin) = begin else { return };
            let begin = if begin > first { begin + MOVED_OUT_S } else { begin };
            let end = if end < self.end_s() { end - MOVED_OUT_S } else { end };
            if end - begin > longest[1] - longest[0] {
                longest = [begin, end];
            }
        };
        for (t_s, present) in rows {
            match (begin, present) {
                (None, true) => begin = Some(*t_s),
                (Some(_), false) => close(begin.take(), *t_s),
                _ => {}
            }
        }
        close(begin, self.end_s());
        longest
    }
}

/// A row of the table.
fn placed(head: &[&str], line: &str) -> Option<(f64, Placed)> {
    let values: Option<Vec<f64>> = line.split(',').map(|v| v.parse().ok()).collect();
    let values = values?;
    let at = |name: String| values.get(head.iter().position(|h| *h == name)?).copied();
    let mut placed = Placed { bodies: [Isometry3::identity(); BODIES], present: [true; BODIES] };
    // Two instruments and the eye, by the names of the exchange format.
    for (body, name) in BODY_NAMES.iter().enumerate() {
        let of = |what: &str| at(format!("{name}_{what}"));
        let rotation = Quaternion::new(of("qw")?, of("qx")?, of("qy")?, of("qz")?);
        let mut tip = Vector3::zeros();
        if body != EYE {
            tip = Vector3::new(of("x")?, of("y")?, of("z")?);
            placed.present[body] = of("present")? > PRESENT;
        }
        let rotation = UnitQuaternion::from_quaternion(rotation);
        placed.bodies[body] = Isometry3::from_parts(Translation3::from(tip), rotation);
    }
    Some((at("t_ns".into())? * 1e-9, placed))
}
