//! A scene that begins in the middle of an operation: the retina is off within a circle, over
//! fluid, or cut free all round.

use super::Retina;
use super::figures::VOLUME_ERROR_MM3;
use super::state::{Bleb, RetinaState};
use crate::sheet::state::NODE_PINNED;
use crate::sheet::tearing;
use protocol::scene::NODE_FREE;
use scene::RetinaOperation;

/// Corrections in which a bleb is filled at the start: each moves nodes by at most v_max · 1 ms,
/// 0.2 mm in the shipped scenes.
const FILLS: u32 = 400;

impl Retina {
    /// Brings a retina that lies on to where a scene's operation has come.
    pub(super) fn operate(&mut self, state: &mut RetinaState, operation: &RetinaOperation) {
        let polar: Vec<f64> = self
            .home_mm
            .iter()
            .map(|p| libm::acos((-f64::from(p.z) / self.figures.radius_mm).clamp(-1.0, 1.0)))
            .collect();
        for (t, nodes) in self.body.mesh.triangles.iter().enumerate() {
            let outside = nodes.iter().filter(|&&n| polar[n as usize] > operation.cut_rad).count();
            if operation.cut_rad > 0.0 && (1..3).contains(&outside) {
                tearing::remove_triangle(&self.body.mesh, &mut state.sheet, t);
            }
        }
        for (n, polar) in polar.iter().enumerate() {
            if *polar <= operation.detached_rad && !self.fixed[n] && state.sheet.flag[n] == NODE_PINNED {
                state.sheet.flag[n] = NODE_FREE;
            }
        }
        self.resume(state);
        state.bleb_of.copy_from_slice(&self.blebs.label);
        let pieces = self.blebs.count();
        let share = operation.fluid_mm3 / pieces.max(1) as f64;
        for bleb in 0..pieces {
            let torn_mm2 = self.blebs.torn_mm2[bleb];
            state.blebs.push(Bleb { volume_mm3: share, pressure_pa: 0.0, torn_mm2 });
            state.account.injected_mm3 += share;
        }
        self.fill(state);
        state.sheet.velocity_mm_s.iter_mut().for_each(|v| v.fill(0.0));
        self.resume(state);
    }

    /// Moves the mesh until it holds what the accounts say.
    fn fill(&mut self, state: &mut RetinaState) {
        for _ in 0..FILLS {
            self.settle_volumes(state);
            let short = (0..self.blebs.count())
                .any(|b| (state.blebs[b].volume_mm3 - self.measured_mm3(state, b)).abs() > VOLUME_ERROR_MM3);
            if !short {
                break;
            }
        }
    }
}

#[cfg(test)]
mod tests {
    use super::super::Retina;
    use super::super::figures::EXCHANGE_MM3_S;
    use super::*;
    use crate::constants::SUBSTEP_S;
    use nalgebra::{UnitVector3, Vector3};
    use protocol::scene::NODE_DEAD;
    use scene::SceneFile;

    fn begun(operation: RetinaOperation) -> (Retina, RetinaState) {
        begun_of(28, operation)
    }

    fn begun_of(rings: u32, operation: RetinaOperation) -> (Retina, RetinaState) {
        let mut scene = SceneFile::load("relocation").unwrap();
        let retina = scene.retina.as_mut().unwrap();
        retina.rings = rings;
        retina.disc_in_eye_mm = Some([4.3, 0.4, -10.6]);
        retina.operation = Some(operation);
        let scene = SceneFile::parse(&scene.to_toml(), "begun").unwrap();
        Retina::new(&scene).unwrap().unwrap()
    }

    /// Runs substeps without contact.
    fn run(model: &mut Retina, state: &mut RetinaState, substeps: u64) {
        for substep in 0..substeps {
            if substep % 20 == 0 {
                model.begin_step(state);
            }
            model.flow(state, [None; 2]);
            model.substep(state, substep);
            if substep % 20 == 19 {
                model.end_step(state);
            }
        }
    }

    #[test]
    fn a_retina_begins_over_fluid_and_stays_there() {
        let operation = RetinaOperation { detached_rad: 0.5, fluid_mm3: 60.0, cut_rad: 0.0 };
        let (mut model, mut state) = begun(operation);
        assert_eq!((state.blebs.len(), state.under_mm3()), (1, 60.0));
        assert_eq!(model.check(&state), Ok(()));
        run(&mut model, &mut state, 1000);
        assert!((model.measured_all_mm3(&state) - 60.0).abs() < 1e-4, "{}", model.measured_all_mm3(&state));
        assert!((state.under_mm3() - 60.0).abs() < 1e-9 && state.blebs[0].pressure_pa > 0.0);
        assert_eq!(model.start().under_mm3(), 60.0, "a reset begins there again");
    }

