//! The transport within one process: order, newest-wins, loss counts, blocks, wake-up, schemas.

use bytemuck::{Pod, Zeroable};
use ipc::clock::now;
use ipc::{Instance, IpcError, Queue, wait};
use protocol::blobs::Blob;
use protocol::message::{Invalid, Message, require};
use protocol::scene::{SceneNode, Section};
use protocol::steps::CheckpointHeader;
use protocol::wire::Wire;
use std::os::unix::fs::PermissionsExt;

#[repr(C)]
#[derive(Debug, Clone, Copy, PartialEq, Pod, Wire, Zeroable)]
struct Number {
    value: u64,
}

impl Message for Number {
    const CHANNEL: &'static str = "number";
    const VERSION: u32 = 1;
    const QUEUE: usize = 4;

    fn validate(&self) -> Result<(), Invalid> {
        require(self.value != 13, "Number", "value", "anything but 13", self.value as f64)
    }
}

/// The same channel as `Number`, of the same size, built from another source.
#[repr(C)]
#[derive(Debug, Clone, Copy, Pod, Wire, Zeroable)]
struct OtherNumber {
    renamed: u64,
}

impl Message for OtherNumber {
    const CHANNEL: &'static str = "number";
    const VERSION: u32 = 1;
    const QUEUE: usize = 4;

    fn validate(&self) -> Result<(), Invalid> {
        Ok(())
    }
}

fn instance(test: &str) -> Instance {
    Instance::own(&format!("t{}-{test}", std::process::id() % 1_000_000)).unwrap()
}

#[test]
fn blocks_arrive_in_order_and_losses_are_counted() {
    let instance = instance("order");
    let mut sender = instance.sender::<Number>().unwrap();
    let mut receiver = instance.receiver::<Number>(Queue::InOrder).unwrap();
    let mut newest = instance.receiver::<Number>(Queue::Newest).unwrap();
    for value in 0..3 {
        sender.send(&Number { value }).unwrap();
    }
    for value in 0..3 {
        assert_eq!(receiver.next_valid().unwrap(), Some(Number { value }));
    }
    assert_eq!(receiver.next_valid().unwrap(), None);
    for value in 20..30 {
        sender.send(&Number { value }).unwrap();
    }
    let rest: Vec<u64> = std::iter::from_fn(|| receiver.next_valid().unwrap()).map(|n| n.value).collect();
    assert_eq!(rest, [26, 27, 28, 29]);
    assert_eq!(receiver.counts().lost, 6);
    assert_eq!(newest.next_valid().unwrap(), Some(Number { value: 29 }));
}

#[test]
fn invalid_blocks_are_refused_and_counted() {
    let instance = instance("refuse");
    let mut sender = instance.sender::<Number>().unwrap();
    let mut receiver = instance.receiver::<Number>(Queue::InOrder).unwrap();
    sender.send(&Number { value: 13 }).unwrap();
    sender.send(&Number { value: 14 }).unwrap();
    let refused = receiver.receive().unwrap().unwrap().unwrap_err();
    assert!(refused.to_string().contains("Number.value"), "{refused}");
    assert_eq!(receiver.next_valid().unwrap(), Some(Number { value: 14 }));
    assert_eq!(receiver.counts().refused, 1);
}

#[test]
fn blocks_of_bytes_keep_header_and_payload() {
    let instance = instance("block");
    let mut sender = instance.block_sender::<CheckpointHeader>(1000).unwrap();
    let mut receiver = instance.block_receiver::<CheckpointHeader>().unwrap();
    for round in 1..=3u8 {
        let header = |bytes| CheckpointHeader { step: u64::from(round), bytes, ..Zeroable::zeroed() };
        sender
            .send(100, |payload| {
                payload[..100].fill(round);
                header(100)
            })
            .unwrap();
    }
    let sample = receiver.receive().unwrap().expect("a block");
    assert_eq!(sample.header().step, 3);
    assert_eq!(&sample.payload()[..100], [3; 100]);
    assert_eq!(sample.payload().as_ptr() as usize % 16, 0);
    let too_large = sender.send(1001, |_| Zeroable::zeroed()).unwrap_err();
    assert!(matches!(too_large, IpcError::TooLarge { bytes: 1001, .. }));
}

