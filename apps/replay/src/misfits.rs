//! Camera-fields that do not fit the rig, and are therefore not tracked.

use protocol::blobs::BlobField;
use rig::sensor::Sensor;

/// Counts of them, by what does not fit.
#[derive(Debug, Clone, Copy, Default, PartialEq, Eq)]
pub(crate) struct Misfits {
    /// Of cameras that the rig lacks.
    pub(crate) foreign: u64,
    /// Of a parity that the camera of the rig does not have.
    pub(crate) odd_parity: u64,
}

impl Misfits {
    /// Looks whether a field fits the cameras of the rig.
    pub(crate) fn note(&mut self, sensors: &[Sensor], field: &BlobField) {
        match sensors.iter().find(|sensor| sensor.camera == field.camera) {
            None => self.foreign += 1,
            Some(sensor) => self.odd_parity += u64::from(!sensor.has_parity(field.parity)),
        }
    }

    /// What does not fit, one phrase a kind.
    pub(crate) fn words(self) -> Vec<String> {
        let kinds = [
            (self.foreign, "fields of cameras that the rig lacks"),
            (
                self.odd_parity,
                "fields of a parity that their camera in the rig does not have (0 and 1 if its scan is interlaced, 2 \
                 if progressive)",
            ),
        ];
        kinds
            .into_iter()
            .filter(|(count, _)| *count > 0)
            .map(|(count, what)| format!("{count} {what}"))
            .collect()
    }
}
