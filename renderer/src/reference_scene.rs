//! Scenes of fixed contents, laid out as the simulation sends them: for `renderer bench`, the
//! reference pictures and tests. Positions are in the eye frame, mm.

use bytemuck::Zeroable;
use glam::{DMat3, DQuat, DVec3};
use protocol::geometry::Pose;
use protocol::scene::{
    FAR_FROM_EDGE_MM, NODE_BOUND, NODE_FREE, SceneBody, SceneBrick, SceneHeader, SceneHome, SceneMark,
    SceneNode, SceneTriangle, SectionWriter,
};
use rig::Rig;
use scene::SceneFile;

/// A scene as the renderer receives it.
pub struct SceneBlock {
    /// Header.
    pub header: SceneHeader,
    payload: Vec<u128>,
}

impl SceneBlock {
    /// A copy of what the simulation sent.
    pub fn new(header: SceneHeader, payload: &[u8]) -> Self {
        let mut units = vec![0u128; payload.len().div_ceil(16)];
        bytemuck::cast_slice_mut(&mut units)[..payload.len()].copy_from_slice(payload);
        Self { header, payload: units }
    }

    /// The sections that the header points into.
    pub fn payload(&self) -> &[u8] {
        bytemuck::cast_slice(&self.payload)
    }

    /// The same, to change.
    pub fn payload_mut(&mut self) -> &mut [u8] {
        bytemuck::cast_slice_mut(&mut self.payload)
    }
}

/// Pose of instrument `which` with its tip at `tip` and its shaft through the trocar.
fn through_trocar(rig: &Rig, which: usize, tip: [f64; 3]) -> Pose {
    let name = protocol::poses::BODY_NAMES[which];
    let trocar = DVec3::from(rig.trocar(name).expect("a trocar for each instrument").p_eye);
    let tip = DVec3::from(tip);
    let z = (trocar - tip).normalize();
    let y = z.cross(DVec3::X).normalize();
    let q = DQuat::from_mat3(&DMat3::from_cols(y.cross(z), y, z));
    Pose { position_mm: tip.to_array(), rotation_wxyz: [q.w, q.x, q.y, q.z] }
}

/// Contents of the eye beside the instruments.
#[derive(Default)]
pub struct Contents {
    /// Nodes of the tissue.
    pub nodes: Vec<SceneNode>,
    /// Triangles of the tissue.
    pub triangles: Vec<SceneTriangle>,
    /// Marks on the retina.
    pub marks: Vec<SceneMark>,
    /// Rigid bodies.
    pub bodies: Vec<SceneBody>,
    /// Densities of the vitreous.
    pub bricks: Vec<SceneBrick>,
    /// Places at which nodes of the retina lay at the start.
    pub homes: Vec<SceneHome>,
}

impl Contents {
    /// A scene of these; `header` says the rest of it.
    pub fn block(&self, mut header: SceneHeader) -> SceneBlock {
        let bytes = size_of_val(&*self.nodes)
            + size_of_val(&*self.triangles)
            + size_of_val(&*self.marks)
            + size_of_val(&*self.bodies)
            + size_of_val(&*self.bricks)
            + size_of_val(&*self.homes);
        let mut payload = vec![0u128; bytes / 16 + 8];
        let mut writer = SectionWriter::new(bytemuck::cast_slice_mut(&mut payload));
        header.nodes = writer.write(&self.nodes).expect("room for the nodes");
        header.triangles = writer.write(&self.triangles).expect("room for the triangles");
        header.marks = writer.write(&self.marks).expect("room for the marks");
        header.bodies = writer.write(&self.bodies).expect("room for the bodies");
        header.bricks = writer.write(&self.bricks).expect("room for the bricks");
        header.homes = writer.write(&self.homes).expect("room for the homes");
        SceneBlock { header, payload }
    }
}

/// A membrane with the forceps at `tip`; nodes within `grabbed_mm` of them are bound to them.
pub fn membrane_scene(
    file: &SceneFile,
    rig: &Rig,
    tip: [f64; 3],
    jaw_rad: f64,
    grabbed_mm: f64,
) -> SceneBlock {
    scene_with(file, rig, tip, jaw_rad, &membrane(file, &through_trocar(rig, 0, tip), grabbed_mm))
}

