//! Where the tips of a stream were, and how far the tracker's are from there.

use anyhow::{Context, ensure};
use nalgebra::Point3;
use protocol::file::{MAX_TABLE_BYTES, read_text};
use protocol::geometry::Validity;
use protocol::limits::INSTRUMENTS;
use protocol::poses::{BODY_NAMES, TrackerFrame};
use protocol::time::Nanos;
use std::path::Path;

/// The beginning of a stream, while the tracker finds the bodies, is not compared, ns.
const SETTLE_NS: u64 = 500_000_000;

/// Tips over time, mm in the world, and the distances of the tracker's from them so far.
#[derive(Debug)]
pub struct Tips {
    rows: Vec<(Nanos, [Point3<f64>; INSTRUMENTS])>,
    /// Sum of squares, µm², and count.
    sums: [(f64, u64); INSTRUMENTS],
}

impl Tips {
    /// Reads a table with the columns `t_ns`, `inst0_x` … `inst1_z`, mm.
    ///
    /// # Errors
    /// Where the file cannot be read, a column is missing, or a cell is no number; the line is named.
    pub fn load(path: &Path) -> anyhow::Result<Self> {
        let file = path.display();
        let text = read_text(path, MAX_TABLE_BYTES).with_context(|| file.to_string())?;
        Self::parse(&text).with_context(|| file.to_string())
    }

    fn parse(text: &str) -> anyhow::Result<Self> {
        let mut reader = csv::ReaderBuilder::new().trim(csv::Trim::All).from_reader(text.as_bytes());
        let header = reader.headers().context("line 1")?.clone();
        let column = |name: &str| {
            let found = header.iter().position(|cell| cell == name);
            found.with_context(|| format!("line 1: expected a column {name}"))
        };
        let time = column("t_ns")?;
        let mut places = [[0; 3]; INSTRUMENTS];
        for (body, place) in BODY_NAMES.iter().zip(&mut places) {
            for (axis, cell) in ["x", "y", "z"].iter().zip(place) {
                *cell = column(&format!("{body}_{axis}"))?;
            }
        }
        let mut rows: Vec<(Nanos, _)> = Vec::new();
        for record in reader.records() {
            let record = record?;
            let line = record.position().map_or(0, csv::Position::line);
            let number = |i: usize| {
                let value: Option<f64> = record[i].parse().ok().filter(|v: &f64| v.is_finite());
                value.with_context(|| format!("line {line}: expected a number, found '{}'", &record[i]))
            };
            let mut tips = [Point3::origin(); INSTRUMENTS];
            for (tip, place) in tips.iter_mut().zip(places) {
                *tip = Point3::new(number(place[0])?, number(place[1])?, number(place[2])?);
            }
            let at = number(time)? as Nanos;
            let in_order = rows.last().is_none_or(|(before, _)| *before <= at);
            ensure!(in_order, "line {line}: expected an instant not before that of the line above");
            rows.push((at, tips));
        }
        Ok(Tips { rows, sums: [(0.0, 0); INSTRUMENTS] })
    }

    /// The tips at an instant, between two rows.
    fn at(&self, at: Nanos) -> Option<[Point3<f64>; INSTRUMENTS]> {
        let begin = self.rows.first()?.0.saturating_add(SETTLE_NS);
        let next = self.rows.partition_point(|(t, _)| *t < at);
        let (later, earlier) = (self.rows.get(next)?, self.rows.get(next.checked_sub(1)?)?);
        if at < begin {
            return None;
        }
        let share = (at - earlier.0) as f64 / (later.0 - earlier.0).max(1) as f64;
        Some(std::array::from_fn(|i| earlier.1[i] + (later.1[i] - earlier.1[i]) * share))
    }

    /// Compares the tips that a frame has measured.
    pub fn note(&mut self, frame: &TrackerFrame) {
        let Some(tips) = self.at(frame.instants.exposed) else { return };
        for ((body, tip), sums) in frame.bodies.iter().zip(tips).zip(&mut self.sums) {
            if body.validity() != Validity::Measured || body.blobs_used == 0 {
                continue;
            }
            let error_mm = body.world_from_body.isometry().translation.vector - tip.coords;
            *sums = (sums.0 + error_mm.norm_squared() * 1e6, sums.1 + 1);
        }
    }

    /// RMS of a tip's distance, µm; `None` where nothing was compared.
    pub fn rms_um(&self, instrument: usize) -> Option<f64> {
        let (sum, count) = *self.sums.get(instrument)?;
        (count > 0).then(|| (sum / count as f64).sqrt())
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use bytemuck::Zeroable;
    use proptest::prelude::*;
    use protocol::geometry::Pose;

    const HEADER: &str = "t_ns,inst0_x,inst0_y,inst0_z,inst1_x,inst1_y,inst1_z";

    #[test]
    fn a_tip_is_compared_with_its_truth_between_two_rows() {
        let text = format!("{HEADER}\n0,0,0,0,5,5,5\n1000000000,2,0,0,5,5,5\n");
        let mut tips = Tips::parse(&text).unwrap();
        let mut frame = TrackerFrame::zeroed();
        for body in &mut frame.bodies {
            body.world_from_body = Pose::IDENTITY;
            (body.validity, body.blobs_used) = (Validity::Measured as u32, 3);
        }
        frame.bodies[0].world_from_body.position_mm = [1.5, 0.003, 0.004];
        frame.bodies[1].validity = Validity::Predicted as u32;
        frame.instants.exposed = 750_000_000;
        tips.note(&frame);
        frame.instants.exposed = 100_000_000;
        tips.note(&frame);
        assert!((tips.rms_um(0).unwrap() - 5.0).abs() < 1e-6 && tips.rms_um(1).is_none());
    }

    #[test]
    fn what_is_no_table_names_its_line() {
        for (text, told) in [
            ("", "column t_ns"),
            ("t_ns,inst0_x", "column inst0_y"),
            (&format!("{HEADER}\n1,2,3,4,5,6,x"), "line 2: expected a number, found 'x'"),
            (&format!("{HEADER}\n1,2"), "line: 2"),
            (&format!("{HEADER}\n9,0,0,0,0,0,0\n1,0,0,0,0,0,0"), "line 3: expected an instant"),
        ] {
            let error = format!("{:#}", Tips::parse(text).unwrap_err());
            assert!(error.contains(told), "{text}: {error}");
        }
    }

    proptest! {
        #[test]
        fn any_text_is_read_or_refused(body in "([0-9.,e+-]{0,12}\n){0,8}") {
            let _ = Tips::parse(&format!("{HEADER}\n{body}"));
            let _ = Tips::parse(&body);
        }
    }
}
