//! The table of the score: every category, metric, weight, threshold and penalty, in one place.
//! `docs/score.md` is made from it, and the code has no other.

use protocol::events::EventKind;

/// Version of the score. Whoever changes a formula, weight, threshold or penalty counts it up.
pub const VERSION: u32 = 5;

/// What is judged: the five categories that studies of the commercial device report (Vergmann et
/// al. 2016, Acta Ophthalmologica, doi 10.1111/aos.13209).
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
#[repr(u32)]
#[allow(missing_docs)]
pub enum Category {
    Target = 0,
    Efficiency = 1,
    Instruments = 2,
    Microscope = 3,
    Tissue = 4,
}

/// Categories.
pub const CATEGORIES: usize = 5;

impl Category {
    /// Every one, by number.
    pub const ALL: [Category; CATEGORIES] = {
        use Category::*;
        [Target, Efficiency, Instruments, Microscope, Tissue]
    };

    /// Name for people.
    pub fn name(self) -> &'static str {
        ["target achievement", "efficiency", "instrument handling", "microscope handling", "tissue treatment"]
            [self as usize]
    }

    /// Name for programs.
    pub fn key(self) -> &'static str {
        ["target", "efficiency", "instruments", "microscope", "tissue"][self as usize]
    }

    /// Most points.
    pub fn points(self) -> f64 {
        METRICS.iter().filter(|m| m.category == self).map(|m| m.points).sum()
    }
}

/// A metric: a figure of the attempt and the points that it brings. Between the two thresholds
/// points fall in a straight line.
#[derive(Debug, Clone, Copy)]
pub struct Metric {
    /// Name for programs.
    pub key: &'static str,
    /// Name for people.
    pub name: &'static str,
    /// Where it counts.
    pub category: Category,
    /// Unit of the figure.
    pub unit: &'static str,
    /// Most points.
    pub points: f64,
    /// Figure from which on all points are given.
    pub full_at: f64,
    /// Figure from which on none are.
    pub none_at: f64,
    /// How the figure is computed.
    pub formula: &'static str,
}

/// Tips within this distance of the retina are near it, mm.
pub const NEAR_RETINA_MM: f64 = 1.0;
/// Half angle of the light pipe's cone within which a tip is lit, rad.
pub const LIGHT_HALF_ANGLE_RAD: f64 = 0.6;
/// Light that leaves the pipe, mW: light sources for surgery give 5 to 20 through a 25-gauge fibre.
pub const LIGHT_MW: f64 = 10.0;
/// Nearest distance of the light pipe from the retina that is believed, mm: its cone ends on it.
pub const NEAREST_LIGHT_MM: f64 = 0.5;
/// Band of tremor, Hz.
pub const TREMOR_BAND_HZ: [f64; 2] = [6.0, 14.0];
/// Retina within this distance of the fovea is macula, mm (its diameter is 5.5 mm).
pub const MACULA_MM: f64 = 2.75;
/// A contact counts when it was deeper than its threshold by this many deviations of the tracked
/// tip.
pub const SIGMAS: f64 = 2.0;
/// Share of its points that an attempt keeps when a serious injury fails it: however well all else
/// was done, less than half of 100.
pub const KEPT_WHEN_FAILED: f64 = 0.5;

/// Makes the enum [`Id`] and the table [`METRICS`] from rows of number, category, key, name, unit,
/// points, the figures from which on all and none of them are given, and formula.
macro_rules! metrics {
    ($($id:ident = $category:ident, $key:literal, $name:literal, $unit:literal, $points:literal,
       $full_at:literal => $none_at:literal, $formula:literal;)*) => {
        /// Numbers of the metrics in [`METRICS`].
        #[derive(Debug, Clone, Copy, PartialEq, Eq)]
        #[repr(usize)]
        #[allow(missing_docs)]
        pub enum Id {
            $($id,)*
        }

        /// How many metrics there are.
        pub const COUNT: usize = [$(Id::$id),*].len();

        /// Every metric, by [`Id`].
        pub const METRICS: [Metric; COUNT] = [$(Metric {
            key: $key,
            name: $name,
            category: Category::$category,
            unit: $unit,
            points: $points,
            full_at: $full_at,
            none_at: $none_at,
            formula: $formula,
        }),*];
    };
}

