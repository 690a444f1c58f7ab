//! Test vectors for a hardware description: lines of a field in, components out, as plain text that
//! any test bench can read with a scanner for words and decimal numbers.
//!
//! The first word of a line names its content; all numbers are decimal integers:
//!
//! ```text
//! vitreo-camera-vectors 1
//! about   what is hard about it
//! size    columns lines
//! tables  runs labels blobs
//! level   fixed|tracked luma
//! low     grey levels above the background of a pixel
//! high    the same of the brightest pixel, classes 0 to 7
//! least   area(px) lines
//! frame   lines of the frame per line of the field
//! line    y           then its samples:
//! Y …     luma, one a pixel
//! B …     Cb, one every second pixel
//! R …     Cr, one every second pixel
//! component clock latency class w wx wy wxx wxy wyy wxxx wxxy wxyy wyyy area rim saturated peak contrast
//!           rise span grain grains half-box(left right top bottom) box(left right top bottom)      all in one line
//! blob    x(2⁻¹⁶ px) y(2⁻¹⁶ lines) flags    of the component above; two where markers touch
//! tally   specks runs-lost unlabelled blobs-lost
//! end
//! ```

pub mod patterns;

use crate::scan::background::Level;
use crate::scan::{Found, Scanner};
use patterns::Pattern;
use std::fmt::Write;

/// First line of a file.
const HEAD: &str = "vitreo-camera-vectors 1";

/// The file of a pattern: its lines, and the extractor's components.
pub fn text(pattern: &Pattern) -> String {
    let mut text = String::new();
    write_head(pattern, &mut text).expect("a string takes everything");
    write_lines(pattern, &mut text).expect("a string takes everything");
    text
}

fn write_head(pattern: &Pattern, out: &mut String) -> std::fmt::Result {
    let (settings, picture) = (&pattern.settings, &pattern.picture);
    let limits = settings.limits;
    writeln!(out, "{HEAD}\nabout {}", pattern.about)?;
    writeln!(out, "size {} {}", picture.width, picture.height)?;
    writeln!(out, "tables {} {} {}", limits.runs, limits.labels, limits.blobs)?;
    match settings.level {
        Level::Fixed(luma) => writeln!(out, "level fixed {luma}")?,
        Level::Tracked(luma) => writeln!(out, "level tracked {luma}")?,
    }
    writeln!(out, "low {}\nhigh{}", settings.low, numbers(&settings.high))?;
    writeln!(out, "least {} {}\nframe {}", settings.least_area, settings.least_lines, settings.frame_lines)
}

/// The lines, each followed by the components that leave while it is labelled.
fn write_lines(pattern: &Pattern, out: &mut String) -> std::fmt::Result {
    let picture = &pattern.picture;
    let mut scanner = Scanner::new(pattern.settings.clone(), picture.width, picture.height);
    let mut found = Vec::new();
    scanner.begin();
    for y in 0..picture.height {
        let (luma, blue, red) = picture.line(y);
        writeln!(out, "line {y}\nY{}\nB{}\nR{}", numbers(luma), numbers(blue), numbers(red))?;
        scanner.line(luma, blue, red, &mut |component| found.push(component));
        found.drain(..).try_for_each(|component| write_component(&component, out))?;
    }
    scanner.end(&mut |component| found.push(component));
    found.drain(..).try_for_each(|component| write_component(&component, out))?;
    let tally = scanner.tally();
    let lost = [tally.specks, tally.runs_lost, tally.unlabelled, tally.blobs_lost];
    writeln!(out, "tally{}\nend", numbers(&lost))
}

fn write_component(found: &Found, out: &mut String) -> std::fmt::Result {
    let s = &found.sums;
    write!(out, "component {} {} {}", found.out_clock, found.latency_clocks, s.class)?;
    write!(out, "{}", numbers(&[s.w, s.wx, s.wy, s.wxx, s.wxy, s.wyy]))?;
    write!(out, "{}", numbers(&[s.wxxx, s.wxxy, s.wxyy, s.wyyy]))?;
    write!(out, "{} {} {}", numbers(&[s.area, s.rim, s.saturated]), s.peak, s.contrast)?;
    write!(out, " {} {} {} {}", s.rise, s.span, s.grain, s.grains)?;
    writeln!(out, "{}{}", numbers(&s.half_box_px), numbers(&s.box_px))?;
    for blob in found.blobs() {
        // Centres are fixed-point numbers until the wire, so that this is exact.
        let fixed = [blob.x_px, blob.y_field_px].map(|px| (px * 65_536.0) as u64);
        writeln!(out, "blob{} {}", numbers(&fixed), blob.flags)?;
    }
    Ok(())
}

fn numbers<T: std::fmt::Display>(all: &[T]) -> String {
    all.iter().fold(String::new(), |mut text, n| {
        let _ = write!(text, " {n}");
        text
    })
}

#[cfg(test)]
mod tests {
    use super::*;
    use std::path::Path;

    /// Expected counts of each pattern, by hand from its description:
    /// blobs, specks, runs lost, runs without a label, blobs lost.
    const EXPECTED: [(&str, usize, [u32; 4]); 16] = [
        ("all-off", 0, [0; 4]),
        ("all-on", 1, [0; 4]),
        ("comb", 1, [0; 4]),
        ("comb-upside-down", 1, [0; 4]),
        ("spiral", 1, [0; 4]),
        ("chequerboard", 1, [0; 4]),
        ("two-colours", 2, [0; 4]),
        ("markers", 2, [0; 4]),
        ("touching", 1, [0; 4]),
        ("border", 2, [0; 4]),
        ("speck", 1, [1, 0, 0, 0]),
        ("tracked-background", 1, [2, 0, 0, 0]),
        ("too-many-runs", 10, [0, 18, 0, 0]),
        ("too-many-labels", 12, [0, 0, 12, 0]),
        ("labels-again", 64, [0; 4]),
        ("too-many-blobs", 64, [0, 0, 0, 2]),
    ];

    #[test]
    fn every_pattern_gives_what_its_description_says() {
        let all = patterns::all();
        assert_eq!(all.len(), EXPECTED.len());
        for (pattern, (name, components, lost)) in all.iter().zip(EXPECTED) {
            assert_eq!(pattern.name, name);
            let text = text(pattern);
            assert_eq!(text.lines().filter(|l| l.starts_with("component ")).count(), components, "{name}");
            assert!(text.contains(&format!("\ntally{}\nend\n", numbers(&lost))), "{name}: {text}");
        }
    }

    #[test]
    fn files_in_the_repository_are_what_the_extractor_gives_today() {
        let folder = Path::new(env!("CARGO_MANIFEST_DIR")).join("vectors");
        let mut files: Vec<_> = std::fs::read_dir(&folder)
            .unwrap()
            .map(|f| f.unwrap().file_name().into_string().unwrap())
            .collect();
        files.retain(|f| f.ends_with(".txt"));
        for pattern in patterns::all() {
            let name = format!("{}.txt", pattern.name);
            let stored = std::fs::read_to_string(folder.join(&name)).unwrap_or_default();
            assert!(stored == text(&pattern), "{name} differs; `make vectors` renews it, if it should");
            files.retain(|f| *f != name);
        }
        assert!(files.is_empty(), "files of no pattern: {files:?}");
    }
}
