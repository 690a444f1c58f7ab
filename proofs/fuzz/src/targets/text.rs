//! Readers of texts: settings, scenes, tables, streams, arguments.

use super::{Kind, Target};
use crate::corpus::{self, shipped};
use calibration::cli::CalibrateArgs;
use calibration::{point_lists, pose_file};
use clap::Parser;
use desk::input_file::Inputs;
use fpga_model::colours::file::ColourFile;
use protocol::budget::Budgets;
use rig::Rig;
use scene::SceneFile;
use scene::module::Module;
use std::hint::black_box;
use surgeon::motion::recorded::RecordedMotion;
use virtual_rig::faults::spec::FaultSpec;

/// Longest text that is made, bytes: scenes and modules are long, a line of a table is not.
const LONGEST: [usize; 2] = [8 << 10, 2 << 10];
/// Longest recorded hand, which must have 500 samples, bytes.
const MOTION: usize = 16 << 10;
/// Between the words of a command line.
const BETWEEN: char = '\n';

/// Targets of all readers of texts.
pub fn targets() -> Vec<Target> {
    let of = |name, run, seeds, longest| Target { name, kind: Kind::Text, run, seeds, layout: None, longest };
    let target = |name, run, seeds| of(name, run, seeds, LONGEST[1]);
    let long = |name, run, seeds| of(name, run, seeds, LONGEST[0]);
    vec![
        long("scene-toml", scene, || shipped(&["assets/scenes", "tests/data/pictures/scenes"], "toml")),
        long("module-toml", module, || shipped(&["assets/modules"], "toml")),
        long("rig-json", rig, || shipped(&["assets", "tests/data/tracker"], "json")),
        target(
            "colours-toml",
            |b| drop(ColourFile::parse(&lossy(b), "f").map(|f| f.table())),
            || vec![corpus::file("assets/colours.toml")],
        ),
        target(
            "budgets-toml",
            |b| drop(black_box(Budgets::parse(&lossy(b), "f"))),
            || {
                vec![
                    b"percentile = 95\n[[budget]]\nstage = \"rendering\"\nlimit_ms = 40\nmean_ms = 3.5\n"
                        .to_vec(),
                ]
            },
        ),
        target("faults-toml", faults, || shipped(&["assets/faults"], "toml")),
        long("blob-lines", blob_lines, || corpus::lines_of("tests/data/tracker", "blobs.jsonl", 4)),
        of("motion-csv", motion, || vec![corpus::motion(520)], MOTION),
        target(
            "desk-inputs",
            |b| drop(black_box(Inputs::parse(&lossy(b), "f"))),
            || {
                vec![
                    corpus::file("tests/data/inputs/navigation-1.txt"),
                    b"0.5 axis left-x 0.5\n+1 wheel 3\n2 end".to_vec(),
                ]
            },
        ),
        target("mesh-obj", mesh, || {
            vec![
                corpus::head("assets/meshes/teapot.obj", 4000),
                b"v 0 0 -11\nv 1 0 -11\nv 1 1 -11\nf 1/1 2//2 -1\n".to_vec(),
            ]
        }),
        target("poses-csv", |b| drop(black_box(pose_file::parse(&lossy(b), "f"))), poses_csv),
        target(
            "point-list",
            |b| drop(black_box(point_lists::parse(&lossy(b), "f"))),
            || {
                vec![
                    corpus::head("tests/data/chessboards/corners.csv", 2000),
                    b"x,y,X,Y,Z,view\n1,2,3,4,5,a\n6,7,8,9,10,b\n".to_vec(),
                    br#"[{"x":1.5,"y":2.5,"X":3,"Y":4,"Z":-5,"view":7}]"#.to_vec(),
                    b"1.5 2.5 3 4 -5\n".to_vec(),
                ]
            },
        ),
        target(
            "dots",
            |b| drop(black_box(point_lists::parse_target(&lossy(b), "f"))),
            || vec![b"0 3.0\t-6\n# x\n1,2,3\n".to_vec()],
        ),
        target(
            "manifest",
            |b| drop(black_box(results::listing::lines(&lossy(b), "f".as_ref()))),
            || vec![b"# made by hand\nday/a.mcap\r\n\n/far/x y.mcap\n".to_vec()],
        ),
        target("arguments", arguments, || {
            ARGUMENTS.iter().map(|words| words.replace(' ', "\n").into_bytes()).collect()
        }),
        target("file-kind", file_kind, || {
            vec![corpus::head("assets/fundus.jpg", 40), b"ply\nformat ascii 1.0\n".to_vec()]
        }),
        target("scene-text", scene_text, || vec!["<Tier 6\n_µ\n=#Finished\n=|0.5|tissue|5 of 10\n".into()]),
    ]
}

