//! Batches: which recordings of a list a shard has, and working through them on several threads. The
//! rows come in the order of the list, whatever the threads do.

use crate::attempt::Attempt;
use std::path::{Path, PathBuf};
use std::sync::atomic::{AtomicBool, AtomicUsize, Ordering};
use std::sync::mpsc;

/// What a recording came to.
#[derive(Debug, Clone, Default, PartialEq)]
pub struct Row {
    /// The recording.
    pub file: PathBuf,
    /// What is wrong with it; it may have a score nevertheless, of what could be read.
    pub problem: Option<String>,
    /// Time that passes in it, s.
    pub seconds: f64,
    /// The attempt ended in it; else it is scored as far as it goes.
    pub ended: bool,
    /// Whether the live run published the same score, to the bit; `None` where it published none,
    /// or one of another version.
    pub agrees: Option<bool>,
    /// The attempt in it.
    pub attempt: Option<Attempt>,
    /// SHA-256 of the recording, 64 hexadecimal digits; `None` where it could not be read.
    pub sha256: Option<String>,
}

/// One of several machines that share a list; numbers begin at 0.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub struct Shard {
    /// Its number.
    pub index: u32,
    /// How many there are.
    pub count: u32,
}

impl Shard {
    /// The only one.
    pub const WHOLE: Shard = Shard { index: 0, count: 1 };

    /// Part `index` of `count`; `None` where there is no such part.
    pub fn new(index: u32, count: u32) -> Option<Shard> {
        (index < count).then_some(Shard { index, count })
    }

    /// As a table's notes have it: `I/N`.
    pub fn of_text(text: &str) -> Option<Shard> {
        let (index, count) = text.split_once('/')?;
        Shard::new(index.parse().ok()?, count.parse().ok()?)
    }

    /// How many entries of a list of `listed` are its own.
    pub fn share(self, listed: u64) -> u64 {
        listed.saturating_sub(u64::from(self.index)).div_ceil(u64::from(self.count))
    }

    /// Its share of a list: every `count`-th entry, so that recordings of one session, which are
    /// alike in length, spread evenly.
    pub fn of<T: Clone>(self, list: &[T]) -> Vec<T> {
        list.iter().skip(self.index as usize).step_by(self.count as usize).cloned().collect()
    }

    /// Name of its table: `scores-00002-of-00016.parquet`.
    pub fn file_name(self) -> String {
        format!("scores-{:05}-of-{:05}.parquet", self.index, self.count)
    }

    /// The shard whose table has this name.
    pub fn of_file_name(name: &str) -> Option<Shard> {
        let (index, count) = name.strip_prefix("scores-")?.strip_suffix(".parquet")?.split_once("-of-")?;
        let shard = Shard::new(index.parse().ok()?, count.parse().ok()?)?;
        (shard.file_name() == name).then_some(shard)
    }
}

/// Works through a list on `jobs` threads; `each` is done as often as the list is long, `done`
/// hears of every row as it comes, on the caller's thread. Once `stop` is raised nothing new is
/// begun. Rows come in the order of the list.
pub fn work<R: Send>(
    list: &[PathBuf],
    jobs: usize,
    stop: &AtomicBool,
    each: impl Fn(&Path) -> R + Sync,
    mut done: impl FnMut(&R),
) -> Vec<R> {
    let next = AtomicUsize::new(0);
    let mut rows: Vec<Option<R>> = list.iter().map(|_| None).collect();
    std::thread::scope(|scope| {
        let (sender, receiver) = mpsc::channel();
        for _ in 0..jobs.clamp(1, list.len().max(1)) {
            let (sender, next, each) = (sender.clone(), &next, &each);
            scope.spawn(move || {
                while !stop.load(Ordering::Relaxed) {
                    let at = next.fetch_add(1, Ordering::Relaxed);
                    let Some(path) = list.get(at) else { break };
                    if sender.send((at, each(path))).is_err() {
                        break;
                    }
                }
            });
        }
        drop(sender);
        for (at, row) in receiver {
            done(&row);
            rows[at] = Some(row);
        }
    });
    rows.into_iter().flatten().collect()
}

#[cfg(test)]
mod tests {
    use super::*;
    use proptest::prelude::*;

    proptest! {
        #[test]
        fn shards_share_a_list_without_gap_or_overlap(length in 0usize..200, count in 1u32..20) {
            let list: Vec<usize> = (0..length).collect();
            let mut all: Vec<usize> = (0..count).flat_map(|index| Shard { index, count }.of(&list)).collect();
            let sizes: Vec<usize> = (0..count).map(|index| Shard { index, count }.of(&list).len()).collect();
            prop_assert!(sizes.iter().max().unwrap() - sizes.iter().min().unwrap() <= 1);
            for (index, size) in (0..count).zip(&sizes) {
                prop_assert_eq!(Shard { index, count }.share(length as u64), *size as u64);
            }
            all.sort_unstable();
            prop_assert_eq!(all, list);
        }

        #[test]
        fn a_table_has_the_name_of_one_shard(index in 0u32..200_000, more in 1u32..200_000, text in "scores-[0-9+]{1,6}-of-[0-9]{1,6}.parquet") {
            let shard = Shard { index, count: index + more };
            prop_assert_eq!(Shard::of_file_name(&shard.file_name()), Some(shard));
            if let Some(shard) = Shard::of_file_name(&text) {
                prop_assert_eq!(shard.file_name(), text);
            }
        }
    }

    #[test]
    fn shards_are_counted_from_0() {
        assert_eq!(Shard::new(3, 16), Some(Shard { index: 3, count: 16 }));
        assert_eq!(Shard { index: 3, count: 16 }.file_name(), "scores-00003-of-00016.parquet");
        assert!(Shard::new(16, 16).is_none() && Shard::new(0, 0).is_none());
    }

    #[test]
    fn rows_keep_the_order_of_the_list() {
        let list: Vec<PathBuf> = (0..97).map(|i| format!("{i}.mcap").into()).collect();
        let stop = AtomicBool::new(false);
        for jobs in [0, 1, 4, 1000] {
            let mut heard = 0;
            let each = |path: &Path| Row { file: path.into(), ..Row::default() };
            let rows = work(&list, jobs, &stop, each, |_| heard += 1);
            assert!(rows.iter().map(|r| &r.file).eq(&list) && heard == 97, "{jobs} jobs");
        }
        stop.store(true, Ordering::Relaxed);
        assert!(work(&list, 2, &stop, |_| -> Row { unreachable!("nothing is begun") }, |_| {}).is_empty());
    }
}
