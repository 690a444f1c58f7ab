//! The retina against what it must obey: fluid that balances over any programme, Laplace and
//! Kendall at the front, limits below which nothing happens, tears that leave a consistent mesh.

use nalgebra::{UnitVector3, Vector3};
use scene::SceneFile;
use tissue::needle::Needle;
use tissue::retina::Retina;
use tissue::retina::state::RetinaState;
use tissue::retina::volume::Cap;
use tissue::sheet::state::NODE_PINNED;
use tissue::sheet::tearing::check_mesh;

/// A retina with one needle, stepped without a world.
struct Bench {
    model: Retina,
    state: RetinaState,
    substep: u64,
}

impl Bench {
    fn new(change: impl FnOnce(&mut SceneFile)) -> Self {
        let mut scene = SceneFile::load("relocation").unwrap();
        change(&mut scene);
        let (model, state) = Retina::new(&scene).unwrap().unwrap();
        Bench { model, state, substep: 0 }
    }

    /// A needle at an eccentricity and azimuth (rad), its tip so far behind the retina (mm),
    /// pressing (Pa) and moving (mm/s).
    fn needle(
        &self,
        [ecc, azimuth]: [f64; 2],
        depth_mm: f64,
        pressure_pa: f64,
        velocity: Vector3<f64>,
    ) -> Needle {
        let out = Vector3::new(ecc.sin() * azimuth.cos(), ecc.sin() * azimuth.sin(), -ecc.cos());
        Needle {
            tip_in_eye_mm: out * (self.model.figures.radius_mm + depth_mm),
            axis_in_eye: UnitVector3::new_normalize(-out),
            velocity_mm_s: velocity,
            radius_mm: 0.05,
            pressure_pa,
        }
    }

    fn run(&mut self, needle: Option<Needle>, fields: u64) {
        for _ in 0..fields {
            self.model.begin_step(&self.state);
            for _ in 0..20 {
                self.model.follow_needle(&mut self.state, 0, needle.as_ref());
                let inside = self.state.needles[0].inside;
                let pressure = needle.filter(|n| inside && n.pressure_pa > 0.0).map(|n| n.pressure_pa);
                self.model.flow(&mut self.state, [pressure, None]);
                self.model.substep(&mut self.state, self.substep);
                self.substep += 1;
            }
            self.model.end_step(&mut self.state);
        }
    }

    fn inject(&mut self, at: [f64; 2], pressure_pa: f64, fields: u64) {
        let needle = self.needle(at, 0.1, pressure_pa, Vector3::zeros());
        self.run(Some(needle), fields);
    }

    fn loose(&self) -> usize {
        self.model.blebs.loose().len()
    }

    /// Fluid is where the account says, and the mesh agrees with it to the rounding of its
    /// positions.
    fn check(&self) {
        let (s, a) = (&self.state, self.state.account);
        assert!((a.injected_mm3 - a.leaked_mm3 - s.under_mm3()).abs() < 1e-9 * (1.0 + a.injected_mm3));
        let error = self.model.measured_all_mm3(s) - s.under_mm3();
        assert!(error.abs() < 2e-4, "mesh less account: {error:e} mm³ of {}", s.under_mm3());
        assert_eq!(check_mesh(&self.model.body.mesh, &s.sheet), Ok(()));
        assert_eq!(self.model.check(s), Ok(()));
    }
}

#[test]
fn below_the_limit_nothing_comes_off() {
    let mut b = Bench::new(|_| {});
    b.inject([0.1, 0.0], 41_000.0, 25);
    assert!(b.state.needles[0].inside);
    assert_eq!((b.loose(), b.state.account.injected_mm3), (0, 0.0));
    b.run(None, 1);
    assert_eq!(b.state.holes.len(), 1, "but the needle left a hole");
}

#[test]
fn more_pressure_takes_more_off_at_once_and_in_time() {
    let off = |pressure: f64, fields: u64| {
        let mut b = Bench::new(|_| {});
        b.inject([0.1, 0.3], pressure, fields);
        b.check();
        (b.loose(), b.state.account.injected_mm3)
    };
    let pressures = [45_000.0, 60_000.0, 90_000.0, 150_000.0];
    for fields in [1, 60] {
        let found = pressures.map(|p| off(p, fields));
        assert!(found.windows(2).all(|w| w[0].0 <= w[1].0 && w[0].1 < w[1].1), "{found:?}");
        assert!(found[0].0 < found[3].0, "{found:?}");
    }
}

