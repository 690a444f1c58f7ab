//! What must hold after every step, whatever was done. Each subject adds its own line.

use super::World;
use crate::bodies::state::BodiesState;
use protocol::handles::Tool;
use tissue::sheet::material::Material;
use tissue::sheet::state::{SheetContact, SheetState};

impl World {
    /// Checks the state: numbers finite, mesh whole, accounts balanced. The text names the first
    /// thing that is wrong. For tests; it may allocate.
    ///
    /// # Errors
    /// The first thing that is wrong.
    pub fn audit(&self) -> Result<(), String> {
        if let Some(membrane) = &self.membrane {
            membrane.audit(&self.state.membrane).map_err(|e| format!("the membrane: {e}"))?;
        }
        BodiesState::check(self.state.bodies.as_ref(), self.scene.bodies.as_ref())
            .map_err(|e| e.to_string())?;
        self.audit_retina()?;
        self.check_vitreous(&self.state).map_err(|e| e.to_string())
    }

    /// Pairs of an instrument and a sheet whose last collision image had colliding pixels.
    pub fn contacts(&self) -> u64 {
        let pairs = self.state.sheets().flat_map(|sheet| &sheet.contact);
        pairs.filter(|contact| contact.in_contact).count() as u64
    }

    /// True while something acts on tissue: an instrument holds, touches or has pierced it, or a
    /// vitrector sucks.
    pub fn is_handled(&self) -> bool {
        let vitrector = Tool::Vitrector as u32;
        let suction = self.state.tools.suction_pa > 0.0;
        let acts = |sheet: &SheetState| {
            let touched = |c: &SheetContact| c.in_contact || c.pierced.is_some();
            sheet.held.iter().any(|h| !h.is_empty()) || sheet.contact.iter().any(touched)
        };
        let pierced = self.state.retina.as_ref().is_some_and(|r| r.needles.iter().any(|n| n.inside));
        pierced
            || self.state.sheets().any(acts)
            || suction && self.state.instruments.iter().any(|i| i.tool == vitrector)
    }

    /// Square of the acceleration of each node of the membrane in the last part of a substep,
    /// before its limit, mm²/s⁴.
    pub fn membrane_acceleration2(&self) -> &[f32] {
        self.membrane.as_ref().map_or(&[], |body| &body.solver.acceleration2)
    }

    /// Changes the figures by which the membrane moves into what no scene can ask for.
    pub fn spoil_membrane(&mut self, spoil: impl FnOnce(&mut Material)) {
        if let Some(membrane) = &mut self.membrane {
            membrane.spoil(&self.state.membrane, spoil);
        }
    }

