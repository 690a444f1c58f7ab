//! The microscope under the foot: the pedal moves it over the eye, zooms, focuses, changes its lens
//! and steps.

use crate::constants::{
    FIELD_RANGE_MM, FOCUS_REACH_MM, MICROSCOPE_REACH_MM, PEDAL_FOCUS_MM_S, PEDAL_MOVE_MM_S, PEDAL_ZOOM_PER_S,
};
use crate::state::{MicroscopeState, OpticsState};
use protocol::handles::PedalState;
use protocol::optics::{Filter, Lens, PedalButton};
use protocol::scene::Microscope;
use scene::SceneFile;

/// A field within this of a step is at it, mm.
const STEP_MM: f64 = 0.01;
/// Pedal mode: the axes move the microscope.
pub const MODE_MOVE: u32 = 0;
/// Pedal mode: the first axis zooms in, the second focuses upwards.
pub const MODE_ZOOM: u32 = 1;

/// The microscope at the start of a scene, the pedal at rest.
pub fn start(scene: &SceneFile) -> MicroscopeState {
    let microscope = &scene.microscope;
    MicroscopeState {
        target_in_world_mm: microscope.target_in_world_mm,
        field_mm: microscope.field_mm,
        focus_mm: 0.0,
        axes: [0.0; 2],
        mode: MODE_MOVE,
    }
}

/// Its optics at the start, where the scene sets them.
pub fn start_optics(scene: &SceneFile) -> Option<OpticsState> {
    scene.optics.as_ref().map(|optics| OpticsState {
        buttons: 0,
        lens: optics.lens as u32,
        inverter: optics.inverter,
        filter: optics.filter as u32,
    })
}

/// Takes a pedal state in. A button acts when it was not held before.
pub fn apply_pedal(
    state: &mut MicroscopeState,
    optics: &mut Option<OpticsState>,
    pedal: &PedalState,
    scene: &SceneFile,
) {
    (state.axes, state.mode) = (pedal.axes, pedal.mode);
    if pedal.buttons == 0 && optics.is_none() {
        return;
    }
    let optics = optics.get_or_insert_default();
    let fresh = pedal.buttons & !optics.buttons;
    optics.buttons = pedal.buttons;
    let steps = &scene.optics_or_usual().steps_mm;
    if PedalButton::Magnify.is_in(fresh) {
        state.field_mm =
            steps.iter().copied().find(|&s| s < state.field_mm - STEP_MM).unwrap_or(state.field_mm);
    }
    if PedalButton::Reduce.is_in(fresh) {
        let larger = steps.iter().rev().copied().find(|&s| s > state.field_mm + STEP_MM);
        state.field_mm = larger.unwrap_or(state.field_mm);
    }
    if PedalButton::Lens.is_in(fresh) {
        let lens = Lens::from_wire(optics.lens).swung();
        (optics.lens, optics.inverter) = (lens as u32, lens == Lens::WideAngle);
    }
    if PedalButton::Inverter.is_in(fresh) {
        optics.inverter = !optics.inverter;
    }
    if PedalButton::Filter.is_in(fresh) {
        optics.filter = Filter::from_wire(optics.filter).next() as u32;
    }
}

/// True if the picture stands on its head: one of lens and inverter turns it, not both.
pub fn is_inverted(optics: &OpticsState) -> bool {
    (Lens::from_wire(optics.lens) == Lens::WideAngle) != optics.inverter
}

