//! `vitreo-fpga-model blobs` on photographs: what is on them is known from elsewhere, from other
//! programs' results that came with the pictures, from labels, or from looking at them. Needs the
//! collection of camera pictures (`VITREO_DATA`); without it these tests say so and pass.

use serde_json::Value;
use std::path::{Path, PathBuf};
use std::process::Command;

/// Settings for dots on a target, particles in a flow, stars, and dark beads: those of
/// `docs/real-pictures.md`.
const DOTS: &str = "--spots --background tracked --threshold 10:20 --min-area 3";
const PARTICLES: &str = "--spots --background tracked --threshold 8:16 --min-area 1";
const STARS: &str = "--spots --background tracked --threshold 12:24 --min-area 1";
const BEADS: &str = "--spots --grey --polarity dark --background tracked --threshold 12:24 --min-area 1";

/// The collection, if it is there.
fn cameras() -> Option<PathBuf> {
    skips::data("cameras")
}

/// A blob of a file.
#[derive(Debug, Clone)]
struct Blob {
    x: f64,
    y: f64,
    area: f64,
    colour: String,
}

/// Runs the program; its standard output.
fn run(args: &[&str], files: &[PathBuf]) -> String {
    let mut command = Command::new(env!("CARGO_BIN_EXE_vitreo-fpga-model"));
    let done = command.args(args).args(files).output().expect("the program starts");
    let told = String::from_utf8_lossy(&done.stderr);
    assert!(done.status.success(), "{args:?}: {told}");
    String::from_utf8(done.stdout).expect("text")
}

/// The blobs of each picture.
fn blobs(options: &str, files: &[PathBuf]) -> Vec<Vec<Blob>> {
    let args: Vec<&str> = std::iter::once("blobs").chain(options.split_whitespace()).collect();
    let of_line = |line: &str| {
        let line: Value = serde_json::from_str(line).expect("JSON");
        let blobs = line["blobs"].as_array().expect("blobs").iter().map(|b| Blob {
            x: b["x"].as_f64().expect("x"),
            y: b["y"].as_f64().expect("y"),
            area: b["area"].as_f64().expect("area"),
            colour: b["colour"].as_str().expect("colour").to_owned(),
        });
        blobs.collect()
    };
    let found: Vec<Vec<Blob>> = run(&args, files).lines().map(of_line).collect();
    assert_eq!(found.len(), files.len());
    found
}

fn distance(blob: &Blob, x: f64, y: f64) -> f64 {
    (blob.x - x).hypot(blob.y - y)
}

/// Distances from each point to the nearest blob, where that is within `reach`.
fn matched(points: &[[f64; 2]], blobs: &[Blob], reach: f64) -> Vec<f64> {
    let nearest = |p: &[f64; 2]| blobs.iter().map(|b| distance(b, p[0], p[1])).fold(f64::INFINITY, f64::min);
    let mut found: Vec<f64> = points.iter().map(nearest).filter(|&d| d <= reach).collect();
    found.sort_by(f64::total_cmp);
    found
}

/// Rows of numbers.
fn table(path: &Path) -> Vec<Vec<f64>> {
    let text = std::fs::read_to_string(path).expect("table");
    let row = |l: &str| l.split_whitespace().map(|n| n.parse().expect("number")).collect();
    text.lines().filter(|l| !l.trim().is_empty()).map(row).collect()
}

#[test]
fn the_documented_commands_are_those_that_are_checked() {
    let page = Path::new(env!("CARGO_MANIFEST_DIR")).join("../docs/real-pictures.md");
    let page = std::fs::read_to_string(page).expect("docs/real-pictures.md");
    for (what, options) in [("dots", DOTS), ("particles", PARTICLES), ("star", STARS), ("beads", BEADS)] {
        let command = format!("vitreo blobs {options} ");
        let line = page.lines().find(|l| l.starts_with(&command));
        let line = line.unwrap_or_else(|| panic!("no line begins with: {command}"));
        assert!(line.contains(what), "{line}");
    }
}

