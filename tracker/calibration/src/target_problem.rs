//! Calibration on a target: any number of cameras that see a target of known points in any number
//! of views, with any choice of free parameters.
//!
//! One camera and a moved board: the lens. Several cameras and a board: lenses and extrinsics.
//! Several cameras and fixed dots: extrinsics in the frame of the dots.

use crate::lens::{
    EXTRINSICS, LENS, LENS_NAMES, by_extrinsics, by_pose, lens_of, move_extrinsics, move_pose, project,
    set_lens,
};
use crate::lens_doubt::over_picture_px;
use crate::linear;
use crate::solve::{Column, Loss, MAX_STEPS, NormalEquations, Problem, Solution, Unknown, solve};
use crate::weak_terms::with_known_terms;
use crate::{CalibrationError, median};
use nalgebra::{
    DVector, Isometry3, Matrix3, Point3, SMatrix, Translation3, UnitQuaternion, Vector2, Vector3,
};
use rig::camera::Camera;

/// A point of the target and its image point.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct Correspondence {
    /// Image point, px.
    pub pixel: Vector2<f64>,
    /// Point of the target, in the target's unit (mm).
    pub point: Point3<f64>,
}

/// The target as one camera saw it in one view.
#[derive(Debug, Clone, PartialEq)]
pub struct TargetView {
    /// Name for the report: the picture's file.
    pub name: String,
    /// Index of the camera.
    pub camera: usize,
    /// Index of the view; in one view the target has one pose.
    pub view: usize,
    /// The points.
    pub samples: Vec<Correspondence>,
}

/// Free parameters of a camera.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub struct FreeParameters {
    /// Values of the lens, in the order of [`LENS_NAMES`].
    pub lens: [bool; LENS],
    /// Rotation and translation.
    pub place: bool,
}

impl FreeParameters {
    /// Every value of the lens.
    pub const LENS: FreeParameters = FreeParameters { lens: [true; LENS], place: false };
}

/// Most steps of a camera that sees known dots. It needs 5 to 30; only those of lists that show no camera need more, and
/// every start of every set of terms would.
const STEPS_ON_DOTS: usize = 200;

/// Cameras and poses of the target.
#[derive(Debug, Clone, PartialEq)]
pub struct Scene {
    /// Cameras.
    pub cameras: Vec<Camera>,
    /// `world_from_target` of each view.
    pub views: Vec<Isometry3<f64>>,
}

/// The least-squares problem.
#[derive(Debug, Clone)]
pub struct TargetProblem<'a> {
    /// The views.
    pub sheets: &'a [TargetView],
    /// Free parameters, by camera.
    pub free: Vec<FreeParameters>,
    /// True if the target's pose is known in every view.
    pub fixed_views: bool,
    /// Number of views.
    pub views: usize,
    /// Standard deviation by which residuals are whitened, px.
    pub sigma_px: f64,
    /// Loss of the whitened residuals.
    pub loss: Loss,
}

impl<'a> TargetProblem<'a> {
    /// Least squares over `views` views.
    pub fn new(sheets: &'a [TargetView], free: Vec<FreeParameters>, fixed_views: bool, views: usize) -> Self {
        TargetProblem { sheets, free, fixed_views, views, sigma_px: 1.0, loss: Loss::Square }
    }
}

/// A shared unknown: camera, and which of its values (lens, then place).
fn shared_unknowns(free: &[FreeParameters]) -> Vec<(usize, usize)> {
    let of_camera = |(c, free): (usize, &FreeParameters)| {
        let lens = (0..LENS).filter(|&i| free.lens[i]).collect::<Vec<_>>();
        let place = if free.place { LENS..LENS + EXTRINSICS } else { 0..0 };
        lens.into_iter().chain(place).map(move |i| (c, i)).collect::<Vec<_>>()
    };
    free.iter().enumerate().flat_map(of_camera).collect()
}

