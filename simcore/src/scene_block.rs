//! The scene as the renderer draws it, written straight into the lent block.

mod homes;

use crate::bodies::state::BodyState;
use crate::microscope;
use crate::state::InstrumentState;
use crate::task_view::{self, MAX_BALLS, MAX_TEXT, TaskText};
use crate::world::World;
use protocol::events::EventKind;
use protocol::geometry::Pose;
use protocol::scene::{
    NODE_DEAD, NODE_FREE, SceneBody, SceneHeader, SceneHome, SceneInstrument, SceneMark, SceneNode,
    SceneTriangle, Section, SectionWriter, TISSUE_GONE, TISSUE_LYING, TISSUE_MEMBRANE, TISSUE_RETINA,
};
use protocol::time::Instants;
use scene::{BodyScene, BodyShape, MAX_BODIES};
use tissue::sheet::mesh::SheetMesh;
use tissue::sheet::state::{SheetState, is_bound};
use tissue::vitreous::Vitreous;

/// Bytes kept for marks, bodies, doses and text beside the mesh.
const BESIDE_THE_MESH: usize = 24 << 10;
/// Dark red, linear RGB and opacity.
const BLOOD: [f32; 4] = [0.25, 0.005, 0.005, 0.9];

const _: () = assert!(
    (MAX_BODIES + MAX_BALLS) * size_of::<SceneBody>()
        + crate::constants::MAX_MARKS * size_of::<SceneMark>()
        + protocol::dose::CELLS * size_of::<f32>()
        + MAX_TEXT
        + 256
        < BESIDE_THE_MESH
);

/// Height from which retina under adhesion is drawn as lifted, mm: a twentieth of its thickness,
/// nothing that an eye would see.
const SHOWN_MM: f32 = 0.005;

/// Room that the scene of a membrane's sheet, `bonded` to the retina or not, a vitreous and a
/// retina's sheet takes at most, bytes.
pub fn bytes_needed(
    sheet: &SheetMesh,
    bonded: bool,
    vitreous: Option<&Vitreous>,
    retina: Option<&SheetMesh>,
) -> usize {
    let mesh = |s: &SheetMesh| {
        s.nodes() * (size_of::<SceneNode>() + size_of::<SceneHome>())
            + s.triangles.len() * size_of::<SceneTriangle>()
    };
    let bricks = vitreous.map_or(0, |v| size_of_val(v.haze().bricks()));
    mesh(sheet) * (1 + usize::from(bonded)) + retina.map_or(0, mesh) + bricks + BESIDE_THE_MESH
}

/// Fills scene blocks. What changes with every step is written into the block itself; what stays for many steps
/// is kept, and copied.
#[derive(Debug)]
pub struct SceneWriter {
    triangles: Vec<SceneTriangle>,
    /// Topology for which `triangles` holds.
    topology: Option<u64>,
    /// By node of the retina: whether a triangle that is loose or moved has it.
    beside: Vec<bool>,
    /// Where the nodes lay at the start; it never changes.
    homes: Vec<SceneHome>,
    elevation: Elevation,
    task: TaskText,
    /// A reset world counts its topology from 0 again, but the renderer must see a change.
    generation: u64,
}

impl SceneWriter {
    /// Lists for a world.
    pub fn new(world: &World) -> Self {
        let (sheet, retina) = (world.sheet(), world.retina().map(|r| &r.body.mesh));
        let sheets = 1 + usize::from(world.adhesion().is_some());
        let triangles = sheets * sheet.triangles.len() + retina.map_or(0, |s| s.triangles.len());
        SceneWriter {
            homes: homes::homes(world),
            triangles: Vec::with_capacity(triangles),
            topology: None,
            beside: Vec::with_capacity(retina.map_or(0, |s| s.nodes())),
            elevation: Elevation {
                raised: vec![false; sheet.triangles.len()],
                beside: vec![false; sheet.nodes()],
                changes: 0,
            },
            task: TaskText::default(),
            generation: 0,
        }
    }

    /// To be called when the world was reset or restored.
    pub fn forget(&mut self) {
        self.topology = None;
        self.generation += 1 << 32;
    }

    /// Lists for another world, whose topology no reader takes for this one's.
    pub fn successor(&self, world: &World) -> Self {
        SceneWriter { generation: self.generation, ..SceneWriter::new(world) }
    }

