//! How near centres come to what the noise allows, on pictures with a known truth.
//!
//! The pictures are integrated here, chord by chord, and share no code with the painter; a second
//! round uses the painter's image model with its shading, movement and colour carrier. The
//! Cramér–Rao bound comes from the same noiseless rendering: derivatives by the centre, the two
//! half axes, the brightness and the background, weighed with the noise of each pixel, give the
//! Fisher information; the first two diagonal elements of its inverse are the least variances that
//! any unbiased estimate can have.

use bytemuck::Zeroable;
use fpga_model::scan::{Scanner, Settings};
use nalgebra::{DMatrix, Matrix2, Vector2};
use protocol::blobs::{BLOB_CLIPPED, BLOB_MERGED, BLOB_SATURATED, Blob, BlobField, Colour};
use protocol::fields::FieldPicture;
use rand::{Rng, SeedableRng};
use rand_chacha::ChaCha8Rng;
use std::f64::consts::{FRAC_1_SQRT_2, TAU};
use virtual_rig::painter::{ImageModel, Painter, Patch};
use virtual_rig::projection::MarkerImage;

/// Field of one camera.
const SIZE: [usize; 2] = [720, 288];
/// Columns as long as the distance of two lines: fx/(fy/2) of the shipped cameras.
const ASPECT: f64 = 2.0 * 54.0 / 59.0;
/// Chords in a line.
const CHORDS: usize = 12;

/// What a picture is made with.
#[derive(Debug, Clone, Copy)]
struct Optics {
    colour: Colour,
    /// Half width of a marker, px.
    radius: f64,
    /// Blur: σ along the line, px, and across, lines.
    blur: [f64; 2],
    /// Read noise, levels, and shot noise, levels² a level.
    noise: [f64; 2],
    /// How much brighter than its middle a marker is at its right and its lower end.
    shade: [f64; 2],
    background: f64,
    /// Movement during the exposure: columns and lines.
    smear: [f64; 2],
}

const USUAL: Optics = Optics {
    colour: Colour::Red,
    radius: 10.5,
    blur: [0.9, 0.4],
    noise: [2.0, 0.01],
    shade: [0.0; 2],
    background: 30.0,
    smear: [0.0; 2],
};

/// A marker: centre (column, line), half axes, brightness above the background, background.
type Marker = [f64; 6];

/// The normal distribution Φ.
fn normal(z: f64) -> f64 {
    0.5 * libm::erfc(-z * FRAC_1_SQRT_2)
}

/// Its antiderivative.
fn ramp(z: f64) -> f64 {
    z * normal(z) + libm::exp(-z * z / 2.0) / TAU.sqrt()
}

/// Share of a pixel `at` from an edge, positive inside, for blur `s`: a Gaussian, averaged over the
/// pixel.
fn behind(at: f64, s: f64) -> f64 {
    s * (ramp((at + 0.5) / s) - ramp((at - 0.5) / s))
}

/// Expected luma of the pixels from `corner` on, line by line, `size` in all.
fn render(optics: &Optics, marker: &Marker, corner: [usize; 2], size: [usize; 2]) -> Vec<f64> {
    let steps = if optics.smear == [0.0; 2] { 1 } else { 8 };
    let mut cover = vec![0.0; size[0] * size[1]];
    for step in 0..steps {
        let t = (step as f64 + 0.5) / steps as f64 - 0.5;
        let centre = [0, 1].map(|i| marker[i] + t * optics.smear[i] - corner[i] as f64);
        add_cover(optics, centre, [marker[2], marker[3]], size, 1.0 / steps as f64, &mut cover);
    }
    let lit = |i: usize| {
        let at = [(i % size[0] + corner[0]) as f64, (i / size[0] + corner[1]) as f64];
        let shade: f64 = (0..2).map(|k| optics.shade[k] * (at[k] - marker[k]) / marker[2 + k]).sum();
        marker[5] + marker[4] * (1.0 + shade) * cover[i]
    };
    (0..cover.len()).map(lit).collect()
}

