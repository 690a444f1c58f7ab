//! The state as bytes: checkpoints, and the state hash. The only module that names bincode, but for
//! the tests of [`tissue::pod_serde`].
//!
//! Both come from the one serialisation of [`State`], so that the hash covers what a checkpoint
//! would restore, and nothing that is left out of it can influence a later step. The doses of light
//! are restored and not hashed: they influence nothing.

use crate::constants::MAX_MARKS;
use crate::state::State;
use crate::ticks::TickState;
use bincode::config::{Configuration, Fixint, Limit, LittleEndian};
use bincode::enc::write::Writer;
use bincode::error::EncodeError;
use protocol::handles::Tool;
use protocol::limits::MAX_CHECKPOINT_BYTES;
use protocol::steps::{InputsDigest, StepInput};
use serde::{Deserialize, Serialize};

/// Version of the state's meaning; another one is refused.
pub const VERSION: u32 = 9;
/// The last version in which a scene without a task has the same state, but for what has come together since
/// the last tick; its states are of 50 Hz, where every step ends with one.
const WITHOUT_TASK: u32 = 7;

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
    /// Made in another scene.
    #[error("checkpoint belongs to another scene (fingerprint {found:016x}, this scene has {expected:016x})")]
    Scene {
        /// Fingerprint of the scene at hand.
        expected: u64,
        /// Fingerprint in the checkpoint.
        found: u64,
    },
    /// A sheet in it is not the scene's.
    #[error("checkpoint: the {sheet}: {problem}")]
    Sheet {
        /// Which one.
        sheet: &'static str,
        /// What is wrong with it.
        problem: &'static str,
    },
    /// Numbers in it make no sense.
    #[error("checkpoint: {0}")]
    Content(&'static str),
}

#[derive(Serialize, Deserialize)]
struct Header {
    version: u32,
    scene: u64,
}

type Config = Configuration<LittleEndian, Fixint, Limit<MAX_CHECKPOINT_BYTES>>;

fn config() -> Config {
    bincode::config::standard().with_fixed_int_encoding().with_limit::<MAX_CHECKPOINT_BYTES>()
}

/// Encodes a state into `out`, whose memory is used again.
///
/// # Errors
/// [`CheckpointError`] when the encoder fails.
pub fn encode(state: &State, scene: u64, out: &mut Vec<u8>) -> Result<(), CheckpointError> {
    out.clear();
    let fail = |e: EncodeError| CheckpointError::Damaged { bytes: 0, problem: e.to_string() };
    let header = Header { version: VERSION, scene };
    bincode::serde::encode_into_std_write(&header, out, config()).map_err(fail)?;
    bincode::serde::encode_into_std_write(state, out, config()).map_err(fail)?;
    bincode::serde::encode_into_std_write(&state.dose.mj_mm2, out, config()).map_err(fail)?;
    bincode::serde::encode_into_std_write(state.ticks, out, config()).map_err(fail)?;
    Ok(())
}

/// Decodes and checks a checkpoint.
///
/// # Errors
/// [`CheckpointError`] for bytes that are damaged, of another version or of another scene.
pub fn decode(bytes: &[u8], scene: u64) -> Result<State, CheckpointError> {
    let fail = |e: bincode::error::DecodeError| CheckpointError::Damaged {
        bytes: bytes.len(),
        problem: e.to_string(),
    };
    let (header, read): (Header, usize) = bincode::serde::decode_from_slice(bytes, config()).map_err(fail)?;
    let other = CheckpointError::Version { found: header.version };
    if !(WITHOUT_TASK..=VERSION).contains(&header.version) {
        return Err(other);
    }
    if header.scene != scene {
        return Err(CheckpointError::Scene { expected: scene, found: header.scene });
    }
    let own = header.version == VERSION;
    let decoded: Result<(State, usize), _> = bincode::serde::decode_from_slice(&bytes[read..], config());
    let (mut state, rest) = match decoded {
        Ok((state, rest)) if own || state.task.is_none() => (state, rest),
        Err(problem) if own => return Err(fail(problem)),
        _ => return Err(other),
    };
    let mut end = read + rest;
    let doses;
    (state.dose.mj_mm2, doses) = bincode::serde::decode_from_slice(&bytes[end..], config()).map_err(fail)?;
    end += doses;
    state.ticks = TickState::at_tick(&state.instruments);
    if own {
        let ticks;
        (state.ticks, ticks) = bincode::serde::decode_from_slice(&bytes[end..], config()).map_err(fail)?;
        end += ticks;
    }
    if end != bytes.len() {
        return Err(CheckpointError::Content("bytes after its end"));
    }
    check(&state)?;
    Ok(state)
}

