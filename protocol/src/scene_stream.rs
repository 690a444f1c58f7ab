//! A stream of scenes in a pipe or a file, from simulation to renderer where no clock runs, as for
//! a film.
//!
//! A line with name and schema hash, then for each scene its header, the length of its payload, and
//! the payload.

use crate::message::Message;
use crate::scene::SceneHeader;
use std::io::{ErrorKind, Read, Write};

/// First bytes of a stream; the hash of the header's layout follows.
const NAME: &[u8; 16] = b"vitreo-scenes-1\n";
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
    out.write_all(&SceneHeader::SCHEMA.to_le_bytes())
}

/// Writes a scene.
///
/// # Errors
/// Those of the operating system.
pub fn write(out: &mut impl Write, header: &SceneHeader, payload: &[u8]) -> std::io::Result<()> {
    out.write_all(bytemuck::bytes_of(header))?;
    out.write_all(&(payload.len() as u64).to_le_bytes())?;
    out.write_all(payload)
}

/// Reads a stream.
pub struct Reader<R> {
    from: R,
    payload: Vec<u128>,
    read: u64,
}

impl<R: Read> Reader<R> {
    /// Reads the beginning.
    ///
    /// # Errors
    /// [`StreamError::Foreign`] for anything but a stream of this build.
    pub fn new(mut from: R) -> Result<Self, StreamError> {
        let (mut name, mut schema) = ([0; NAME.len()], [0; 8]);
        from.read_exact(&mut name)?;
        from.read_exact(&mut schema)?;
        if &name != NAME || u64::from_le_bytes(schema) != SceneHeader::SCHEMA {
            return Err(StreamError::Foreign);
        }
        Ok(Reader { from, payload: Vec::new(), read: 0 })
    }

    /// The next scene with its payload; `None` at the end.
    ///
    /// # Errors
    /// A cut stream, or a scene that makes no sense.
    pub fn next_scene(&mut self) -> Result<Option<(SceneHeader, &[u8])>, StreamError> {
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
        let mut length = [0; 8];
        self.from.read_exact(&mut length)?;
        let length = u64::from_le_bytes(length);
        if length > crate::limits::MAX_SCENE_BYTES as u64 {
            return Err(bad(format!("a payload of {length} bytes")));
        }
        self.payload.resize((length as usize).div_ceil(UNIT), 0);
        let payload = &mut bytemuck::cast_slice_mut(&mut self.payload)[..length as usize];
        self.from.read_exact(payload)?;
        self.read += 1;
        Ok(Some((header, payload)))
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::geometry::Pose;
    use bytemuck::Zeroable;

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
            write(&mut bytes, &header, &vec![step as u8; 32 * step as usize]).unwrap();
        }
        bytes
    }

    #[test]
    fn scenes_come_back_in_order() {
        let bytes = stream();
        let mut reader = Reader::new(&bytes[..]).unwrap();
        for step in 1..4u64 {
            let (header, payload) = reader.next_scene().unwrap().unwrap();
            assert_eq!((header.step, payload), (step, &vec![step as u8; 32 * step as usize][..]));
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
        let mut bent = bytes.clone();
        let length_at = NAME.len() + 8 + size_of::<SceneHeader>();
        bent[length_at + 7] = 0xff;
        let problem = Reader::new(&bent[..]).unwrap().next_scene().unwrap_err().to_string();
        assert!(problem.contains("scene 0") && problem.contains("bytes"), "{problem}");
    }
}