/// Names of a camera's place.
const EXTRINSIC_NAMES: [&str; EXTRINSICS] = ["rotation x", "rotation y", "rotation z", "t x", "t y", "t z"];

impl Problem for TargetProblem<'_> {
    type State = Scene;

    fn most_steps(&self) -> usize {
        if self.fixed_views { STEPS_ON_DOTS } else { MAX_STEPS }
    }

    fn shared(&self) -> usize {
        shared_unknowns(&self.free).len()
    }

    fn name(&self, shared: usize) -> String {
        let (camera, value) = shared_unknowns(&self.free)[shared];
        let name = if value < LENS { LENS_NAMES[value] } else { EXTRINSIC_NAMES[value - LENS] };
        format!("{name} of camera {camera}")
    }

    fn blocks(&self) -> usize {
        self.views
    }

    fn own(&self, block: usize) -> usize {
        let seen = self.sheets.iter().any(|s| s.view == block);
        if self.fixed_views || !seen { 0 } else { EXTRINSICS }
    }

    fn equations(&self, state: &Scene, block: usize, out: &mut NormalEquations) {
        let unknowns = shared_unknowns(&self.free);
        let view = &state.views[block];
        let mut columns: Vec<Column<2>> = Vec::with_capacity(LENS + 2 * EXTRINSICS);
        for sheet in self.sheets.iter().filter(|s| s.view == block) {
            let camera = &state.cameras[sheet.camera];
            for sample in &sheet.samples {
                let world = view * sample.point;
                let p = camera.in_camera(&world);
                let Some(image) = project(camera, &p) else { return out.refuse() };
                let places = image.by_point * by_extrinsics(camera, &p);
                columns.clear();
                let mine = unknowns.iter().enumerate().filter(|(_, u)| u.0 == sheet.camera);
                for (at, &(_, value)) in mine {
                    let column: Vector2<f64> = if value < LENS {
                        image.by_lens.column(value).into()
                    } else {
                        places.column(value - LENS).into()
                    };
                    columns.push((Unknown::Shared(at), column / self.sigma_px));
                }
                if !self.fixed_views {
                    let by_world = image.by_point * camera.camera_from_world;
                    let by_pose = by_pose(&by_world, &(world.coords - view.translation.vector));
                    let slopes = by_pose.column_iter().enumerate();
                    columns.extend(slopes.map(|(i, slope)| (Unknown::Own(i), slope / self.sigma_px)));
                }
                out.add(&((image.pixel - sample.pixel) / self.sigma_px), &columns, self.loss);
            }
        }
    }

    fn moved(&self, state: &Scene, shared: &DVector<f64>, own: &[DVector<f64>]) -> Scene {
        let mut next = state.clone();
        let unknowns = shared_unknowns(&self.free);
        for (c, camera) in next.cameras.iter_mut().enumerate() {
            let (mut lens, mut place) = (lens_of(camera), SMatrix::<f64, EXTRINSICS, 1>::zeros());
            for (&(_, value), step) in unknowns.iter().zip(shared.iter()).filter(|(u, _)| u.0 == c) {
                if value < LENS { lens[value] += step } else { place[value - LENS] = *step }
            }
            set_lens(camera, &lens);
            move_extrinsics(camera, &place);
        }
        if !self.fixed_views {
            for (view, step) in next.views.iter_mut().zip(own).filter(|(_, step)| !step.is_empty()) {
                move_pose(view, step.as_slice());
            }
        }
        next
    }
}

/// Residual of one point: observed less computed.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct Residual {
    /// Index of the camera.
    pub camera: usize,
    /// Index of the sheet (or of the instant, for a waved instrument).
    pub sheet: usize,
    /// Observed image point, px.
    pub pixel: Vector2<f64>,
    /// Observed less computed, px.
    pub error: Vector2<f64>,
}

/// Root mean square length of residuals, px; 0 of none.
pub fn rms(residuals: impl Iterator<Item = Residual>) -> f64 {
    let (sum, n) = residuals.fold((0.0, 0), |(s, n), r| (s + r.error.norm_squared(), n + 1));
    (sum / f64::from(n.max(1))).sqrt()
}

