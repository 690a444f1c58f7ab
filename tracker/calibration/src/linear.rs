//! First guesses without iteration: homographies, lenses from planes (Zhang 2000), a camera from
//! dots in space (direct linear transform, Abdel-Aziz & Karara 1971), places of planes and points.
//!
//! They ignore distortion and minimise algebraic errors; the least squares after them does the
//! rest.

use crate::lens::pinhole_camera;
use crate::target_problem::Correspondence;
use crate::target_problem::set_camera_pose;
use crate::{CalibrationError, degenerate};
use nalgebra::{
    DMatrix, DVector, Isometry3, Matrix3, Matrix3x4, Point3, Rotation3, SVector, Translation3,
    UnitQuaternion, Vector2, Vector3,
};
use rig::camera::Camera;

/// Spread of points out of their plane, as a share of their extent, below which they count as
/// plane.
const PLANE: f64 = 1e-4;
/// Second smallest over largest singular value of a linear system below which its solution is not
/// one.
const RANK: f64 = 1e-7;
/// Spread across a line, as a share of the extent, below which points count as collinear.
const LINE: f64 = 1e-3;

/// The plane in which points lie: `world_from_plane`, with the points at z = 0.
///
/// `None` where they fill space.
///
/// # Errors
/// Points on a line or in one place.
pub fn plane_of(samples: &[Correspondence]) -> Result<Option<Isometry3<f64>>, CalibrationError> {
    let n = samples.len() as f64;
    let centre = samples.iter().map(|s| s.point.coords).sum::<Vector3<f64>>() / n;
    let spread = samples.iter().map(|s| s.point.coords - centre).map(|d| d * d.transpose());
    let eigen = spread.sum::<Matrix3<f64>>().symmetric_eigen();
    let mut order = [0, 1, 2];
    order.sort_by(|&a, &b| eigen.eigenvalues[b].total_cmp(&eigen.eigenvalues[a]));
    let extent = order.map(|i| eigen.eigenvalues[i].max(0.0).sqrt());
    if extent[1].is_nan() || extent[1] <= LINE * extent[0] {
        return Err(degenerate("the points of the target lie on a line or in one place"));
    }
    if extent[2] > PLANE * extent[0] {
        return Ok(None);
    }
    let x = eigen.eigenvectors.column(order[0]).into_owned();
    let y = eigen.eigenvectors.column(order[1]).into_owned();
    let axes = Rotation3::from_basis_unchecked(&[x, y, x.cross(&y)]);
    let rotation = UnitQuaternion::from_rotation_matrix(&axes);
    Ok(Some(Isometry3::from_parts(Translation3::from(centre), rotation)))
}

/// Scales points so that their mean is 0 and their mean distance √2 (Hartley 1997).
fn normaliser(points: impl Iterator<Item = Vector2<f64>> + Clone) -> Matrix3<f64> {
    let n = points.clone().count().max(1) as f64;
    let mean = points.clone().sum::<Vector2<f64>>() / n;
    let size = points.map(|p| (p - mean).norm()).sum::<f64>() / n;
    let s = std::f64::consts::SQRT_2 / size.max(f64::MIN_POSITIVE);
    Matrix3::new(s, 0.0, -s * mean.x, 0.0, s, -s * mean.y, 0.0, 0.0, 1.0)
}

/// The vector that a matrix makes shortest; refused where two directions do equally well.
fn null_vector(rows: DMatrix<f64>) -> Result<DVector<f64>, CalibrationError> {
    let eigen = (rows.transpose() * &rows).symmetric_eigen();
    let mut order: Vec<usize> = (0..eigen.eigenvalues.len()).collect();
    order.sort_by(|&a, &b| eigen.eigenvalues[a].total_cmp(&eigen.eigenvalues[b]));
    let [second, largest] = [order[1], order[order.len() - 1]].map(|i| eigen.eigenvalues[i].max(0.0));
    if second.is_nan() || second <= RANK * RANK * largest {
        return Err(degenerate(
            "the points do not determine the projection: too few, or all on a line or a plane",
        ));
    }
    Ok(eigen.eigenvectors.column(order[0]).into_owned())
}