    /// The retina's mesh is whole, its blebs are those of its flags, and the fluid balances:
    /// injected = under it + leaked.
    fn audit_retina(&self) -> Result<(), String> {
        self.check_sheets(&self.state).map_err(|e| e.to_string())?;
        let Some(retina) = &self.state.retina else { return Ok(()) };
        let account = &retina.account;
        let missing = account.injected_mm3 - account.leaked_mm3 - retina.under_mm3();
        let rounding = 1e-9 * (1.0 + account.injected_mm3.abs() + account.leaked_mm3.abs());
        if missing.abs() <= rounding {
            Ok(())
        } else {
            Err(format!("{missing:e} mm³ of the fluid under the retina are missing from its account"))
        }
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::world::no_clock;
    use protocol::events::EventKind;
    use protocol::steps::StepInput;
    use scene::{RetinaOperation, SceneFile};
    use surgeon::rehearsal::Rehearsal;

    /// Plays a scene for a while, spoils its state, plays on: the events of the second part. The
    /// audit must pass after every step.
    fn spoiled(scene: &SceneFile, fields: u64, spoil: impl FnOnce(&mut World)) -> (World, Vec<u32>) {
        let (rehearsal, mut world) = (Rehearsal::shipped(scene), World::new(scene).unwrap());
        let mut events = Vec::new();
        let mut spoil = Some(spoil);
        for field in 0..fields + 25 {
            if field == fields {
                spoil.take().unwrap()(&mut world);
                events.clear();
            }
            world.step(&rehearsal.inputs(field).input(), &mut no_clock);
            events.extend(world.events().iter().map(|e| e.kind));
            world.audit().unwrap_or_else(|e| panic!("field {field}: {e}"));
        }
        (world, events)
    }

    const DISABLED: u32 = EventKind::TissueDisabled as u32;

    #[test]
    fn a_bad_number_in_the_membrane_costs_its_node_and_the_rest_goes_on() {
        let scene = SceneFile::load("peel").unwrap();
        for bad in [f32::NAN, f32::NEG_INFINITY, 3e20] {
            let node = 250;
            let (world, events) = spoiled(&scene, 5, |w| w.state.membrane.position_mm[2][node] = bad);
            let alive = |a: &&u8| **a != 0;
            let lost = 1000 - world.state.membrane.triangle_alive.iter().filter(alive).count();
            assert!(events.contains(&DISABLED) && (1..=40).contains(&lost), "{bad}: {lost} triangles");
            let (_, events) = spoiled(&scene, 5, |w| w.state.membrane.velocity_mm_s[0][node] = bad);
            assert!(events.contains(&DISABLED), "{bad} as a velocity");
        }
    }

    #[test]
    fn a_bad_number_in_the_retina_or_its_fluid_costs_its_culprit_and_the_rest_goes_on() {
        let mut scene = SceneFile::load("relocation").unwrap();
        let operation = RetinaOperation { detached_rad: 0.4, fluid_mm3: 30.0, cut_rad: 0.0 };
        scene.retina.as_mut().unwrap().operation = Some(operation);
        let retina = |w: &mut World, spoil: fn(&mut tissue::retina::state::RetinaState)| {
            spoil(w.state.retina.as_mut().unwrap())
        };
        let spoils: [fn(&mut tissue::retina::state::RetinaState); 4] = [
            |r| r.sheet.position_mm[0][7] = f32::NAN,
            |r| r.sheet.velocity_mm_s[1][7] = f32::INFINITY,
            |r| r.blebs[0].volume_mm3 = f64::NAN,
            |r| r.blebs[0].pressure_pa = f64::NEG_INFINITY,
        ];
        for (i, spoil) in spoils.into_iter().enumerate() {
            let (world, events) = spoiled(&scene, 3, |w| retina(w, spoil));
            assert!(events.contains(&DISABLED), "number {i}");
            let loose = world.retina().unwrap().blebs.loose().len();
            assert!(loose > 100, "number {i}: the rest is still lifted: {loose} nodes");
        }
    }

    /// Fluid that is a bad number only when volumes are settled cannot leave bad nodes behind: the
    /// last check of a step is the last.
    #[test]
    fn nodes_that_run_away_while_volumes_are_settled_are_taken_out_in_the_same_step() {
        let mut scene = SceneFile::load("relocation").unwrap();
        let operation = RetinaOperation { detached_rad: 0.4, fluid_mm3: 30.0, cut_rad: 0.0 };
        scene.retina.as_mut().unwrap().operation = Some(operation);
        let (_, events) = spoiled(&scene, 3, |w| {
            let retina = w.state.retina.as_mut().unwrap();
            let more = 1e12;
            retina.blebs[0].volume_mm3 += more;
            retina.account.injected_mm3 += more;
        });
        assert!(!events.is_empty());
    }

    /// A stiff retina is split as a stiff membrane is, and the first step raises one event, with
    /// the larger number.
    #[test]
    fn split_substeps_are_told_whichever_tissue_needs_them() {
        let parts = |scene: &SceneFile| {
            let (rehearsal, mut world) = (Rehearsal::shipped(scene), World::new(scene).unwrap());
            let told = |w: &World| {
                let split = |e: &&protocol::events::Event| e.kind == EventKind::TimeStepSplit as u32;
                w.events().iter().filter(split).map(|e| e.value).collect::<Vec<_>>()
            };
            world.step(&rehearsal.inputs(0).input(), &mut no_clock);
            let first = told(&world);
            world.step(&rehearsal.inputs(1).input(), &mut no_clock);
            assert!(told(&world).is_empty(), "once");
            first
        };
        let mut stiff = SceneFile::load("relocation").unwrap();
        assert!(parts(&stiff).is_empty());
        let retina = stiff.retina.as_mut().unwrap();
        (retina.stiffness_un_per_mm, retina.spring_damping_un_s_per_mm) = (5e4, 0.0);
        // Six springs a node and some more at the fovea: dt²·12 k/m < 4 within 1 ms takes at least
        // 1.7 parts at 0.03 g.
        let found = parts(&stiff);
        assert!(found.len() == 1 && found[0] >= 2.0, "{found:?}");
        let mut both = SceneFile::load("peel").unwrap();
        both.membrane.as_mut().unwrap().stiffness_un_per_mm = 4e4;
        let found = parts(&both);
        assert!(found.len() == 1 && found[0] >= 4.0, "{found:?}");
    }

    /// Bodies stop where they last were; an instrument whose pose is not a number is refused, and
    /// nothing else notices.
    #[test]
    fn bad_numbers_in_bodies_and_poses_touch_nothing_else() {
        let scene = SceneFile::load("bodies").unwrap();
        let spoils: [fn(&mut crate::bodies::state::BodyState); 2] =
            [|b| b.velocity_mm_s.x = f64::NAN, |b| b.eye_from_body.translation.vector.y = f64::NAN];
        for spoil in spoils {
            let (world, events) =
                spoiled(&scene, 5, |w| spoil(&mut w.state.bodies.as_mut().unwrap().body[0]));
            assert_eq!(world.state.step, 30);
            let stopped = events.iter().filter(|&&k| k == EventKind::BodyStopped as u32).count();
            assert_eq!(stopped, 1, "it is stopped once, and stands");
        }
        for name in ["peel", "relocation", "vitrectomy", "bodies"] {
            let scene = SceneFile::load(name).unwrap();
            let (rehearsal, mut world) = (Rehearsal::shipped(&scene), World::new(&scene).unwrap());
            world.step(&rehearsal.inputs(0).input(), &mut no_clock);
            let (mut frame, handles) = rehearsal.field(1);
            frame.bodies[0].world_from_body.position_mm = [f64::NAN, 1e300, f64::INFINITY];
            let input = StepInput { frame: &frame, handles: &handles, pedals: &[] };
            world.step(&input, &mut no_clock);
            let told = world.events().iter().any(|e| {
                e.kind == EventKind::InputRefused as u32 || e.kind == EventKind::TrackingLost as u32
            });
            assert!(told, "{name}");
            world.audit().unwrap_or_else(|e| panic!("{name}: {e}"));
        }
    }

    /// The vitreous has whole numbers only, and every move ends at a limit: the fastest way through
    /// it, there and back, breaks none.
    #[test]
    fn the_vitreous_cannot_run_away() {
        let mut scene = SceneFile::load("vitrectomy").unwrap();
        scene.vitreous.as_mut().unwrap().lattice = 24;
        let (rehearsal, mut world) = (Rehearsal::shipped(&scene), World::new(&scene).unwrap());
        for field in 0..40u64 {
            let (mut frame, handles) = rehearsal.field(field);
            let side = if field % 2 == 0 { 9.0 } else { -9.0 };
            frame.bodies[0].world_from_body.position_mm = [side, 0.5 * side, -3.0];
            let input = StepInput { frame: &frame, handles: &handles, pedals: &[] };
            world.step(&input, &mut no_clock);
            world.audit().unwrap_or_else(|e| panic!("field {field}: {e}"));
        }
        let (gel, state) = world.vitreous().unwrap();
        let moved = state.shift_um.iter().flatten().filter(|&&s| s != 0).count();
        assert!(moved > 20 && state.remaining_um3(gel.lattice()) > 0, "{moved}");
    }
}