/// Residuals of every sample.
pub fn residuals(scene: &Scene, sheets: &[TargetView]) -> Vec<Residual> {
    let of_sheet = |(s, sheet): (usize, &TargetView)| {
        let camera = &scene.cameras[sheet.camera];
        let residual = |sample: &Correspondence| {
            let error = sample.pixel - camera.project(&(scene.views[sheet.view] * sample.point))?;
            Some(Residual { camera: sheet.camera, sheet: s, pixel: sample.pixel, error })
        };
        sheet.samples.iter().filter_map(residual).collect::<Vec<_>>()
    };
    sheets.iter().enumerate().flat_map(of_sheet).collect()
}

/// A calibrated scene.
#[derive(Debug, Clone)]
pub struct Calibrated {
    /// Cameras and places of the target.
    pub scene: Scene,
    /// Residuals of every sample.
    pub residuals: Vec<Residual>,
    /// Standard deviations of the nine values of each camera's lens (0: not free) and of its place.
    pub sigmas: Vec<[f64; LENS + EXTRINSICS]>,
    /// By camera: standard deviation of its image points over the whole picture by what is not known of its lens, px
    /// ([`crate::lens_doubt`]); 0 of a lens that is given.
    pub doubt_px: Vec<f64>,
    /// Standard deviation of one coordinate, px, if each camera is fitted without the others to the views that others saw
    /// too; 0 of one camera, and if none was fitted so.
    pub alone_px: f64,
    /// Root mean square length of the residuals, px.
    pub rms_px: f64,
    /// Standard deviation of one coordinate, from the residuals of the inliers, px.
    pub sigma_px: f64,
    /// Iterations of the last solve.
    pub iterations: usize,
    /// Values of lenses that were to be found but are held at zero, since the data do not determine
    /// them: camera, and index into [`LENS_NAMES`].
    pub left_out: Vec<(usize, usize)>,
    /// What else a person should know.
    pub remarks: Vec<String>,
}

/// Values of the lens that are held at zero, in this order, where the data do not determine them: the highest power
/// first, which a part of the picture determines least.
pub(crate) const DISPENSABLE: [usize; 5] = [8, 5, 7, 6, 4];

/// Solves with the values of the lens in `free`, and with fewer as long as the data do not determine them; returns those
/// that are held at zero.
///
/// # Errors
/// The last problem, where holding terms does not help.
pub fn with_weak_terms_held<T>(
    mut free: [bool; LENS],
    mut solved: impl FnMut([bool; LENS]) -> Result<T, CalibrationError>,
) -> Result<(T, Vec<usize>), CalibrationError> {
    let mut held = Vec::new();
    loop {
        let weak = match solved(free) {
            Ok(found) => return Ok((found, held)),
            Err(weak) => weak,
        };
        let open = weak.is_undetermined();
        let Some(term) = DISPENSABLE.into_iter().find(|&term| open && free[term]) else { return Err(weak) };
        free[term] = false;
        held.push(term);
    }
}

/// How to weigh residuals.
#[derive(Debug, Clone, Copy, PartialEq, Eq, clap::ValueEnum)]
pub enum Robustness {
    /// Least squares: every point has full weight.
    Square,
    /// Huber: beyond 3 standard deviations the influence of a point stays constant.
    Huber,
    /// Cauchy: beyond 3 standard deviations the influence of a point decreases.
    Cauchy,
}

/// Standard deviations beyond which a residual is suspect.
const SUSPECT: f64 = 3.0;

impl Robustness {
    fn loss(self) -> Loss {
        match self {
            Robustness::Square => Loss::Square,
            Robustness::Huber => Loss::Huber(SUSPECT),
            Robustness::Cauchy => Loss::Cauchy(SUSPECT),
        }
    }
}

