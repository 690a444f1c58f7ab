//! The microscope under the foot: the pedal moves it over the eye, zooms and focuses.

use crate::constants::{
    FIELD_RANGE_MM, FOCUS_REACH_MM, MICROSCOPE_REACH_MM, PEDAL_FOCUS_MM_S, PEDAL_MOVE_MM_S, PEDAL_ZOOM_PER_S,
};
use crate::state::MicroscopeState;
use protocol::handles::PedalState;
use protocol::scene::Microscope;
use protocol::scene_file::MicroscopeScene;

/// Pedal mode: the axes move the microscope.
pub const MODE_MOVE: u32 = 0;
/// Pedal mode: the first axis zooms in, the second focuses upwards.
pub const MODE_ZOOM: u32 = 1;

/// The microscope at the start of a scene, the pedal at rest.
pub fn start(scene: &MicroscopeScene) -> MicroscopeState {
    MicroscopeState {
        target_in_world_mm: scene.target_in_world_mm,
        field_mm: scene.field_mm,
        focus_mm: 0.0,
        axes: [0.0; 2],
        mode: MODE_MOVE,
    }
}

/// Takes a pedal state in.
pub fn press(state: &mut MicroscopeState, pedal: &PedalState) {
    (state.axes, state.mode) = (pedal.axes, pedal.mode);
}

/// Moves the microscope for `dt_s` seconds. In the upright picture right is −x and up is −y of the world,
/// so the first axis, pressed to the right, moves the target to −x, and the second one to −y.
pub fn advance(state: &mut MicroscopeState, dt_s: f64) {
    let [right, up] = state.axes;
    if right == 0.0 && up == 0.0 {
        return;
    }
    match state.mode {
        MODE_MOVE => {
            for (target, axis) in state.target_in_world_mm.iter_mut().zip([right, up]) {
                let moved = *target - axis * PEDAL_MOVE_MM_S * dt_s;
                *target = moved.clamp(-MICROSCOPE_REACH_MM, MICROSCOPE_REACH_MM);
            }
        }
        MODE_ZOOM => {
            let field = state.field_mm * libm::exp(-right * PEDAL_ZOOM_PER_S * dt_s);
            state.field_mm = field.clamp(FIELD_RANGE_MM[0], FIELD_RANGE_MM[1]);
            let focus = state.focus_mm + up * PEDAL_FOCUS_MM_S * dt_s;
            state.focus_mm = focus.clamp(-FOCUS_REACH_MM, FOCUS_REACH_MM);
        }
        _ => {}
    }
}

/// As the renderer wants it.
pub fn view(state: &MicroscopeState, scene: &MicroscopeScene) -> Microscope {
    Microscope {
        target_in_world_mm: state.target_in_world_mm,
        working_distance_mm: scene.working_distance_mm,
        stereo_base_mm: scene.stereo_base_mm,
        field_mm: state.field_mm,
        focus_mm: state.focus_mm,
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use protocol::scene_file::SceneFile;

    fn pressed(mode: u32, axes: [f64; 2]) -> MicroscopeState {
        let mut state = start(&SceneFile::load("peel").unwrap().microscope);
        press(&mut state, &PedalState { seq: 0, instant_ns: 1, axes, buttons: 0, mode });
        state
    }

    #[test]
    fn the_pedal_moves_to_the_right_and_up_in_the_picture() {
        let mut state = pressed(MODE_MOVE, [1.0, 0.5]);
        advance(&mut state, 0.2);
        assert!((state.target_in_world_mm[0] + 1.0).abs() < 1e-12);
        assert!((state.target_in_world_mm[1] + 0.5).abs() < 1e-12);
    }

    #[test]
    fn zoom_and_focus_stay_in_range() {
        let mut state = pressed(MODE_ZOOM, [1.0, -1.0]);
        advance(&mut state, 1000.0);
        assert_eq!((state.field_mm, state.focus_mm), (FIELD_RANGE_MM[0], -FOCUS_REACH_MM));
    }
}