/// Refuses a state that holds bad numbers; the sheets and whatever depends on the scene are checked
/// by their owners.
fn check(state: &State) -> Result<(), CheckpointError> {
    if state.stain.as_ref().is_some_and(|s| s.dye.len() != state.membrane.nodes()) {
        return Err(CheckpointError::Content("the dye is on another membrane"));
    }
    check_instruments(state)?;
    if !state.dose.is_sound() {
        return Err(CheckpointError::Content("doses of light are out of range"));
    }
    if !state.ticks.is_sound() {
        return Err(CheckpointError::Content("what is kept for the next tick is out of range"));
    }
    if !state.tools.is_sound() {
        return Err(CheckpointError::Content("pump, blade or syringe are out of range"));
    }
    let poses = state.instruments.iter().flat_map(|i| [&i.eye_from_instrument, &i.world_from_instrument]);
    let mut poses = poses.chain([&state.world_from_eye]);
    if !poses.all(|p| protocol::geometry::Pose::from_isometry(p).is_valid()) {
        return Err(CheckpointError::Content("a pose is not rigid"));
    }
    Ok(())
}

/// Openings in range, known tools, lists within their capacity.
fn check_instruments(state: &State) -> Result<(), CheckpointError> {
    for instrument in &state.instruments {
        let jaws = [instrument.jaw_rad, instrument.jaw_target_rad];
        let jaws_ok = jaws.iter().all(|j| (0.0..=std::f64::consts::PI).contains(j));
        if !jaws_ok || Tool::from_wire(instrument.tool).is_none() {
            return Err(CheckpointError::Content("an instrument is out of range"));
        }
    }
    if state.marks.len() > MAX_MARKS {
        return Err(CheckpointError::Content("there are too many marks"));
    }
    Ok(())
}

/// FNV-1a over words of eight bytes: a number of the state is one word, and of a list of numbers
/// eight bytes are. A single changed word always changes the hash, because each round is a
/// bijection. Long lists go through eight such hashes in turn, whose rounds a processor does side
/// by side, and those into the one.
struct HashWriter(u64);

const FNV_BASIS: u64 = 0xcbf2_9ce4_8422_2325;
const FNV_PRIME: u64 = 0x0000_0100_0000_01b3;
const WORD: usize = size_of::<u64>();
/// Hashes of a long list.
const LANES: usize = 8;

impl HashWriter {
    fn round(hash: &mut u64, bytes: &[u8]) {
        let mut word = [0; WORD];
        word[..bytes.len()].copy_from_slice(bytes);
        *hash = (*hash ^ u64::from_le_bytes(word)).wrapping_mul(FNV_PRIME);
    }
}

impl Writer for HashWriter {
    fn write(&mut self, bytes: &[u8]) -> Result<(), EncodeError> {
        let turns = bytes.chunks_exact(LANES * WORD);
        let mut rest = turns.remainder();
        if rest.len() < bytes.len() {
            let mut lanes = [FNV_BASIS; LANES];
            for turn in turns {
                lanes
                    .iter_mut()
                    .zip(turn.chunks_exact(WORD))
                    .for_each(|(lane, word)| Self::round(lane, word));
            }
            lanes.iter().for_each(|lane| Self::round(&mut self.0, &lane.to_le_bytes()));
        }
        while !rest.is_empty() {
            let (word, after) = rest.split_at(rest.len().min(WORD));
            Self::round(&mut self.0, word);
            rest = after;
        }
        Ok(())
    }
}

/// Hash of a state.
pub fn state_hash(state: &State) -> u64 {
    let mut writer = HashWriter(FNV_BASIS);
    // The writer cannot fail, and a state is plain tables; a failure would show as a hash that
    // differs.
    let _ = bincode::serde::encode_into_writer(state, &mut writer, config());
    // After a tick it follows from the rest.
    if state.ticks != TickState::at_tick(&state.instruments) {
        let _ = bincode::serde::encode_into_writer(state.ticks, &mut writer, config());
    }
    writer.0
}