/// Lines, their rows, and rows written again, which must be the same rows.
fn scene_text(bytes: &[u8]) {
    use protocol::scene_text::{Row, lines};
    let text = lossy(bytes);
    for (_, line) in lines(&text) {
        let (row, mut again) = (Row::of(line.trim_end_matches('\r')), String::new());
        row.push(&mut again);
        let back = lines(&again).next().map(|(_, line)| Row::of(line));
        assert!(!matches!(row, Row::Title(_)) || back == Some(row), "{row:?} became {back:?}");
    }
}

fn lossy(bytes: &[u8]) -> std::borrow::Cow<'_, str> {
    String::from_utf8_lossy(bytes)
}

fn scene(bytes: &[u8]) {
    if let Ok(scene) = SceneFile::parse(&lossy(bytes), "f") {
        let again = SceneFile::parse(&scene.to_toml(), "again").expect("what was read is written readably");
        assert_eq!(scene, again);
    }
}

fn module(bytes: &[u8]) {
    if let Ok(module) = Module::parse("f", &lossy(bytes), None) {
        (1..=module.levels().min(4)).for_each(|level| drop(black_box(module.level_scene(level))));
    }
}

fn rig(bytes: &[u8]) {
    if let Ok(rig) = Rig::parse(&lossy(bytes), "f") {
        assert_eq!(rig, Rig::parse(&rig.to_json(), "again").expect("what was read is written readably"));
        black_box((rig.field_period_ns(), rig.read_out_ns(), rig.cameras(), rig.field_bytes()));
    }
}

fn faults(bytes: &[u8]) {
    if let Ok(spec) = FaultSpec::parse(&lossy(bytes), "f") {
        let rig = Rig::load_or_shipped(None).expect("the shipped rig");
        drop(black_box(spec.check_rig(&rig)));
    }
}

fn blob_lines(bytes: &[u8]) {
    for line in lossy(bytes).lines() {
        drop(black_box(blob_stream::parse_head(line, "f", 1)));
        if let Ok(field) = blob_stream::parse_line(line, "f", 1) {
            let again = blob_stream::parse_line(&blob_stream::write_line(&field), "f", 1);
            assert_eq!(again.expect("what was read is written readably").blobs(), field.blobs());
        }
    }
}

fn motion(bytes: &[u8]) {
    if let Ok(motion) = RecordedMotion::parse(&lossy(bytes), "f") {
        let shaking = motion.fast_part().fitted(2.0);
        for t_s in [0.0, 0.1, motion.length_s(), 1e6] {
            assert!(shaking.at(t_s).iter().all(|c| c.is_finite()));
        }
    }
}

fn mesh(bytes: &[u8]) {
    if let Ok((positions, triangles)) = scene::parse_obj(&lossy(bytes)) {
        assert!(triangles.iter().flatten().all(|&corner| (corner as usize) < positions.len()));
    }
}

fn poses_csv() -> Vec<Vec<u8>> {
    let text = "t_ns,t_out_ns,body,valid,x,y,z,qw,qx,qy,qz,kind\n20,30,inst0,1,1.5,2,3,1,0,0,0,meas\n\
        20,30,eye,1,0,0,0,0,1,0,0,meas\n40,50,inst0,1,9,9,9,1,0,0,0,pred\n";
    vec![text.into(), corpus::head("tests/data/tracker/nominal/truth.csv", 2000)]
}