metrics! {
    Goals = Target, "goals", "goals reached", "share", 25.0, 1.0 => 0.0,
        "mean over the goals of the task: 1 for a goal reached (event 111), else the largest completed share, in tenths (event 123), of \
         its time, path, volume or number of events";
    Precision = Target, "precision", "distance from the goals", "share of the radius", 5.0, 0.4 => 1.0,
        "mean over the goals reached that have a radius: mean distance of the smoothed tip (time constant 0.1 s) or body \
         from the goal while it was held / radius of the goal";
    OffPath = Target, "off-path", "time outside the tube", "share", 5.0, 0.0 => 0.2,
        "sum of the times from event 114 to event 115 (or the end) / time of the attempt; only tasks with a path";
    Time = Efficiency, "time", "time", "× the plan's", 12.0, 1.3 => 3.0,
        "time of the attempt / par_s of the task; an attempt that is not finished gets no points";
    Way = Efficiency, "way", "path length of the tips", "× the plan's", 8.0, 1.25 => 3.0,
        "sum over both instruments of the path length of the smoothed tip (two time constants of 0.1 s, one \
         after the other) in the \
         eye / (par_mm of the task × goals reached)";
    Tremor = Instruments, "tremor", "tremor", "µm RMS", 6.0, 30.0 => 120.0,
        "root of the mean square of the tip in the eye, all axes together, between 6 and 14 Hz (Butterworth, 4 poles at each \
         end), less what the tracker's covariance puts into the band; the worse of the hands at the task";
    Speed = Instruments, "speed", "greatest speed", "mm/s", 3.0, 12.0 => 40.0,
        "greatest speed of a smoothed tip in the eye";
    SpeedNearRetina = Instruments, "speed-near-retina", "greatest speed near the retina", "mm/s", 3.0, 4.0 => 16.0,
        "greatest speed of a smoothed tip while it is within 1 mm of the retina";
    Grip = Instruments, "grip", "grips that slipped", "times", 3.0, 0.0 => 3.0,
        "number of events 12";
    OutOfView = Microscope, "out-of-view", "working out of view", "share", 6.0, 0.02 => 0.3,
        "sum of the times from event 118 to event 119 (or the end), both instruments, no light pipes / time of the attempt";
    Unlit = Microscope, "unlit", "working in the dark", "share", 4.0, 0.05 => 0.5,
        "share of the time in which the tip of instrument 0 is more than 0.6 rad off the axis of the light pipe in hand 1; only \
         tasks that begin with one there";
    LightDose = Tissue, "light-dose", "light on the retina", "mJ/mm²", 5.0, 8.0 => 40.0,
        "sum over time of 10 mW / (π (d · tan 0.6)²), where d is the distance along the light pipe from its tip to the retina, \
         at least 0.5 mm; only tasks that begin with a light pipe in hand 1; ISO 15004-2 warns from 100 mJ/mm² (10 J/cm²) on, and \
         surgery lasts many times as long as an exercise";
    Injuries = Tissue, "injuries", "points lost to injuries", "points", 15.0, 0.0 => 15.0,
        "points of all metrics together, times the share that the injuries below take; the category falls below 0 where that \
         exceeds its points";
}

/// An injury and what it costs.
#[derive(Debug, Clone, Copy)]
pub struct Penalty {
    /// Name for people and programs.
    pub name: &'static str,
    /// Share of the points that each takes of what the others left, 0 to 1.
    pub share: f64,
    /// One of it fails the attempt ([`KEPT_WHEN_FAILED`]).
    pub serious: bool,
    /// What counts as one.
    pub what: &'static str,
}

/// Numbers of the injuries in [`PENALTIES`].
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
#[repr(usize)]
#[allow(missing_docs)]
pub enum Injury {
    Lens,
    Macula,
    Haemorrhage,
    Tear,
    Contact,
    Pull,
}

/// How many kinds of injuries there are.
pub const INJURIES: usize = 6;

