//! The selected part of a recording, and the check that it is within the recording.

use super::numbers::not_negative;
use outputs::exit::WrongUse;
use std::path::Path;

/// A part of a recording, counted from its first exposure.
#[derive(Debug, Clone, Copy, Default, PartialEq, clap::Args)]
pub struct SpanArgs {
    /// Start S seconds into the recording; everything before is computed as fast as possible.
    #[arg(long, value_name = "S", default_value_t = 0.0, value_parser = not_negative, allow_negative_numbers = true)]
    pub from: f64,
    /// Stop S seconds after the recording's start.
    #[arg(long, value_name = "S", value_parser = not_negative, allow_negative_numbers = true)]
    pub until: Option<f64>,
}

impl SpanArgs {
    /// Refuses an empty part and one that begins after the recording's end. `length_s` returns the
    /// recording's length, s; it is only called if needed.
    ///
    /// # Errors
    /// [`WrongUse`] if the part's end is not after its beginning, or its beginning is after the recording's
    /// end.
    pub fn check(&self, file: &Path, length_s: impl FnOnce() -> f64) -> Result<(), WrongUse> {
        let SpanArgs { from, until } = *self;
        if let Some(until) = until.filter(|until| *until <= from) {
            return Err(WrongUse(format!("--until {until}: expected more than --from {from}")));
        }
        if from == 0.0 {
            return Ok(());
        }
        let (length_s, file) = (length_s(), file.display());
        if from > length_s {
            return Err(WrongUse(format!("--from {from}: {file} is only {length_s:.2} s long")));
        }
        Ok(())
    }

    /// Length of the part, s, of a recording of length `recorded_s`, s.
    pub fn length_s(&self, recorded_s: f64) -> f64 {
        let until_s = self.until.unwrap_or(f64::INFINITY).min(recorded_s);
        (until_s - self.from).max(0.0)
    }
}
