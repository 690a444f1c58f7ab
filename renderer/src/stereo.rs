//! How the two channels share one picture or one display.
//!
//! Passes draw the channels side by side; an arrangement makes of that what a display takes. The
//! same rules hold for a window (on the device, `present::blit`) and for files (here, [`arrange`]).

use crate::readback::Picture;

pub use settings::commands::Arrangement;

/// ITU-R BT.601 luminance of display values, in 1/256 as the device has it in 1/255.
const LUMA: [u32; 3] = [77, 150, 29];

/// Arranges `picture`, which holds the channels side by side, in place.
///
/// A red fundus in coloured anaglyphs is bright for the one eye and black for the other, which
/// no one can fuse; the grey kind has equal brightness in both.
pub fn arrange(picture: &mut Picture, arrangement: Arrangement) {
    let (width, height) = (picture.width_px as usize / 2, picture.height_px as usize);
    if arrangement.for_files() == Arrangement::SideBySide || picture.rgba.len() < 8 * width * height {
        return;
    }
    for y in 0..height {
        for x in 0..width {
            let pixel = |channel: usize| {
                let at = ((2 * y + channel) * width + x) * 4;
                [0, 1, 2, 3].map(|i| picture.rgba[at + i])
            };
            let chosen = match arrangement {
                Arrangement::Anaglyph => {
                    let ([red, cyan], opaque) = ([luma(pixel(0)), luma(pixel(1))], 255);
                    [red, cyan, cyan, opaque]
                }
                Arrangement::Interleaved => pixel(y % 2),
                Arrangement::Right => pixel(1),
                _ => pixel(0),
            };
            // What is written lies before everything that is still to be read.
            picture.rgba[(y * width + x) * 4..][..4].copy_from_slice(&chosen);
        }
    }
    picture.rgba.truncate(width * height * 4);
    picture.width_px = width as u32;
}

fn luma([r, g, b, _]: [u8; 4]) -> u8 {
    let sum: u32 = [r, g, b].iter().zip(LUMA).map(|(&c, k)| u32::from(c) * k).sum();
    ((sum + 128) >> 8) as u8
}

#[cfg(test)]
mod tests {
    use super::*;

    /// Left channel (1, y, x), right channel (2, y, x).
    fn both() -> Picture {
        let pixel = |i: u32| {
            let (x, y) = (i % 6, i / 6);
            [1 + (x / 3) as u8, y as u8, (x % 3) as u8, 255]
        };
        Picture { width_px: 6, height_px: 4, rgba: (0..24).flat_map(pixel).collect() }
    }

    #[test]
    fn one_channel_alone_or_line_by_line() {
        for (arrangement, channel) in [
            (Arrangement::Left, (|_| 1) as fn(u32) -> u8),
            (Arrangement::Right, |_| 2),
            (Arrangement::Interleaved, |y| 1 + (y % 2) as u8),
        ] {
            let mut picture = both();
            arrange(&mut picture, arrangement);
            assert_eq!([picture.width_px, picture.height_px], arrangement.size_px(3, 4));
            for (x, y) in (0..4).flat_map(|y| (0..3).map(move |x| (x, y))) {
                assert_eq!(picture.rgb(x, y), [channel(y), y as u8, x as u8], "{arrangement:?}");
            }
        }
    }

    #[test]
    fn anaglyphs_hold_each_channels_luminance() {
        let mut picture =
            Picture { width_px: 2, height_px: 1, rgba: vec![200, 0, 0, 255, 255, 255, 255, 255] };
        arrange(&mut picture, Arrangement::Anaglyph);
        assert_eq!((picture.rgb(0, 0), picture.width_px), ([60, 255, 255], 1));
    }

    #[test]
    fn files_do_not_alternate() {
        let mut picture = both();
        arrange(&mut picture, Arrangement::Sequential);
        assert_eq!(picture, both());
    }
}
