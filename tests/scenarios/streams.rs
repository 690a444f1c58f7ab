//! Imported streams, through the whole replay, against truth that this project did not make.

use std::collections::HashMap;
use std::path::Path;
use vitreo_tests::{repository, vitreo};

/// Truth of a stream: (instant, body) → tip, for the instants of the excerpt.
fn truth(path: &Path) -> (Vec<u64>, HashMap<String, Vec<[f64; 3]>>) {
    let text = std::fs::read_to_string(path).expect("truth");
    let mut lines = text.lines();
    let header: Vec<&str> = lines.next().expect("header").split(',').collect();
    let column =
        |name: &str| header.iter().position(|h| *h == name).unwrap_or_else(|| panic!("column {name}"));
    let (mut times, mut tips) = (Vec::new(), HashMap::<String, Vec<[f64; 3]>>::new());
    for line in lines {
        let cells: Vec<f64> = line.split(',').map(|c| c.parse().expect("number")).collect();
        times.push(cells[column("t_ns")] as u64);
        for body in ["inst0", "inst1"] {
            let tip = ["x", "y", "z"].map(|axis| cells[column(&format!("{body}_{axis}"))]);
            tips.entry(body.to_owned()).or_default().push(tip);
        }
    }
    (times, tips)
}

/// RMS of the tips' errors, µm, and how many measured rows there were.
fn tip_rms_um(stream: &str) -> (f64, usize) {
    let data = repository().join("tests/data/tracker").join(stream);
    let folder = tempfile::tempdir().expect("folder");
    let path = |p: &Path| p.display().to_string();
    let (recording, poses) = (folder.path().join("s.mcap"), folder.path().join("poses.csv"));
    let (rig, blobs) = (path(&data.join("rig.json")), path(&data.join("blobs.jsonl")));
    vitreo(&["import", "--rig", &rig, &blobs, "-o", &path(&recording)]).expect_code(0);
    vitreo(&["replay", &path(&recording), "--lockstep", "--poses", &path(&poses)]).expect_code(0);
    let (times, tips) = truth(&data.join("truth.csv"));
    let (mut sum, mut count) = (0.0, 0);
    for line in std::fs::read_to_string(&poses).expect("poses").lines().skip(1) {
        let cells: Vec<&str> = line.split(',').collect();
        let at: u64 = cells[0].parse().expect("t_ns");
        let Some(tips) = tips.get(cells[2]).filter(|_| cells[3] == "1") else { continue };
        if at < times[0] + 500_000_000 || at > times[times.len() - 1] {
            continue;
        }
        let i = times.partition_point(|&t| t < at).clamp(1, times.len() - 1);
        let share = (at - times[i - 1]) as f64 / (times[i] - times[i - 1]) as f64;
        let error = (0..3).map(|k| {
            let truth = tips[i - 1][k] + share * (tips[i][k] - tips[i - 1][k]);
            let measured: f64 = cells[4 + k].parse().expect("coordinate");
            ((measured - truth) * 1e3).powi(2)
        });
        sum += error.sum::<f64>();
        count += 1;
    }
    ((sum / count.max(1) as f64).sqrt(), count)
}

#[test]
fn a_static_stream_is_tracked_within_four_micrometres() {
    let (rms, rows) = tip_rms_um("static");
    assert!(rows > 100, "{rows} rows");
    assert!(rms <= 4.0, "{rms} µm");
}

#[test]
fn a_nominal_stream_is_tracked_within_four_micrometres() {
    let (rms, rows) = tip_rms_um("nominal");
    assert!(rows > 100, "{rows} rows");
    assert!(rms <= 4.0, "{rms} µm");
}

/// Every line of the page that is one is read, and together they have every key of its tables.
#[test]
fn the_examples_of_the_page_are_lines_and_have_every_key() {
    let page = std::fs::read_to_string(repository().join("docs/blob-stream.md")).expect("the page");
    let examples: Vec<&str> = page.lines().filter_map(|line| line.strip_prefix("    {")).collect();
    for example in &examples {
        blob_stream::parse_line(&format!("{{{example}"), "docs/blob-stream.md", 1).expect("a line");
    }
    let rows = page.lines().filter_map(|line| line.strip_prefix("| `")?.split_once("` |"));
    let keys: Vec<&str> = rows.map(|(key, _)| key).take_while(|key| *key != "-").collect();
    assert!(keys.len() >= 16, "{keys:?}");
    for key in keys {
        assert!(examples.iter().any(|e| e.contains(&format!("\"{key}\":"))), "no example has {key}");
    }
}