    /// Writes the world into `payload`; sections that do not fit are left empty.
    pub fn write(
        &mut self,
        world: &World,
        instants: Instants,
        state_hash: u64,
        payload: &mut [u8],
    ) -> SceneHeader {
        let (state, scene) = (world.state(), world.scene());
        self.elevation.follow(world);
        self.update_triangles(world);
        let mut writer = SectionWriter::new(payload);
        let text = if state.notice_kind == 0 { "" } else { notice(state.notice_kind) };
        SceneHeader {
            step: state.step,
            field: state.field,
            instants,
            state_hash,
            topology: self.generation + self.topology_of(world),
            world_from_eye: Pose::from_isometry(&state.world_from_eye),
            instruments: std::array::from_fn(|i| {
                // A body between them keeps the jaws open.
                let stop = state.bodies.as_ref().and_then(|b| b.grip[i]).map_or(0.0, |grip| grip.opening_rad);
                let shown = instrument(&state.instruments[i]);
                SceneInstrument { jaw_rad: shown.jaw_rad.max(stop), ..shown }
            }),
            microscope: microscope::view(&state.microscope, &state.optics, scene),
            filter: state.optics.map_or(0, |o| o.filter),
            reserved: 0,
            nodes: self.write_nodes(world, &mut writer).unwrap_or_default(),
            triangles: writer.write(&self.triangles).unwrap_or_default(),
            marks: write_marks(world, &mut writer).unwrap_or_default(),
            bodies: write_bodies(world, &mut writer).unwrap_or_default(),
            bricks: world.vitreous().and_then(|(v, _)| writer.write(v.haze().bricks())).unwrap_or_default(),
            text: writer
                .write(self.task.lines(world, text, state.notice_kind).as_bytes())
                .unwrap_or_default(),
            homes: writer.write(&self.homes).unwrap_or_default(),
            doses: write_doses(world, &mut writer).unwrap_or_default(),
        }
    }

    /// Every node, so that a node keeps its number while the retina comes off and lies on: the membrane's,
    /// those of the retina under a bonded membrane, those of a retina of its own.
    fn write_nodes(&self, world: &World, writer: &mut SectionWriter) -> Option<Section> {
        let (section, mut room) = writer.lend::<SceneNode>(self.homes.len())?;
        let state = world.state();
        let dye = |i: usize| state.stain.as_ref().map_or(0, |s| s.dye[i]);
        room = write_sheet(&state.membrane, dye, room);
        let under = self.elevation.nodes(world);
        let count = if world.adhesion().is_some() { world.sheet().nodes() } else { 0 };
        let (lifted, room) = room.split_at_mut(count);
        lifted.iter_mut().zip(under).for_each(|(room, node)| *room = node);
        if let Some(retina) = &state.retina {
            write_sheet(&retina.sheet, |_| 0, room);
        }
        Some(section)
    }

    /// Rebuilds the list of triangles if they have changed.
    fn update_triangles(&mut self, world: &World) {
        let (state, sheet) = (world.state(), world.sheet());
        let topology = self.topology_of(world);
        if self.topology.replace(topology) == Some(topology) {
            return;
        }
        let base = state.membrane.nodes() as u32;
        let bonded = if world.adhesion().is_some() { base } else { 0 };
        let alive = sheet.triangles.iter().zip(&state.membrane.triangle_alive).filter(|(_, a)| **a != 0);
        self.triangles.clear();
        self.triangles.extend(alive.map(|(t, _)| SceneTriangle { nodes: *t, tissue: TISSUE_MEMBRANE }));
        self.triangles.extend(self.elevation.triangles(world, base));
        self.collect_retina_triangles(world, base + bonded);
    }

    /// Only triangles of the retina that are loose, lie elsewhere than at the start, or are gone, and
    /// those beside them: what lies where it lay is the fundus itself.
    fn collect_retina_triangles(&mut self, world: &World, base: u32) {
        let (Some(model), Some(retina)) = (world.retina(), &world.state().retina) else { return };
        let gone = |t: usize| retina.sheet.triangle_alive[t] == 0;
        let differs = |t: usize, nodes: &[u32; 3]| {
            model.body.active()[t] != 0 || nodes.iter().any(|&n| model.has_moved(retina, n))
        };
        let all = || model.body.mesh.triangles.iter().enumerate();
        let sent = |nodes: &[u32; 3], tissue| SceneTriangle { nodes: nodes.map(|n| n + base), tissue };
        self.beside.clear();
        self.beside.resize(retina.sheet.nodes(), false);
        for (t, nodes) in all() {
            if gone(t) {
                self.triangles.push(sent(nodes, TISSUE_GONE));
            } else if differs(t, nodes) {
                self.triangles.push(sent(nodes, TISSUE_RETINA));
                nodes.iter().for_each(|&n| self.beside[n as usize] = true);
            }
        }
        let beside = |nodes: &[u32; 3]| nodes.iter().any(|&n| self.beside[n as usize]);
        let lying = all().filter(|(t, nodes)| !gone(*t) && !differs(*t, nodes) && beside(nodes));
        self.triangles.extend(lying.map(|(_, nodes)| sent(nodes, TISSUE_LYING)));
    }

