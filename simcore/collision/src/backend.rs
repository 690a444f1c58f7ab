//! Back end of collision detection: the processor or a graphics adapter. Both give bit-identical results
//! ([`super::gpu`]), so the choice affects only speed, which is measured at start-up on the scene's own
//! mesh.

use super::instrument_image::InstrumentImage;
use super::surface::Surface;
use super::zcoll::Zcoll;
use nalgebra::{Isometry3, Point3, UnitQuaternion, Vector3};
use std::fmt;

/// What the user wants.
#[derive(Debug, Clone, Copy, Default, PartialEq, Eq)]
pub enum Backend {
    /// Whichever is faster for the scene's mesh, measured at start-up.
    #[default]
    Auto,
    /// The processor.
    Cpu,
    /// A graphics adapter, or the processor where there is none.
    Gpu,
}

impl Backend {
    /// The names of the wishes, as an argument gives them.
    pub const NAMES: [&str; 3] = ["auto", "cpu", "gpu"];

    /// The wish of a name of [`Self::NAMES`].
    pub fn named(name: &str) -> Option<Self> {
        let all = [Backend::Auto, Backend::Cpu, Backend::Gpu];
        Self::NAMES.iter().zip(all).find(|(known, _)| **known == name).map(|(_, backend)| backend)
    }
}

/// What was chosen, and why; one line of the log.
#[derive(Debug, Clone, PartialEq)]
pub struct BackendChoice {
    /// An adapter looks.
    pub on_gpu: bool,
    /// Median look of the processor, µs; absent where it was not asked.
    pub cpu_us: Option<f64>,
    /// Median look of the adapter, µs; absent where it was not asked or cannot.
    pub gpu_us: Option<f64>,
    /// The adapter, or why there is none.
    pub reason: String,
    /// What the choosing took, ms.
    pub took_ms: f64,
}

impl fmt::Display for BackendChoice {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        let us = |t: Option<f64>| t.map_or("not measured".to_owned(), |t| format!("{t:.1} µs a query"));
        let winner = if self.on_gpu { "gpu" } else { "cpu" };
        let BackendChoice { cpu_us, gpu_us, reason, took_ms, .. } = self;
        write!(
            f,
            "collision on the {winner}: cpu {}, gpu {} ({reason}); chosen in {took_ms:.0} ms",
            us(*cpu_us),
            us(*gpu_us)
        )
    }
}

/// Looks that are measured, after one that is not.
const QUERIES: usize = 11;
/// Below this the processor is faster than any adapter's empty round trip, and none is opened for
/// the question, ns. The shortest trip seen, on the software driver, which has no bus to cross,
/// took 28 µs.
const ROUND_TRIP_NS: u64 = 15_000;
/// No measurement goes on for longer, ns.
const PATIENCE_NS: u64 = 200_000_000;

/// A pose, eye frame to instrument frame, in which the instrument pushes the middle of the mesh 0.1
/// mm away from the eye's centre. `None` if no living triangle has a place.
pub fn pressing_pose(surface: &Surface) -> Option<Isometry3<f64>> {
    let living = surface.triangles.iter().zip(surface.alive).filter(|(_, alive)| **alive != 0);
    let at = |n: u32| Point3::from(surface.position_mm.map(|axis| f64::from(axis[n as usize])));
    let places: Vec<Point3<f64>> =
        living.map(|(t, _)| at(t[0])).filter(|p| p.coords.iter().all(|c| c.is_finite())).collect();
    let sum = places.iter().fold(Vector3::zeros(), |sum, p| sum + p.coords);
    let middle = sum / places.len().max(1) as f64;
    let distance = |p: &Point3<f64>| (p.coords - middle).norm_squared();
    let place = places.iter().min_by(|a, b| distance(a).total_cmp(&distance(b)))?;
    let to_handle = (-place.coords).try_normalize(1e-6).unwrap_or_else(Vector3::z);
    let half_turn = || UnitQuaternion::from_axis_angle(&Vector3::x_axis(), std::f64::consts::PI);
    let turn = UnitQuaternion::rotation_between(&Vector3::z(), &to_handle).unwrap_or_else(half_turn);
    let tip = place - 0.1 * to_handle;
    Some(Isometry3::from_parts(tip.into(), turn).inverse())
}