fn file_kind(bytes: &[u8]) {
    black_box(protocol::file::looks_like(bytes));
    black_box(protocol::file::other_format_in(&lossy(bytes), scene::FORMAT));
}

/// Command lines that show every option with a value of a form of its own.
const ARGUMENTS: [&str; 26] = [
    "vitreo run --duration 2.5 --percentile 99.9 --scene peel --picture side-by-side --budgets b.toml",
    "vitreo run --delay tracking=5 --delay camera=3.5 --faults mild,dropped --collision cpu",
    "vitreo play --input mouse --module navigation --level 2 --trainee anna",
    "vitreo replay a.mcap --speed 0.5 --from 1 --to 2.5 --poses p.csv --display-hz 60 --lead-ms 15",
    "vitreo export a.mcap --csv poses -o t.csv",
    "vitreo run --record a.mcap --split 10m --compress lz4",
    "vitreo run --rig r.json --cameras genicam:10.0.0.7?gain=3,mcap:a.mcap --colours c.toml",
    "vitreo cut a.mcap --from 1 --split 500MB --compress none -o b.mcap",
    "vitreo film --module peeling --level 1 --length 20 --every-s 2 --tier 3",
    "vitreo score a.mcap --jobs 2 --shard 0/4 --csv s.csv",
    "vitreo results list --trainee anna --module navigation --level 2",
    "vitreo trace a.mcap --field 12 --instance x-1",
    "vitreo ctl pause --instance main",
    "vitreo-fpga-model blobs a.png --levels 10:2000 --level 30 --threshold 16:24",
    "vitreo-fpga-model colours learn red=a.png@10,20,30,40 white=b.png",
    "vitreo-fpga-model hardware --width 720 --lines 288",
    "vitreo-calibration intrinsics --board 9x6 --square 25 --size 640x480 a.png --fix k3,p1",
    "vitreo-calibration stereo --charuco 7x5,2.5,1.8,DICT_5X5_100 --legacy --left a.png --right b.png",
    "vitreo-calibration board --charuco 8x6,3 --dpi 300 --margin 5 -o b.svg",
    "vitreo-calibration waved --rig r.json --sigma 0.02 s.jsonl -o out.json",
    "vitreo-virtual-rig --late-camera 1=20 --duration 3 --after-round 2 --seed 9",
    "vitreo-desk --input gamepad --scene peel",
    "vitreo-cameras --cameras y4m:a,v4l2:b?parity=1&exposure_us=9&gain=-4&trigger=external --duration 3",
    "vitreo-cameras cameras virtual --snapshot s --rig r.json --force",
    "vitreo-controls --pedal evdev:/dev/input/event5,analogue --handles serial:/dev/ttyUSB0?baud=9600",
    "vitreo-renderer --pictures-hz 2 --tier 4 --headless",
];

/// The command line of whichever program it names first.
fn arguments(bytes: &[u8]) {
    let text = lossy(bytes);
    let words: Vec<&str> = text.split(BETWEEN).collect();
    match words[0] {
        "vitreo-fpga-model" => drop(black_box(fpga_model::config::Config::try_parse_from(&words))),
        "vitreo-calibration" => drop(black_box(CalibrateArgs::try_parse_from(&words))),
        "vitreo-virtual-rig" => drop(black_box(virtual_rig::config::Config::try_parse_from(&words))),
        "vitreo-cameras" => drop(black_box(cameras::config::Config::try_parse_from(&words))),
        "vitreo-controls" => drop(black_box(::controls::config::Config::try_parse_from(&words))),
        "vitreo-desk" => drop(black_box(desk::config::Config::try_parse_from(&words))),
        "vitreo-renderer" => drop(black_box(renderer::config::Config::try_parse_from(&words))),
        _ => drop(black_box(launcher::cli::Cli::try_parse_from(&words))),
    }
}