/// Equations of a direct linear transform of homogeneous points to pixels.
fn transform_equations<const N: usize>(
    pairs: impl ExactSizeIterator<Item = (SVector<f64, N>, Vector2<f64>)>,
) -> DMatrix<f64> {
    let mut rows = DMatrix::zeros(2 * pairs.len(), 3 * N);
    for (i, (p, q)) in pairs.enumerate() {
        for c in 0..N {
            rows[(2 * i, c)] = p[c];
            rows[(2 * i, 2 * N + c)] = -q.x * p[c];
            rows[(2 * i + 1, N + c)] = p[c];
            rows[(2 * i + 1, 2 * N + c)] = -q.y * p[c];
        }
    }
    rows
}

/// Homography `image_from_plane` of points (x, y) of a plane and their pixels.
///
/// # Errors
/// Too few points, or points that do not determine it.
pub fn homography(pairs: &[(Vector2<f64>, Vector2<f64>)]) -> Result<Matrix3<f64>, CalibrationError> {
    if pairs.len() < 4 {
        return Err(degenerate(format!("{} points; a plane needs at least 4", pairs.len())));
    }
    let from = normaliser(pairs.iter().map(|p| p.0));
    let to = normaliser(pairs.iter().map(|p| p.1));
    let scaled = pairs.iter().map(|(plane, pixel)| (from * plane.push(1.0), (to * pixel.push(1.0)).xy()));
    let h = null_vector(transform_equations(scaled))?;
    let normal = Matrix3::from_row_slice(h.as_slice());
    let back = to.try_inverse().ok_or_else(|| degenerate("all image points are in one place"))?;
    Ok(back * normal * from)
}

/// `image_from_plane` and `world_from_plane`.
type Flat = (Matrix3<f64>, Isometry3<f64>);

/// The homography of a plane view with its plane; `None` where the points fill space.
fn homography_of(samples: &[Correspondence]) -> Result<Option<Flat>, CalibrationError> {
    let Some(plane) = plane_of(samples)? else { return Ok(None) };
    let flat = |s: &Correspondence| (plane.inverse_transform_point(&s.point).coords.xy(), s.pixel);
    let pairs: Vec<_> = samples.iter().map(flat).collect();
    Ok(Some((homography(&pairs)?, plane)))
}

/// A lens without distortion from plane views, the principal point at the picture's centre, square
/// or oblong pixels. Each homography [h1 h2 h3] gives two conditions on ω = (K Kᵀ)⁻¹: h1ᵀ ω h2 = 0
/// and h1ᵀ ω h1 = h2ᵀ ω h2 (Zhang 2000).
///
/// # Errors
/// Views that do not determine the focal lengths.
pub fn lens_from_planes(
    id: u32,
    size_px: [u32; 2],
    views: &[&[Correspondence]],
) -> Result<Camera, CalibrationError> {
    let centre = Vector2::new(f64::from(size_px[0]) - 1.0, f64::from(size_px[1]) - 1.0) / 2.0;
    let shift = Matrix3::new(1.0, 0.0, -centre.x, 0.0, 1.0, -centre.y, 0.0, 0.0, 1.0);
    let scale = centre.norm();
    let mut rows = Vec::new();
    for samples in views {
        let Some((h, _)) = homography_of(samples)? else { continue };
        let h = Matrix3::from_diagonal(&Vector3::new(1.0 / scale, 1.0 / scale, 1.0)) * shift * h;
        let h = h / h.norm();
        let (a, b) = (h.column(0), h.column(1));
        // ω = diag(u, v, 1) with u = 1/fx², v = 1/fy².
        rows.push(([a.x * b.x, a.y * b.y], -a.z * b.z));
        rows.push(([a.x * a.x - b.x * b.x, a.y * a.y - b.y * b.y], b.z * b.z - a.z * a.z));
    }
    let focal = solve_focal(&rows).ok_or_else(|| {
        degenerate(
            "every view shows the target from the same direction, or face on: tilt it differently in each",
        )
    })?;
    Ok(pinhole_camera(id, size_px, focal * scale, centre))
}

