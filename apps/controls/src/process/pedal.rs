//! The pedal: its device to states, sent when they change and ten times a second.

use super::device::PedalDevice;
use crate::condition::{Condition, Kind, Rate, Trouble};
use crate::mapping::{Mapping, Pressed};
use anyhow::{Result, ensure};
use ipc::{Instance, Sender};
use protocol::condition::{News, ProblemKind};
use protocol::controls::ControlFigures;
use protocol::handles::{PedalMode, PedalState};
use protocol::time::Nanos;
use settings::commands::controls::{PedalInterface, PedalSpec};

/// The pedal is sent when it changes, and at least so often, ns: ten times a second.
const EVERY_NS: u64 = 100_000_000;
/// Time for which the last state of a missing pedal counts, ns; then it is up.
const HOLD_NS: u64 = 500_000_000;

/// A pedal that has not been pressed yet.
const UP: Pressed = Pressed { axes: [0.0; 2], buttons: 0, mode: PedalMode::Move };

/// A pedal's device and channel.
pub(super) struct PedalFeed {
    source: String,
    pub(super) device: PedalDevice,
    channel: Sender<PedalState>,
    pub(super) condition: Condition,
    bad: Rate,
    /// Why it cannot be opened.
    absent: Option<String>,
    was_there: bool,
    /// Since when it is gone.
    gone_ns: Option<Nanos>,
    said: Pressed,
    sent: Option<Pressed>,
    due_ns: Nanos,
}

impl PedalFeed {
    /// Reads the mapping; the device is opened later.
    ///
    /// # Errors
    /// Where the mapping is refused or is of another kind of device, or a channel fails.
    pub(super) fn open(spec: &PedalSpec, instance: &Instance) -> Result<Self> {
        let device = PedalDevice::new(spec, load(spec)?, true);
        Ok(PedalFeed {
            source: spec.to_string(),
            device,
            channel: instance.sender()?,
            condition: Condition::new("the pedal"),
            bad: Rate::default(),
            absent: None,
            was_there: false,
            gone_ns: None,
            said: UP,
            sent: None,
            due_ns: 0,
        })
    }

    /// Blocks sent so far.
    pub(super) fn sent(&self) -> u64 {
        self.channel.sent()
    }

    /// Takes in what has come, and sends what is due. A recorded file begins at `run_from`.
    pub(super) fn turn(&mut self, now: Nanos, run_from: Option<Nanos>) -> Result<()> {
        match self.device.open_if_due(now) {
            // Its next writer has still to come.
            Ok(true) if self.gone_ns.is_some() && self.device.is_pipe() => {}
            Ok(true) => (self.absent, self.was_there, self.gone_ns) = (None, true, None),
            Ok(false) => {}
            Err(why) => self.absent = Some(why),
        }
        let bad = self.device.bad;
        let gone = self.device.take(now, run_from);
        self.gone_ns = self.gone_ns.filter(|_| !self.device.has_news);
        if gone {
            self.gone_ns = self.gone_ns.or(Some(now));
        }
        self.bad.note(self.device.bad - bad, now);
        if self.device.is_file() && !self.device.is_there() {
            self.gone_ns = self.gone_ns.or(Some(now));
        }
        if std::mem::take(&mut self.device.has_news)
            && let Some(mapping) = &self.device.mapping
        {
            self.said = mapping.pressed(&self.device.inputs);
        }
        if self.gone_ns.is_some_and(|gone| now >= gone + HOLD_NS) {
            self.said = self.device.mapping.as_ref().map_or(UP, Mapping::let_go);
        }
        self.send(now)
    }

    fn send(&mut self, now: Nanos) -> Result<()> {
        if self.sent == Some(self.said) && now < self.due_ns {
            return Ok(());
        }
        (self.sent, self.due_ns) = (Some(self.said), now + EVERY_NS);
        let seq = self.channel.sent();
        let said = &self.said;
        Ok(self.channel.fill(|block| *block = said.state(seq, now))?)
    }

    /// Brings its condition up to date; returns what is to be reported.
    pub(super) fn judge(&mut self, now: Nanos) -> Option<News> {
        let trouble = match (&self.absent, self.gone_ns) {
            (Some(why), _) if !self.was_there => Some(Trouble::new(Kind::Absent, why.clone())),
            (_, Some(_)) if self.device.is_file() => {
                Some(Trouble::new(Kind::Over, "has reached the end of its file: it counts as up"))
            }
            (_, Some(_)) => Some(Trouble::new(Kind::Gone, "is disconnected: it counts as up")),
            _ if self.bad.is_much(now) => Some(Trouble::new(
                Kind::Garbled,
                "sends reports of a wrong length, or more than can be processed",
            )),
            _ => None,
        };
        self.condition.note(trouble, now)
    }

    pub(super) fn figures(&self) -> ControlFigures {
        ControlFigures {
            control: "pedal".into(),
            source: self.source.clone(),
            taken: self.device.taken,
            sent: self.sent(),
            openings: self.device.line().openings,
            bad: Some(("bad reports or events".into(), self.bad.total))
                .filter(|(_, n)| *n > 0)
                .into_iter()
                .collect(),
            missing: 0,
            troubles: self.condition.counts().map(|(kind, n)| (kind.name().into(), n)).collect(),
            trouble: self.condition.text().into(),
        }
    }
}

/// The mapping of a pedal, where one is named.
///
/// # Errors
/// Where it is refused, is of another kind of device, or must be named.
pub(crate) fn load(spec: &PedalSpec) -> Result<Option<Mapping>> {
    let Some(name) = &spec.mapping else {
        ensure!(
            spec.interface == PedalInterface::Evdev,
            "{spec}: expected hidraw:PATH,MAPPING: reports do not describe themselves"
        );
        return Ok(None);
    };
    let mapping = Mapping::load(name)?;
    let (wanted, found) = (spec.interface.prefix(), mapping.interface.prefix());
    ensure!(
        mapping.interface == spec.interface,
        "{spec}: the mapping {name} is for {found}, not for {wanted}"
    );
    Ok(Some(mapping))
}
