//! What the picture is made from besides the scene: the fundus photograph and the instruments'
//! meshes, built in or from files.

use crate::photograph::{FundusArgs, Photograph};
use crate::tools::{ModelError, Models};
use crate::{fundus_map, kept_map};
use image::{ImageReader, Limits, RgbImage};
use protocol::contain::contain;
use protocol::file::{MAX_TABLE_BYTES, looks_like, read_bytes};
use scene::Side;
use std::io::Cursor;
use std::path::{Path, PathBuf};

/// The photograph that is built in (see `assets/README.md`).
const PHOTOGRAPH: &[u8] = include_bytes!("../../assets/fundus.jpg");
/// Least width of a photograph, px: a software driver's map shows as many.
const MIN_PX: u32 = 512;
/// Greatest width and height of a photograph, px.
const MAX_PX: u32 = 8192;
/// Memory limit of a decoder, bytes: the largest photograph with 16 bits a sample.
const MAX_DECODER_BYTES: u64 = 512 << 20;
/// Most that width and height of a photograph may differ, share of the width.
const SQUARE: f64 = 0.02;

/// Why an asset cannot be used.
#[derive(Debug, thiserror::Error)]
pub enum AssetError {
    /// An instrument's mesh.
    #[error("instrument: {0}")]
    Model(#[from] ModelError),
    /// The fundus photograph.
    #[error("fundus photograph {file}: {problem}")]
    Photograph {
        /// Its path.
        file: String,
        /// What is wrong, and what was expected.
        problem: String,
    },
}

/// Photograph and meshes.
#[derive(Debug, Clone)]
pub struct Assets {
    /// The fundus.
    pub photograph: Photograph,
    /// The instruments.
    pub models: Models,
    /// Where the next renderer of a run finds what this one has baked.
    kept_in: Option<PathBuf>,
}

impl Assets {
    /// Those that are built in.
    ///
    /// # Errors
    /// If an asset that is built in cannot be decoded.
    pub fn shipped() -> Result<Self, AssetError> {
        Self::load(&FundusArgs::default(), None)
    }

    /// From a photograph and a folder of meshes, where they are given. Warns of a photograph that
    /// seems to be another than the given one.
    ///
    /// # Errors
    /// If a file cannot be read, or is not a square colour photograph or a valid mesh.
    pub fn load(fundus: &FundusArgs, instruments: Option<&Path>) -> Result<Self, AssetError> {
        let photograph = match &fundus.fundus {
            Some(path) => {
                let photograph = Photograph::described(self::photograph(path)?, fundus)?;
                for doubt in photograph.doubts() {
                    tracing::warn!("fundus photograph {}: {doubt}", path.display());
                }
                photograph
            }
            None => Photograph::new(shipped_photograph()?),
        };
        let models = instruments.map_or_else(Models::shipped, Models::from_folder)?;
        Ok(Self { photograph, models, kept_in: None })
    }

    /// From now on keeps the map of the fundus in `folder`, and takes one that is kept there: it
    /// must belong to this photograph.
    #[must_use]
    pub fn kept_in(self, folder: PathBuf) -> Self {
        Self { kept_in: Some(folder), ..self }
    }

