//! Trunks: the vessels that cross the photograph's border. Each is followed inwards in the photograph,
//! so that what is grown beyond it goes on at the same place, in the same direction, as wide and as dark.

use super::{BEARINGS, Random, SEAM, STEP_MM, Tip, bearing_of, direction};
use crate::photograph::Photograph;
use std::f32::consts::FRAC_PI_2;

/// Share of the way to the border at which vessels are found.
const FOUND_AT: f32 = 0.985;
/// By how much a vessel is darker than its surroundings in green, of 255, and how many bearings two are
/// apart.
const DARKER: f32 = 6.0;
const APART: usize = 4;
/// Samples across a vessel and their distance, mm (1.6 pixels of the shipped photograph).
const ACROSS: usize = 31;
const APART_MM: f32 = 0.02;
const MIDDLE: usize = ACROSS / 2;
/// A profile is a mean over so much of the vessel's length to both sides, mm.
const ALONG_MM: f32 = 0.05;
/// Farthest that a vessel is looked for beside its expected place, samples.
const ASIDE: usize = 5;
/// Most steps that a vessel is followed inwards, and fewest of one.
const MOST_STEPS: usize = 30;
const LEAST_STEPS: usize = 5;
/// A vessel is lost where its depth falls below this share of the depth at the border.
const LOST: f32 = 0.35;
/// Least depth of a vessel in green along its first half millimetre, of 255.
const LEAST_DEPTH: f32 = 3.5;
/// Half of the width at half depth of the lines that [`super::layer`] draws, in their radii; on the map,
/// which is sharpened, a tenth less than by their formula.
const HALF_DEPTH: f32 = 0.82;
/// Limits of a trunk's radius, mm.
const RADII_MM: [f32; 2] = [0.012, 0.075];

/// A vessel that crosses the border.
pub struct Trunk {
    /// Its course in the photograph, from where the photograph begins to give way to the border, where
    /// it goes on.
    pub course: Vec<Tip>,
    /// Share of red, green and blue that it takes away in its middle.
    pub absorbed: [f32; 3],
}

/// Bearings, by their numbers, at which vessels cross the border, the darkest first.
pub fn crossings(photograph: &Photograph) -> Vec<usize> {
    let depth = |i: usize| Profile::across(photograph, &at_border(photograph, i)).depth(1);
    let depths: Vec<f32> = (0..BEARINGS).map(depth).collect();
    let mut all: Vec<usize> = (0..BEARINGS).filter(|&i| depths[i] > DARKER).collect();
    all.sort_by(|a, b| depths[*b].total_cmp(&depths[*a]));
    let mut found: Vec<usize> = Vec::new();
    for i in all {
        let apart = |j: &usize| (i + BEARINGS - j) % BEARINGS;
        if found.iter().all(|j| apart(j).min(BEARINGS - apart(j)) >= APART) {
            found.push(i);
        }
    }
    found
}

impl Trunk {
    /// Follows the vessel that crosses the border at bearing number `i`, if there is one.
    pub fn follow(photograph: &Photograph, i: usize) -> Option<Self> {
        let (depth, begin) = best_heading(photograph, &at_border(photograph, i));
        if depth < LEAST_DEPTH {
            return None;
        }
        let mut at = centred(photograph, &begin).0;
        let mut sum = Profile::across(photograph, &at);
        let (mut course, least) = (vec![at], LOST * sum.depth(1));
        while course.len() < MOST_STEPS && at.theta > border_rad(photograph, at.bearing) - SEAM - 0.01 {
            let (next, profile) = inwards(photograph, &at);
            if profile.depth(1) < least {
                break;
            }
            sum.add(&profile);
            at = next;
            course.push(at);
        }
        if course.len() < LEAST_STEPS {
            return None;
        }
        course.reverse();
        let absorbed = [0, 1, 2].map(|c| (sum.depth(c) / sum.ground(c).max(1.0)).max(0.0));
        let radius_mm = (sum.half_width_mm() / HALF_DEPTH).clamp(RADII_MM[0], RADII_MM[1]);
        course.iter_mut().for_each(|tip| tip.radius_mm = radius_mm);
        if let [.., inner, _, _, outer] = &mut course[..] {
            // The direction in which it leaves the photograph: that of its last steps.
            outer.heading = heading(inner, outer);
        }
        Some(Trunk { course, absorbed })
    }

    /// One where the photograph has none, at bearing number `i`; it comes up where that gives way.
    pub fn invented(photograph: &Photograph, i: usize, random: &mut Random) -> Self {
        let theta = border_rad(photograph, bearing_of(i)) - SEAM;
        let heading = random.within(0.4);
        let mut tip = Tip { theta, bearing: bearing_of(i), heading, radius_mm: 0.02, dark: 0.0 };
        let mut course = vec![tip];
        while tip.theta < theta + SEAM {
            tip.step(STEP_MM);
            course.push(tip);
        }
        Trunk { course, absorbed: super::ABSORBED.map(|share| 0.45 * share) }
    }

    /// The depth to draw it with: the share of `absorbed` that it takes, before fine vessels are made
    /// fainter. One that was lost on the way begins from nothing.
    pub fn darken(&mut self, absorbed: [f32; 3], photograph: &Photograph) {
        let share = (self.absorbed[1] / absorbed[1]).min(1.0);
        let first = self.course[0];
        let lost = first.theta > border_rad(photograph, first.bearing) - SEAM + 0.01;
        for (k, tip) in self.course.iter_mut().enumerate() {
            let comes_up = if lost { (k as f32 / LEAST_STEPS as f32).min(1.0) } else { 1.0 };
            tip.dark = comes_up * share / tip.fine();
        }
    }
}

