//! Recorded motion of a hand: M2S2 recordings (250 Hz, `sample,x,y,z,grip`, mm, no header), played
//! in a mirrored loop so that their end joins their beginning without a jump.

use nalgebra::Vector3;
use protocol::file::{MAX_TABLE_BYTES, read_bytes, rows};
use std::f64::consts::TAU;
use std::path::Path;

/// Samples a second.
const RATE_HZ: f64 = 250.0;
/// Movement below this is voluntary, above it tremor, Hz.
const SPLIT_HZ: f64 = 1.0;
/// Shortest recording that can be split at 1 Hz: two periods.
const MIN_SAMPLES: usize = 500;
/// Largest coordinate taken for a position of a hand, mm.
const MAX_MM: f64 = 1000.0;

/// A recording was refused.
#[derive(Debug, thiserror::Error)]
pub enum RecordedMotionError {
    /// The file cannot be read.
    #[error("motion file {file}: {source}")]
    Read {
        /// The file.
        file: String,
        /// Cause.
        source: std::io::Error,
    },
    /// A line is malformed.
    #[error("motion file {file}, line {line}: expected {expected}, found {found}")]
    Line {
        /// The file.
        file: String,
        /// Counted from 1.
        line: usize,
        /// Expected content.
        expected: String,
        /// Content found.
        found: String,
    },
    /// Too little is left once the padding is dropped.
    #[error(
        "motion file {file}: expected at least {MIN_SAMPLES} samples before the zero padding, found {found}"
    )]
    Short {
        /// The file.
        file: String,
        /// Samples found.
        found: usize,
    },
}

/// Displacements of a hand about its mean, 250 a second.
#[derive(Debug, Clone, PartialEq)]
pub struct RecordedMotion {
    /// mm.
    samples: Vec<Vector3<f64>>,
}

impl RecordedMotion {
    /// Reads a recording.
    ///
    /// # Errors
    /// [`RecordedMotionError::Read`] where the file cannot be read, else as [`Self::parse`].
    pub fn load(path: &Path) -> Result<Self, RecordedMotionError> {
        let file = path.display().to_string();
        let bytes = read_bytes(path, MAX_TABLE_BYTES)
            .map_err(|source| RecordedMotionError::Read { file: file.clone(), source })?;
        Self::parse(&String::from_utf8_lossy(&bytes), &file)
    }

    /// Parses a recording; the padding of zeros at its end is dropped. `file` is for error
    /// messages.
    ///
    /// # Errors
    /// Where a line is not five finite numbers in order, or fewer than 500 samples are left.
    pub fn parse(text: &str, file: &str) -> Result<Self, RecordedMotionError> {
        let mut samples = Vec::new();
        let mut previous = None;
        for (line, row) in rows(text) {
            let cells: Vec<&str> = row.iter().collect();
            let (number, position) = parse_row(&cells, previous).map_err(|(expected, found)| {
                RecordedMotionError::Line { file: file.into(), line, expected, found }
            })?;
            previous = Some(number);
            samples.push(position);
        }
        let used = samples.iter().rposition(|p| *p != Vector3::zeros()).map_or(0, |last| last + 1);
        if used < MIN_SAMPLES {
            return Err(RecordedMotionError::Short { file: file.into(), found: used });
        }
        samples.truncate(used);
        let mean = samples.iter().sum::<Vector3<f64>>() / used as f64;
        samples.iter_mut().for_each(|p| *p -= mean);
        Ok(RecordedMotion { samples })
    }

    /// The part above [`SPLIT_HZ`]. The slow part is subtracted without a shift in phase: a
    /// second-order Butterworth filter run forward and backward over the mirrored loop.
    pub fn fast_part(&self) -> RecordedMotion {
        let mirrored = 2 * (self.samples.len() - 1);
        let looped: Vec<_> = (0..mirrored as i64).map(|i| self.sample(i)).collect();
        let forward = low_pass(&looped);
        let mut slow = low_pass(&forward.into_iter().rev().collect::<Vec<_>>());
        slow.reverse();
        RecordedMotion { samples: self.samples.iter().zip(&slow).map(|(p, s)| p - s).collect() }
    }

