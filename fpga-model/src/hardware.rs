//! What the extractor costs in hardware: registers and memories in bits, clocks per line and per
//! blob.
//!
//! Everything is computed from the constants that the extractor itself runs with
//! ([`crate::scan::limits`]); nothing is written down twice.

use crate::colours;
use crate::scan::background::{LEVEL_WIDTH, blocks_along};
use crate::scan::limits::{
    DIVIDER_CLOCKS, LINE_CLOCKS, Limits, RUN_CLOCKS, SPLIT_CLOCKS, UNION_CLOCKS, Widths, bits,
};
use crate::scan::{COMPLETE_AFTER, weight};

/// Bits of a colour class.
const CLASS_BITS: u32 = bits(colours::CLASSES as u128 - 1);
/// Bits of a luma sample.
const LUMA_BITS: u32 = 8;

/// One register or memory.
#[derive(Debug, Clone, PartialEq, Eq, serde::Serialize)]
pub struct Resource {
    /// What it is for.
    pub name: &'static str,
    /// `register`: all words at once; `memory`: one word a clock.
    pub kind: &'static str,
    /// Words.
    pub depth: usize,
    /// Bits of a word.
    pub width: u32,
}

impl Resource {
    /// Bits in all.
    pub fn bits(&self) -> u64 {
        self.depth as u64 * u64::from(self.width)
    }
}

/// Bits of the moments of a component or of a run: weights, and 10 sums.
fn moment_bits(w: &Widths) -> u32 {
    w.w + w.wx + w.wy + w.wxx + w.wxy + w.wyy + w.wxxx + w.wxxy + w.wxyy + w.wyyy
}

/// Bits of a component's registers.
fn component_bits(w: &Widths) -> u32 {
    let counts = 3 * w.area;
    let boxes = 2 * (2 * w.x + 2 * w.y);
    let surface = w.rise + w.span + w.grain + w.area;
    moment_bits(w) + surface + counts + 2 * LUMA_BITS + CLASS_BITS + boxes + w.x
}

/// Bits of the sums along one run: those without y, which are the same for all its pixels.
fn run_sum_bits(limits: &Limits) -> u32 {
    let line = Limits { lines: 1, ..*limits }.widths();
    line.w + line.wx + line.wxx + line.wxxx + 3 * line.area + 2 * LUMA_BITS + 2 * line.x
}

/// All registers and memories of one camera.
pub fn resources(limits: &Limits) -> Vec<Resource> {
    let widths = limits.widths();
    let run = 2 * widths.x + CLASS_BITS;
    let blocks = blocks_along(limits.width, 0) * blocks_along(limits.lines, 1);
    let register = |name, depth, width| Resource { name, kind: "register", depth, width };
    let memory = |name, depth, width| Resource { name, kind: "memory", depth, width };
    let mut all = vec![
        memory("colour classes", colours::TABLE_DEPTH, CLASS_BITS),
        memory("background levels", blocks, LEVEL_WIDTH),
    ];
    all.extend(weight::MEMORIES.iter().map(|&(name, depth, width)| memory(name, depth, width)));
    all.extend([
        register("column and line counter", 1, widths.x + widths.y),
        memory("luma of the lines above and below", 2 * weight::LINES * limits.width, LUMA_BITS),
        register("luma around a pixel", (2 * weight::LINES + 1) * weight::WINDOW, LUMA_BITS),
        memory("runs being read", limits.runs, run),
        memory("runs of the four lines before", 2 * weight::LINES * limits.runs, run),
        register("sums of the current run", 1, run_sum_bits(limits)),
        register("labels of the runs", (2 * weight::LINES + 1) * limits.runs, widths.label + 1),
        register("labels in use", limits.labels, 1),
        memory("components", limits.labels, component_bits(&widths)),
        memory("components waiting for the divider", limits.blobs, component_bits(&widths)),
        register("divider", 1, 3 * u32::BITS),
        register("loss counters", 4, u32::BITS),
    ]);
    all
}

/// Clocks, computed and bounded.
#[derive(Debug, Clone, PartialEq, Eq, serde::Serialize)]
pub struct Clocks {
    /// Pixel clocks of a line, blanking included.
    pub line: u64,
    /// Bound on labelling the runs of a line and searching for complete components.
    pub labelling_at_most: u64,
    /// For one component in the divider.
    pub divider: u64,
    /// Additional clocks for two markers that touch.
    pub split: u64,
    /// From the last pixel of a blob to its output if no other blob waits: least and most.
    pub latency: [u64; 2],
}

/// The clocks of one camera.
pub fn clocks(limits: &Limits) -> Clocks {
    let labelling = limits.runs as u64 * (RUN_CLOCKS + UNION_CLOCKS) + limits.labels as u64;
    // A blob's last line is followed by one without it, which is weighed when the lines below are
    // known, and counted while the next is read. Its last pixel may have been the last or the first
    // of its line.
    let wait = |from_last_pixel: u64| from_last_pixel + COMPLETE_AFTER as u64 * LINE_CLOCKS + DIVIDER_CLOCKS;
    Clocks {
        line: LINE_CLOCKS,
        labelling_at_most: labelling,
        divider: DIVIDER_CLOCKS,
        split: SPLIT_CLOCKS,
        latency: [wait(LINE_CLOCKS - limits.width as u64 + 1) + 1, wait(LINE_CLOCKS) + limits.labels as u64],
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::scan::Scanner;
    use crate::scan::limits::{CAMERA, PICTURE};
    use crate::vectors::patterns;

    #[test]
    fn every_resource_has_a_size_and_the_camera_is_small() {
        for limits in [CAMERA, PICTURE] {
            assert!(resources(&limits).iter().all(|r| r.bits() > 0));
        }
        let total: u64 = resources(&CAMERA).iter().map(Resource::bits).sum();
        // Three cameras in the block memory of a small FPGA (Artix-7 35T: 1,800 kbit).
        assert!(3 * total < 1_800_000, "{total} bits");
    }

    #[test]
    fn blobs_leave_within_the_stated_clocks() {
        let clocks = clocks(&CAMERA);
        for pattern in patterns::all().iter().filter(|p| p.settings.limits == CAMERA) {
            let picture = &pattern.picture;
            let mut scanner = Scanner::new(pattern.settings.clone(), picture.width, picture.height);
            let mut latencies = Vec::new();
            let mut note = |found: crate::scan::Found| latencies.push(found.latency_clocks);
            scanner.begin();
            for y in 0..picture.height {
                let (luma, blue, red) = picture.line(y);
                scanner.line(luma, blue, red, &mut note);
            }
            scanner.end(&mut note);
            let waiting = latencies.len() as u64 * (clocks.divider + clocks.split);
            for latency in latencies {
                assert!(latency >= clocks.latency[0], "{}: {latency}", pattern.name);
                assert!(latency <= clocks.latency[1] + waiting, "{}: {latency}", pattern.name);
            }
        }
    }
}
