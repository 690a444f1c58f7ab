//! Poses of cameras that were written by another convention: a rotation by columns, a pose from the camera to the world,
//! or a camera's position in place of t. A rig looks so if its cameras see the workspace once this is undone.

use super::Viewer;
use crate::words;
use nalgebra::{Matrix3, Vector3};
use rig::{Rig, RigCamera};
use tracker::rig_check::{RigDefect, check};

/// A convention explains a rig if at most this share of what is missing remains once it is undone.
const REMAINS: f64 = 0.25;
/// Of more cameras, not all sets are tried for transposed rotations: only pairs, all, and all but one.
const ALL_SETS: usize = 4;

/// How a pose was written.
#[derive(Debug, Clone, Copy, PartialEq)]
enum Convention {
    /// R by columns.
    Transposed,
    /// R and t lead from the camera to the world.
    Inverse,
    /// t is the camera's position in the world.
    Position,
}

impl Convention {
    /// Writes the pose of a camera as a rig file expects it.
    fn undo(self, camera: &mut RigCamera) {
        let rotation = Matrix3::from_fn(|i, j| camera.rotation[i][j]);
        let t = Vector3::from(camera.t);
        let (rotation, t) = match self {
            Convention::Transposed => (rotation.transpose(), t),
            Convention::Inverse => (rotation.transpose(), -(rotation.transpose() * t)),
            Convention::Position => (rotation, -(rotation * t)),
        };
        camera.rotation = std::array::from_fn(|i| std::array::from_fn(|j| rotation[(i, j)]));
        camera.t = t.into();
    }

    /// What would have to be done, to which cameras, and what they look like.
    fn words(self, cameras: &str) -> String {
        match self {
            Convention::Transposed => {
                format!("R of {cameras} were transposed: its rows look like columns")
            }
            Convention::Inverse => format!(
                "R and t of {cameras} were inverted: they look like those from the camera to the world, expected those \
                 from the world to the camera"
            ),
            Convention::Position => format!(
                "t of {cameras} were −R·t: it looks like the camera's position in the world, expected the world's \
                 origin in the camera's frame"
            ),
        }
    }
}

/// A convention of some cameras, and what is missing once it is undone.
struct Suspect {
    convention: Convention,
    /// Indices in the rig.
    cameras: Vec<usize>,
    lack: f64,
}

/// Says which cameras look written by another convention; `None` where that explains nothing of what is missing. The
/// rig may have defects.
pub fn remedy(rig: &Rig) -> Option<String> {
    let before = check(rig).is_ok().then(|| Viewer::new(rig).lack());
    let best = suspect(rig).filter(|s| before.is_none_or(|before| s.lack <= REMAINS * before))?;
    let cameras = words::cameras(&best.cameras.iter().map(|&i| rig.cameras[i].id).collect::<Vec<_>>());
    let lead = match (before, best.lack > 0.0) {
        (None, _) => "the cameras would see the workspace if",
        (Some(_), false) => "the cameras would see all of this if",
        (Some(_), true) => "the cameras would see most of this if",
    };
    Some(format!("{lead} {}", best.convention.words(&cameras)))
}

/// The likeliest convention: that which leaves least missing, for as few cameras as possible.
fn suspect(rig: &Rig) -> Option<Suspect> {
    let astray: Vec<usize> = (0..rig.cameras.len()).filter(|&i| is_astray(rig, i)).collect();
    let moved = [Convention::Inverse, Convention::Position].map(|convention| (convention, astray.clone()));
    let transposed = sets(rig.cameras.len()).into_iter().map(|set| (Convention::Transposed, set));
    let mut best: Option<Suspect> = None;
    for (convention, cameras) in moved.into_iter().chain(transposed) {
        let mut rig = rig.clone();
        cameras.iter().for_each(|&i| convention.undo(&mut rig.cameras[i]));
        if cameras.is_empty() || check(&rig).is_err() {
            continue;
        }
        let lack = Viewer::new(&rig).lack();
        if best.as_ref().is_none_or(|best| lack < best.lack) {
            best = Some(Suspect { convention, cameras, lack });
        }
        if lack == 0.0 {
            break;
        }
    }
    best
}

/// Sets of cameras whose rotations may be transposed, by their indices, small ones first.
fn sets(cameras: usize) -> Vec<Vec<usize>> {
    let likely = |set: &Vec<usize>| cameras <= ALL_SETS || set.len() <= 2 || set.len() + 1 >= cameras;
    let members = |bits: u32| (0..cameras).filter(|i| bits & (1 << i) != 0).collect::<Vec<_>>();
    let mut sets: Vec<_> = (1..1_u32 << cameras).map(members).filter(likely).collect();
    sets.sort_by_key(Vec::len);
    sets
}

/// True of a camera that has a defect whatever the others are.
fn is_astray(rig: &Rig, camera: usize) -> bool {
    let alone = Rig { cameras: vec![rig.cameras[camera].clone()], ..rig.clone() };
    matches!(
        check(&alone),
        Err(RigDefect::Blind { .. } | RigDefect::CameraInside { .. } | RigDefect::CameraFar { .. })
    )
}

#[cfg(test)]
mod tests {
    use super::*;
    use nalgebra::Rotation3;

    fn shipped() -> Rig {
        Rig::load_or_shipped(None).unwrap()
    }

    /// The shipped rig with the poses of some cameras written by a convention.
    fn written(convention: Convention, cameras: &[usize]) -> Rig {
        let mut rig = shipped();
        for &i in cameras {
            let camera = &mut rig.cameras[i];
            match convention {
                // Those two undo themselves.
                Convention::Transposed | Convention::Inverse => convention.undo(camera),
                Convention::Position => camera.t = camera.model().centre_in_world().coords.into(),
            }
        }
        rig
    }

    #[test]
    fn every_set_of_cameras_is_named_with_its_convention() {
        for convention in [Convention::Transposed, Convention::Inverse, Convention::Position] {
            for set in sets(3) {
                let rig = written(convention, &set);
                let said = remedy(&rig).unwrap_or_default();
                let ids: Vec<u32> = set.iter().map(|&i| rig.cameras[i].id).collect();
                let expected = convention.words(&words::cameras(&ids));
                assert!(said.ends_with(&expected), "{set:?}: {said}, expected {expected}");
            }
        }
    }

    #[test]
    fn cameras_that_look_aside_are_not_called_confused() {
        for (i, axis) in (0..3).flat_map(|i| (0..6).map(move |axis| (i, axis))) {
            let mut rig = shipped();
            let mut by = Vector3::zeros();
            by[axis % 3] = if axis < 3 { 0.15 } else { -0.15 };
            let (model, turned) = (rig.cameras[i].model(), Rotation3::new(by));
            let rotation = turned.matrix() * model.camera_from_world;
            rig.cameras[i].rotation = std::array::from_fn(|r| std::array::from_fn(|c| rotation[(r, c)]));
            rig.cameras[i].t = (turned * model.translation_mm).into();
            assert_eq!(remedy(&rig).filter(|_| Viewer::new(&rig).lack() > 0.0), None, "camera {i} by {by:?}");
        }
    }

    #[test]
    fn not_all_sets_of_many_cameras_are_tried() {
        assert_eq!(sets(8).len(), 8 + 28 + 8 + 1);
    }
}
