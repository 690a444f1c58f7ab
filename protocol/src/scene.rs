//! `scene`: the state that the renderer draws, written by simcore straight into shared memory.
//!
//! A block has the [`SceneHeader`] as its header and a payload of 16-byte units. The header's
//! [`Section`]s say where each array lies. All positions are in the **eye** frame, mm, so that
//! the renderer can turn the eye with the pose it latched.

use crate::geometry::Pose;
use crate::limits::INSTRUMENTS;
use crate::message::{Invalid, Message, all_finite, require};
use crate::time::Instants;
use crate::wire::Wire;
use bytemuck::{Pod, Zeroable};
use std::marker::PhantomData;

/// Where an array lies in the payload.
#[repr(C)]
#[derive(Debug, Clone, Copy, Default, PartialEq, Eq, Pod, Wire, Zeroable)]
pub struct Section {
    /// Bytes from the start of the payload; a multiple of 16.
    pub offset: u32,
    /// Elements.
    pub count: u32,
}

/// The node is free, or pinned to the eye.
pub const NODE_FREE: u32 = 0;
/// The node belongs to no triangle any more.
pub const NODE_DEAD: u32 = 1;
/// The node is bound to instrument `flag - NODE_BOUND`; `position` is then in that
/// **instrument's** frame, so that it moves with the pose the renderer latched. Farther from the eye's
/// centre than the retina it lies on the retina.
pub const NODE_BOUND: u32 = 16;

/// A node of a tissue mesh.
#[repr(C)]
#[derive(Debug, Clone, Copy, PartialEq, Pod, Wire, Zeroable)]
pub struct SceneNode {
    /// Eye frame, or an instrument's (see [`NODE_BOUND`]), mm.
    pub position_mm: [f32; 3],
    /// `NODE_…`.
    pub flag: u16,
    /// Dye that the node has taken: 0 none, `u16::MAX` all that it can.
    pub dye: u16,
}

/// Epiretinal membrane.
pub const TISSUE_MEMBRANE: u32 = 0;
/// Retina that is off the choroid, or lies on it elsewhere than at the start.
pub const TISSUE_RETINA: u32 = 1;
/// Retina that is gone: nothing is drawn but the choroid where it lay.
pub const TISSUE_GONE: u32 = 2;
/// Retina that lies where it lay at the start, beside one that does not. It is the fundus itself; what
/// comes off is rounded off against it.
pub const TISSUE_LYING: u32 = 3;

/// A triangle of a tissue mesh.
#[repr(C)]
#[derive(Debug, Clone, Copy, PartialEq, Eq, Pod, Wire, Zeroable)]
pub struct SceneTriangle {
    /// Nodes, counter-clockwise seen from the inside of the eye.
    pub nodes: [u32; 3],
    /// `TISSUE_…`.
    pub tissue: u32,
}

/// Where a node of a tissue mesh lay at the start. What is drawn on the tissue stays with it by this:
/// the photograph of the fundus on retina, the grain of a membrane.
#[repr(C)]
#[derive(Debug, Clone, Copy, PartialEq, Pod, Wire, Zeroable)]
pub struct SceneHome {
    /// Eye frame, mm.
    pub position_mm: [f32; 3],
    /// Number of the node in the section of nodes.
    pub node: u32,
    /// Way from there to the edge that the sheet had at the start, mm; [`FAR_FROM_EDGE_MM`] where it
    /// has none.
    pub from_edge_mm: f32,
}

/// Stands for "no edge near".
pub const FAR_FROM_EDGE_MM: f32 = 1000.0;

/// A mark on the retina or the tissue.
#[repr(C)]
#[derive(Debug, Clone, Copy, PartialEq, Pod, Wire, Zeroable)]
pub struct SceneMark {
    /// Eye frame, mm.
    pub position_mm: [f32; 3],
    /// mm.
    pub radius_mm: f32,
    /// Linear RGB and opacity.
    pub rgba: [f32; 4],
}

/// A rigid body of an abstract task.
#[repr(C)]
#[derive(Debug, Clone, Copy, PartialEq, Pod, Wire, Zeroable)]
pub struct SceneBody {
    /// Eye frame, mm.
    pub position_mm: [f32; 3],
    /// 0 sphere, 1 box, 2 capsule.
    pub shape: u32,
    /// Rotation (x, y, z, w).
    pub rotation_xyzw: [f32; 4],
    /// Half extents, mm; a capsule lies along z, its caps inside, its radius is that of x.
    pub half_extents_mm: [f32; 3],
    /// 0.
    pub reserved: u32,
    /// Linear RGB and opacity.
    pub rgba: [f32; 4],
}

/// A brick of 8³ densities (0 to 255) of the vitreous.
#[repr(C)]
#[derive(Debug, Clone, Copy, PartialEq, Pod, Wire, Zeroable)]
pub struct SceneBrick {
    /// Corner with the smallest coordinates, eye frame, mm.
    pub corner_mm: [f32; 3],
    /// Edge, mm.
    pub edge_mm: f32,
    /// x fastest, z slowest.
    pub density: [u8; 512],
}