/// Adds how far an ellipse covers each pixel: chord by chord along the lines, each chord spread
/// over lines.
fn add_cover(
    optics: &Optics,
    centre: [f64; 2],
    half: [f64; 2],
    size: [usize; 2],
    part: f64,
    cover: &mut [f64],
) {
    let mut row = vec![0.0; size[0]];
    let chords = (2.0 * half[1] * CHORDS as f64).ceil();
    for chord in 0..chords as usize {
        let u = (2.0 * chord as f64 + 1.0) / chords - 1.0;
        let (y, reach) = (centre[1] + u * half[1], half[0] * (1.0 - u * u).sqrt());
        for (x, value) in row.iter_mut().enumerate() {
            let x = x as f64 - centre[0];
            *value = behind(x + reach, optics.blur[0]) - behind(x - reach, optics.blur[0]);
        }
        let thick = 2.0 * half[1] / chords;
        for line in 0..size[1] {
            let away = line as f64 - y;
            if away.abs() > 4.0 * optics.blur[1] + 1.0 {
                continue;
            }
            let spread = normal((away + 0.5) / optics.blur[1]) - normal((away - 0.5) / optics.blur[1]);
            let share = thick * spread * part;
            for (pixel, value) in cover[line * size[0]..][..size[0]].iter_mut().zip(&row) {
                *pixel += share * value;
            }
        }
    }
}

/// Numbers from a seed.
struct Dice(ChaCha8Rng);

impl Dice {
    fn new(seed: u64) -> Self {
        Dice(ChaCha8Rng::seed_from_u64(seed))
    }

    /// Between two numbers.
    fn between(&mut self, from: f64, to: f64) -> f64 {
        from + (to - from) * (f64::from(self.0.next_u32()) + 0.5) / 4_294_967_296.0
    }

    /// A normal number (Box and Muller 1958).
    fn normal(&mut self) -> f64 {
        let (u, v) = (self.between(0.0, 1.0), self.between(0.0, 1.0));
        (-2.0 * libm::log(u)).sqrt() * libm::cos(TAU * v)
    }
}

/// Variance of a pixel that is expected to show `mean`: reading, photons, rounding.
fn variance(optics: &Optics, mean: f64) -> f64 {
    optics.noise[0] * optics.noise[0] + optics.noise[1] * (mean - 16.0).max(0.0) + 1.0 / 12.0
}

/// Least variances of centre x and y (px of the field, squared) for expected pictures by parameter.
fn bound(at: impl Fn(&Marker) -> Vec<f64>, variance: impl Fn(f64) -> f64, marker: &Marker) -> [f64; 2] {
    let mean = at(marker);
    let steps: Marker = [0.05, 0.05, 0.05, 0.05, 0.02, 0.02];
    let slopes: Vec<Vec<f64>> = (0..6)
        .map(|i| {
            let moved = |by: f64| {
                let mut marker = *marker;
                marker[i] += by;
                at(&marker)
            };
            let (up, down) = (moved(steps[i]), moved(-steps[i]));
            up.iter().zip(&down).map(|(u, d)| (u - d) / (2.0 * steps[i])).collect()
        })
        .collect();
    let information = DMatrix::from_fn(6, 6, |i, j| {
        let terms = slopes[i].iter().zip(&slopes[j]).zip(&mean);
        terms.map(|((a, b), m)| a * b / variance(*m)).sum::<f64>()
    });
    let inverse = information.try_inverse().expect("every parameter shows in the picture");
    [inverse[(0, 0)], inverse[(1, 1)]]
}

/// Errors of many blobs.
#[derive(Default)]
struct Figures {
    errors: Vec<[f64; 2]>,
    /// Squared errors over the variances that the blobs claim.
    scaled: Vec<[f64; 2]>,
    bounds: Vec<[f64; 2]>,
}

