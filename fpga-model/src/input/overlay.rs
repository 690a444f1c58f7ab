//! Overlay of the blobs found on their picture.
//!
//! Each blob has a cross at its centre and a box in its colour. A box of dashes marks a merged
//! blob, a second box around it a clipped one, a white cross a saturated one. The cross of a blob
//! that is smaller than it is open: its arms lie outside of the box. Every mark has a dark border,
//! so that it is seen before any ground, also its own colour. Lines of a field are drawn twice, so
//! that the picture has the shape of a frame.

use super::FieldView;
use crate::colours::convert::rgb_of_ycc;
use image::{Rgb, RgbImage};
use protocol::blobs::{BLOB_CLIPPED, BLOB_MERGED, BLOB_SATURATED, Blob, Colour};

/// Arm of a cross, px.
const ARM: i64 = 3;
/// A cross with its border leaves enough of a blob to be seen that is larger than this, px.
const CROSS_PX: f64 = (2 * ARM + 3) as f64;
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
    let mut marks = Marks { size: size.map(i64::from), painted: Vec::new() };
    for (blob, &sides) in blobs {
        marks.add(blob, sides, f64::from(lines));
    }
    marks.draw(&mut image);
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

/// The pixels of the marks.
struct Marks {
    /// Of the picture, px.
    size: [i64; 2],
    painted: Vec<(i64, i64, Rgb<u8>)>,
}

impl Marks {
    fn add(&mut self, blob: &Blob, [left, right, top, bottom]: [f64; 4], lines: f64) {
        // The middle of the rows that a line becomes lies below its first.
        let half_row = (lines - 1.0) / 2.0;
        let row = |y: f64| y * lines + half_row;
        let sides = [left, right, row(top) - half_row, row(bottom) + half_row];
        let colour = paint(blob.colour);
        let has = |flag: u32| blob.flags & flag != 0;
        self.frame(sides, MARGIN, colour, has(BLOB_MERGED));
        if has(BLOB_CLIPPED) {
            self.frame(sides, 2.0 * MARGIN, colour, false);
        }
        let cross = if has(BLOB_SATURATED) { SATURATED } else { colour };
        let centre = [blob.x_px, row(blob.y_field_px)].map(|v| v.round() as i64);
        let is_small = sides[1] - sides[0] < CROSS_PX || sides[3] - sides[2] < CROSS_PX;
        if is_small {
            let margin = if has(BLOB_CLIPPED) { 2.0 * MARGIN } else { MARGIN };
            self.open_cross(centre, self.corners(sides, margin), cross);
        } else {
            (-ARM..=ARM).for_each(|d| self.put(centre[0] + d, centre[1], cross));
            (-ARM..=ARM).for_each(|d| self.put(centre[0], centre[1] + d, cross));
        }
    }

    fn put(&mut self, x: i64, y: i64, colour: Rgb<u8>) {
        self.painted.push((x, y, colour));
    }

    /// A box about a blob's, left, right, top and bottom. What lies beyond the picture is clamped to
    /// just outside of it.
    fn corners(&self, sides: [f64; 4], margin: f64) -> [i64; 4] {
        let cut = |v: f64, n: i64| v.clamp(-1.0, n as f64) as i64;
        let [width, height] = self.size;
        [
            cut((sides[0] - margin).floor(), width),
            cut((sides[1] + margin).ceil(), width),
            cut((sides[2] - margin).floor(), height),
            cut((sides[3] + margin).ceil(), height),
        ]
    }

    fn frame(&mut self, sides: [f64; 4], margin: f64, colour: Rgb<u8>, dashed: bool) {
        let [left, right, top, bottom] = self.corners(sides, margin);
        let drawn = |i: i64| !dashed || (i / DASH) % 2 == 0;
        for x in (left..=right).filter(|x| drawn(x - left)) {
            self.put(x, top, colour);
            self.put(x, bottom, colour);
        }
        for y in (top..=bottom).filter(|y| drawn(y - top)) {
            self.put(left, y, colour);
            self.put(right, y, colour);
        }
    }

    /// Arms that point at a centre from outside of a box.
    fn open_cross(&mut self, [x, y]: [i64; 2], [left, right, top, bottom]: [i64; 4], colour: Rgb<u8>) {
        for d in 1..=ARM {
            self.put(left - d, y, colour);
            self.put(right + d, y, colour);
            self.put(x, top - d, colour);
            self.put(x, bottom + d, colour);
        }
    }

