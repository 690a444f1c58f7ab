//! The channels of the renderer's process.

use anyhow::Result;
use ipc::{BlockReceiver, BlockSender, Instance, Queue, Receiver, Sender};
use protocol::frames::{FrameRecord, PictureHeader};
use protocol::limits::MAX_PICTURE_BYTES;
use protocol::poses::TrackerFrame;
use protocol::scene::SceneHeader;

/// The channels.
pub(super) struct Channels {
    pub(super) poses: Receiver<TrackerFrame>,
    pub(super) scenes: BlockReceiver<SceneHeader>,
    pub(super) frames: Sender<FrameRecord>,
    pub(super) pictures: BlockSender<PictureHeader>,
}

impl Channels {
    /// Opens the channels of an instance.
    ///
    /// # Errors
    /// If one of them cannot be opened.
    pub(super) fn open(instance: &Instance) -> Result<Self> {
        Ok(Channels {
            poses: instance.receiver(Queue::Newest)?,
            scenes: instance.block_receiver()?,
            frames: instance.sender()?,
            pictures: instance.block_sender(MAX_PICTURE_BYTES)?,
        })
    }
}
