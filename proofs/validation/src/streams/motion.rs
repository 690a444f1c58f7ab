//! Where hands and eye are at every instant: sums of sines drawn from a seed, or read from a file.

use super::Scenario;
use super::recorded::Recorded;
use nalgebra::{Isometry3, Matrix3, Rotation3, Translation3, UnitQuaternion, Vector3};
use protocol::limits::{BODIES, INSTRUMENTS};
use protocol::poses::BODY_NAMES;
use protocol::random::Random;
use rig::Rig;
use std::f64::consts::TAU;

/// Truth of an instant.
#[derive(Debug, Clone, Copy)]
pub struct Placed {
    /// `world_from_body` of the instruments and the eye.
    pub bodies: [Isometry3<f64>; BODIES],
    /// False for an instrument that is out of the eye.
    pub present: [bool; BODIES],
}

/// A sum of sines.
#[derive(Debug, Clone)]
struct Waves(Vec<[f64; 3]>);

impl Waves {
    /// Frequencies in a band (Hz), with this root mean square together.
    fn draw(count: usize, band_hz: [f64; 2], rms: f64, random: &mut Random) -> Self {
        let amplitudes: Vec<f64> = (0..count).map(|_| random.between(0.4, 1.0)).collect();
        let power: f64 = amplitudes.iter().map(|a| 0.5 * a * a).sum();
        let scale = rms / libm::sqrt(power);
        let wave = |a: f64| [scale * a, TAU * random.between(band_hz[0], band_hz[1]), TAU * random.uniform()];
        Waves(amplitudes.into_iter().map(wave).collect())
    }

    /// The same with the nearest frequencies that fit a period, at least one of them.
    fn periodic(&mut self, period_s: f64) {
        let base = TAU / period_s;
        self.0.iter_mut().for_each(|[_, rate, _]| *rate = (*rate / base).round().max(1.0) * base);
    }

    fn at(&self, t_s: f64) -> f64 {
        self.0.iter().map(|[amplitude, rate, phase]| amplitude * libm::sin(rate * t_s + phase)).sum()
    }
}

fn vector(waves: &[Waves; 3], t_s: f64) -> Vector3<f64> {
    Vector3::from_fn(|i, _| waves[i].at(t_s))
}

/// What waves are drawn from.
#[derive(Debug, Clone, Copy)]
pub(super) struct Spectrum {
    /// Where their power lies evenly, Hz.
    pub band_hz: [f64; 2],
    /// Root mean square of an axis.
    pub rms: f64,
}

/// Spectra of a hand, each of every axis, as sums of bands.
#[derive(Debug, Clone)]
pub(super) struct Spectra {
    /// Of the tip, mm: what is wanted, and tremor.
    pub tip: Vec<Spectrum>,
    /// Of the point of the shaft in the trocar, mm.
    pub play: Vec<Spectrum>,
    /// Of the roll, rad.
    pub roll: Vec<Spectrum>,
}

/// What the pose of an instrument follows from, at an instant.
#[derive(Debug, Clone, Copy)]
pub(super) struct Held {
    /// Tip where it is not withdrawn, and point of the shaft in the trocar, mm.
    pub tip: Vector3<f64>,
    pub pivot: Vector3<f64>,
    /// Turn about the shaft, rad.
    pub roll: f64,
    /// From 0 to 1: out of the eye.
    out: f64,
}

impl Held {
    /// That of a pose whose shaft passes the trocar (at `trocar` in the world) at `pivot`, the nearest point to it.
    pub fn of_pose(pose: &Isometry3<f64>, trocar: &Vector3<f64>) -> Self {
        let tip = pose.translation.vector;
        let z = pose.rotation * Vector3::z();
        // Where the tip is out of the eye, any point of the shaft gives its direction.
        let depth = z.dot(&(trocar - tip)).max(AT_TROCAR_MM);
        let x = (Vector3::x() - z * z.x).normalize();
        let side = pose.rotation * Vector3::x();
        let roll = libm::atan2(side.dot(&z.cross(&x)), side.dot(&x));
        Held { tip, pivot: tip + z * depth, roll, out: 0.0 }
    }

    /// `world_from_body`, and whether the tip is in the eye.
    pub fn pose(&self) -> (Isometry3<f64>, bool) {
        let outward = self.pivot - self.tip;
        let z = outward.normalize();
        let x = (Vector3::x() - z * z.x).normalize();
        let turn = Rotation3::from_matrix_unchecked(Matrix3::from_columns(&[x, z.cross(&x), z]))
            * Rotation3::from_axis_angle(&Vector3::z_axis(), self.roll);
        let withdrawn = (outward.norm() + OUTSIDE_MM) * self.out;
        let pose = Isometry3::from_parts(
            Translation3::from(self.tip + z * withdrawn),
            UnitQuaternion::from_rotation_matrix(&turn),
        );
        (pose, withdrawn < outward.norm() - AT_TROCAR_MM)
    }
}

