//! What each cause does to blobs: a camera that was turned or moved, another focal length, a clock that is
//! off, a marker that was moved. Each is fitted to the matched blobs robustly, and judged by what it leaves
//! unexplained.

use super::blobs::{BlobPair, MarkerId};
use nalgebra::{DMatrix, DVector, Rotation3, Vector2, Vector3};
use rig::camera::Camera;

/// Residual of half weight in a fit, px.
const SCALE_PX: f64 = 0.3;
/// Residuals count as this at most, px: a blob that is partly hidden in one of the recordings.
const CAP_PX: f64 = 1.0;
/// Iterations of a fit.
const ITERATIONS: usize = 12;
/// Step of the numeric derivatives, in units of the parameters.
const STEP: f64 = 1e-4;

/// A cause whose size is to be found.
#[derive(Debug, Clone, Copy, PartialEq)]
pub enum Model {
    /// A camera was turned: rotation vector in its frame, degrees.
    Turned(u32),
    /// A camera was turned and shifted: the same, and shift in its frame, mm.
    Moved(u32),
    /// Another focal length of a camera, or of all: relative change, per cent.
    Focal(Option<u32>),
    /// The clock of a camera is off: its exposures are later, ms.
    Clock(u32),
    /// A marker was moved: shift in the frame of its body, mm.
    Marker(MarkerId),
}

impl Model {
    /// How many parameters it has.
    pub fn parameters(self) -> usize {
        match self {
            Model::Turned(_) | Model::Marker(_) => 3,
            Model::Moved(_) => 6,
            Model::Focal(_) | Model::Clock(_) => 1,
        }
    }

    /// Whether it moves a blob at all.
    fn concerns(self, pair: &BlobPair) -> bool {
        match self {
            Model::Turned(camera) | Model::Moved(camera) | Model::Clock(camera) => camera == pair.camera,
            Model::Focal(camera) => camera.is_none_or(|camera| camera == pair.camera),
            Model::Marker(marker) => pair.marker == Some(marker),
        }
    }

    /// How far it moves a blob, px.
    fn moved_px(self, camera: &Camera, pair: &BlobPair, p: &[f64]) -> Vector2<f64> {
        match self {
            Model::Turned(_) => moved_by_camera(camera, pair, &[p[0], p[1], p[2], 0.0, 0.0, 0.0]),
            Model::Moved(_) => moved_by_camera(camera, pair, p),
            Model::Focal(_) => (pair.a_px - camera.centre_px) * (p[0] * 0.01),
            Model::Clock(_) => pair.moved_after(p[0] * 1e-3),
            Model::Marker(_) => {
                let by = pair.world_from_body * Vector3::new(p[0], p[1], p[2]);
                between(camera.project(&pair.p_in_world), camera.project(&(pair.p_in_world + by)))
            }
        }
    }
}

/// Moves the camera, not the marker.
fn moved_by_camera(camera: &Camera, pair: &BlobPair, p: &[f64]) -> Vector2<f64> {
    let seen = camera.in_camera(&pair.p_in_world);
    let turn = Rotation3::new(Vector3::new(p[0], p[1], p[2]) * 1f64.to_radians());
    let moved = turn * seen + Vector3::new(p[3], p[4], p[5]);
    let pixel = |q: &Vector3<f64>| {
        (q.z > 1e-6).then(|| camera.pixel_from_normalised(Vector2::new(q.x / q.z, q.y / q.z)))
    };
    between(pixel(&seen), pixel(&moved))
}

fn between(from: Option<Vector2<f64>>, to: Option<Vector2<f64>>) -> Vector2<f64> {
    from.zip(to).map_or(Vector2::zeros(), |(from, to)| to - from)
}

/// A model with the size that fits best.
#[derive(Debug, Clone)]
pub struct Fit {
    /// The model.
    pub model: Model,
    /// Its parameters.
    pub parameters: Vec<f64>,
    /// What it leaves: sum of the squares of all residuals, px², each capped.
    pub left_px2: f64,
}

