//! A fundus photograph: how it shows its eye, and what speaks against that.
//!
//! Photographers name a field by the angle that the camera takes in, which is measured before the
//! eye: 30°, 45° or 50°. The same field is 1.38 times as wide about the eye's centre, where the map
//! of the retina is laid out; that ratio is the shipped photograph's, a 45° one.

use crate::assets::AssetError;
use image::RgbImage;
use scene::Side;
use settings::commands::FundusEye;

pub use settings::commands::FundusArgs;

/// Fovea in the shipped photograph, share of its width.
const FOVEA: [f32; 2] = [0.503, 0.497];
/// Radius of a photograph's round field that is used, share of its width.
pub const FIELD_RADIUS: f32 = 0.478;
/// Angle at the eye's centre from the middle of a field of [`FIELD_DEG`] to its border, rad. The
/// optic disc lies [`DISC`] from the fovea in the picture and 4.5 mm on a retina of 11.5 mm radius.
pub const FIELD_ANGLE: f32 = 4.5 / 11.5 * FIELD_RADIUS / DISC;
/// Field of the shipped photograph as photographers give it, degrees.
const FIELD_DEG: f32 = 45.0;
/// From the fovea to the optic disc at that field, share of the width.
const DISC: f32 = 0.345;
/// Farthest that the fovea may lie from the middle of the field, share of the field's radius.
const MOST_OFF: f32 = 0.8;

/// Cells along a side in which the optic disc is looked for.
const CELLS: i32 = 64;
/// Half widths of the squares that are compared, cells: one lies in a disc, one has it in its
/// middle.
const DISC_CELLS: i32 = 3;
const AROUND_CELLS: i32 = 10;
/// By how much an optic disc is brighter than what lies around it, of 255.
const DISC_CONTRAST: f32 = 15.0;
/// A pixel whose channels are all below this is black, of 255.
const BLACK: u8 = 20;
/// Share of the field that may be black.
const MOST_BLACK: f32 = 0.02;

/// A photograph and how it shows the fundus.
#[derive(Debug, Clone)]
pub struct Photograph {
    /// The picture.
    pub picture: RgbImage,
    /// The eye in it.
    pub eye: Side,
    /// Fovea, in widths of the picture from the upper left.
    pub fovea: [f32; 2],
    /// Middle of the round field, in widths.
    middle: [f32; 2],
    /// Angle at the eye's centre that [`FIELD_RADIUS`] covers, rad.
    field_rad: f32,
}

impl Photograph {
    /// A picture that shows its eye as the shipped photograph does: a left one, the fovea in the
    /// middle of a field of 45°.
    pub fn new(picture: RgbImage) -> Self {
        Photograph { picture, eye: Side::Left, fovea: FOVEA, middle: FOVEA, field_rad: FIELD_ANGLE }
    }

    /// A picture as the arguments describe it.
    ///
    /// # Errors
    /// If the fovea lies at the border of the field or beyond.
    pub fn described(picture: RgbImage, args: &FundusArgs) -> Result<Self, AssetError> {
        let mut photograph = Self::new(picture);
        if args.fundus_eye == Some(FundusEye::Right) {
            photograph.eye = Side::Right;
        }
        if photograph.eye == Side::Right {
            (photograph.fovea[0], photograph.middle[0]) = (1.0 - FOVEA[0], 1.0 - FOVEA[0]);
        }
        photograph.field_rad *= args.fundus_field.unwrap_or(FIELD_DEG) / FIELD_DEG;
        if let Some([x, y]) = args.fundus_fovea {
            let tall = photograph.picture.height() as f32 / photograph.picture.width() as f32;
            (photograph.fovea, photograph.middle) = ([x, y * tall], [0.5, 0.5 * tall]);
            let [dx, dy] = photograph.to_middle();
            if dx.hypot(dy) > MOST_OFF * FIELD_RADIUS {
                let file = args.fundus.as_deref().map(|f| f.display().to_string()).unwrap_or_default();
                let problem = format!("--fundus-fovea {x},{y}: expected a place well inside the round field");
                return Err(AssetError::Photograph { file, problem });
            }
        }
        Ok(photograph)
    }

