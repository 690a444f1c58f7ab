//! `cargo bench -p tracker --bench field [-- --json]`: what one frame costs on one core.
//!
//! Streams are those of the tests. Times are those of the tracker alone; the median is over all
//! frames, the maximum over the frames' least of five runs, so that other programs do not count.
//!
//! - `full triple`: three genlocked cameras, everything visible;
//! - `64 blobs a camera`: the same with false blobs of the markers' colours up to 64 in each field;
//! - `a camera left out`: one was moved by 5 px and is being resected;
//! - `search, 64 blobs a camera`: every body is lost before every frame;
//! - `full triple, its poses`: until they can be sent; what follows is not in it;
//! - `full triple, cold caches`, and its poses: 64 MB of other memory were walked through before every frame, as where
//!   other programs had the processor between two fields.

use blob_stream::BlobReader;
use bytemuck::Zeroable;
use protocol::blobs::{Blob, BlobField};
use protocol::limits::MAX_BLOBS;
use protocol::phases::Unmarked;
use protocol::poses::TrackerFrame;
use rig::Rig;
use std::hint::black_box;
use std::path::PathBuf;
use std::time::Instant;
use tracker::assembler::FrameAssembler;
use tracker::{Reference, Tracker};

/// Runs over the stream; a frame's least time is taken.
const RUNS: usize = 5;
/// Frames given to start-up: the search of the first is a method of its own.
const START: usize = 3;

type Frame = (Vec<BlobField>, Reference);

fn frames(name: &str) -> (Rig, Vec<Frame>) {
    let folder = PathBuf::from(env!("CARGO_MANIFEST_DIR")).join("../tests/data/tracker").join(name);
    let rig = Rig::load(&folder.join("rig.json")).expect("the rig of the tests is there");
    let mut assembler = FrameAssembler::new(&rig);
    let mut frames = Vec::new();
    for field in BlobReader::open(&folder.join("blobs.jsonl")).expect("the stream of the tests is there") {
        let field = field.expect("the stream of the tests is whole");
        let now = field.blobs_out_ns;
        let _ = assembler.push(&field, now);
        while let Some(closed) = assembler.complete(now) {
            frames.push((assembler.used().to_vec(), closed.reference));
        }
    }
    (rig, frames)
}

/// Fills every field with blobs of its own colours and sizes at places that a counter scatters.
fn cluttered(frames: &[Frame]) -> Vec<Frame> {
    let mut state = 1u64;
    let mut next = |limit: f64| {
        // Knuth's MMIX generator: scattered, the same on every machine.
        state = state.wrapping_mul(6_364_136_223_846_793_005).wrapping_add(1_442_695_040_888_963_407);
        (state >> 11) as f64 / (1u64 << 53) as f64 * limit
    };
    let mut all = frames.to_vec();
    for field in all.iter_mut().flat_map(|(fields, _)| fields) {
        let own: Vec<Blob> = field.blobs().to_vec();
        while (field.count as usize) < MAX_BLOBS && !own.is_empty() {
            let like = own[field.count as usize % own.len()];
            field.push(Blob { x_px: next(720.0), y_field_px: next(288.0), ..like });
        }
    }
    all
}

/// First frame in which camera 1 is moved, and the frames during which it is left out after that.
const MOVED_AT: usize = 15;
const LEFT_OUT: std::ops::Range<usize> = MOVED_AT + 10..MOVED_AT + 75;

/// Moves the picture of camera 1 by 5 px.
fn moved(frames: &[Frame]) -> Vec<Frame> {
    let mut all = frames.to_vec();
    for field in all[MOVED_AT..].iter_mut().flat_map(|(fields, _)| fields).filter(|f| f.camera == 1) {
        let count = field.count as usize;
        field.blobs[..count].iter_mut().for_each(|b| b.x_px += 5.0);
    }
    all
}

/// What happens before every frame, outside of its time.
#[derive(Clone, Copy, PartialEq)]
enum Before {
    Nothing,
    /// Every body is lost.
    Lost,
    /// Other memory is walked through, so that nothing of the tracker's is in a cache.
    Cold,
}

/// More than the caches of any processor's core, and of most processors.
const OTHER_BYTES: usize = 64 << 20;
/// Of a cache, bytes.
const LINE: usize = 64;

/// Least times of every frame, ns.
struct Times {
    /// Until its poses can be sent.
    poses: Vec<u64>,
    /// With what follows.
    all: Vec<u64>,
}

fn times(rig: &Rig, frames: &[Frame], before: Before) -> Times {
    let mut other = vec![0u8; if before == Before::Cold { OTHER_BYTES } else { 0 }];
    let mut least = Times { poses: vec![u64::MAX; frames.len()], all: vec![u64::MAX; frames.len()] };
    let mut frame = TrackerFrame::zeroed();
    for _ in 0..RUNS {
        let mut tracker = Tracker::new(rig);
        let places = least.poses.iter_mut().zip(&mut least.all);
        for ((used, reference), (poses, all)) in frames.iter().zip(places) {
            if before == Before::Lost {
                tracker.reset();
            }
            other.iter_mut().step_by(LINE).for_each(|byte| *byte = byte.wrapping_add(1));
            black_box(&mut other);
            let begin = Instant::now();
            tracker.track_into(&mut frame, black_box(used), reference, &mut Unmarked);
            black_box(&mut frame);
            *poses = (*poses).min(begin.elapsed().as_nanos() as u64);
            tracker.follow_up(used);
            *all = (*all).min(begin.elapsed().as_nanos() as u64);
        }
    }
    least
}

fn main() {
    let json = std::env::args().any(|a| a == "--json");
    let (rig, plain) = frames("nominal");
    let clutter = cluttered(&plain);
    let [warm, cold] = [Before::Nothing, Before::Cold].map(|before| times(&rig, &plain, before));
    let methods = [
        ("full triple", warm.all[START..].to_vec()),
        ("full triple, its poses", warm.poses[START..].to_vec()),
        ("64 blobs a camera", times(&rig, &clutter, Before::Nothing).all[START..].to_vec()),
        ("a camera left out", times(&rig, &moved(&plain), Before::Nothing).all[LEFT_OUT].to_vec()),
        ("search, 64 blobs a camera", times(&rig, &clutter, Before::Lost).all),
        ("full triple, cold caches", cold.all[START..].to_vec()),
        ("its poses, cold caches", cold.poses[START..].to_vec()),
    ];
    for (method, mut ns) in methods {
        ns.sort_unstable();
        let (median_us, max_us) = (ns[ns.len() / 2] as f64 * 1e-3, ns[ns.len() - 1] as f64 * 1e-3);
        if json {
            println!("{{\"method\":\"{method}\",\"median_us\":{median_us:.2},\"max_us\":{max_us:.2}}}");
        } else {
            println!("{method:26} median {median_us:7.1} µs, max {max_us:7.1} µs over {} frames", ns.len());
        }
    }
}