#[test]
fn dots_of_the_calibration_target_are_found_where_another_program_found_them() {
    let Some(data) = cameras() else { return };
    for camera in 1..=3 {
        let picture = data.join(format!("myptv/Calibration/cal{camera}.png"));
        let found = blobs(DOTS, &[picture]).remove(0);
        // x_px y_px X Y Z
        let dots = table(&data.join(format!("myptv/Calibration/cam{camera}_cal_points")));
        let dots: Vec<[f64; 2]> = dots.iter().map(|r| [r[0], r[1]]).collect();
        let same = matched(&dots, &found, 2.0);
        println!(
            "camera {camera}: {} of {} dots, median {:.3} px",
            same.len(),
            dots.len(),
            same[same.len() / 2]
        );
        assert!(same.len() * 100 >= dots.len() * 99, "{} of {} dots", same.len(), dots.len());
        // Both are centres of about 25 pixels, of which the other program's count alike.
        assert!(same[same.len() / 2] < 0.3, "median {} px", same[same.len() / 2]);
    }
}

#[test]
fn particles_in_a_flow_are_those_another_program_found() {
    let Some(data) = cameras() else { return };
    for camera in 1..=3 {
        let pictures: Vec<PathBuf> =
            (1..=3).map(|i| data.join(format!("myptv/Images_cam{camera}/0{i}.png"))).collect();
        let found = blobs(PARTICLES, &pictures);
        // y_px x_px size_y size_x mass frame
        let rows = table(&data.join(format!("myptv/blobs_cam{camera}")));
        for (frame, found) in found.iter().enumerate() {
            let of_frame = rows.iter().filter(|r| r[5] == frame as f64);
            let particles: Vec<[f64; 2]> = of_frame.map(|r| [r[1], r[0]]).collect();
            let same = matched(&particles, found, 1.5);
            let share = same.len() as f64 / particles.len() as f64;
            println!(
                "camera {camera}, frame {frame}: {share:.2} found, median {:.3} px",
                same[same.len() / 2]
            );
            // The other program filters before it decides; of its faintest some stay below this
            // threshold.
            assert!(share > 0.88, "{} of {}", same.len(), particles.len());
            assert!(same[same.len() / 2] < 0.26, "median {} px", same[same.len() / 2]);
        }
    }
}

/// Centre of what a deep picture has above the border of a window.
fn window_centre(samples: &image::ImageBuffer<image::Luma<u16>, Vec<u16>>, x: u32, y: u32) -> [f64; 2] {
    let reach = 4;
    let window = || (y - reach..=y + reach).flat_map(|y| (x - reach..=x + reach).map(move |x| (x, y)));
    let border = |&(px, py): &(u32, u32)| px.abs_diff(x) == reach || py.abs_diff(y) == reach;
    let mut around: Vec<u16> = window().filter(border).map(|(x, y)| samples.get_pixel(x, y).0[0]).collect();
    around.sort_unstable();
    let ground = f64::from(around[around.len() / 2]);
    let spread = f64::from(around[around.len() * 9 / 10]) - ground;
    let weight =
        |(x, y): (u32, u32)| (f64::from(samples.get_pixel(x, y).0[0]) - ground - 2.0 * spread).max(0.0);
    let sum = |of: fn((u32, u32)) -> f64| window().map(|p| weight(p) * of(p)).sum::<f64>();
    let total = sum(|_| 1.0).max(1e-9);
    [sum(|p| f64::from(p.0)) / total, sum(|p| f64::from(p.1)) / total]
}

#[test]
fn stars_are_at_the_centres_of_their_light() {
    let Some(data) = cameras() else { return };
    let names = ["2019-07-29T204726_Alt40_Azi-135_Try1.png", "2019-07-29T204726_Alt40_Azi135_Try1.png"];
    let pictures = names.map(|n| data.join("tetra3_stars").join(n));
    let found = blobs(STARS, &pictures);
    for (picture, stars) in pictures.iter().zip(&found) {
        let samples = image::open(picture).expect("picture").into_luma16();
        let [width, height] = [samples.width(), samples.height()].map(f64::from);
        let inside = |b: &&Blob| b.x > 6.0 && b.y > 6.0 && b.x < width - 7.0 && b.y < height - 7.0;
        let small = stars.iter().filter(inside).filter(|b| b.area < 40.0);
        let off = small.map(|b| {
            let [x, y] = window_centre(&samples, b.x.round() as u32, b.y.round() as u32);
            distance(b, x, y)
        });
        let mut off: Vec<f64> = off.collect();
        off.sort_by(f64::total_cmp);
        println!("{} stars, {} compared, median {:.3} px", stars.len(), off.len(), off[off.len() / 2]);
        // The pictures hold 76 to 201 spots of more than 6 σ; this threshold is higher.
        assert!((40..=201).contains(&stars.len()), "{} stars", stars.len());
        assert!(off[off.len() / 2] < 0.12, "median {} px", off[off.len() / 2]);
    }
}

