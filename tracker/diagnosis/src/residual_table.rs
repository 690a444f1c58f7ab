//! Residuals by camera and marker: number, mean, root mean square, largest, and how consistent the filter's
//! predictions were.

use protocol::limits::{BODIES, MAX_CAMERAS, MAX_MARKERS};
use protocol::matches::{MatchFrame, MatchedBlob, NIS_95};
use protocol::poses::BODY_NAMES;
use serde::Serialize;

/// Sums of the residuals of blobs that measured a pose.
#[derive(Debug, Clone, Copy, Default)]
struct Sums {
    count: u64,
    sum: [f64; 2],
    squares: [f64; 2],
    largest: f64,
    predicted: u64,
    inconsistent: u64,
}

impl Sums {
    fn add(&mut self, blob: &MatchedBlob) {
        let residual = [blob.residual_x_px, blob.residual_y_px].map(f64::from);
        self.count += 1;
        for ((sum, squares), r) in self.sum.iter_mut().zip(&mut self.squares).zip(residual) {
            *sum += r;
            *squares += r * r;
        }
        self.largest = self.largest.max(residual[0].hypot(residual[1]));
        self.predicted += u64::from(blob.nis > 0.0);
        self.inconsistent += u64::from(f64::from(blob.nis) > NIS_95);
    }
}

/// Residuals of a marker in a camera.
#[derive(Debug, Clone, PartialEq, Serialize)]
pub struct ResidualRow {
    /// Camera id.
    pub camera: usize,
    /// Name of the body.
    pub body: &'static str,
    /// Index of the marker in the body.
    pub marker: usize,
    /// Blobs that measured a pose.
    pub count: u64,
    /// Mean of blob less marker at the fitted pose, px of the frame: column, line.
    pub mean_px: [f64; 2],
    /// Root mean square of the same, px.
    pub rms_px: [f64; 2],
    /// Longest residual, px.
    pub largest_px: f64,
    /// Share of blobs whose NIS is above 5.99, which 5 % of a consistent filter's are; of those with a
    /// prediction.
    pub nis_above_share: f64,
}

/// Sums up residuals by camera, body and marker.
#[derive(Debug, Clone)]
pub struct ResidualTable(Box<[[[Sums; MAX_MARKERS]; BODIES]; MAX_CAMERAS]>);

impl Default for ResidualTable {
    fn default() -> Self {
        ResidualTable(Box::new([[[Sums::default(); MAX_MARKERS]; BODIES]; MAX_CAMERAS]))
    }
}

impl ResidualTable {
    /// Takes what became of the blobs of a frame.
    pub fn note(&mut self, matches: &MatchFrame) {
        for field in matches.fields() {
            let Some(of_camera) = self.0.get_mut(field.camera as usize) else { continue };
            for blob in field.blobs().iter().filter(|b| b.outcome().is_used()) {
                if let Some((body, marker)) = blob.marker() {
                    of_camera[body][marker].add(blob);
                }
            }
        }
    }

    /// The markers that were seen, by camera, body and marker.
    pub fn rows(&self) -> Vec<ResidualRow> {
        let mut rows = Vec::new();
        for (camera, of_camera) in self.0.iter().enumerate() {
            for (body, of_body) in of_camera.iter().enumerate() {
                let seen = of_body.iter().enumerate().filter(|(_, sums)| sums.count > 0);
                rows.extend(seen.map(|(marker, sums)| row(camera, BODY_NAMES[body], marker, sums)));
            }
        }
        rows
    }
}

fn row(camera: usize, body: &'static str, marker: usize, sums: &Sums) -> ResidualRow {
    let count = sums.count as f64;
    ResidualRow {
        camera,
        body,
        marker,
        count: sums.count,
        mean_px: sums.sum.map(|s| s / count),
        rms_px: sums.squares.map(|s| (s / count).sqrt()),
        largest_px: sums.largest,
        nis_above_share: sums.inconsistent as f64 / sums.predicted.max(1) as f64,
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use bytemuck::Zeroable;
    use proptest::prelude::*;

    proptest! {
        #[test]
        fn figures_are_those_of_the_blobs(residuals in prop::collection::vec((-3.0..3.0f32, -3.0..3.0f32, 0.0..20.0f32), 1..200)) {
            let mut table = ResidualTable::default();
            for (x, y, nis) in &residuals {
                let mut matches = MatchFrame { field_count: 1, ..Zeroable::zeroed() };
                let field = &mut matches.fields_mut()[0];
                field.camera = 2;
                let blob = MatchedBlob { body: 1, marker: 3, residual_x_px: *x, residual_y_px: *y, nis: *nis, ..Zeroable::zeroed() };
                field.push(blob);
                field.push(MatchedBlob { outcome: 2, residual_x_px: 50.0, ..blob });
                table.note(&matches);
            }
            let rows = table.rows();
            prop_assert_eq!(rows.len(), 1);
            let row = &rows[0];
            prop_assert_eq!((row.camera, row.body, row.marker, row.count), (2, "inst1", 3, residuals.len() as u64));
            let mean = residuals.iter().map(|r| f64::from(r.0)).sum::<f64>() / residuals.len() as f64;
            prop_assert!((row.mean_px[0] - mean).abs() < 1e-9);
            let largest = residuals.iter().map(|r| f64::from(r.0).hypot(f64::from(r.1))).fold(0.0, f64::max);
            prop_assert!((row.largest_px - largest).abs() < 1e-9);
            prop_assert!(row.rms_px[1] + 1e-12 >= row.mean_px[1].abs());
        }
    }
}
