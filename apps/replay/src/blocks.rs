//! What a simulation sends of its world, if no channel lends memory for it.

use protocol::scene::SceneHeader;
use protocol::time::Instants;
use simcore::scene_block::{SceneWriter, bytes_needed};
use simcore::world::World;

/// Makes scene blocks of a world, one in the place of the other.
#[derive(Debug)]
pub struct Blocks {
    writer: SceneWriter,
    payload: Vec<u128>,
}

impl Blocks {
    /// With room for a world's scene.
    pub fn new(world: &World) -> Self {
        let bytes = bytes_needed(
            world.sheet(),
            world.adhesion().is_some(),
            world.vitreous().map(|(v, _)| v),
            world.retina().map(|r| &r.body.mesh),
        );
        Blocks { writer: SceneWriter::new(world), payload: vec![0; bytes.div_ceil(size_of::<u128>())] }
    }

    /// Bytes of the largest payload.
    pub fn capacity(&self) -> usize {
        self.payload.len() * size_of::<u128>()
    }

    /// To be called when the world was reset or restored.
    pub fn forget(&mut self) {
        self.writer.forget();
    }

    /// The scene of `world`: header and payload.
    pub fn make(&mut self, world: &World, instants: Instants, state_hash: u64) -> (SceneHeader, &[u8]) {
        let payload = bytemuck::cast_slice_mut(&mut self.payload);
        let header = self.writer.write(world, instants, state_hash, payload);
        (header, bytemuck::cast_slice(&self.payload))
    }
}