/// What a bleb's front would release by Laplace's law and Kendall's energy, from its pressure and
/// shape alone as one would measure them from outside, as a share of the adhesion that the scene
/// states.
fn laplace_energy(b: &Bench) -> f64 {
    let (figures, radius) = (&b.model.figures, b.model.figures.radius_mm);
    let bleb = b.state.blebs[0];
    // The base: the area of choroid inside the front, as a cap of the sphere. A loose node stands
    // for a third of each of its triangles.
    let home = |n: u32| b.model.home_mm[n as usize].map(f64::from);
    let share = b.model.body.mesh.triangles.iter().map(|t| {
        let [p, q, r] = t.map(home);
        let loose = t.iter().filter(|&&n| b.state.sheet.flag[n as usize] != NODE_PINNED).count();
        0.5 * (q - p).cross(&(r - p)).norm() * loose as f64 / 3.0
    });
    let sag = share.sum::<f64>() / (std::f64::consts::TAU * radius);
    let base_mm = (sag * (2.0 * radius - sag)).sqrt();
    // Height of the cap over the base plane from the volume, which is that cap and the choroid's
    // under it.
    let over = bleb.volume_mm3 - Cap { base_mm, height_mm: sag }.volume_mm3();
    let (mut low, mut high) = (0.0, 2.0 * base_mm);
    for _ in 0..60 {
        let height_mm = 0.5 * (low + high);
        let below = (Cap { base_mm, height_mm }).volume_mm3() < over;
        (low, high) = if below { (height_mm, high) } else { (low, height_mm) };
    }
    let cap = Cap { base_mm, height_mm: low };
    let tension = 0.5 * bleb.pressure_pa * cap.radius_mm();
    let angle = cap.contact_angle_rad() + (base_mm / radius).asin();
    figures.release_un_per_mm(tension * angle.sin(), tension * angle.cos()) / figures.adhesion_un_per_mm
}

/// The front comes off ring by ring, so the load swings; it must reach the adhesion before each
/// advance and never stay over it.
fn peak_load(rings: u32) -> f64 {
    let mut b = Bench::new(|s| s.retina.as_mut().unwrap().rings = rings);
    b.inject([0.0, 0.0], 75_000.0, 200);
    let mut peaks = Vec::new();
    let mut last = (b.loose(), 0.0);
    for _ in 0..400 {
        b.inject([0.0, 0.0], 75_000.0, 1);
        let now = (b.loose(), laplace_energy(&b));
        if now.0 > last.0 && last.1 > 0.0 {
            peaks.push(last.1);
        }
        last = now;
    }
    b.check();
    peaks.iter().sum::<f64>() / peaks.len() as f64
}

#[test]
fn the_front_advances_where_laplace_and_kendall_say() {
    let found = [16, 24, 36].map(peak_load);
    assert!(found.iter().all(|load| (0.9..1.2).contains(load)), "{found:?}");
}

#[test]
fn blebs_that_meet_add_their_accounts() {
    let mut b = Bench::new(|_| {});
    b.inject([0.2, 0.0], 75_000.0, 200);
    b.run(None, 1);
    let mut most = 0;
    for _ in 0..80 {
        b.inject([0.22, std::f64::consts::PI], 90_000.0, 10);
        b.check();
        if b.state.blebs.len() == 1 {
            break;
        }
        most = b.state.blebs.len();
    }
    assert_eq!((most, b.state.blebs.len()), (2, 1), "{:?}", b.state.blebs);
    assert!((b.state.blebs[0].volume_mm3 - b.state.under_mm3()).abs() < 1e-12 && b.state.under_mm3() > 12.0);
}

#[test]
fn fluid_balances_over_a_long_random_programme() {
    let mut seed = 20_021_109u64;
    let mut random = || {
        seed = seed.wrapping_mul(6364136223846793005).wrapping_add(1442695040888963407);
        (seed >> 40) as f64 / (1u64 << 24) as f64
    };
    let mut b = Bench::new(|s| s.retina.as_mut().unwrap().rings = 14);
    let (mut torn, mut blebs) = (0, 0);
    for round in 0..60 {
        let at = [0.05 + 0.5 * random(), std::f64::consts::TAU * random()];
        let fast = round % 7 == 3;
        let velocity = Vector3::new(if fast { 60.0 } else { 0.0 }, 0.0, 0.0);
        let pressure = if random() < 0.8 { 30_000.0 + 90_000.0 * random() } else { 0.0 };
        let needle = b.needle(at, 0.1, pressure, velocity);
        b.state.air = round % 10 == 9;
        b.run((round % 3 != 2).then_some(needle), 6);
        b.check();
        torn += b.state.sheet.triangle_alive.iter().filter(|&&a| a == 0).count();
        blebs = blebs.max(b.state.blebs.len());
    }
    let a = b.state.account;
    assert!(a.injected_mm3 > 3.0 && a.leaked_mm3 > 0.1 && torn > 0 && blebs > 1, "{a:?} {torn} {blebs}");
}

