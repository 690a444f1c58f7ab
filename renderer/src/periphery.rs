//! The fundus beyond the photograph, by procedure: vessels that go on from the photograph's, branch
//! and taper, vortex veins, the grain of the pigment; before it the ora serrata and the pars plana.
//!
//! Everything is laid out in **canonical** directions, temporal and down, so that both eyes and
//! mirrored photographs have the same periphery. A vessel divides by Murray's law (Proc. Natl. Acad.
//! Sci. 12, 207, 1926): the cubes of the radii of the branches sum up to the trunk's.

mod layer;
mod random;
#[cfg(test)]
mod seam;
mod trunk;

use crate::fundus_map::RADIUS_MM;
use crate::photograph::Photograph;
use layer::Layer;
use random::{Noise, Random, smooth};
use scene::Side;
use std::f32::consts::{FRAC_PI_2, FRAC_PI_4, TAU};
use trunk::Trunk;

/// Angle from the pole to the ora serrata, where the retina ends, rad: 23 mm from the fovea, which is 7
/// to 8 mm behind the limbus of an eye 24 mm long ("Examination of the ora serrata", Archives of
/// Ophthalmology, about 1950).
pub const ORA_ANGLE: f32 = 23.0 / RADIUS_MM;
/// Angle inside the photograph's border over which it gives way, rad.
const SEAM: f32 = 0.07;
/// Angle beyond the border within which its colours fade into [`PERIPHERY`], rad.
const FADE: f32 = 0.5;
/// Mean colour towards the periphery, of the photograph's 255.
const PERIPHERY: [f32; 3] = [168.0, 66.0, 44.0];
/// Colours of the line along the ora serrata, of the pars plana, of the sclera, of a vortex vein.
const ORA: [f32; 3] = [190.0, 140.0, 112.0];
const PLANA: [f32; 3] = [96.0, 58.0, 42.0];
const SCLERA: [f32; 3] = [206.0, 186.0, 170.0];
const VORTEX: [f32; 3] = [192.0, 58.0, 30.0];
/// Width of the pars plana (about 4 mm), rad.
const PARS_PLANA: f32 = 0.30;
/// Teeth of the ora serrata all round, and the longest, rad.
const TEETH: usize = 36;
const TOOTH: f32 = 0.09;
/// Share of red, green and blue that a vessel's blood takes away at most; of each colour beside green as
/// much as in the photograph's own vessels, if it has any.
const ABSORBED: [f32; 3] = [0.24, 0.62, 0.52];

/// Directions in which the photograph's border is looked at.
const BEARINGS: usize = 720;
/// Share of the way to the border at which the ground's colour is.
const GROUND_AT: f32 = 0.95;
/// Half width of the surroundings with which a vessel is compared, directions.
const SURROUNDINGS: usize = 14;
/// Most vessels that go on, and how many there are at least.
const MOST: usize = 30;
const LEAST: usize = 12;

/// Way of a step along a vessel, mm.
const STEP_MM: f32 = 0.08;
/// Divisions a millimetre, and the share of its radius that a vessel loses in one.
const DIVISIONS: f32 = 0.17;
const TAPER: f32 = 0.035;
/// A vessel ends below this radius, mm.
const THINNEST_MM: f32 = 0.007;
/// How a vessel's direction wanders in a step, and how fast it turns back outwards.
const MEANDER: f32 = 0.10;
const OUTWARDS: f32 = 0.035;

/// The periphery of an eye on a map of `size` pixels.
pub struct Periphery {
    /// Colours at the photograph's border by canonical bearing, without its vessels.
    border: Vec<[f32; 3]>,
    /// Teeth of the ora serrata: bearing, half width, length, rad.
    teeth: Vec<[f32; 3]>,
    blood: Layer,
    absorbed: [f32; 3],
    vortex: Layer,
    noise: Noise,
}

/// A place of the map: canonical direction, angle from the pole.
#[derive(Debug, Clone, Copy)]
pub struct Place {
    /// Temporal and down, unit.
    pub canonical: [f32; 2],
    /// rad.
    pub theta: f32,
}