    /// The map of the fundus, of `size` × `size` pixels; see [`fundus_map::bake`].
    pub fn map(&self, size: u32, side: Side) -> Vec<u8> {
        let Some(folder) = &self.kept_in else { return fundus_map::bake(&self.photograph, size, side) };
        kept_map::take(folder, size, side).unwrap_or_else(|| {
            let map = fundus_map::bake(&self.photograph, size, side);
            if let Err(problem) = kept_map::put(folder, size, side, &map) {
                tracing::debug!("the map of the fundus cannot be cached: {problem}");
            }
            map
        })
    }
}

/// The photograph that is built in, decoded.
///
/// # Errors
/// If it cannot be decoded.
pub fn shipped_photograph() -> Result<RgbImage, AssetError> {
    decode("assets/fundus.jpg", PHOTOGRAPH)
}

fn photograph(path: &Path) -> Result<RgbImage, AssetError> {
    let file = path.display().to_string();
    let bytes = read_bytes(path, MAX_TABLE_BYTES)
        .map_err(|e| AssetError::Photograph { file: file.clone(), problem: e.to_string() })?;
    decode(&file, &bytes)
}

/// A photograph from the bytes of `file`.
///
/// # Errors
/// If they are no square colour photograph, or one of more than [`MAX_PX`] a side.
pub fn decode(file: &str, bytes: &[u8]) -> Result<RgbImage, AssetError> {
    let refused = |problem: String| AssetError::Photograph { file: file.to_owned(), problem };
    let unreadable = |e: String| {
        let found = looks_like(bytes);
        refused(format!("expected a JPEG or PNG picture of at most {MAX_PX} px a side, found {found}: {e}"))
    };
    let mut reader = ImageReader::new(Cursor::new(bytes)).with_guessed_format().expect("memory is read");
    let mut limits = Limits::default();
    (limits.max_image_width, limits.max_image_height) = (Some(MAX_PX), Some(MAX_PX));
    limits.max_alloc = Some(MAX_DECODER_BYTES);
    reader.limits(limits);
    let picture = contain(|| reader.decode()).map_err(unreadable)?.map_err(|e| unreadable(e.to_string()))?;
    if !picture.color().has_color() {
        return Err(refused(format!("expected colours, found {:?}", picture.color())));
    }
    let (width, height) = (picture.width(), picture.height());
    let square = (f64::from(width) - f64::from(height)).abs() <= SQUARE * f64::from(width);
    if width < MIN_PX || !square {
        return Err(refused(format!(
            "expected a square of at least {MIN_PX} px, the fovea in its middle; found {width}×{height} px"
        )));
    }
    Ok(picture.to_rgb8())
}

#[cfg(test)]
mod tests {
    use super::*;

    fn problem(bytes: &[u8]) -> String {
        decode("eye.png", bytes).unwrap_err().to_string()
    }

    fn png(width: u32, height: u32, colour: image::ColorType) -> Vec<u8> {
        let mut out = std::io::Cursor::new(Vec::new());
        image::DynamicImage::new(width, height, colour).write_to(&mut out, image::ImageFormat::Png).unwrap();
        out.into_inner()
    }

    #[test]
    fn wrong_photographs_are_refused_by_name_and_reason() {
        assert!(problem(b"not a picture").starts_with("fundus photograph eye.png: expected a JPEG or PNG"));
        let whole = png(600, 600, image::ColorType::Rgb8);
        assert!(problem(&whole[..whole.len() / 2]).contains("expected a JPEG or PNG"), "cut off");
        assert!(problem(&png(600, 600, image::ColorType::L8)).contains("colours, found L8"));
        assert!(problem(&png(600, 400, image::ColorType::Rgb8)).contains("600×400"));
        assert!(problem(&png(100, 100, image::ColorType::Rgb8)).contains("at least 512 px"));
        let wide = problem(&png(8200, 8, image::ColorType::Rgb8));
        assert!(wide.contains("at most 8192 px a side, found a PNG picture"), "{wide}");
        assert!(decode("eye.png", &whole).is_ok() && shipped_photograph().is_ok());
    }

    #[test]
    fn missing_files_are_named() {
        let nowhere = Path::new("/nowhere/at/all");
        let fundus = FundusArgs { fundus: Some(nowhere.into()), ..FundusArgs::default() };
        let e = Assets::load(&fundus, None).unwrap_err().to_string();
        assert!(e.starts_with("fundus photograph /nowhere/at/all: "), "{e}");
        let e = Assets::load(&FundusArgs::default(), Some(nowhere)).unwrap_err().to_string();
        assert!(e.starts_with("instrument: /nowhere/at/all/forceps.glb: "), "{e}");
    }
}
