//! Tip against retina (paper, section 3.3, case 2): the tip is a point, the retina a sphere. Being
//! near, touching and being inside are different levels; each is entered at its own clearance and
//! left only a little farther away, so that tremor at a threshold is one contact and not fifty.

use protocol::events::EventKind;
use protocol::limits::SUBSTEP_NS;
use scene::ContactScene;
use serde::{Deserialize, Serialize};

/// Hysteresis of the retina contact as a share of the grazing clearance: leaving a level needs so
/// much more clearance than entering it, so that tremor at a threshold does not flood the events.
const RETINA_HYSTERESIS: f64 = 0.1;
/// Smallest hysteresis, mm.
const RETINA_HYSTERESIS_MM: f64 = 0.02;
/// A penetration is reported again whenever it is so much deeper, mm.
const PENETRATION_STEP_MM: f64 = 0.1;
/// A substep, s.
const SUBSTEP_S: f64 = SUBSTEP_NS as f64 * 1e-9;

/// How near a tip is to the retina.
#[derive(Debug, Clone, Copy, PartialEq, PartialOrd, Serialize, Deserialize)]
#[allow(missing_docs)]
pub enum RetinaLevel {
    Away,
    Grazing,
    Touching,
    Inside,
}

/// A contact of a tip with the retina.
#[derive(Debug, Clone, Copy, PartialEq, Serialize, Deserialize)]
pub struct RetinaContact {
    /// How near.
    pub level: RetinaLevel,
    /// Begin of the contact, in substeps.
    pub since_substep: u64,
    /// Depth that was reported last, mm.
    pub reported_mm: f64,
}

/// What a change of the contact means.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct ContactChange {
    /// Grazed, touched, penetrated or left.
    pub kind: EventKind,
    /// mm of clearance or depth, or s of contact.
    pub value: f64,
    /// Clearance at which it counts, mm; 0 for a left contact.
    pub limit: f64,
}

/// The state before the first contact.
pub const AWAY: RetinaContact =
    RetinaContact { level: RetinaLevel::Away, since_substep: 0, reported_mm: 0.0 };

/// Follows the contact by one substep; `clearance_mm` is the distance of the tip from the retina,
/// negative inside it.
pub fn update_contact(
    contact: &mut RetinaContact,
    clearance_mm: f64,
    substep: u64,
    scene: &ContactScene,
) -> Option<ContactChange> {
    let before = contact.level;
    let level = level_at(before, clearance_mm, scene);
    let limit = match level {
        RetinaLevel::Grazing => scene.graze_mm,
        RetinaLevel::Touching => scene.touch_mm,
        RetinaLevel::Away | RetinaLevel::Inside => 0.0,
    };
    let change = |kind, value| Some(ContactChange { kind, value, limit });
    contact.level = level;
    if before == RetinaLevel::Away && level > before {
        contact.since_substep = substep;
    }
    match level {
        RetinaLevel::Away if before > level => {
            let lasted_s = substep.saturating_sub(contact.since_substep) as f64 * SUBSTEP_S;
            *contact = AWAY;
            change(EventKind::RetinaLeft, lasted_s)
        }
        RetinaLevel::Grazing if before < level => change(EventKind::RetinaGrazed, clearance_mm),
        RetinaLevel::Touching if before < level => change(EventKind::RetinaTouched, clearance_mm),
        RetinaLevel::Inside
            if before < level || -clearance_mm > contact.reported_mm + PENETRATION_STEP_MM =>
        {
            contact.reported_mm = -clearance_mm;
            change(EventKind::RetinaPenetrated, -clearance_mm)
        }
        _ => None,
    }
}

/// The level at a clearance, coming from `before`.
fn level_at(before: RetinaLevel, clearance_mm: f64, scene: &ContactScene) -> RetinaLevel {
    use RetinaLevel::{Away, Grazing, Inside, Touching};
    let slack = (scene.graze_mm * RETINA_HYSTERESIS).max(RETINA_HYSTERESIS_MM);
    let within =
        |level: RetinaLevel, limit: f64| clearance_mm < if before >= level { limit + slack } else { limit };
    if within(Inside, 0.0) {
        Inside
    } else if within(Touching, scene.touch_mm) {
        Touching
    } else if within(Grazing, scene.graze_mm) {
        Grazing
    } else {
        Away
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use scene::SceneFile;

    fn kinds(clearances: &[f64]) -> Vec<EventKind> {
        let scene = SceneFile::load("peel").unwrap().contact;
        let mut contact = AWAY;
        let steps = clearances.iter().enumerate();
        steps
            .filter_map(|(i, &c)| update_contact(&mut contact, c, i as u64, &scene))
            .map(|c| c.kind)
            .collect()
    }

    #[test]
    fn every_level_is_told_once_on_the_way_in_and_the_end_on_the_way_out() {
        use EventKind::*;
        let way = [3.0, 0.4, 0.3, 0.04, 0.01, -0.02, -0.05, 0.3, 0.52, 2.0];
        assert_eq!(kinds(&way), [RetinaGrazed, RetinaTouched, RetinaPenetrated, RetinaLeft]);
    }

    #[test]
    fn tremor_at_a_threshold_is_one_contact() {
        let trembling: Vec<f64> = (0..1000).map(|i| 0.5 + if i % 2 == 0 { 0.01 } else { -0.01 }).collect();
        assert_eq!(kinds(&trembling), [EventKind::RetinaGrazed]);
    }

    #[test]
    fn going_deeper_is_reported_in_steps() {
        let deeper: Vec<f64> = (0..100).map(|i| -0.005 * f64::from(i)).collect();
        let told = kinds(&deeper).iter().filter(|k| **k == EventKind::RetinaPenetrated).count();
        assert!((4..=6).contains(&told), "{told}");
    }

    #[test]
    fn duration_counts_substeps() {
        let scene = SceneFile::load("peel").unwrap().contact;
        let mut contact = AWAY;
        update_contact(&mut contact, 0.2, 100, &scene);
        let left = update_contact(&mut contact, 5.0, 350, &scene).unwrap();
        assert!((left.value - 0.25).abs() < 1e-12);
    }
}
