//! What the tracker's poses leave in the pictures: how often which residual came.

use protocol::limits::BODIES;

/// A body alone whose marker another one hides in part leaves as much, for seconds. Periods after which
/// it is judged, and the share of frames that may lie below.
const LONG_PERIODS: u32 = 30;
const BELOW: f64 = 0.1;

/// How often which residual came, by hundredths of a pixel; the last place takes all above.
#[derive(Debug, Clone)]
pub struct Residuals([u32; 500]);

impl Default for Residuals {
    fn default() -> Self {
        Residuals([0; 500])
    }
}

impl Residuals {
    const STEP_PX: f64 = 0.01;

    /// Counts one.
    pub fn note(&mut self, px: f64) {
        self.0[((px / Self::STEP_PX) as usize).min(self.0.len() - 1)] += 1;
    }

    /// The median, px; 0 without any.
    pub fn median_px(&self) -> f64 {
        self.quantile_px(0.5)
    }

    /// What this share of them does not exceed, px; 0 without any.
    pub fn quantile_px(&self, share: f64) -> f64 {
        let wanted = (share * f64::from(self.0.iter().sum::<u32>())).ceil() as u32;
        let mut below = 0;
        let place = self.0.iter().position(|n| {
            below += n;
            wanted > 0 && below >= wanted
        });
        place.map_or(0.0, |p| (p as f64 + 0.5) * Self::STEP_PX)
    }

    fn add(&mut self, others: &Residuals) {
        self.0.iter_mut().zip(&others.0).for_each(|(own, other)| *own += other);
    }
}

/// Residuals of many periods, in which hands and what they hide have moved on.
#[derive(Debug, Default)]
pub struct Long {
    periods: u32,
    residuals: [Residuals; BODIES],
    /// What nine in ten frames of the last ones exceeded, px.
    pub residual_px: [f64; BODIES],
}

impl Long {
    /// Takes the residuals of a period, by body.
    pub fn note(&mut self, period: [&Residuals; BODIES]) {
        self.residuals.iter_mut().zip(period).for_each(|(long, of_period)| long.add(of_period));
        self.periods += 1;
        if self.periods == LONG_PERIODS {
            self.residual_px = std::array::from_fn(|b| self.residuals[b].quantile_px(BELOW));
            (self.periods, self.residuals) = (0, Default::default());
        }
    }
}
