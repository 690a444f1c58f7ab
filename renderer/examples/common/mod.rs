//! A scene made from the shipped scene file, as the simulation would send it: for the example and
//! the picture test.

use bytemuck::Zeroable;
use glam::{DMat3, DQuat, DVec3};
use protocol::geometry::Pose;
use protocol::rig::Rig;
use protocol::scene::{NODE_BOUND, NODE_FREE, SceneHeader, SceneNode, SceneTriangle, SectionWriter};
use protocol::scene_file::SceneFile;
use renderer::start::microscope;

/// A scene block.
pub struct Scene {
    /// Header.
    pub header: SceneHeader,
    /// Payload, in units of 16 bytes.
    pub payload: Vec<u128>,
}

/// Pose of instrument `which` with its tip at `tip` and its shaft through the trocar.
pub fn through_trocar(rig: &Rig, which: usize, tip: [f64; 3]) -> Pose {
    let name = protocol::poses::BODY_NAMES[which];
    let trocar = DVec3::from(rig.trocar(name).expect("a trocar for each instrument").p_eye);
    let tip = DVec3::from(tip);
    let z = (trocar - tip).normalize();
    let y = z.cross(DVec3::X).normalize();
    let q = DQuat::from_mat3(&DMat3::from_cols(y.cross(z), y, z));
    Pose { position_mm: tip.to_array(), rotation_wxyz: [q.w, q.x, q.y, q.z] }
}

/// The scene with the forceps at `tip`; `grabbed` binds the nodes within so many mm of them.
pub fn scene(file: &SceneFile, rig: &Rig, tip: [f64; 3], jaw_rad: f64, grabbed_mm: f64) -> Scene {
    let mut header = SceneHeader::zeroed();
    header.world_from_eye = Pose::IDENTITY;
    header.microscope = microscope(&file.microscope);
    let lamp = [-2.6, 0.6, -5.0];
    for (which, at) in [tip, lamp].into_iter().enumerate() {
        let instrument = &mut header.instruments[which];
        instrument.world_from_instrument = through_trocar(rig, which, at);
        instrument.tool = file.instruments[which].tool as u32;
        instrument.jaw_rad = if which == 0 { jaw_rad } else { 0.0 };
    }
    header.instants.exposed = 1_000_000_000;
    header.topology = 1;
    let (nodes, triangles) = membrane(file, &header.instruments[0].world_from_instrument, grabbed_mm);
    let bytes = nodes.len() * 16 + triangles.len() * 16;
    let mut payload = vec![0u128; bytes / 16 + 2];
    let mut writer = SectionWriter::new(bytemuck::cast_slice_mut(&mut payload));
    header.nodes = writer.write(&nodes).expect("room for the nodes");
    header.triangles = writer.write(&triangles).expect("room for the triangles");
    Scene { header, payload }
}

/// The sheet over the pole, lifted in the middle and drawn towards the tip of `forceps`.
fn membrane(file: &SceneFile, forceps: &Pose, grabbed_mm: f64) -> (Vec<SceneNode>, Vec<SceneTriangle>) {
    let m = file.membrane.as_ref().expect("the shipped scene has a membrane");
    let [nx, ny] = m.squares;
    let radius = file.eye.retina_radius_mm;
    let tip = DVec3::from(forceps.position_mm);
    let instrument_from_eye = forceps.isometry().inverse();
    let mut nodes = Vec::new();
    for j in 0..=ny {
        for i in 0..=nx {
            let (u, v) = (f64::from(i) / f64::from(nx), f64::from(j) / f64::from(ny));
            let (x, y) = ((u - 0.5) * m.size_mm[0], (v - 0.5) * m.size_mm[1]);
            let bump = (u * (1.0 - u) * v * (1.0 - v) * 16.0).sqrt();
            let folds = 0.06 * (x * 3.1 + y * 1.7).sin() * bump;
            let z = -(radius * radius - x * x - y * y).sqrt() + m.lift_mm * bump + folds;
            let mut p = DVec3::new(x, y, z);
            let flat = p.truncate().distance(tip.truncate());
            if grabbed_mm > 0.0 && bump > 0.0 {
                p += (tip - p) * (-(flat * flat) / 0.8).exp() * bump;
            }
            let bound = grabbed_mm > 0.0 && flat < grabbed_mm;
            let (q, flag) = if bound {
                (instrument_from_eye * nalgebra::Point3::new(p.x, p.y, p.z), NODE_BOUND)
            } else {
                (nalgebra::Point3::new(p.x, p.y, p.z), NODE_FREE)
            };
            nodes.push(SceneNode { position_mm: [q.x as f32, q.y as f32, q.z as f32], flag });
        }
    }
    let at = |i: u32, j: u32| j * (nx + 1) + i;
    let mut triangles = Vec::new();
    for (j, i) in (0..ny).flat_map(|j| (0..nx).map(move |i| (j, i))) {
        let (a, b, c, d) = (at(i, j), at(i + 1, j), at(i + 1, j + 1), at(i, j + 1));
        triangles.extend([[a, b, c], [a, c, d]].map(|nodes| SceneTriangle { nodes, tissue: 0 }));
    }
    (nodes, triangles)
}
