//! Worker threads of a software driver, each on a processor of its own.
//!
//! llvmpipe wakes its workers together. The kernel then often puts two of them on one processor, while
//! another has nothing to do, and leaves them there for the few milliseconds of a frame, which takes half as
//! long again. They share out the picture's tiles by themselves, so a worker whose processor is busy with
//! something else takes fewer.

use rustix::process::Pid;
use rustix::thread::{CpuSet, sched_getaffinity, sched_setaffinity};
use std::fs::{read_dir, read_to_string};

/// How llvmpipe names its workers; their number follows.
const NAME: &str = "llvmpipe-";

/// Gives each worker a processor of its own, where there are as many workers as processors; returns how
/// many were placed. With fewer the kernel has room to move them to where nothing else runs. The driver
/// starts them with its first frame.
pub fn place() -> usize {
    place_named(NAME)
}

fn place_named(name: &str) -> usize {
    let Ok(allowed) = sched_getaffinity(None) else { return 0 };
    let processors: Vec<usize> = (0..CpuSet::MAX_CPU).filter(|&cpu| allowed.is_set(cpu)).collect();
    let workers: Vec<(usize, Pid)> = workers(name).collect();
    if workers.len() < processors.len() {
        return 0;
    }
    let placed = workers.iter().filter(|(number, id)| {
        let mut own = CpuSet::new();
        own.set(processors[number % processors.len()]);
        sched_setaffinity(Some(*id), &own).is_ok()
    });
    placed.count()
}

/// Number and thread of each thread of this process that is called `name` and a number.
fn workers(name: &str) -> impl Iterator<Item = (usize, Pid)> {
    read_dir("/proc/self/task").into_iter().flatten().flatten().filter_map(move |task| {
        let called = read_to_string(task.path().join("comm")).ok()?;
        let number = called.trim().strip_prefix(name)?.parse().ok()?;
        let id = task.file_name().to_str()?.parse().ok()?;
        Some((number, Pid::from_raw(id)?))
    })
}

#[cfg(test)]
mod tests {
    use super::*;
    use std::sync::mpsc::channel;

    /// Not the driver's, which other tests may have started.
    const NAME: &str = "tiles-";

    #[test]
    fn as_many_workers_as_processors_get_one_each() {
        let allowed = sched_getaffinity(None).unwrap();
        let count = allowed.count() as usize;
        let (tell, wait) = channel::<()>();
        let wait = std::sync::Arc::new(std::sync::Mutex::new(wait));
        let begin = |number: usize| {
            let wait = std::sync::Arc::clone(&wait);
            let name = format!("{NAME}{number}");
            std::thread::Builder::new()
                .name(name)
                .spawn(move || wait.lock().unwrap().recv().is_err())
                .unwrap()
        };
        let mut threads: Vec<_> = (1..count).map(begin).collect();
        assert_eq!(place_named(NAME), 0, "one less than processors");
        threads.push(begin(0));
        // A thread names itself once it runs.
        while workers(NAME).count() < count {
            std::thread::yield_now();
        }
        assert_eq!(place_named(NAME), count);
        let mut taken = CpuSet::new();
        for (number, id) in workers(NAME) {
            let own = sched_getaffinity(Some(id)).unwrap();
            assert_eq!(own.count(), 1, "worker {number}");
            (0..CpuSet::MAX_CPU).filter(|&cpu| own.is_set(cpu)).for_each(|cpu| taken.set(cpu));
        }
        assert_eq!(taken.count(), allowed.count(), "of {count} processors");
        drop(tell);
        assert!(threads.into_iter().all(|t| t.join().unwrap()), "each ended with its sender");
    }
}
