//! Sums over the samples and events of an attempt, for its score. A pure function of
//! their sequence; the simulation runs it live, the launcher over recordings, with the same bits.

use super::filter::{Band, NOISE_SHARE, TipFilter};
use super::table::{
    INJURIES, Injury, LIGHT_HALF_ANGLE_RAD, LIGHT_MW, MACULA_MM, NEAR_RETINA_MM, NEAREST_LIGHT_MM, SIGMAS,
    injury_of,
};
use crate::sample::{Sample, Tip};
use nalgebra::Vector3;
use protocol::events::{Event, EventKind};
use protocol::handles::Tool;
use protocol::limits::{INSTRUMENTS, MAX_STEP_NS};
use protocol::time::Nanos;
use scene::{Goal, MAX_GOALS, SceneFile, TaskScene};
use serde::{Deserialize, Serialize};

/// Tears and pulls raise events repeatedly while they last, a hand that trembles touches again and
/// again; what comes within this time is the same injury, ns.
const ONCE_NS: u64 = 1_000_000_000;
/// A detached retina is pressed onto its place by the jaws that hold it: up to this depth that is
/// work, mm.
const PRESSED_MM: f64 = 0.1;
/// Contacts nearer to each other than this are at one place, mm.
const SAME_PLACE_MM: f64 = 0.5;

/// What a score must know of a scene.
#[derive(Debug, Clone)]
pub struct Scorer {
    pub(super) task: TaskScene,
    band: Band,
    radius_mm: f64,
    touch_mm: f64,
    /// Depth to which jaws may press a retina that they hold onto its place, mm.
    press_mm: f64,
    /// Instrument 1 begins with a light pipe.
    pub(super) lit: bool,
    /// The hands that do the task: what they hold does what the goals ask for.
    pub(super) at_task: [bool; INSTRUMENTS],
}

/// Sums over one instrument.
#[derive(Debug, Clone, Copy, Default, PartialEq, Serialize, Deserialize)]
pub(super) struct InstrumentStats {
    filter: TipFilter,
    pub way_mm: f64,
    pub fastest_mm_s: f64,
    pub fastest_near_mm_s: f64,
    /// Sum of squares in the tremor's band and of what noise puts there, mm²; samples.
    pub tremor_mm2: f64,
    pub noise_mm2: f64,
    pub tremor_samples: u32,
    /// Contact with the retina that lasts.
    contact: Option<Contact>,
    /// Its jaws hold tissue, or its needle is in the retina: what touches then is work.
    at_work: bool,
    /// End of the last contact; where the last that counts was, mm, and whether it went in.
    contact_end_ns: Nanos,
    counted_at: Vector3<f64>,
    counted_inside: bool,
}

/// A contact with the retina.
#[derive(Debug, Clone, Copy, PartialEq, Serialize, Deserialize)]
struct Contact {
    /// Deepest beyond the clearance that counts as touching, in deviations.
    sigmas: f64,
    /// Deepest beyond the retina itself, in deviations.
    inside_sigmas: f64,
    /// Where it went into the retina, if it did: in the macula.
    macula: bool,
    /// Where it was reported last, mm.
    at: Vector3<f64>,
}

/// Injuries of a kind.
#[derive(Debug, Clone, Copy, Default, PartialEq, Serialize, Deserialize)]
pub struct Tally {
    /// How many count.
    pub count: u32,
    /// Sum of p(1 − p), where p is the probability that it happened.
    pub variance: f64,
    /// Last that counted.
    last_ns: Nanos,
}

