//! The streaming extractor against the slow and obvious way: a flood fill over the whole field.
//!
//! Both classify and weigh pixels alike; what is compared is everything after that: which pixels belong
//! together, and every sum over them, to the bit. The random fields come from a seed.

use bytemuck::Zeroable;
use fpga_model::colours::{CLASSES, ColourTable, DARK, UNSURE, reference};
use fpga_model::picture::FieldPicture;
use fpga_model::scan::limits::{FULL_WEIGHT, Limits, PICTURE};
use fpga_model::scan::sums::{EMPTY_BOX, SATURATED, Sums};
use fpga_model::scan::{Scanner, Settings, weight};
use protocol::blobs::{BlobField, Colour};
use rand::{Rng, SeedableRng};
use rand_chacha::ChaCha8Rng;

/// Small fields compared.
const SMALL_FIELDS: u64 = 100_000;
/// Fields of 720 × 288 compared.
const FULL_FIELDS: u64 = 50;

/// Tables that never overflow here, and components of any size and brightness.
fn settings() -> Settings {
    let limits = Limits { runs: 1024, labels: 1024, blobs: 1 << 20, ..PICTURE };
    Settings { limits, high: [0; CLASSES], least_area: 0, least_lines: 1, ..Settings::default() }
}

/// Numbers below `n`.
fn below(random: &mut ChaCha8Rng, n: usize) -> usize {
    (random.next_u32() as usize * n) >> 32
}

/// Fills a field with one of several kinds of disorder.
fn disorder(random: &mut ChaCha8Rng, picture: &mut FieldPicture) {
    let (width, height) = (picture.width, picture.height);
    picture.luma.fill(DARK);
    picture.blue.fill(128);
    picture.red.fill(128);
    match below(random, 4) {
        // Everything random: every class, mostly bright.
        0 => {
            random.fill_bytes(&mut picture.luma);
            random.fill_bytes(&mut picture.blue);
            random.fill_bytes(&mut picture.red);
        }
        // Single pixels of a few colours, sparse to dense.
        1 => {
            let density = 20 + below(random, 200) as u8;
            let colours = 1 + below(random, 3);
            let mut dice = vec![0u8; width * height];
            random.fill_bytes(&mut dice);
            for (i, d) in dice.iter().enumerate().filter(|(_, d)| **d < density) {
                dot(picture, i % width, i / width, Colour::ALL[usize::from(*d) % colours], *d);
            }
        }
        // Boxes that overlap.
        2 => {
            for _ in 0..below(random, 40) {
                let (x, y) = (below(random, width), below(random, height));
                let (w, h) = (1 + below(random, 12), 1 + below(random, 8));
                let (colour, shade) = (Colour::ALL[below(random, 7)], random.next_u32() as u8);
                for (x, y) in
                    (y..(y + h).min(height)).flat_map(|y| (x..(x + w).min(width)).map(move |x| (x, y)))
                {
                    dot(picture, x, y, colour, shade);
                }
            }
        }
        // One line that wanders about: spirals, hooks, combs.
        _ => {
            let (mut x, mut y) = (below(random, width), below(random, height));
            let mut way = 0;
            for _ in 0..width * height / 3 {
                dot(picture, x, y, Colour::Green, 200);
                if below(random, 5) == 0 {
                    way = below(random, 4);
                }
                let (dx, dy) = [(1, 0), (0, 1), (-1, 0), (0, -1)][way];
                x = x.saturating_add_signed(dx).min(width - 1);
                y = y.saturating_add_signed(dy).min(height - 1);
            }
        }
    }
}

fn dot(picture: &mut FieldPicture, x: usize, y: usize, colour: Colour, shade: u8) {
    let i = y * picture.width + x;
    let [light, blue, red] = reference(colour);
    picture.luma[i] = light.saturating_sub(shade % 64);
    (picture.blue[i / 2], picture.red[i / 2]) = (blue, red);
}