/// Focal lengths from conditions on (1/fx², 1/fy²): both free, else equal; `None` where neither
/// has a solution that makes sense (0.2 to 60 half diagonals).
fn solve_focal(rows: &[([f64; 2], f64)]) -> Option<Vector2<f64>> {
    let sane = |u: f64| u.is_finite() && (1.0 / 3600.0..25.0).contains(&u);
    let (mut m, mut r) = (nalgebra::Matrix2::zeros(), Vector2::zeros());
    for (a, b) in rows {
        let a = Vector2::from(*a);
        m += a * a.transpose();
        r += a * *b;
    }
    let both = m.try_inverse().map(|inverse| inverse * r);
    if let Some(w) = both
        && sane(w.x)
        && sane(w.y)
        && (0.25..4.0).contains(&(w.x / w.y))
    {
        return Some(w.map(|u| 1.0 / u.sqrt()));
    }
    let (mut up, mut down) = (0.0, 0.0);
    for (a, b) in rows {
        up += (a[0] + a[1]) * b;
        down += (a[0] + a[1]) * (a[0] + a[1]);
    }
    let u = up / down;
    // Conditions that hold by rounding only (all views face on) say nothing.
    (sane(u) && down > 1e-12).then(|| Vector2::repeat(1.0 / u.sqrt()))
}

/// Place of a plane target before a camera, `camera_from_target`; distortion is taken off first.
fn plane_in_camera(
    camera: &Camera,
    samples: &[Correspondence],
) -> Result<Option<Isometry3<f64>>, CalibrationError> {
    let straight: Vec<Correspondence> = samples
        .iter()
        .filter_map(|s| {
            Some(Correspondence { pixel: camera.normalised_from_pixel(s.pixel)?, point: s.point })
        })
        .collect();
    let Some((h, plane)) = homography_of(&straight)? else { return Ok(None) };
    let size = (h.column(0).norm() * h.column(1).norm()).sqrt();
    let sign = if h[(2, 2)] < 0.0 { -1.0 } else { 1.0 };
    let h = h * (sign / size);
    let (x, y, t) = (h.column(0).into_owned(), h.column(1).into_owned(), h.column(2).into_owned());
    let camera_from_plane = isometry(&Matrix3::from_columns(&[x, y, x.cross(&y)]), t)
        .ok_or_else(|| degenerate("a view shows the target edge on"))?;
    Ok(Some(camera_from_plane * plane.inverse()))
}

/// Nearest rotation to a matrix, with a translation.
fn isometry(matrix: &Matrix3<f64>, t: Vector3<f64>) -> Option<Isometry3<f64>> {
    let svd = matrix.svd(true, true);
    let (u, v) = (svd.u?, svd.v_t?);
    let flip = Matrix3::from_diagonal(&Vector3::new(1.0, 1.0, (u * v).determinant().signum()));
    let rotation = Rotation3::from_matrix_unchecked(u * flip * v);
    let rotation = UnitQuaternion::from_rotation_matrix(&rotation);
    t.iter().all(|c| c.is_finite()).then(|| Isometry3::from_parts(Translation3::from(t), rotation))
}

/// Place of a target before a camera whose lens is known, `camera_from_target`.
///
/// # Errors
/// Points that do not determine the place.
pub fn target_in_camera(
    camera: &Camera,
    samples: &[Correspondence],
) -> Result<Isometry3<f64>, CalibrationError> {
    if let Some(place) = plane_in_camera(camera, samples)? {
        return Ok(place);
    }
    let straight: Vec<Correspondence> = samples
        .iter()
        .filter_map(|s| {
            Some(Correspondence { pixel: camera.normalised_from_pixel(s.pixel)?, point: s.point })
        })
        .collect();
    let p = projection_matrix(&straight)?;
    let m = p.fixed_view::<3, 3>(0, 0).into_owned();
    let scale = m.determinant().cbrt();
    isometry(&(m / scale), p.column(3) / scale)
        .ok_or_else(|| degenerate("the dots do not determine the camera's position"))
}

/// Projection matrix of dots in space (6 or more, not in a plane) with right-handed positions.
fn projection_matrix(samples: &[Correspondence]) -> Result<Matrix3x4<f64>, CalibrationError> {
    let p = oriented_projection(samples)?;
    // With the dots before the camera, only mirrored axes turn a picture inside out.
    if p.fixed_view::<3, 3>(0, 0).determinant() < 0.0 {
        return Err(CalibrationError::LeftHanded);
    }
    Ok(p)
}