#[test]
fn beads_that_diffuse_are_seen_again_in_the_next_frame() {
    let Some(data) = cameras() else { return };
    let pictures: Vec<PathBuf> =
        (0..6).map(|i| data.join(format!("trackpy_bulk_water/bulk_water_00{i}.png"))).collect();
    let found = blobs(BEADS, &pictures);
    for pair in found.windows(2) {
        let before: Vec<[f64; 2]> = pair[0].iter().map(|b| [b.x, b.y]).collect();
        // A bead moves by a pixel or two a frame; beads are some 30 px apart.
        let again = matched(&before, &pair[1], 6.0).len();
        println!("{} beads, {again} seen again", before.len());
        assert!(before.len() > 30 && again * 10 >= before.len() * 6, "{again} of {}", before.len());
    }
}

#[test]
fn drawn_shapes_are_found_each_in_its_colour() {
    let Some(data) = cameras() else { return };
    let picture = data.join("opencv/detect_blob.png");
    let found = blobs("--background fixed=16 --threshold 10:20 --min-area 30", &[picture]).remove(0);
    // 17 shapes; white are the line that frames the picture and the end of the one that fades to
    // black.
    assert_eq!(found.iter().filter(|b| b.colour != "white").count(), 17, "{found:#?}");
    // Centres of the round ones by OpenCV 5.0 (connectedComponentsWithStats).
    let round = [
        (64.294, 68.153, "green"),
        (181.404, 60.573, "green"),
        (132.242, 156.933, "green"),
        (62.404, 238.189, "green"),
        (111.500, 362.778, "blue"),
        (270.016, 287.283, "green"),
        (213.506, 566.884, "green"),
    ];
    for (x, y, colour) in round {
        let near = found.iter().filter(|b| b.colour == colour && distance(b, x, y) < 0.15).count();
        assert_eq!(near, 1, "{colour} at {x}, {y}: {found:#?}");
    }
    let count = |colour: &str| found.iter().filter(|b| b.colour == colour).count();
    assert_eq!([count("blue"), count("red")], [2, 1]);
}

#[test]
fn sweets_are_told_apart_by_learnt_colours() {
    let Some(data) = cameras() else { return };
    let picture = data.join("opencv/smarties.png");
    let folder = tempfile::tempdir().expect("scratch folder");
    let file = folder.path().join("sweets.toml").display().to_string();
    let regions = ["red@14,209,40,40", "green@250,98,40,40", "blue@360,64,36,36", "yellow@190,196,30,30"];
    let samples = regions.map(|r| {
        let (colour, region) = r.split_once('@').expect("region");
        format!("{colour}={}@{region}", picture.display())
    });
    let mut args = vec!["colours", "learn", "-o", &file];
    args.extend(samples.iter().map(String::as_str));
    run(&args, &[]);
    let options = format!(
        "--colours {file} --key --polarity dark --background fixed=16 --threshold 30:60 --min-area 100"
    );
    let found = blobs(&options, &[picture]).remove(0);
    // By looking at the picture: colour and rough centre of each sweet; the brown ones are no
    // class.
    let sweets = [
        ("red", 34, 229),
        ("red", 99, 260),
        ("red", 288, 213),
        ("red", 220, 306),
        ("yellow", 205, 211),
        ("yellow", 134, 327),
        ("green", 268, 117),
        ("green", 387, 170),
        ("green", 16, 344),
        ("blue", 377, 81),
        ("blue", 348, 237),
        ("blue", 294, 320),
    ];
    for (colour, x, y) in sweets {
        let here: Vec<&Blob> =
            found.iter().filter(|b| distance(b, f64::from(x), f64::from(y)) < 9.0).collect();
        let largest = here.iter().max_by(|a, b| a.area.total_cmp(&b.area));
        let largest = largest.unwrap_or_else(|| panic!("{colour} at {x}, {y}: {found:#?}"));
        assert!(largest.colour == colour && largest.area > 500.0, "{colour} at {x}, {y}: {largest:?}");
    }
    for blob in &found {
        // Sweets are 26 px in radius; an orange one is redder where it is in the shade.
        let on_one = sweets.iter().any(|&(_, x, y)| distance(blob, f64::from(x), f64::from(y)) < 26.0);
        assert!(on_one, "there is nothing at {blob:?}");
    }
}

