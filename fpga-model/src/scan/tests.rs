//! Tests of the extractor: against a flood fill, against ideal centres, against rubbish.

use super::*;
use protocol::fields::DARK;

use bytemuck::Zeroable;
use nalgebra::{Matrix2, Vector2};
use proptest::prelude::*;
use protocol::blobs::{BLOB_MERGED, Colour};
use protocol::limits::MAX_BLOBS;
use protocol::message::Message;
use rig::Rig;
use scene::{DEFAULT_SCENE, SceneFile};
use surgeon::motion::MotionSource;
use virtual_rig::painter::Painter;
use virtual_rig::projection::{MarkerImage, Markers};

fn scan(picture: &FieldPicture) -> BlobField {
    let mut out = BlobField::zeroed();
    out.exposed_ns = 1;
    Scanner::new(Settings::default(), picture.width, picture.height).scan(picture, &mut out);
    out
}

/// A small field from letters: `r` red, `g` green, anything else dark; each letter is two pixels
/// wide.
fn field_of(rows: &[&str]) -> FieldPicture {
    let width = rows.iter().map(|r| 2 * r.len()).max().unwrap();
    let mut picture = FieldPicture::new([width as u32, 2 * rows.len() as u32]);
    for (y, row) in rows.iter().enumerate() {
        for (i, letter) in row.chars().enumerate() {
            let pixel = match letter {
                'r' => Colour::Red.reference(),
                'g' => Colour::Green.reference(),
                _ => [DARK, 128, 128],
            };
            picture.luma[y * width + 2 * i..][..2].fill(pixel[0]);
            picture.blue[y * width / 2 + i] = pixel[1];
            picture.red[y * width / 2 + i] = pixel[2];
        }
    }
    picture
}

/// Class and pixels of every component of a field, however small.
fn areas(picture: &FieldPicture) -> Vec<(u8, u32)> {
    let settings = Settings { high: [0; CLASSES], least_area: 0, least_lines: 1, ..Settings::default() };
    let mut scanner = Scanner::new(settings, picture.width, picture.height);
    let mut all = Vec::new();
    let mut push = |found: Found| all.push((found.sums.class, found.sums.area));
    scanner.begin();
    for y in 0..picture.height {
        let (luma, blue, red) = picture.line(y);
        scanner.line(luma, blue, red, &mut push);
    }
    scanner.end(&mut push);
    all.sort_unstable();
    all
}

#[test]
fn arms_that_meet_further_down_are_one_component() {
    let u = field_of(&[
        "..r..r..r..",
        "..r..r..r..",
        "..r..rrrr..",
        "..rrrr.....",
        "...........",
        ".gg........",
        ".gg........",
    ]);
    // 3 + 3 + 6 + 4 letters of two pixels.
    assert_eq!(areas(&u), [(Colour::Red as u8, 30), (Colour::Green as u8, 8)]);
}

#[test]
fn diagonal_neighbours_touch_and_colours_do_not_mix() {
    let steps = field_of(&["rr.......", "rr.......", "..rr.....", "..rrgg...", "....gg...", "....gg..."]);
    assert_eq!(areas(&steps), [(Colour::Red as u8, 16), (Colour::Green as u8, 12)]);
}

#[test]
fn blobs_come_as_soon_as_the_lines_below_are_known() {
    let picture =
        field_of(&["rrr..", "rrr..", ".....", "...gg", "...gg", "...gg", ".....", ".....", "....."]);
    let mut scanner = Scanner::new(Settings::default(), picture.width, picture.height);
    let mut out = BlobField::zeroed();
    scanner.begin();
    let mut counts = Vec::new();
    for y in 0..picture.height {
        let (luma, blue, red) = picture.line(y);
        scanner.line(luma, blue, red, &mut |found| found.blobs().for_each(|blob| out.push(blob)));
        counts.push(out.count);
    }
    // Red ends in line 1, green in line 5; line 2, or 6, is weighed once line 4, or 8, is known.
    assert_eq!(counts, [0, 0, 0, 0, 1, 1, 1, 1, 2]);
}

#[test]
fn what_finds_no_room_is_counted() {
    // 130 columns of red pairs: 128 runs a line fit.
    let row = "r.".repeat(130);
    let rows: Vec<&str> = vec![&row; 8];
    let field = scan(&field_of(&rows));
    assert_eq!(field.count as usize, MAX_BLOBS);
    assert_eq!(field.blobs_left_out as usize, (CAMERA.labels - MAX_BLOBS) + 2 * 8);
}