/// An instrument as the simulation saw it at `instants.exposed`.
#[repr(C)]
#[derive(Debug, Clone, Copy, PartialEq, Pod, Wire, Zeroable)]
pub struct SceneInstrument {
    /// `world_from_instrument` at the exposure.
    pub world_from_instrument: Pose,
    /// Jaw opening, rad.
    pub jaw_rad: f64,
    /// [`crate::handles::Tool`] on the wire.
    pub tool: u32,
    /// 1 if it may touch tissue (it is tracked).
    pub touches: u32,
}

/// The surgical microscope and the lens before it. World frame; it looks along −z. Distances and
/// field are those of the object that it looks at: without a lens the eye itself, else the image of
/// it that the lens makes in the air.
#[repr(C)]
#[derive(Debug, Clone, Copy, PartialEq, Pod, Wire, Zeroable)]
pub struct Microscope {
    /// Point looked at, mm.
    pub target_in_world_mm: [f64; 3],
    /// Distance from the target to the objective, mm.
    pub working_distance_mm: f64,
    /// Distance between the two channels at the objective, mm.
    pub stereo_base_mm: f64,
    /// Diameter of the round field of view at the target, mm.
    pub field_mm: f64,
    /// Height of the plane of focus over the target, mm.
    pub focus_mm: f64,
    /// Diameter of a channel's beam at the objective, mm.
    pub aperture_mm: f64,
    /// Focal length of the wide-angle lens, mm.
    pub lens_focal_mm: f64,
    /// Height of the wide-angle lens over the eye's centre, mm.
    pub lens_height_mm: f64,
    /// [`crate::optics::Lens`] on the wire.
    pub lens: u32,
    /// 1 if the inverter is on.
    pub inverter: u32,
}

/// Header of a scene block.
#[repr(C)]
#[derive(Debug, Clone, Copy, PartialEq, Pod, Wire, Zeroable)]
pub struct SceneHeader {
    /// Step that made it.
    pub step: u64,
    /// Field of that step.
    pub field: u64,
    /// Instants so far.
    pub instants: Instants,
    /// Hash of the state.
    pub state_hash: u64,
    /// Changes when the triangles changed; positions change every step.
    pub topology: u64,
    /// `world_from_eye` at the exposure.
    pub world_from_eye: Pose,
    /// The two instruments.
    pub instruments: [SceneInstrument; INSTRUMENTS],
    /// The microscope.
    pub microscope: Microscope,
    /// [`crate::optics::Filter`] of the lamp, on the wire.
    pub filter: u32,
    /// 0.
    pub reserved: u32,
    /// Nodes of the tissue meshes.
    #[wire(elements = SceneNode)]
    pub nodes: Section,
    /// Triangles of the tissue meshes.
    #[wire(elements = SceneTriangle)]
    pub triangles: Section,
    /// Marks on retina and tissue.
    #[wire(elements = SceneMark)]
    pub marks: Section,
    /// Rigid bodies.
    #[wire(elements = SceneBody)]
    pub bodies: Section,
    /// Bricks of the vitreous.
    #[wire(elements = SceneBrick)]
    pub bricks: Section,
    /// Bytes of UTF-8 shown on the picture: lines as in [`crate::scene_text`].
    #[wire(elements = u8)]
    pub text: Section,
    /// Where the nodes lay at the start.
    #[wire(elements = SceneHome)]
    pub homes: Section,
    /// Doses of light on the retina, mJ/mm², in the cells of [`crate::dose`].
    #[wire(elements = f32)]
    pub doses: Section,
}

impl Message for SceneHeader {
    const CHANNEL: &'static str = "scene";
    /// 2: lens, inverter, aperture and filter; homes of the retina's nodes. 3: doses of light. 4: homes of all nodes.
    const VERSION: u32 = 4;
    const QUEUE: usize = 1;

    fn validate(&self) -> Result<(), Invalid> {
        let check = |holds, field, expected| require(holds, "SceneHeader", field, expected, f64::NAN);
        check(self.world_from_eye.is_valid(), "world_from_eye", "a rigid pose")?;
        for instrument in &self.instruments {
            let ok = instrument.world_from_instrument.is_valid() && instrument.jaw_rad.is_finite();
            check(ok, "instruments", "rigid poses")?;
        }
        let m = &self.microscope;
        let figures = [m.working_distance_mm, m.stereo_base_mm, m.field_mm, m.focus_mm, m.aperture_mm];
        let lens = [m.lens_focal_mm, m.lens_height_mm];
        check(
            all_finite(&figures) && all_finite(&lens) && all_finite(&m.target_in_world_mm),
            "microscope",
            "finite numbers",
        )
    }
}

/// The elements of `section` in `payload`.
///
/// # Errors
/// Where the section does not lie inside the payload, or is not aligned.
pub fn section<T: Wire>(payload: &[u8], section: Section) -> Result<&[T], Invalid> {
    let start = section.offset as usize;
    let bytes = (section.count as usize).checked_mul(size_of::<T>());
    let end = bytes.and_then(|b| start.checked_add(b));
    end.and_then(|end| payload.get(start..end)).and_then(|bytes| bytemuck::try_cast_slice(bytes).ok()).ok_or(
        Invalid {
            message: "SceneHeader",
            field: "section",
            expected: "offset and count inside the payload",
            found: f64::from(section.count),
        },
    )
}