    fn to_middle(&self) -> [f32; 2] {
        [self.middle[0] - self.fovea[0], self.middle[1] - self.fovea[1]]
    }

    /// From the fovea to the border of the round field in a direction of the picture: widths of the
    /// picture, and the angle at the eye's centre, rad.
    pub fn border(&self, towards: [f32; 2]) -> (f32, f32) {
        let [x, y] = self.to_middle();
        let along = x * towards[0] + y * towards[1];
        let widths = along + (FIELD_RADIUS * FIELD_RADIUS - (x * x + y * y) + along * along).max(0.0).sqrt();
        (widths, self.field_rad * (widths / FIELD_RADIUS))
    }

    /// The direction in the picture of a canonical one, which is temporal and down.
    pub fn towards(&self, [temporal, down]: [f32; 2]) -> [f32; 2] {
        [if self.eye == Side::Left { temporal } else { -temporal }, down]
    }

    /// Colour in a canonical direction, `widths` of the picture from the fovea.
    pub fn colour(&self, canonical: [f32; 2], widths: f32) -> [f32; 3] {
        let (towards, width) = (self.towards(canonical), self.picture.width() as f32);
        let at = |c: usize| (self.fovea[c] + towards[c] * widths) * width - 0.5;
        bilinear(&self.picture, at(0), at(1))
    }

    /// Colour in a canonical direction at a share of the way to the border.
    pub fn at_share(&self, canonical: [f32; 2], share: f32) -> [f32; 3] {
        let (border, _) = self.border(self.towards(canonical));
        self.colour(canonical, border * share)
    }

    /// Why the photograph may not be of the given kind, as a text.
    pub fn doubts(&self) -> Vec<String> {
        let black = self.black_share();
        let dark = (black > MOST_BLACK).then(|| {
            format!(
                "{:.0} % of the round field that is laid on the retina is black: crop the picture to its field, \
                 so that this fills it",
                (100.0 * black).max(1.0)
            )
        });
        let nasal = if self.eye == Side::Left { -1.0 } else { 1.0 };
        let other = self.disc_offset().filter(|offset| offset * nasal < 0.0).map(|_| {
            let (is, said) = if self.eye == Side::Left { ("right", "left") } else { ("left", "right") };
            format!(
                "the optic disc seems to lie on the {is} of the fovea, as in a {is} eye, not a {said} one: \
                 --fundus-eye {is} if it is, or --fundus-fovea X,Y"
            )
        });
        dark.into_iter().chain(other).collect()
    }

    fn is_in_field(&self, x_px: f32, y_px: f32, share: f32) -> bool {
        let width = self.picture.width() as f32;
        (x_px / width - self.middle[0]).hypot(y_px / width - self.middle[1]) < share * FIELD_RADIUS
    }

    /// Share of the field that is black.
    fn black_share(&self) -> f32 {
        let step = (self.picture.width() / 256).max(1);
        let (mut all, mut black) = (0u32, 0u32);
        for (x, y, pixel) in self.picture.enumerate_pixels() {
            let looked_at = x.is_multiple_of(step) && y.is_multiple_of(step);
            if looked_at && self.is_in_field(x as f32 + 0.5, y as f32 + 0.5, 0.98) {
                all += 1;
                black += u32::from(pixel.0.iter().all(|c| *c < BLACK));
            }
        }
        black as f32 / all.max(1) as f32
    }

