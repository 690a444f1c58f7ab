//! The part of a recording that is asked for, and whether it exists.

use crate::exit::WrongUse;
use anyhow::bail;
use protocol::time::Nanos;
use recording::Recording;

/// A part of a recording, counted from its first exposure.
#[derive(Debug, Clone, Copy, Default, PartialEq, clap::Args)]
pub struct SpanArgs {
    /// Show the recording from so many seconds after its start; what comes before is computed as fast
    /// as possible.
    #[arg(long, value_name = "S", default_value_t = 0.0, value_parser = not_negative)]
    pub from: f64,
    /// End so many seconds after its start.
    #[arg(long, value_name = "S", value_parser = not_negative)]
    pub until: Option<f64>,
}

impl SpanArgs {
    /// Refuses a part that the recording does not have.
    ///
    /// # Errors
    /// [`WrongUse`] where the end is not behind the beginning, or the beginning not in the recording.
    pub fn check(&self, recording: &Recording) -> anyhow::Result<()> {
        let SpanArgs { from, until } = *self;
        if let Some(until) = until.filter(|until| *until <= from) {
            bail!(WrongUse(format!("--until {until}: expected more than --from {from}")));
        }
        if from == 0.0 {
            return Ok(());
        }
        let (length_s, file) = (length_s(recording), recording.path().display());
        if from > length_s {
            bail!(WrongUse(format!("--from {from}: {file} holds {length_s:.2} s only")));
        }
        Ok(())
    }

    /// Length of the part, s.
    pub fn length_s(&self, recording: &Recording) -> f64 {
        let until_s = self.until.unwrap_or(f64::INFINITY).min(length_s(recording));
        (until_s - self.from).max(0.0)
    }
}

/// A number of 0 or more.
///
/// # Errors
/// What was expected.
pub fn not_negative(text: &str) -> Result<f64, String> {
    match text.parse::<f64>() {
        Ok(value) if value.is_finite() && value >= 0.0 => Ok(value),
        _ => Err("expected a number of 0 or more".into()),
    }
}

/// From the first exposure to the last of what is replayed, s; damage ends it.
fn length_s(recording: &Recording) -> f64 {
    let mut exposures = recording.exposures();
    let first = exposures.next().unwrap_or(0);
    exposures.fold(first, Nanos::max).saturating_sub(first) as f64 * 1e-9
}
