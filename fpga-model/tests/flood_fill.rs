//! The streaming extractor against the slow and obvious way: a flood fill over the whole field.
//!
//! Both classify and weigh pixels alike; what is compared is everything after that: which pixels
//! belong together, which of them every weight counts for, and every sum, to the bit. The random
//! fields come from a seed.

use bytemuck::Zeroable;
use fpga_model::colours::{CLASSES, UNSURE};
use fpga_model::scan::limits::{FULL_WEIGHT, Limits, PICTURE};
use fpga_model::scan::owners::SKIRT;
use fpga_model::scan::runs::Run;
use fpga_model::scan::sums::{EMPTY_BOX, SATURATED, Sums};
use fpga_model::scan::weight::{LINES, Line, Weigher, slope};
use fpga_model::scan::{Scanner, Settings};
use protocol::blobs::{BlobField, Colour};
use protocol::fields::DARK;
use protocol::fields::FieldPicture;
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
    let [light, blue, red] = colour.reference();
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

/// Adds one pixel of a component to what does not depend on weights, by definition.
fn add_pixel(sums: &mut Sums, x: usize, y: usize, luma: u8) {
    sums.area += 1;
    sums.saturated += u32::from(luma >= SATURATED);
    sums.peak = sums.peak.max(luma);
    sums.contrast = sums.peak - DARK;
    let (x, y) = (x as u16, y as u16);
    let last = (sums.box_px[3], sums.last_x).max((y, x));
    grow(&mut sums.box_px, x, y);
    sums.last_x = if last.0 == y { last.1 } else { sums.last_x };
}

/// Adds one weight, by definition.
fn add_weight(sums: &mut Sums, x: usize, y: usize, weight: u8) {
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
    sums.rim += u32::from(weight > 0 && weight < FULL_WEIGHT);
    if weight >= FULL_WEIGHT / 2 {
        grow(&mut sums.half_box_px, x as u16, y as u16);
    }
}

fn grow(b: &mut [u16; 4], x: u16, y: u16) {
    *b = [b[0].min(x), b[1].max(x), b[2].min(y), b[3].max(y)];
}

/// No component.
const NOBODY: u32 = u32::MAX;

/// Buffers of the flood fill, kept between fields.
#[derive(Default)]
struct Flood {
    classes: Vec<u8>,
    /// The stretches of one class, line by line.
    runs: Vec<Vec<Run>>,
    /// Component of each pixel.
    of: Vec<u32>,
    all: Vec<Sums>,
    stack: Vec<usize>,
    weigher: Weigher,
    width: usize,
}

impl Flood {
    /// All components of a field that have a pixel of at least half the weight.
    fn components(&mut self, settings: &Settings, picture: &FieldPicture) -> Vec<Sums> {
        classes(settings, picture, &mut self.classes);
        self.width = picture.width;
        self.of.clear();
        self.of.resize(self.classes.len(), NOBODY);
        self.all.clear();
        for start in 0..self.classes.len() {
            if self.classes[start] != UNSURE && self.of[start] == NOBODY {
                self.fill(picture, start);
            }
        }
        self.runs = (0..picture.height).map(|y| self.runs_of(y)).collect();
        for y in 0..picture.height {
            self.add_weights(picture, y);
            self.add_surfaces(picture, y);
        }
        self.all.iter().copied().filter(|sums| sums.half_box_px[0] <= sums.half_box_px[1]).collect()
    }

    /// The component that holds pixel `start`.
    fn fill(&mut self, picture: &FieldPicture, start: usize) {
        let (width, height) = (picture.width, picture.height);
        let (id, class) = (self.all.len() as u32, self.classes[start]);
        let mut sums = Sums { class, half_box_px: EMPTY_BOX, box_px: EMPTY_BOX, ..Sums::default() };
        self.of[start] = id;
        self.stack.push(start);
        while let Some(i) = self.stack.pop() {
            let (x, y) = (i % width, i / width);
            add_pixel(&mut sums, x, y, picture.luma[i]);
            for ny in y.saturating_sub(1)..(y + 2).min(height) {
                for nx in x.saturating_sub(1)..(x + 2).min(width) {
                    let n = ny * width + nx;
                    if self.classes[n] == class && self.of[n] == NOBODY {
                        self.of[n] = id;
                        self.stack.push(n);
                    }
                }
            }
        }
        self.all.push(sums);
    }