    /// Changes with every change of the triangles that are sent.
    fn topology_of(&self, world: &World) -> u64 {
        let retina = world.state().retina.as_ref().map_or(0, |r| r.sheet.topology);
        world.state().membrane.topology + retina + self.elevation.changes
    }
}

/// Writes the nodes of a sheet; the room behind them is left.
fn write_sheet<'a>(
    sheet: &SheetState,
    dye: impl Fn(usize) -> u16,
    room: &'a mut [SceneNode],
) -> &'a mut [SceneNode] {
    let (own, rest) = room.split_at_mut(sheet.nodes());
    for (i, node) in own.iter_mut().enumerate() {
        *node =
            SceneNode { position_mm: sheet.position(i).into(), flag: shown_flag(sheet.flag[i]), dye: dye(i) };
    }
    for held in sheet.held.iter().flatten() {
        own[held.node as usize].position_mm = held.at_in_instrument_mm;
    }
    rest
}

fn write_marks(world: &World, writer: &mut SectionWriter) -> Option<Section> {
    let mut marks = writer.list();
    let all = world.state().marks.iter();
    all.for_each(|m| {
        marks.push(SceneMark { position_mm: m.position_mm, radius_mm: m.radius_mm, rgba: BLOOD });
    });
    marks.end()
}

fn write_bodies(world: &World, writer: &mut SectionWriter) -> Option<Section> {
    let mut bodies = writer.list();
    let models = world.scene().bodies.iter().flat_map(|b| &b.body);
    let states = world.state().bodies.iter().flat_map(|b| &b.body);
    models.zip(states).for_each(|(scene, state)| bodies.push(body(scene, state)));
    task_view::balls(world, |ball| bodies.push(ball));
    bodies.end()
}

fn write_doses(world: &World, writer: &mut SectionWriter) -> Option<Section> {
    let (section, room) = writer.lend::<f32>(protocol::dose::CELLS)?;
    room.fill(0.0);
    room.iter_mut().zip(&world.state().dose.mj_mm2).for_each(|(shown, dose)| *shown = *dose as f32);
    Some(section)
}

/// Retina that a bonded membrane has lifted: the membrane's triangles once more, between the places
/// of its nodes on the retina.
#[derive(Debug)]
struct Elevation {
    /// Triangles of the sheet with a lifted corner.
    raised: Vec<bool>,
    /// Nodes of raised triangles.
    beside: Vec<bool>,
    /// How often that changed.
    changes: u64,
}

impl Elevation {
    /// Which triangles are raised now. One raised corner is enough: so the sheet comes down to the
    /// choroid all round.
    fn follow(&mut self, world: &World) {
        let Some(bonds) = &world.state().membrane.adhesion else { return };
        let mut changed = false;
        for (raised, nodes) in self.raised.iter_mut().zip(&world.sheet().triangles) {
            let now = nodes.iter().any(|&n| bonds.lifted_mm[n as usize] > SHOWN_MM);
            changed |= now != *raised;
            *raised = now;
        }
        self.changes += u64::from(changed);
        if changed {
            self.beside.fill(false);
            let raised = world.sheet().triangles.iter().zip(&self.raised).filter(|(_, raised)| **raised);
            raised.flat_map(|(t, _)| t).for_each(|&n| self.beside[n as usize] = true);
        }
    }

