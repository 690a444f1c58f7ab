//! How much successive pictures of a scene differ: what flickers or jumps draws the eye, however well
//! each picture looks on its own. Pictures are a field (20 ms) apart, levels those of 8 bits.

use crate::moments::ScenePlayer;
use protocol::scene::Section;
use renderer::gpu::Gpu;
use renderer::latch::latch_scene;
use renderer::offscreen::Offscreen;
use renderer::readback::Picture;
use renderer::reference_scene::SceneBlock;
use renderer::start::renderer_config;
use replay::film::scripted::FIELDS_PER_S;
use rig::Rig;

/// Change of a pixel within a field that is seen as a jump, levels.
pub const JUMP: u8 = 10;
/// A tool number without a tool: no instrument is drawn, and a chandelier lights the eye.
const NO_TOOL: u32 = 99;

/// What is drawn of a scene.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub enum Shown {
    /// All of it.
    Whole,
    /// The eye with its tissue, evenly lit: nothing moves but tissue, so what jumps is the drawing.
    Tissue,
}

/// Differences of successive pictures of both channels, over the pixels of the round fields.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct Stability {
    /// Pairs of pictures.
    pub pairs: u32,
    /// Mean, levels.
    pub mean: f64,
    /// That which 99.9 % of all pixels stay under, levels.
    pub most: u8,
    /// Pixels of the largest connected patch that changed by more than [`JUMP`], and the s at which.
    pub patch: (usize, f64),
}

/// Plays `player` from `from_s` until `to_s` and compares each picture at `tier` with that before.
///
/// # Panics
/// If the shipped meshes or the graphics driver fail.
pub fn watch(
    gpu: &Gpu,
    player: &mut ScenePlayer,
    [from_s, to_s]: [f64; 2],
    tier: usize,
    map_px: u32,
    shown: Shown,
) -> Stability {
    let rig = Rig::load_or_shipped(None).expect("the shipped rig");
    let config = renderer_config(&player.scene, &rig, tier, map_px);
    let mut offscreen = Offscreen::new(gpu.clone(), config).expect("shipped meshes and photograph");
    let (mut before, mut now) = (Picture::default(), Picture::default());
    let mut sums = Sums { levels: [0; 256], patch: (0, from_s) };
    let fields = |s: f64| (s * FIELDS_PER_S).round() as u64;
    for field in fields(from_s)..=fields(to_s) {
        let at_s = field as f64 / FIELDS_PER_S;
        let block = of(player.play_to(at_s), shown);
        let taken = offscreen.renderer.take_scene(gpu, &block.header, block.payload());
        taken.expect("a scene of the simulation");
        let latched = latch_scene(&block.header);
        if field == fields(from_s) {
            // Text follows with the next picture.
            offscreen.draw(tier, &latched);
        }
        offscreen.draw(tier, &latched);
        offscreen.read(tier, &mut now).expect("the picture");
        if field > fields(from_s) {
            sums.add(&before, &now, at_s);
        }
        std::mem::swap(&mut before, &mut now);
    }
    sums.stability((fields(to_s) - fields(from_s)) as u32)
}

fn of(mut block: SceneBlock, shown: Shown) -> SceneBlock {
    if shown == Shown::Tissue {
        block.header.instruments.iter_mut().for_each(|i| i.tool = NO_TOOL);
        (block.header.text, block.header.marks) = (Section::default(), Section::default());
        block.header.bodies = Section::default();
    }
    block
}

struct Sums {
    /// Pixels by their change.
    levels: [u64; 256],
    patch: (usize, f64),
}

impl Sums {
    fn add(&mut self, before: &Picture, now: &Picture, at_s: f64) {
        let jumped = changes(before, now).map(|change| {
            change.is_some_and(|c| {
                self.levels[usize::from(c)] += 1;
                c > JUMP
            })
        });
        let jumped: Vec<bool> = jumped.collect();
        let patch = largest_patch(jumped, now.width_px as usize);
        if patch > self.patch.0 {
            self.patch = (patch, at_s);
        }
    }

    fn stability(&self, pairs: u32) -> Stability {
        let all: u64 = self.levels.iter().sum();
        let sum: u64 = (0..).zip(&self.levels).map(|(level, n)| level * n).sum();
        let mut under = 0;
        let most = self.levels.iter().position(|n| {
            under += n;
            under as f64 >= 0.999 * all as f64
        });
        let mean = sum as f64 / all.max(1) as f64;
        Stability { pairs, mean, most: most.unwrap_or(0) as u8, patch: self.patch }
    }
}

/// Change of each pixel's luma; `None` outside the round fields.
fn changes<'a>(before: &'a Picture, now: &'a Picture) -> impl Iterator<Item = Option<u8>> + 'a {
    let luma = |p: &[u8]| (77 * u32::from(p[0]) + 150 * u32::from(p[1]) + 29 * u32::from(p[2])) / 256;
    let pixels = before.rgba.chunks_exact(4).zip(now.rgba.chunks_exact(4));
    pixels.map(move |(a, b)| {
        let (a, b) = (luma(a), luma(b));
        (a + b > 0).then(|| a.abs_diff(b) as u8)
    })
}

/// Pixels of the largest patch of neighbours that are all true.
fn largest_patch(mut open: Vec<bool>, width: usize) -> usize {
    let (mut largest, mut stack) = (0, Vec::new());
    for start in 0..open.len() {
        let mut size = 0;
        stack.push(start);
        while let Some(i) = stack.pop() {
            if open.get(i) == Some(&true) {
                open[i] = false;
                size += 1;
                stack.extend([i + 1, i + width, i.wrapping_sub(1), i.wrapping_sub(width)]);
            }
        }
        largest = largest.max(size);
    }
    largest
}

#[cfg(test)]
mod tests {
    use super::*;

    fn picture(level: impl Fn(u32) -> u8) -> Picture {
        let rgba = (0..64).flat_map(|i| [level(i); 3].into_iter().chain([255])).collect();
        Picture { width_px: 8, height_px: 8, rgba }
    }

    #[test]
    fn a_patch_that_jumps_is_found_and_measured() {
        let (before, same) = (picture(|_| 100), picture(|_| 100));
        // Two by three pixels, and one apart from them.
        let after = picture(|i| if [9, 10, 17, 18, 25, 26, 63].contains(&i) { 130 } else { 100 });
        let mut sums = Sums { levels: [0; 256], patch: (0, 0.0) };
        sums.add(&before, &same, 1.0);
        assert_eq!(sums.stability(1), Stability { pairs: 1, mean: 0.0, most: 0, patch: (0, 0.0) });
        sums.add(&same, &after, 2.0);
        let expected = 7.0 * 30.0 / 128.0;
        assert_eq!(sums.stability(2), Stability { pairs: 2, mean: expected, most: 30, patch: (6, 2.0) });
    }
}