    /// Shrunk, where it must be, so that no displacement is longer than `reach_mm`.
    pub fn fitted(&self, reach_mm: f64) -> RecordedMotion {
        let longest = self.samples.iter().map(|p| p.norm()).fold(0.0, f64::max);
        let scale = if longest > reach_mm { reach_mm / longest } else { 1.0 };
        RecordedMotion { samples: self.samples.iter().map(|p| p * scale).collect() }
    }

    /// Displacement `t_s` seconds after the start, mm; Catmull–Rom between the samples.
    pub fn at(&self, t_s: f64) -> Vector3<f64> {
        let place = t_s * RATE_HZ;
        let whole = libm::floor(place);
        let (i, s) = (whole as i64, place - whole);
        let [a, b, c, d] = [i - 1, i, i + 1, i + 2].map(|i| self.sample(i));
        let bend = (b - c) * 3.0 + d - a;
        b + ((c - a) + (a * 2.0 - b * 5.0 + c * 4.0 - d + bend * s) * s) * (0.5 * s)
    }

    /// Seconds until the recording turns back.
    pub fn length_s(&self) -> f64 {
        (self.samples.len() - 1) as f64 / RATE_HZ
    }

    /// Sample `i` of the endless mirrored loop.
    fn sample(&self, i: i64) -> Vector3<f64> {
        let last = self.samples.len() as i64 - 1;
        let in_loop = i.rem_euclid(2 * last);
        self.samples[in_loop.min(2 * last - in_loop) as usize]
    }
}

/// One row as sample number and position, or what was expected and found.
fn parse_row(row: &[&str], previous: Option<f64>) -> Result<(f64, Vector3<f64>), (String, String)> {
    const NAMES: [&str; 5] = ["sample number", "x", "y", "z", "grip force"];
    if row.len() != NAMES.len() {
        return Err(("5 columns sample,x,y,z,grip".into(), format!("{}", row.len())));
    }
    let mut numbers = [0.0; 5];
    for ((text, name), number) in row.iter().zip(NAMES).zip(&mut numbers) {
        let parsed = text.parse::<f64>().ok().filter(|v| v.is_finite());
        *number = parsed.ok_or_else(|| (format!("a finite number for {name}"), format!("{text:?}")))?;
    }
    let [sample, x, y, z, _] = numbers;
    if let Some(previous) = previous.filter(|p| sample != p + 1.0) {
        return Err((format!("sample number {}", previous + 1.0), sample.to_string()));
    }
    if [x, y, z].iter().any(|c| c.abs() > MAX_MM) {
        return Err((format!("positions within {MAX_MM} mm"), format!("{x}, {y}, {z}")));
    }
    Ok((sample, Vector3::new(x, y, z)))
}

/// Second-order Butterworth low-pass (bilinear transform) of a periodic signal: one round to
/// settle, one that counts.
fn low_pass(looped: &[Vector3<f64>]) -> Vec<Vector3<f64>> {
    let k = libm::tan(TAU / 2.0 * SPLIT_HZ / RATE_HZ);
    let norm = 1.0 / (1.0 + std::f64::consts::SQRT_2 * k + k * k);
    let gain = k * k * norm;
    let (a1, a2) = (2.0 * (k * k - 1.0) * norm, (1.0 - std::f64::consts::SQRT_2 * k + k * k) * norm);
    let (mut x1, mut x2, mut y1, mut y2) = Default::default();
    let mut out = Vec::with_capacity(looped.len());
    for round in 0..2 {
        for &x in looped {
            let y: Vector3<f64> = (x + x1 * 2.0 + x2) * gain - y1 * a1 - y2 * a2;
            (x2, x1, y2, y1) = (x1, x, y1, y);
            if round == 1 {
                out.push(y);
            }
        }
    }
    out
}