impl Place {
    fn bearing(self) -> f32 {
        self.canonical[1].atan2(self.canonical[0]).rem_euclid(TAU)
    }
}

/// The growing end of a vessel.
#[derive(Debug, Clone, Copy)]
struct Tip {
    theta: f32,
    bearing: f32,
    /// From outwards towards growing bearings, rad.
    heading: f32,
    radius_mm: f32,
    /// Share of the light that it takes where it is not fine.
    dark: f32,
}

impl Periphery {
    /// Grows what lies beyond `photograph` in an eye of `side`.
    pub fn grow(photograph: &Photograph, size: usize, side: Side) -> Self {
        let mut random = Random(0x05ee_d07e);
        let trunks = trunks(photograph, &mut random);
        let mut grown = Periphery {
            border: ground(photograph),
            teeth: teeth(&mut random),
            blood: Layer::new(size, side),
            absorbed: absorbed(&trunks),
            vortex: Layer::new(size, side),
            noise: Noise(11),
        };
        for mut trunk in trunks {
            trunk.darken(grown.absorbed, photograph);
            grown.vessel(&trunk.course, &mut random);
        }
        for quadrant in 0..4 {
            let bearing = FRAC_PI_4 + quadrant as f32 * FRAC_PI_2 + random.within(0.25);
            grown.vortex_vein(1.30 + random.within(0.07), bearing, &mut random);
        }
        grown
    }

    /// Colour at a place whose pixel of the map is `index`; the photograph's border lies there at
    /// `border_rad` and shows `photo` inside it.
    pub fn colour(&self, photo: [f32; 3], place: Place, border_rad: f32, index: usize) -> [f32; 3] {
        let beyond = place.theta - border_rad;
        if beyond < -SEAM {
            return photo;
        }
        let bearing = place.bearing();
        let fade = smooth(beyond / FADE) * 0.95;
        let near = mix(self.border_colour(bearing), PERIPHERY, fade);
        let at = place.canonical.map(|c| c * place.theta * RADIUS_MM);
        let patches = self.noise.at(at.map(|c| c * 0.55)) + 0.6 * self.noise.at(at.map(|c| c * 1.9));
        let grain = self.noise.at(at.map(|c| c * 7.0)) * (0.4 + smooth((place.theta - 1.1) / 0.6));
        let uneven = smooth((beyond + SEAM) / FADE) * (0.055 * patches + 0.035 * grain);
        let ground = near.map(|c| c * (1.0 + uneven));
        let ground = mix(ground, VORTEX, 0.45 * self.vortex.shares[index]);
        let blood = self.blood.shares[index];
        let retina = std::array::from_fn(|c| ground[c] * (1.0 - self.absorbed[c] * blood));
        let retina = mix(photo, retina, smooth((beyond + SEAM) / SEAM));
        self.before_the_ora(retina, place.theta, bearing, at)
    }

    /// What lies about the retina's border: pointed teeth with round bays between them, the streaked
    /// pars plana, the sclera.
    fn before_the_ora(&self, retina: [f32; 3], theta: f32, bearing: f32, at: [f32; 2]) -> [f32; 3] {
        if theta < ORA_ANGLE - 0.1 {
            return retina;
        }
        let reach = |&[middle, half, length]: &[f32; 3]| {
            let away = (bearing - middle + 0.5 * TAU).rem_euclid(TAU) - 0.5 * TAU;
            length * (1.0 - away.abs() / half).max(0.0).powi(2)
        };
        let round = theta - ORA_ANGLE + 0.012 * self.noise.at(at.map(|c| c * 0.8));
        let past = round - self.teeth.iter().map(reach).fold(0.0, f32::max);
        let step = |from: f32, to: f32| smooth((past - from) / (to - from));
        let streak = self.noise.at([bearing * 45.0, theta * 3.0]) + 0.5 * self.noise.at(at.map(|c| c * 5.0));
        let line = mix(retina, ORA, 0.8 * step(-0.022, 0.0));
        let plana = mix(line, PLANA.map(|c| c * (1.0 + 0.14 * streak)), step(0.004, 0.02));
        mix(plana, SCLERA, smooth((round - PARS_PLANA) / 0.05))
    }

