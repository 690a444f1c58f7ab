//! What must hold after every step, whatever was done. Each subject adds its own line.

use super::World;
use crate::bodies::state::BodiesState;
use crate::guard;
use crate::membrane::tear;

impl World {
    /// Checks the state: numbers finite, mesh whole, accounts balanced. The text names the first thing that is wrong.
    /// For tests; it may allocate.
    pub fn audit(&self) -> Result<(), String> {
        if !guard::all_finite(&self.state.membrane) {
            return Err("the membrane has numbers that are not finite".into());
        }
        tear::check_mesh(&self.sheet, &self.state.membrane)?;
        BodiesState::check(self.state.bodies.as_ref(), self.scene.bodies.as_ref())
            .map_err(|e| e.to_string())?;
        self.audit_retina()?;
        self.check_vitreous(&self.state).map_err(|e| e.to_string())?;
        self.audit_glue()
    }

    /// The retina's mesh is whole, its blebs are those of its flags, and the fluid balances: injected = under it + leaked.
    fn audit_retina(&self) -> Result<(), String> {
        self.check_retina(&self.state).map_err(|e| e.to_string())?;
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
