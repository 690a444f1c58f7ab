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
        self.check_vitreous(&self.state).map_err(|e| e.to_string())?;
        self.audit_glue()
    }
}