/// What is kept.
#[derive(Debug, Clone, Default, PartialEq, Serialize, Deserialize)]
pub struct Meter {
    pub(super) begun_ns: Nanos,
    pub(super) last_ns: Nanos,
    pub(super) ended: bool,
    pub(super) finished: bool,
    /// Share of each goal that is done; 1 for those that are reached.
    pub(super) done: [f64; MAX_GOALS],
    /// Sum of distances as shares of radii, of their variances, and how many.
    pub(super) missed: f64,
    pub(super) missed_variance: f64,
    pub(super) missed_count: u32,
    pub(super) off_path_s: f64,
    off_path_ns: Nanos,
    pub(super) out_of_view_s: f64,
    out_ns: [Nanos; INSTRUMENTS],
    pub(super) slips: u32,
    pub(super) seen_s: f64,
    pub(super) unlit_s: f64,
    pub(super) dose_mj_mm2: f64,
    pub(super) instruments: [InstrumentStats; INSTRUMENTS],
    pub(super) injuries: [Tally; INJURIES],
}

impl Scorer {
    /// For the task of a scene, if it has one.
    pub fn of(scene: &SceneFile) -> Option<Self> {
        Some(Scorer {
            task: scene.task.clone()?,
            band: Band::default(),
            radius_mm: scene.eye.retina_radius_mm,
            touch_mm: scene.contact.touch_mm,
            press_mm: if scene.retina.is_some() { PRESSED_MM } else { 0.0 },
            lit: scene.instruments.get(1).is_some_and(|i| i.tool == Tool::LightPipe),
            at_task: at_task(scene),
        })
    }

    /// Before the attempt.
    pub fn start(&self) -> Meter {
        Meter::default()
    }

    /// Takes a step in. Nothing counts before event 110 and after event 112 or 113.
    pub fn note(&self, meter: &mut Meter, sample: &Sample) {
        if meter.ended {
            return;
        }
        let starts = |e: &Event| e.kind == EventKind::TaskStarted as u32;
        if meter.begun_ns == 0 {
            if !sample.events.iter().any(starts) {
                return;
            }
            (meter.begun_ns, meter.last_ns) = (sample.exposed_ns, sample.exposed_ns);
        }
        let gap_ns = sample.exposed_ns.saturating_sub(meter.last_ns);
        meter.last_ns = sample.exposed_ns;
        if gap_ns > MAX_STEP_NS {
            meter.skip_gap(gap_ns);
        }
        let dt_s = if gap_ns > MAX_STEP_NS { 0.0 } else { gap_ns as f64 * 1e-9 };
        for (hand, tip) in meter.instruments.iter_mut().zip(&sample.tips) {
            self.note_tip(hand, tip.as_ref(), sample.exposed_ns);
        }
        self.note_light(meter, &sample.tips, dt_s);
        for event in sample.events {
            self.note_event(meter, event, &sample.tips);
        }
        if meter.ended {
            self.close(meter);
        }
    }

    fn note_tip(&self, hand: &mut InstrumentStats, tip: Option<&Tip>, at_ns: Nanos) {
        let Some(tip) = tip else { return hand.filter.lose() };
        let clearance = self.radius_mm - tip.tip_in_eye_mm.norm();
        // At work the retina is not where the sphere is: then only the simulation knows how deep a
        // tip is.
        if let Some(contact) = hand.contact.as_mut().filter(|_| !hand.at_work) {
            contact.deepen(self.touch_mm, -clearance, tip);
        }
        hand.filter.pass(&self.band, &tip.tip_in_eye_mm, at_ns, |moved| {
            hand.way_mm += moved.way_mm;
            hand.fastest_mm_s = larger(hand.fastest_mm_s, moved.speed_mm_s);
            if clearance < NEAR_RETINA_MM {
                hand.fastest_near_mm_s = larger(hand.fastest_near_mm_s, moved.speed_mm_s);
            }
            if let Some(shake) = moved.tremor_mm {
                hand.tremor_mm2 += shake.norm_squared();
                hand.noise_mm2 += tip.covariance_mm2.trace() * NOISE_SHARE;
                hand.tremor_samples += 1;
            }
        });
    }