    /// How far the optic disc lies beside the fovea, in widths, right of it above 0; `None` where
    /// there is nothing like one at its distance.
    fn disc_offset(&self) -> Option<f32> {
        let cells = Cells::of(self);
        let places = (0..CELLS).flat_map(|y| (0..CELLS).map(move |x| [x, y]));
        let contrast = |[x, y]: [i32; 2]| {
            let inside = self.is_in_field(cells.middle_px(x), cells.middle_px(y), 0.9);
            let [disc, around] = [DISC_CELLS, AROUND_CELLS].map(|half| cells.mean([x, y], half));
            if inside { disc - around } else { 0.0 }
        };
        let (place, contrast) =
            places.map(|p| (p, contrast(p))).max_by(|a, b| a.1.total_cmp(&b.1)).unwrap_or(([0, 0], 0.0));
        let offset = cells.middle_px(place[0]) / self.picture.width() as f32 - self.fovea[0];
        let expected = DISC * FIELD_ANGLE / self.field_rad;
        (contrast > DISC_CONTRAST && offset.abs() > 0.5 * expected).then_some(offset)
    }
}

/// Green of a photograph's field, averaged in cells.
struct Cells {
    edge_px: f32,
    /// Sum and number of pixels.
    sums: Vec<(f32, f32)>,
}

impl Cells {
    fn of(photograph: &Photograph) -> Self {
        let picture = &photograph.picture;
        let edge_px = picture.width().max(picture.height()) as f32 / CELLS as f32;
        let mut sums = vec![(0.0, 0.0); (CELLS * CELLS) as usize];
        for (x, y, pixel) in picture.enumerate_pixels() {
            if photograph.is_in_field(x as f32 + 0.5, y as f32 + 0.5, 1.0) {
                let [cx, cy] = [x, y].map(|c| ((c as f32 / edge_px) as usize).min(CELLS as usize - 1));
                let (sum, count) = &mut sums[cy * CELLS as usize + cx];
                (*sum, *count) = (*sum + f32::from(pixel.0[1]), *count + 1.0);
            }
        }
        Cells { edge_px, sums }
    }

    fn middle_px(&self, cell: i32) -> f32 {
        (cell as f32 + 0.5) * self.edge_px
    }

    /// Mean over a square about a cell, as far as it lies in the field.
    fn mean(&self, [x, y]: [i32; 2], half: i32) -> f32 {
        let range = |c: i32| (c - half).max(0)..=(c + half).min(CELLS - 1);
        let cells = range(y).flat_map(|v| range(x).map(move |u| (v * CELLS + u) as usize));
        let (sum, count) = cells.fold((0.0, 0.0), |(s, n), i| (s + self.sums[i].0, n + self.sums[i].1));
        sum / f32::max(count, 1.0)
    }
}

