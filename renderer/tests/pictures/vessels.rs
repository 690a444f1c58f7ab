//! Vessels of the fundus photograph, projected by formulas written out here, against those found in
//! the picture. Vessels are the 12 % of pixels that are darkest in green against their
//! surroundings, after a smoothing that is the same on the retina; vessels cover about that share
//! of fundus photographs.

use crate::stage::Stage;
use glam::{DVec2, DVec3};
use renderer::latch::latch_scene;
use renderer::offscreen::Offscreen;
use renderer::readback::Picture;
use renderer::reference_scene::{Contents, scene_with};
use renderer::start::renderer_config;

/// Least overlap (Dice: twice what is common, by the sum of both).
const DICE: f64 = 0.8;
/// The tier of standard magnification: 2×1280×1024, full shading.
const TIER: usize = 0;
/// As fine as on a graphics card.
const MAP_PX: u32 = 2048;
/// Share of the retina taken for vessels.
const VESSELS: f64 = 0.12;
/// Half widths of the smoothing and of the surroundings, mm on the retina.
const SMOOTH_MM: f64 = 0.05;
const AROUND_MM: f64 = 0.35;

/// Where the fovea lies in the photograph, and the radius of its round field, share of its width.
const FOVEA: DVec2 = DVec2::new(0.503, 0.497);
const FIELD: f64 = 0.478;
/// Arc of the retina that this radius shows, mm: the disc is 0.345 widths and 4.5 mm from the
/// fovea.
const ARC_MM: f64 = 4.5 * FIELD / 0.345;
const RETINA_MM: f64 = 11.5;

/// A plane of numbers.
struct Plane {
    width: usize,
    values: Vec<f64>,
}

impl Plane {
    /// Means over a square of `half` to each side, clamped at the border.
    fn means(&self, half: usize) -> Plane {
        let once = self.means_along_rows(half).exchanged();
        once.means_along_rows(half).exchanged()
    }

    fn means_along_rows(&self, half: usize) -> Plane {
        let rows = self.values.chunks(self.width).flat_map(|row| {
            let sums: Vec<f64> = std::iter::once(0.0)
                .chain(row.iter().scan(0.0, |sum, v| {
                    *sum += v;
                    Some(*sum)
                }))
                .collect();
            (0..row.len()).map(move |x| {
                let (from, to) = (x.saturating_sub(half), (x + half + 1).min(sums.len() - 1));
                (sums[to] - sums[from]) / (to - from) as f64
            })
        });
        Plane { width: self.width, values: rows.collect() }
    }

    fn exchanged(&self) -> Plane {
        let height = self.values.len() / self.width;
        let values = (0..self.values.len()).map(|i| self.values[i % height * self.width + i / height]);
        Plane { width: height, values: values.collect() }
    }

    /// How much darker each place is than its surroundings, as a share of them.
    fn darkness(&self, px_per_mm: f64) -> Plane {
        let half = |mm: f64| (mm * px_per_mm).round().max(1.0) as usize;
        let (fine, around) = (self.means(half(SMOOTH_MM)), self.means(half(AROUND_MM)));
        let pairs = fine.values.iter().zip(&around.values);
        Plane { width: self.width, values: pairs.map(|(f, a)| (a - f) / a.max(1.0)).collect() }
    }
}

/// The left channel's green.
fn green(picture: &Picture) -> Plane {
    let width = picture.width_px / 2;
    let places = (0..picture.height_px).flat_map(|y| (0..width).map(move |x| (x, y)));
    Plane { width: width as usize, values: places.map(|(x, y)| f64::from(picture.rgb(x, y)[1])).collect() }
}

/// Where on the retina the left channel's pixel (x, y) looks.
fn on_retina(stage: &Stage, height_px: u32, width_px: u32, x: u32, y: u32) -> DVec3 {
    let m = &stage.file.microscope;
    let target = DVec3::from(m.target_in_world_mm);
    // The surgeon's left is +x, down is +y.
    let objective = target + DVec3::new(0.5 * m.stereo_base_mm, 0.0, m.working_distance_mm);
    let axis = (target - objective).normalize();
    let right = axis.cross(DVec3::NEG_Y).normalize();
    let down = axis.cross(right);
    let px = f64::from(height_px) * 0.98 / m.field_mm * objective.distance(target);
    let across = (f64::from(x) + 0.5 - 0.5 * f64::from(width_px)) / px;
    let along = (f64::from(y) + 0.5 - 0.5 * f64::from(height_px)) / px;
    let ray = (axis + right * across + down * along).normalize();
    let b = ray.dot(objective);
    let root = b * b - objective.length_squared() + RETINA_MM * RETINA_MM;
    objective + ray * (root.max(0.0).sqrt() - b)
}

