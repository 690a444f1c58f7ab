//! A stream of scenes in a pipe or a file, from simulation to renderer where no clock runs, as for
//! a film.
//!
//! A line with name and schema hashes, then for each scene its header, the poses that its step was made
//! of, the length of its payload, and the payload.

use crate::message::Message;
use crate::poses::TrackerFrame;
use crate::scene::SceneHeader;
use bytemuck::Pod;
use std::io::{ErrorKind, Read, Write};

/// First bytes of a stream; the hashes of the layouts of header and poses follow.
const NAME: &[u8; 16] = b"vitreo-scenes-2\n";
/// The hashes.
const SCHEMAS: [u64; 2] = [SceneHeader::SCHEMA, TrackerFrame::SCHEMA];
/// Payloads consist of units of this size, bytes.
const UNIT: usize = 16;

/// Why a stream ended early.
#[derive(Debug, thiserror::Error)]
pub enum StreamError {
    /// The operating system refused, or the stream ends within a scene.
    #[error("stream of scenes: {0}")]
    Io(#[from] std::io::Error),
    /// Something else, or the scenes of another build.
    #[error("stream of scenes: expected one of this build, found something else")]
    Foreign,
    /// A scene that makes no sense.
    #[error("stream of scenes: scene {number}: {problem}")]
    Scene {
        /// Its number from 0 on.
        number: u64,
        /// What is wrong.
        problem: String,
    },
}

/// Begins a stream.
///
/// # Errors
/// Those of the operating system.
pub fn begin(out: &mut impl Write) -> std::io::Result<()> {
    out.write_all(NAME)?;
    SCHEMAS.iter().try_for_each(|schema| out.write_all(&schema.to_le_bytes()))
}

/// Writes a scene.
///
/// # Errors
/// Those of the operating system.
pub fn write(
    out: &mut impl Write,
    header: &SceneHeader,
    poses: &TrackerFrame,
    payload: &[u8],
) -> std::io::Result<()> {
    out.write_all(bytemuck::bytes_of(header))?;
    out.write_all(bytemuck::bytes_of(poses))?;
    out.write_all(&(payload.len() as u64).to_le_bytes())?;
    out.write_all(payload)
}

/// A scene of a stream.
#[derive(Debug)]
pub struct StreamedScene<'a> {
    /// Its header.
    pub header: SceneHeader,
    /// The poses that its step was made of, with their validity.
    pub poses: &'a TrackerFrame,
    /// Its payload.
    pub payload: &'a [u8],
}

/// Reads a stream.
pub struct Reader<R> {
    from: R,
    poses: Box<TrackerFrame>,
    payload: Vec<u128>,
    read: u64,
}

impl<R: Read> Reader<R> {
    /// Reads the beginning.
    ///
    /// # Errors
    /// [`StreamError::Foreign`] for anything but a stream of this build.
    pub fn new(mut from: R) -> Result<Self, StreamError> {
        let (mut name, mut schemas) = ([0; NAME.len()], [0; SCHEMAS.len()]);
        from.read_exact(&mut name)?;
        if &name != NAME {
            return Err(StreamError::Foreign);
        }
        for schema in &mut schemas {
            *schema = u64::from_le_bytes(read_plain(&mut from)?);
        }
        if schemas != SCHEMAS {
            return Err(StreamError::Foreign);
        }
        let poses = Box::new(bytemuck::Zeroable::zeroed());
        Ok(Reader { from, poses, payload: Vec::new(), read: 0 })
    }

