//! What a tracker knows as bytes. The only module of the crate that names bincode.
//!
//! A checkpoint is made between two frames. It holds what the next frame depends on and what does not
//! follow from the rig: filters, predictors, the newest blobs of each camera, where cameras and markers
//! are estimated to be, and what is held against a camera. A tracker that goes on from it makes the
//! same poses, to the bit. Covariances are symmetric to the bit nearly always, and then only half of
//! them is written.
//!
//! Each module writes and reads its own share (`save`, `load`); sizes follow from the rig, so that no
//! length in the bytes is believed.

use crate::tracker::Tracker;
use bincode::config::{Configuration, Fixint, Limit, LittleEndian};
use nalgebra::{Isometry3, Matrix3, Quaternion, UnitQuaternion};
use protocol::limits::MAX_CHECKPOINT_BYTES;
use serde::de::DeserializeOwned;
use serde::{Deserialize, Serialize};

/// Version of the meaning of the bytes; another one is refused.
pub const VERSION: u32 = 2;
/// Instants and counts from here on are damage, so that nothing that is added to them overflows.
const MOST: u64 = 1 << 62;
/// By how much a rotation may miss being one.
const ROTATION_TOLERANCE: f64 = 1e-6;

/// Why a checkpoint was refused.
#[derive(Debug, Clone, PartialEq, thiserror::Error)]
pub enum CheckpointError {
    /// The bytes are no checkpoint.
    #[error("checkpoint of {bytes} bytes: {problem}")]
    Damaged {
        /// Bytes there are.
        bytes: usize,
        /// The decoder's message.
        problem: String,
    },
    /// Made by another version of the program.
    #[error("checkpoint has version {found}, this build reads {VERSION}")]
    Version {
        /// Its version.
        found: u32,
    },
    /// Made with another rig, or by a tracker that does not estimate the rig's drift alike.
    #[error("checkpoint belongs to another rig (fingerprint {found:016x}, this rig has {expected:016x})")]
    Rig {
        /// Fingerprint of the rig at hand.
        expected: u64,
        /// Fingerprint in the checkpoint.
        found: u64,
    },
    /// Numbers in it make no sense.
    #[error("checkpoint: {0}")]
    Content(&'static str),
}

#[derive(Serialize, Deserialize)]
struct Header {
    version: u32,
    rig: u64,
}

type Config = Configuration<LittleEndian, Fixint, Limit<MAX_CHECKPOINT_BYTES>>;

fn config() -> Config {
    bincode::config::standard().with_fixed_int_encoding().with_limit::<MAX_CHECKPOINT_BYTES>()
}

/// What writing or reading a share ends in.
pub(crate) type Done = Result<(), CheckpointError>;

impl Tracker {
    /// Writes what it knows into `out`, whose memory is used again.
    ///
    /// # Errors
    /// [`CheckpointError`] when the encoder fails.
    // Its copy of the states is large: not in the frame of a caller, who keeps it.
    #[inline(never)]
    pub fn save(&self, out: &mut Vec<u8>) -> Result<(), CheckpointError> {
        out.clear();
        let mut saver = Saver(out);
        saver.put(&Header { version: VERSION, rig: self.fingerprint() })?;
        self.save_state(&mut saver)
    }

    /// Goes on from what a tracker of the same rig has saved. A tracker with numbers that are not
    /// finite, which it would have dropped itself soon, saves what is refused here.
    ///
    /// # Errors
    /// [`CheckpointError`] for bytes that are damaged or belong to another rig; nothing changes then.
    pub fn restore(&mut self, bytes: &[u8]) -> Result<(), CheckpointError> {
        let mut loader = Loader { bytes, read: 0 };
        let header: Header = loader.take()?;
        if header.version != VERSION {
            return Err(CheckpointError::Version { found: header.version });
        }
        let expected = self.fingerprint();
        if header.rig != expected {
            return Err(CheckpointError::Rig { expected, found: header.rig });
        }
        let mut restored = self.snapshot();
        restored.0.load_state(&mut loader)?;
        if loader.read != bytes.len() {
            return Err(CheckpointError::Content("bytes after its end"));
        }
        self.take_over(*restored.0);
        Ok(())
    }
}

/// Writes a checkpoint.
pub(crate) struct Saver<'a>(&'a mut Vec<u8>);