/// Standard deviation of one coordinate from the median length of residuals, which a few outliers
/// do not move: the length of a normal 2-vector has the median σ·√(2 ln 2).
pub fn robust_sigma(residuals: &[Residual]) -> f64 {
    let median = median(residuals.iter().map(|r| r.error.norm())).unwrap_or(0.0);
    // Exact data would otherwise divide by zero; no camera measures to 1e-6 px.
    (median / (2.0 * std::f64::consts::LN_2).sqrt()).max(1e-6)
}

/// Solves by least squares, then again with the loss on residuals whitened by their own spread.
///
/// # Errors
/// A problem without a solution.
pub fn calibrate(
    mut problem: TargetProblem<'_>,
    start: Scene,
    robustness: Robustness,
    progress: &mut dyn FnMut(usize, f64),
) -> Result<Calibrated, CalibrationError> {
    let mut solution = solve(&problem, start, progress)?;
    if robustness != Robustness::Square {
        // Twice: outliers widen the spread of the first.
        for _ in 0..2 {
            problem.sigma_px = robust_sigma(&residuals(&solution.state, problem.sheets));
            problem.loss = robustness.loss();
            solution = solve(&problem, solution.state, progress)?;
        }
    }
    Ok(summary(&problem, solution))
}

fn summary(problem: &TargetProblem<'_>, solution: Solution<Scene>) -> Calibrated {
    // χ² per degree of freedom is how much larger the noise is than assumed.
    let noise = (solution.cost / solution.freedom.max(1) as f64).sqrt();
    let mut sigmas = vec![[0.0; LENS + EXTRINSICS]; solution.state.cameras.len()];
    for (at, (camera, value)) in shared_unknowns(&problem.free).into_iter().enumerate() {
        sigmas[camera][value] = noise * solution.sigma(at);
    }
    let residuals = residuals(&solution.state, problem.sheets);
    let doubt = |(c, camera)| over_picture_px(camera, &lens_covariance(problem, &solution, c, noise));
    Calibrated {
        doubt_px: solution.state.cameras.iter().enumerate().map(doubt).collect(),
        alone_px: 0.0,
        rms_px: rms(residuals.iter().copied()),
        sigma_px: noise * problem.sigma_px,
        sigmas,
        residuals,
        iterations: solution.iterations,
        scene: solution.state,
        left_out: Vec::new(),
        remarks: Vec::new(),
    }
}

/// Covariance of the values of a camera's lens; 0 for those that are held.
fn lens_covariance(
    problem: &TargetProblem<'_>,
    solution: &Solution<Scene>,
    camera: usize,
    noise: f64,
) -> SMatrix<f64, LENS, LENS> {
    let unknowns = shared_unknowns(&problem.free);
    let own: Vec<(usize, usize)> = unknowns
        .iter()
        .enumerate()
        .filter(|(_, u)| u.0 == camera && u.1 < LENS)
        .map(|(at, u)| (at, u.1))
        .collect();
    let mut covariance = SMatrix::zeros();
    for (&(a, i), &(b, j)) in own.iter().flat_map(|a| own.iter().map(move |b| (a, b))) {
        covariance[(i, j)] = noise * noise * solution.covariance[(a, b)];
    }
    covariance
}

/// Standard deviation of a focal length, as a share of it, from which views do not fix it.
const UNSURE: f64 = 0.05;
/// Fewest views of a board from which a lens is calibrated; two would fix it on paper only.
pub const FEWEST_VIEWS: usize = 3;

/// Checks that a camera has views enough for its lens.
///
/// # Errors
/// Fewer than [`FEWEST_VIEWS`] of targets that are all flat, or points on a line.
pub fn check_views<'a>(own: impl Iterator<Item = &'a TargetView>) -> Result<(), CalibrationError> {
    let flat = own.map(|s| Ok(linear::plane_of(&s.samples)?.is_some()));
    let flat = flat.collect::<Result<Vec<bool>, CalibrationError>>()?;
    let enough = flat.len() >= FEWEST_VIEWS || flat.contains(&false);
    if enough { Ok(()) } else { Err(CalibrationError::TooFewViews(flat.len())) }
}