    /// Whether the light falls on the working tip, and what it does to the retina.
    fn note_light(&self, meter: &mut Meter, tips: &[Option<Tip>; INSTRUMENTS], dt_s: f64) {
        let (true, [_, Some(pipe)]) = (self.lit, tips) else { return };
        let shines = -pipe.to_handle;
        // The retina lies where the ray from inside meets the sphere.
        let (p, r) = (pipe.tip_in_eye_mm, self.radius_mm);
        let along = p.dot(&shines);
        let under = along * along - (p.norm_squared() - r * r);
        if p.norm() < r && under > 0.0 {
            let distance = larger(libm::sqrt(under) - along, NEAREST_LIGHT_MM);
            let spot = distance * libm::tan(LIGHT_HALF_ANGLE_RAD);
            meter.dose_mj_mm2 += LIGHT_MW / (std::f64::consts::PI * spot * spot) * dt_s;
        }
        if let Some(tip) = tips[0] {
            meter.seen_s += dt_s;
            let to_tip = tip.tip_in_eye_mm - p;
            if to_tip.dot(&shines) < to_tip.norm() * libm::cos(LIGHT_HALF_ANGLE_RAD) {
                meter.unlit_s += dt_s;
            }
        }
    }

    fn note_event(&self, meter: &mut Meter, event: &Event, tips: &[Option<Tip>; INSTRUMENTS]) {
        let Some(kind) = EventKind::from_wire(event.kind) else { return };
        let hand = (event.instrument as usize).min(INSTRUMENTS - 1);
        match kind {
            EventKind::GoalReached => self.note_goal(meter, event, tips),
            EventKind::GoalProgress => meter.note_done(event.subject, event.value),
            EventKind::TaskFinished => (meter.ended, meter.finished) = (true, true),
            EventKind::TaskTimedOut => meter.ended = true,
            EventKind::PathLeft => meter.off_path_ns = event.exposed_ns,
            EventKind::PathRegained => {
                meter.off_path_s += event.value;
                meter.off_path_ns = 0;
            }
            EventKind::TipOutOfView => meter.out_ns[hand] = event.exposed_ns,
            EventKind::TipInView => {
                meter.out_of_view_s += event.value;
                meter.out_ns[hand] = 0;
            }
            EventKind::GripSlipped => {
                meter.slips += 1;
                meter.instruments[hand].at_work = false;
            }
            EventKind::RetinaTouched | EventKind::RetinaPenetrated => {
                self.note_contact(meter, hand, event, tips)
            }
            EventKind::RetinaLeft => end_contact(meter, hand),
            EventKind::TissueGrabbed | EventKind::RetinaPierced => begin_work(meter, hand),
            EventKind::TissueReleased | EventKind::BlebFilled => meter.instruments[hand].at_work = false,
            _ => {}
        }
        match injury_of(kind) {
            Some(Injury::Lens) => {
                let tip = tips[hand].as_ref();
                let sigma = tip.map_or(0.0, |t| t.sigma_along_mm(&Vector3::z()));
                let sigmas = in_sigmas(event.value, sigma);
                meter.injuries[Injury::Lens as usize].add(sigmas, event.exposed_ns);
            }
            Some(injury) => {
                let tally = &mut meter.injuries[injury as usize];
                if tally.last_ns == 0 || event.exposed_ns >= tally.last_ns + ONCE_NS {
                    tally.add(f64::INFINITY, event.exposed_ns);
                } else if injury == Injury::Pull {
                    // A pull that goes on is one.
                    tally.last_ns = event.exposed_ns;
                }
            }
            None => {}
        }
    }

    fn note_goal(&self, meter: &mut Meter, event: &Event, tips: &[Option<Tip>; INSTRUMENTS]) {
        meter.note_done(event.subject, 1.0);
        let Some(goal) = self.task.goals.get(event.subject as usize) else { return };
        let Some(radius_mm) = goal.radius_mm() else { return };
        let hand = goal.instrument().unwrap_or(0) as usize;
        let variance = tips[hand].map_or(0.0, |t| t.covariance_mm2.trace());
        meter.missed += event.value / radius_mm;
        meter.missed_variance += variance / (radius_mm * radius_mm);
        meter.missed_count += 1;
    }

