//! Parsers for numbers on command lines.

/// Parses a finite number of 0 or more.
///
/// # Errors
/// The expected form.
pub fn not_negative(text: &str) -> Result<f64, String> {
    match text.parse::<f64>() {
        Ok(value) if value.is_finite() && value >= 0.0 => Ok(value),
        _ => Err("expected a number of 0 or more".into()),
    }
}

/// Parses a finite number above 0.
///
/// # Errors
/// The expected form.
pub fn positive(text: &str) -> Result<f64, String> {
    not_negative(text).ok().filter(|v| *v > 0.0).ok_or("expected a number above 0".into())
}

/// A parser of whole numbers from `low` to `high`, with an error that states the range as people read it.
///
/// ```
/// let tier = settings::commands::numbers::whole::<u32>(0, 8);
/// assert_eq!(tier("8"), Ok(8));
/// assert_eq!(tier("9"), Err("expected a whole number from 0 to 8".into()));
/// ```
pub fn whole<T: TryFrom<u64> + Clone + Send + Sync + 'static>(
    low: u64,
    high: u64,
) -> impl Fn(&str) -> Result<T, String> + Clone {
    move |text| {
        let number = text.parse().ok().filter(|n| (low..=high).contains(n));
        number.and_then(|n| T::try_from(n).ok()).ok_or_else(|| match high {
            u64::MAX => format!("expected a whole number of {low} or more"),
            _ => format!("expected a whole number from {low} to {high}"),
        })
    }
}

/// Parses a fraction from 0 to 1.
///
/// # Errors
/// The expected form.
pub fn share(text: &str) -> Result<f64, String> {
    let value: f64 = text.parse().map_err(|_| format!("expected a number, found '{text}'"))?;
    if (0.0..=1.0).contains(&value) { Ok(value) } else { Err("expected 0 to 1".into()) }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn numbers_are_checked() {
        assert!(positive("0").is_err() && positive("nan").is_err() && positive("-1").is_err());
        assert_eq!((positive("2.5"), not_negative("0")), (Ok(2.5), Ok(0.0)));
        assert!(share("1.01").is_err() && share("x").is_err() && share("nan").is_err());
        assert_eq!(share("0.5"), Ok(0.5));
    }
}