impl Saver<'_> {
    /// Anything.
    pub fn put<T: Serialize + ?Sized>(&mut self, value: &T) -> Done {
        let fail =
            |e: bincode::error::EncodeError| CheckpointError::Damaged { bytes: 0, problem: e.to_string() };
        bincode::serde::encode_into_std_write(value, self.0, config()).map(drop).map_err(fail)
    }

    /// Numbers, without their count.
    pub fn numbers<'n>(&mut self, numbers: impl IntoIterator<Item = &'n f64>) -> Done {
        numbers.into_iter().try_for_each(|number| self.put(number))
    }

    /// A square matrix of `n` rows: half of it where it is symmetric to the bit.
    pub fn square(&mut self, n: usize, at: impl Fn(usize, usize) -> f64) -> Done {
        let same = |r: usize| (0..r).all(|c| at(r, c).to_bits() == at(c, r).to_bits());
        let symmetric = (0..n).all(same);
        self.put(&symmetric)?;
        for r in 0..n {
            for c in 0..if symmetric { r + 1 } else { n } {
                self.put(&at(r, c))?;
            }
        }
        Ok(())
    }

    /// A pose.
    pub fn pose(&mut self, pose: &Isometry3<f64>) -> Done {
        self.numbers(pose.translation.vector.as_slice())?;
        self.rotation(&pose.rotation)
    }

    /// A rotation.
    pub fn rotation(&mut self, rotation: &UnitQuaternion<f64>) -> Done {
        self.numbers(rotation.coords.as_slice())
    }
}

/// Reads a checkpoint.
pub(crate) struct Loader<'a> {
    bytes: &'a [u8],
    read: usize,
}

impl Loader<'_> {
    /// Anything; of numbers in it nothing is known.
    pub fn take<T: DeserializeOwned>(&mut self) -> Result<T, CheckpointError> {
        let fail = |e: bincode::error::DecodeError| CheckpointError::Damaged {
            bytes: self.bytes.len(),
            problem: e.to_string(),
        };
        let rest = &self.bytes[self.read..];
        let (value, read) = bincode::serde::decode_from_slice(rest, config()).map_err(fail)?;
        self.read += read;
        Ok(value)
    }

    /// A finite number.
    pub fn number(&mut self) -> Result<f64, CheckpointError> {
        let number: f64 = self.take()?;
        require(number.is_finite(), "a number is not finite")?;
        Ok(number)
    }

    /// A finite number within a range.
    pub fn within(&mut self, low: f64, high: f64) -> Result<f64, CheckpointError> {
        let number = self.number()?;
        require((low..=high).contains(&number), "a number is out of range")?;
        Ok(number)
    }

    /// Finite numbers, as many as there is room for.
    pub fn numbers<'n>(&mut self, room: impl IntoIterator<Item = &'n mut f64>) -> Done {
        room.into_iter().try_for_each(|slot| self.number().map(|number| *slot = number))
    }

    /// A square matrix of `n` rows.
    pub fn square(&mut self, n: usize, mut set: impl FnMut(usize, usize, f64)) -> Done {
        let symmetric: bool = self.take()?;
        for r in 0..n {
            for c in 0..if symmetric { r + 1 } else { n } {
                let number = self.number()?;
                set(r, c, number);
                if symmetric {
                    set(c, r, number);
                }
            }
        }
        Ok(())
    }

    /// An instant, ns, or a count of what may have been.
    pub fn count(&mut self) -> Result<u64, CheckpointError> {
        self.below(MOST)
    }

    /// A count of at most 32 bits.
    pub fn small_count(&mut self) -> Result<u32, CheckpointError> {
        Ok(self.below(1 << 30)? as u32)
    }

    /// An index or a count below `end`.
    pub fn below(&mut self, end: u64) -> Result<u64, CheckpointError> {
        let count: u64 = self.take()?;
        require(count < end, "a count is out of range")?;
        Ok(count)
    }

    /// A pose.
    pub fn pose(&mut self) -> Result<Isometry3<f64>, CheckpointError> {
        let mut pose = Isometry3::identity();
        self.numbers(pose.translation.vector.as_mut_slice())?;
        pose.rotation = self.rotation()?;
        Ok(pose)
    }

    /// A rotation.
    pub fn rotation(&mut self) -> Result<UnitQuaternion<f64>, CheckpointError> {
        let mut quaternion = Quaternion::identity();
        self.numbers(quaternion.coords.as_mut_slice())?;
        require((quaternion.norm() - 1.0).abs() < ROTATION_TOLERANCE, "a quaternion has not length 1")?;
        Ok(UnitQuaternion::new_unchecked(quaternion))
    }

    /// A rotation matrix.
    pub fn rotation_matrix(&mut self) -> Result<Matrix3<f64>, CheckpointError> {
        let mut matrix = Matrix3::zeros();
        self.numbers(matrix.as_mut_slice())?;
        let off = (matrix * matrix.transpose() - Matrix3::identity()).norm();
        require(
            off < ROTATION_TOLERANCE && matrix.determinant() > 0.0,
            "a camera's matrix is not a rotation",
        )?;
        Ok(matrix)
    }
}

/// Refuses a checkpoint unless something holds.
pub(crate) fn require(holds: bool, problem: &'static str) -> Done {
    if holds { Ok(()) } else { Err(CheckpointError::Content(problem)) }
}
