//! `vitreo blobs`: the scanner over pictures and clips from elsewhere.

use super::progress;
use crate::input::source::{Reading, Shot, Source};
use crate::input::{Interlace, overlay, still::Levels};
use crate::scan::{Scanner, Settings, limits};
use anyhow::{Context, Result};
use protocol::blob_stream::write_blobs;
use protocol::blobs::{BLOB_CLIPPED, BLOB_MERGED, Blob, Colour};
use protocol::time::now;
use std::fs::File;
use std::io::{BufWriter, Write};
use std::path::{Path, PathBuf};

/// Find the blobs in pictures and clips.
///
/// Each still image (PNG, JPEG) is one picture of camera 0. Each clip (Y4M, 8 bits; - for the standard input)
/// is a camera of its own: the first is camera 0. Without --fields, pictures are numbered from 0 and picture k was exposed
/// k + 1 periods after the origin of time: 20 ms for stills, for clips their own period.
#[derive(Debug, Clone, clap::Args)]
pub struct BlobsArgs {
    /// Still images, or one clip a camera.
    #[arg(required = true, value_name = "IMAGE|CLIP.y4m")]
    pub pictures: Vec<PathBuf>,
    /// Which field each picture is: the k-th line of a camera belongs to its k-th picture.
    #[arg(long, value_name = "FIELDS.jsonl")]
    pub fields: Option<PathBuf>,
    /// Where the blobs go, one line a field; the standard output if not given.
    #[arg(short, long, value_name = "BLOBS.jsonl")]
    pub output: Option<PathBuf>,
    /// Write a picture with the blobs drawn in. With %d in the name (or %04d) every picture is written, numbered from 0.
    #[arg(long, value_name = "OUT.png")]
    pub overlay: Option<PathBuf>,
    /// Which picture --overlay draws, counted from 0 over all cameras.
    #[arg(long, value_name = "N", default_value_t = 0, requires = "overlay")]
    pub overlay_picture: u64,
    /// Fields in a picture; a clip's header tells if not given.
    #[arg(long, value_name = "ORDER")]
    pub interlaced: Option<Interlace>,
    /// Whether blobs are brighter or darker than what is around them.
    #[arg(long, default_value = "bright")]
    pub polarity: Polarity,
    /// Samples of still images that become black and white, for instance 2000:12000 for 16 bits. If not given:
    /// all of 8 bits, and of 16 bits what the picture uses.
    #[arg(long, value_name = "BLACK:WHITE", value_parser = Levels::parse)]
    pub levels: Option<Levels>,
}

/// What stands out.
#[derive(Debug, Clone, Copy, PartialEq, Eq, clap::ValueEnum)]
pub enum Polarity {
    /// Bright on dark.
    Bright,
    /// Dark on bright.
    Dark,
}

/// Runs the command.
pub fn run(args: &BlobsArgs) -> Result<()> {
    let reading =
        Reading { levels: args.levels, interlace: args.interlaced, dark: args.polarity == Polarity::Dark };
    let mut source = Source::open(&args.pictures, args.fields.as_deref(), &reading)?;
    let mut out = Output::create(args.output.as_deref())?;
    let mut extractor = Extractor::default();
    let mut tally = Tally::default();
    let bar = progress::counter("pictures");
    while let Some(shot) = source.next()? {
        let began = now();
        let blobs = extractor.scan(&shot, &mut tally.lost);
        tally.add(&shot, blobs, now() - began);
        out.line(&write_blobs(&shot.head, blobs))?;
        if let Some(path) = overlay_path(args, tally.pictures - 1) {
            let lines = if shot.is_field { 2 } else { 1 };
            overlay::write(&shot.view, blobs, lines, &path)
                .with_context(|| format!("cannot write {}", path.display()))?;
        }
        bar.inc(1);
    }
    bar.finish_and_clear();
    out.finish()?;
    eprintln!("{}", tally.told());
    Ok(())
}

/// Where picture `n` is to be drawn, if it is.
fn overlay_path(args: &BlobsArgs, n: u64) -> Option<PathBuf> {
    let path = args.overlay.as_ref()?;
    match numbered(&path.to_string_lossy(), n) {
        Some(name) => Some(name.into()),
        None => (n == args.overlay_picture).then(|| path.clone()),
    }
}

/// A name with `%d` or `%04d` replaced by a number.
fn numbered(name: &str, n: u64) -> Option<String> {
    let at = name.find('%')?;
    let (digits, rest) = name[at + 1..].split_once('d')?;
    let width: usize = if digits.is_empty() { 0 } else { digits.strip_prefix('0')?.parse().ok()? };
    (width < 20).then(|| format!("{}{n:0width$}{rest}", &name[..at]))
}

