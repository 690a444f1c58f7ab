//! What vitrectors have taken out of the eye since the start, and what is left of the vitreous:
//! counts of whole triangles and elements by what each was at rest, so that sums balance to the
//! last µm² and µm³.

use super::World;

/// Tissue that is gone, and vitreous that is left; 0 where the scene has none.
#[derive(Debug, Clone, Copy, Default, PartialEq, Eq)]
pub struct RemovedTissue {
    /// Membrane, µm².
    pub membrane_um2: u64,
    /// Retina, µm².
    pub retina_um2: u64,
    /// Vitreous, µm³.
    pub vitreous_um3: u64,
    /// Vitreous that is left, µm³.
    pub vitreous_left_um3: u64,
}

impl World {
    /// What is gone.
    pub fn removed(&self) -> RemovedTissue {
        let gel = self.vitreous().map(|(gel, state)| {
            let lattice = gel.lattice();
            [state.removed_um3(lattice), state.remaining_um3(lattice)]
        });
        let [vitreous_um3, vitreous_left_um3] = gel.unwrap_or_default();
        RemovedTissue {
            membrane_um2: self.state.membrane.removed.area_um2,
            retina_um2: self.state.retina.as_ref().map_or(0, |r| r.sheet.removed.area_um2),
            vitreous_um3,
            vitreous_left_um3,
        }
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::world::no_clock;
    use protocol::events::EventKind;
    use scene::SceneFile;
    use surgeon::rehearsal::Rehearsal;

    /// The shipped script of a scene up to a field; the sum of the values of a kind of event.
    fn played(name: &str, fields: u64, kind: EventKind) -> (World, f64) {
        let scene = SceneFile::load(name).unwrap();
        let (rehearsal, mut world) = (Rehearsal::shipped(&scene), World::new(&scene).unwrap());
        let mut sum = 0.0;
        for field in 0..fields {
            world.step(&rehearsal.inputs(field).input(), &mut no_clock);
            let told = world.events().iter().filter(|e| e.kind == kind as u32);
            sum += told.map(|e| e.value).sum::<f64>();
        }
        (world, sum)
    }

    /// Each cut is an event in mm²; the account is their sum, and the area of the triangles that
    /// are missing.
    #[test]
    fn membrane_is_counted_as_the_events_tell_it() {
        let (world, told_mm2) = played("trim", 450, EventKind::TissueCut);
        let removed = world.removed();
        assert!(removed.membrane_um2 > 100_000, "{removed:?}");
        assert!(
            (removed.membrane_um2 as f64 * 1e-6 - told_mm2).abs() < 1e-9,
            "{removed:?}, {told_mm2} mm² told"
        );
        let (sheet, start) = (world.sheet(), world.sheet().start());
        let gone =
            sheet.triangles.iter().zip(&world.state().membrane.triangle_alive).filter(|(_, a)| **a == 0);
        let area = |t: &[u32; 3]| {
            let [a, b, c] = t.map(|n| start.position(n as usize).map(f64::from));
            0.5 * (b - a).cross(&(c - a)).norm()
        };
        let missing_mm2: f64 = gone.map(|(t, _)| area(t)).sum();
        assert!((missing_mm2 - told_mm2).abs() < 1e-4, "{missing_mm2} mm² are missing, {told_mm2} told");
        assert_eq!((removed.vitreous_um3, removed.vitreous_left_um3, removed.retina_um2), (0, 0, 0));
    }

    #[test]
    fn vitreous_gone_and_left_add_up_to_all_of_it() {
        let (world, _) = played("vitrectomy", 0, EventKind::VitreousRemoved);
        let whole = world.removed();
        let (world, _) = played("vitrectomy", 300, EventKind::VitreousRemoved);
        let now = world.removed();
        assert!(whole.vitreous_um3 == 0 && now.vitreous_um3 > 0, "{whole:?}, {now:?}");
        assert_eq!(now.vitreous_um3 + now.vitreous_left_um3, whole.vitreous_left_um3);
        // Between an eye's 4 ml and the ball of its retina, 6.4 ml, less the lens.
        assert!((3.5..6.4).contains(&(whole.vitreous_left_um3 as f64 * 1e-12)), "{whole:?}");
    }
}