#[test]
fn a_wait_ends_with_a_notification_and_with_its_time() {
    let instance = instance("wait");
    let mut sender = instance.sender::<Number>().unwrap();
    let mut receiver = instance.receiver::<Number>(Queue::InOrder).unwrap();
    let start = now();
    wait(&[&receiver], 3_000_000);
    assert!(now() - start >= 3_000_000, "nothing was sent");
    sender.send(&Number { value: 1 }).unwrap();
    let start = now();
    wait(&[&receiver], 60_000_000_000);
    assert!(now() - start < 50_000_000_000, "woken, not timed out");
    assert_eq!(receiver.next_valid().unwrap(), Some(Number { value: 1 }));
}

#[test]
fn another_layout_is_refused_by_name() {
    let instance = instance("schema");
    let _sender = instance.sender::<Number>().unwrap();
    let refused = instance.receiver::<OtherNumber>(Queue::InOrder).err().expect("refused");
    assert!(matches!(refused, IpcError::SchemaDiffers { channel: "number", .. }), "{refused}");
    assert!(refused.to_string().contains("rebuild both"));
}

/// Declares a stand-in for a wire type of the product, on channel "stand-in".
macro_rules! stand_in {
    ($name:ident of $part:ty, $elements:ty) => {
        #[repr(C)]
        #[derive(Debug, Clone, Copy, Pod, Wire, Zeroable)]
        struct $name {
            part: $part,
            #[wire(elements = $elements)]
            section: Section,
        }

        impl Message for $name {
            const CHANNEL: &'static str = "stand-in";
            const VERSION: u32 = 1;
            const QUEUE: usize = 1;

            fn validate(&self) -> Result<(), Invalid> {
                Ok(())
            }
        }
    };
}

/// [`Blob`] with `x_px` and `y_field_px` in the other order.
#[repr(C)]
#[derive(Debug, Clone, Copy, Pod, Wire, Zeroable)]
struct SwappedBlob {
    y_field_px: f64,
    x_px: f64,
    area_px: f64,
    width_px: f64,
    height_px: f64,
    var_x_px2: f64,
    var_y_px2: f64,
    cov_xy_px2: f64,
    colour: u32,
    flags: u32,
}

/// [`SceneNode`] with its two shorts in the other order.
#[repr(C)]
#[derive(Debug, Clone, Copy, Pod, Wire, Zeroable)]
struct SwappedNode {
    position_mm: [f32; 3],
    dye: u16,
    flag: u16,
}

stand_in!(Ours of Blob, SceneNode);
stand_in!(OtherBlob of SwappedBlob, SceneNode);
stand_in!(OtherNode of Blob, SwappedNode);

#[test]
fn blobs_and_scene_nodes_of_another_order_are_refused() {
    let instance = instance("order2");
    let _sender = instance.block_sender::<Ours>(64).unwrap();
    assert!(instance.block_receiver::<Ours>().is_ok());
    for refused in
        [instance.block_receiver::<OtherBlob>().err(), instance.block_receiver::<OtherNode>().err()]
    {
        let refused = refused.expect("refused");
        assert!(matches!(refused, IpcError::SchemaDiffers { channel: "stand-in", .. }), "{refused}");
    }
}

#[test]
fn an_instance_has_one_owner_and_leaves_nothing() {
    let name = format!("t{}-own", std::process::id() % 1_000_000);
    let first = Instance::own(&name).unwrap();
    assert!(matches!(Instance::own(&name), Err(IpcError::InUse(_))));
    let directory = first.directory().to_owned();
    let mark = format!("vitreo_{}_", std::fs::read_to_string(directory.join("token")).unwrap());
    let files = || {
        let files = std::fs::read_dir("/dev/shm").unwrap().flatten();
        files.filter(|f| f.file_name().to_string_lossy().starts_with(&mark)).collect::<Vec<_>>()
    };
    let left = || files().len();
    let sender = first.sender::<Number>().unwrap();
    assert!(left() > 0, "shared memory has the prefix of the instance");
    for file in files() {
        let mode = file.metadata().unwrap().permissions().mode();
        assert_eq!(mode & 0o077, 0, "{:?} is open to other users", file.file_name());
    }
    drop(sender);
    drop(first);
    assert!(!directory.exists());
    assert_eq!(left(), 0, "files left in shared memory");
    assert!(matches!(Instance::join("No/Such"), Err(IpcError::InstanceName(_))));
}
