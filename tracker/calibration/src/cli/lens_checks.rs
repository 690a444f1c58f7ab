//! How boards were held for the lenses: those that lie in parallel planes or are tilted about one axis or to one side only,
//! and lenses that are hardly known. What is true of several cameras is reported once.

use crate::lens::lens_of;
use crate::linear::plane_of;
use crate::target_problem::{Calibrated, TargetView, camera_pose};
use crate::words;
use nalgebra::{Matrix2, Vector2, Vector3};

/// Boards whose normals spread less than this, as sines, about their mean were tilted about one axis.
const ONE_AXIS: f64 = 0.1;
/// Boards whose normals spread less than this in every direction, as sines, lie in parallel planes.
const PARALLEL: f64 = 0.05;
/// Boards whose normals lie farther than this, as sines, to one side of the line of sight are seen from one side.
const ONE_SIDE: f64 = 0.05;
/// Focal lengths less sure than the first are worth a word, than the second are refused, %.
const DOUBT: [f64; 2] = [1.0, 5.0];
/// The same for the lens over the whole picture, px; by boards that are tilted about one axis it is refused beyond the
/// first: held-out views of the same tilt would not show the error.
const DOUBT_PX: [f64; 2] = [0.8, 5.0];
/// What to do about it.
const TILT: &str = "tilt the board by 20° to 45°, to another side in each view";

/// How well boards were held for the lenses.
#[derive(Debug, Default)]
pub struct Determined {
    /// What a person should do better.
    pub notes: Vec<String>,
    /// Why a lens that is known badly is not written.
    pub weak: Vec<String>,
    /// Why a lens is not determined at all.
    pub refusals: Vec<String>,
}

/// Looks at how boards were held for each lens.
pub fn determined(found: &Calibrated, sheets: &[TargetView]) -> Determined {
    let all: Vec<Finding> =
        (0..found.scene.cameras.len()).filter_map(|c| Finding::of(found, sheets, c)).collect();
    let mut determined = Determined::default();
    for (ids, kind) in words::grouped(all.iter().map(|f| (f.id, f.kind.clone()))) {
        let own: Vec<&Finding> = all.iter().filter(|f| ids.contains(&f.id)).collect();
        let text = format!("{}: {}", words::cameras(&ids), kind.text(&own));
        match kind {
            Kind::Parallel | Kind::NoFocal | Kind::NoLens => determined.refusals.push(text),
            Kind::Tilted { refused: true, .. } => determined.weak.push(text),
            _ => determined.notes.push(text),
        }
    }
    determined
}

/// What is wrong with the views of a lens.
#[derive(Debug, Clone, PartialEq)]
enum Kind {
    Parallel,
    NoFocal,
    NoLens,
    /// About one axis only.
    Tilted {
        what: &'static str,
        advice: String,
        refused: bool,
    },
    UnsureFocal,
    UnsureLens {
        side: Option<&'static str>,
    },
}

impl Kind {
    /// The sentence about cameras of this kind.
    fn text(&self, own: &[&Finding]) -> String {
        let focal = |decimals| words::span(own.iter().map(|f| f.focal), decimals);
        let doubt_px = |decimals| words::span(own.iter().map(|f| f.doubt_px), decimals);
        match self {
            Kind::Parallel => format!(
                "expected boards tilted differently, found all in parallel planes, which do not determine a lens: {TILT}"
            ),
            Kind::NoFocal => {
                format!(
                    "the views do not determine the focal length, which is uncertain by {} %: {TILT}",
                    focal(0)
                )
            }
            Kind::NoLens => format!(
                "the views do not determine the lens, whose image points are uncertain by {} px over the picture: {TILT}, and \
                 fill the picture with them",
                doubt_px(1)
            ),
            Kind::Tilted { what, advice, .. } => format!(
                "all boards are {what}, which leaves image points of the lens uncertain by {} px over the picture: {advice}",
                doubt_px(2)
            ),
            Kind::UnsureFocal => format!("the focal length is uncertain by {} %: {TILT}", focal(2)),
            Kind::UnsureLens { side } => {
                let uncertain =
                    format!("image points of the lens are uncertain by {} px over the picture", doubt_px(2));
                let more = "use more views, which fill it";
                match side {
                    None => format!("{uncertain}: {more}"),
                    Some(edge) => format!(
                        "{uncertain}, and all boards are seen from one side, their {edge} edge nearer: tilt some the other \
                         way, and {more}"
                    ),
                }
            }
        }
    }
}

/// What is wrong with the views of a camera's lens.
struct Finding {
    id: u32,
    kind: Kind,
    /// Standard deviation of the focal lengths, %.
    focal: f64,
    /// As [`Calibrated::doubt_px`].
    doubt_px: f64,
}