impl Figures {
    fn mean(all: &[[f64; 2]], of: impl Fn(f64) -> f64) -> [f64; 2] {
        [0, 1].map(|axis| all.iter().map(|v| of(v[axis])).sum::<f64>() / all.len() as f64)
    }

    fn add(&mut self, blob: &Blob, truth: [f64; 2]) {
        let error = [blob.x_px - truth[0], blob.y_field_px - truth[1]];
        // The blob's variance across is of lines of the frame.
        let claimed = [blob.var_x_px2, blob.var_y_px2 / 4.0];
        self.scaled.push([0, 1].map(|i| error[i] * error[i] / claimed[i]));
        self.errors.push(error);
    }

    fn bias(&self) -> [f64; 2] {
        Self::mean(&self.errors, |e| e)
    }

    fn rms(&self) -> [f64; 2] {
        Self::mean(&self.errors, |e| e * e).map(f64::sqrt)
    }

    fn chi2(&self) -> [f64; 2] {
        Self::mean(&self.scaled, |s| s)
    }

    /// Standard deviations over the bound.
    fn over_bound(&self) -> [f64; 2] {
        let (rms, bound) = (self.rms(), Self::mean(&self.bounds, |b| b).map(f64::sqrt));
        [0, 1].map(|i| rms[i] / bound[i])
    }

    fn print(&self, name: &str) {
        let ([rx, ry], [bx, by], [cx, cy]) = (self.rms(), self.bias(), self.chi2());
        print!(
            "{name:26} {:4} blobs: rms {rx:.4} px {ry:.4} lines, bias {bx:+.4} {by:+.4}",
            self.errors.len()
        );
        print!(", error² over variance {cx:.2} {cy:.2}");
        if !self.bounds.is_empty() {
            let [ox, oy] = self.over_bound();
            print!(", times the bound {ox:.2} {oy:.2}");
        }
        println!();
    }
}

/// Markers in a field lie in tiles of this size, one in each.
const TILE: [usize; 2] = [80, 40];

/// A field with every tile's marker drawn and its noise added.
struct Scene {
    picture: FieldPicture,
    dice: Dice,
}

impl Scene {
    fn new(optics: &Optics, seed: u64) -> Self {
        let mut picture = FieldPicture::new([SIZE[0] as u32, 2 * SIZE[1] as u32]);
        let mut dice = Dice::new(seed);
        for luma in &mut picture.luma {
            *luma = (optics.background + optics.noise[0] * dice.normal() + 0.5) as u8;
        }
        Scene { picture, dice }
    }

    /// Draws a tile whose expected luma is `mean`; chroma reaches a little further than luma.
    fn draw(&mut self, optics: &Optics, corner: [usize; 2], mean: &[f64]) {
        let lit = f64::from(optics.colour.reference()[0]) - optics.background;
        for (i, &mean) in mean.iter().enumerate() {
            let at = (corner[1] + i / TILE[0]) * SIZE[0] + corner[0] + i % TILE[0];
            let noisy = mean + variance(optics, mean).sqrt() * self.dice.normal();
            self.picture.luma[at] = (noisy + 0.5) as u8;
            if mean - optics.background > 0.1 * lit {
                let [_, blue, red] = optics.colour.reference();
                (self.picture.blue[at / 2], self.picture.red[at / 2]) = (blue, red);
            }
        }
    }

    fn blobs(&self) -> BlobField {
        let mut field = BlobField::zeroed();
        Scanner::new(Settings::default(), SIZE[0], SIZE[1]).scan(&self.picture, &mut field);
        field
    }
}

fn nearest(field: &BlobField, [x, y]: [f64; 2]) -> &Blob {
    let distance = |b: &Blob| (b.x_px - x).hypot(b.y_field_px - y);
    let blob = field.blobs().iter().min_by(|a, b| distance(a).total_cmp(&distance(b))).expect("a blob");
    assert!(distance(blob) < 2.0, "no blob at {x} {y}: {blob:?}");
    blob
}

