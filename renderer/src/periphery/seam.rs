//! Measures how vessels go on across the photograph's border, on the map as it is laid on the retina and
//! beside it on the photograph alone.

use super::{BEARINGS, bearing_of, direction};
use crate::assets::shipped_photograph;
use crate::fundus_map::{RADIUS_MM, bake, map_scale};
use crate::photograph::Photograph;
use scene::Side;

const SIZE: usize = 2048;
/// Distance of the circles on which vessels are looked at, rad (0.09 mm).
const STEP: f32 = 0.008;
/// Samples across a vessel and their distance, mm.
const ACROSS: usize = 51;
const APART_MM: f32 = 0.02;
/// Where a vessel's sides are, mm from its middle.
const BESIDE_MM: f32 = 0.18;
/// Circles along which a direction is measured (0.46 mm), and over which the photograph gives way.
const LINE: usize = 5;
const GIVES_WAY: usize = 9;
/// Farthest that a vessel is looked for beside its expected place, samples.
const ASIDE: usize = 6;

/// Green at an angle from the pole and a canonical bearing.
type Green<'a> = &'a dyn Fn(f32, f32) -> f32;

/// Where a vessel crosses a circle.
#[derive(Debug, Clone, Copy)]
struct Crossing {
    theta: f32,
    bearing: f32,
    /// How much darker than its sides, of 255.
    depth: f32,
    /// Along the circle, between its sides at half of its depth.
    width_mm: f32,
}

impl Crossing {
    /// What is darkest near `bearing` on the circle at `theta`.
    fn near(green: Green, theta: f32, bearing: f32) -> Self {
        let apart = APART_MM / (RADIUS_MM * theta.sin());
        let middle = ACROSS / 2;
        let at = |i: usize| bearing + (i as f32 - middle as f32) * apart;
        let line: [f32; ACROSS] = std::array::from_fn(|i| green(theta, at(i)));
        let mut sorted = line;
        sorted.sort_by(f32::total_cmp);
        let ground = sorted[3 * ACROSS / 4];
        let mean = |i: usize| (line[i - 1] + line[i] + line[i + 1]) / 3.0;
        let near = middle - ASIDE..=middle + ASIDE;
        let darkest = near.min_by(|a, b| mean(*a).total_cmp(&mean(*b))).unwrap();
        let depth = ground - mean(darkest);
        let half = ground - 0.5 * depth;
        // From the middle to where half of the depth is reached, samples.
        let reach = |side: i32| {
            let value = |k: i32| line[(darkest as i32 + side * k) as usize];
            let last = if side > 0 { ACROSS - 1 - darkest } else { darkest } as i32;
            let out = (1..=last).find(|k| value(*k) > half).unwrap_or(last);
            let (within, beyond) = (value(out - 1), value(out));
            (out - 1) as f32 + ((half - within) / (beyond - within).max(1e-3)).clamp(0.0, 1.0)
        };
        let (right, left) = (reach(1), reach(-1));
        let width_mm = (left + right) * APART_MM;
        let bearing = at(darkest) + 0.5 * (right - left) * apart;
        Crossing { theta, bearing, depth, width_mm }
    }

    /// The direction from outwards towards growing bearings, degrees, in which the straight line over
    /// the next circles (`step` from one to the next, rad) is darkest.
    fn heading_deg(&self, green: Green, step: f32) -> f32 {
        let depth = |deg: &i32| {
            let on = (1..=LINE).map(|k| self.along(*deg as f32, k as f32 * step));
            on.map(|at| Crossing::depth_at(green, at)).sum::<f32>()
        };
        let headings = (-60..=60).step_by(3);
        headings.max_by(|a, b| depth(a).total_cmp(&depth(b))).unwrap() as f32
    }

    /// The place `way` further out, rad, in a direction: angle from the pole and bearing.
    fn along(&self, heading_deg: f32, way: f32) -> [f32; 2] {
        let theta = self.theta + way;
        let aside = way * heading_deg.to_radians().tan();
        [theta, self.bearing + aside / (0.5 * (self.theta + theta)).sin()]
    }

    /// How much darker a place is than what lies at both sides.
    fn depth_at(green: Green, [theta, bearing]: [f32; 2]) -> f32 {
        let beside = BESIDE_MM / (RADIUS_MM * theta.sin());
        0.5 * (green(theta, bearing - beside) + green(theta, bearing + beside)) - green(theta, bearing)
    }

    /// The vessel on the next circles, from here in a direction.
    fn course(&self, green: Green, heading_deg: f32, step: f32, circles: usize) -> Vec<Crossing> {
        let mut course = vec![*self];
        let mut turn = self.along(heading_deg, step)[1] - self.bearing;
        while course.len() <= circles {
            let last = course[course.len() - 1];
            let next = Self::near(green, last.theta + step, last.bearing + turn);
            turn += 0.5 * (next.bearing - last.bearing - turn);
            course.push(next);
        }
        course.split_off(1)
    }
}

