//! How a camera's pictures look: their rate, blobs and brightness over a second, and what to do. Pure.

use fpga_model::colours::convert::{BLACK, WHITE};
use protocol::time::Nanos;

/// Luma from which a sample counts as saturated.
const SATURATED: u8 = WHITE - 1;
/// More than this share of a picture is saturated only where light itself is seen.
const TOO_BRIGHT: f64 = 0.02;
/// Where nothing is brighter than this above black, markers are too dark to be found well.
const TOO_DARK: u8 = 60;
/// Relative difference of a rate above which it is reported.
const SAME_RATE: f64 = 0.02;
/// A rate is judged over at least this time, s.
const RATE_S: f64 = 0.5;
/// More blobs than three bodies of markers and a few reflections make.
const MANY_BLOBS: f64 = 60.0;

/// What a person does about pictures without blobs that are not dark.
const NO_BLOBS: &str = "no blobs: check focus, the markers' colours and what the camera sees";

/// Pictures of one camera since the last line.
#[derive(Debug, Clone, Default)]
pub struct Watch {
    fields: u64,
    /// When the first and the newest came.
    span: Option<[Nanos; 2]>,
    blobs: u64,
    saturated: u64,
    samples: u64,
    brightest: u8,
    /// Pictures came before the last line, too. The rate is judged from then on: the first ones had waited.
    is_steady: bool,
}

impl Watch {
    /// Counts a field that came at `at`, with its blobs.
    pub fn note(&mut self, luma: &[u8], blobs: usize, at: Nanos) {
        self.fields += 1;
        self.span = Some([self.span.map_or(at, |[first, _]| first), at]);
        self.blobs += blobs as u64;
        self.samples += luma.len() as u64;
        self.saturated += luma.iter().filter(|&&y| y >= SATURATED).count() as u64;
        self.brightest = luma.iter().copied().max().unwrap_or(0).max(self.brightest);
    }

    /// Summary of the time since the last line, for a rig of `field_hz`; `lost` counts missing fields,
    /// `trouble` is the reader's problem. Resets the counts.
    pub fn line(&mut self, field_hz: f64, lost: u64, trouble: Option<&str>) -> String {
        let is_steady = self.is_steady || self.fields > 0;
        let seen = std::mem::replace(self, Watch { is_steady, ..Watch::default() });
        let seconds = seen.span.map_or(0.0, |[first, last]| last.saturating_sub(first) as f64 * 1e-9);
        let hz = if seconds > 0.0 { (seen.fields - 1) as f64 / seconds } else { 0.0 };
        let share = seen.saturated as f64 / (seen.samples as f64).max(1.0);
        let blobs = seen.blobs as f64 / (seen.fields as f64).max(1.0);
        let advice =
            trouble.map_or_else(|| seen.advice([hz, field_hz], seconds, share, blobs), str::to_owned);
        format!(
            "{hz:.1} fields/s, {lost} lost, {blobs:.1} blobs, {:.2} % saturated, brightest {}: {advice}",
            100.0 * share,
            seen.brightest
        )
    }

    /// What the pictures ask for, and what their rate does.
    fn advice(&self, [hz, field_hz]: [f64; 2], seconds: f64, saturated: f64, blobs: f64) -> String {
        if self.fields == 0 {
            return "nothing came".into();
        }
        let is_judged = self.is_steady && seconds >= RATE_S;
        let strange = is_judged && (hz / field_hz - 1.0).abs() > SAME_RATE.max(1.5 / field_hz);
        let rate = strange.then(|| {
            format!("the rig expects {field_hz:.1} fields/s: set the camera's rate, or field_hz of the rig")
        });
        let picture = self.picture_advice(saturated, blobs).map(str::to_owned);
        let all: Vec<String> = [picture, rate].into_iter().flatten().collect();
        if all.is_empty() { "all right".into() } else { all.join("; ") }
    }

    fn picture_advice(&self, saturated: f64, blobs: f64) -> Option<&'static str> {
        if self.brightest < BLACK + TOO_DARK {
            return Some("too dark: raise exposure or gain, or the light");
        }
        if saturated > TOO_BRIGHT {
            return Some("too bright: lower exposure or gain");
        }
        if blobs < 0.5 {
            return Some(NO_BLOBS);
        }
        (blobs > MANY_BLOBS).then_some("many blobs: keep reflections and other coloured light away")
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    /// A second of 50 fields whose samples are `luma`, with so many blobs each.
    fn line(luma: &[u8], fields: usize, blobs: usize) -> String {
        let mut watch = Watch::default();
        watch.note(luma, blobs, 3);
        let first = watch.line(50.0, 0, None);
        assert!(!first.contains("the rig expects"), "{first}");
        let at = |k: usize| 7 + k as u64 * 1_000_000_000 / fields as u64;
        (0..fields).for_each(|k| watch.note(luma, blobs, at(k)));
        watch.line(50.0, 0, None)
    }

    #[test]
    fn what_to_do_follows_from_what_is_seen() {
        let good = [30, 30, 30, 150];
        assert_eq!(
            line(&good, 50, 14),
            "50.0 fields/s, 0 lost, 14.0 blobs, 0.00 % saturated, brightest 150: all right"
        );
        for (luma, fields, blobs, named) in [
            (&good[..], 30, 14, "the rig expects 50.0 fields/s"),
            (&[17, 40], 50, 0, "too dark: raise exposure"),
            (&[30, 235], 50, 3, "50.00 % saturated, brightest 235: too bright: lower exposure"),
            (&good, 50, 0, "no blobs"),
            (&good, 50, 80, "many blobs"),
            (&good, 0, 0, "0.0 fields/s, 0 lost, 0.0 blobs, 0.00 % saturated, brightest 0: nothing came"),
        ] {
            let told = line(luma, fields, blobs);
            assert!(told.contains(named), "{told}");
        }
    }

    #[test]
    fn trouble_of_the_source_comes_before_advice_and_a_line_begins_anew() {
        let mut watch = Watch::default();
        watch.note(&[200], 1, 7);
        assert!(
            watch
                .line(50.0, 7, Some("is unplugged"))
                .ends_with("7 lost, 1.0 blobs, 0.00 % saturated, brightest 200: is unplugged")
        );
        assert!(watch.line(50.0, 7, None).ends_with("nothing came"));
        // Pictures that had waited for the others come all at once.
        let mut burst = Watch::default();
        (0..60).for_each(|k| burst.note(&[200], 1, 7 + k * 10_000_000));
        assert!(burst.line(50.0, 0, None).ends_with("all right"));
    }
}