#[cfg(test)]
mod tests {
    use super::*;
    use proptest::prelude::*;

    /// A hand that moves along x as `f` of seconds, with padding behind it.
    fn recording(samples: usize, f: impl Fn(f64) -> f64) -> String {
        let moving = (0..samples).map(|i| format!("{i}.000000,{:.6},5.0,5.0,190.1\n", f(i as f64 / RATE_HZ)));
        let padding = (samples..samples + 40).map(|i| format!("{i}.000000,0.0,0.0,0.0,200.0\n"));
        moving.chain(padding).collect()
    }

    fn rms(values: impl Iterator<Item = f64>) -> f64 {
        let (n, sum) = values.fold((0, 0.0), |(n, sum), v| (n + 1, sum + v * v));
        (sum / f64::from(n)).sqrt()
    }

    #[test]
    fn padding_is_dropped_and_the_loop_has_no_jump() {
        let hand = RecordedMotion::parse(&recording(1000, |t| t), "h.csv").unwrap();
        assert_eq!(hand.samples.len(), 1000);
        for i in 0..4000 {
            let t = f64::from(i) * 0.0031;
            assert!((hand.at(t + 1e-3) - hand.at(t)).norm() < 0.0014, "jump at {t}");
        }
        assert!((hand.at(2.0 * hand.length_s()) - hand.at(0.0)).norm() < 1e-12);
    }

    #[test]
    fn fast_part_keeps_tremor_and_drops_drift() {
        let tremor = |t: f64| 0.05 * libm::sin(TAU * 9.0 * t);
        let whole =
            RecordedMotion::parse(&recording(2500, |t| 3.0 * libm::cos(TAU * 0.1 * t) + tremor(t)), "h")
                .unwrap();
        let fast = whole.fast_part();
        let error = rms((250..2250).map(|i| fast.samples[i].x - tremor(i as f64 / RATE_HZ)));
        assert!(error < 0.002, "{error}");
    }

    #[test]
    fn fitted_hand_stays_within_reach() {
        let hand = RecordedMotion::parse(&recording(1000, |t| 10.0 * libm::sin(t)), "h").unwrap();
        let longest = |h: &RecordedMotion| h.samples.iter().map(|p| p.norm()).fold(0.0, f64::max);
        assert!((longest(&hand.fitted(2.0)) - 2.0).abs() < 1e-9);
        assert_eq!(hand.fitted(100.0), hand);
    }

    #[test]
    fn defects_are_named_with_file_and_line() {
        let good = recording(1000, |t| t);
        let cases = [
            ("7.000000,", "7.000000,NaN,1.0,", "line 8", "5 columns"),
            ("7.000000,0.028000", "7.000000,NaN", "line 8", "finite number for x"),
            ("7.000000,0.028000", "7.000000,", "line 8", "finite number for x"),
            ("7.000000,0.028000", "7.000000,1e9", "line 8", "within 1000 mm"),
            ("7.000000,", "9.000000,", "line 8", "sample number 7"),
            (",190.1\n", "\n", "line 1", "5 columns"),
        ];
        for (from, to, line, named) in cases {
            let broken = good.replacen(from, to, 1);
            assert_ne!(broken, good, "{from} is not in the recording");
            let error = RecordedMotion::parse(&broken, "h.csv").unwrap_err().to_string();
            assert!(error.contains("h.csv") && error.contains(line) && error.contains(named), "{error}");
        }
        assert!(matches!(RecordedMotion::parse("", "h"), Err(RecordedMotionError::Short { found: 0, .. })));
        assert!(
            RecordedMotion::load(Path::new("/nonexistent/h.csv")).unwrap_err().to_string().contains("h.csv")
        );
    }

    proptest! {
        #[test]
        fn any_text_is_parsed_or_refused(text in "[-0-9.,eNan\n ]{0,300}") {
            let _ = RecordedMotion::parse(&text, "f");
        }
    }
}