/// The labelled ball of a picture of a robot's camera: left, right, top, bottom, px.
fn ball(data: &Path, name: &str) -> [f64; 4] {
    let rows = table(&data.join(format!("colour_balls/robocup/{name}.txt")));
    let row = rows.iter().find(|r| r[0] == 0.0).expect("a ball");
    let size =
        image::image_dimensions(data.join(format!("colour_balls/robocup/{name}.jpg"))).expect("picture");
    let [w, h] = [size.0, size.1].map(f64::from);
    [
        (row[1] - row[3] / 2.0) * w,
        (row[1] + row[3] / 2.0) * w,
        (row[2] - row[4] / 2.0) * h,
        (row[2] + row[4] / 2.0) * h,
    ]
}

#[test]
fn a_learnt_ball_is_the_largest_blob_of_its_colour() {
    let Some(data) = cameras() else { return };
    let folder = tempfile::tempdir().expect("scratch folder");
    let file = folder.path().join("ball.toml").display().to_string();
    let path = |name: &str| data.join(format!("colour_balls/robocup/{name}.jpg"));
    let sample = |name: &str| {
        let [left, right, top, bottom] = ball(&data, name);
        let middle = |a: f64, b: f64| ((a + (b - a) * 0.3) as u32, ((b - a) * 0.4) as u32);
        let ((x, w), (y, h)) = (middle(left, right), middle(top, bottom));
        format!("yellow={}@{x},{y},{w},{h}", path(name).display())
    };
    // Two halls and two balls; learnt from one picture of each, found in another one.
    for (teachers, others) in [
        (&["cam0_20260514_112049"][..], &["cam0_20260514_180606"][..]),
        (&["cam0_20220716_063802"], &["cam0_20220716_065748"]),
    ] {
        let samples: Vec<String> = teachers.iter().map(|t| sample(t)).collect();
        let mut args = vec!["colours", "learn", "--force", "-o", &file];
        args.extend(samples.iter().map(String::as_str));
        run(&args, &[]);
        let options = format!("--colours {file} --key --background fixed=16 --threshold 8:16 --min-area 100");
        let pictures: Vec<PathBuf> = others.iter().map(|n| path(n)).collect();
        for (name, found) in others.iter().zip(blobs(&options, &pictures)) {
            let largest = found.iter().max_by(|a, b| a.area.total_cmp(&b.area)).expect("a blob");
            let [left, right, top, bottom] = ball(&data, name);
            println!("{name}: ball {left:.0}–{right:.0}, {top:.0}–{bottom:.0}; {largest:?}");
            let inside = (left..right).contains(&largest.x) && (top..bottom).contains(&largest.y);
            assert!(inside && largest.area > 0.3 * (right - left) * (bottom - top), "{name}: {largest:?}");
        }
    }
}

#[test]
fn red_halves_of_balls_on_a_table_are_counted() {
    let Some(data) = cameras() else { return };
    let photo = |i: u32| data.join(format!("colour_balls/photo_reddish_ball_0{i}.jpg"));
    let folder = tempfile::tempdir().expect("scratch folder");
    let file = folder.path().join("ball.toml").display().to_string();
    run(&["colours", "learn", &format!("red={}@700,240,100,60", photo(1).display()), "-o", &file], &[]);
    let options = format!("--colours {file} --key --background fixed=16 --threshold 8:16 --min-area 1500");
    let found = blobs(&options, &[photo(7), photo(8)]);
    // By looking at the photographs: rough centres of the red halves.
    let expected: [&[(f64, f64)]; 2] =
        [&[(430.0, 480.0), (960.0, 475.0)], &[(430.0, 480.0), (690.0, 390.0), (960.0, 475.0)]];
    for (found, expected) in found.iter().zip(expected) {
        // Half a ball is no disc: it may come as two blobs that touch, and then both lie on it.
        let near = |b: &Blob, &(x, y): &(f64, f64)| b.colour == "red" && distance(b, x, y) < 75.0;
        for place in expected {
            assert!(found.iter().any(|b| near(b, place)), "{place:?}: {found:#?}");
        }
        assert!(found.iter().all(|b| expected.iter().any(|place| near(b, place))), "{found:#?}");
    }
}