    fn note_contact(&self, meter: &mut Meter, hand: usize, event: &Event, tips: &[Option<Tip>; INSTRUMENTS]) {
        let inside = event.kind == EventKind::RetinaPenetrated as u32;
        if !inside {
            end_contact(meter, hand);
        }
        let at = Vector3::from(event.position_in_eye_mm);
        let fovea = Vector3::new(0.0, 0.0, -self.radius_mm);
        let pressed_mm = if meter.instruments[hand].at_work { self.press_mm } else { 0.0 };
        let depth_mm = if inside { event.value - pressed_mm } else { -event.value };
        let fresh = Contact { sigmas: 0.0, inside_sigmas: 0.0, macula: false, at };
        let contact = meter.instruments[hand].contact.get_or_insert(fresh);
        contact.at = at;
        contact.macula |= inside && (at - fovea).norm() < MACULA_MM;
        if let Some(tip) = &tips[hand] {
            contact.deepen(self.touch_mm, depth_mm, tip);
        }
    }

    /// Ends what still lasts when the attempt ends.
    fn close(&self, meter: &mut Meter) {
        let since = |begin: Nanos| meter.last_ns.saturating_sub(begin) as f64 * 1e-9;
        if meter.off_path_ns > 0 {
            meter.off_path_s += since(meter.off_path_ns);
        }
        meter.out_of_view_s += meter.out_ns.iter().filter(|t| **t > 0).map(|t| since(*t)).sum::<f64>();
        (meter.off_path_ns, meter.out_ns) = (0, [0; INSTRUMENTS]);
        (0..INSTRUMENTS).for_each(|hand| end_contact(meter, hand));
    }

    /// The meter as if the attempt ended now.
    pub fn closed(&self, meter: &Meter) -> Meter {
        let mut closed = meter.clone();
        if !closed.ended {
            self.close(&mut closed);
        }
        closed
    }
}

impl Meter {
    /// True once the attempt has ended.
    pub fn has_ended(&self) -> bool {
        self.ended
    }

    fn note_done(&mut self, goal: u32, share: f64) {
        if let Some(done) = self.done.get_mut(goal as usize) {
            *done = larger(*done, share).min(1.0);
        }
    }

    /// A pause, or another gap long enough that the simulation stood still: it is no part of the
    /// attempt.
    fn skip_gap(&mut self, gap_ns: u64) {
        let clocks = self.out_ns.iter_mut().chain([&mut self.begun_ns, &mut self.off_path_ns]);
        clocks.filter(|since| **since > 0).for_each(|since| *since += gap_ns);
    }

    /// Time of the attempt so far, s.
    pub fn elapsed_s(&self) -> f64 {
        self.last_ns.saturating_sub(self.begun_ns) as f64 * 1e-9
    }

    /// Injuries of each kind, by [`Injury`].
    pub fn injuries(&self) -> &[Tally; INJURIES] {
        &self.injuries
    }

    /// True if its numbers are finite: for checkpoints.
    pub fn is_sound(&self) -> bool {
        let hands = self.instruments.iter().all(|h| {
            let sums = [h.way_mm, h.fastest_mm_s, h.fastest_near_mm_s, h.tremor_mm2, h.noise_mm2];
            h.filter.is_sound() && sums.iter().all(|s| s.is_finite())
        });
        let sums = [self.missed, self.missed_variance, self.off_path_s, self.out_of_view_s, self.dose_mj_mm2];
        hands && sums.iter().chain(&self.done).all(|s| s.is_finite())
    }
}