/// A hand with its instrument.
#[derive(Debug, Clone)]
struct Hand {
    spectra: Spectra,
    trocar: Vector3<f64>,
    centre: Vector3<f64>,
    wanted: [Waves; 3],
    tremor: [Waves; 3],
    play: [Waves; 3],
    roll: Waves,
    /// When it is taken out and put back, s.
    out_s: Option<[f64; 2]>,
}

/// Hands and eye that were drawn.
#[derive(Debug, Clone)]
pub struct Drawn {
    hands: [Hand; INSTRUMENTS],
    eye: [Waves; 3],
    period_s: Option<f64>,
}

/// Hands and eye.
#[derive(Debug, Clone)]
pub enum Motion {
    /// Drawn from a seed.
    Drawn(Box<Drawn>),
    /// As another generator wrote it.
    Recorded(Box<Recorded>),
}

/// Root mean square of what is wanted of a tip, an axis, mm.
const WANTED_MM: f64 = 1.9;
/// Band of a roll, Hz.
const ROLL_HZ: [f64; 2] = [0.06, 0.3];
/// Depth of a tip outside of the trocar, mm.
const OUTSIDE_MM: f64 = 4.0;
/// Time to take an instrument out or put it in, s.
const WITHDRAWN_S: f64 = 0.9;
/// Depth of a tip inside of the trocar above which it does not count as in the eye, mm: its markers are in
/// the trocar.
const AT_TROCAR_MM: f64 = 3.3;

impl Motion {
    /// Draws them.
    pub fn draw(scenario: Scenario, rig: &Rig, seconds: f64, seed: u64) -> Self {
        Motion::Drawn(Box::new(Drawn::draw(scenario, rig, seconds, seed)))
    }

    /// The same with the nearest frequencies that make it periodic; what was recorded stays as it is.
    pub fn periodic(self, period_s: f64) -> Self {
        match self {
            Motion::Drawn(drawn) => Motion::Drawn(Box::new(drawn.periodic(period_s))),
            Motion::Recorded(_) => self,
        }
    }

    /// True if it repeats.
    pub fn is_periodic(&self) -> bool {
        matches!(self, Motion::Drawn(drawn) if drawn.period_s.is_some())
    }

    /// What the pose of an instrument follows from, at an instant.
    pub(super) fn held(&self, instrument: usize, t_s: f64) -> Held {
        match self {
            Motion::Drawn(drawn) => drawn.held(instrument, t_s),
            Motion::Recorded(recorded) => recorded.held(instrument, t_s),
        }
    }

    /// What the motion of an instrument is drawn from.
    pub(super) fn spectra(&self, instrument: usize) -> &Spectra {
        match self {
            Motion::Drawn(drawn) => &drawn.hands[instrument].spectra,
            Motion::Recorded(recorded) => recorded.spectra(instrument),
        }
    }

    /// When an instrument begins to be taken out and to be put back, s; `None` of one that stays, or was recorded.
    pub fn taken_out_s(&self, instrument: usize) -> Option<[f64; 2]> {
        match self {
            Motion::Drawn(drawn) => drawn.hands[instrument].out_s,
            Motion::Recorded(_) => None,
        }
    }

    /// Everything at an instant.
    pub fn at(&self, t_s: f64) -> Placed {
        match self {
            Motion::Drawn(drawn) => drawn.at(t_s),
            Motion::Recorded(recorded) => recorded.at(t_s),
        }
    }
}

impl Drawn {
    fn draw(scenario: Scenario, rig: &Rig, seconds: f64, seed: u64) -> Self {
        let random = &mut Random::new(seed, 0);
        let moves = if scenario == Scenario::Rest { 0.0 } else { 1.0 };
        let eye = std::array::from_fn(|i| {
            Waves::draw(3, [0.05, 0.22], moves * if i == 2 { 0.03 } else { 0.11 }, random)
        });
        let out_at = random.between(0.25, 0.7) * seconds;
        let out_for = random.between(1.4, 2.4);
        let taken_out = random.below(INSTRUMENTS);
        let hands = std::array::from_fn(|i| {
            let mut hand = Hand::draw(scenario, rig, i, random);
            hand.out_s = match scenario {
                Scenario::Hard => Some([out_at, out_at + out_for]),
                Scenario::Withdrawn => Some([0.4 * seconds, 0.73 * seconds]),
                _ => None,
            };
            hand.out_s = hand.out_s.filter(|_| taken_out == i);
            hand
        });
        Drawn { hands, eye, period_s: None }
    }

