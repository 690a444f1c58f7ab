//! Which marker of a body moved, after a refinement in which all were free.
//!
//! Blobs show the distances between the markers of a body, and not its frame: that follows from the markers which did
//! not move. Four markers in a plane do not always show which one that is. If one of them was shifted across the plane,
//! each of the others may as well have been, with a body that is tilted, and the tip lies elsewhere.

use crate::bundle::Bundle;
use nalgebra::{Isometry3, Matrix3, Point3, Rotation3, Translation3, Vector3};
use protocol::poses::BODY_NAMES;
use rig::Rig;

/// A marker has moved, and is one too many, beyond so many standard deviations.
const MOVED: f64 = 3.0;
/// Two markers may as well have moved where χ² differs by less.
const ALIKE_CHI2: f64 = 9.0;
/// The tip's places may differ by this, mm.
const TIP_MM: f64 = 0.02;

/// Why the frame of a body is not determined; `None` where each is. `marker_mm`: standard deviation of the markers'
/// positions before.
pub fn undetermined(before: &Rig, after: &Bundle, marker_mm: f64) -> Option<String> {
    BODY_NAMES.iter().zip(&after.markers).find_map(|(name, markers)| {
        let old: Vec<Point3<f64>> =
            before.body(name)?.markers.iter().map(|m| Point3::from(Vector3::from(m.p))).collect();
        let new: Vec<Point3<f64>> = markers.iter().map(|m| m.position).collect();
        of_body(&old, &new, marker_mm).map(|why| format!("{name}: {why}"))
    })
}

fn of_body(old: &[Point3<f64>], new: &[Point3<f64>], marker_mm: f64) -> Option<String> {
    let limit_mm = MOVED * marker_mm;
    let moved = |m: usize| (new[m] - old[m]).norm();
    let most = (0..old.len()).max_by(|a, b| moved(*a).total_cmp(&moved(*b)))?;
    if old.len() < 4 || moved(most) <= limit_mm {
        return None;
    }
    let alone: Vec<Alone> = (0..old.len()).map(|m| Alone::of(old, new, m)).collect();
    let chi2 = |alone: &Alone| alone.squares / (marker_mm * marker_mm);
    let best = alone.iter().map(chi2).fold(f64::MAX, f64::min);
    let alike: Vec<&Alone> = alone.iter().filter(|a| chi2(a) < best + ALIKE_CHI2).collect();
    if alike.iter().any(|a| a.largest_mm > limit_mm) {
        return Some("more than one marker has moved, so that the tip's place is not determined".into());
    }
    let tip = |alone: &Alone| alone.old_from_new.translation.vector;
    let apart = alike.iter().map(|a| (tip(a) - tip(alike[0])).norm()).fold(0.0, f64::max);
    let names: Vec<String> = alike.iter().map(|a| a.marker.to_string()).collect();
    (apart > TIP_MM).then(|| {
        format!(
            "the stream does not determine which of its markers {} has moved, and a wrong choice would displace the tip \
             by up to {:.2} mm",
            names.join(", "),
            apart
        )
    })
}

/// A body of which one marker alone has moved.
struct Alone {
    marker: usize,
    /// By the other markers.
    old_from_new: Isometry3<f64>,
    /// Of what the others leave, mm².
    squares: f64,
    largest_mm: f64,
}

impl Alone {
    fn of(old: &[Point3<f64>], new: &[Point3<f64>], marker: usize) -> Self {
        let pairs: Vec<(Point3<f64>, Point3<f64>)> = old
            .iter()
            .zip(new)
            .enumerate()
            .filter(|(m, _)| *m != marker)
            .map(|(_, (o, n))| (*o, *n))
            .collect();
        let old_from_new = between(&pairs);
        let left = pairs.iter().map(|(o, n)| (old_from_new * n - o).norm_squared());
        let (squares, largest) = left.fold((0.0, 0.0), |(sum, most): (f64, f64), s| (sum + s, most.max(s)));
        Alone { marker, old_from_new, squares, largest_mm: largest.sqrt() }
    }
}

/// The rigid motion of least squares from the second points to the first ones (Kabsch 1976).
fn between(pairs: &[(Point3<f64>, Point3<f64>)]) -> Isometry3<f64> {
    let n = pairs.len().max(1) as f64;
    let to = pairs.iter().map(|(o, _)| o.coords).sum::<Vector3<f64>>() / n;
    let from = pairs.iter().map(|(_, n)| n.coords).sum::<Vector3<f64>>() / n;
    let spread =
        pairs.iter().map(|(o, n)| (o.coords - to) * (n.coords - from).transpose()).sum::<Matrix3<f64>>();
    let svd = spread.svd(true, true);
    let (Some(u), Some(v_t)) = (svd.u, svd.v_t) else { return Isometry3::identity() };
    let proper = Matrix3::from_diagonal(&Vector3::new(1.0, 1.0, (u * v_t).determinant().signum()));
    let rotation = Rotation3::from_matrix_unchecked(u * proper * v_t);
    let turn = nalgebra::UnitQuaternion::from_rotation_matrix(&rotation);
    Isometry3::from_parts(Translation3::from(to - turn * from), turn)
}

#[cfg(test)]
mod tests {
    use super::*;

    /// Of an instrument.
    fn shaft() -> Vec<Point3<f64>> {
        vec![
            Point3::new(0.0, 0.0, 1.0),
            Point3::new(0.0, 0.0, 4.0),
            Point3::new(0.0, 0.0, 9.0),
            Point3::new(0.9, 0.0, 6.5),
        ]
    }

    fn after(shift: [Vector3<f64>; 4]) -> Option<String> {
        let old = shaft();
        let new: Vec<_> = old.iter().zip(shift).map(|(p, s)| p + s).collect();
        of_body(&old, &new, 0.005)
    }

    #[test]
    fn a_marker_shifted_across_the_plane_of_all_may_be_any_of_them() {
        let none = Vector3::zeros();
        assert_eq!(after([none; 4]), None);
        let little = Vector3::new(0.003, -0.004, 0.005);
        assert_eq!(after([little, none, -little, none]), None, "as before");
        let across = after([Vector3::new(0.0, 0.15, 0.0), none, none, none]).expect("not determined");
        // Not the last, beside the shaft: the other three are no longer in line.
        assert!(across.contains("which of its markers 0, 1, 2 has moved"), "{across}");
        // Along the plane the distances show which.
        assert_eq!(after([Vector3::new(0.1, 0.1, 0.1), none, none, none]), None);
        assert_eq!(after([none, none, none, Vector3::new(0.1, 0.0, 0.1)]), None);
    }

    #[test]
    fn two_markers_that_moved_leave_no_frame() {
        let none = Vector3::zeros();
        let two = after([Vector3::new(0.1, 0.0, 0.1), none, Vector3::new(-0.1, 0.0, -0.2), none]);
        assert!(two.expect("not determined").contains("more than one marker"));
    }
}
