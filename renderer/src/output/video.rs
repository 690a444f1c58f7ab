//! A film that is being written, in the format that the ending of its name asks for.

use super::mp4::Mp4;
use super::y4m::Y4m;
use crate::readback::Picture;
use outputs::{GrowingFile, OutputError, VideoFormat};

/// A film being written; it appears with its first picture. All pictures have one size.
pub enum Video {
    /// H.264.
    Mp4(Box<Mp4>),
    /// Without compression.
    Y4m(Y4m),
}

/// Why a film cannot be written.
#[derive(Debug, thiserror::Error)]
pub enum VideoError {
    /// The file is refused or cannot be written.
    #[error(transparent)]
    Output(#[from] OutputError),
    /// The name has an ending of no format.
    #[error("{0}: expected a name that ends in .mp4 or .y4m")]
    Format(String),
    /// The encoder refused a picture.
    #[error("{file}: H.264: {problem}")]
    Encoder {
        /// The film.
        file: String,
        /// What the encoder said.
        problem: String,
    },
}

impl Video {
    /// Begins a film of pictures of `size_px`, both even, `hz` a second.
    ///
    /// # Errors
    /// If the name has a foreign ending or the file cannot be written.
    pub fn begin(name: GrowingFile, size_px: [u32; 2], hz: u32) -> Result<Self, VideoError> {
        match VideoFormat::of(name.path()) {
            Some(VideoFormat::Mp4) => Ok(Video::Mp4(Box::new(Mp4::begin(name, size_px, hz)?))),
            Some(VideoFormat::Y4m) => Ok(Video::Y4m(Y4m::begin(name, size_px, hz)?)),
            None => Err(VideoError::Format(name.path().display().to_string())),
        }
    }

    /// Writes `picture`, scaled to the film's size, `count` times.
    ///
    /// # Errors
    /// If the film cannot be written.
    pub fn write(&mut self, picture: &Picture, count: u64) -> Result<(), VideoError> {
        match self {
            Video::Mp4(file) => file.write(picture, count),
            Video::Y4m(file) => Ok(file.write(picture, count)?),
        }
    }

    /// Writes what is left.
    ///
    /// # Errors
    /// If the film cannot be written.
    pub fn finish(&mut self) -> Result<(), VideoError> {
        match self {
            Video::Mp4(file) => file.finish(),
            Video::Y4m(file) => Ok(file.flush()?),
        }
    }
}
