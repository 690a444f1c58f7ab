//! The thread that reads one camera out of a recording of pixels, field by field. What was lost when it was made is
//! black, so that the picture at place *k* stays that of field *k* of every camera.

use super::line::Line;
use super::reader::{Pictured, Told};
use crate::device::Parts;
use crate::stream::{Expected, is_black};
use anyhow::{Result, ensure};
use fpga_model::colours::convert::{BLACK, GREY};
use fpga_model::input::Picture;
use fpga_model::input::recorded::{CUT, Recorded};
use ipc::clock::now;
use protocol::blobs::WHOLE_FRAME;
use protocol::fields::FieldHeader;
use rig::Rig;
use std::path::PathBuf;

/// More fields than this are never filled up at once.
const MOST_FILLED: u64 = 10_000;

/// Reads one camera.
pub(super) struct RecordedReader {
    pub(super) path: PathBuf,
    pub(super) camera: u32,
    pub(super) expected: Expected,
    pub(super) line: Line,
}

impl RecordedReader {
    /// Reads until the recording is over or the process ends.
    pub(super) fn run(self) {
        let over = match self.read() {
            Ok(()) if self.line.stopping() => return,
            Ok(()) => None,
            Err(problem) => Some(format!("{problem:#}")),
        };
        // A process that is gone needs no telling.
        let _ = self.line.tell(Told::Over(over));
    }

    fn read(&self) -> Result<()> {
        let head = Recorded::head(&self.path)?;
        ensure!(
            head.cameras.contains(&self.camera),
            "has the cameras {:?}; camera {} of the rig is not among them",
            head.cameras,
            self.camera
        );
        let hz = self.expected.field_hz;
        // Its rig knows the rate of each camera.
        let rig = Rig::parse(&head.rig_json, "rig");
        let own_hz = rig.map_or(head.field_hz, |rig| 1e9 / rig.sensor(self.camera).period_ns as f64);
        let note = ((own_hz / hz - 1.0).abs() > 0.01)
            .then(|| format!("has {own_hz:.2} fields per second; the rig's {hz:.2} are used"));
        let mut recorded = Recorded::open(&self.path, self.camera)?;
        self.line.tell(Told::Opened { is_file: true, settings: String::new(), note })?;
        let (mut next, mut is_first) = (0, true);
        while !self.line.stopping() {
            let mut picture = self.line.picture();
            let Some(header) = recorded.read(&mut picture)?.then_some(recorded.header).flatten() else {
                break;
            };
            self.check(&header)?;
            let parity = |number: u64| match header.parity {
                WHOLE_FRAME => None,
                own => Some((own + ((header.field - number) % 2) as u32) % 2),
            };
            if header.field < next {
                continue;
            }
            for number in next.max(header.field.saturating_sub(MOST_FILLED))..header.field {
                self.bring(black(&picture), parity(number), std::mem::take(&mut is_first))?;
            }
            self.bring(picture, parity(header.field), std::mem::take(&mut is_first))?;
            next = header.field + 1;
        }
        ensure!(self.line.stopping() || !recorded.is_cut(), "{CUT}");
        Ok(())
    }

    /// Refuses fields of another camera.
    fn check(&self, header: &FieldHeader) -> Result<()> {
        let [width, lines] = self.expected.frame_px;
        let whole = self.expected.scan == rig::sensor::Scan::Progressive;
        let height = if whole { lines } else { lines / 2 };
        let found = [header.width, header.height];
        ensure!(
            found == [width, height] && whole == (header.parity == WHOLE_FRAME),
            "has fields of {}×{} px; the rig expects {} of {width}×{height} px",
            found[0],
            found[1],
            if whole { "whole frames" } else { "fields" }
        );
        Ok(())
    }

    fn bring(&self, picture: Picture, parity: Option<u32>, is_first: bool) -> Result<()> {
        let is_black = is_black(&picture);
        let (parts, arrived_ns) = (Parts::one(parity), now());
        let pictured = Pictured { picture, parts, arrived_ns, is_black, is_first, before: None, taken: None };
        self.line.tell(Told::Picture(Box::new(pictured)))
    }
}

/// A black picture of the size of another.
fn black(like: &Picture) -> Picture {
    let plane = |like: &[u8], value| vec![value; like.len()];
    Picture {
        luma: plane(&like.luma, BLACK),
        blue: plane(&like.blue, GREY),
        red: plane(&like.red, GREY),
        as_read: Vec::new(),
        ..*like
    }
}
