//! Condenses traffic, events and the state of the bodies for the screen and the report. Pure.

use super::report::{Picture, Removed, TierChoice};
use protocol::events::{Event, Severity};
use protocol::frames::{DISPLAY_ESTIMATED, DISPLAY_REPORTED, FrameRecord, TierReason};
use protocol::poses::{BODY_NAMES, BodyStatus, TrackerFrame};
use protocol::time::Nanos;
use recording::Item;
use std::collections::{BTreeMap, VecDeque};

/// Counted channels, in the order of the data path.
pub const CHANNELS: [&str; 7] = ["blobs", "handles", "pedal", "poses", "steps", "frames", "events"];
/// Maximum number of tier choices kept for the report.
const TIER_CHOICES: usize = 100;
/// Maximum number of warnings kept for the screen.
const WARNINGS: usize = 3;

/// Index into [`CHANNELS`], and the timestamp from which the age of an item counts, ns.
fn place(item: &Item) -> Option<(usize, Nanos)> {
    let channel = CHANNELS.iter().position(|channel| *channel == item.topic())?;
    let instant = if let Item::Event(event) = item { Some(event.exposed_ns) } else { item.instant_ns() };
    Some((channel, instant?))
}

/// Count, age and rate of one channel.
#[derive(Debug, Clone, Copy, Default, PartialEq)]
pub struct Traffic {
    /// Number of items so far.
    pub count: u64,
    /// Timestamp of the newest item, ns; 0 before the first.
    pub newest_ns: Nanos,
    /// Items per second, between the last two calls of [`Monitor::measure`].
    pub rate_hz: f64,
    counted_before: u64,
}

/// Traffic figures so far.
#[derive(Debug, Default)]
pub struct Monitor {
    /// Traffic of each channel, in the order of [`CHANNELS`].
    pub traffic: [Traffic; CHANNELS.len()],
    /// Tracking status of each body in the newest frame, as text.
    pub bodies: [&'static str; BODY_NAMES.len()],
    /// Number of events by kind.
    pub events: BTreeMap<&'static str, u64>,
    /// The newest warnings, oldest first.
    pub warnings: VecDeque<Event>,
    /// The newest displayed frame.
    pub frame: Option<FrameRecord>,
    /// Tissue removed by vitrectors up to the newest step; `None` before the first.
    pub removed: Option<Removed>,
    frames_by_tier: BTreeMap<u32, u64>,
    /// Number of frames with a presentation time from the display server.
    reported: u64,
    tiers: Vec<TierChoice>,
    first_frame_ns: Nanos,
    measured_ns: Nanos,
}

impl Monitor {
    /// Adds an item.
    pub fn note(&mut self, item: &Item) {
        if let Some((channel, instant)) = place(item) {
            let traffic = &mut self.traffic[channel];
            traffic.count += 1;
            traffic.newest_ns = traffic.newest_ns.max(instant);
        }
        match item {
            Item::Poses(pose) => self.note_pose(pose),
            Item::Event(event) => self.note_event(event),
            Item::Frame(frame) => self.note_frame(frame),
            Item::Step(step) => self.removed = Some(Removed::of(step)),
            _ => {}
        }
    }

    /// Traffic of one of the [`CHANNELS`], by name; empty for another channel.
    pub fn traffic_of(&self, channel: &str) -> Traffic {
        let index = CHANNELS.iter().position(|name| *name == channel);
        index.map_or_else(Traffic::default, |index| self.traffic[index])
    }

    fn note_pose(&mut self, pose: &TrackerFrame) {
        for (text, body) in self.bodies.iter_mut().zip(&pose.bodies) {
            *text = BodyStatus::from_wire(body.status).map_or("unknown", BodyStatus::text);
        }
    }

    fn note_event(&mut self, event: &Event) {
        let kind = event.info().map_or("unknown", |e| e.text);
        *self.events.entry(kind).or_default() += 1;
        if event.severity >= Severity::Warning as u32 {
            self.warnings.push_back(*event);
            if self.warnings.len() > WARNINGS {
                self.warnings.pop_front();
            }
        }
    }

    fn note_frame(&mut self, frame: &FrameRecord) {
        if self.frame.is_none() {
            self.first_frame_ns = frame.displayed;
        }
        *self.frames_by_tier.entry(frame.tier).or_default() += 1;
        self.reported += u64::from(frame.flags & DISPLAY_REPORTED != 0);
        let changed = self.frame.is_none_or(|before| before.tier != frame.tier);
        if changed && self.tiers.len() < TIER_CHOICES {
            let at_s = frame.displayed.saturating_sub(self.first_frame_ns) as f64 * 1e-9;
            let reason = TierReason::of_flags(frame.flags).text();
            self.tiers.push(TierChoice { at_s, tier: frame.tier, reason });
        }
        self.frame = Some(*frame);
    }

