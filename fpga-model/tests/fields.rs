//! Fields of cameras whose black level is not given: the background is followed.

use blob_stream::parse_line;
use protocol::blobs::{BlobField, Colour};
use std::process::Command;

/// Sides of a field, px.
const SIZE: [usize; 2] = [256, 96];

/// A clip of `fields` fields, a red marker over a ground that rises from `dark` to `dark + 40`.
fn clip(fields: usize, dark: u8) -> Vec<u8> {
    let [width, height] = SIZE;
    let [light, blue, red] = Colour::Red.reference();
    let inside = |x: usize, y: usize, wide: f64| {
        let (dx, dy) = ((x as f64 - 120.3) / (11.0 * wide), (y as f64 - 50.2) / (6.0 * wide));
        dx * dx + dy * dy <= 1.0
    };
    let mut file = format!("YUV4MPEG2 W{width} H{height} F50:1 Ip C422\n").into_bytes();
    for _ in 0..fields {
        file.extend_from_slice(b"FRAME\n");
        for i in 0..width * height {
            let ground = dark + (i % width * 40 / width) as u8;
            file.push(if inside(i % width, i / width, 1.0) { light + 40 } else { ground });
        }
        for chroma in [blue, red] {
            let half = width / 2;
            file.extend(
                (0..half * height).map(|i| if inside(2 * (i % half), i / half, 1.3) { chroma } else { 128 }),
            );
        }
    }
    file
}

#[test]
fn marker_over_an_unknown_and_uneven_ground_is_found_in_every_field() {
    let folder = tempfile::tempdir().unwrap();
    let (video, fields) = (folder.path().join("cam0.y4m"), folder.path().join("fields.jsonl"));
    let line = |seq: u64| {
        let t = (seq + 1) * 20_000_000;
        format!("{{\"cam\":0,\"seq\":{seq},\"t_ns\":{t},\"t_rx_ns\":{},\"parity\":{}}}\n", t + 1, seq & 1)
    };
    for dark in [16, 60] {
        std::fs::write(&video, clip(4, dark)).unwrap();
        std::fs::write(&fields, (0..4).map(line).collect::<String>()).unwrap();
        let run = |extra: &[&str]| {
            let out = Command::new(env!("CARGO_BIN_EXE_vitreo-fpga-model"))
                .args(["blobs", "--fields", fields.to_str().unwrap(), video.to_str().unwrap()])
                .args(extra)
                .output()
                .unwrap();
            assert!(out.status.success(), "{}", String::from_utf8_lossy(&out.stderr));
            String::from_utf8(out.stdout).unwrap()
        };
        let near = |text: String| {
            let fields = text.lines().zip(1..).map(|(line, n)| parse_line(line, "stdout", n).unwrap());
            let near = |field: BlobField| {
                let [blob] = field.blobs() else { return false };
                let off = [blob.x_px - 120.3, blob.y_field_px - 50.2];
                blob.colour == Colour::Red as u32 && off.iter().all(|d| d.abs() < 0.2)
            };
            fields.map(near).collect::<Vec<_>>()
        };
        assert_eq!(near(run(&[])), [true; 4], "over {dark}");
        if dark == 60 {
            assert_eq!(near(run(&["--background", "fixed=30"])), [false; 4], "told a wrong black, it errs");
        }
    }
}
