//! The handles: lines of their encoders to tools and jaws.

use super::line::{Got, Line};
use crate::condition::{Condition, Kind, Rate, Trouble};
use crate::encoder::{Heard, LineReader, Sample};
use anyhow::{Result, ensure};
use ipc::{Instance, Sender};
use protocol::condition::{News, ProblemKind};
use protocol::controls::ControlFigures;
use protocol::handles::{HandleState, OPEN_JAWS_RAD, Tool};
use protocol::limits::INSTRUMENTS;
use protocol::time::Nanos;
use rig::Rig;
use rig::handles::RigHandle;
use settings::commands::controls::HandlesSpec;
use std::collections::BTreeMap;

/// A handle is sent when it changes, but not more often than this, ns.
const SHORTEST_NS: u64 = 2_000_000;
/// A handle is sent at least so often, ns: 50 times a second.
const EVERY_NS: u64 = 20_000_000;
/// Time without a sample after which a line counts as silent, ns.
const SILENT_NS: u64 = 200_000_000;
/// Time after its last line for which a handle that the rig does not have is reported, ns.
const STRANGE_NS: u64 = 1_000_000_000;
/// Bytes read at a time.
const BUFFER: usize = 4096;

/// One hand.
#[derive(Debug, Clone, Copy)]
struct Hand {
    encoder: Option<RigHandle>,
    tool: Tool,
    /// How far its jaws are open, where it has any.
    jaw_rad: f64,
    /// What was sent last, and when.
    sent: Option<(Tool, f64)>,
    sent_ns: Nanos,
}

/// The line and the channel of the handles.
pub(super) struct HandlesFeed {
    source: String,
    line: Line,
    reader: LineReader,
    channel: Sender<HandleState>,
    hands: [Hand; INSTRUMENTS],
    pub(super) condition: Condition,
    bad: Rate,
    gaps: Rate,
    bad_kinds: BTreeMap<&'static str, u64>,
    restarts: u64,
    taken: u64,
    absent: Option<String>,
    was_there: bool,
    /// When the newest sample came, or the line was opened.
    newest_ns: Nanos,
    /// The handle of which the rig says nothing, and when it sent last.
    strange: Option<(u32, Nanos)>,
}

impl HandlesFeed {
    /// The line is opened later; until a handle states its tool, it is that of `tools`.
    ///
    /// # Errors
    /// Where the rig says nothing of handles, or a channel fails.
    pub(super) fn open(
        spec: &HandlesSpec,
        rig: &Rig,
        tools: [Tool; INSTRUMENTS],
        instance: &Instance,
    ) -> Result<Self> {
        ensure!(
            !rig.handles.is_empty(),
            "--handles: the rig has no section `handles`, which says how far jaws open: write it with vitreo handles \
             {} --calibrate RIG.json -o NEW.json",
            outputs::shell_word(spec)
        );
        let hand = |i: usize| {
            let encoder = rig.handle(i as u32).copied();
            let jaw_rad = encoder.map_or(OPEN_JAWS_RAD, |e| e.open_rad);
            Hand { encoder, tool: tools[i], jaw_rad, sent: None, sent_ns: 0 }
        };
        Ok(HandlesFeed {
            source: spec.to_string(),
            line: Line::new(&spec.path, Some(spec.baud)),
            reader: LineReader::default(),
            channel: instance.sender()?,
            hands: std::array::from_fn(hand),
            condition: Condition::new("the line of the handles"),
            bad: Rate::default(),
            gaps: Rate::default(),
            bad_kinds: BTreeMap::new(),
            restarts: 0,
            taken: 0,
            absent: None,
            was_there: false,
            newest_ns: 0,
            strange: None,
        })
    }

    pub(super) fn line(&self) -> &Line {
        &self.line
    }

    /// Blocks sent so far.
    pub(super) fn sent(&self) -> u64 {
        self.channel.sent()
    }

    /// Samples taken in, and lines that were refused.
    pub(super) fn counts(&self) -> [u64; 2] {
        [self.taken, self.bad.total]
    }

