//! Pictures for files: a finished picture at the size that is wanted of it, with the text over it. A
//! lean tier's picture is enlarged first, so that text on it can be read.

use crate::governor::Tier;
use crate::gpu::Gpu;
use crate::passes::{COLOUR, texture_descriptor, view};
use crate::present::blit::{Blit, Shown};
use crate::stereo::Arrangement;
use crate::target::Target;
use wgpu::{Texture, TextureUsages, TextureView};

/// Least size of a channel in files, px: a module's instructions stand below the working area in
/// letters of ten pixels, which are read without effort.
pub const LEAST_PX: [u32; 2] = [400, 320];
/// Size of a channel of the small pictures for console and recorder, px: both are 640 px wide, so that
/// nothing scales the text again.
pub const SMALL_PX: [u32; 2] = [320, 256];

/// Size of a channel of this tier's pictures in files, px: its own, or the smallest whole multiple that
/// reaches [`LEAST_PX`].
pub fn output_px(tier: &Tier) -> [u32; 2] {
    let times = LEAST_PX[0].div_ceil(tier.width_px);
    [times * tier.width_px, times * tier.height_px]
}

/// Draws pictures for files.
pub struct Composer {
    blit: Blit,
    picture: Option<(Texture, TextureView)>,
}

impl Composer {
    /// Makes the passes; the picture follows with its first size.
    pub fn new(gpu: &Gpu) -> Self {
        Composer { blit: Blit::new(&gpu.device, COLOUR), picture: None }
    }

    /// Both channels of `target` beside each other, each `channel_px` large, with `text` (lines of
    /// `protocol::scene_text`) over them, to be read back. `arrangement` is what a file makes of them
    /// later.
    pub fn compose(
        &mut self,
        gpu: &Gpu,
        target: &Target,
        channel_px: [u32; 2],
        text: &str,
        arrangement: Arrangement,
    ) -> &Texture {
        let size_px = [2 * channel_px[0], channel_px[1]];
        let is = |texture: &Texture| [texture.width(), texture.height()] == size_px;
        self.picture = self.picture.take().filter(|(texture, _)| is(texture));
        let (texture, surface) = self.picture.get_or_insert_with(|| {
            let usage = TextureUsages::RENDER_ATTACHMENT | TextureUsages::COPY_SRC;
            let texture = gpu.device.create_texture(&texture_descriptor("file", COLOUR, size_px, usage));
            let surface = view(&texture);
            (texture, surface)
        });
        let shown = Shown {
            arrangement: Arrangement::SideBySide,
            channel: 0,
            text,
            text_scale: arrangement.text_scale(),
        };
        self.blit.draw(gpu, target, surface, size_px, shown);
        texture
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::governor::TIERS;

    #[test]
    fn pictures_in_files_keep_their_shape_and_are_never_smaller_than_text_needs() {
        for tier in &TIERS {
            let [w, h] = output_px(tier);
            assert!(
                w >= LEAST_PX[0] && h >= LEAST_PX[1] && w < 2 * LEAST_PX[0].max(tier.width_px),
                "{tier:?}"
            );
            assert_eq!((w % tier.width_px, w * tier.height_px), (0, h * tier.width_px));
        }
        assert_eq!([5, 6, 8].map(|i| output_px(&TIERS[i])), [[400, 320], [640, 512], [480, 384]]);
    }
}
