//! Draws the vitreous of a scene while the script works on it: `cargo run --release -p validation
//! --example vitreous_picture [SCENE] [OUT.png]`. Three sections through the eye (at the start,
//! half way, at the end of a round): haze in grey, every second row of elements as it lies in blue,
//! elements that hold to the retina in green, those that came off in red. Below, the removed volume
//! over time, a line a tenth of a millilitre. Prints every event of the vitreous and the cost of
//! the steps.

use image::{Rgb, RgbImage};
use ipc::clock::now;
use scene::SceneFile;
use simcore::world::World;
use surgeon::rehearsal::Rehearsal;
use tissue::vitreous::Vitreous;
use tissue::vitreous::state::VitreousState;

/// Side of a section, pixels.
const SIDE: u32 = 440;
/// Height of the curve, pixels.
const CURVE: u32 = 160;
const GRID: Rgb<u8> = Rgb([70, 120, 220]);
const HOLDS: Rgb<u8> = Rgb([40, 200, 90]);
const LOOSE: Rgb<u8> = Rgb([240, 60, 50]);
const LINE: Rgb<u8> = Rgb([60, 60, 60]);
const VOLUME: Rgb<u8> = Rgb([250, 200, 80]);

/// A pixel of a section from a place in the plane of x and z, mm.
fn pixel(x_mm: f64, z_mm: f64, radius_mm: f64) -> [f64; 2] {
    let scale = f64::from(SIDE) / (2.1 * radius_mm);
    let half = f64::from(SIDE) * 0.5;
    [half + x_mm * scale, half - z_mm * scale]
}

fn line(picture: &mut RgbImage, left: u32, a: [f64; 2], b: [f64; 2], colour: Rgb<u8>) {
    let steps = (a[0] - b[0]).abs().max((a[1] - b[1]).abs()).ceil().max(1.0) as u32;
    for i in 0..=steps {
        let s = f64::from(i) / f64::from(steps);
        let (x, y) = (a[0] + (b[0] - a[0]) * s, a[1] + (b[1] - a[1]) * s);
        if x >= 0.0 && y >= 0.0 && (left + x as u32) < picture.width() && (y as u32) < picture.height() {
            picture.put_pixel(left + x as u32, y as u32, colour);
        }
    }
}

/// The densities in the section, as grey.
fn draw_haze(picture: &mut RgbImage, left: u32, gel: &Vitreous, y_mm: f32) {
    let radius = f64::from(gel.lattice().radius_um) * 1e-3;
    for brick in gel.haze().bricks() {
        let cell = brick.edge_mm / 8.0;
        let row = ((y_mm - brick.corner_mm[1]) / cell).floor();
        if !(0.0..8.0).contains(&row) {
            continue;
        }
        for (i, density) in (0..64).map(|i| (i, brick.density[i % 8 + 8 * (row as usize + 8 * (i / 8))])) {
            let corner = |dx: f32, dz: f32| {
                let x = brick.corner_mm[0] + ((i % 8) as f32 + dx) * cell;
                let z = brick.corner_mm[2] + ((i / 8) as f32 + dz) * cell;
                pixel(f64::from(x), f64::from(z), radius)
            };
            let ([x0, y1], [x1, y0]) = (corner(0.0, 0.0), corner(1.0, 1.0));
            for (y, x) in (y0 as u32..y1 as u32).flat_map(|y| (x0 as u32..x1 as u32).map(move |x| (y, x))) {
                if x < SIDE && y < SIDE {
                    picture.put_pixel(left + x, y, Rgb([density; 3]));
                }
            }
        }
    }
}