    /// The retina under every node of a bonded membrane.
    fn nodes<'a>(&self, world: &'a World) -> impl Iterator<Item = SceneNode> + 'a {
        let radius_mm = world.scene().eye.retina_radius_mm as f32;
        let bonds = world.adhesion().zip(world.state().membrane.adhesion.as_ref());
        bonds.into_iter().flat_map(move |(adhesion, bonds)| {
            bonds.lifted_mm.iter().enumerate().map(move |(node, lifted_mm)| {
                let up = adhesion.place(bonds, node).normalize();
                let position_mm = (up * (radius_mm - lifted_mm)).into();
                SceneNode { position_mm, flag: NODE_FREE as u16, dye: 0 }
            })
        })
    }

    fn triangles<'a>(&'a self, world: &'a World, base: u32) -> impl Iterator<Item = SceneTriangle> + 'a {
        world.sheet().triangles.iter().zip(&self.raised).filter_map(move |(nodes, raised)| {
            let beside = nodes.iter().any(|&n| self.beside[n as usize]);
            let tissue = if *raised { TISSUE_RETINA } else { TISSUE_LYING };
            (*raised || beside).then(|| SceneTriangle { nodes: nodes.map(|n| n + base), tissue })
        })
    }
}

/// The node as the renderer gets it: pinned ones are drawn like free ones.
fn shown_flag(flag: u32) -> u16 {
    (if is_bound(flag) || flag == NODE_DEAD { flag } else { NODE_FREE }) as u16
}

fn body(scene: &BodyScene, state: &BodyState) -> SceneBody {
    let q = state.eye_from_body.rotation.coords;
    SceneBody {
        position_mm: state.eye_from_body.translation.vector.map(|c| c as f32).into(),
        shape: match scene.shape {
            BodyShape::Sphere => 0,
            BodyShape::Box => 1,
            BodyShape::Capsule => 2,
        },
        rotation_xyzw: q.map(|c| c as f32).into(),
        half_extents_mm: scene.half_extents_mm.map(|h| h as f32),
        reserved: 0,
        rgba: scene.rgba,
    }
}

fn instrument(state: &InstrumentState) -> SceneInstrument {
    SceneInstrument {
        world_from_instrument: Pose::from_isometry(&state.world_from_instrument),
        jaw_rad: state.jaw_rad,
        tool: state.tool,
        touches: u32::from(state.touches),
    }
}

