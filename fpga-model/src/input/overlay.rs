//! Overlay of the blobs found on their picture.
//!
//! Each blob has a cross at its centre and a box in its colour. A box of dashes marks a merged
//! blob, a second box around it a clipped one, a white cross a saturated one. Lines of a field are
//! drawn twice, so that the picture has the shape of a frame.

use super::FieldView;
use crate::colours::convert::rgb_of_ycc;
use image::{Rgb, RgbImage};
use protocol::blobs::{BLOB_CLIPPED, BLOB_MERGED, BLOB_SATURATED, Blob, Colour};

/// Arm of a cross, px.
const ARM: i64 = 3;
/// Dash and gap of a merged blob's box, px.
const DASH: i64 = 3;
/// From the blob's box to the drawn one, px.
const MARGIN: f64 = 2.0;
const SATURATED: Rgb<u8> = Rgb([255, 255, 255]);
const EDGE: Rgb<u8> = Rgb([0, 0, 0]);

fn paint(colour: u32) -> Rgb<u8> {
    Rgb(match Colour::from_wire(colour) {
        Some(Colour::Red) => [255, 40, 40],
        Some(Colour::Yellow) => [240, 220, 0],
        Some(Colour::Green) => [0, 200, 60],
        Some(Colour::Cyan) => [0, 210, 230],
        Some(Colour::Blue) => [60, 90, 255],
        Some(Colour::Magenta) => [230, 0, 230],
        Some(Colour::White) | None => [255, 150, 0],
    })
}

/// Draws the blobs on the picture as read, each with its box (left, right, top, bottom). Every line
/// is drawn `lines` times.
pub fn draw<'a>(
    view: &FieldView<'_>,
    blobs: impl Iterator<Item = (&'a Blob, &'a [f64; 4])>,
    lines: u32,
) -> RgbImage {
    let size = [view.picture.width as u32, view.height() as u32 * lines];
    let mut image = RgbImage::from_fn(size[0], size[1], |x, y| {
        Rgb(rgb_of_ycc(view.pixel_as_read(x as usize, (y / lines) as usize)))
    });
    for (blob, &sides) in blobs {
        mark(&mut image, blob, sides, f64::from(lines));
    }
    image
}

/// An image as a PNG file.
///
/// # Errors
/// Where it cannot be encoded.
pub fn png(image: &RgbImage) -> Result<Vec<u8>, image::ImageError> {
    let mut file = std::io::Cursor::new(Vec::new());
    image.write_to(&mut file, image::ImageFormat::Png)?;
    Ok(file.into_inner())
}

fn put(image: &mut RgbImage, x: i64, y: i64, colour: Rgb<u8>) {
    if let (Ok(x), Ok(y)) = (u32::try_from(x), u32::try_from(y))
        && let Some(pixel) = image.get_pixel_mut_checked(x, y)
    {
        *pixel = colour;
    }
}

fn mark(image: &mut RgbImage, blob: &Blob, [left, right, top, bottom]: [f64; 4], lines: f64) {
    // The middle of the rows that a line becomes lies below its first.
    let row = |y: f64| y * lines + (lines - 1.0) / 2.0;
    let half_row = (lines - 1.0) / 2.0;
    let sides = [left, right, row(top) - half_row, row(bottom) + half_row];
    let colour = paint(blob.colour);
    let has = |flag: u32| blob.flags & flag != 0;
    frame(image, sides, MARGIN, colour, has(BLOB_MERGED));
    if has(BLOB_CLIPPED) {
        frame(image, sides, 2.0 * MARGIN, colour, false);
    }
    let [x, y] = [blob.x_px, row(blob.y_field_px)].map(|v| v.round() as i64);
    let cross = if has(BLOB_SATURATED) { SATURATED } else { colour };
    for d in -ARM..=ARM {
        // A dark border keeps it visible before its own colour.
        for (dx, dy) in [(d, -1), (d, 1), (-1, d), (1, d)] {
            put(image, x + dx, y + dy, EDGE);
        }
    }
    for d in -ARM..=ARM {
        put(image, x + d, y, cross);
        put(image, x, y + d, cross);
    }
}

fn frame(image: &mut RgbImage, sides: [f64; 4], margin: f64, colour: Rgb<u8>, dashed: bool) {
    // Coordinates beyond the picture are clamped to just outside of it.
    let cut = |v: f64, n: u32| v.round().clamp(-1.0, f64::from(n)) as i64;
    let [left, right] = [sides[0] - margin, sides[1] + margin].map(|v| cut(v, image.width()));
    let [top, bottom] = [sides[2] - margin, sides[3] + margin].map(|v| cut(v, image.height()));
    let drawn = |i: i64| !dashed || (i / DASH) % 2 == 0;
    for x in (left..=right).filter(|x| drawn(x - left)) {
        put(image, x, top, colour);
        put(image, x, bottom, colour);
    }
    for y in (top..=bottom).filter(|y| drawn(y - top)) {
        put(image, left, y, colour);
        put(image, right, y, colour);
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::input::{Interlace, Picture};

    #[test]
    fn a_blob_is_marked_where_it_is_even_at_the_border() {
        let chroma = vec![128; 20 * 20];
        let (luma, blue) = (vec![16; 800], chroma.clone());
        let mut picture = Picture { width: 40, height: 20, luma, blue, red: chroma, ..Picture::default() };
        picture.invert();
        let blob = |x_px: f64, y_field_px: f64, flags| Blob {
            x_px,
            y_field_px,
            area_px: 9.0,
            width_px: 4.0,
            height_px: 4.0,
            var_x_px2: 0.1,
            var_y_px2: 0.1,
            cov_xy_px2: 0.0,
            colour: Colour::Green as u32,
            flags,
        };
        let blobs = [blob(20.0, 10.0, 0), blob(0.0, 19.0, BLOB_CLIPPED | BLOB_SATURATED), blob(1e9, -1e9, 0)];
        let boxes = blobs.map(|b| [b.x_px - 2.0, b.x_px + 2.0, b.y_field_px - 2.0, b.y_field_px + 2.0]);
        let view = picture.view(Interlace::Progressive, 0);
        let image = draw(&view, blobs.iter().zip(&boxes), 2);
        assert_eq!(image.dimensions(), (40, 40));
        // Line 10 is rows 20 and 21, its middle at 20.5.
        assert_eq!(image.get_pixel(20, 21).0, paint(Colour::Green as u32).0);
        assert_eq!(image.get_pixel(30, 21).0, [0, 0, 0]);
        assert_eq!(image.get_pixel(0, 39).0, SATURATED.0);
    }
}
