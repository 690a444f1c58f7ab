//! Writes the map that is laid on the retina:
//! `cargo run --release -p renderer --example fundus -- OUT.png [SIZE [left|right]]`.

use anyhow::Result;
use renderer::assets::shipped_photograph;
use renderer::fundus_map::bake;
use renderer::photograph::Photograph;
use scene::Side;

fn main() -> Result<()> {
    let mut args = std::env::args().skip(1);
    let out = args.next().unwrap_or_else(|| "fundus.png".into());
    let size: u32 = args.next().map_or(Ok(1024), |s| s.parse())?;
    let side = if args.next().as_deref() == Some("left") { Side::Left } else { Side::Right };
    let map = bake(&Photograph::new(shipped_photograph()?), size, side);
    let rgb = map.chunks_exact(4).flat_map(|p| [p[0], p[1], p[2]]).collect();
    // The map's rows run up, a picture's down.
    let picture = image::RgbImage::from_raw(size, size, rgb).expect("three bytes a pixel");
    image::imageops::flip_vertical(&picture).save(out)?;
    Ok(())
}
