//! Hues in pictures: where they heap up, and which heap is which colour of the rig.

use fpga_model::colours::convert::GREY;
use fpga_model::colours::learn::{apart_deg, hue_deg};
use protocol::blobs::Colour;

/// Bins of hue.
const BINS: usize = 90;
/// Least distance from grey of a sample that counts.
const LEAST_CHROMA: f64 = 16.0;
/// A heap has at least this share of the largest one.
const LEAST_SHARE: f64 = 0.01;
/// Between two heaps there is a valley of at most this share of the lower one.
const VALLEY: f64 = 0.6;
/// Farthest that a colour may be from its usual hue, degrees.
const FARTHEST_DEG: f64 = 50.0;
/// What it costs to leave a colour without a heap: more than any distance.
const WITHOUT_DEG: f64 = 100.0;

/// Samples of one hue.
#[derive(Debug, Clone, PartialEq)]
pub struct Heap {
    /// Hue of its summit, degrees.
    pub hue_deg: f64,
    /// Its samples.
    pub samples: Vec<[u8; 3]>,
}

impl Heap {
    /// Median deviation of the samples' hues as a standard deviation, degrees.
    pub fn sigma_deg(&self) -> f64 {
        let mut off: Vec<f64> = self.samples.iter().map(|s| apart_deg(hue_deg(s), self.hue_deg)).collect();
        off.sort_by(f64::total_cmp);
        off.get(off.len() / 2).map_or(0.0, |m| 1.4826 * m)
    }
}

fn chroma(sample: &[u8; 3]) -> f64 {
    let [_, cb, cr] = sample.map(|v| f64::from(v) - f64::from(GREY));
    cb.hypot(cr)
}

fn bin(hue_deg: f64) -> usize {
    ((hue_deg + 180.0) / 360.0 * BINS as f64) as usize % BINS
}

/// The heaps of hue among samples, the largest first.
pub fn heaps(samples: &[[u8; 3]]) -> Vec<Heap> {
    let coloured: Vec<[u8; 3]> = samples.iter().filter(|s| chroma(s) >= LEAST_CHROMA).copied().collect();
    let mut counts = [0.0; BINS];
    // A colourful sample's hue is more certain.
    coloured.iter().for_each(|s| counts[bin(hue_deg(s))] += chroma(s) * chroma(s));
    let near =
        |i: usize, by: usize| (counts[(i + by) % BINS] + counts[(i + BINS - by) % BINS]) / (by + 1) as f64;
    let smooth: Vec<f64> = (0..BINS).map(|i| counts[i] + near(i, 1) + near(i, 2)).collect();
    let bounds = bounds(&smooth);
    let mut found: Vec<(f64, Heap)> = bounds
        .iter()
        .map(|&(first, bins)| {
            let inside = |s: &&[u8; 3]| (bin(hue_deg(s)) + BINS - first) % BINS < bins;
            let own: Vec<[u8; 3]> = coloured.iter().filter(inside).copied().collect();
            let of = |k: usize| smooth[(first + k) % BINS];
            let summit = (0..bins).max_by(|&a, &b| of(a).total_cmp(&of(b))).unwrap_or(0);
            let hue = ((first + summit) % BINS) as f64 + 0.5;
            let heap = Heap { hue_deg: hue / BINS as f64 * 360.0 - 180.0, samples: own };
            ((0..bins).map(of).sum(), heap)
        })
        .collect();
    found.sort_by(|a, b| b.0.total_cmp(&a.0));
    let largest = found.first().map_or(0.0, |f| f.0);
    found.retain(|f| f.0 >= LEAST_SHARE * largest && !f.1.samples.is_empty());
    found.into_iter().map(|f| f.1).collect()
}

