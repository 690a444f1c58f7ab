//! Cameras whose fields are all refused: their frames are missing, and it must be said why. Pure.

use crate::assembler::Refusal;
use protocol::limits::MAX_CAMERAS;

/// Fields of a camera refused in a row that are no accident: repeated fields and single wrong stamps are fewer.
const MANY: u32 = 10;
/// Place of all cameras that no rig has.
const OTHERS: usize = MAX_CAMERAS;

/// Counts of fields refused, by camera.
#[derive(Debug, Clone, Default)]
pub struct Refusals {
    in_a_row: [u32; MAX_CAMERAS + 1],
    /// Why the newest was, of each camera of which many are.
    why: [Option<String>; MAX_CAMERAS + 1],
}

impl Refusals {
    /// Adds a refused field of `camera`; returns what is to be reported, once until a field of it is taken.
    pub fn note(&mut self, camera: u32, refusal: &Refusal) -> Option<String> {
        let place = (camera as usize).min(OTHERS);
        self.in_a_row[place] = self.in_a_row[place].saturating_add(1);
        if self.in_a_row[place] != MANY {
            return None;
        }
        let why = format!("all fields are refused: {refusal}");
        self.why[place] = Some(why.clone());
        Some(why)
    }

    /// Adds a field of `camera` that was taken; true where that ends what was reported.
    pub fn taken(&mut self, camera: u32) -> bool {
        let place = (camera as usize).min(OTHERS);
        self.in_a_row[place] = 0;
        self.why[place].take().is_some()
    }

    /// What is wrong at present, empty where nothing is.
    pub fn text(&self) -> &str {
        self.why.iter().flatten().next().map_or("", String::as_str)
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn many_in_a_row_are_reported_once_and_until_one_is_taken() {
        let mut refusals = Refusals::default();
        let future = Refusal::FromTheFuture(1);
        for _ in 0..3 {
            // One now and then is an accident.
            (1..MANY).for_each(|_| assert_eq!(refusals.note(1, &future), None));
            assert!(!refusals.taken(1) && refusals.text().is_empty());
        }
        let told: Vec<String> = (0..5 * MANY).filter_map(|_| refusals.note(1, &future)).collect();
        assert_eq!(told, ["all fields are refused: camera 1: exposed in the future"]);
        assert!(!refusals.taken(0) && refusals.text() == told[0], "another camera");
        let strange = (0..MANY).find_map(|_| refusals.note(77, &Refusal::UnknownCamera(77)));
        assert!(strange.is_some_and(|text| text.ends_with("camera 77 is not in the rig")));
        assert!(refusals.taken(1) && refusals.text().contains("camera 77"));
    }
}