impl Contact {
    /// The tip is so deep in the retina, or by so little above it where that is below 0; contact
    /// begins `touch_mm` above it.
    fn deepen(&mut self, touch_mm: f64, depth_mm: f64, tip: &Tip) {
        let outwards = tip.tip_in_eye_mm.try_normalize(1e-6).unwrap_or(-Vector3::z());
        let sigma = tip.sigma_along_mm(&outwards);
        self.sigmas = larger(self.sigmas, in_sigmas(touch_mm + depth_mm, sigma));
        self.inside_sigmas = larger(self.inside_sigmas, in_sigmas(depth_mm, sigma));
    }

    /// It went into the retina, beyond tracking noise.
    fn is_inside(&self) -> bool {
        self.inside_sigmas >= SIGMAS
    }
}

impl Tally {
    /// Adds one that is `sigmas` deviations beyond its limit; it counts from [`SIGMAS`] on.
    fn add(&mut self, sigmas: f64, at_ns: Nanos) {
        if sigmas >= SIGMAS {
            self.count += 1;
            self.last_ns = at_ns;
        }
        if sigmas.is_finite() {
            let p = 0.5 * (1.0 + libm::erf(sigmas * std::f64::consts::FRAC_1_SQRT_2));
            self.variance += p * (1.0 - p);
        }
    }
}

/// The hands that do a scene's task. A goal that names an instrument is for its hand, one that aligns
/// both tips for both, and any other for the hands that do not begin with a light pipe: a hand that
/// only lights may rest, or be led by a script beside a person's.
fn at_task(scene: &SceneFile) -> [bool; INSTRUMENTS] {
    let lights = |i: usize| scene.instruments.get(i).is_some_and(|own| own.tool == Tool::LightPipe);
    let tools: [bool; INSTRUMENTS] = std::array::from_fn(|i| !lights(i));
    let by_any = if tools.contains(&true) { tools } else { [true; INSTRUMENTS] };
    let goals = scene.task.iter().flat_map(|task| &task.goals);
    let of_goal = |goal: &Goal| match (goal, goal.instrument()) {
        (Goal::Align { .. }, _) => [true; INSTRUMENTS],
        (_, Some(hand)) => std::array::from_fn(|i| i == hand as usize),
        (_, None) => by_any,
    };
    goals.map(of_goal).fold([false; INSTRUMENTS], |all, own| std::array::from_fn(|i| all[i] || own[i]))
}

/// The touch by which jaws take hold, or through which a needle goes in, is work.
fn begin_work(meter: &mut Meter, hand: usize) {
    meter.instruments[hand].contact = None;
    meter.instruments[hand].at_work = true;
}

/// A contact counts when it has ended. A hand that trembles at one place of the retina makes one:
/// what comes within a second of the last there is the same, unless it goes in as the last did not.
fn end_contact(meter: &mut Meter, hand: usize) {
    let now = meter.last_ns;
    let own = &mut meter.instruments[hand];
    let Some(contact) = own.contact.take() else { return };
    if own.at_work && !contact.is_inside() {
        return;
    }
    let lasts = own.contact_end_ns > 0 && now < own.contact_end_ns + ONCE_NS;
    own.contact_end_ns = now;
    let same = lasts && (contact.at - own.counted_at).norm() < SAME_PLACE_MM;
    if same && (own.counted_inside || !contact.is_inside()) {
        return;
    }
    (own.counted_at, own.counted_inside) = (contact.at, contact.is_inside());
    let injury = match (contact.is_inside(), contact.macula) {
        (true, true) => Injury::Macula,
        (true, false) => Injury::Haemorrhage,
        (false, _) => Injury::Contact,
    };
    meter.injuries[injury as usize].add(contact.sigmas, meter.last_ns);
}

fn in_sigmas(beyond_mm: f64, sigma_mm: f64) -> f64 {
    if beyond_mm <= 0.0 {
        0.0
    } else if sigma_mm > 0.0 {
        beyond_mm / sigma_mm
    } else {
        f64::INFINITY
    }
}

/// The larger of two numbers; the first where the second is none.
pub(super) fn larger(a: f64, b: f64) -> f64 {
    if b > a { b } else { a }
}
