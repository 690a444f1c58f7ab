//! Trying inputs on one target, in this process.

use crate::corpus;
use crate::coverage::Coverage;
use crate::fields::{self, Number};
use crate::mutate;
use crate::random::Random;
use crate::targets::Target;
use crate::watch::{self, Present, SLOW, Watch};
use std::cell::RefCell;
use std::panic::{AssertUnwindSafe, catch_unwind};
use std::path::Path;
use std::time::{Duration, Instant};

/// When to end.
#[derive(Debug, Clone, Copy)]
pub struct Limits {
    /// After this time, where there is one.
    pub time: Option<Duration>,
    /// After so many inputs, where that is bounded.
    pub inputs: Option<u64>,
}

/// What came of a target.
#[derive(Debug, Clone, Default, PartialEq)]
pub struct Outcome {
    /// Inputs tried.
    pub inputs: u64,
    /// Seconds it took.
    pub seconds: f64,
    /// Inputs kept at the end, those to begin with included.
    pub kept: usize,
    /// Inputs that reached something new.
    pub new: usize,
    /// Branches of our code that were taken; 0 without counters.
    pub branches: usize,
    /// Different panics.
    pub crashes: usize,
    /// Inputs that took longer than [`SLOW`].
    pub slow: usize,
    /// Slowest input, ms.
    pub slowest_ms: f64,
    /// Most memory of the process, bytes.
    pub memory: u64,
}

impl Outcome {
    /// As a line for the campaign that started this process.
    pub fn to_line(&self) -> String {
        let Outcome { inputs, seconds, kept, new, branches, crashes, slow, slowest_ms, memory } = self;
        format!("{inputs} {seconds} {kept} {new} {branches} {crashes} {slow} {slowest_ms} {memory}")
    }

    /// From such a line.
    pub fn from_line(line: &str) -> Option<Self> {
        let words: Vec<&str> = line.split_whitespace().collect();
        let [inputs, seconds, kept, new, branches, crashes, slow, slowest_ms, memory] = words[..] else {
            return None;
        };
        Some(Outcome {
            inputs: inputs.parse().ok()?,
            seconds: seconds.parse().ok()?,
            kept: kept.parse().ok()?,
            new: new.parse().ok()?,
            branches: branches.parse().ok()?,
            crashes: crashes.parse().ok()?,
            slow: slow.parse().ok()?,
            slowest_ms: slowest_ms.parse().ok()?,
            memory: memory.parse().ok()?,
        })
    }
}

/// The engine on one target.
pub struct Engine<'a> {
    target: Target,
    /// Where crashes, slow and new inputs are put.
    folder: &'a Path,
    present: Present,
    watch: Watch,
    coverage: Coverage,
    kept: Vec<Vec<u8>>,
    /// Places of panics so far.
    places: Vec<String>,
    outcome: Outcome,
}

thread_local! {
    /// Place and message of the last panic.
    static PANIC: RefCell<String> = const { RefCell::new(String::new()) };
}

impl<'a> Engine<'a> {
    /// Puts what it finds into `folder`.
    pub fn new(target: Target, folder: &'a Path) -> Self {
        std::panic::set_hook(Box::new(|info| {
            let place = info.location().map_or(String::new(), ToString::to_string);
            let what = info.payload_as_str().unwrap_or_default();
            PANIC.set(format!("{place}: {}", what.chars().take(300).collect::<String>()));
        }));
        Engine {
            target,
            folder,
            present: Present::in_folder(folder),
            watch: Watch::start(),
            coverage: Coverage::default(),
            kept: Vec::new(),
            places: Vec::new(),
            outcome: Outcome::default(),
        }
    }

    /// Tries inputs until a limit; `progress` hears of it about once a second.
    pub fn run(mut self, seed: u64, limits: Limits, mut progress: impl FnMut(&Outcome)) -> Outcome {
        let begin = Instant::now();
        let mut random = Random::new(seed);
        for seed in corpus::of(&self.target) {
            self.coverage.look_at_all();
            self.try_one(&seed);
            self.kept.push(seed);
        }
        let numbers = self.target.layout.map(fields::numbers);
        let (mut input, mut reported_at) = (Vec::new(), begin);
        // Clocks cost more than the checks of a small message.
        let batch = if numbers.is_some() { 4096 } else { 1 };
        loop {
            let left = limits.inputs.map_or(batch, |n| batch.min(n.saturating_sub(self.outcome.inputs)));
            let late = limits.time.is_some_and(|t| begin.elapsed() >= t);
            if left == 0 || late {
                break;
            }
            match &numbers {
                Some(numbers) => self.try_blocks(left, numbers, &mut random, &mut input),
                None => self.try_bytes(&mut random, &mut input),
            }
            if reported_at.elapsed() >= Duration::from_secs(1) {
                reported_at = Instant::now();
                self.measure(begin);
                progress(&self.outcome);
            }
        }
        self.measure(begin);
        self.outcome
    }

