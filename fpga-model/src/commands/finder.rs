//! Blobs of pictures, one picture after the other: those that `vitreo blobs` writes, and those that other commands take
//! out of a recording of pixels.

use super::extractor::{Counts, Extractor, Tuning};
use crate::colours::file::ColourFile;
use crate::input::source::{Shot, Source};
use anyhow::{Result, ensure};
use blob_stream::{parse_line, write_blobs};
use ipc::clock::now;
use protocol::blobs::{Blob, BlobField};
use std::path::Path;

/// Finds the blobs of pictures in their sequence.
pub struct Finder<'a> {
    source: Source,
    extractor: Extractor<'a>,
    /// What was found so far.
    pub counts: Counts,
}

/// A picture and its blobs.
pub struct Found<'a> {
    /// The picture.
    pub shot: Shot<'a>,
    /// Its blobs.
    pub blobs: &'a [Blob],
    /// Their boxes (left, right, top, bottom), px and lines of the field.
    pub boxes: &'a [[f64; 4]],
}

impl<'a> Finder<'a> {
    /// Looks for blobs of these colours.
    pub fn new(source: Source, colours: &'a ColourFile, tuning: &'a Tuning) -> Self {
        Finder { source, extractor: Extractor::new(colours, tuning), counts: Counts::default() }
    }

    /// The blobs of the next picture; `None` at the end.
    ///
    /// # Errors
    /// A picture that cannot be read.
    pub fn next_picture(&mut self) -> Result<Option<Found<'_>>> {
        let Some(mut shot) = self.source.take()? else { return Ok(None) };
        if shot.is_live {
            (shot.head.t_ns, shot.head.t_rx_ns) = (now(), now());
        }
        self.extractor.settle(&shot);
        let began = now();
        let lost = self.extractor.scan(&shot);
        self.counts.add(&shot, &self.extractor.blobs, lost, now() - began);
        Ok(Some(Found { shot, blobs: &self.extractor.blobs, boxes: &self.extractor.boxes }))
    }
}

/// The fields of a recording of pixels with their blobs: those of the file that `vitreo blobs PIXELS.mcap -o …` writes.
/// `progress` gets the number of fields read.
///
/// # Errors
/// A file that cannot be read or has no field.
pub fn fields_of_pixels(
    path: &Path,
    colours: &ColourFile,
    mut progress: impl FnMut(u64),
) -> Result<(Vec<BlobField>, Counts)> {
    let tuning = Tuning::default();
    let source = Source::open(&[path.to_path_buf()], None, &tuning.reading(None, None, colours))?;
    let (mut finder, mut fields) = (Finder::new(source, colours, &tuning), Vec::new());
    let file = path.display().to_string();
    while let Some(found) = finder.next_picture()? {
        // By way of the text, so that both agree to the bit.
        let line = write_blobs(&found.shot.head, found.blobs);
        fields.push(parse_line(&line, &file, fields.len() as u64 + 1)?);
        progress(fields.len() as u64);
    }
    ensure!(!fields.is_empty(), "{file}: has no fields");
    Ok((fields, finder.counts))
}