    fn border_colour(&self, bearing: f32) -> [f32; 3] {
        let at = bearing / TAU * BEARINGS as f32;
        let (i, share) = (at as usize, at.fract());
        mix(self.border[i % BEARINGS], self.border[(i + 1) % BEARINGS], share)
    }

    /// A trunk along its course in the photograph, and what grows from its end.
    fn vessel(&mut self, course: &[Tip], random: &mut Random) {
        course.windows(2).for_each(|ends| self.blood.line(&ends[0], &ends[1], ends[1].share()));
        let mut tips: Vec<Tip> = course.last().copied().into_iter().collect();
        while let Some(mut tip) = tips.pop() {
            while tip.radius_mm > THINNEST_MM
                && tip.theta < ORA_ANGLE - 0.06 - 0.25 * random.share() * STEP_MM
            {
                let from = tip;
                tip.go(STEP_MM, random);
                self.blood.line(&from, &tip, tip.share());
                if random.share() < DIVISIONS * STEP_MM {
                    tips.push(tip.divide(random));
                }
            }
        }
    }

    /// Veins of the choroid that run together behind the equator.
    fn vortex_vein(&mut self, theta: f32, bearing: f32, random: &mut Random) {
        const STRANDS: usize = 11;
        for strand in 0..STRANDS {
            let heading = TAU * (strand as f32 + random.within(0.3)) / STRANDS as f32;
            let curl = if heading.sin() > 0.0 { 0.018 } else { -0.018 };
            let mut tip = Tip { theta, bearing, heading, radius_mm: 0.17, dark: 1.0 };
            for _ in 0..(30.0 + 25.0 * random.share()) as usize {
                let from = tip;
                tip.step(STEP_MM);
                tip.heading += curl + random.within(0.04);
                tip.radius_mm *= 0.985;
                self.vortex.line(&from, &tip, 0.4 + 2.5 * tip.radius_mm);
            }
        }
    }
}

impl Tip {
    /// Share by which a vessel as fine as this is fainter.
    fn fine(&self) -> f32 {
        (self.radius_mm / 0.05).min(1.0).sqrt()
    }

    /// Share of the light that it takes.
    fn share(&self) -> f32 {
        self.dark * self.fine()
    }

    fn step(&mut self, way_mm: f32) {
        self.theta += way_mm * self.heading.cos() / RADIUS_MM;
        self.bearing += way_mm * self.heading.sin() / (RADIUS_MM * self.theta.sin().max(0.2));
    }

    fn go(&mut self, way_mm: f32, random: &mut Random) {
        self.step(way_mm);
        self.heading += random.within(MEANDER) - OUTWARDS * self.heading;
        self.radius_mm *= 1.0 - TAPER * way_mm;
    }

    /// Divides; returns the thinner branch, which turns away more.
    fn divide(&mut self, random: &mut Random) -> Tip {
        let share = 0.15 + 0.35 * random.share();
        let trunk = self.radius_mm;
        let turn = (0.35 + 0.35 * random.share()) * if random.share() < 0.5 { 1.0 } else { -1.0 };
        let branch =
            Tip { radius_mm: trunk * share.cbrt(), heading: self.heading + turn * (1.0 - share), ..*self };
        self.radius_mm = trunk * (1.0 - share).cbrt();
        self.heading -= turn * share;
        branch
    }
}

/// The photograph's colours near its border without vessels, smooth all round.
fn ground(photograph: &Photograph) -> Vec<[f32; 3]> {
    let colour = |i: usize| photograph.at_share(direction(bearing_of(i)), GROUND_AT);
    let ring: Vec<[f32; 3]> = (0..BEARINGS).map(colour).collect();
    (0..BEARINGS).map(|i| mean_about(&ring, i, 2 * SURROUNDINGS)).collect()
}