    /// Computes the rates since the last call.
    pub fn measure(&mut self, now: Nanos) {
        let seconds = now.saturating_sub(self.measured_ns) as f64 * 1e-9;
        for traffic in &mut self.traffic {
            traffic.rate_hz = (traffic.count - traffic.counted_before) as f64 / seconds.max(1e-3);
            traffic.counted_before = traffic.count;
        }
        self.measured_ns = now;
    }

    /// Figures of the picture, with the renderer's status text; `None` if no frame was displayed.
    pub fn picture(&self, renderer: String) -> Option<Picture> {
        let frame = self.frame?;
        let frames: u64 = self.frames_by_tier.values().sum();
        let seconds = frame.displayed.saturating_sub(self.first_frame_ns) as f64 * 1e-9;
        Some(Picture {
            frames,
            frames_per_second: if seconds > 0.0 { (frames - 1) as f64 / seconds } else { 0.0 },
            missed: frame.missed,
            tier: frame.tier,
            frames_by_tier: self.frames_by_tier.clone(),
            tiers: self.tiers.clone(),
            width_px: frame.width_px,
            height_px: frame.height_px,
            displayed: displayed_by(frame.flags, self.reported),
            reported: self.reported,
            renderer,
        })
    }
}

/// Meaning of the timestamp `displayed`, given the flags of the last frame and the number of frames with a
/// presentation time.
fn displayed_by(flags: u32, reported: u64) -> &'static str {
    if reported > 0 {
        "the presentation time from the display server, or an estimate without one"
    } else if flags & DISPLAY_ESTIMATED != 0 {
        "an estimate: the first refresh after the picture was handed over"
    } else {
        "the time at which the picture was complete (no display)"
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use bytemuck::Zeroable;
    use protocol::events::EventKind;
    use protocol::steps::StepRecord;

    #[test]
    fn rates_are_those_of_the_last_interval() {
        let mut monitor = Monitor::default();
        let mut step = StepRecord::zeroed();
        step.instants.stepped = 77;
        monitor.measure(1_000_000_000);
        (0..100).for_each(|_| monitor.note(&Item::Step(step)));
        monitor.measure(3_000_000_000);
        assert_eq!((monitor.traffic[4].rate_hz, monitor.traffic[4].newest_ns), (50.0, 77));
        monitor.measure(4_000_000_000);
        assert_eq!((monitor.traffic[4].rate_hz, monitor.traffic[4].count), (0.0, 100));
    }

    #[test]
    fn warnings_are_kept_newest_last_and_every_event_is_counted() {
        let mut monitor = Monitor::default();
        for seq in 0..5 {
            let severity = if seq == 4 { Severity::Info } else { Severity::Warning } as u32;
            let kind = EventKind::RimForceHigh as u32;
            monitor.note(&Item::Event(Event { seq, severity, kind, ..Event::zeroed() }));
        }
        assert_eq!(monitor.warnings.iter().map(|e| e.seq).collect::<Vec<_>>(), [1, 2, 3]);
        assert_eq!(monitor.events[EventKind::RimForceHigh.info().text], 5);
    }

    #[test]
    fn the_picture_is_summed_up_by_tier() {
        let mut monitor = Monitor::default();
        assert!(monitor.picture(String::new()).is_none());
        for i in 0..11u64 {
            let tier = u32::from(i > 2);
            let displayed = 1 + i * 100_000_000;
            let why = if tier == 0 { TierReason::Start } else { TierReason::Overload };
            let frame = FrameRecord { displayed, tier, flags: why.flags(), ..FrameRecord::zeroed() };
            monitor.note(&Item::Frame(frame));
        }
        let picture = monitor.picture("x".into()).unwrap();
        assert_eq!((picture.frames, picture.tier), (11, 1));
        assert!((picture.frames_per_second - 10.0).abs() < 1e-9);
        assert_eq!(picture.frames_by_tier, BTreeMap::from([(0, 3), (1, 8)]));
        let choices: Vec<_> = picture.tiers.iter().map(|c| (c.tier, c.reason)).collect();
        assert_eq!(choices, [(0, TierReason::Start.text()), (1, TierReason::Overload.text())]);
        assert!((picture.tiers[1].at_s - 0.3).abs() < 1e-9);
        assert!(picture.displayed.starts_with("the time at which"));
        monitor.note(&Item::Frame(FrameRecord { flags: DISPLAY_ESTIMATED, ..FrameRecord::zeroed() }));
        assert!(monitor.picture("x".into()).unwrap().displayed.starts_with("an estimate"));
        for flags in [DISPLAY_REPORTED, DISPLAY_ESTIMATED] {
            monitor.note(&Item::Frame(FrameRecord { flags, ..FrameRecord::zeroed() }));
        }
        let picture = monitor.picture("x".into()).unwrap();
        assert_eq!(
            (
                picture.reported,
                picture.displayed.starts_with("the presentation time from the display server")
            ),
            (1, true)
        );
    }
}