/// A scene with `contents`, the forceps at `tip` and a light pipe beside the macula.
pub fn scene_with(
    file: &SceneFile,
    rig: &Rig,
    tip: [f64; 3],
    jaw_rad: f64,
    contents: &Contents,
) -> SceneBlock {
    let mut header = SceneHeader::zeroed();
    header.world_from_eye = Pose::IDENTITY;
    header.microscope = file.start_microscope();
    let lamp = [-2.6, 0.6, -5.0];
    for (which, at) in [tip, lamp].into_iter().enumerate() {
        let instrument = &mut header.instruments[which];
        instrument.world_from_instrument = through_trocar(rig, which, at);
        instrument.tool = file.instruments[which].tool as u32;
        instrument.jaw_rad = if which == 0 { jaw_rad } else { 0.0 };
    }
    header.instants.exposed = 1_000_000_000;
    header.topology = 1;
    contents.block(header)
}

/// Subjects of the reference pictures.
pub const SUBJECTS: [&str; 4] = ["peel", "bleb", "vitreous", "bodies"];

/// The scenes that lead to the picture of a subject, in their order.
///
/// # Panics
/// If there is no such subject.
pub fn subject(file: &SceneFile, rig: &Rig, name: &str) -> Vec<SceneBlock> {
    match name {
        "peel" => {
            let tip = [0.9, 0.5, -10.1];
            let marks = vec![mark(2.4, 1.9, 0.3), mark(-2.0, 2.2, 0.18)];
            let contents = Contents { marks, ..membrane(file, &through_trocar(rig, 0, tip), 0.3) };
            vec![scene_with(file, rig, tip, 0.06, &contents)]
        }
        "bleb" => {
            let mut scenes =
                [0.0, 1.3].map(|height| scene_with(file, rig, [0.6, 1.2, -9.2], 0.3, &bleb(height)));
            scenes[1].header.topology += 1;
            scenes.into()
        }
        "vitreous" => {
            let contents = Contents { bricks: bricks([0.6, 0.4, -6.5]), ..Contents::default() };
            vec![scene_with(file, rig, [0.6, 0.4, -6.5], 0.3, &contents)]
        }
        "bodies" => vec![scene_with(file, rig, [0.9, 0.5, -8.5], 0.3, &bodies())],
        _ => panic!("no subject {name}"),
    }
}

fn mark(x: f32, y: f32, radius_mm: f32) -> SceneMark {
    let position_mm = [x, y, -(11.5f32.powi(2) - x * x - y * y).sqrt()];
    SceneMark { position_mm, radius_mm, rgba: [0.25, 0.005, 0.005, 0.9] }
}

/// A dome of lifted retina: a disc of radius 2.6 mm beside the macula, `height` mm high in its
/// middle.
fn bleb(height: f32) -> Contents {
    const RINGS: u32 = 10;
    const AROUND: u32 = 32;
    let centre = glam::Vec3::new(0.6, 1.4, -11.4).normalize();
    let side = centre.cross(glam::Vec3::X).normalize();
    let mut contents = Contents::default();
    for ring in 0..=RINGS {
        for k in 0..AROUND {
            let share = ring as f32 / RINGS as f32;
            let (sin, cos) = (k as f32 / AROUND as f32 * std::f32::consts::TAU).sin_cos();
            let away = (side * cos + centre.cross(side) * sin) * (2.6 / 11.5 * share);
            let lift = height * (1.0 - share * share);
            let out = (centre + away).normalize();
            let p = out * (11.5 - lift);
            let node = contents.nodes.len() as u32;
            contents.homes.push(SceneHome {
                position_mm: (out * 11.5).to_array(),
                node,
                from_edge_mm: FAR_FROM_EDGE_MM,
            });
            contents.nodes.push(SceneNode { position_mm: p.to_array(), flag: NODE_FREE as u16, dye: 0 });
        }
    }
    // Flat on the choroid, no triangle is lifted.
    let rings = if height > 0.0 { RINGS } else { 0 };
    for (ring, k) in (0..rings).flat_map(|r| (0..AROUND).map(move |k| (r, k))) {
        let at = |r: u32, k: u32| r * AROUND + k % AROUND;
        let (a, b, c, d) = (at(ring, k), at(ring, k + 1), at(ring + 1, k + 1), at(ring + 1, k));
        contents.triangles.extend([[a, b, c], [a, c, d]].map(|nodes| SceneTriangle { nodes, tissue: 1 }));
    }
    contents
}

