//! The fields of live cameras for a program that looks at them itself: `vitreo cameras` and `vitreo commission`.

use super::feed::{Feed, Field};
use crate::timing::Clock;
use anyhow::{Result, bail, ensure};
use fpga_model::input::Picture;
use ipc::Bell;
use ipc::clock::{now, sleep_until};
use protocol::fields::FieldHeader;
use protocol::time::Nanos;
use rig::Rig;
use settings::commands::cameras::{Stream, Streams};
use std::ops::ControlFlow;
use std::sync::Arc;
use std::sync::atomic::{AtomicBool, Ordering};

/// Time between two looks, ns.
const LOOK_NS: u64 = 2_000_000;
/// Time without any picture of a camera after which it is given up, ns.
const GIVEN_UP_NS: u64 = 15_000_000_000;

/// Feeds of some cameras, each with its clock once it has begun.
pub(crate) struct Capture {
    pub(crate) feeds: Vec<(Feed, Option<Clock>)>,
}

impl Capture {
    /// Starts to read the first cameras of a rig.
    pub(crate) fn start(rig: &Rig, streams: &[Stream], bell: &Bell, stop: &Arc<AtomicBool>) -> Result<Self> {
        let cameras = rig.cameras();
        let (expected, found) = (cameras.len(), streams.len());
        ensure!(found <= expected, "expected at most the rig's {expected} cameras, found {found}");
        let feed = |(camera, stream)| {
            anyhow::Ok((Feed::start(rig, camera, stream, bell.rope(), stop, now())?, None))
        };
        Ok(Capture { feeds: cameras.iter().zip(streams).map(feed).collect::<Result<_>>()? })
    }

    /// Hears of the sources, and begins those that have brought their first picture: each by itself, or all
    /// `together`, so that fields of one number are of one instant.
    pub(crate) fn listen(&mut self, at: Nanos, together: bool) -> Result<()> {
        let feeds = &mut self.feeds;
        for (feed, clock) in &mut *feeds {
            feed.listen(at);
            if clock.is_none() && together {
                feed.renew(at);
            }
            if let Some(why) = feed.defect() {
                bail!("{} {why}", feed.source);
            }
        }
        let all: Option<Vec<Nanos>> = feeds.iter().map(|(feed, _)| feed.first_ready(at)).collect();
        let common = all.and_then(|all| all.into_iter().max());
        for (feed, clock) in feeds.iter_mut().filter(|(_, clock)| clock.is_none()) {
            let start_ns = if together { common } else { feed.first_ready(at) };
            *clock = start_ns.map(|start_ns| feed.own_clock(start_ns));
        }
        Ok(())
    }

    /// Hands every field that has come by `at` to `take`: the place of its camera, what that was set to, and itself.
    pub(crate) fn publish(
        &mut self,
        at: Nanos,
        mut take: impl FnMut(usize, &str, &Field<'_>) -> Result<()>,
    ) -> Result<()> {
        for (i, (feed, clock)) in self.feeds.iter_mut().enumerate() {
            let Some(clock) = clock else { continue };
            let settings = feed.settings().to_owned();
            feed.publish(clock, u64::MAX, at, |field: &Field<'_>| take(i, &settings, field))?;
        }
        Ok(())
    }

    /// True where nothing more will come.
    pub(crate) fn is_over(&self) -> bool {
        self.feeds.iter().all(|(feed, _)| feed.is_over())
    }
}

/// A field as a picture, all of its lines.
pub struct Taken {
    /// The place of its camera in the rig.
    pub place: usize,
    /// Number, instants and parity; its camera by its id.
    pub header: FieldHeader,
    /// The pixels.
    pub picture: Picture,
}

/// Reads a source for each camera of a rig, from the first picture of all on, and hands every field to `look` until
/// that breaks, `stop` is raised, or no source will bring more.
///
/// # Errors
/// Another number of sources than the rig has cameras, one that is refused, a camera that brings nothing for 15 s
/// (with its problem in words), or those of `look`.
pub fn watch(
    rig: &Rig,
    streams: &Streams,
    stop: &Arc<AtomicBool>,
    look: &mut dyn FnMut(Taken) -> Result<ControlFlow<()>>,
) -> Result<()> {
    let (expected, streams) = (rig.cameras.len(), streams.spread(rig.cameras.len()));
    let found = streams.len();
    ensure!(found == expected, "--cameras: expected one for each of {expected} cameras, found {found}");
    let (bell, reading) = (Bell::new()?, Arc::<AtomicBool>::default());
    let mut capture = Capture::start(rig, &streams, &bell, &reading)?;
    let mut newest = vec![now(); expected];
    let mut flow = ControlFlow::Continue(());
    while flow.is_continue() && !stop.load(Ordering::Relaxed) && !capture.is_ended() {
        let at = now();
        capture.listen(at, true)?;
        capture.publish(at, |place, _, field| {
            newest[place] = at;
            if flow.is_continue() {
                flow = look(Taken { place, header: field.header, picture: field.whole() })?;
            }
            Ok(())
        })?;
        capture.give_up(&newest, at)?;
        sleep_until(at + LOOK_NS);
    }
    // The readers' threads end with it.
    reading.store(true, Ordering::Relaxed);
    Ok(())
}

impl Capture {
    /// True where every source has ended: a file at its end, a pipe that its writer has closed.
    fn is_ended(&self) -> bool {
        self.feeds.iter().all(|(feed, clock)| feed.is_over() || (clock.is_some() && feed.is_closed_pipe()))
    }

    /// Refuses to wait longer for a camera that brings nothing.
    fn give_up(&self, newest: &[Nanos], at: Nanos) -> Result<()> {
        for ((feed, clock), newest) in self.feeds.iter().zip(newest) {
            let ends = feed.is_over() || feed.is_closed_pipe();
            if ends || at.saturating_sub(*newest) < GIVEN_UP_NS {
                continue;
            }
            let trouble = feed.trouble(clock.is_some(), at);
            let why = trouble.map_or_else(|| "delivers nothing".to_owned(), |trouble| trouble.text);
            bail!("camera {} ({}) {why}", feed.camera(), feed.source);
        }
        Ok(())
    }
}
