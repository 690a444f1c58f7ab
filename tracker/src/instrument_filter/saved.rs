//! An instrument's filter in a checkpoint.

use super::{Hand, InstrumentFilter, N, Pivot};
use crate::checkpoint::{CheckpointError, Done, Loader, Saver};
use crate::pose_math::Matrix6;
use crate::rig_model::BodyModel;
use nalgebra::{Isometry3, Vector3};

impl Hand {
    /// Writes it.
    pub(crate) fn save(&self, out: &mut Saver<'_>) -> Done {
        out.numbers(self.tremor_variance.iter().chain(&self.roll_tremor_variance).chain([&self.lever_mm]))
    }

    /// Takes over what was saved.
    pub(crate) fn load(&mut self, from: &mut Loader<'_>) -> Done {
        let variances = self.tremor_variance.iter_mut().chain(&mut self.roll_tremor_variance);
        from.numbers(variances.chain([&mut self.lever_mm]))
    }
}

impl InstrumentFilter {
    /// Writes all but the constants, which are the rig's.
    pub(crate) fn save(&self, out: &mut Saver<'_>) -> Done {
        let InstrumentFilter { vectors, roll_rate, roll_acceleration, roll_tremor, rotation, .. } = self;
        let InstrumentFilter { pivot, hand, voluntary_variance, .. } = self;
        let InstrumentFilter { nis_ratio, covariance, time_ns, hand_known_ns, .. } = self;
        let InstrumentFilter { onsets, tuning: _, bank: _, nis_gain: _, .. } = self;
        // Computed from the covariance.
        let InstrumentFilter { cross: _, pose_covariance: _, .. } = self;
        out.put(time_ns)?;
        out.put(hand_known_ns)?;
        out.rotation(rotation)?;
        out.numbers(vectors.iter().flatten())?;
        out.numbers([roll_rate, roll_acceleration, nis_ratio])?;
        out.numbers([&voluntary_variance.along, &voluntary_variance.across])?;
        out.numbers(roll_tremor.iter().flatten())?;
        hand.save(out)?;
        out.numbers(pivot.position.iter().chain([&pivot.sigma]))?;
        out.put(&pivot.tracked)?;
        onsets.save(out)?;
        out.square(N, |r, c| covariance[r][c])
    }

    /// The filter that was saved.
    pub(crate) fn load(model: &BodyModel, from: &mut Loader<'_>) -> Result<Self, CheckpointError> {
        let time_ns = from.count()?;
        let pivot = Pivot { position: Vector3::zeros(), sigma: 0.0, tracked: false };
        let mut filter =
            Self::new(&Isometry3::identity(), &Matrix6::zeros(), Some(pivot), time_ns, model, None);
        filter.hand_known_ns = from.count()?;
        filter.rotation = from.rotation()?;
        from.numbers(filter.vectors.iter_mut().flatten())?;
        let InstrumentFilter { roll_rate, roll_acceleration, voluntary_variance, nis_ratio, .. } =
            &mut filter;
        from.numbers([roll_rate, roll_acceleration, nis_ratio])?;
        from.numbers([&mut voluntary_variance.along, &mut voluntary_variance.across])?;
        let InstrumentFilter { roll_tremor, pivot, hand, .. } = &mut filter;
        from.numbers(roll_tremor.iter_mut().flatten())?;
        hand.load(from)?;
        from.numbers(pivot.position.iter_mut().chain([&mut pivot.sigma]))?;
        pivot.tracked = from.take()?;
        filter.onsets.load(from)?;
        from.square(N, |r, c, number| filter.covariance[r][c] = number)?;
        filter.renew_cross();
        Ok(filter)
    }
}