/// The place of the photograph (shares of its width) that shows `p` of a right eye, and how far
/// from the fovea, as a share of the photograph's field.
fn in_photograph(p: DVec3) -> (DVec2, f64) {
    let arc_mm = RETINA_MM * (-p.z / RETINA_MM).clamp(-1.0, 1.0).acos();
    let share = arc_mm / ARC_MM;
    // The photograph shows a left eye: a right one is its mirror image.
    let towards = DVec2::new(-p.x, -p.y).normalize_or_zero();
    (FOVEA + towards * (FIELD * share), share)
}

fn picture(stage: &Stage) -> Picture {
    let config = renderer_config(&stage.file, &stage.rig, TIER, MAP_PX);
    let mut offscreen = Offscreen::new(stage.gpu.clone(), config).unwrap();
    let mut scene = scene_with(&stage.file, &stage.rig, [0.0; 3], 0.0, &Contents::default());
    // No instruments; a chandelier lights the eye.
    scene.header.instruments.iter_mut().for_each(|i| i.tool = 99);
    offscreen.renderer.take_scene(&stage.gpu, &scene.header, scene.payload()).unwrap();
    offscreen.draw(TIER, &latch_scene(&scene.header));
    let mut picture = Picture::default();
    offscreen.read(TIER, &mut picture).unwrap();
    picture
}

/// The value that a share of `values` exceeds.
fn exceeded_by(share: f64, values: impl Iterator<Item = f64>) -> f64 {
    let mut sorted: Vec<f64> = values.collect();
    sorted.sort_by(f64::total_cmp);
    sorted[((1.0 - share) * sorted.len() as f64) as usize]
}

#[test]
fn the_photographs_vessels_are_found_in_the_picture() {
    let Some(stage) = Stage::open() else { return };
    let photograph = renderer::assets::shipped_photograph().unwrap();
    let width = photograph.width();
    let values = photograph.pixels().map(|p| f64::from(p.0[1])).collect();
    let known = Plane { width: width as usize, values }.darkness(FIELD * f64::from(width) / ARC_MM);
    let picture = picture(&stage);
    let seen = green(&picture).darkness(f64::from(picture.height_px) * 0.98 / stage.file.microscope.field_mm);
    let (w, h) = (picture.width_px / 2, picture.height_px);
    let mut pairs = Vec::new();
    for [x, y] in (0..h).flat_map(|y| (0..w).map(move |x| [x, y])) {
        let (at, share) = in_photograph(on_retina(&stage, h, w, x, y));
        if share < 0.85 {
            let [u, v] = [at.x, at.y].map(|c| ((c * f64::from(width)) as usize).min(width as usize - 1));
            pairs.push([known.values[v * known.width + u], seen.values[(y * w + x) as usize]]);
        }
    }
    assert!(pairs.len() > 200_000, "most of the field shows the photograph: {}", pairs.len());
    let least = [0, 1].map(|i| exceeded_by(VESSELS, pairs.iter().map(|p| p[i])));
    let dice = |pairs: &[[f64; 2]], shift: usize| {
        let vessel = |i: usize, k: usize| f64::from(u8::from(pairs[k][i] > least[i]));
        let n = pairs.len() - shift;
        let both: f64 = (0..n).map(|k| vessel(0, k) * vessel(1, k + shift)).sum();
        2.0 * both / (0..n).map(|k| vessel(0, k) + vessel(1, k + shift)).sum::<f64>()
    };
    let found = dice(&pairs, 0);
    println!("Dice {found:.3} on {}", stage.gpu.name);
    assert!(found >= DICE, "Dice {found:.3} on {}", stage.gpu.name);
    // The measure drops for a picture that is shifted by 0.3 mm.
    assert!(dice(&pairs, 20) < 0.6);
}