/// The class of each pixel; [`UNSURE`] where it does not stand out.
fn classes(settings: &Settings, picture: &FieldPicture, out: &mut Vec<u8>) {
    let table = &settings.colours;
    out.clear();
    for y in 0..picture.height {
        let (luma, blue, red) = picture.line(y);
        let stands_out = |x: usize| luma[x] >= DARK + settings.low;
        let own = |x: usize| table.class(blue[x / 2], red[x / 2]);
        for x in 0..picture.width {
            let class = if stands_out(x) {
                let left = (0..=x).rev().take_while(|&i| stands_out(i)).map(own).find(|&c| c != UNSURE);
                let right = (x..picture.width).take_while(|&i| stands_out(i)).map(own).find(|&c| c != UNSURE);
                left.or(right).unwrap_or(Colour::White as u8)
            } else {
                UNSURE
            };
            out.push(class);
        }
    }
}

/// The weight of each pixel: the same rule on the same runs.
fn weights(table: &ColourTable, picture: &FieldPicture, classes: &[u8], out: &mut Vec<u8>) {
    let mut run_weights = Vec::new();
    out.clear();
    for y in 0..picture.height {
        let (luma, ..) = picture.line(y);
        let classes = &classes[y * picture.width..][..picture.width];
        for run in classes.chunk_by(|a, b| a == b) {
            let start = out.len() % picture.width;
            if run[0] == UNSURE {
                out.resize(out.len() + run.len(), 0);
            } else {
                let range = start..start + run.len();
                weight::weights(table, luma, range, run[0], u16::from(DARK) << 4, &mut run_weights);
                out.extend_from_slice(&run_weights);
            }
        }
    }
}

/// Adds one pixel to the sums of its component, by definition.
fn add_pixel(sums: &mut Sums, x: usize, y: usize, luma: u8, weight: u8) {
    let (w, cx, cy) = (u64::from(weight), x as u64, y as u64);
    sums.w += w;
    sums.wx += w * cx;
    sums.wy += w * cy;
    sums.wxx += w * cx * cx;
    sums.wxy += w * cx * cy;
    sums.wyy += w * cy * cy;
    sums.wxxx += u128::from(w * cx * cx * cx);
    sums.wxxy += u128::from(w * cx * cx * cy);
    sums.wxyy += u128::from(w * cx * cy * cy);
    sums.wyyy += u128::from(w * cy * cy * cy);
    sums.area += 1;
    sums.rim += u32::from(weight > 0 && weight < FULL_WEIGHT);
    sums.saturated += u32::from(luma >= SATURATED);
    sums.peak = sums.peak.max(luma);
    sums.contrast = sums.peak - DARK;
    let (x, y) = (x as u16, y as u16);
    let grow = |b: &mut [u16; 4]| *b = [b[0].min(x), b[1].max(x), b[2].min(y), b[3].max(y)];
    let last = (sums.box_px[3], sums.last_x).max((y, x));
    grow(&mut sums.box_px);
    sums.last_x = if last.0 == y { last.1 } else { sums.last_x };
    if weight >= FULL_WEIGHT / 2 {
        grow(&mut sums.half_box_px);
    }
}

/// Buffers of the flood fill, kept between fields.
#[derive(Default)]
struct Flood {
    classes: Vec<u8>,
    weights: Vec<u8>,
    stack: Vec<usize>,
}

impl Flood {
    /// All components of a field that have a pixel of at least half the weight.
    fn components(&mut self, settings: &Settings, picture: &FieldPicture) -> Vec<Sums> {
        classes(settings, picture, &mut self.classes);
        weights(&settings.colours, picture, &self.classes, &mut self.weights);
        let all = (0..self.classes.len()).filter_map(|start| self.fill(picture, start));
        all.filter(|sums| sums.half_box_px[0] <= sums.half_box_px[1]).collect()
    }