/// A vitreous as dense as one with tracer, removed within 2.5 mm of `tip`.
fn bricks(tip: [f32; 3]) -> Vec<SceneBrick> {
    const ALONG: usize = 8;
    const EDGE: f32 = 3.0;
    let mut bricks = Vec::new();
    for number in 0..ALONG * ALONG * ALONG {
        let cell = [number % ALONG, number / ALONG % ALONG, number / ALONG / ALONG];
        let corner_mm = cell.map(|c| (c as f32 - ALONG as f32 / 2.0) * EDGE);
        let mut brick = SceneBrick { corner_mm, edge_mm: EDGE, ..SceneBrick::zeroed() };
        for (i, density) in brick.density.iter_mut().enumerate() {
            let at: [f32; 3] = std::array::from_fn(|c| {
                corner_mm[c] + ([i % 8, i / 8 % 8, i / 64][c] as f32 + 0.5) * EDGE / 8.0
            });
            let p = glam::Vec3::from(at);
            let strands = 1.0 + 0.35 * (p.x * 2.3 + (p.z * 1.1).sin()).sin() * (p.y * 1.9 + p.z).sin();
            let inside = p.length() < 11.3 && p.z < 6.5 && p.distance(tip.into()) > 2.5;
            *density = if inside { (110.0 * strands) as u8 } else { 0 };
        }
        bricks.push(brick);
    }
    bricks
}

/// A sphere, a box and a capsule over the retina.
fn bodies() -> Contents {
    let turned = glam::Quat::from_rotation_x(0.6) * glam::Quat::from_rotation_y(0.5);
    let body = |shape, position_mm, half_extents_mm, rgba| SceneBody {
        position_mm,
        shape,
        rotation_xyzw: turned.to_array(),
        half_extents_mm,
        reserved: 0,
        rgba,
    };
    let bodies = vec![
        body(0, [-1.5, 1.5, -9.5], [0.5; 3], [0.7, 0.1, 0.08, 1.0]),
        body(1, [1.8, 1.6, -9.8], [0.6, 0.4, 0.3], [0.1, 0.3, 0.7, 1.0]),
        body(2, [0.5, -2.0, -9.5], [0.3, 0.3, 0.9], [0.1, 0.55, 0.2, 1.0]),
        body(0, [3.0, -1.5, -9.0], [0.6; 3], [0.9, 0.8, 0.2, 0.4]),
    ];
    Contents { bodies, ..Contents::default() }
}

/// The sheet over the pole, lifted in the middle and drawn towards the tip of `forceps`.
fn membrane(file: &SceneFile, forceps: &Pose, grabbed_mm: f64) -> Contents {
    let m = file.membrane.as_ref().expect("the shipped scene has a membrane");
    let [nx, ny] = m.squares;
    let radius = file.eye.retina_radius_mm;
    let tip = DVec3::from(forceps.position_mm);
    let instrument_from_eye = forceps.isometry().inverse();
    let mut contents = Contents::default();
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
            let inside = |share: f64, size_mm: f64| share.min(1.0 - share) * size_mm;
            contents.homes.push(SceneHome {
                position_mm: DVec3::new(x, y, -(radius * radius - x * x - y * y).sqrt()).as_vec3().to_array(),
                node: contents.nodes.len() as u32,
                from_edge_mm: inside(u, m.size_mm[0]).min(inside(v, m.size_mm[1])) as f32,
            });
            contents.nodes.push(SceneNode {
                position_mm: [q.x as f32, q.y as f32, q.z as f32],
                flag: flag as u16,
                dye: 0,
            });
        }
    }
    let at = |i: u32, j: u32| j * (nx + 1) + i;
    for (j, i) in (0..ny).flat_map(|j| (0..nx).map(move |i| (j, i))) {
        let (a, b, c, d) = (at(i, j), at(i + 1, j), at(i + 1, j + 1), at(i, j + 1));
        contents.triangles.extend([[a, b, c], [a, c, d]].map(|nodes| SceneTriangle { nodes, tissue: 0 }));
    }
    contents
}