/// Corners of the tiles of a field.
fn tiles() -> impl Iterator<Item = [usize; 2]> {
    let [columns, lines] = [0, 1].map(|i| SIZE[i] / TILE[i]);
    (0..columns * lines).map(move |i| [i % columns * TILE[0], i / columns * TILE[1]])
}

/// Draws and extracts `fields` fields of isolated markers at random places.
fn isolated(optics: &Optics, fields: u64) -> Figures {
    let mut figures = Figures::default();
    let lit = f64::from(optics.colour.reference()[0]) - optics.background;
    for seed in 0..fields {
        let mut scene = Scene::new(optics, seed + 1);
        let mut truth = Vec::new();
        for (i, corner) in tiles().enumerate() {
            let place = |axis: usize, dice: &mut Dice| {
                (corner[axis] + TILE[axis] / 2) as f64 + dice.between(-1.0, 1.0)
            };
            let (x, y) = (place(0, &mut scene.dice), place(1, &mut scene.dice));
            let radius = optics.radius * scene.dice.between(0.92, 1.08);
            let marker = [x, y, radius, radius / ASPECT, lit, optics.background];
            scene.draw(optics, corner, &render(optics, &marker, corner, TILE));
            truth.push([x, y]);
            if i % 16 == 0 {
                let picture = |m: &Marker| render(optics, m, corner, TILE);
                figures.bounds.push(bound(picture, |mean| variance(optics, mean), &marker));
            }
        }
        let field = scene.blobs();
        assert_eq!(field.count as usize, truth.len());
        for at in truth {
            let blob = nearest(&field, at);
            assert_eq!((blob.flags, blob.colour), (0, optics.colour as u32), "{blob:?}");
            figures.add(blob, at);
        }
    }
    figures
}

#[test]
fn isolated_blobs_come_near_the_least_variance() {
    let cases = [
        ("usual", USUAL),
        ("darkest colour", Optics { colour: Colour::Blue, radius: 13.5, ..USUAL }),
        ("small and bright", Optics { colour: Colour::Cyan, radius: 7.5, noise: [2.0, 0.02], ..USUAL }),
        ("noisy", Optics { noise: [4.0, 0.04], ..USUAL }),
        ("blurred", Optics { blur: [1.6, 0.7], ..USUAL }),
        ("moving", Optics { smear: [3.0, 0.7], ..USUAL }),
        ("background not as set", Optics { background: 32.0, ..USUAL }),
    ];
    for (name, optics) in cases {
        let figures = isolated(&optics, 4);
        figures.print(name);
        let ([x, y], bias, chi2) = (figures.over_bound(), figures.bias(), figures.chi2());
        assert!(x < 1.5 && y < 1.5, "{name}: {x:.2} and {y:.2} times the bound");
        assert!(bias.iter().all(|b| b.abs() < 0.01), "{name}: bias {bias:?}");
        assert!(chi2.iter().all(|c| (0.15..2.0).contains(c)), "{name}: claimed variance {chi2:?}");
    }
}

/// The centre of light of a tile, as far as it stands out from the background by a quarter of the
/// contrast.
fn intensity_centre(picture: &FieldPicture, optics: &Optics, corner: [usize; 2]) -> [f64; 2] {
    let lit = f64::from(optics.colour.reference()[0]) - optics.background;
    let mut sums = [0.0; 3];
    for y in corner[1]..corner[1] + TILE[1] {
        for x in corner[0]..corner[0] + TILE[0] {
            let light = f64::from(picture.luma[y * SIZE[0] + x]) - optics.background;
            if light > lit / 4.0 {
                [1.0, x as f64, y as f64].iter().zip(&mut sums).for_each(|(v, sum)| *sum += v * light);
            }
        }
    }
    [sums[1] / sums[0], sums[2] / sums[0]]
}