fn bilinear(picture: &RgbImage, u: f32, v: f32) -> [f32; 3] {
    let (w, h) = (picture.width() as i32, picture.height() as i32);
    let (x, y) = (u.floor(), v.floor());
    let (fx, fy) = (u - x, v - y);
    let at = |dx: i32, dy: i32| {
        let (px, py) = ((x as i32 + dx).clamp(0, w - 1), (y as i32 + dy).clamp(0, h - 1));
        picture.get_pixel(px as u32, py as u32).0.map(f32::from)
    };
    let (a, b, c, d) = (at(0, 0), at(1, 0), at(0, 1), at(1, 1));
    std::array::from_fn(|i| {
        (a[i] * (1.0 - fx) + b[i] * fx) * (1.0 - fy) + (c[i] * (1.0 - fx) + d[i] * fx) * fy
    })
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::assets::shipped_photograph;
    use crate::fundus_map::bake;
    use image::Rgb;
    use image::imageops::flip_horizontal;

    fn args(eye: Option<Side>, fovea: Option<[f32; 2]>, field: Option<f32>) -> FundusArgs {
        let eye = eye.map(|eye| if eye == Side::Left { FundusEye::Left } else { FundusEye::Right });
        FundusArgs { fundus: None, fundus_eye: eye, fundus_fovea: fovea, fundus_field: field }
    }

    fn described(picture: &RgbImage, args: &FundusArgs) -> Photograph {
        Photograph::described(picture.clone(), args).unwrap()
    }

    /// An even ground with a bright disc `at` (shares) in it, black beyond `radius`.
    fn drawn(at: [f32; 2], radius: f32) -> RgbImage {
        RgbImage::from_fn(600, 600, |x, y| {
            let from = |c: [f32; 2]| (x as f32 / 600.0 - c[0]).hypot(y as f32 / 600.0 - c[1]);
            match (from([0.5; 2]) < radius, from(at) < 0.065) {
                (false, _) => Rgb([3, 2, 2]),
                (true, true) => Rgb([230, 200, 120]),
                (true, false) => Rgb([180, 80, 50]),
            }
        })
    }

    #[test]
    fn the_other_eye_is_doubted_and_the_one_that_is_named_is_not() {
        let shipped = shipped_photograph().unwrap();
        let mirrored = flip_horizontal(&shipped);
        for (picture, right) in [
            (shipped, false),
            (mirrored, true),
            (drawn([0.16, 0.5], 0.5), false),
            (drawn([0.84, 0.5], 0.5), true),
        ] {
            let [left_doubts, right_doubts] = [Side::Left, Side::Right]
                .map(|eye| described(&picture, &args(Some(eye), None, None)).doubts());
            let (wrong, good) = if right { (left_doubts, right_doubts) } else { (right_doubts, left_doubts) };
            assert_eq!(good, Vec::<String>::new());
            let named = if right { "--fundus-eye right" } else { "--fundus-eye left" };
            assert!(wrong.len() == 1 && wrong[0].contains(named), "{wrong:?}");
        }
        let even = RgbImage::from_pixel(600, 600, Rgb([180, 80, 50]));
        assert!(Photograph::new(even).doubts().is_empty(), "no disc, no doubt");
    }

    #[test]
    fn a_field_that_is_black_in_part_is_doubted() {
        let small = Photograph::new(drawn([0.2, 0.5], 0.4)).doubts();
        assert!(small.len() == 1 && small[0].contains("27 %"), "{small:?}");
        let mut half = shipped_photograph().unwrap();
        half.enumerate_pixels_mut().filter(|(_, y, _)| *y > 700).for_each(|(_, _, p)| *p = Rgb([0; 3]));
        assert!(Photograph::new(half).doubts()[0].contains("is black"));
    }

    #[test]
    fn a_right_eye_laid_on_is_the_mirror_image_of_a_left_one() {
        let shipped = shipped_photograph().unwrap();
        let right = described(&flip_horizontal(&shipped), &args(Some(Side::Right), None, None));
        for eye in [Side::Left, Side::Right] {
            let [a, b] = [&Photograph::new(shipped.clone()), &right].map(|p| bake(p, 128, eye));
            let off = a.iter().zip(&b).map(|(a, b)| a.abs_diff(*b)).max().unwrap();
            assert!(off <= 2, "{off} of 255");
        }
    }

    #[test]
    fn fovea_and_field_say_what_lies_where() {
        let picture = drawn([0.7, 0.4], 0.5);
        let own = described(&picture, &args(None, Some([0.7, 0.4]), None));
        let map = bake(&own, 129, Side::Left);
        let pole = (64 * 129 + 64) * 4;
        assert!(map[pole + 1] > 180, "the fovea lies at the pole: {:?}", &map[pole..pole + 4]);
        let [narrow, wide] = [30.0, 60.0].map(|f| described(&picture, &args(None, None, Some(f))));
        assert!((wide.border([1.0, 0.0]).1 / narrow.border([1.0, 0.0]).1 - 2.0).abs() < 1e-5);
        // A field of 45°: 6.2 mm on a retina of 11.5 mm radius.
        let arc_mm = described(&picture, &args(None, None, Some(45.0))).border([0.0, 1.0]).1 * 11.5;
        assert!((arc_mm - 6.23).abs() < 0.02, "{arc_mm} mm");
        let (towards, away) = (own.border([-1.0, 0.0]).0, own.border([1.0, 0.0]).0);
        assert!(towards > FIELD_RADIUS && away < FIELD_RADIUS && (towards - away - 0.4).abs() < 1e-5);
        let outside = Photograph::described(picture, &args(None, Some([0.02, 0.5]), None)).unwrap_err();
        assert!(outside.to_string().contains("--fundus-fovea 0.02,0.5"), "{outside}");
    }
}