    fn periodic(mut self, period_s: f64) -> Self {
        let hands = self.hands.iter_mut().flat_map(Hand::waves);
        hands.chain(&mut self.eye).for_each(|waves| waves.periodic(period_s));
        Drawn { period_s: Some(period_s), ..self }
    }

    fn held(&self, instrument: usize, t_s: f64) -> Held {
        self.hands[instrument].at(&Rotation3::new(vector(&self.eye, t_s)), t_s)
    }

    fn at(&self, t_s: f64) -> Placed {
        let t_s = self.period_s.map_or(t_s, |period| t_s.rem_euclid(period));
        let eye = Rotation3::new(vector(&self.eye, t_s));
        let mut placed = Placed { bodies: [Isometry3::identity(); BODIES], present: [true; BODIES] };
        for (i, hand) in self.hands.iter().enumerate() {
            (placed.bodies[i], placed.present[i]) = hand.at(&eye, t_s).pose();
        }
        placed.bodies[INSTRUMENTS].rotation = UnitQuaternion::from_rotation_matrix(&eye);
        placed
    }
}

impl Hand {
    fn draw(scenario: Scenario, rig: &Rig, i: usize, random: &mut Random) -> Self {
        let (band, tremor_mm) = match scenario {
            Scenario::Nominal | Scenario::Async | Scenario::Withdrawn => ([8.0, 12.0], 0.037),
            Scenario::Rest => ([8.0, 12.0], 0.0),
            Scenario::Tremor => ([6.0, 14.0], 0.065),
            Scenario::Hard => ([8.0, 12.0], 0.065),
        };
        let side = if i == 0 { 1.0 } else { -1.0 };
        let trocar = rig.trocar(BODY_NAMES[i]).map_or([8.0 * side, 4.5, 7.9], |t| t.p_eye);
        let sigma = rig.trocar(BODY_NAMES[i]).map_or(0.05, |t| t.sigma);
        let moves = if scenario == Scenario::Rest { 0.0 } else { 1.0 };
        let three = |count, band, rms: f64, random: &mut Random| {
            std::array::from_fn(|_| Waves::draw(count, band, rms, random))
        };
        let (wanted, play) = ([0.06, 0.45], [0.1, 0.7]);
        let spectrum = |band_hz, rms| Spectrum { band_hz, rms };
        let mut hand = Hand {
            spectra: Spectra {
                tip: vec![spectrum(wanted, WANTED_MM * moves), spectrum(band, tremor_mm)],
                play: vec![spectrum(play, moves * sigma / 1.5)],
                roll: Vec::new(),
            },
            trocar: trocar.into(),
            centre: Vector3::new(
                side * random.between(0.5, 2.0),
                random.between(-1.0, 2.0),
                random.between(-5.0, -3.0),
            ),
            wanted: three(4, wanted, WANTED_MM * moves, random),
            tremor: three(24, band, tremor_mm, random),
            play: three(3, play, moves * sigma / 1.5, random),
            roll: Waves(Vec::new()),
            out_s: None,
        };
        let roll_rad = moves * random.between(0.3, 0.6);
        hand.spectra.roll = vec![spectrum(ROLL_HZ, roll_rad)];
        hand.roll = Waves::draw(3, ROLL_HZ, roll_rad, random);
        hand
    }

    fn waves(&mut self) -> impl Iterator<Item = &mut Waves> {
        let vectors = self.wanted.iter_mut().chain(&mut self.tremor).chain(&mut self.play);
        vectors.chain([&mut self.roll])
    }

    fn at(&self, eye: &Rotation3<f64>, t_s: f64) -> Held {
        let out = self.out_s.map_or(0.0, |[from, to]| {
            smooth((t_s - from) / WITHDRAWN_S).min(1.0 - smooth((t_s - to) / WITHDRAWN_S))
        });
        Held {
            tip: self.centre + vector(&self.wanted, t_s) + vector(&self.tremor, t_s),
            pivot: eye * self.trocar + vector(&self.play, t_s),
            roll: self.roll.at(t_s),
            out,
        }
    }
}

/// From 0 to 1 with a continuous acceleration.
fn smooth(x: f64) -> f64 {
    let x = x.clamp(0.0, 1.0);
    x * x * x * (10.0 - x * (15.0 - 6.0 * x))
}