/// Writes sections one after the other into a payload of a fixed capacity.
pub struct SectionWriter<'a> {
    payload: &'a mut [u8],
    used: usize,
}

impl<'a> SectionWriter<'a> {
    /// Begins at the start of `payload`.
    pub fn new(payload: &'a mut [u8]) -> Self {
        Self { payload, used: 0 }
    }

    /// Copies `elements` in; `None` (and nothing written) where they do not fit.
    pub fn write<T: Wire>(&mut self, elements: &[T]) -> Option<Section> {
        let bytes: &[u8] = bytemuck::cast_slice(elements);
        let end = self.used.checked_add(bytes.len())?;
        self.payload.get_mut(self.used..end)?.copy_from_slice(bytes);
        let section = Section { offset: self.used as u32, count: elements.len() as u32 };
        self.used = end.next_multiple_of(16);
        Some(section)
    }

    /// Lends room for `count` elements, which holds whatever an earlier block left there; `None` where they do
    /// not fit.
    pub fn lend<T: Wire>(&mut self, count: usize) -> Option<(Section, &mut [T])> {
        let end = self.used.checked_add(count.checked_mul(size_of::<T>())?)?;
        let room = bytemuck::try_cast_slice_mut(self.payload.get_mut(self.used..end)?).ok()?;
        let section = Section { offset: self.used as u32, count: count as u32 };
        self.used = end.next_multiple_of(16);
        Some((section, room))
    }

    /// Begins a section whose elements are written one by one.
    pub fn list<T: Wire>(&mut self) -> SectionList<'_, 'a, T> {
        SectionList { writer: self, count: 0, fits: true, holds: PhantomData }
    }

    /// Bytes in use, a multiple of 16.
    pub fn used(&self) -> usize {
        self.used.min(self.payload.len())
    }
}

/// A section that grows where it will be read.
pub struct SectionList<'w, 'a, T> {
    writer: &'w mut SectionWriter<'a>,
    count: usize,
    fits: bool,
    holds: PhantomData<fn(T)>,
}

impl<T: Wire> SectionList<'_, '_, T> {
    /// Appends an element.
    pub fn push(&mut self, element: T) {
        let begin = self.writer.used + self.count * size_of::<T>();
        let room = self.writer.payload.get_mut(begin..begin + size_of::<T>());
        match room.filter(|_| self.fits) {
            Some(room) => room.copy_from_slice(bytemuck::bytes_of(&element)),
            None => self.fits = false,
        }
        self.count += 1;
    }

    /// Elements so far.
    pub fn len(&self) -> usize {
        self.count
    }

    /// True before the first one.
    pub fn is_empty(&self) -> bool {
        self.count == 0
    }

    /// Ends the section; `None` (and nothing in use) where its elements did not fit.
    pub fn end(self) -> Option<Section> {
        let offset = self.writer.used;
        let end = (offset + self.count * size_of::<T>()).next_multiple_of(16);
        self.fits.then(|| self.writer.used = end)?;
        Some(Section { offset: offset as u32, count: self.count as u32 })
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn sections_come_back() {
        let mut payload = vec![0u128; 16];
        let bytes: &mut [u8] = bytemuck::cast_slice_mut(&mut payload);
        let mut writer = SectionWriter::new(bytes);
        let text = writer.write(b"hello".as_slice()).unwrap();
        let marks = [SceneMark { position_mm: [1.0, 2.0, 3.0], radius_mm: 0.5, rgba: [1.0; 4] }];
        let at = writer.write(&marks).unwrap();
        assert!(writer.write(&[SceneBrick::zeroed()]).is_none(), "a brick of 528 bytes cannot fit");
        assert!(writer.lend::<SceneBrick>(1).is_none() && writer.lend::<f32>(usize::MAX).is_none());
        let mut long = writer.list();
        (0..99).for_each(|_| long.push(marks[0]));
        assert!(long.end().is_none(), "99 marks do not fit");
        let mut each = writer.list::<f32>();
        marks.iter().for_each(|mark| each.push(mark.radius_mm));
        assert_eq!((each.len(), each.is_empty()), (1, false));
        let each = each.end().unwrap();
        let (lent, room) = writer.lend::<SceneMark>(1).unwrap();
        room.copy_from_slice(&marks);
        let bytes: &[u8] = bytemuck::cast_slice(&payload);
        assert_eq!(section::<u8>(bytes, text).unwrap(), b"hello");
        assert_eq!(section::<SceneMark>(bytes, at).unwrap(), &marks);
        assert_eq!(section::<f32>(bytes, each).unwrap(), &[0.5]);
        assert_eq!(section::<SceneMark>(bytes, lent).unwrap(), &marks);
        assert!(section::<SceneMark>(bytes, Section { offset: at.offset, count: 99 }).is_err());
        assert!(section::<u8>(bytes, Section { offset: u32::MAX, count: u32::MAX }).is_err());
    }
}
