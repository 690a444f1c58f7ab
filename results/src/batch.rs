//! Batches: which recordings there are, which of them a shard has, and working through them on
//! several threads. The rows come in the order of the list, whatever the threads do.

use crate::attempt::Attempt;
use protocol::file::{MAX_TABLE_BYTES, read_text};
use std::collections::BTreeSet;
use std::path::{Path, PathBuf};
use std::str::FromStr;
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
}

/// A list that cannot be worked through.
#[derive(Debug, thiserror::Error)]
pub enum BatchError {
    /// A file or folder cannot be read.
    #[error("{file}: {problem}")]
    Read {
        /// What was named.
        file: String,
        /// Why.
        problem: std::io::Error,
    },
    /// A folder without recordings.
    #[error("{folder}: expected recordings (*.mcap) in it or below, found none")]
    Empty {
        /// What was named.
        folder: String,
    },
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

    /// Its share of a list: every `count`-th entry, so that recordings of one session, which are
    /// alike in length, spread evenly.
    pub fn of<T: Clone>(self, list: &[T]) -> Vec<T> {
        list.iter().skip(self.index as usize).step_by(self.count as usize).cloned().collect()
    }

    /// Name of its table: `scores-00002-of-00016.parquet`.
    pub fn file_name(self) -> String {
        format!("scores-{:05}-of-{:05}.parquet", self.index, self.count)
    }
}

impl FromStr for Shard {
    type Err = String;

    fn from_str(text: &str) -> Result<Self, String> {
        let wrong = || format!("expected I/N with I from 0 to N - 1, found '{text}'");
        let (index, count) = text.split_once('/').ok_or_else(wrong)?;
        let number = |t: &str| t.parse::<u32>().map_err(|_| wrong());
        let shard = Shard { index: number(index)?, count: number(count)? };
        if shard.index < shard.count { Ok(shard) } else { Err(wrong()) }
    }
}

/// Recordings that were named: files as they are, folders with every `*.mcap` in and below them by
/// name, and the lines of a manifest. What is named twice is there once.
///
/// # Errors
/// If a folder or the manifest cannot be read, or a folder holds no recording.
pub fn list(named: &[PathBuf], manifest: Option<&Path>) -> Result<Vec<PathBuf>, BatchError> {
    let mut all = Vec::new();
    for path in named {
        if path.is_dir() {
            let before = all.len();
            walk(path, &mut all)?;
            if all.len() == before {
                return Err(BatchError::Empty { folder: path.display().to_string() });
            }
        } else {
            all.push(path.clone());
        }
    }
    if let Some(manifest) = manifest {
        let text = read_text(manifest, MAX_TABLE_BYTES).map_err(|e| refused(manifest, e))?;
        all.extend(lines(&text, manifest.parent().unwrap_or(Path::new(""))));
    }
    let mut seen = BTreeSet::new();
    all.retain(|path| seen.insert(path.clone()));
    Ok(all)
}

fn refused(path: &Path, problem: std::io::Error) -> BatchError {
    BatchError::Read { file: path.display().to_string(), problem }
}

/// Paths of a manifest: one a line, from its own folder on; blank lines and those that begin with
/// `#` are passed over.
pub fn lines(text: &str, folder: &Path) -> Vec<PathBuf> {
    let lines = text.lines().map(|line| line.trim_end_matches('\r'));
    let paths = lines.filter(|line| !line.trim().is_empty() && !line.starts_with('#'));
    paths.map(|line| folder.join(line)).collect()
}

fn walk(folder: &Path, found: &mut Vec<PathBuf>) -> Result<(), BatchError> {
    let entries = std::fs::read_dir(folder).map_err(|e| refused(folder, e))?;
    let mut entries = entries.collect::<Result<Vec<_>, _>>().map_err(|e| refused(folder, e))?;
    entries.sort_by_key(|e| e.file_name());
    for entry in entries {
        let path = entry.path();
        // A link to a folder may lead in a circle.
        let kind = entry.file_type().map_err(|e| refused(&path, e))?;
        if kind.is_dir() {
            walk(&path, found)?;
        } else if path.extension().is_some_and(|e| e == "mcap") {
            found.push(path);
        }
    }
    Ok(())
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
            all.sort_unstable();
            prop_assert_eq!(all, list);
        }

        #[test]
        fn any_text_is_a_shard_or_refused(text in "[0-9/ a-]{0,12}") {
            if let Ok(shard) = text.parse::<Shard>() {
                prop_assert!(shard.index < shard.count);
            }
        }
    }

    #[test]
    fn shards_are_counted_from_0() {
        assert_eq!("3/16".parse(), Ok(Shard { index: 3, count: 16 }));
        assert_eq!(Shard { index: 3, count: 16 }.file_name(), "scores-00003-of-00016.parquet");
        for wrong in ["", "3", "16/16", "0/0", "-1/2", "1/2/3", "a/b"] {
            assert!(wrong.parse::<Shard>().unwrap_err().contains("I/N"), "{wrong}");
        }
    }

    #[test]
    fn folders_are_walked_by_name_and_manifests_read_from_their_place() {
        let folder = tempfile::tempdir().unwrap();
        let at = |name: &str| folder.path().join(name);
        std::fs::create_dir_all(at("day/b")).unwrap();
        for name in ["day/c.mcap", "day/b/z.mcap", "day/a.mcap", "day/notes.txt"] {
            std::fs::write(at(name), "").unwrap();
        }
        std::fs::write(at("list.txt"), "# made by hand\nday/a.mcap\r\n\n/far/x y.mcap\n").unwrap();
        std::os::unix::fs::symlink(at("day"), at("day/b/circle")).unwrap();
        let found = list(&[at("day"), at("single")], Some(&at("list.txt"))).unwrap();
        let expected =
            [at("day/a.mcap"), at("day/b/z.mcap"), at("day/c.mcap"), at("single"), "/far/x y.mcap".into()];
        assert_eq!(found, expected);
        std::fs::create_dir(at("bare")).unwrap();
        assert!(list(&[at("bare")], None).unwrap_err().to_string().contains("bare"));
        assert!(list(&[], Some(&at("none.txt"))).unwrap_err().to_string().contains("none.txt"));
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
