//! `vitreo blobs`: extraction from pictures and clips.

use super::extractor::Tuning;
use super::finder::{Finder, Found};
use super::progress;
use crate::colours::file::ColourFile;
use crate::input::source::Source;
use crate::input::still::Levels;
use crate::input::{Interlace, overlay};
use anyhow::{Context, Result, bail};
use blob_stream::write_blobs;
use ipc::logging::inform;
use outputs::exit::WrongUse;
use outputs::{Force, OutputFile, Outputs, STDOUT};
use std::io::Write;
use std::path::{Path, PathBuf};

/// Find blobs in pictures and clips.
///
/// A still image (PNG, JPEG) is one picture of camera 0. A clip (Y4M, 8 bits; - for standard input) is one
/// camera; the first clip is camera 0. A recording of pixels (vitreo cameras --record-fields FILE.mcap) contains
/// all cameras with the number and timestamps of each field. For images and clips without --fields, pictures
/// are numbered from 0, and picture k is exposed k + 1 periods after time zero; the period is 20 ms for
/// stills and the clip's own for clips.
#[derive(Debug, Clone, clap::Args)]
#[command(mut_arg("force", |arg| arg.help_heading("Outputs")))]
pub struct BlobsArgs {
    /// Still images, one clip or camera device (/dev/video0) per camera, or one recording of pixels.
    #[arg(required = true, value_name = "IMAGE|CLIP.y4m|PIXELS.mcap")]
    pub pictures: Vec<PathBuf>,
    /// Field of each picture: a camera's k-th line describes its k-th picture.
    #[arg(long, value_name = "FIELDS.jsonl", help_heading = "Pictures")]
    pub fields: Option<PathBuf>,
    /// File for the blobs, one line per field [default: standard output].
    #[arg(short, long, value_name = "BLOBS.jsonl", help_heading = "Outputs")]
    pub output: Option<PathBuf>,
    /// Draw the blobs over a picture. With %d or %04d in the name, draw every picture, numbered from 0.
    #[arg(long, value_name = "OUT.png", help_heading = "Outputs")]
    pub overlay: Option<PathBuf>,
    /// Picture to draw with --overlay, counted from 0 over all cameras.
    #[arg(long, value_name = "N", default_value_t = 0, requires = "overlay", help_heading = "Outputs")]
    pub overlay_picture: u64,
    /// Stop after N pictures.
    #[arg(long = "count", value_name = "N", help_heading = "Pictures")]
    pub pictures_at_most: Option<u64>,
    /// Fields per picture [default: from the clip's header].
    #[arg(long, value_name = "ORDER", help_heading = "Pictures")]
    pub interlaced: Option<Interlace>,
    /// Sample values of black and white in still images, for instance 2000:12000 for 16 bits [default: full
    /// range for 8 bits, the picture's own range for 16 bits].
    #[arg(long, value_name = "BLACK:WHITE", value_parser = Levels::parse, help_heading = "Pictures")]
    pub levels: Option<Levels>,
    /// Colour classes and their levels [default: the shipped classes].
    #[arg(long, value_name = "FILE.toml")]
    pub colours: Option<PathBuf>,
    /// How the scanner is set.
    #[command(flatten)]
    pub tuning: Tuning,
    /// `--force`.
    #[command(flatten)]
    pub force: Force,
}

/// Runs the command.
///
/// # Errors
/// Where colours, pictures or the list of fields are refused, or an output cannot be written.
pub fn run(args: &BlobsArgs) -> Result<()> {
    let colours = ColourFile::load_or_shipped(args.colours.as_deref())?;
    let source = Source::open(
        &args.pictures,
        args.fields.as_deref(),
        &args.tuning.reading(args.levels, args.interlaced, &colours),
    )?;
    let outputs = Outputs::new(args.force.force).reading_all(&args.pictures).reading_all(&args.fields);
    let mut outputs = outputs.reading_all(&args.colours);
    let name = args.output.as_deref().unwrap_or(Path::new(STDOUT));
    if let Some(path) = args.overlay.as_deref().filter(|path| numbered(&path.to_string_lossy(), 0).is_none())
    {
        outputs.claim(path)?;
    }
    let mut out = outputs.create(name)?;
    let mut finder = Finder::new(source, &colours, &args.tuning);
    let bar = progress::counter("pictures");
    let mut n = 0;
    while args.pictures_at_most.is_none_or(|most| n < most)
        && let Some(Found { shot, blobs, boxes }) = finder.next_picture()?
    {
        line(&mut out, &write_blobs(&shot.head, blobs), shot.is_live)
            .with_context(|| format!("cannot write {}", name.display()))?;
        if let Some(path) = overlay_path(args, n) {
            let lines = if shot.is_field { 2 } else { 1 };
            let image = overlay::draw(&shot.view, blobs.iter().zip(boxes), lines);
            outputs.write(&path, overlay::png(&image)?)?;
        }
        n += 1;
        bar.inc(1);
    }
    bar.finish_and_clear();
    out.finish()?;
    if args.overlay.is_some() && overlay_path(args, 0).is_none() && n <= args.overlay_picture {
        let wanted = args.overlay_picture;
        bail!(WrongUse(format!(
            "--overlay-picture {wanted}: the input has only {n} pictures, counted from 0"
        )));
    }
    inform(&finder.counts.summary());
    Ok(())
}

/// File of the overlay of picture `n`, if it is drawn.
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

/// Writes a line; at once where it is live.
fn line(out: &mut OutputFile, text: &str, at_once: bool) -> std::io::Result<()> {
    writeln!(out, "{text}")?;
    if at_once { out.flush() } else { Ok(()) }
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