/// The vessels that cross the border, the darkest first, as far as they are wanted; where there are
/// few, others beside them.
fn trunks(photograph: &Photograph, random: &mut Random) -> Vec<Trunk> {
    let found = trunk::crossings(photograph).into_iter();
    let mut trunks: Vec<Trunk> = found.filter_map(|i| Trunk::follow(photograph, i)).take(MOST).collect();
    for more in trunks.len()..LEAST {
        let i = (more * 211 + (random.share() * 20.0) as usize) % BEARINGS;
        trunks.push(Trunk::invented(photograph, i, random));
    }
    trunks
}

/// What blood takes away of each colour: as much of green as [`ABSORBED`] says, of the others as the
/// trunks have it.
fn absorbed(trunks: &[Trunk]) -> [f32; 3] {
    let sum = |c: usize| trunks.iter().map(|t| t.absorbed[c]).sum::<f32>();
    [0, 1, 2].map(|c| ABSORBED[1] * (sum(c) / sum(1).max(1e-6)))
}

fn mean_about(ring: &[[f32; 3]], at: usize, half: usize) -> [f32; 3] {
    let mut sum = [0.0; 3];
    for k in 0..=2 * half {
        let colour = ring[(at + BEARINGS + k - half) % BEARINGS];
        (0..3).for_each(|c| sum[c] += colour[c]);
    }
    sum.map(|c| c / (2 * half + 1) as f32)
}

fn bearing_of(i: usize) -> f32 {
    i as f32 / BEARINGS as f32 * TAU
}

fn direction(bearing: f32) -> [f32; 2] {
    [bearing.cos(), bearing.sin()]
}

/// Bearings, half widths and lengths of the ora serrata's teeth; they are longer nasally.
fn teeth(random: &mut Random) -> Vec<[f32; 3]> {
    let tooth = |i: usize| {
        let bearing = (i as f32 + random.within(0.3)) / TEETH as f32 * TAU;
        let nasal = 0.6 - 0.4 * bearing.cos();
        [bearing, 0.045 + 0.04 * random.share(), TOOTH * nasal * (0.2 + 0.8 * random.share())]
    };
    (0..TEETH).map(tooth).collect()
}