    /// A cut retina holds no pressure, hangs on its disc alone, and a turn about the disc costs
    /// nothing: put there as a rigid whole, it stays.
    #[test]
    fn a_retina_that_is_cut_all_round_hangs_on_its_disc_and_turns_freely() {
        let operation = RetinaOperation { detached_rad: 1.2, fluid_mm3: 0.0, cut_rad: 1.1 };
        let (mut model, mut state) = begun(operation);
        assert!(model.blebs.open[0] && state.sheet.flag.iter().all(|&f| f != NODE_DEAD));
        let disc = (0..model.home_mm.len()).find(|&n| model.fixed[n] && model.home_mm[n].z < -9.0).unwrap();
        assert_eq!(state.sheet.flag[disc], NODE_PINNED);
        let axis = UnitVector3::new_normalize(model.home_mm[disc].map(f64::from));
        let turn = nalgebra::Rotation3::from_axis_angle(&axis, 0.4);
        let whole: Vec<usize> = model.blebs.nodes_of(0).iter().map(|&n| n as usize).collect();
        for &n in &whole {
            let p = turn * model.home_mm[n].map(f64::from);
            state.sheet.set_position(n, p.map(|c| c as f32));
        }
        run(&mut model, &mut state, 500);
        let mean = whole.iter().map(|&n| turn_of(&model, &state, n, &axis)).sum::<f64>() / whole.len() as f64;
        assert!((mean - 0.4).abs() < 0.01, "{mean}");
        assert_eq!(state.blebs[0].pressure_pa, 0.0);
        let account = state.account;
        assert!((account.injected_mm3 - account.leaked_mm3 - state.under_mm3()).abs() < 1e-9);
        // Air drives it on, and it holds where it is.
        state.air = true;
        for substep in 500..8000 {
            if substep % 20 == 0 {
                model.begin_step(&state);
            }
            model.flow(&mut state, [None; 2]);
            model.substep(&mut state, substep);
            if substep % 20 == 19 {
                model.end_step(&mut state);
            }
        }
        assert_eq!(state.blebs.len(), 0, "{:?}", state.blebs);
        // A few nodes near folds aside, it lies where it was put.
        let mut lying: Vec<f64> = whole.iter().map(|&n| turn_of(&model, &state, n, &axis)).collect();
        lying.sort_by(f64::total_cmp);
        let [least, middle, most] = [10, 50, 90].map(|percent| lying[(lying.len() - 1) * percent / 100]);
        assert!(least > 0.34 && most < 0.46 && (middle - 0.4).abs() < 0.02, "{least} {middle} {most}");
    }

    /// Kinetic energy and that of the springs, nJ.
    fn energy_nj(model: &Retina, state: &RetinaState) -> f64 {
        let tissue = &state.sheet;
        let squares = (0..tissue.nodes()).filter(|&n| tissue.flag[n] == NODE_FREE);
        let squares = squares.map(|n| f64::from(tissue.velocity(n).norm_squared()));
        let kinetic = 0.5 * model.figures.scene.node_mass_g * squares.sum::<f64>();
        let spring = |(s, ends): (usize, &[u32; 2])| {
            let [a, b] = ends.map(|n| tissue.position(n as usize));
            let stretch = f64::from((b - a).norm() - model.body.mesh.rest_mm[s]);
            0.5 * f64::from(model.body.material().spring(&model.body.mesh, tissue, s).0) * stretch * stretch
        };
        kinetic + model.body.mesh.springs.iter().enumerate().map(spring).sum::<f64>()
    }

    /// Retina at rest whose free edge stands millimetres off the choroid: whatever the air does to
    /// it costs no more than its pressure does on what the pump drives.
    #[test]
    fn air_does_no_more_work_on_a_standing_retina_than_its_pump() {
        let operation = RetinaOperation { detached_rad: 1.3, fluid_mm3: 0.0, cut_rad: 1.2 };
        let (mut model, mut state) = begun_of(14, operation);
        let disc = (0..model.home_mm.len()).find(|&n| model.fixed[n] && model.home_mm[n].z < -9.0).unwrap();
        for &n in model.blebs.nodes_of(0) {
            let home = model.home_mm[n as usize];
            let far = ((home - model.home_mm[disc]).norm() / 6.0).min(1.0);
            state.sheet.set_position(n as usize, home * (1.0 - 0.5 * far));
        }
        run(&mut model, &mut state, 1500);
        let edge = model.blebs.nodes_of(0).iter().map(|&n| state.sheet.position(n as usize).norm());
        assert!(model.blebs.open[0] && edge.fold(11.5, f32::min) < 9.5, "it stands");
        state.air = true;
        model.begin_step(&state);
        let begin_nj = energy_nj(&model, &state);
        for substep in 1..=60 {
            model.flow(&mut state, [None; 2]);
            model.substep(&mut state, substep);
            let work_nj = energy_nj(&model, &state) - begin_nj;
            let driven_mm3 = EXCHANGE_MM3_S * SUBSTEP_S * substep as f64;
            assert!(work_nj < model.figures.scene.air_pa * driven_mm3, "{work_nj} nJ in {substep} ms");
        }
        model.end_step(&mut state);
        let account = state.account;
        assert!((account.injected_mm3 - account.leaked_mm3 - state.under_mm3()).abs() < 1e-9);
    }

    /// Angle of a node about the axis against its home, rad; for nodes near the axis that of the
    /// whole.
    fn turn_of(model: &Retina, state: &RetinaState, n: usize, axis: &UnitVector3<f64>) -> f64 {
        let flat = |p: Vector3<f64>| p - axis.into_inner() * p.dot(axis);
        let (home, now) =
            (flat(model.home_mm[n].map(f64::from)), flat(state.sheet.position(n).map(f64::from)));
        if home.norm() < 1.0 { 0.4 } else { home.cross(&now).dot(axis).atan2(home.dot(&now)) }
    }
}