    /// The next scene; `None` at the end.
    ///
    /// # Errors
    /// A cut stream, or a scene that makes no sense.
    pub fn next_scene(&mut self) -> Result<Option<StreamedScene<'_>>, StreamError> {
        let mut bytes = [0; size_of::<SceneHeader>()];
        let mut have = 0;
        while have < bytes.len() {
            match self.from.read(&mut bytes[have..]) {
                Ok(0) if have == 0 => return Ok(None),
                Ok(0) => return Err(std::io::Error::from(ErrorKind::UnexpectedEof).into()),
                Ok(n) => have += n,
                Err(e) if e.kind() == ErrorKind::Interrupted => {}
                Err(e) => return Err(e.into()),
            }
        }
        let header: SceneHeader = bytemuck::pod_read_unaligned(&bytes);
        let number = self.read;
        let bad = |problem: String| StreamError::Scene { number, problem };
        header.validate().map_err(|e| bad(e.to_string()))?;
        *self.poses = read_plain(&mut self.from)?;
        self.poses.validate().map_err(|e| bad(e.to_string()))?;
        let length = u64::from_le_bytes(read_plain(&mut self.from)?);
        if length > crate::limits::MAX_SCENE_BYTES as u64 {
            return Err(bad(format!("a payload of {length} bytes")));
        }
        self.payload.resize((length as usize).div_ceil(UNIT), 0);
        let payload = &mut bytemuck::cast_slice_mut(&mut self.payload)[..length as usize];
        self.from.read_exact(payload)?;
        self.read += 1;
        Ok(Some(StreamedScene { header, poses: &self.poses, payload }))
    }
}

/// A plain value as it lies in memory.
fn read_plain<T: Pod>(from: &mut impl Read) -> std::io::Result<T> {
    let mut value = T::zeroed();
    from.read_exact(bytemuck::bytes_of_mut(&mut value))?;
    Ok(value)
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::geometry::Pose;
    use crate::poses::BodyState;
    use bytemuck::Zeroable;
    use std::mem::offset_of;

    fn poses(frame: u64) -> TrackerFrame {
        let mut poses = TrackerFrame { frame, ..TrackerFrame::zeroed() };
        poses.instants.exposed = frame;
        poses.bodies.iter_mut().for_each(|b| b.world_from_body = Pose::IDENTITY);
        poses
    }

    fn stream() -> Vec<u8> {
        let mut bytes = Vec::new();
        begin(&mut bytes).unwrap();
        for step in 1..4u64 {
            let mut header = SceneHeader::zeroed();
            (header.step, header.world_from_eye) = (step, Pose::IDENTITY);
            header.instruments.iter_mut().for_each(|i| i.world_from_instrument = Pose::IDENTITY);
            header.instants.exposed = step;
            (header.microscope.field_mm, header.microscope.working_distance_mm) = (16.0, 200.0);
            header.validate().unwrap();
            write(&mut bytes, &header, &poses(step), &vec![step as u8; 32 * step as usize]).unwrap();
        }
        bytes
    }

    #[test]
    fn scenes_come_back_in_order() {
        let bytes = stream();
        let mut reader = Reader::new(&bytes[..]).unwrap();
        for step in 1..4u64 {
            let scene = reader.next_scene().unwrap().unwrap();
            assert_eq!((scene.header.step, scene.poses.frame), (step, step));
            assert_eq!(scene.payload, vec![step as u8; 32 * step as usize]);
        }
        assert!(reader.next_scene().unwrap().is_none());
    }

    #[test]
    fn a_cut_or_foreign_stream_is_refused() {
        let bytes = stream();
        assert!(matches!(Reader::new(&b"YUV4MPEG2 W4 H4 and so on"[..]), Err(StreamError::Foreign)));
        assert!(matches!(Reader::new(&bytes[..7]), Err(StreamError::Io(_))));
        let mut cut = Reader::new(&bytes[..bytes.len() - 1]).unwrap();
        let last = (0..3).map(|_| cut.next_scene().map(|s| s.is_some())).last().unwrap();
        assert!(matches!(last, Err(StreamError::Io(_))));
        let header_at = NAME.len() + size_of_val(&SCHEMAS);
        let poses_at = header_at + size_of::<SceneHeader>();
        let length_at = poses_at + size_of::<TrackerFrame>();
        let validity_at = poses_at + offset_of!(TrackerFrame, bodies) + offset_of!(BodyState, validity);
        for (at, told) in [(length_at + 7, "bytes"), (validity_at, "TrackerFrame")] {
            let mut bent = bytes.clone();
            bent[at] = 0xff;
            let problem = Reader::new(&bent[..]).unwrap().next_scene().unwrap_err().to_string();
            assert!(problem.contains("scene 0") && problem.contains(told), "{problem}");
        }
    }
}
