//! Tests of the recorder on slow, full and hung disks.

use super::*;
use bytemuck::Zeroable;
use outputs::Outputs;
use protocol::handles::PedalState;
use settings::commands::WritingArgs;
use std::sync::mpsc;

/// A store that waits for leave at each item, and keeps the items.
struct Slow {
    leave: mpsc::Receiver<()>,
    kept: Arc<Mutex<Disk>>,
    waiting: Vec<Item>,
}

#[derive(Default)]
struct Disk {
    items: Vec<Item>,
    room: usize,
    finished: bool,
}

impl Slow {
    fn settle(&mut self) -> Result<(), RecordingError> {
        let mut kept = self.kept.lock().unwrap();
        while !self.waiting.is_empty() {
            if kept.items.len() >= kept.room {
                let problem = std::io::Error::from(std::io::ErrorKind::StorageFull);
                return Err(RecordingError::Io { file: "/d/f".into(), problem });
            }
            kept.items.push(self.waiting.remove(0));
        }
        Ok(())
    }
}

impl Store for Slow {
    fn write(&mut self, _: Nanos, item: &Item) -> Result<(), RecordingError> {
        let _ = self.leave.recv();
        self.waiting.push(item.clone());
        self.settle()
    }

    fn keep_up(&mut self, _: Nanos) -> Result<(), RecordingError> {
        self.settle()
    }

    fn finish(&mut self) -> Result<(), RecordingError> {
        self.settle()?;
        self.kept.lock().unwrap().finished = true;
        Ok(())
    }

    fn unwritten(&self) -> u64 {
        self.waiting.len() as u64
    }

    fn bytes(&self) -> u64 {
        0
    }

    fn sync_lag(&self) -> Duration {
        Duration::ZERO
    }
}

fn pedal(seq: u64) -> Item {
    Item::Pedal(PedalState { seq, ..PedalState::zeroed() })
}

fn slow(room: usize) -> (Recorder, mpsc::Sender<()>, Arc<Mutex<Disk>>) {
    let (go, leave) = mpsc::channel();
    let kept = Arc::new(Mutex::new(Disk { room, ..Disk::default() }));
    let store = Slow { leave, kept: Arc::clone(&kept), waiting: Vec::new() };
    let files =
        RecordingFiles::begin(Path::new("/dev/null"), &WritingArgs::default(), &mut Outputs::new(false));
    (Recorder::with(files.unwrap(), store, 4).unwrap(), go, kept)
}

fn noted(kept: &Disk, kind: NoteKind) -> Vec<Note> {
    let of = |i: &Item| match i {
        Item::Note(n) if n.kind == kind => Some(n.clone()),
        _ => None,
    };
    kept.items.iter().filter_map(of).collect()
}

#[tokio::test(flavor = "multi_thread", worker_threads = 1)]
async fn a_slow_disk_blocks_nobody_and_the_gap_is_noted() {
    let (mut recorder, go, kept) = slow(usize::MAX);
    (0..20).for_each(|seq| recorder.offer(seq, pedal(seq)));
    let lost = recorder.lost();
    assert!((15..=16).contains(&lost), "queue of four, at most one in the store: {lost}");
    drop(go);
    let figures = recorder.finish().await;
    assert_eq!((figures.lost, figures.problem), (lost, None));
    let kept = kept.lock().unwrap();
    assert_eq!(noted(&kept, NoteKind::Loss).iter().map(|n| n.count).sum::<u64>(), lost);
    assert_eq!(kept.items.len() as u64, figures.items);
}

/// Waits until the recorder reports a problem, or none any more.
fn await_problem(recorder: &Recorder, expected: bool) -> String {
    loop {
        let problem = recorder.problem();
        if problem.is_some() == expected {
            return problem.unwrap_or_default();
        }
        thread::yield_now();
    }
}

#[tokio::test(flavor = "multi_thread", worker_threads = 1)]
async fn after_a_full_disk_the_recording_goes_on_and_says_so() {
    let (mut recorder, go, kept) = slow(2);
    drop(go);
    (0..3).for_each(|seq| recorder.offer(seq, pedal(seq)));
    assert_eq!(await_problem(&recorder, true), "the disk is full: /d/f");
    // The queue holds four items; the others are lost.
    (3..10).for_each(|seq| recorder.offer(seq, pedal(seq)));
    assert_eq!(recorder.lost(), 3);
    kept.lock().unwrap().room = usize::MAX;
    await_problem(&recorder, false);
    let figures = recorder.finish().await;
    assert_eq!((figures.problem, figures.lost), (None, 3));
    let kept = kept.lock().unwrap();
    let seqs = kept.items.iter().filter_map(|i| if let Item::Pedal(p) = i { Some(p.seq) } else { None });
    assert!(seqs.eq(0..7), "all but the three that found no place");
    assert!(noted(&kept, NoteKind::Log)[0].text.contains("the disk is full"));
    assert_eq!(noted(&kept, NoteKind::Loss)[0].count, 3);
    assert!(kept.finished);
}

#[tokio::test(flavor = "multi_thread", worker_threads = 1)]
async fn where_space_never_returns_the_cause_and_the_loss_are_told() {
    let (mut recorder, go, kept) = slow(2);
    drop(go);
    (0..3).for_each(|seq| recorder.offer(seq, pedal(seq)));
    await_problem(&recorder, true);
    recorder.offer(3, pedal(3));
    let figures = recorder.finish().await;
    let problem = figures.problem.unwrap();
    assert!(problem.starts_with("the disk is full: /d/f") && problem.contains("recover"), "{problem}");
    assert_eq!((figures.items, figures.lost), (2, 2));
    assert!(!kept.lock().unwrap().finished);
}

#[tokio::test(flavor = "multi_thread", worker_threads = 1)]
async fn a_write_that_never_returns_is_not_waited_for() {
    let (mut recorder, go, _kept) = slow(usize::MAX);
    (0..4).for_each(|seq| recorder.offer(seq, pedal(seq)));
    assert!(await_problem(&recorder, true).starts_with("blocked in writing /dev/null for "));
    let begun = Instant::now();
    let figures = recorder.finish().await;
    // A run must end within 5 s, of which other tasks need two.
    assert!(begun.elapsed() < Duration::from_secs(5));
    let problem = figures.problem.unwrap();
    assert!(problem.contains("did not finish: blocked in writing /dev/null for "), "{problem}");
    assert_eq!((figures.items, figures.lost), (0, 4));
    drop(go);
}