    /// Takes in what has come, and sends what is due with the number of the newest field.
    pub(super) fn turn(&mut self, field: u64, now: Nanos) -> Result<()> {
        if self.line.is_due(now) {
            match self.line.open(now) {
                Ok(_) => {
                    (self.absent, self.was_there, self.newest_ns) = (None, true, now);
                    self.reader.forget();
                }
                Err(why) => self.absent = Some(why),
            }
        }
        let mut buffer = [0; BUFFER];
        for _ in 0..16 {
            match self.line.read(&mut buffer) {
                Got::Bytes(bytes) => self.take(&buffer[..bytes], now),
                Got::Nothing | Got::Closed => break,
            }
        }
        (0..INSTRUMENTS).try_for_each(|i| self.send(i, field, now))
    }

    fn take(&mut self, bytes: &[u8], now: Nanos) {
        let mut reader = std::mem::take(&mut self.reader);
        reader.take(bytes, |heard| match heard {
            Heard::Sample(sample) => self.take_sample(sample, now),
            Heard::Bad(bad) => {
                self.bad.note(1, now);
                *self.bad_kinds.entry(bad.name()).or_default() += 1;
            }
            Heard::Gap(lines) => self.gaps.note(lines.into(), now),
            Heard::Restart => self.restarts += 1,
        });
        self.reader = reader;
    }

    fn take_sample(&mut self, sample: Sample, now: Nanos) {
        (self.taken, self.newest_ns) = (self.taken + 1, now);
        let hand = &mut self.hands[sample.handle as usize];
        hand.tool = sample.tool.unwrap_or(hand.tool);
        match hand.encoder {
            Some(encoder) => hand.jaw_rad = encoder.jaw_rad(sample.count),
            None => self.strange = Some((sample.handle, now)),
        }
    }

    fn send(&mut self, i: usize, field: u64, now: Nanos) -> Result<()> {
        let hand = &mut self.hands[i];
        let has_jaws = hand.tool.open_rad() > 0.0;
        let said = (hand.tool, if has_jaws { hand.jaw_rad } else { 0.0 });
        let wait = if hand.sent == Some(said) { EVERY_NS } else { SHORTEST_NS };
        if hand.sent.is_some() && now < hand.sent_ns + wait {
            return Ok(());
        }
        (hand.sent, hand.sent_ns) = (Some(said), now);
        let (seq, tool, jaw_rad) = (self.channel.sent(), said.0 as u32, said.1);
        let (instant_ns, instrument) = (now, i as u32);
        self.channel.fill(|block| {
            *block = HandleState { seq, field, instant_ns, instrument, tool, jaw_rad };
        })?;
        Ok(())
    }

    /// Brings its condition up to date; returns what is to be reported.
    pub(super) fn judge(&mut self, now: Nanos) -> Option<News> {
        let (garbled, gaps) = (self.bad.is_much(now), self.gaps.is_much(now));
        let trouble = |kind, text: &str| Some(Trouble::new(kind, text));
        let silent = now >= self.newest_ns + SILENT_NS;
        let strange = self.strange.filter(|(_, at)| now < at + STRANGE_NS);
        let found = if let (Some(why), false) = (&self.absent, self.was_there) {
            trouble(Kind::Absent, why)
        } else if !self.line.is_open() && self.was_there {
            trouble(Kind::Gone, "is disconnected: tools and jaws keep their state")
        } else if garbled {
            trouble(Kind::Garbled, "is noisy: lines are rejected; check cable and baud rate")
        } else if silent && self.was_there {
            trouble(Kind::Silent, "is silent: tools and jaws keep their state")
        } else if gaps {
            trouble(Kind::Gaps, "loses lines: their sequence numbers jump")
        } else {
            let text =
                |i| format!("has handle {i}, which the rig's section handles lacks: its jaws stay open");
            strange.and_then(|(i, _)| trouble(Kind::Uncalibrated, &text(i)))
        };
        self.condition.note(found, now)
    }

    pub(super) fn figures(&self) -> ControlFigures {
        let restarts = Some(("restarts of the numbers".into(), self.restarts)).filter(|(_, n)| *n > 0);
        let bad = self.bad_kinds.iter().map(|(name, n)| ((*name).to_owned(), *n));
        ControlFigures {
            control: "handles".into(),
            source: self.source.clone(),
            taken: self.taken,
            sent: self.sent(),
            openings: self.line.openings,
            bad: bad.chain(restarts).collect(),
            missing: self.gaps.total,
            troubles: self.condition.counts().map(|(kind, n)| (kind.name().into(), n)).collect(),
            trouble: self.condition.text().into(),
        }
    }
}