fn notice(kind: u32) -> &'static str {
    EventKind::from_wire(kind).map_or("", |k| k.info().text)
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::world::no_clock;
    use protocol::message::Message;
    use protocol::scene::{NODE_BOUND, section};
    use scene::SceneFile;
    use surgeon::rehearsal::Rehearsal;

    /// A block as the transport lends it: aligned to sixteen bytes.
    fn block(bytes: usize) -> Vec<u128> {
        vec![0; bytes.div_ceil(16)]
    }

    #[test]
    fn a_scene_carries_the_mesh_and_bound_nodes_in_the_instruments_frame() {
        let scene = SceneFile::load("peel").unwrap();
        let rehearsal = Rehearsal::shipped(&scene);
        let mut world = World::new(&scene).unwrap();
        let mut writer = SceneWriter::new(&world);
        let mut field = 0;
        while world.state().membrane.held[0].is_empty() {
            world.step(&rehearsal.inputs(field).input(), &mut no_clock);
            field += 1;
            assert!(field < 50 * 16, "the script grabs");
        }
        let mut payload = block(bytes_needed(world.sheet(), false, None, None));
        let bytes: &mut [u8] = bytemuck::cast_slice_mut(&mut payload);
        let header = writer.write(&world, bytemuck::Zeroable::zeroed(), 5, bytes);
        header.validate().unwrap();
        let nodes = section::<SceneNode>(bytes, header.nodes).unwrap();
        let triangles = section::<SceneTriangle>(bytes, header.triangles).unwrap();
        assert_eq!((nodes.len(), triangles.len()), (546, 1000));
        let held = &world.state().membrane.held[0];
        let bound: Vec<_> = nodes.iter().filter(|n| u32::from(n.flag) == NODE_BOUND).collect();
        assert_eq!(bound.len(), held.len());
        assert!(bound.iter().all(|n| n.position_mm.iter().all(|c| c.abs() < 0.5)), "near the tip");
        assert!(header.instruments[0].touches == 1);
    }

    #[test]
    fn a_block_that_is_too_small_leaves_sections_empty() {
        let world = World::new(&SceneFile::load("peel").unwrap()).unwrap();
        let mut payload = block(64);
        let bytes = bytemuck::cast_slice_mut(&mut payload);
        let header = SceneWriter::new(&world).write(&world, bytemuck::Zeroable::zeroed(), 0, bytes);
        assert_eq!((header.nodes.count, header.triangles.count), (0, 0));
    }

    #[test]
    fn a_reset_changes_the_topology_number() {
        let world = World::new(&SceneFile::load("peel").unwrap()).unwrap();
        let mut writer = SceneWriter::new(&world);
        let mut payload = block(bytes_needed(world.sheet(), false, None, None));
        let mut topology = |writer: &mut SceneWriter| {
            let bytes = bytemuck::cast_slice_mut(&mut payload);
            writer.write(&world, bytemuck::Zeroable::zeroed(), 0, bytes).topology
        };
        let first = topology(&mut writer);
        writer.forget();
        assert_ne!(topology(&mut writer), first);
    }

    /// A retina that holds less than the adhesion comes up in the picture where the state has it,
    /// under the membrane, and goes down again.
    #[test]
    fn lifted_retina_is_sent_where_the_adhesion_has_lifted_it() {
        let mut scene = SceneFile::load("erm").unwrap();
        let adhesion = scene.membrane.as_mut().unwrap().adhesion.as_mut().unwrap();
        (adhesion.retina_lift_pa, adhesion.retina_tear_mm) = (9000.0, 0.3);
        let (rehearsal, mut world) = (Rehearsal::shipped(&scene), World::new(&scene).unwrap());
        let mut writer = SceneWriter::new(&world);
        let mut payload = block(bytes_needed(world.sheet(), true, None, None));
        let (sheet_nodes, mut most, mut numbers) = (world.sheet().nodes(), 0, Vec::new());
        for field in 190..420 {
            world.step(&rehearsal.inputs(field).input(), &mut no_clock);
            let bytes: &mut [u8] = bytemuck::cast_slice_mut(&mut payload);
            let header = writer.write(&world, bytemuck::Zeroable::zeroed(), 0, bytes);
            header.validate().unwrap();
            let nodes = section::<SceneNode>(bytes, header.nodes).unwrap();
            let triangles = section::<SceneTriangle>(bytes, header.triangles).unwrap();
            assert_eq!(nodes.len(), 2 * sheet_nodes);
            let lifted_mm = &world.state().membrane.adhesion.as_ref().unwrap().lifted_mm;
            for (node, lifted_mm) in nodes[sheet_nodes..].iter().zip(lifted_mm) {
                let height_mm = 11.5 - nalgebra::Vector3::from(node.position_mm).norm();
                assert!((height_mm - lifted_mm).abs() < 1e-5, "{height_mm} {lifted_mm}");
            }
            let retina: Vec<_> = triangles.iter().filter(|t| t.tissue == TISSUE_RETINA).collect();
            let shown = |n: usize| retina.iter().any(|t| t.nodes.contains(&((sheet_nodes + n) as u32)));
            let high = lifted_mm.iter().enumerate().filter(|(_, mm)| **mm > SHOWN_MM);
            assert!(high.into_iter().all(|(n, _)| shown(n)), "field {field}");
            most = most.max(retina.len());
            numbers.push((header.topology, retina.len()));
        }
        assert!(most > 10, "{most}");
        let told = numbers.windows(2).all(|w| w[0].1 == w[1].1 || w[0].0 != w[1].0);
        assert!(told, "another number of triangles is another topology");
    }

    /// Tissue that tears in a step is gone from the block of the same step, and what is sent is
    /// what lives.
    #[test]
    fn torn_triangles_leave_the_picture_in_the_same_step() {
        let mut scene = SceneFile::load("peel").unwrap();
        scene.membrane.as_mut().unwrap().tear_tension_n_per_m *= 0.25;
        let (rehearsal, mut world) = (Rehearsal::shipped(&scene), World::new(&scene).unwrap());
        let mut writer = SceneWriter::new(&world);
        let mut payload = block(bytes_needed(world.sheet(), false, None, None));
        let (mut before, mut changes) = (None, 0);
        for field in 150..500 {
            world.step(&rehearsal.inputs(field).input(), &mut no_clock);
            let bytes: &mut [u8] = bytemuck::cast_slice_mut(&mut payload);
            let header = writer.write(&world, bytemuck::Zeroable::zeroed(), 0, bytes);
            let sent = section::<SceneTriangle>(bytes, header.triangles).unwrap();
            let alive = &world.state().membrane.triangle_alive;
            let living = world.sheet().triangles.iter().zip(alive).filter(|(_, a)| **a != 0).map(|(t, _)| *t);
            assert!(sent.iter().map(|t| t.nodes).eq(living), "field {field}");
            changes += usize::from(before.is_some_and(|b| b != (header.topology, sent.len())));
            before = Some((header.topology, sent.len()));
        }
        assert!(changes > 3, "it must tear: {changes}");
    }
}