/// Median of some looks as they are now set up, ns.
fn median_query_ns(
    zcoll: &mut Zcoll,
    image: &InstrumentImage,
    pose: &Isometry3<f64>,
    surface: &Surface,
    clock: &mut dyn FnMut() -> u64,
) -> u64 {
    let begun = clock();
    zcoll.query(image, pose, surface);
    let mut times = Vec::with_capacity(QUERIES);
    while times.len() < QUERIES && (times.is_empty() || clock().saturating_sub(begun) < PATIENCE_NS) {
        let from = clock();
        zcoll.query(image, pose, surface);
        times.push(clock().saturating_sub(from));
    }
    times.sort_unstable();
    times[times.len() / 2]
}

/// Sets `zcoll` up for the faster back end, or the wanted one. `image` is an instrument of the
/// scene, prepared; `clock` gives nanoseconds and is used for nothing else.
pub fn choose_backend(
    zcoll: &mut Zcoll,
    wanted: Backend,
    image: &InstrumentImage,
    surface: &Surface,
    clock: &mut dyn FnMut() -> u64,
) -> BackendChoice {
    let begun = clock();
    let us = |ns: u64| ns as f64 * 1e-3;
    let mut choice = BackendChoice {
        on_gpu: false,
        cpu_us: None,
        gpu_us: None,
        reason: "as requested".into(),
        took_ms: 0.0,
    };
    let pose = pressing_pose(surface).filter(|_| wanted != Backend::Cpu);
    if let Some(pose) = pose {
        let cpu_ns = median_query_ns(zcoll, image, &pose, surface, clock);
        choice.cpu_us = Some(us(cpu_ns));
        if wanted == Backend::Auto && cpu_ns < ROUND_TRIP_NS {
            choice.reason = "no adapter is faster".into();
        } else {
            match open(zcoll, surface) {
                Ok(name) => {
                    let gpu_ns = median_query_ns(zcoll, image, &pose, surface, clock);
                    (choice.reason, choice.gpu_us) = (name, zcoll.is_on_gpu().then(|| us(gpu_ns)));
                    if wanted == Backend::Auto && gpu_ns >= cpu_ns {
                        close(zcoll);
                    }
                }
                Err(why) => choice.reason = why,
            }
        }
    }
    choice.on_gpu = zcoll.is_on_gpu();
    choice.took_ms = us(clock().saturating_sub(begun)) * 1e-3;
    choice
}

/// Gives `zcoll` an adapter; its name, or why there is none.
#[cfg(feature = "gpu")]
fn open(zcoll: &mut Zcoll, surface: &Surface) -> Result<String, String> {
    use super::gpu::{GpuDevice, GpuZcoll};
    let device = GpuDevice::open().map_err(|e| e.to_string())?;
    let name = device.name().to_owned();
    let nodes = surface.position_mm[0].len();
    let gpu = GpuZcoll::new(device, *zcoll.volume(), surface.triangles, nodes).map_err(|e| e.to_string())?;
    zcoll.set_gpu(Some(gpu));
    Ok(name)
}

#[cfg(not(feature = "gpu"))]
fn open(_: &mut Zcoll, _: &Surface) -> Result<String, String> {
    Err("this program was built without the feature gpu".into())
}

#[cfg(feature = "gpu")]
fn close(zcoll: &mut Zcoll) {
    zcoll.set_gpu(None);
}

#[cfg(not(feature = "gpu"))]
fn close(_: &mut Zcoll) {}

#[cfg(test)]
mod tests {
    use super::*;
    use scene::SceneFile;

    #[test]
    fn the_measured_pose_collides() {
        let scene = SceneFile::load("peel").unwrap();
        let mesh = crate::test_mesh::TestMesh::cap();
        let surface = mesh.surface();
        let volume = crate::instrument_image::Volume::new(&scene.contact);
        let mut image = InstrumentImage::new(scene.instruments[0].tool, 0.25, &volume);
        image.prepare(0.0, &volume);
        let mut zcoll = Zcoll::new(volume, surface.triangles, mesh.nodes()).unwrap();
        assert!(zcoll.query(&image, &pressing_pose(&surface).unwrap(), &surface).pixels > 5);
        let dead = vec![0; surface.alive.len()];
        assert_eq!(pressing_pose(&Surface { alive: &dead, ..surface }), None);
    }
}
