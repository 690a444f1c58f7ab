//! The constants of the tracker that a what-if may set, each with unit, range and meaning. Their defaults
//! are [`crate::constants`]; a tracker with the defaults computes what one without a tuning does, to the
//! bit.

use crate::constants as k;

/// A row of [`TUNABLE`].
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct Tunable {
    /// Name, as behind `tracker.`.
    pub key: &'static str,
    /// Unit; empty for a number without one.
    pub unit: &'static str,
    /// Value that the tracker has without a tuning.
    pub default: f64,
    /// Least value.
    pub low: f64,
    /// Largest value.
    pub high: f64,
    /// What it is.
    pub what: &'static str,
}

/// Makes [`Tuning`] and [`TUNABLE`] from rows of key, unit, default, range and meaning.
macro_rules! tunables {
    ($($key:ident, $unit:literal, $default:expr, $low:literal..$high:literal, $what:literal;)*) => {
        /// Values of the tunable constants.
        #[derive(Debug, Clone, Copy, PartialEq)]
        pub struct Tuning {
            $(#[doc = $what] pub $key: f64,)*
        }

        /// The constants of the tracker, as they are built in.
        pub const DEFAULT: Tuning = Tuning { $($key: $default,)* };

        /// Every tunable constant.
        pub const TUNABLE: &[Tunable] = &[$(Tunable {
            key: stringify!($key),
            unit: $unit,
            default: $default,
            low: $low,
            high: $high,
            what: $what,
        },)*];

        impl Tuning {
            fn slot(&mut self, key: &str) -> Option<&mut f64> {
                match key {
                    $(stringify!($key) => Some(&mut self.$key),)*
                    _ => None,
                }
            }

            /// The values, in the order of [`TUNABLE`].
            pub fn values(&self) -> [f64; TUNABLE.len()] {
                [$(self.$key,)*]
            }
        }
    };
}

tunables! {
    sigma_x_px, "px", k::SIGMA_X_PX, 0.01..10.0, "standard deviation of the column of a blob of 1 px, if the stream gives none";
    sigma_y_px, "px", k::SIGMA_Y_PX, 0.01..10.0, "standard deviation of the line of a blob of 1 px, if the stream gives none";
    gate, "", k::GATE, 1.0..1000.0, "largest squared Mahalanobis distance of a blob from its predicted marker";
    gate_px, "px", k::GATE_PX, 1.0..200.0, "largest distance of a blob from its predicted marker";
    outlier, "", k::OUTLIER, 2.0..1000.0, "squared normalised residual above which a blob is an outlier of a fit";
    robust_scale, "", k::ROBUST_SCALE, 0.1..1000.0, "squared residual of half weight in the robust iteration";
    bad_fit, "", k::BAD_FIT, 1.0..1000.0, "reduced χ² above which a fit is rejected";
    measured_mm, "mm", k::MEASURED_MM, 0.001..1.0, "largest standard deviation of a tip that counts as measured";
    measured_rad, "rad", k::MEASURED_RAD, 0.001..3.0, "largest standard deviation of a rotation that counts as measured";
    voluntary_mm_s2, "mm/s²", k::VOLUNTARY_MM_S2, 5.0..300.0, "initial standard deviation of the voluntary acceleration";
    voluntary_tau_s, "s", k::VOLUNTARY_TAU_S, 0.1..2.0, "time constant of the voluntary acceleration";
    voluntary_learning_s, "s", k::VOLUNTARY_LEARNING_S, 0.02..60.0, "time constant of the adaptation of the voluntary acceleration's variance";
    tremor_ripple_db, "dB", k::TREMOR_RIPPLE_DB, 0.01..6.0, "passband ripple of the tremor filter";
    tremor_learning_s, "s", k::TREMOR_LEARNING_S, 0.1..60.0, "time constant of the adaptation of the tremor's variance";
    turn_acceleration_rad_s2, "rad/s²", k::TURN_ACCELERATION_RAD_S2, 0.1..200.0, "standard deviation of the acceleration of an instrument's roll";
    turn_acceleration_tau_s, "s", k::TURN_ACCELERATION_TAU_S, 0.01..10.0, "time constant of the acceleration of an instrument's roll";
    eye_acceleration_rad_s2, "rad/s²", k::EYE_ACCELERATION_RAD_S2, 0.001..20.0, "standard deviation of the acceleration of the eye's rotation";
    eye_acceleration_tau_s, "s", k::EYE_ACCELERATION_TAU_S, 0.01..10.0, "time constant of the acceleration of the eye's rotation";
    drift_kept, "", k::DRIFT_KEPT, 0.5..1.0, "fraction of earlier drift evidence kept at each update";
    drift_step, "", k::DRIFT_STEP, 0.0..1.0, "gain of each drift update on the rig; 0 trusts the rig file";
}

impl Default for Tuning {
    fn default() -> Self {
        DEFAULT
    }
}

/// Why a value was refused.
#[derive(Debug, Clone, PartialEq, thiserror::Error)]
pub enum TuningError {
    /// No such constant.
    #[error("{key}: no such key; did you mean {nearest}? (vitreo settings lists all)")]
    Unknown {
        /// What was asked for.
        key: String,
        /// The known key that is nearest.
        nearest: &'static str,
    },
    /// The value is out of range.
    #[error("{key}: expected {low} to {high}{unit}, found {found}")]
    Range {
        /// The key.
        key: &'static str,
        /// Least value.
        low: f64,
        /// Largest value.
        high: f64,
        /// Unit with a space before it.
        unit: String,
        /// What was given.
        found: f64,
    },
}

impl Tuning {
    /// Sets a constant by its key.
    ///
    /// # Errors
    /// For a key that there is not, with the nearest one, and for a value out of range.
    pub fn set(&mut self, key: &str, value: f64) -> Result<(), TuningError> {
        let Some(row) = TUNABLE.iter().find(|row| row.key == key) else {
            let nearest = TUNABLE.iter().min_by_key(|row| edits(row.key, key)).map_or("", |row| row.key);
            return Err(TuningError::Unknown { key: key.into(), nearest });
        };
        if !(row.low..=row.high).contains(&value) {
            let unit = if row.unit.is_empty() { String::new() } else { format!(" {}", row.unit) };
            return Err(TuningError::Range {
                key: row.key,
                low: row.low,
                high: row.high,
                unit,
                found: value,
            });
        }
        if let Some(slot) = self.slot(key) {
            *slot = value;
        }
        Ok(())
    }
}

/// Levenshtein's distance of two keys.
pub fn edits(a: &str, b: &str) -> usize {
    let mut row: Vec<usize> = (0..=b.len()).collect();
    for (i, x) in a.bytes().enumerate() {
        let mut before = row[0];
        row[0] = i + 1;
        for (j, y) in b.bytes().enumerate() {
            let replaced = before + usize::from(x != y);
            before = row[j + 1];
            row[j + 1] = replaced.min(before + 1).min(row[j] + 1);
        }
    }
    row[b.len()]
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn every_key_is_set_within_its_range_and_refused_beyond_it() {
        for (index, row) in TUNABLE.iter().enumerate() {
            let mut tuning = Tuning::default();
            assert_eq!(tuning.values()[index], row.default, "{}", row.key);
            for value in [row.low, row.high] {
                tuning.set(row.key, value).unwrap();
                assert_eq!(tuning.values()[index], value);
                let others = tuning.values().iter().zip(DEFAULT.values()).filter(|(a, b)| **a != *b).count();
                assert!(others <= 1, "{} sets itself alone", row.key);
            }
            for value in [row.low - 1e-6, row.high + 1e-6, f64::NAN, f64::INFINITY] {
                assert!(tuning.set(row.key, value).unwrap_err().to_string().contains(row.key), "{value}");
            }
        }
    }

    #[test]
    fn an_unknown_key_is_answered_with_the_nearest() {
        let error = Tuning::default().set("tremor_riple_db", 0.1).unwrap_err();
        assert_eq!(
            error,
            TuningError::Unknown { key: "tremor_riple_db".into(), nearest: "tremor_ripple_db" }
        );
        assert_eq!((edits("", "ab"), edits("gate", "gaze"), edits("kitten", "sitting")), (2, 1, 3));
    }
}
