//! Parsers for values of `vitreo run`'s options.

use protocol::budget::Stage;

/// Parses a duration above 0 s, at most a year, s.
pub(crate) fn positive(text: &str) -> Result<f64, String> {
    let value: f64 = text.parse().map_err(|_| format!("expected seconds, found '{text}'"))?;
    let range = 0.0..=86_400.0 * 365.0;
    if value > 0.0 && range.contains(&value) { Ok(value) } else { Err("expected more than 0 s".into()) }
}

/// Parses a percentile, 0 to 100.
pub(super) fn percentile(text: &str) -> Result<f64, String> {
    let value: f64 = text.parse().map_err(|_| format!("expected a number, found '{text}'"))?;
    if (0.0..=100.0).contains(&value) { Ok(value) } else { Err("expected 0 to 100".into()) }
}

/// Parses a fraction, 0 to 1.
pub fn share(text: &str) -> Result<f64, String> {
    let value: f64 = text.parse().map_err(|_| format!("expected a number, found '{text}'"))?;
    if (0.0..=1.0).contains(&value) { Ok(value) } else { Err("expected 0 to 1".into()) }
}

/// Parses `STAGE=MS`: a stage of the data path, and the delay to inject into it, ms.
pub(super) fn injected_delay(text: &str) -> Result<(Stage, f64), String> {
    let names = || {
        let single = Stage::ALL.iter().filter(|&&s| s != Stage::WholeSystem);
        single.map(|s| s.name()).collect::<Vec<_>>().join(", ")
    };
    let (name, delay) = text.split_once('=').ok_or("expected STAGE=MS")?;
    let stage = Stage::ALL.into_iter().find(|s| s.name() == name && *s != Stage::WholeSystem);
    let stage = stage.ok_or_else(|| format!("unknown stage '{name}'; known: {}", names()))?;
    let delay: f64 = delay.parse().map_err(|_| format!("expected milliseconds, found '{delay}'"))?;
    if (0.0..=10_000.0).contains(&delay) { Ok((stage, delay)) } else { Err("expected 0 to 10000 ms".into()) }
}