/// Projection matrix of dots in space (6 or more, not in a plane), with most of them before the camera. Its left part
/// has a negative determinant if their positions are left-handed.
///
/// # Errors
/// Too few dots, or dots that do not determine it.
pub fn oriented_projection(samples: &[Correspondence]) -> Result<Matrix3x4<f64>, CalibrationError> {
    if samples.len() < 6 {
        return Err(degenerate(format!("{} dots; a target in space needs at least 6", samples.len())));
    }
    let to = normaliser(samples.iter().map(|s| s.pixel));
    let n = samples.len() as f64;
    let mean = samples.iter().map(|s| s.point.coords).sum::<Vector3<f64>>() / n;
    let size = samples.iter().map(|s| (s.point.coords - mean).norm()).sum::<f64>() / n;
    let scaled =
        samples.iter().map(|s| (((s.point.coords - mean) / size).push(1.0), (to * s.pixel.push(1.0)).xy()));
    let h = null_vector(transform_equations(scaled))?;
    let mut from = nalgebra::Matrix4::identity() / size;
    from.fixed_view_mut::<3, 1>(0, 3).copy_from(&(-mean / size));
    from[(3, 3)] = 1.0;
    let back = to.try_inverse().ok_or_else(|| degenerate("all image points are in one place"))?;
    let p = back * Matrix3x4::from_row_slice(h.as_slice()) * from;
    let front = samples.iter().filter(|s| p.row(2).dot(&s.point.coords.push(1.0).transpose()) > 0.0).count();
    Ok(if 2 * front < samples.len() { -p } else { p })
}

/// A camera without distortion, its place included, from dots in space.
///
/// # Errors
/// Too few dots, or dots that do not determine the camera.
pub fn camera_from_dots(
    id: u32,
    size_px: [u32; 2],
    samples: &[Correspondence],
) -> Result<Camera, CalibrationError> {
    let p = projection_matrix(samples)?;
    let m = p.fixed_view::<3, 3>(0, 0).into_owned();
    let scale = m.row(2).norm() * m.determinant().signum();
    let (m, t) = (m / scale, p.column(3) / scale);
    // M = K·R with K upper triangular: K from M·Mᵀ, whose last row is that of K's (cx, cy, 1).
    let w = m * m.transpose();
    let centre = Vector2::new(w[(0, 2)], w[(1, 2)]);
    let fy = (w[(1, 1)] - centre.y * centre.y).max(0.0).sqrt();
    let skew = (w[(0, 1)] - centre.x * centre.y) / fy;
    let fx = (w[(0, 0)] - centre.x * centre.x - skew * skew).max(0.0).sqrt();
    if !(fx.is_finite() && fy.is_finite() && fx > 0.0 && fy > 0.0) {
        return Err(degenerate("the dots do not determine the focal length"));
    }
    let k = Matrix3::new(fx, skew, centre.x, 0.0, fy, centre.y, 0.0, 0.0, 1.0);
    let inverse = k.try_inverse().ok_or_else(|| degenerate("the dots do not determine the focal length"))?;
    let place = isometry(&(inverse * m), inverse * t)
        .ok_or_else(|| degenerate("the dots do not determine the camera's pose"))?;
    let mut camera = pinhole_camera(id, size_px, Vector2::new(fx, fy), centre);
    set_camera_pose(&mut camera, &place);
    Ok(camera)
}

/// The point that comes nearest to the rays of some sights, by their least squared distance.
/// `None` where the rays are parallel.
pub fn triangulate_rays(rays: &[(Point3<f64>, Vector3<f64>)]) -> Option<Point3<f64>> {
    let (mut m, mut r) = (Matrix3::zeros(), Vector3::zeros());
    for (origin, direction) in rays {
        let across = Matrix3::identity() - direction * direction.transpose();
        m += across;
        r += across * origin.coords;
    }
    let eigen = m.symmetric_eigenvalues();
    if eigen.min() < 1e-9 * eigen.max() {
        return None;
    }
    Some(Point3::from(m.cholesky()?.solve(&r)))
}
