//! What each tool does to tissue, beyond pushing it; and what the foot asks of them.

use protocol::handles::{PedalMode, PedalState};
use scene::{NeedleScene, SceneFile, VitrectorScene};
use serde::{Deserialize, Serialize};
use tissue::vitrector::Cutter;

/// Pump, blade and syringe, and what they have done.
#[derive(Debug, Clone, Copy, Default, PartialEq, Serialize, Deserialize)]
pub struct ToolsState {
    /// Suction of the pump, Pa; 0 or more.
    pub suction_pa: f64,
    /// Cut rate of the blade, cuts/min.
    pub cuts_per_min: u32,
    /// Pressure of the syringe, Pa; 0 or more.
    pub injection_pa: f64,
    /// Fluid–air exchange as a share of its full flow, 0 to 1.
    pub exchange: f64,
    /// The blade.
    pub cutter: Cutter,
}

/// The figures of a scene's tools, those it leaves out at their defaults.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct ToolFigures {
    /// The vitrector.
    pub vitrector: VitrectorScene,
    /// The needle.
    pub needle: NeedleScene,
}

impl ToolFigures {
    /// Of a scene.
    pub fn new(scene: &SceneFile) -> Self {
        ToolFigures {
            vitrector: scene.vitrector.unwrap_or_default(),
            needle: scene.needle.unwrap_or_default(),
        }
    }
}

impl ToolsState {
    /// Takes a pedal state in. A foot in another mode presses none of the tools.
    pub fn press(&mut self, pedal: &PedalState, figures: &ToolFigures) {
        let [first, second] = pedal.axes.map(|a| if a > 0.0 { a } else { 0.0 });
        let mode = PedalMode::from_wire(pedal.mode);
        let pressed = |in_mode, share: f64| if mode == Some(in_mode) { share } else { 0.0 };
        self.suction_pa = figures.vitrector.suction_pa * pressed(PedalMode::Aspirate, first);
        let full = f64::from(figures.vitrector.cuts_per_min);
        self.cuts_per_min = (full * pressed(PedalMode::Aspirate, second) + 0.5) as u32;
        self.injection_pa = figures.needle.pressure_pa * pressed(PedalMode::Inject, first);
        self.exchange = pressed(PedalMode::Exchange, first);
    }

    /// The foot asks for suction, injection or air.
    pub fn is_pressed(&self) -> bool {
        [self.suction_pa, self.injection_pa, self.exchange].iter().any(|x| *x > 0.0)
    }

    /// True if a state may hold these numbers.
    pub fn is_sound(&self) -> bool {
        let finite = [self.suction_pa, self.injection_pa, self.exchange].iter().all(|x| x.is_finite());
        finite && self.cutter.is_sound()
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use bytemuck::Zeroable;

    #[test]
    fn the_foot_drives_the_tool_of_its_mode_and_no_other() {
        let figures = ToolFigures { vitrector: VitrectorScene::default(), needle: NeedleScene::default() };
        let mut tools = ToolsState::default();
        let pedal = |mode: PedalMode, axes| PedalState { mode: mode as u32, axes, ..PedalState::zeroed() };
        tools.press(&pedal(PedalMode::Aspirate, [0.5, 0.2]), &figures);
        assert_eq!((tools.suction_pa, tools.cuts_per_min, tools.injection_pa), (43_330.0, 1_500, 0.0));
        tools.press(&pedal(PedalMode::Inject, [0.25, 1.0]), &figures);
        assert_eq!((tools.suction_pa, tools.cuts_per_min, tools.injection_pa), (0.0, 0, 20_685.0));
        tools.press(&pedal(PedalMode::Exchange, [1.0, 0.0]), &figures);
        assert_eq!((tools.injection_pa, tools.exchange), (0.0, 1.0));
        tools.press(&pedal(PedalMode::Aspirate, [-1.0, -0.5]), &figures);
        assert_eq!((tools.suction_pa, tools.cuts_per_min, tools.exchange), (0.0, 0, 0.0));
        tools.press(&pedal(PedalMode::Zoom, [1.0, 1.0]), &figures);
        assert_eq!((tools.suction_pa, tools.cuts_per_min), (0.0, 0));
    }
}