impl Finding {
    /// Looks at one camera's lens.
    fn of(found: &Calibrated, sheets: &[TargetView], c: usize) -> Option<Self> {
        let camera = &found.scene.cameras[c];
        let [fx, fy, ..] = lens_of(camera);
        let focal = 100.0 * (found.sigmas[c][0] / fx).abs().max((found.sigmas[c][1] / fy).abs());
        let doubt_px = found.doubt_px[c];
        let tilts = tilts(found, sheets, c);
        let is_below = |limit: f64, of: fn(&Tilts) -> f64| tilts.as_ref().is_some_and(|t| of(t) < limit);
        let kind = if is_below(PARALLEL, |t| t.most) {
            Kind::Parallel
        } else if focal.is_nan() || focal > DOUBT[1] {
            Kind::NoFocal
        } else if doubt_px > DOUBT_PX[1] {
            Kind::NoLens
        } else if let Some(tilts) = tilts.as_ref().filter(|t| t.least < ONE_AXIS) {
            let (what, advice) = tilts.about_one_axis();
            Kind::Tilted { what, advice, refused: doubt_px > DOUBT_PX[0] }
        } else if focal > DOUBT[0] {
            Kind::UnsureFocal
        } else if doubt_px > DOUBT_PX[0] {
            Kind::UnsureLens { side: tilts.and_then(|t| t.side) }
        } else {
            return None;
        };
        Some(Finding { id: camera.id, kind, focal, doubt_px })
    }
}

/// How the boards of a camera were tilted.
#[derive(Debug, PartialEq)]
struct Tilts {
    /// Smallest spread of the normals, as a sine, over all directions in the picture.
    least: f64,
    /// The largest.
    most: f64,
    /// True if they spread most across the picture, about its vertical.
    is_across: bool,
    /// The edge of the boards that is nearer in all views.
    side: Option<&'static str>,
}

impl Tilts {
    /// Of normals away from the camera, by their components in the picture (right, down).
    fn of(normals: &[Vector2<f64>]) -> Self {
        let n = normals.len().max(1) as f64;
        let mean = normals.iter().sum::<Vector2<f64>>() / n;
        let spread = normals.iter().map(|v| (v - mean) * (v - mean).transpose()).sum::<Matrix2<f64>>() / n;
        let eigen = spread.symmetric_eigen();
        let most = eigen.eigenvectors.column(eigen.eigenvalues.imax()).into_owned();
        let towards = mean.try_normalize(ONE_SIDE).filter(|m| normals.iter().all(|v| v.dot(m) > ONE_SIDE));
        // A board whose normal leads away to the right has its right edge nearer.
        let edge = |m: Vector2<f64>| match (m.x.abs() > m.y.abs(), m.x > 0.0, m.y > 0.0) {
            (true, true, _) => "right",
            (true, false, _) => "left",
            (false, _, true) => "lower",
            (false, _, false) => "upper",
        };
        let [least, largest] = [eigen.eigenvalues.min(), eigen.eigenvalues.max()].map(|v| v.max(0.0).sqrt());
        Tilts { least, most: largest, is_across: most.x.abs() > most.y.abs(), side: towards.map(edge) }
    }

    /// What is wrong with boards that are tilted about one axis, and what to do about it.
    fn about_one_axis(&self) -> (&'static str, String) {
        let (other, edges) = if self.is_across {
            ("horizontal", "upper edge nearer in some views and the lower one in others")
        } else {
            ("vertical", "left edge nearer in some views and the right one in others")
        };
        let axis = format!("tilt the board about the other axis too, the picture's {other}: the {edges}");
        match self.side {
            None => ("tilted about one axis only", axis),
            Some(edge) => (
                "tilted about one axis and seen from one side only",
                format!(
                    "{axis}; and tilt it the other way, so that not the {edge} edge is nearer in all views"
                ),
            ),
        }
    }
}

/// How a camera's boards were tilted; `None` if a target in space was seen, which needs no tilt.
fn tilts(found: &Calibrated, sheets: &[TargetView], camera: usize) -> Option<Tilts> {
    let to_camera = camera_pose(&found.scene.cameras[camera]);
    let mut normals = Vec::new();
    for sheet in sheets.iter().filter(|s| s.camera == camera) {
        let plane = plane_of(&sheet.samples).ok()??;
        let normal =
            to_camera.rotation * found.scene.views[sheet.view].rotation * plane.rotation * Vector3::z();
        // The side of a plane is arbitrary; boards are seen from the front.
        normals.push((if normal.z < 0.0 { -normal } else { normal }).xy());
    }
    Some(Tilts::of(&normals))
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn tilts_are_named_by_their_axis_and_side() {
        let of =
            |normals: &[[f64; 2]]| Tilts::of(&normals.iter().map(|&v| Vector2::from(v)).collect::<Vec<_>>());
        let across = of(&[[-0.4, 0.02], [0.3, -0.01], [0.1, 0.0], [-0.1, 0.03]]);
        assert!(across.least < ONE_AXIS && across.most > 0.2 && across.is_across, "{across:?}");
        assert_eq!(across.about_one_axis().0, "tilted about one axis only");
        assert!(across.about_one_axis().1.contains("the picture's horizontal: the upper edge"));
        let right = of(&[[0.4, 0.02], [0.3, -0.01], [0.1, 0.0]]);
        assert_eq!(right.side, Some("right"));
        assert!(right.about_one_axis().1.contains("not the right edge"), "{right:?}");
        let above = of(&[[0.05, -0.4], [-0.04, -0.2], [0.0, -0.3]]);
        assert!(above.side == Some("upper") && !above.is_across, "{above:?}");
        let all = of(&[[0.3, 0.3], [-0.3, 0.3], [0.3, -0.3], [-0.3, -0.3]]);
        assert!(all.side.is_none() && all.least > 0.25, "{all:?}");
    }
}
