//! Film formats, selected by the file extension.

use std::path::{Path, PathBuf};

/// Formats of films.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub enum VideoFormat {
    /// H.264 in fragmented MP4, which every player can show.
    Mp4,
    /// YUV4MPEG2: uncompressed and lossless, about a hundred times as large.
    Y4m,
}

impl VideoFormat {
    /// The format of a path's extension, in either case; `None` for other extensions.
    pub fn of(path: &Path) -> Option<Self> {
        match path.extension()?.to_ascii_lowercase().to_str()? {
            "mp4" => Some(VideoFormat::Mp4),
            "y4m" => Some(VideoFormat::Y4m),
            _ => None,
        }
    }
}

/// Parses the file name of a film on the command line.
///
/// # Errors
/// If the extension is not that of a format.
pub fn video_file(text: &str) -> Result<PathBuf, String> {
    let path = PathBuf::from(text);
    match VideoFormat::of(&path) {
        Some(_) => Ok(path),
        None => Err("expected a name that ends in .mp4 (H.264) or .y4m (uncompressed)".into()),
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn the_ending_decides() {
        assert_eq!(VideoFormat::of(Path::new("a/b.y4m/c.mp4")), Some(VideoFormat::Mp4));
        assert_eq!(VideoFormat::of(Path::new("C.Y4M")), Some(VideoFormat::Y4m));
        assert_eq!(video_file("x/y.MP4"), Ok("x/y.MP4".into()));
        for other in ["a.avi", "mp4", ".mp4", "-", "a.mp4.mov", ""] {
            let told = video_file(other);
            assert!(told.is_err_and(|t| t.contains(".mp4") && t.contains(".y4m")), "{other}");
        }
    }
}