#[test]
fn a_needle_warns_when_it_moves_and_tears_when_it_rushes() {
    let mut b = Bench::new(|_| {});
    let mut told = Vec::new();
    for speed in [3.0, 10.0, 10.0, 3.0, 10.0] {
        let needle = b.needle([0.1, 0.0], 0.1, 0.0, Vector3::new(0.0, speed, 0.0));
        for _ in 0..60 {
            told.extend(b.model.follow_needle(&mut b.state, 0, Some(&needle)).fast_mm_s);
        }
    }
    assert_eq!(told.len(), 2, "once each time it becomes fast: {told:?}");
    assert!(b.state.sheet.triangle_alive.iter().all(|&a| a == 1));
    let needle = b.needle([0.1, 0.0], 0.1, 0.0, Vector3::new(0.0, 50.0, 0.0));
    (0..60).for_each(|_| {
        b.model.follow_needle(&mut b.state, 0, Some(&needle));
    });
    let torn = b.state.sheet.triangle_alive.iter().filter(|&&a| a == 0).count();
    assert!(torn >= 2, "{torn}");
    b.check();
}

#[test]
fn a_torn_bleb_loses_its_fluid() {
    let mut b = Bench::new(|_| {});
    b.inject([0.1, 0.0], 80_000.0, 100);
    let before = b.state.under_mm3();
    let rush = b.needle([0.1, 0.0], 0.1, 0.0, Vector3::new(0.0, 80.0, 0.0));
    b.run(Some(rush), 2);
    assert!(b.state.blebs.iter().any(|bleb| bleb.torn_mm2 > 0.0));
    b.run(None, 30);
    b.check();
    assert!(b.state.under_mm3() < 0.8 * before, "{} of {before}", b.state.under_mm3());
}

#[test]
fn a_tip_over_a_bleb_is_as_near_as_the_bleb_is_high() {
    let mut b = Bench::new(|_| {});
    b.inject([0.0, 0.0], 80_000.0, 100);
    let top =
        (0..b.state.sheet.nodes()).map(|n| 11.5 - b.state.sheet.position(n).norm()).fold(0.0f32, f32::max);
    assert!(top > 0.5);
    let tip = Vector3::new(0.01, 0.01, -9.5);
    let over = b.model.clearance(&b.state, &tip);
    assert!(over.loose && (over.mm - (2.0 - f64::from(top))).abs() < 0.1, "{over:?} {top}");
    let beside = b.model.clearance(&b.state, &Vector3::new(9.0, 0.0, 0.0));
    assert_eq!((beside.loose, beside.mm), (false, 2.5));
    let under = b.model.clearance(&b.state, &Vector3::new(0.01, 0.01, -11.4));
    assert!(under.loose && under.mm < 0.0, "{under:?}");
}

#[test]
fn bad_numbers_are_taken_out_and_the_rest_goes_on() {
    let mut b = Bench::new(|_| {});
    b.inject([0.1, 0.0], 80_000.0, 60);
    for bad in [f32::NAN, f32::INFINITY, 1e30] {
        let node = b.model.blebs.loose()[0] as usize;
        b.model.begin_step(&b.state);
        b.state.sheet.position_mm[1][node] = bad;
        (0..20).for_each(|k| b.model.substep(&mut b.state, k));
        b.model.end_step(&mut b.state);
        assert!(
            (1..8).contains(&b.model.take_counts().sheet.disabled.count),
            "the node, or the few that its force ran away with"
        );
        b.run(None, 3);
        assert!(b.state.sheet.position_mm.iter().flatten().all(|c| c.abs() < 12.0), "{bad}");
        assert!(b.state.under_mm3().is_finite());
        assert_eq!(check_mesh(&b.model.body.mesh, &b.state.sheet), Ok(()));
    }
}