/// Every injury, by [`Injury`]. The first four are in the proportions of [`STUDIED`], to half a
/// per cent; what the study does not list, a contact that goes into nothing and a pull, is less than
/// each of them.
pub const PENALTIES: [Penalty; INJURIES] = [
    Penalty {
        name: "lens contact",
        share: 0.48,
        serious: true,
        what: "event 116 whose depth is beyond tracking noise",
    },
    Penalty {
        name: "macular haemorrhage",
        share: 0.175,
        serious: true,
        what: "a contact with the retina that goes into it (event 3) beyond tracking noise, within 2.75 mm of the fovea",
    },
    Penalty {
        name: "haemorrhage",
        share: 0.145,
        serious: false,
        what: "a contact with the retina that goes into it (event 3) beyond tracking noise, elsewhere",
    },
    Penalty {
        name: "retinal tear",
        share: 0.125,
        serious: true,
        what: "event 15, 64, 73 or 79 (rim torn off, retina torn, ripped or cut), at most one a second",
    },
    Penalty {
        name: "retina contact",
        share: 0.08,
        serious: false,
        what: "a contact with the retina (event 2) that does not go into it. Contacts while jaws hold the retina or a needle is in it (events 10 \
               and 70 to 11, 12 and 71) do not count, nor does pressing detached retina by up to 0.1 mm with the jaws that hold it. Contacts and haemorrhages of a hand within 0.5 mm and a second of the one before count once",
    },
    Penalty {
        name: "pull at the retina",
        share: 0.03,
        serious: false,
        what: "event 14, 62, 72, 77, 81 or 83 (pull of membrane or vitreous, needle or injection too fast); a continuous pull \
               counts once",
    },
];

/// What the commercial device took off for injuries in a study of surgeons who trained on it,
/// points in all (Deuchler et al. 2016, PLoS ONE 11(3), e0150690, doi 10.1371/journal.pone.0150690,
/// table of the most prominent faults): injured lens, macular spotted haemorrhages, injured
/// extramacular retina, retinal tear.
pub const STUDIED: [(Injury, f64); 4] =
    [(Injury::Lens, 346.0), (Injury::Macula, 125.0), (Injury::Haemorrhage, 106.0), (Injury::Tear, 90.0)];

/// The injury that an event is by itself; contacts with the retina are followed, see the scorer.
pub fn injury_of(kind: EventKind) -> Option<Injury> {
    use EventKind::{
        BaseTraction, InjectionFast, NeedleFast, RetinaCut, RetinaPulled, RetinaRipped, RetinaTorn,
        RimDetached, RimForceHigh, VitreousTraction,
    };
    match kind {
        EventKind::LensTouched => Some(Injury::Lens),
        RimDetached | RetinaTorn | RetinaRipped | RetinaCut => Some(Injury::Tear),
        RimForceHigh | RetinaPulled | NeedleFast | InjectionFast | VitreousTraction | BaseTraction => {
            Some(Injury::Pull)
        }
        _ => None,
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn a_hundred_points_in_five_categories() {
        assert_eq!(Category::ALL.map(Category::points), [35.0, 20.0, 15.0, 10.0, 20.0]);
        assert_eq!(METRICS.iter().map(|m| m.points).sum::<f64>(), 100.0);
        assert_eq!(METRICS[Id::Injuries as usize].key, "injuries");
        assert_eq!(METRICS[Id::Unlit as usize].key, "unlit");
    }

    #[test]
    fn the_lens_is_far_above_the_macula_and_that_above_tears_and_contacts() {
        let share = |i: Injury| PENALTIES[i as usize].share;
        assert!(share(Injury::Lens) >= 2.0 * share(Injury::Macula));
        assert!(share(Injury::Macula) > share(Injury::Tear) && share(Injury::Tear) > share(Injury::Contact));
        assert!(share(Injury::Macula) > share(Injury::Haemorrhage));
        for (injury, studied) in STUDIED {
            let by_study = share(Injury::Lens) * studied / STUDIED[0].1;
            assert!((share(injury) - by_study).abs() <= 0.0025, "{injury:?}: {by_study} by the study");
        }
        assert!(PENALTIES.iter().all(|p| p.share > 0.0 && p.share < 1.0), "each takes something, none all");
    }
}
