//! The window and files arrange the two channels alike.

use renderer::governor::Tier;
use renderer::gpu::Gpu;
use renderer::present::blit::{Blit, Shown};
use renderer::readback::{Picture, ReadBack};
use renderer::stereo::{Arrangement, arrange};
use renderer::target::Target;
use wgpu::{TexelCopyBufferLayout, TextureDescriptor, TextureUsages, TextureViewDescriptor};

/// Channels of this size are copied to surfaces of the same size, so that no pixel is mixed.
const SIZE_PX: [u32; 2] = [24, 16];

fn noise() -> Picture {
    let [width_px, height_px] = [2 * SIZE_PX[0], SIZE_PX[1]];
    let mut seed = 1u32;
    let mut byte = || {
        seed = seed.wrapping_mul(1_664_525).wrapping_add(1_013_904_223);
        (seed >> 24) as u8
    };
    let rgba = (0..width_px * height_px).flat_map(|_| [byte(), byte(), byte(), 255]).collect();
    Picture { width_px, height_px, rgba }
}

fn target(gpu: &Gpu, width_px: u32) -> Target {
    Target::new(&gpu.device, &Tier { width_px, height_px: SIZE_PX[1], ..renderer::governor::TIERS[8] })
}

/// A target that holds `picture`.
fn holding(gpu: &Gpu, picture: &Picture) -> Target {
    let mut target = target(gpu, picture.width_px / 2);
    let size = target.texture.size();
    target.texture = gpu.device.create_texture(&TextureDescriptor {
        label: None,
        size,
        mip_level_count: 1,
        sample_count: 1,
        dimension: target.texture.dimension(),
        format: target.texture.format(),
        usage: TextureUsages::COPY_DST | TextureUsages::TEXTURE_BINDING,
        view_formats: &[],
    });
    target.colour = target.texture.create_view(&TextureViewDescriptor::default());
    let layout =
        TexelCopyBufferLayout { offset: 0, bytes_per_row: Some(4 * size.width), rows_per_image: None };
    gpu.queue.write_texture(target.texture.as_image_copy(), &picture.rgba, layout, size);
    target
}

#[test]
fn the_device_arranges_as_files_do() {
    let gpu = match Gpu::headless() {
        Ok(gpu) => gpu,
        Err(e) => return skips::skip(&e),
    };
    let picture = noise();
    let source = holding(&gpu, &picture);
    let mut blit = Blit::new(&gpu.device, source.texture.format());
    let read_back = ReadBack::new(&gpu, 8);
    use Arrangement::*;
    for (arrangement, channel, expected) in [
        (SideBySide, 0, SideBySide),
        (Anaglyph, 0, Anaglyph),
        (Interleaved, 0, Interleaved),
        (Left, 0, Left),
        (Right, 0, Right),
        (Sequential, 0, Left),
        (Sequential, 1, Right),
    ] {
        let mut wanted = picture.clone();
        arrange(&mut wanted, expected);
        // A target is two channels wide; half as wide a one is as wide as a channel.
        let surface = target(&gpu, wanted.width_px / 2);
        let shown = Shown { arrangement, channel, text: "", text_scale: arrangement.text_scale() };
        blit.draw(&gpu, &source, &surface.colour, [wanted.width_px, wanted.height_px], shown);
        let mut shown = Picture::default();
        read_back.read(&gpu, &surface.texture, &mut shown).unwrap();
        let worst = shown.rgba.iter().zip(&wanted.rgba).map(|(a, b)| a.abs_diff(*b)).max();
        assert!(shown.rgba.len() == wanted.rgba.len() && worst <= Some(1), "{arrangement:?}: {worst:?}");
    }
}