fn median(part: &[Crossing], value: fn(&Crossing) -> f32) -> f32 {
    let mut values: Vec<f32> = part.iter().map(value).collect();
    values.sort_by(f32::total_cmp);
    values[values.len() / 2]
}

/// The vessels on a circle, darkest first.
fn trunks(green: Green, theta: impl Fn(f32) -> f32) -> Vec<Crossing> {
    let all = (0..BEARINGS).map(|i| Crossing::near(green, theta(bearing_of(i)), bearing_of(i)));
    let mut all: Vec<Crossing> = all.filter(|c| c.depth > 14.0 && c.width_mm < 0.3).collect();
    all.sort_by(|a, b| b.depth.total_cmp(&a.depth));
    let mut found: Vec<Crossing> = Vec::new();
    for c in all {
        let apart = |f: &Crossing| {
            let between = (f.bearing - c.bearing).abs();
            between.min(std::f32::consts::TAU - between) * RADIUS_MM * c.theta.sin()
        };
        if found.iter().all(|f| apart(f) > 0.3) {
            found.push(c);
        }
    }
    found
}

/// How a vessel that the photograph has at its border goes on beyond it.
#[derive(Debug)]
struct Join {
    /// Beside its place in the photograph, mm.
    off_mm: f32,
    /// Its direction in the photograph and beyond.
    came_deg: f32,
    goes_deg: f32,
    /// Width and darkness beyond, and the least darkness on the way there, in those of the photograph.
    width: f32,
    depth: f32,
    least: f32,
}

impl Join {
    /// `None` where the vessel ends, or runs along the border, in the photograph itself.
    fn of(own: &Crossing, photographed: Green, laid_on: Green) -> Option<Self> {
        let came_deg = own.heading_deg(photographed, -STEP);
        let inside = own.course(photographed, came_deg, -STEP, GIVES_WAY);
        let weakest = |course: &[Crossing]| course.iter().map(|c| c.depth).fold(f32::MAX, f32::min);
        if weakest(&inside) < 0.5 * own.depth || came_deg.abs() > 55.0 {
            return None;
        }
        let at = Crossing::near(laid_on, own.theta, own.bearing);
        let goes_deg = at.heading_deg(laid_on, STEP);
        let beyond = at.course(laid_on, goes_deg, STEP, LINE);
        let seam = at.course(laid_on, came_deg, -STEP, GIVES_WAY);
        let across = |course: &[Crossing], deg: f32| median(course, |c| c.width_mm) * deg.to_radians().cos();
        let before = median(&inside, |c| c.depth);
        Some(Join {
            off_mm: (at.bearing - own.bearing) * RADIUS_MM * own.theta.sin(),
            came_deg,
            goes_deg,
            width: across(&beyond, goes_deg) / across(&inside, came_deg),
            depth: median(&beyond, |c| c.depth) / before,
            least: weakest(&seam).min(at.depth) / before,
        })
    }

    fn is_smooth(&self) -> bool {
        self.off_mm.abs() < 0.04
            && (self.goes_deg - self.came_deg).abs() < 20.0
            && (0.75..1.4).contains(&self.width)
            && (0.8..1.3).contains(&self.depth)
            && self.least > 0.65
    }
}

#[test]
fn a_vessel_goes_on_as_wide_and_dark_and_straight_as_the_photograph_has_it() {
    let photograph = Photograph::new(shipped_photograph().unwrap());
    let border = |bearing: f32| photograph.border(photograph.towards(direction(bearing))).1;
    let photographed =
        |theta: f32, bearing: f32| photograph.at_share(direction(bearing), theta / border(bearing))[1];
    let map = bake(&photograph, SIZE as u32, Side::Left);
    let laid_on = |theta: f32, bearing: f32| {
        let rho = 2.0 * (0.5 * theta).sin() * map_scale() * SIZE as f32;
        let [x, y] = direction(bearing);
        let [u, v] = [x * rho, -y * rho].map(|c| c + 0.5 * SIZE as f32 - 0.5);
        let pixel = |x: f32, y: f32| f32::from(map[(y as usize * SIZE + x as usize) * 4 + 1]);
        let (i, j, fu, fv) = (u.floor(), v.floor(), u.fract(), v.fract());
        let row = |j| pixel(i, j) * (1.0 - fu) + pixel(i + 1.0, j) * fu;
        row(j) * (1.0 - fv) + row(j + 1.0) * fv
    };
    let own = trunks(&photographed, |bearing| 0.985 * border(bearing));
    let joins: Vec<Join> = own.iter().filter_map(|c| Join::of(c, &photographed, &laid_on)).collect();
    let rough: Vec<&Join> = joins.iter().filter(|join| !join.is_smooth()).collect();
    println!("{} trunks were compared: {joins:#?}", joins.len());
    assert!(joins.len() >= 10, "{} trunks were compared", joins.len());
    assert!(rough.is_empty(), "{} of {}: {rough:#?}", rough.len(), joins.len());
}