/// Elements of one layer, as they lie.
fn draw_elements(picture: &mut RgbImage, left: u32, gel: &Vitreous, state: &VitreousState) {
    let lattice = gel.lattice();
    let radius = f64::from(lattice.radius_um) * 1e-3;
    let layer = lattice.cells as i32 / 2;
    let at = |e: usize| {
        let [x, _, z] = state.place_um(lattice, e).map(|c| f64::from(c) * 1e-3);
        pixel(x, z, radius)
    };
    for e in lattice.numbers().filter(|&e| lattice.cell(e)[1] == layer && state.is_alive(e)) {
        let cell = lattice.cell(e);
        for (axis, k) in [(0, 1), (2, 5)] {
            let other = lattice.neighbour(e, k);
            let linked = lattice.links[e] >> k & 1 == 1 && state.is_alive(other);
            if linked && cell[2 - axis] % 2 == 0 {
                line(picture, left, at(e), at(other), GRID);
            }
        }
        if let Ok(wall) = lattice.walls.binary_search_by_key(&(e as u32), |w| w.element) {
            let colour = if state.is_adhered(lattice.walls[wall].element as usize) { HOLDS } else { LOOSE };
            let [x, y] = at(e);
            line(picture, left, [x - 1.0, y], [x + 1.0, y], colour);
            line(picture, left, [x, y - 1.0], [x, y + 1.0], colour);
        }
    }
}

fn draw_curve(picture: &mut RgbImage, removed_ml: &[f64]) {
    let most = removed_ml.iter().copied().fold(0.1, f64::max);
    let bottom = f64::from(SIDE + CURVE) - 4.0;
    let height = |ml: f64| bottom - ml / most * (f64::from(CURVE) - 12.0);
    let width = f64::from(3 * SIDE);
    for tenth in 0..=(most * 10.0) as u32 {
        let y = height(f64::from(tenth) * 0.1);
        line(picture, 0, [0.0, y], [width - 1.0, y], LINE);
    }
    let x = |i: usize| i as f64 / removed_ml.len() as f64 * (width - 1.0);
    for (i, pair) in removed_ml.windows(2).enumerate() {
        line(picture, 0, [x(i), height(pair[0])], [x(i + 1), height(pair[1])], VOLUME);
    }
}

fn main() -> Result<(), Box<dyn std::error::Error>> {
    let mut args = std::env::args().skip(1);
    let scene = SceneFile::load(&args.next().unwrap_or("vitrectomy".into()))?;
    let out = args.next().unwrap_or("vitreous.png".into());
    let rehearsal = Rehearsal::shipped(&scene);
    let mut world = World::new(&scene)?;
    let mut picture = RgbImage::new(3 * SIDE, SIDE + CURVE);
    let (mut removed_ml, mut times) = (Vec::new(), Vec::new());
    let fields = rehearsal.fields();
    for field in 0..fields {
        if let Some(panel) = [0, fields / 2, fields - 1].iter().position(|&f| f == field) {
            let (gel, state) = world.vitreous().ok_or("the scene has no vitreous")?;
            let left = panel as u32 * SIDE;
            draw_haze(&mut picture, left, gel, gel.lattice().pitch_um as f32 * 0.5e-3);
            draw_elements(&mut picture, left, gel, state);
        }
        let begin = now();
        world.step(&rehearsal.inputs(field).input(), &mut now);
        times.push((now() - begin) as f64 * 1e-3);
        for event in world.events().iter().filter(|e| (80..90).contains(&e.kind)) {
            let (text, unit) = event.info().map_or(("", ""), |e| (e.text, e.unit));
            let at = event.position_in_eye_mm.map(|c| (c * 100.0).round() / 100.0);
            println!("{:6.2} s  {text}: {:.3} {unit} at {at:?}", field as f64 * 0.02, event.value);
        }
        let (gel, state) = world.vitreous().ok_or("the scene has no vitreous")?;
        removed_ml.push(state.removed_um3(gel.lattice()) as f64 * 1e-12);
    }
    draw_curve(&mut picture, &removed_ml);
    picture.save(&out)?;
    times.sort_by(f64::total_cmp);
    let (gel, state) = world.vitreous().ok_or("the scene has no vitreous")?;
    let left_ml = state.remaining_um3(gel.lattice()) as f64 * 1e-12;
    println!(
        "{:.3} ml removed, {left_ml:.3} left, {:.1} mm² off the retina",
        removed_ml.last().unwrap_or(&0.0),
        state.released as f64 * (f64::from(gel.lattice().pitch_um) * 1e-3).powi(2)
    );
    let at = |share: f64| times[((times.len() - 1) as f64 * share) as usize];
    println!("step: median {:.0} µs, p99 {:.0}, most {:.0}; picture in {out}", at(0.5), at(0.99), at(1.0));
    Ok(())
}