/// First bin and number of bins of each heap: from valley to valley.
fn bounds(smooth: &[f64]) -> Vec<(usize, usize)> {
    let n = smooth.len();
    let mut peaks: Vec<usize> = (0..n)
        .filter(|&i| {
            smooth[i] > 0.0 && smooth[i] >= smooth[(i + 1) % n] && smooth[i] > smooth[(i + n - 1) % n]
        })
        .collect();
    let valley = |a: usize, b: usize| {
        let steps = (b + n - a) % n;
        let steps = if steps == 0 { n } else { steps };
        (0..=steps).map(|k| (a + k) % n).min_by(|&x, &y| smooth[x].total_cmp(&smooth[y])).unwrap_or(a)
    };
    // Shallow valleys go first, with the lower of their two peaks.
    while peaks.len() > 1 {
        let pairs = (0..peaks.len()).map(|i| (i, (i + 1) % peaks.len()));
        let depth = |&(i, j): &(usize, usize)| {
            smooth[valley(peaks[i], peaks[j])] / smooth[peaks[i]].min(smooth[peaks[j]])
        };
        let Some((i, j)) = pairs.max_by(|a, b| depth(a).total_cmp(&depth(b))) else { break };
        if depth(&(i, j)) <= VALLEY {
            break;
        }
        peaks.remove(if smooth[peaks[i]] < smooth[peaks[j]] { i } else { j });
    }
    let cuts: Vec<usize> =
        (0..peaks.len()).map(|i| valley(peaks[(i + peaks.len() - 1) % peaks.len()], peaks[i])).collect();
    (0..cuts.len())
        .map(|i| {
            let next = cuts[(i + 1) % cuts.len()];
            let bins = (next + n - cuts[i]) % n;
            (cuts[i], if bins == 0 { n } else { bins })
        })
        .collect()
}

/// Which heap is which colour: the pairing of least distance in hue; `None` for a colour that has no heap.
pub fn matched(colours: &[Colour], heaps: &[Heap]) -> Vec<Option<usize>> {
    fn best(colours: &[Colour], heaps: &[Heap], used: u64) -> (f64, Vec<Option<usize>>) {
        let Some((colour, rest)) = colours.split_first() else { return (0.0, Vec::new()) };
        let own = hue_deg(&colour.reference());
        let choices = heaps.iter().enumerate().map(|(i, heap)| (Some(i), apart_deg(heap.hue_deg, own)));
        let choices =
            choices.filter(|(i, off)| *off <= FARTHEST_DEG && i.is_some_and(|i| used & (1 << i) == 0));
        let all = choices.chain([(None, WITHOUT_DEG)]).map(|(choice, cost)| {
            let taken = choice.map_or(used, |i| used | (1 << i));
            let (more, mut after) = best(rest, heaps, taken);
            after.insert(0, choice);
            (cost + more, after)
        });
        all.min_by(|a, b| a.0.total_cmp(&b.0)).unwrap_or_default()
    }
    best(colours, &heaps[..heaps.len().min(12)], 0).1
}

#[cfg(test)]
mod tests {
    use super::*;

    /// Samples about a hue, with some spread.
    fn about(hue: f64, spread: f64, number: usize) -> Vec<[u8; 3]> {
        (0..number)
            .map(|i| {
                let t = ((i * 37 % 101) as f64 / 50.0 - 1.0) * spread;
                let (sin, cos) = (hue + t).to_radians().sin_cos();
                [120, (128.0 + 60.0 * cos).round() as u8, (128.0 + 60.0 * sin).round() as u8]
            })
            .collect()
    }

    #[test]
    fn heaps_lie_where_hues_are_and_across_the_seam() {
        let samples = [about(178.0, 8.0, 400), about(60.0, 5.0, 100), about(-100.0, 6.0, 300)].concat();
        let found = heaps(&samples);
        assert_eq!(found.len(), 3, "{:?}", found.iter().map(|h| h.hue_deg).collect::<Vec<_>>());
        for (heap, hue, number) in [(&found[0], 178.0, 400), (&found[1], -100.0, 300), (&found[2], 60.0, 100)]
        {
            assert!(apart_deg(heap.hue_deg, hue) <= 6.0, "{} for {hue}", heap.hue_deg);
            assert_eq!(heap.samples.len(), number);
            assert!((1.0..8.0).contains(&heap.sigma_deg()));
        }
        assert!(heaps(&[[200, 128, 128]; 50]).is_empty(), "grey has no hue");
        assert_eq!(heaps(&about(10.0, 20.0, 500)).len(), 1, "one broad hue is one heap");
    }

    /// Every colour by some degrees off in one direction, as a wrong white balance makes it: each is the nearest of
    /// itself, or of what is left.
    #[test]
    fn colours_off_their_usual_hue_are_still_told() {
        let colours = [Colour::Red, Colour::Yellow, Colour::Green, Colour::Cyan, Colour::Blue];
        let hue = |c: &Colour| hue_deg(&c.reference()) + 18.0;
        let heaps: Vec<Heap> =
            colours.iter().map(|c| Heap { hue_deg: hue(c), samples: about(hue(c), 3.0, 9) }).collect();
        assert_eq!(matched(&colours, &heaps), (0..5).map(Some).collect::<Vec<_>>());
        assert_eq!(matched(&colours, &heaps[..4])[4], None);
        assert_eq!(matched(&colours, &[]), vec![None; 5]);
    }
}