/// A place at the border, where vessels are looked for.
fn at_border(photograph: &Photograph, i: usize) -> Tip {
    let bearing = bearing_of(i);
    let theta = FOUND_AT * border_rad(photograph, bearing);
    Tip { theta, bearing, heading: 0.0, radius_mm: 0.0, dark: 0.0 }
}

/// Angle of the photograph's border in a canonical direction, rad.
fn border_rad(photograph: &Photograph, bearing: f32) -> f32 {
    photograph.border(photograph.towards(direction(bearing))).1
}

/// From one place to another, from outwards towards growing bearings, rad.
fn heading(from: &Tip, to: &Tip) -> f32 {
    let middle = 0.5 * (from.theta + to.theta);
    ((to.bearing - from.bearing) * middle.sin()).atan2(to.theta - from.theta)
}

/// The tip `way_mm` further along its heading, turned by `turn`; it looks where it looked.
fn moved(tip: &Tip, way_mm: f32, turn: f32) -> Tip {
    let mut to = Tip { heading: tip.heading + turn, ..*tip };
    to.step(way_mm);
    Tip { heading: tip.heading, ..to }
}

/// The heading along which the line inwards is darkest against its sides, and by how much, of 255.
fn best_heading(photograph: &Photograph, at: &Tip) -> (f32, Tip) {
    let depth = |tip: &Tip| {
        let deep = |k: usize| Profile::across(photograph, &moved(tip, -STEP_MM * k as f32, 0.0)).depth(1);
        (0..7).map(deep).sum::<f32>() / 7.0
    };
    let headings = (-16..=16).map(|k| Tip { heading: k as f32 * 0.08, ..*at });
    let centred = headings.map(|tip| centred(photograph, &tip).0);
    centred
        .map(|tip| (depth(&tip), tip))
        .fold((0.0, *at), |best, now| if now.0 > best.0 { now } else { best })
}

/// The tip moved across onto the vessel's middle, and by how much, mm.
fn centred(photograph: &Photograph, tip: &Tip) -> (Tip, f32) {
    let aside_mm = Profile::across(photograph, tip).darkest_mm();
    (moved(tip, aside_mm, FRAC_PI_2), aside_mm)
}

/// A step back along the vessel, and the profile there.
fn inwards(photograph: &Photograph, at: &Tip) -> (Tip, Profile) {
    let (mut next, aside_mm) = centred(photograph, &moved(at, -STEP_MM, 0.0));
    next.heading += 0.5 * (-aside_mm).atan2(STEP_MM);
    let profile = Profile::across(photograph, &next);
    (next, profile)
}

/// Colours of the photograph across a vessel.
struct Profile([[f32; 3]; ACROSS]);

impl Profile {
    fn across(photograph: &Photograph, tip: &Tip) -> Self {
        let colour = |i: usize| {
            let beside = moved(tip, (i as f32 - MIDDLE as f32) * APART_MM, FRAC_PI_2);
            let along =
                [-ALONG_MM, 0.0, ALONG_MM].map(|way_mm| seen(photograph, &moved(&beside, way_mm, 0.0)));
            [0, 1, 2].map(|c| along.iter().map(|colour| colour[c]).sum::<f32>() / 3.0)
        };
        Profile(std::array::from_fn(colour))
    }

    /// Adds another; ratios and widths are then those of the mean.
    fn add(&mut self, other: &Profile) {
        self.0.iter_mut().flatten().zip(other.0.iter().flatten()).for_each(|(a, b)| *a += b);
    }

    /// What lies beside the vessel: three quarters of the samples are darker.
    fn ground(&self, c: usize) -> f32 {
        let mut sorted = self.0.map(|colour| colour[c]);
        sorted.sort_by(f32::total_cmp);
        sorted[3 * ACROSS / 4]
    }

    /// Of channel `c`, a mean over three samples about number `i`.
    fn smooth(&self, i: usize, c: usize) -> f32 {
        (i - 1..=i + 1).map(|k| self.0[k][c]).sum::<f32>() / 3.0
    }

    /// How much darker the middle is than the ground.
    fn depth(&self, c: usize) -> f32 {
        self.ground(c) - self.smooth(MIDDLE, c)
    }

    /// Where it is darkest near the middle, mm.
    fn darkest_mm(&self) -> f32 {
        let near = MIDDLE - ASIDE..=MIDDLE + ASIDE;
        let darkest = near.min_by(|a, b| self.smooth(*a, 1).total_cmp(&self.smooth(*b, 1))).unwrap_or(MIDDLE);
        (darkest as f32 - MIDDLE as f32) * APART_MM
    }

    /// Half of the width in which it is at least half as dark as in its middle, mm.
    fn half_width_mm(&self) -> f32 {
        let half = self.ground(1) - 0.5 * self.depth(1);
        let reach = |side: i32| {
            let at = |k: i32| self.0[(MIDDLE as i32 + side * k) as usize][1];
            let out = (1..=MIDDLE as i32).find(|k| at(*k) > half).unwrap_or(MIDDLE as i32);
            let (inside, outside) = (at(out - 1), at(out));
            (out - 1) as f32 + ((half - inside) / (outside - inside).max(1e-3)).clamp(0.0, 1.0)
        };
        0.5 * APART_MM * (reach(1) + reach(-1))
    }
}

/// The photograph at a place; what is outside it is as its border.
fn seen(photograph: &Photograph, at: &Tip) -> [f32; 3] {
    let share = at.theta / border_rad(photograph, at.bearing);
    photograph.at_share(direction(at.bearing), share.min(1.0))
}