/// Blobs to be explained, and the cameras that saw them.
pub struct Observed<'a> {
    /// The cameras of the first recording's rig.
    pub cameras: &'a [Camera],
    /// Matched blobs.
    pub pairs: &'a [BlobPair],
}

impl Observed<'_> {
    fn camera(&self, id: u32) -> Option<&Camera> {
        self.cameras.iter().find(|camera| camera.id == id)
    }

    /// Sum of the squares of what no model explains, px², each capped.
    pub fn unexplained_px2(&self) -> f64 {
        self.pairs.iter().map(|pair| capped(&pair.moved_px)).sum()
    }

    /// Fits a model; none where too few blobs are concerned, or they do not determine it.
    pub fn fit(&self, model: Model) -> Option<Fit> {
        let concerned: Vec<(&Camera, &BlobPair)> = self
            .pairs
            .iter()
            .filter(|pair| model.concerns(pair))
            .filter_map(|pair| Some((self.camera(pair.camera)?, pair)))
            .collect();
        if concerned.len() < 20 {
            return None;
        }
        let mut parameters = vec![0.0; model.parameters()];
        for _ in 0..ITERATIONS {
            let step = gauss_newton(model, &concerned, &parameters)?;
            parameters.iter_mut().zip(step.iter()).for_each(|(p, s)| *p += s);
            if step.amax() < 1e-7 {
                break;
            }
        }
        let before: f64 = concerned.iter().map(|(_, pair)| capped(&pair.moved_px)).sum();
        let after: f64 = concerned
            .iter()
            .map(|(camera, pair)| capped(&(pair.moved_px - model.moved_px(camera, pair, &parameters))))
            .sum();
        Some(Fit { model, parameters, left_px2: self.unexplained_px2() - before + after })
    }

    /// The blobs less what a fit explains of them.
    pub fn less(&self, fit: &Fit) -> Vec<BlobPair> {
        let mut left = self.pairs.to_vec();
        for pair in left.iter_mut().filter(|pair| fit.model.concerns(pair)) {
            if let Some(camera) = self.camera(pair.camera) {
                pair.moved_px -= fit.model.moved_px(camera, pair, &fit.parameters);
            }
        }
        left
    }
}

fn capped(residual: &Vector2<f64>) -> f64 {
    residual.norm_squared().min(CAP_PX * CAP_PX)
}

/// One step of the weighted Gauss–Newton iteration; weights of Geman and McClure, whose scale begins wide.
fn gauss_newton(model: Model, concerned: &[(&Camera, &BlobPair)], at: &[f64]) -> Option<DVector<f64>> {
    let count = at.len();
    let residuals: Vec<Vector2<f64>> =
        concerned.iter().map(|(camera, pair)| pair.moved_px - model.moved_px(camera, pair, at)).collect();
    let mut norms: Vec<f64> = residuals.iter().map(Vector2::norm).collect();
    norms.sort_unstable_by(f64::total_cmp);
    let scale = (2.0 * norms[norms.len() / 2]).max(SCALE_PX);
    let (mut normal, mut right) = (DMatrix::zeros(count, count), DVector::zeros(count));
    for ((camera, pair), residual) in concerned.iter().zip(&residuals) {
        let share = residual.norm_squared() / (scale * scale);
        let weight = 1.0 / ((1.0 + share) * (1.0 + share));
        let base = model.moved_px(camera, pair, at);
        let mut slopes = DMatrix::zeros(2, count);
        for column in 0..count {
            let mut moved = at.to_vec();
            moved[column] += STEP;
            slopes.set_column(column, &((model.moved_px(camera, pair, &moved) - base) / STEP));
        }
        normal += slopes.transpose() * &slopes * weight;
        right += slopes.transpose() * residual * weight;
    }
    // A direction that the blobs do not determine stays where it is.
    let damping = 1e-9 * normal.diagonal().amax();
    (0..count).for_each(|i| normal[(i, i)] += damping.max(1e-12));
    Some(normal.cholesky()?.solve(&right))
}