    fn measure(&mut self, begin: Instant) {
        self.outcome.seconds = begin.elapsed().as_secs_f64();
        self.outcome.kept = self.kept.len();
        self.outcome.branches = self.coverage.branches();
        self.outcome.memory = watch::peak_memory();
    }

    /// Varied blocks of a message, timed together.
    fn try_blocks(&mut self, count: u64, numbers: &[Number], random: &mut Random, input: &mut Vec<u8>) {
        let begin = self.watch.begin();
        for _ in 0..count {
            input.clear();
            input.extend_from_slice(&self.kept[random.below(self.kept.len())]);
            fields::vary(input, numbers, random);
            if catch_unwind(AssertUnwindSafe(|| (self.target.run)(input))).is_err() {
                self.crashed(input);
            }
        }
        self.outcome.inputs += count;
        let each = self.watch.end(begin).as_secs_f64() * 1e3 / count as f64;
        self.outcome.slowest_ms = self.outcome.slowest_ms.max(each);
    }

    fn try_bytes(&mut self, random: &mut Random, input: &mut Vec<u8>) {
        // What was found last is varied most.
        let recent = self.kept.len().min(16);
        let from = match random.below(4) {
            0 => self.kept.len() - 1 - random.below(recent),
            // A short one is tried faster, and a change in it means more.
            _ => {
                let two = [random.below(self.kept.len()), random.below(self.kept.len())];
                if self.kept[two[0]].len() <= self.kept[two[1]].len() { two[0] } else { two[1] }
            }
        };
        mutate::vary(&self.kept, from, self.target.longest, random, input);
        if self.try_one(input) {
            self.outcome.new += 1;
            self.save("new", input);
            self.kept.push(input.clone());
        }
    }

    /// Tries an input; true if it reached something new.
    fn try_one(&mut self, input: &[u8]) -> bool {
        self.present.note(input);
        self.coverage.begin();
        let begin = self.watch.begin();
        let done = catch_unwind(AssertUnwindSafe(|| (self.target.run)(input)));
        let took = self.watch.end(begin);
        self.outcome.inputs += 1;
        self.outcome.slowest_ms = self.outcome.slowest_ms.max(took.as_secs_f64() * 1e3);
        if took > SLOW {
            self.outcome.slow += 1;
            self.save("slow", input);
        }
        let new = self.coverage.end();
        if done.is_err() {
            self.crashed(input);
            return false;
        }
        new
    }

    /// Keeps the first input of every place that panics.
    fn crashed(&mut self, input: &[u8]) {
        let what = PANIC.take();
        let place = what.splitn(3, ':').take(2).collect::<Vec<_>>().join(":");
        if !self.places.contains(&place) {
            self.places.push(place);
            self.outcome.crashes += 1;
            self.save("crash", input);
            let text = format!("{}: {what}\n", self.target.name);
            let all =
                std::fs::OpenOptions::new().create(true).append(true).open(self.folder.join("panics.txt"));
            let _ = all.and_then(|mut file| std::io::Write::write_all(&mut file, text.as_bytes()));
        }
    }

    fn save(&self, what: &str, input: &[u8]) {
        let folder = self.folder.join(what);
        let name = format!("{:016x}", protocol::message::fnv1a(input));
        let _ = std::fs::create_dir_all(&folder).and_then(|()| std::fs::write(folder.join(name), input));
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::targets::Kind;

    fn trap(bytes: &[u8]) {
        assert!(bytes.first() != Some(&b'9'), "nine");
    }

    #[test]
    fn a_panic_is_found_counted_once_and_kept() {
        let folder = tempfile::tempdir().unwrap();
        let seeds = || vec![b"1 2".to_vec()];
        let target = Target { name: "trap", kind: Kind::Text, run: trap, seeds, layout: None, longest: 8 };
        let limits = Limits { time: None, inputs: Some(3000) };
        let outcome = Engine::new(target, folder.path()).run(1, limits, |_| {});
        let _ = std::panic::take_hook();
        assert_eq!((outcome.inputs, outcome.crashes), (3000, 1), "{outcome:?}");
        let kept: Vec<_> = corpus::files_in(&folder.path().join("crash"));
        assert!(kept.len() == 1 && kept[0].1[0] == b'9', "{kept:?}");
        assert!(std::fs::read_to_string(folder.path().join("panics.txt")).unwrap().contains("nine"));
        assert_eq!(Outcome::from_line(&outcome.to_line()), Some(outcome));
    }
}