fn mix(a: [f32; 3], b: [f32; 3], share: f32) -> [f32; 3] {
    std::array::from_fn(|c| a[c] + (b[c] - a[c]) * share)
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::assets::shipped_photograph;
    use crate::fundus_map::{bake, map_scale};
    use std::sync::OnceLock;

    const SIZE: usize = 1024;

    fn shipped() -> Photograph {
        Photograph::new(shipped_photograph().unwrap())
    }

    /// The map of a left eye, baked once.
    fn map() -> &'static [u8] {
        static MAP: OnceLock<Vec<u8>> = OnceLock::new();
        MAP.get_or_init(|| bake(&shipped(), SIZE as u32, Side::Left))
    }

    /// Colours of the map round the photograph, `beyond` its border (rad).
    fn circle(map: &[u8], beyond: f32) -> Vec<[f32; 3]> {
        let photograph = shipped();
        let colour = |i: usize| {
            let towards = direction(bearing_of(i));
            let theta = photograph.border(photograph.towards(towards)).1 + beyond;
            let rho = 2.0 * (0.5 * theta).sin() * map_scale();
            let [x, y] = [0.5 + towards[0] * rho, 0.5 - towards[1] * rho].map(|c| (c * SIZE as f32) as usize);
            std::array::from_fn(|c| f32::from(map[(y * SIZE + x) * 4 + c]))
        };
        (0..BEARINGS).map(colour).collect()
    }

    /// How much darker each direction of a circle is than its surroundings in green, of 255.
    fn darker(ring: &[[f32; 3]]) -> Vec<f32> {
        (0..BEARINGS).map(|i| mean_about(ring, i, SURROUNDINGS)[1] - mean_about(ring, i, 1)[1]).collect()
    }

    /// Pearson's correlation.
    fn correlation(a: &[f32], b: &[f32]) -> f32 {
        let mean = |v: &[f32]| v.iter().sum::<f32>() / v.len() as f32;
        let (ma, mb) = (mean(a), mean(b));
        let sum = |f: &dyn Fn(f32, f32) -> f32| a.iter().zip(b).map(|(a, b)| f(a - ma, b - mb)).sum::<f32>();
        sum(&|a, b| a * b) / (sum(&|a, _| a * a) * sum(&|_, b| b * b)).sqrt()
    }

    #[test]
    fn what_the_border_shows_is_not_drawn_outwards() {
        let at = |beyond| darker(&circle(map(), beyond));
        let alike = correlation(&at(0.15), &at(0.40));
        assert!(alike < 0.4, "{alike}");
    }

    /// The colours change across the seam no more than the photograph's do over as much.
    #[test]
    fn no_seam_runs_round_the_photograph() {
        let way = SEAM + 0.01;
        let [within, inside, beyond] = [-2.0 * way, -way, 0.0].map(|b| circle(map(), b + 0.005));
        for i in (0..BEARINGS).step_by(20) {
            let [w, a, b] = [&within, &inside, &beyond].map(|ring| mean_about(ring, i, 20));
            let [own, across] =
                [[w, a], [a, b]].map(|[p, q]| (0..3).map(|c| (p[c] - q[c]).abs()).sum::<f32>());
            assert!(across < own.max(30.0) + 30.0, "direction {i}: {w:?}, {a:?}, {b:?}");
        }
    }

    #[test]
    fn vessels_go_on_where_the_photograph_has_them_and_taper() {
        let photograph = shipped();
        let grown = Periphery::grow(&photograph, SIZE, Side::Left);
        let blood = |theta: f32, bearing: f32| {
            let (rho, [x, y]) = (2.0 * (0.5 * theta).sin() * map_scale(), direction(bearing));
            let [i, j] = [0.5 + x * rho, 0.5 - y * rho].map(|c| (c * SIZE as f32) as usize);
            grown.blood.shares[j * SIZE + i]
        };
        let trunks = trunks(&photograph, &mut Random(1));
        assert!((LEAST..=MOST).contains(&trunks.len()), "{}", trunks.len());
        for trunk in trunks.iter().take(6) {
            let tip = trunk.course[trunk.course.len() - 1];
            let near = (-8..=8).map(|k| blood(tip.theta + 0.02, tip.bearing + 0.01 * k as f32));
            assert!(near.fold(0.0, f32::max) > 0.3, "{tip:?}");
        }
        let all_round = |theta| (0..BEARINGS).map(|i| blood(theta, bearing_of(i))).sum::<f32>();
        let [near, far, end] = [0.75, 1.6, ORA_ANGLE - 0.02].map(all_round);
        assert!(near > far && far > 0.1 * near && end < 0.1 * far, "{near}, {far}, {end}");
    }

    #[test]
    fn both_eyes_are_mirror_images() {
        let [left, right] = [Side::Left, Side::Right].map(|side| Periphery::grow(&shipped(), 256, side));
        for (l, r) in left.blood.shares.chunks(256).zip(right.blood.shares.chunks(256)) {
            assert!(l.iter().zip(r.iter().rev()).all(|(l, r)| (l - r).abs() < 0.02));
        }
    }

    #[test]
    fn the_thicker_branch_keeps_more_of_the_way_and_the_cubes_sum_up() {
        let trunk = Tip { theta: 0.8, bearing: 1.0, heading: 0.1, radius_mm: 0.05, dark: 0.7 };
        for seed in 0..50 {
            let mut tip = trunk;
            let branch = tip.divide(&mut Random(seed));
            let cubes = tip.radius_mm.powi(3) + branch.radius_mm.powi(3);
            assert!((cubes / trunk.radius_mm.powi(3) - 1.0).abs() < 1e-4);
            let [kept, turned] = [tip, branch].map(|t| (t.heading - trunk.heading).abs());
            assert!(kept <= turned && branch.radius_mm <= tip.radius_mm);
        }
    }
}