    fn class(&self, x: usize, y: usize) -> u8 {
        self.classes[y * self.width + x]
    }

    fn runs_of(&self, y: usize) -> Vec<Run> {
        let line = &self.classes[y * self.width..][..self.width];
        let mut end = 0;
        let stretch = |run: &[u8]| {
            end += run.len() as u16;
            Run { start: end - run.len() as u16, end, class: run[0] }
        };
        line.chunk_by(|a, b| a == b).map(stretch).filter(|run| run.class != UNSURE).collect()
    }

    /// The coloured runs of a line with their skirts, as columns and component.
    fn dressed(&self, y: usize) -> Vec<(std::ops::Range<usize>, u32)> {
        let runs: Vec<_> =
            self.runs[y].iter().map(|r| (usize::from(r.start)..usize::from(r.end), r.class)).collect();
        let skirt = usize::from(SKIRT);
        let dress = |i: usize| {
            let run = &runs[i].0;
            let before = if i == 0 { run.start } else { (run.start - runs[i - 1].0.end) / 2 };
            let after =
                runs.get(i + 1).map_or(self.width - run.end, |next| (next.0.start - run.end).div_ceil(2));
            run.start - skirt.min(before)..run.end + skirt.min(after)
        };
        let coloured = (0..runs.len()).filter(|&i| runs[i].1 != Colour::White as u8);
        coloured.map(|i| (dress(i), self.of[y * self.width + runs[i].0.start])).collect()
    }

    /// Whom a pixel's weight counts for: the coloured run here, else whoever is above, below, or
    /// white here.
    fn owner(&self, dressed: &[(std::ops::Range<usize>, u32)], x: usize, y: usize, height: usize) -> u32 {
        if let Some((_, id)) = dressed.iter().find(|(columns, _)| columns.contains(&x)) {
            return *id;
        }
        let there = |y: usize| (self.class(x, y) != UNSURE).then(|| self.of[y * self.width + x]);
        let above = y.checked_sub(1).and_then(there);
        let below = || (y + 1 < height).then(|| there(y + 1)).flatten();
        above.or_else(below).or_else(|| there(y)).unwrap_or(NOBODY)
    }

    fn weigh(&mut self, picture: &FieldPicture, y: usize, columns: std::ops::Range<usize>, class: u8) {
        let around = std::array::from_fn(|i| {
            let y = (y + i).saturating_sub(LINES).min(picture.height - 1);
            Line { luma: picture.line(y).0, runs: &self.runs[y] }
        });
        self.weigher.weigh(&around, columns, class, u16::from(DARK) << 4);
    }

    /// Every pixel's weight to its owner.
    fn add_weights(&mut self, picture: &FieldPicture, y: usize) {
        let dressed = self.dressed(y);
        let owners: Vec<_> = (0..picture.width).map(|x| self.owner(&dressed, x, y, picture.height)).collect();
        let mut x = 0;
        for owned in owners.chunk_by(|a, b| a == b) {
            if owned[0] != NOBODY {
                let sums = owned[0] as usize;
                self.weigh(picture, y, x..x + owned.len(), self.all[sums].class);
                for (i, &weight) in self.weigher.weights.iter().enumerate() {
                    add_weight(&mut self.all[sums], x + i, y, weight);
                }
            }
            x += owned.len();
        }
    }

    /// Slope and grain of every dressed run.
    fn add_surfaces(&mut self, picture: &FieldPicture, y: usize) {
        for (columns, id) in self.dressed(y) {
            self.weigh(picture, y, columns.clone(), self.all[id as usize].class);
            let slope = slope(&picture.line(y).0[columns.clone()], u16::from(DARK) << 4);
            let sums = &mut self.all[id as usize];
            sums.rise += i64::from(slope.rise);
            sums.span += u64::from(slope.contrast);
            let full = |i: usize| self.weigher.weights[i] == FULL_WEIGHT;
            for i in (2..columns.len()).filter(|&i| full(i) && full(i - 2)) {
                let at = |i: usize| i64::from(picture.line(y).0[columns.start + i]);
                sums.grain += (at(i) - at(i - 2)).pow(2) as u64;
                sums.grains += 1;
            }
        }
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