/// Digest of what a step consumes, of all that the simulation reads and a recording keeps.
pub fn inputs_digest(input: &StepInput) -> InputsDigest {
    let StepInput { frame, handles, pedals } = input;
    let mut writer = HashWriter(FNV_BASIS);
    let key = [frame.field, frame.frame, frame.instants.exposed];
    let parts: [&[u8]; 4] = [
        bytemuck::cast_slice(&key),
        bytemuck::cast_slice(&frame.bodies),
        bytemuck::cast_slice(handles),
        bytemuck::cast_slice(pedals),
    ];
    // The writer cannot fail.
    parts.iter().for_each(|part| drop(writer.write(part)));
    InputsDigest { hash: writer.0.max(1), handles: handles.len() as u32, pedals: pedals.len() as u32 }
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::state::OpticsState;
    use crate::world::World;
    use proptest::prelude::*;
    use scene::SceneFile;
    use tissue::sheet::stain::StainState;

    fn world() -> World {
        World::new(&SceneFile::load("peel").unwrap()).unwrap()
    }

    #[test]
    fn a_state_comes_back() {
        let world = world();
        let mut bytes = Vec::new();
        encode(world.state(), 7, &mut bytes).unwrap();
        assert_eq!(&decode(&bytes, 7).unwrap(), world.state());
        assert!(bytes.len() < MAX_CHECKPOINT_BYTES);
    }

    #[test]
    fn foreign_and_damaged_checkpoints_are_refused() {
        let world = world();
        let mut bytes = Vec::new();
        encode(world.state(), 7, &mut bytes).unwrap();
        assert!(matches!(decode(&bytes, 8), Err(CheckpointError::Scene { .. })));
        for end in [0, 3, 12, bytes.len() / 2, bytes.len() - 1] {
            assert!(matches!(decode(&bytes[..end], 7), Err(CheckpointError::Damaged { .. })));
        }
        let mut longer = bytes.clone();
        longer.push(0);
        assert!(decode(&longer, 7).is_err());
        let mut other = bytes.clone();
        other[0] = 10;
        assert_eq!(decode(&other, 7), Err(CheckpointError::Version { found: 10 }));
    }

    #[test]
    fn a_checkpoint_belongs_to_the_scene_whoever_works_in_it() {
        let scene = SceneFile::load("peel").unwrap();
        let mut bytes = Vec::new();
        World::new(&scene).unwrap().save(&mut bytes).unwrap();
        World::new(&scene.without_script()).unwrap().restore(&bytes).unwrap();
        let mut other = scene.clone();
        other.eye.retina_radius_mm += 0.1;
        let refused = World::new(&other).unwrap().restore(&bytes);
        assert!(matches!(refused, Err(CheckpointError::Scene { .. })), "{refused:?}");
    }

    #[test]
    fn a_state_of_the_version_before_comes_back_where_it_has_no_task() {
        let world = world();
        let mut bytes = Vec::new();
        encode(world.state(), 7, &mut bytes).unwrap();
        let mut ticks = Vec::new();
        bincode::serde::encode_into_std_write(world.state().ticks, &mut ticks, config()).unwrap();
        bytes.truncate(bytes.len() - ticks.len());
        assert!(matches!(decode(&bytes, 7), Err(CheckpointError::Damaged { .. })));
        bytes[0] = 8;
        assert_eq!(&decode(&bytes, 7).unwrap(), world.state());
        let module = surgeon::load("navigation").unwrap();
        let scene = surgeon::compose(&module, 1, &surgeon::skill::EXPERT, 1).unwrap();
        encode(World::new(&scene).unwrap().state(), 7, &mut bytes).unwrap();
        bytes[0] = 8;
        assert_eq!(decode(&bytes, 7), Err(CheckpointError::Version { found: 8 }));
    }

    #[test]
    fn optics_are_saved_where_there_are_some() {
        let world = world();
        let mut bytes = Vec::new();
        let mut state = world.state().clone();
        assert_eq!(state.optics, None);
        state.optics = Some(OpticsState { buttons: 4, lens: 2, inverter: true, filter: 3 });
        encode(&state, 7, &mut bytes).unwrap();
        assert_eq!(decode(&bytes, 7).unwrap(), state);
    }

    #[test]
    fn random_damage_never_panics() {
        let world = world();
        let mut bytes = Vec::new();
        encode(world.state(), 7, &mut bytes).unwrap();
        let mut seed = 1u64;
        for _ in 0..300 {
            let mut broken = bytes.clone();
            for _ in 0..4 {
                seed = seed.wrapping_mul(6364136223846793005).wrapping_add(1442695040888963407);
                let at = (seed >> 33) as usize % broken.len();
                broken[at] = (seed >> 20) as u8;
            }
            let _ = decode(&broken, 7);
        }
    }

    proptest! {
        #[test]
        fn the_hash_sees_every_byte_and_the_order(
            bytes in prop::collection::vec(any::<u8>(), 1..400), at in any::<prop::sample::Index>(), flip in 1u8..,
        ) {
            let hash = |bytes: &[u8]| {
                let mut writer = HashWriter(FNV_BASIS);
                writer.write(bytes).unwrap();
                writer.0
            };
            let (at, mut other) = (at.index(bytes.len()), bytes.clone());
            other[at] ^= flip;
            prop_assert_ne!(hash(&bytes), hash(&other));
            let mut turned = bytes.clone();
            turned.rotate_left(WORD.min(bytes.len()));
            prop_assert!(turned == bytes || hash(&bytes) != hash(&turned));
        }
    }

    #[test]
    fn the_hash_sees_every_part() {
        let world = world();
        let hash = state_hash(world.state());
        let changes: [fn(&mut State); 9] = [
            |s| s.step += 1,
            |s| s.membrane.velocity_mm_s[2][5] = 1e-30,
            |s| s.membrane.triangle_alive[3] = 0,
            |s| s.membrane.contact[1].under = true,
            |s| s.microscope.focus_mm = 0.1,
            |s| s.optics = Some(OpticsState::default()),
            |s| s.stain = Some(StainState::new(s.membrane.nodes())),
            |s| s.remainder_ns = 1,
            |s| s.ticks.from[1].translation.x = 1e-30,
        ];
        for change in changes {
            let mut state = world.state().clone();
            change(&mut state);
            assert_ne!(state_hash(&state), hash);
        }
    }
}
