//! Pictures of a target out of a recording of pixels (`vitreo cameras --record-fields FILE.mcap`).

use crate::grey_image::GreyImage;
use anyhow::{Context, Result};
use fpga_model::input::Picture;
use fpga_model::input::whole::WholePictures;
use std::path::Path;

/// Most pictures of a camera.
const MOST: usize = 400;

/// Which pictures of a recording are used.
#[derive(Debug, Clone, Copy, clap::Args)]
pub struct EveryArgs {
    /// Use every Nth picture of a recording.
    #[arg(
        long, value_name = "N", default_value_t = 25, value_parser = settings::commands::numbers::whole::<u64>(1, 100_000),
        help_heading = "Pictures"
    )]
    pub every: u64,
}

/// Hands pictures of a camera to `look`, with their number, which pictures of other cameras taken at the same time share,
/// and their name in messages.
///
/// # Errors
/// A file that cannot be read or lacks the camera; those of `look`.
pub fn each(
    path: &Path,
    camera: u32,
    every: EveryArgs,
    mut look: impl FnMut(u64, String, &GreyImage) -> Result<()>,
) -> Result<()> {
    let (mut pictures, mut picture) = (WholePictures::open(path, camera)?, Picture::default());
    let mut used = 0;
    while let Some(number) = pictures.read(&mut picture)? {
        // Pictures of one number were taken together.
        if !number.is_multiple_of(every.every) {
            continue;
        }
        look(number, name_of(path, camera, number), &grey(&picture))?;
        used += 1;
        if used == MOST {
            break;
        }
    }
    Ok(())
}

/// The first whole picture of a camera, and its name in messages.
///
/// # Errors
/// A file that cannot be read, lacks the camera or has no whole picture of it.
pub fn first(path: &Path, camera: u32) -> Result<(String, GreyImage)> {
    let (mut pictures, mut picture) = (WholePictures::open(path, camera)?, Picture::default());
    let number = pictures.read(&mut picture)?.context("a picture")?;
    Ok((name_of(path, camera, number), grey(&picture)))
}

fn name_of(path: &Path, camera: u32, number: u64) -> String {
    format!("{}, camera {camera}, picture {number}", path.display())
}

fn grey(picture: &Picture) -> GreyImage {
    let luma = picture.luma.iter().map(|v| f32::from(*v)).collect();
    GreyImage::new(picture.width, picture.height, luma)
}
