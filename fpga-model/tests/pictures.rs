//! Extracts blobs from pictures that another program drew, and compares them with its truth. The
//! pictures lie beside the data that `VITREO_DATA` names; without them the test says so and passes.

use bytemuck::Zeroable;
use fpga_model::scan::{Scanner, Settings};
use protocol::blobs::{BLOB_MERGED, BlobField};
use protocol::fields::FieldPicture;
use serde_json::Value;
use std::collections::HashMap;
use std::io::{BufRead, BufReader, Read};
use std::path::{Path, PathBuf};

/// Share of a marker that must be visible for its blob to be asked for.
const VISIBLE: f64 = 0.45;
/// Share from which a marker counts as wholly visible.
const WHOLE: f64 = 0.985;
/// Height of a field pixel over its width.
const ASPECT: f64 = 1.83;

fn pictures() -> Option<PathBuf> {
    Some(skips::data("../tracker-data/pictures-pal/image_truth.jsonl")?.with_file_name(""))
}

fn lines(path: &Path) -> Vec<Value> {
    let text = std::fs::read_to_string(path).unwrap();
    text.lines().map(|line| serde_json::from_str(line).unwrap()).collect()
}

/// The fields of one camera's Y4M file (4:2:2).
fn fields(path: &Path) -> Vec<FieldPicture> {
    let mut file = BufReader::new(std::fs::File::open(path).unwrap());
    let mut header = String::new();
    file.read_line(&mut header).unwrap();
    assert!(header.contains("W720 H288") && header.contains("C422"), "{header}");
    let mut all = Vec::new();
    while file.read_line(&mut header).unwrap() > 0 {
        let mut picture = FieldPicture::new([720, 576]);
        for plane in [&mut picture.luma, &mut picture.blue, &mut picture.red] {
            file.read_exact(plane).unwrap();
        }
        all.push(picture);
    }
    all
}

#[derive(Default)]
struct Score {
    whole: Vec<[f64; 2]>,
    missed: u32,
    merged: u32,
    wrong_colour: u32,
    ghosts: u32,
}

impl Score {
    fn add(&mut self, truth: &[Value], field: &BlobField) {
        let number = |v: &Value, key: &str| v[key].as_f64().unwrap();
        let off = |v: &Value, x: &str, y: &str, b: &protocol::blobs::Blob| {
            let [dx, dy] = [b.x_px - number(v, x), b.y_field_px - number(v, y)];
            ((dx * dx + dy * dy * ASPECT * ASPECT).sqrt(), [dx, dy])
        };
        for marker in truth.iter().filter(|m| number(m, "frac") >= VISIBLE) {
            let nearest = field.blobs().iter().map(|b| (off(marker, "vx", "vy", b), b));
            let nearest = nearest.min_by(|a, b| a.0.0.total_cmp(&b.0.0));
            let Some(((distance, error), blob)) =
                nearest.filter(|((d, _), _)| *d < 0.6 * number(marker, "rx"))
            else {
                self.missed += 1;
                continue;
            };
            let name = protocol::blobs::Colour::from_wire(blob.colour).unwrap().name();
            self.wrong_colour += u32::from(name != marker["colour"]);
            self.merged += u32::from(blob.flags & BLOB_MERGED != 0);
            if number(marker, "frac") > WHOLE {
                assert!(distance < 2.0, "{marker} {blob:?}");
                self.whole.push(error);
            }
        }
        let known =
            |b: &&protocol::blobs::Blob| truth.iter().any(|m| off(m, "x", "y", b).0 < number(m, "rx") + 2.0);
        self.ghosts += field.blobs().iter().filter(|b| !known(b)).count() as u32;
    }

    /// Root mean square of column (px) and line (field lines), and means.
    fn figures(&self) -> [[f64; 2]; 2] {
        let n = self.whole.len() as f64;
        let sum =
            |f: &dyn Fn(f64) -> f64, axis: usize| self.whole.iter().map(|e| f(e[axis])).sum::<f64>() / n;
        [[0, 1].map(|a| sum(&|e| e * e, a).sqrt()), [0, 1].map(|a| sum(&|e| e, a))]
    }
}

#[test]
fn foreign_pal_pictures_give_their_markers() {
    let Some(folder) = pictures() else { return };
    let truth: HashMap<_, _> = lines(&folder.join("image_truth.jsonl"))
        .into_iter()
        .map(|v| {
            ((v["cam"].as_u64().unwrap(), v["seq"].as_u64().unwrap()), v["blobs"].as_array().unwrap().clone())
        })
        .collect();
    let pictures: Vec<_> = (0..3).map(|cam| fields(&folder.join(format!("cam{cam}.y4m")))).collect();
    let mut next = [0; 3];
    let mut scanner = Scanner::new(Settings::default(), 720, 288);
    let mut score = Score::default();
    for field in lines(&folder.join("fields.jsonl")) {
        let (cam, seq) = (field["cam"].as_u64().unwrap(), field["seq"].as_u64().unwrap());
        let picture = &pictures[cam as usize][next[cam as usize]];
        next[cam as usize] += 1;
        let mut out = BlobField::zeroed();
        scanner.scan(picture, &mut out);
        score.add(&truth[&(cam, seq)], &out);
    }
    let [rms, bias] = score.figures();
    println!(
        "whole markers {}: rms x {:.4} px y {:.4} line, bias {:.4} {:.4}; merged {}, missed {}, ghosts {}, wrong colour {}",
        score.whole.len(),
        rms[0],
        rms[1],
        bias[0],
        bias[1],
        score.merged,
        score.missed,
        score.ghosts,
        score.wrong_colour
    );
    assert!(score.whole.len() > 400, "{} whole markers", score.whole.len());
    // What the lines' jitter leaves of a fit of the whole picture is 0.025 px and 0.008 lines.
    assert!(rms[0] < 0.038 && rms[1] < 0.014, "rms {rms:?}");
    assert!(bias.iter().all(|b| b.abs() < 0.01), "bias {bias:?}");
    // Eight pairs of one colour touch: each is separated, near enough to be found, and flagged as merged.
    assert_eq!((score.missed, score.merged), (0, 16), "missed, merged");
    assert_eq!((score.wrong_colour, score.ghosts), (0, 0), "wrong colour, ghosts");
}
