//! Camera-fields with blobs: out of blob streams and recordings, or found in the pictures of a recording of pixels.

use super::progress;
use anyhow::{bail, ensure};
use blob_stream::BlobReader;
use fpga_model::colours::file::ColourFile;
use fpga_model::commands::finder::fields_of_pixels;
use fpga_model::input::recorded::Recorded;
use fpga_model::input::whole::is_recording;
use ipc::logging::{inform, warn};
use outputs::exit::WrongUse;
use protocol::blobs::BlobField;
use recording::{Item, Recording};
use rig::Rig;
use std::path::{Path, PathBuf};

/// The rig that saw a stream, and how much of the stream is used.
#[derive(Debug, Clone, clap::Args)]
pub struct StreamArgs {
    /// Rig file of the stream; a recording contains its own.
    #[arg(long, value_name = "RIG.json")]
    pub rig: Option<PathBuf>,
    /// Use at most N instants, spread over the stream.
    #[arg(long, value_name = "N", default_value_t = 400)]
    pub instants: usize,
    /// Colour classes of the blobs in a recording of pixels [default: the shipped classes].
    #[arg(long, value_name = "FILE.toml")]
    pub colours: Option<PathBuf>,
}

impl StreamArgs {
    /// The rig and the fields of a stream.
    pub(super) fn fields(&self, path: &Path) -> anyhow::Result<(Rig, Vec<BlobField>)> {
        ensure!(self.instants >= 10, "--instants: expected 10 or more, found {}", self.instants);
        let (own, fields) = fields_in(path, self.colours.as_deref())?;
        let rig = match (&self.rig, own) {
            (Some(path), _) => Rig::load(path)?,
            (None, Some(text)) => Rig::parse(&text, &format!("of {}", path.display()))?,
            (None, None) => bail!(WrongUse("a blob stream needs --rig RIG.json".into())),
        };
        Ok((rig, fields))
    }

    /// Files that are read beside the stream.
    pub(super) fn files(&self) -> impl Iterator<Item = &PathBuf> {
        self.rig.iter().chain(&self.colours)
    }
}

/// The fields of a recording, with its rig, or of a blob stream. In a recording of pixels, blobs are found as `vitreo
/// blobs` finds them, by the colour classes of `colours` or the shipped ones.
///
/// # Errors
/// A file that cannot be read, or colours for a stream that has blobs already.
pub fn fields_in(path: &Path, colours: Option<&Path>) -> anyhow::Result<(Option<String>, Vec<BlobField>)> {
    if is_recording(path) {
        return found_in_pixels(path, colours);
    }
    ensure!(
        colours.is_none(),
        "--colours: {} has blobs already; expected a recording of pixels (vitreo cameras --record-fields FILE.mcap)",
        path.display()
    );
    if path.extension().is_some_and(|e| e == "mcap") {
        return of_recording(path);
    }
    Ok((None, BlobReader::open(path)?.collect::<Result<_, _>>()?))
}

/// The rig of a recording of pixels, and its fields with the blobs that are found in them.
fn found_in_pixels(path: &Path, colours: Option<&Path>) -> anyhow::Result<(Option<String>, Vec<BlobField>)> {
    let colours = ColourFile::load_or_shipped(colours)?;
    let rig_json = Recorded::head(path)?.rig_json;
    let bar = progress("finding blobs", None);
    let (fields, counts) = fields_of_pixels(path, &colours, |n| bar.set_message(format!("{n} fields")))?;
    bar.finish_and_clear();
    inform(&format!("{}: {}", path.display(), counts.summary()));
    Ok((Some(rig_json), fields))
}

/// The rig and the fields of a recording.
fn of_recording(path: &Path) -> anyhow::Result<(Option<String>, Vec<BlobField>)> {
    let recording = Recording::open(path)?;
    let progress = progress("reading", Some(recording.bytes()));
    let (mut fields, mut items) = (Vec::new(), recording.items());
    while let Some(item) = items.next() {
        progress.set_position(items.bytes_read());
        match item {
            Ok((_, Item::Blobs(field))) => fields.push(*field),
            Ok(_) => {}
            // What came before the damage serves as well.
            Err(error) => {
                warn(&format!("{}: read up to here: {error}", path.display()));
                break;
            }
        }
    }
    progress.finish_and_clear();
    Ok((Some(recording.provenance().rig_json.clone()), fields))
}