    /// The component that holds pixel `start`, which is thereby wiped out.
    fn fill(&mut self, picture: &FieldPicture, start: usize) -> Option<Sums> {
        let class = std::mem::replace(&mut self.classes[start], UNSURE);
        if class == UNSURE {
            return None;
        }
        let (width, height) = (picture.width, picture.height);
        let mut sums = Sums { class, half_box_px: EMPTY_BOX, box_px: EMPTY_BOX, ..Sums::default() };
        self.stack.push(start);
        while let Some(i) = self.stack.pop() {
            let (x, y) = (i % width, i / width);
            add_pixel(&mut sums, x, y, picture.luma[i], self.weights[i]);
            for ny in y.saturating_sub(1)..(y + 2).min(height) {
                for nx in x.saturating_sub(1)..(x + 2).min(width) {
                    let n = ny * width + nx;
                    if self.classes[n] == class {
                        self.classes[n] = UNSURE;
                        self.stack.push(n);
                    }
                }
            }
        }
        Some(sums)
    }
}

fn key(sums: &Sums) -> (u8, [u16; 4], u64, u64, u64) {
    (sums.class, sums.box_px, sums.w, sums.wx, sums.wy)
}

/// Both ways over one field; how many components there were.
fn compare(flood: &mut Flood, scanner: &mut Scanner, settings: &Settings, picture: &FieldPicture) -> usize {
    let mut expected = flood.components(settings, picture);
    let mut found = Vec::with_capacity(expected.len());
    scanner.begin();
    for y in 0..picture.height {
        let (luma, blue, red) = picture.line(y);
        scanner.line(luma, blue, red, &mut |component| found.push(component.sums));
    }
    scanner.end(&mut |component| found.push(component.sums));
    assert_eq!(scanner.tally().lost(), 0);
    expected.sort_unstable_by_key(key);
    found.sort_unstable_by_key(key);
    assert!(found == expected, "{} × {}: {:?}", picture.width, picture.height, picture.luma);
    expected.len()
}

#[test]
fn components_of_small_fields_are_those_of_a_flood_fill() {
    let mut random = ChaCha8Rng::seed_from_u64(1);
    let (settings, mut flood) = (settings(), Flood::default());
    let mut components = 0;
    for _ in 0..SMALL_FIELDS {
        let size = [2 + 2 * below(&mut random, 48) as u32, 2 + 2 * below(&mut random, 64) as u32];
        let mut picture = FieldPicture::new(size);
        disorder(&mut random, &mut picture);
        let mut scanner = Scanner::new(settings.clone(), picture.width, picture.height);
        components += compare(&mut flood, &mut scanner, &settings, &picture);
    }
    assert!(components as u64 > 10 * SMALL_FIELDS, "{components} components in all");
}

#[test]
fn components_of_full_fields_are_those_of_a_flood_fill() {
    let mut random = ChaCha8Rng::seed_from_u64(2);
    let (settings, mut flood) = (settings(), Flood::default());
    let mut picture = FieldPicture::new([720, 576]);
    // One extractor for all: nothing of a field may stay for the next.
    let mut scanner = Scanner::new(settings.clone(), picture.width, picture.height);
    for _ in 0..FULL_FIELDS {
        disorder(&mut random, &mut picture);
        compare(&mut flood, &mut scanner, &settings, &picture);
    }
}

#[test]
fn whatever_the_tables_lack_is_counted_and_the_rest_is_right() {
    let mut random = ChaCha8Rng::seed_from_u64(3);
    let (mut flood, generous) = (Flood::default(), settings());
    let (mut scarce, mut enough) = (0, 0);
    for _ in 0..2_000 {
        let mut picture = FieldPicture::new([96, 128]);
        disorder(&mut random, &mut picture);
        let limits = Limits { runs: 24, labels: 1 + below(&mut random, 24), blobs: 30, ..PICTURE };
        let mut scanner = Scanner::new(Settings { limits, ..generous.clone() }, 96, 64);
        let mut out = BlobField::zeroed();
        scanner.scan(&picture, &mut out);
        let expected = flood.components(&generous, &picture).len();
        if scanner.tally().lost() == 0 {
            enough += 1;
            assert!(out.count as usize >= expected, "{} of {expected}", out.count);
        } else {
            scarce += 1;
            assert_eq!(out.blobs_left_out, scanner.tally().lost());
        }
    }
    assert!(scarce > 100 && enough > 20, "{scarce} fields with loss, {enough} without");
}
