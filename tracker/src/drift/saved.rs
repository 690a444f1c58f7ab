//! The estimation of the drift in a checkpoint.

use super::{DriftEstimator, DriftReport, PAST, Past};
use crate::checkpoint::{Done, Loader, Saver};
use crate::constants as k;
use crate::tracker::{load_place, save_place};
use protocol::limits::BODIES;

impl DriftEstimator {
    /// Writes the evidence of the residuals. Of the factor only the lower triangle is ever read.
    pub(crate) fn save(&self, out: &mut Saver<'_>) -> Done {
        let DriftEstimator { nominal, parameters, information, gradient, factor, right, .. } = self;
        let DriftEstimator { applied, column, turn, report, past, .. } = self;
        let DriftEstimator { calibrated: _, camera_at: _, markers_at: _, local: _, with_pose: _, .. } = self;
        let n = *parameters;
        for camera in nominal.cameras.iter().flatten() {
            save_place(camera, out)?;
        }
        out.square(n, |r, c| information[r * n + c])?;
        out.numbers((0..n).flat_map(|r| &factor[r * n..=r * n + r]))?;
        out.numbers(gradient.iter().chain(right).chain(applied))?;
        out.put(&[*column as u64, *turn as u64])?;
        let DriftReport { detected, evidence, camera_rad, camera_mm, markers_mm, unobservable_mm: _ } =
            report;
        out.put(detected)?;
        out.numbers([evidence, camera_rad, camera_mm].into_iter().chain(markers_mm))?;
        for Past { information, gradient, applied, detected } in past {
            out.square(n, |r, c| information[r * n + c])?;
            out.numbers(gradient.iter().chain(applied))?;
            out.put(detected)?;
        }
        Ok(())
    }

    /// Takes over what was saved.
    pub(crate) fn load(&mut self, from: &mut Loader<'_>) -> Done {
        let n = self.parameters;
        for camera in self.nominal.cameras.iter_mut().flatten() {
            load_place(camera, from)?;
        }
        from.square(n, |r, c, number| self.information[r * n + c] = number)?;
        for r in 0..n {
            from.numbers(&mut self.factor[r * n..=r * n + r])?;
        }
        from.numbers(self.gradient.iter_mut().chain(&mut self.right))?;
        load_corrections(&mut self.applied, from)?;
        self.column = from.below(n.max(1) as u64)? as usize;
        self.turn = from.below(BODIES as u64)? as usize;
        let DriftReport { detected, evidence, camera_rad, camera_mm, markers_mm, .. } = &mut self.report;
        *detected = from.take()?;
        from.numbers([evidence, camera_rad, camera_mm].into_iter().chain(markers_mm))?;
        for Past { information, gradient, applied, detected } in &mut self.past[..PAST] {
            from.square(n, |r, c, number| information[r * n + c] = number)?;
            from.numbers(gradient)?;
            load_corrections(applied, from)?;
            *detected = from.take()?;
        }
        Ok(())
    }
}

fn load_corrections(applied: &mut [f64], from: &mut Loader<'_>) -> Done {
    for slot in applied {
        *slot = from.within(-k::DRIFT_LIMIT, k::DRIFT_LIMIT)?;
    }
    Ok(())
}