/// Moves the microscope for `dt_s` seconds. In the upright picture right is −x and up is −y of the
/// world, so the first axis, pressed to the right, moves the target to −x, and the second one to
/// −y. Where the picture stands on its head the drive is reversed, so that right stays right.
pub fn advance(state: &mut MicroscopeState, optics: &Option<OpticsState>, dt_s: f64) {
    let [right, up] = state.axes;
    if right == 0.0 && up == 0.0 {
        return;
    }
    match state.mode {
        MODE_MOVE => {
            let sense = if optics.as_ref().is_some_and(is_inverted) { 1.0 } else { -1.0 };
            for (target, axis) in state.target_in_world_mm.iter_mut().zip([right, up]) {
                let moved = *target + sense * axis * PEDAL_MOVE_MM_S * dt_s;
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
pub fn view(state: &MicroscopeState, optics: &Option<OpticsState>, scene: &SceneFile) -> Microscope {
    let optics = optics.unwrap_or_default();
    Microscope {
        target_in_world_mm: state.target_in_world_mm,
        field_mm: state.field_mm,
        focus_mm: state.focus_mm,
        lens: optics.lens,
        inverter: u32::from(optics.inverter),
        ..scene.start_microscope()
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use protocol::handles::PedalMode;

    fn peel() -> SceneFile {
        SceneFile::load("peel").unwrap()
    }

    fn pedal(mode: u32, axes: [f64; 2], buttons: u32) -> PedalState {
        PedalState { seq: 0, instant_ns: 1, axes, buttons, mode }
    }

    fn pressed(mode: u32, axes: [f64; 2]) -> MicroscopeState {
        let mut state = start(&peel());
        apply_pedal(&mut state, &mut None, &pedal(mode, axes, 0), &peel());
        state
    }

    #[test]
    fn the_pedal_moves_to_the_right_and_up_in_the_picture() {
        let mut state = pressed(MODE_MOVE, [1.0, 0.5]);
        advance(&mut state, &None, 0.2);
        assert!((state.target_in_world_mm[0] + 1.0).abs() < 1e-12);
        assert!((state.target_in_world_mm[1] + 0.5).abs() < 1e-12);
        let mut optics = OpticsState { inverter: true, ..OpticsState::default() };
        advance(&mut state, &Some(optics), 0.2);
        assert!(state.target_in_world_mm[0].abs() < 1e-12, "reversed in an inverted picture");
        optics.lens = Lens::WideAngle as u32;
        advance(&mut state, &Some(optics), 0.2);
        assert!((state.target_in_world_mm[0] + 1.0).abs() < 1e-12, "upright again");
    }

    #[test]
    fn zoom_and_focus_stay_in_range() {
        let mut state = pressed(MODE_ZOOM, [1.0, -1.0]);
        advance(&mut state, &None, 1000.0);
        assert_eq!((state.field_mm, state.focus_mm), (FIELD_RANGE_MM[0], -FOCUS_REACH_MM));
    }

    #[test]
    fn buttons_act_once_when_pressed() {
        let scene = peel();
        let (mut state, mut optics) = (start(&scene), start_optics(&scene));
        apply_pedal(&mut state, &mut optics, &pedal(0, [0.0; 2], 0), &scene);
        assert_eq!(optics, None, "no optics without a request");
        let mut hold = |button: PedalButton, times: usize| {
            for _ in 0..times {
                let held = pedal(PedalMode::Aspirate as u32, [0.0; 2], button as u32);
                apply_pedal(&mut state, &mut optics, &held, &scene);
            }
            apply_pedal(&mut state, &mut optics, &pedal(0, [0.0; 2], 0), &scene);
            (state.field_mm, optics.unwrap())
        };
        assert_eq!(hold(PedalButton::Magnify, 3).0, 10.0, "one step from 16 mm, however long it is held");
        assert_eq!(hold(PedalButton::Magnify, 1).0, 6.4);
        assert_eq!(hold(PedalButton::Reduce, 1).0, 10.0);
        let wide = hold(PedalButton::Lens, 2).1;
        assert_eq!((wide.lens, wide.inverter, is_inverted(&wide)), (Lens::WideAngle as u32, true, false));
        assert!(is_inverted(&hold(PedalButton::Inverter, 1).1), "whoever forgets the prism sees it");
        let flat = hold(PedalButton::Lens, 1).1;
        assert_eq!((flat.lens, flat.inverter), (Lens::Flat as u32, false));
        assert_eq!(hold(PedalButton::Filter, 1).1.filter, Filter::Yellow as u32);
    }

    #[test]
    fn steps_end_at_the_last_one_and_join_the_zoom() {
        let scene = peel();
        let (mut state, mut optics) = (start(&scene), None);
        state.field_mm = 13.0;
        let mut once = |button: PedalButton| {
            apply_pedal(&mut state, &mut optics, &pedal(0, [0.0; 2], button as u32), &scene);
            apply_pedal(&mut state, &mut optics, &pedal(0, [0.0; 2], 0), &scene);
            state.field_mm
        };
        assert_eq!(
            (once(PedalButton::Reduce), once(PedalButton::Reduce), once(PedalButton::Reduce)),
            (16.0, 27.0, 27.0)
        );
        let down: Vec<f64> = (0..6).map(|_| once(PedalButton::Magnify)).collect();
        assert_eq!(down, [16.0, 10.0, 6.4, 4.0, 4.0, 4.0]);
    }
}