#[test]
fn light_from_one_side_hardly_moves_centres() {
    for shade in [[0.04, 0.0], [-0.04, 0.0], [0.0, 0.04], [0.0, -0.04]] {
        let optics = Optics { shade, radius: 18.0, ..USUAL };
        let figures = isolated(&optics, 2);
        figures.print(&format!("shaded {shade:?}"));
        assert!(figures.bias().iter().all(|b| b.abs() < 0.04), "{shade:?}: bias {:?}", figures.bias());
        // The same light moves the centre of intensity by a quarter of its share of the half axis.
        let mut scene = Scene::new(&optics, 9);
        let marker = [40.0, 20.0, optics.radius, optics.radius / ASPECT, 84.0, 30.0];
        scene.draw(&optics, [0, 0], &render(&optics, &marker, [0, 0], TILE));
        let plain = intensity_centre(&scene.picture, &optics, [0, 0]);
        let axis = usize::from(shade[0] == 0.0);
        let moved = (plain[axis] - marker[axis]).abs();
        assert!(moved > 0.007 * marker[2 + axis], "{shade:?}: intensity is off by {moved}");
    }
}

#[test]
fn touching_markers_are_told_apart_and_say_so() {
    let mut figures = Figures::default();
    for seed in 0..2 {
        let mut scene = Scene::new(&USUAL, seed + 1);
        let mut truth = Vec::new();
        for corner in tiles().step_by(2).take(31) {
            let dice = &mut scene.dice;
            let radii = [0; 2].map(|_| dice.between(9.5, 10.5));
            let angle = dice.between(0.0, TAU);
            let apart = radii[0] + radii[1] - dice.between(0.0, 1.5);
            let middle = [0, 1].map(|axis| (corner[axis] + TILE[axis] / 2) as f64 + dice.between(-1.0, 1.0));
            let markers = [(-0.5, radii[0]), (0.5, radii[1])].map(|(side, r)| {
                let (x, y) = (side * apart * libm::cos(angle), side * apart * libm::sin(angle) / ASPECT);
                [middle[0] + x, middle[1] + y, r, r / ASPECT, 84.0, 30.0]
            });
            // The nearer hides the further where they overlap.
            let [a, b] = markers.map(|marker| render(&USUAL, &marker, corner, TILE));
            let both: Vec<f64> =
                a.iter().zip(&b).map(|(a, b)| (a + b - 30.0).min(114.0).max(a.max(*b))).collect();
            scene.draw(&USUAL, corner, &both);
            truth.extend(markers.map(|m| [m[0], m[1]]));
        }
        let field = scene.blobs();
        assert_eq!(field.count as usize, truth.len());
        for at in truth {
            let blob = nearest(&field, at);
            assert_eq!(blob.flags, BLOB_MERGED);
            figures.add(blob, at);
        }
    }
    figures.print("touching");
    let (rms, chi2) = (figures.rms(), figures.chi2());
    assert!(rms[0] < 0.08 && rms[1] < 0.05, "{rms:?}");
    assert!(chi2.iter().all(|c| (0.05..2.5).contains(c)), "{chi2:?}");
}

#[test]
fn markers_cut_by_the_border_or_too_bright_say_so() {
    let mut cut = Figures::default();
    let mut bright = Figures::default();
    for seed in 0..40 {
        let mut scene = Scene::new(&USUAL, seed + 1);
        let (x, y) = (scene.dice.between(1.0, 9.0), scene.dice.between(14.0, 26.0));
        let marker = [x, y, 10.0, 10.0 / ASPECT, 84.0, 30.0];
        scene.draw(&USUAL, [0, 0], &render(&USUAL, &marker, [0, 0], TILE));
        let glaring = Optics { colour: Colour::Yellow, ..USUAL };
        let centre = [0, 1].map(|_| scene.dice.between(-1.0, 1.0));
        let marker = [200.0 + centre[0], 100.0 + centre[1], 10.0, 10.0 / ASPECT, 215.0, 30.0];
        scene.draw(&glaring, [160, 80], &render(&glaring, &marker, [160, 80], TILE));
        let field = scene.blobs();
        let clipped = field.blobs().iter().find(|b| b.x_px < 30.0).expect("the cut marker");
        assert_eq!(clipped.flags & BLOB_CLIPPED, BLOB_CLIPPED);
        cut.add(clipped, [x, y]);
        let glare = nearest(&field, [marker[0], marker[1]]);
        assert_eq!(glare.flags, BLOB_SATURATED);
        bright.add(glare, [marker[0], marker[1]]);
    }
    cut.print("cut by the border");
    bright.print("saturated");
    assert!(cut.chi2()[0] < 4.0 && cut.chi2()[1] < 2.0, "{:?}", cut.chi2());
    assert!(bright.chi2().iter().all(|c| *c < 2.0), "{:?}", bright.chi2());
}