/// Calibrates one lens from views of a target: the parameters in `free`. Terms of its distortion that the views do not
/// determine are held at zero and listed in [`Calibrated::left_out`].
///
/// # Errors
/// Too few or degenerate views, or a problem without a solution.
pub fn calibrate_lens(
    id: u32,
    size_px: [u32; 2],
    sheets: &[TargetView],
    free: FreeParameters,
    robustness: Robustness,
    progress: &mut dyn FnMut(usize, f64),
) -> Result<Calibrated, CalibrationError> {
    check_views(sheets.iter())?;
    let found = lens_of_views(id, size_px, sheets, free, robustness, progress)?;
    // Views that fix no focal length still let a lens of few terms converge somewhere.
    let focal = found.scene.cameras[0].focal_px;
    let unsure = |axis: usize| free.lens[axis] && found.sigmas[0][axis] > UNSURE * focal[axis].abs();
    if !found.left_out.is_empty() && (unsure(0) || unsure(1)) {
        return Err(crate::degenerate(
            "the views do not determine the focal length: they are too alike; tilt the target differently in each",
        ));
    }
    Ok(found)
}

/// As [`calibrate_lens`], also from two views of a board, as they are left when a third one is held out.
///
/// # Errors
/// Degenerate views, or a problem without a solution.
pub fn lens_of_views(
    id: u32,
    size_px: [u32; 2],
    sheets: &[TargetView],
    free: FreeParameters,
    robustness: Robustness,
    progress: &mut dyn FnMut(usize, f64),
) -> Result<Calibrated, CalibrationError> {
    let start = start_of_views(id, size_px, sheets)?;
    let sheets: Vec<TargetView> =
        sheets.iter().enumerate().map(|(view, s)| TargetView { camera: 0, view, ..s.clone() }).collect();
    let (found, held) = with_known_terms(free.lens, |lens| {
        let problem = TargetProblem::new(&sheets, vec![FreeParameters { lens, ..free }], false, sheets.len());
        calibrate(problem, start.clone(), robustness, progress)
    })?;
    Ok(Calibrated { left_out: held.into_iter().map(|term| (0, term)).collect(), ..found })
}

/// A camera without distortion at the origin and the places of the target before it, to begin with.
///
/// # Errors
/// Degenerate views.
pub fn start_of_views(id: u32, size_px: [u32; 2], sheets: &[TargetView]) -> Result<Scene, CalibrationError> {
    let all: Vec<&[Correspondence]> = sheets.iter().map(|s| s.samples.as_slice()).collect();
    let plane = all.iter().map(|s| linear::plane_of(s)).collect::<Result<Vec<_>, _>>()?;
    let mut camera = match plane.iter().position(Option::is_none) {
        Some(in_space) => linear::camera_from_dots(id, size_px, all[in_space])?,
        None => linear::lens_from_planes(id, size_px, &all)?,
    };
    (camera.camera_from_world, camera.translation_mm) = (Matrix3::identity(), Vector3::zeros());
    let views = all.iter().map(|s| linear::target_in_camera(&camera, s)).collect::<Result<Vec<_>, _>>()?;
    Ok(Scene { cameras: vec![camera], views })
}

/// `camera_from_world` as an isometry.
pub fn camera_pose(camera: &Camera) -> Isometry3<f64> {
    let rotation = nalgebra::Rotation3::from_matrix_unchecked(camera.camera_from_world);
    Isometry3::from_parts(
        Translation3::from(camera.translation_mm),
        UnitQuaternion::from_rotation_matrix(&rotation),
    )
}

/// Sets the pose of a camera.
pub fn set_camera_pose(camera: &mut Camera, camera_from_world: &Isometry3<f64>) {
    camera.camera_from_world = camera_from_world.rotation.to_rotation_matrix().into_inner();
    camera.translation_mm = camera_from_world.translation.vector;
}