    /// Draws the borders first, so that none hides a mark.
    fn draw(&self, image: &mut RgbImage) {
        for &(x, y, _) in &self.painted {
            for (dx, dy) in [(0, -1), (0, 1), (-1, 0), (1, 0)] {
                put(image, x + dx, y + dy, EDGE);
            }
        }
        for &(x, y, colour) in &self.painted {
            put(image, x, y, colour);
        }
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::input::{Interlace, Picture};

    /// A grey picture of 40 × 20 with the marks of blobs, each with its box.
    fn drawn(blobs: &[(Blob, [f64; 4])], lines: u32) -> RgbImage {
        let chroma = vec![128; 20 * 20];
        let (luma, blue) = (vec![140; 800], chroma.clone());
        let picture = Picture { width: 40, height: 20, luma, blue, red: chroma, ..Picture::default() };
        let view = picture.view(Interlace::Progressive, 0);
        draw(&view, blobs.iter().map(|(blob, sides)| (blob, sides)), lines)
    }

    /// A blob with a box that reaches `half` pixels from its centre.
    fn blob(x_px: f64, y_field_px: f64, half: f64, flags: u32) -> (Blob, [f64; 4]) {
        let blob = Blob {
            x_px,
            y_field_px,
            area_px: 9.0,
            width_px: 2.0 * half,
            height_px: 2.0 * half,
            var_x_px2: 0.1,
            var_y_px2: 0.1,
            cov_xy_px2: 0.0,
            colour: Colour::Red as u32,
            flags,
        };
        (blob, [x_px - half, x_px + half, y_field_px - half, y_field_px + half])
    }

    fn ground() -> [u8; 3] {
        drawn(&[], 1).get_pixel(0, 0).0
    }

    #[test]
    fn a_blob_is_marked_where_it_is_even_at_the_border() {
        let blobs = [
            blob(20.0, 10.0, 5.0, 0),
            blob(0.0, 19.0, 5.0, BLOB_CLIPPED | BLOB_SATURATED),
            blob(1e9, -1e9, 2.0, 0),
        ];
        let image = drawn(&blobs, 2);
        assert_eq!(image.dimensions(), (40, 40));
        // Line 10 is rows 20 and 21, its middle at 20.5.
        assert_eq!(image.get_pixel(20, 21).0, paint(Colour::Red as u32).0);
        assert_eq!(image.get_pixel(30, 21).0, ground());
        assert_eq!(image.get_pixel(0, 39).0, SATURATED.0);
    }

    #[test]
    fn a_spot_that_is_smaller_than_the_cross_is_left_to_be_seen() {
        for (half, lines) in [(0.0, 1), (1.0, 1), (1.5, 1), (3.0, 1), (1.0, 2)] {
            let image = drawn(&[blob(20.0, 10.0, half, 0)], lines);
            let rows = |y: f64| y * f64::from(lines);
            for y in (rows(10.0 - half) as u32)..=(rows(10.0 + half) as u32) {
                for x in ((20.0 - half).ceil() as u32)..=((20.0 + half) as u32) {
                    assert_eq!(image.get_pixel(x, y).0, ground(), "half {half}: {x}, {y}");
                }
            }
            let red = image.pixels().filter(|p| p.0 == paint(Colour::Red as u32).0).count();
            assert!(red >= 4 * ARM as usize + 8, "box and arms: {red}");
        }
    }

    #[test]
    fn every_mark_is_seen_before_its_own_colour() {
        for (half, flags) in [(1.0, 0), (5.0, 0), (2.0, BLOB_MERGED), (2.0, BLOB_CLIPPED)] {
            let image = drawn(&[blob(20.0, 10.0, half, flags)], 1);
            let is_mark = |x: u32, y: u32| image.get_pixel(x, y).0 == paint(Colour::Red as u32).0;
            let around = |x: u32, y: u32| [(x - 1, y), (x + 1, y), (x, y - 1), (x, y + 1)];
            let mut marks =
                (1..39).flat_map(|x| (1..19).map(move |y| (x, y))).filter(|&(x, y)| is_mark(x, y));
            assert!(marks.clone().count() > 10);
            let is_bordered = |(x, y): (u32, u32)| is_mark(x, y) || image.get_pixel(x, y).0 == EDGE.0;
            assert!(marks.all(|(x, y)| around(x, y).into_iter().all(is_bordered)), "half {half}");
        }
    }
}