/// The painter's markers, one a tile, with its shading, movement and colour carrier; and its own
/// bound.
#[test]
fn painted_fields_come_near_the_least_variance_too() {
    let model = ImageModel { side_shade: 0.0, ..ImageModel::default() };
    let painter = Painter::with_model([SIZE[0] as u32, 2 * SIZE[1] as u32], 5, model);
    let mut picture = FieldPicture::new([SIZE[0] as u32, 2 * SIZE[1] as u32]);
    let (mut figures, mut dice) = (Figures::default(), Dice::new(3));
    for number in 0..4u64 {
        let parity = (number & 1) as f64;
        let patch = |marker: &Marker, smear: Vector2<f64>| {
            let axes = Vector2::new(marker[2] * marker[2], 4.0 * marker[3] * marker[3]);
            let centre_px = Vector2::new(marker[0], 2.0 * marker[1] + parity);
            let shape_px2 = Matrix2::from_diagonal(&axes);
            let image = MarkerImage {
                body: 0,
                marker: 0,
                colour: Colour::Green,
                centre_px,
                shape_px2,
                depth_mm: 80.0,
            };
            Patch { smear_px: smear, ..Patch::from(image) }
        };
        let markers: Vec<_> = tiles()
            .map(|corner| {
                let [x, y] = [0, 1].map(|i| (corner[i] + TILE[i] / 2) as f64 + dice.between(-1.0, 1.0));
                let radius = dice.between(9.5, 11.0);
                let smear = Vector2::new(dice.between(-1.5, 1.5), dice.between(-1.5, 1.5));
                ([x, y, radius, radius / ASPECT, 1.0, 0.0], smear, corner)
            })
            .collect();
        let patches = markers.iter().map(|(marker, smear, _)| patch(marker, *smear));
        painter.paint(patches, &virtual_rig::painter::Light::default(), 0, number, &mut picture);
        let mut field = BlobField::zeroed();
        Scanner::new(Settings::default(), SIZE[0], SIZE[1]).scan(&picture, &mut field);
        for (i, (marker, smear, corner)) in markers.iter().enumerate() {
            figures.add(nearest(&field, [marker[0], marker[1]]), [marker[0], marker[1]]);
            if i % 16 == 0 {
                let mean = |m: &Marker| -> Vec<f64> {
                    let seen = Patch { brightness: m[4], ..patch(m, *smear) };
                    let pixel = |i: usize| {
                        let at = [i % TILE[0] + corner[0], i / TILE[0] + corner[1]].map(|v| v as f64);
                        m[5] + model.mean_luma(&seen, number, SIZE, at[0], at[1])
                    };
                    (0..TILE[0] * TILE[1]).map(pixel).collect()
                };
                let mut steps = *marker;
                steps[4] = 1.0;
                figures.bounds.push(bound(mean, |mean| model.luma_variance(mean) + 1.0 / 12.0, &steps));
            }
        }
    }
    figures.print("painted, green");
    let ([x, y], bias) = (figures.over_bound(), figures.bias());
    assert!(x < 1.5 && y < 1.5, "{x:.2} and {y:.2} times the bound");
    assert!(bias.iter().all(|b| b.abs() < 0.01), "bias {bias:?}");
    assert!(figures.chi2().iter().all(|c| (0.25..2.0).contains(c)), "claimed variance {:?}", figures.chi2());
}