/// Every marker of a rig drawn and extracted, over many fields: errors against the ideal centre, px
/// of the frame, of blobs without a flag.
fn errors(fields: u64) -> (Vec<Vector2<f64>>, usize, Vec<f64>) {
    let rig = Rig::load_or_shipped(None).unwrap();
    let scene = SceneFile::load(DEFAULT_SCENE).unwrap();
    let mut source = MotionSource::new(&scene, &rig, None, 11);
    let (markers, painter) = (Markers::of(&rig), Painter::new(rig.cameras()[0].size_px, 11));
    let (mut seen, mut picture) = (Markers::list(), FieldPicture::new(rig.cameras()[0].size_px));
    let (mut all, mut missed, mut scaled) = (Vec::new(), 0, Vec::new());
    for number in 0..fields {
        let motion = source.at(number * 97_000_000);
        for camera in rig.cameras() {
            markers.project(&camera, &motion, &mut seen);
            painter.draw(&seen, camera.id, number, &mut picture);
            let mut field = scan(&picture);
            field.parity = (number & 1) as u32;
            for marker in seen.iter().filter(|m| stands_alone(m, &seen)) {
                let of_it = |b: &&protocol::blobs::Blob| {
                    let at = Vector2::new(b.x_px, field.y_frame_px(b));
                    b.colour == marker.colour as u32
                        && (at - marker.centre_px).norm() < marker.half_size_px().x
                };
                match field.blobs().iter().find(of_it) {
                    Some(b) => {
                        assert_eq!(b.flags, 0, "{marker:?} {b:?}");
                        let error = Vector2::new(b.x_px, field.y_frame_px(b)) - marker.centre_px;
                        scaled.push(error.x * error.x / b.var_x_px2 + error.y * error.y / b.var_y_px2);
                        all.push(error);
                    }
                    None => missed += 1,
                }
            }
        }
    }
    (all, missed, scaled)
}

/// Nothing overlaps it and the whole of it is in the picture.
fn stands_alone(marker: &MarkerImage, seen: &[MarkerImage]) -> bool {
    let (c, r) = (marker.centre_px, marker.half_size_px());
    let whole = c.x > r.x + 4.0 && c.y > r.y + 8.0 && c.x < 715.0 - r.x && c.y < 567.0 - r.y;
    whole
        && seen
            .iter()
            .filter(|other| *other != marker)
            .all(|other| (other.centre_px - c).norm() > r.norm() + other.half_size_px().norm() + 8.0)
}

#[test]
fn centres_are_within_a_twentieth_of_a_pixel() {
    let (errors, missed, scaled) = errors(60);
    let n = errors.len() as f64;
    assert!(n > 1000.0 && missed == 0, "{n} found, {missed} missed");
    let mean = errors.iter().sum::<Vector2<f64>>() / n;
    let square = errors.iter().map(|e| e.component_mul(e)).sum::<Vector2<f64>>() / n;
    let rms = square.map(f64::sqrt);
    println!("{n} centres: bias {:.4} {:.4}, rms {:.4} {:.4} px of the frame", mean.x, mean.y, rms.x, rms.y);
    // What is left of the light from one side, which shows along the lines.
    assert!(mean.x.abs() < 0.03 && mean.y.abs() < 0.005, "bias {mean}");
    assert!(rms.x < 0.05 && rms.y < 0.05, "rms {rms}");
    let chi2 = scaled.iter().sum::<f64>() / n;
    println!("variance: mean of squared error over variance {chi2:.2} (2 expected)");
    assert!((0.5..4.0).contains(&chi2), "the stated variance is off: {chi2}");
}

#[test]
fn two_markers_of_a_colour_that_touch_are_told_apart() {
    let painter = Painter::new([720, 576], 5);
    let mut picture = FieldPicture::new([720, 576]);
    let marker = |x: f64| MarkerImage {
        body: 0,
        marker: 0,
        colour: Colour::Red,
        centre_px: Vector2::new(x, 200.0),
        // A ball: a pixel of the frame is 59 wide and 54 high.
        shape_px2: Matrix2::new(110.0, 0.0, 0.0, 110.0 * 59.0 * 59.0 / (54.0 * 54.0)),
        depth_mm: 80.0,
    };
    painter.draw(&[marker(300.0), marker(320.0)], 0, 0, &mut picture);
    let field = scan(&picture);
    assert_eq!(field.count, 2);
    for (blob, x) in field.blobs().iter().zip([300.0, 320.0]) {
        assert_eq!(blob.flags, BLOB_MERGED);
        assert!((blob.x_px - x).abs() < 0.2 && (blob.y_field_px - 100.0).abs() < 0.1, "{blob:?}");
    }
}

proptest! {
    #[test]
    fn rubbish_is_scanned_without_a_panic(seed in any::<u64>(), width in 1u32..200, lines in 1u32..40, low in any::<u8>()) {
        let mut picture = FieldPicture::new([2 * width, 2 * lines]);
        let mut state = seed | 1;
        let mut byte = || { state ^= state << 13; state ^= state >> 7; state ^= state << 17; (state >> 24) as u8 };
        for plane in [&mut picture.luma, &mut picture.blue, &mut picture.red] {
            plane.iter_mut().for_each(|p| *p = byte().max(low));
        }
        let field = scan(&picture);
        prop_assert!(field.count as usize <= MAX_BLOBS && field.validate().is_ok());
        for blob in field.blobs() {
            prop_assert!(blob.x_px >= 0.0 && blob.x_px < f64::from(2 * width));
            prop_assert!(blob.y_field_px >= 0.0 && blob.y_field_px < f64::from(lines));
            prop_assert!(blob.var_x_px2 > 0.0 && blob.var_y_px2 > 0.0);
        }
    }
}