/// The file or the standard output.
struct Output {
    to: Box<dyn Write>,
    name: String,
}

impl Output {
    fn create(path: Option<&Path>) -> Result<Self> {
        Ok(match path {
            None => {
                Output { to: Box::new(BufWriter::new(std::io::stdout())), name: "the standard output".into() }
            }
            Some(path) => {
                let name = path.display().to_string();
                let file = File::create(path).with_context(|| format!("cannot write {name}"))?;
                Output { to: Box::new(BufWriter::new(file)), name }
            }
        })
    }

    fn line(&mut self, text: &str) -> Result<()> {
        writeln!(self.to, "{text}").with_context(|| format!("cannot write {}", self.name))
    }

    fn finish(mut self) -> Result<()> {
        self.to.flush().with_context(|| format!("cannot write {}", self.name))
    }
}

/// A scanner for each camera.
#[derive(Default)]
struct Extractor {
    scanners: Vec<Option<([usize; 2], Scanner)>>,
    blobs: Vec<Blob>,
}

impl Extractor {
    /// The blobs of a field.
    fn scan(&mut self, shot: &Shot<'_>, lost: &mut u64) -> &[Blob] {
        let camera = shot.head.cam as usize;
        if self.scanners.len() <= camera {
            self.scanners.resize_with(camera + 1, || None);
        }
        let size = [shot.view.picture.width, shot.view.height()];
        let slot = &mut self.scanners[camera];
        if slot.as_ref().is_none_or(|(known, _)| *known != size) {
            *slot = None;
        }
        let frame_lines = if shot.is_field { 2 } else { 1 };
        let settings = || Settings { frame_lines, limits: limits::PICTURE, ..Settings::default() };
        let (_, scanner) = slot.get_or_insert_with(|| (size, Scanner::new(settings(), size[0], size[1])));
        self.blobs.clear();
        let mut keep = |found: crate::scan::Found| self.blobs.extend(found.blobs());
        scanner.begin();
        for y in 0..size[1] {
            let (luma, blue, red) = shot.view.line(y);
            scanner.line(luma, blue, red, &mut keep);
        }
        scanner.end(&mut keep);
        *lost += u64::from(scanner.tally().lost());
        &self.blobs
    }
}

/// What was found, for the last line.
#[derive(Default)]
struct Tally {
    pictures: u64,
    pixels: u64,
    scanning_ns: u64,
    blobs: u64,
    by_colour: [u64; Colour::ALL.len()],
    merged: u64,
    clipped: u64,
    lost: u64,
}

impl Tally {
    fn add(&mut self, shot: &Shot<'_>, blobs: &[Blob], scanning_ns: u64) {
        self.pictures += 1;
        self.pixels += (shot.view.picture.width * shot.view.height()) as u64;
        self.scanning_ns += scanning_ns;
        self.blobs += blobs.len() as u64;
        for blob in blobs {
            let class = Colour::ALL.iter().position(|&c| c as u32 == blob.colour);
            self.by_colour[class.expect("the scanner knows its classes")] += 1;
            self.merged += u64::from(blob.flags & BLOB_MERGED != 0);
            self.clipped += u64::from(blob.flags & BLOB_CLIPPED != 0);
        }
    }

    fn told(&self) -> String {
        let colours = Colour::ALL.iter().zip(self.by_colour).filter(|(_, n)| *n > 0);
        let colours: Vec<String> = colours.map(|(c, n)| format!("{n} {}", c.name())).collect();
        let colours = if colours.is_empty() { String::new() } else { format!(" ({})", colours.join(", ")) };
        let rate = self.pixels as f64 * 1e3 / self.scanning_ns.max(1) as f64;
        format!(
            "{} pictures, {} blobs{colours}, {} merged, {} clipped, {} lost; {rate:.1} Mpx/s",
            self.pictures, self.blobs, self.merged, self.clipped, self.lost
        )
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn overlays_are_numbered_where_the_name_asks_for_it() {
        assert_eq!(numbered("a/%d.png", 7).unwrap(), "a/7.png");
        assert_eq!(numbered("b-%03d.png", 7).unwrap(), "b-007.png");
        for plain in ["a.png", "100%.png", "%xd.png", "%0999999d.png"] {
            assert!(numbered(plain, 7).is_none(), "{plain}");
        }
    }
}
