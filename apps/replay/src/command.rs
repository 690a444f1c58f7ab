//! `vitreo replay`: a recording runs through tracker and simulation again ([`crate::engine`]), at its
//! pace or as fast as it can be computed, and is compared, counted and written.

use crate::engine::{Made, Recorded, Streamed, stream};
use crate::film::PICTURES_PER_S;
use crate::interactive;
use crate::likely_cause::{self, OfLast};
use crate::misfits::Misfits;
use crate::other_build;
use crate::pace::{Pace, Part, Stopped};
use crate::pixels;
use crate::report::{Figures, Products};
use crate::resimulate::scene_of;
use crate::screen::Screen;
use crate::stop::StopSignal;
use crate::verify::Verdict;
use crate::what_if;
use anyhow::{Context, bail};
use collision::backend::Backend;
use diagnosis::{sentences, unjudged, untracked, warned};
use ipc::clock::now;
use ipc::logging::{inform, warn};
use outputs::exit::{DIFFERS, LOSS, UNTRACKED, WARNED};
use outputs::{println, shell_word};
use recording::{Recording, RecordingError, Source};
use rig::Rig;
use settings::commands::ReplayArgs;
use simcore::world::World;
use std::ops::ControlFlow;
use std::process::ExitCode;
use std::sync::Arc;
use std::time::Instant;

/// Runs it.
///
/// # Errors
/// Where the recording cannot be read or replayed, or a file cannot be written.
pub fn run(args: &ReplayArgs) -> anyhow::Result<ExitCode> {
    if pixels::is_recorded(&args.file) {
        if what_if::is_wanted(&args.what_if) || args.with.is_some() {
            bail!(
                "{}: a recording of pixels can only be replayed, not changed or compared",
                args.file.display()
            );
        }
        return replay(args, &pixels::found(&args.file, args.colours.as_deref())?.recording);
    }
    pixels::check_colours(&args.file, args.colours.as_deref())?;
    if what_if::is_wanted(&args.what_if) {
        return what_if::run(args);
    }
    if let Some(program) = &args.with {
        return other_build::run(args, program);
    }
    replay(args, &Recording::open(&args.file)?)
}

/// Replays a recording, or the blobs of one of pixels.
fn replay(args: &ReplayArgs, recording: &Recording) -> anyhow::Result<ExitCode> {
    let desk = recording.provenance().config.contains_key(recording::DESK);
    check(args, recording, desk)?;
    if args.is_watched() {
        return interactive::run(args, recording, &StopSignal::install().context("signals")?);
    }
    let rig = Rig::parse(&recording.provenance().rig_json, "of the recording")?;
    tracker::rig_check::check(&rig).context("the recording's rig is not usable")?;
    let mut products = Products::open(args, &rig)?;
    products.figures.desk = desk;
    let verdict = args.verify.then(|| Verdict::new(recording.provenance(), desk));
    let stop = StopSignal::install().context("signals")?;
    let pace = Pace::new(args, &stop);
    let mut replay = Replay { args, recording, rig, pace, products, verdict, screen: None };
    let played = replay.play();
    let pictures = replay.screen.take().map(Screen::finish).transpose()?;
    let stopped = was_stopped(played, &mut replay.products.figures)?;
    let judged = if stopped { None } else { likely_cause::at_end(recording, || stop.is_raised()) };
    let Replay { mut products, verdict, .. } = replay;
    products.judged(judged.as_ref().and_then(OfLast::judged));
    products.figures.unclosed = !recording.is_finished();
    products.figures.verify = verdict;
    let figures = products.finish()?;
    print(&figures, judged.as_ref());
    pictures.iter().for_each(|pictures| print_pictures(args, *pictures));
    if stopped && args.is_unpaced() {
        bail!(Stopped);
    }
    if !stopped && stop.is_raised() && judged.is_none() {
        let file = shell_word(args.file.display());
        warn(&format!(
            "the search for the cause of the residuals was stopped; to continue: vitreo residuals {file} --causes"
        ));
        bail!(Stopped);
    }
    judge(args, &figures, judged.as_ref())
}

/// Notes how the recording ends; true if the user stopped the replay before.
fn was_stopped(
    played: anyhow::Result<Option<Arc<RecordingError>>>,
    figures: &mut Figures,
) -> anyhow::Result<bool> {
    match played {
        Ok(damage) => {
            figures.cut = matches!(damage.as_deref(), Some(RecordingError::Truncated { .. }));
            figures.damage = damage.map(|d| d.to_string());
            Ok(false)
        }
        Err(error) if error.is::<Stopped>() => Ok(true),
        Err(error) => Err(error),
    }
}

/// Refuses what cannot be asked of a recording.
fn check(args: &ReplayArgs, recording: &Recording, desk: bool) -> anyhow::Result<()> {
    let file = args.file.display();
    if desk && (args.blobs.is_some() || args.assert_tracking.is_some() || args.assert_no_warnings) {
        bail!("{file}: a desk recording without cameras: it has no blobs, and nothing was tracked");
    }
    if args.as_recorded && recording.provenance().source == Source::Import {
        bail!("{file}: an imported stream has no recorded poses to show");
    }
    if args.verify && recording.provenance().source == Source::Import {
        bail!("{file}: an imported stream has no results to compare with");
    }
    Ok(args.span.check(&args.file, || recording.exposed_s())?)
}

/// The exit code, by what was asserted and compared.
fn judge(args: &ReplayArgs, figures: &Figures, judged: Option<&OfLast>) -> anyhow::Result<ExitCode> {
    if let Some(verdict) = figures.verify.as_ref().filter(|v| v.is_empty()) {
        bail!("{}: nothing could be compared: {}", args.file.display(), verdict.reasons.join("; "));
    }
    let (body, tracked) = figures.least_tracked;
    if let Some(asserted) = args.assert_tracking.filter(|asserted| tracked < *asserted) {
        warn(&untracked(body, tracked, asserted));
        return Ok(ExitCode::from(UNTRACKED));
    }
    if let Some(warned) = warned(&figures.warnings).filter(|_| args.assert_no_warnings) {
        warn(&warned);
        return Ok(ExitCode::from(WARNED));
    }
    // Without anything to judge there are no warnings either.
    let shortage = judged.and_then(|judged| judged.judgement.shortage());
    if let Some(shortage) = shortage.filter(|_| args.assert_no_warnings) {
        warn(&unjudged(&shortage));
        return Ok(ExitCode::from(WARNED));
    }
    Ok(ExitCode::from(code(figures)))
}

/// A replay under way.
struct Replay<'a> {
    args: &'a ReplayArgs,
    recording: &'a Recording,
    rig: Rig,
    pace: Pace,
    products: Products,
    verdict: Option<Verdict>,
    screen: Option<Screen>,
}

impl Replay<'_> {
    /// Replays once or for ever; returns how the recording ends.
    fn play(&mut self) -> anyhow::Result<Option<Arc<RecordingError>>> {
        loop {
            let world = self.world()?;
            let begun = Instant::now();
            let outcome = match self.recording.provenance().source {
                Source::Live => self.recorded(world),
                Source::Import => self.imported(world),
            };
            // Also where the user stopped it.
            self.products.figures.wall_s += begun.elapsed().as_secs_f64();
            let damage = outcome?;
            if !self.args.endless {
                return Ok(damage);
            }
            self.pace.rewind();
        }
    }

    /// The world at the start of the recording's scene, and the screen on which it is shown.
    fn world(&mut self) -> anyhow::Result<World> {
        let scene = scene_of(self.recording)?;
        let mut world = World::new(&scene).context("scene")?;
        if self.args.draws() {
            let outputs = self.products.outputs();
            self.screen =
                Some(Screen::begin(self.args, self.recording, (&scene, &world), &self.rig, outputs)?);
        } else {
            world = world.unseen();
        }
        let wanted = self.args.collision.collision.as_deref().and_then(Backend::named).unwrap_or_default();
        if let Some(choice) = world.choose_collision(wanted, &mut now) {
            match wanted == Backend::Gpu && !choice.on_gpu {
                true => tracing::warn!("{choice}"),
                false => tracing::info!("{choice}"),
            }
        }
        Ok(world)
    }

    fn recorded(&mut self, world: World) -> anyhow::Result<Option<Arc<RecordingError>>> {
        let mut run = Recorded::new(self.recording, &self.rig, world);
        if self.args.as_recorded {
            run = run.as_recorded();
        }
        let mut ended = run.run_to_end(|made| self.take(made))?;
        if let Some(verdict) = &mut self.verdict {
            verdict.states.missing += ended.steps.done.missing;
            verdict.pass_over_steps(ended.steps.left_out());
        }
        if ended.stopped {
            ended.due.end_here();
        }
        self.products.count_by(ended.due);
        let behind = ended.frames_lost.map(|why| format!("the last field: {why}"));
        let lost = self.products.figures.lost.take().or(ended.steps.lost);
        self.products.figures.lost = lost.or(behind.filter(|_| !ended.stopped));
        Ok(ended.damage)
    }

    /// Takes what came of a recorded run.
    fn take(&mut self, made: Made<'_>) -> anyhow::Result<ControlFlow<()>> {
        match made {
            Made::Frame(turn, frame, matches) => {
                let part = self.pace.part(turn.recorded.instants.exposed);
                if part == Part::After {
                    return Ok(ControlFlow::Break(()));
                }
                let shown = part == Part::Shown;
                tracing::debug!(field = turn.recorded.field, "replayed");
                if shown {
                    self.pace.await_due(turn.recorded.instants.tracked)?;
                }
                turn.fields.iter().try_for_each(|field| self.products.field(field, shown))?;
                self.products.frame(frame, matches, shown)?;
                if let (Some(why), None) = (&turn.lost, &self.products.figures.lost) {
                    self.products.figures.lost = Some(format!("field {}: {why}", turn.recorded.field));
                }
                match &mut self.verdict {
                    Some(verdict) if turn.determined => verdict.pose(&turn.recorded, frame),
                    Some(verdict) => verdict.pass_over_pose(),
                    None => {}
                }
            }
            Made::Step(again) => {
                if self.pace.part(again.recorded.instants.exposed) == Part::After {
                    return Ok(ControlFlow::Continue(()));
                }
                self.products.step(again.step.state_hash);
                if let Some(verdict) = &mut self.verdict {
                    verdict.pass_over_steps(again.left_out);
                    verdict.step(&again.recorded, &again.step);
                }
                if let Some(screen) = &mut self.screen {
                    return screen.step(again);
                }
            }
        }
        Ok(ControlFlow::Continue(()))
    }

    fn imported(&mut self, world: World) -> anyhow::Result<Option<Arc<RecordingError>>> {
        let Replay { args, recording, rig, pace, products, screen, .. } = self;
        let (sensors, mut misfits) = (rig.sensors(), Misfits::default());
        let damage = stream(recording, rig, world, |made| {
            match made {
                Streamed::Field(field, _) => {
                    misfits.note(&sensors, field);
                    let part = pace.part(field.exposed_ns);
                    if part == Part::After {
                        return Ok(ControlFlow::Break(()));
                    }
                    if part == Part::Shown {
                        pace.await_due(field.blobs_out_ns)?;
                    }
                    products.field(field, part == Part::Shown)?;
                }
                Streamed::Frame { frame, matches, world, report, .. } => {
                    let part = pace.part(frame.instants.exposed);
                    products.frame(frame, Some(matches), part == Part::Shown)?;
                    products.step(report.state_hash);
                    if let Some(screen) = screen.as_mut().filter(|_| part != Part::After) {
                        return screen.streamed(frame, world, report.state_hash);
                    }
                }
            }
            Ok(ControlFlow::Continue(()))
        })?;
        let figures = &products.figures;
        if figures.frames == 0 && figures.camera_fields > 0 && misfits != Misfits::default() {
            bail!(untrackable(args, figures.camera_fields, misfits));
        }
        Ok(damage.map(Arc::new))
    }
}

/// Why a stream of so many camera-fields gives no frame at all.
fn untrackable(args: &ReplayArgs, camera_fields: u64, misfits: Misfits) -> String {
    let (file, misfits) = (args.file.display(), misfits.words().join("; "));
    format!(
        "{file}: none of {camera_fields} camera-fields fits the rig with which the stream was imported, so nothing was \
         tracked: {misfits}. Import it with the rig that saw it"
    )
}

/// What was replayed, and how fast as far as that was measured.
fn summary(figures: &Figures) -> String {
    let Figures { camera_fields, frames, steps, stream_s, wall_s, .. } = figures;
    let counts = format!("{camera_fields} camera-fields, {frames} tracker frames, {steps} steps");
    match (*stream_s > 0.0, *wall_s > 0.0) {
        (true, true) => {
            let speed = stream_s / wall_s;
            format!("{counts}; {stream_s:.2} s in {wall_s:.2} s ({speed:.1} times real time)")
        }
        (true, false) => format!("{counts}; {stream_s:.2} s"),
        (false, _) => counts,
    }
}

fn print(figures: &Figures, judged: Option<&OfLast>) {
    println!("{}", summary(figures));
    let fields_refused = figures.fields_refused;
    if fields_refused > 0 {
        println!(
            "{fields_refused} camera-fields refused by the tracker (twice, out of order, unknown camera)"
        );
    }
    figures.tracking.lines.iter().for_each(|line| println!("{line}"));
    if let Some(verdict) = &figures.verify {
        println!("{}", verdict.text());
        if !verdict.reasons.is_empty() {
            println!("not all is verified: {}", verdict.reasons.join("; "));
        }
    }
    if let (Some(lost), None) = (&figures.lost, &figures.verify) {
        println!("the recording has gaps; the first: {lost}");
    }
    if figures.unclosed && figures.damage.is_none() {
        warn("the recording was not closed properly: it was replayed up to its last complete record");
    }
    judged.and_then(OfLast::paragraph).into_iter().for_each(|cause| println!("{cause}"));
    let stated = judged.and_then(OfLast::stated);
    sentences(&figures.warnings, stated.as_ref()).iter().for_each(|text| warn(text));
    if let Some(damage) = &figures.damage {
        warn(&damage.to_string());
    }
}

/// How long the film is, and where it lies.
fn print_pictures(args: &ReplayArgs, pictures: u64) {
    inform(&format!("{:.1} s of pictures", pictures as f64 / PICTURES_PER_S));
    for path in args.video.iter().chain(&args.drawing.stills) {
        println!("{}", path.display());
    }
}

/// The exit code. A recording that was not closed is what a crash leaves, and no loss of the replay's;
/// but to verify it is to ask whether it is whole.
fn code(figures: &Figures) -> u8 {
    let Some(verdict) = &figures.verify else {
        let damaged = figures.damage.is_some() && !figures.cut;
        return if damaged || figures.lost.is_some() { LOSS } else { 0 };
    };
    match (&verdict.difference, verdict.reasons.is_empty()) {
        (Some(_), _) => DIFFERS,
        (None, true) => 0,
        (None, false) => LOSS,
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn exit_codes_follow_the_contract() {
        let verified = |difference: Option<&str>, change: fn(&mut Figures)| {
            let mut verdict = Verdict { difference: difference.map(Into::into), ..Verdict::default() };
            (verdict.poses.recorded, verdict.poses.compared, verdict.states.recorded) = (1, 1, 1);
            let mut figures = Figures { verify: Some(verdict), camera_fields: 1, ..Figures::default() };
            change(&mut figures);
            let reasons = figures.reasons();
            figures.verify.as_mut().unwrap().reasons = reasons;
            figures
        };
        assert_eq!(code(&verified(None, |_| {})), 0);
        assert_eq!(code(&verified(Some("field 4"), |f| f.lost = Some("field 9".into()))), DIFFERS);
        let losses: [fn(&mut Figures); 9] = [
            |f| f.camera_fields = 0,
            |f| f.lost = Some("field 9".into()),
            |f| (f.damage, f.cut) = (Some("cut".into()), true),
            |f| f.damage = Some("damaged".into()),
            |f| f.unclosed = true,
            |f| f.tracking.frames_due = 1,
            |f| f.verify.as_mut().unwrap().states.other_version = Some(7),
            |f| f.verify.as_mut().unwrap().poses.other_version = Some(7),
            |f| f.verify.as_mut().unwrap().poses.recorded = 2,
        ];
        for loss in losses {
            let figures = verified(None, loss);
            let reasons = &figures.verify.as_ref().unwrap().reasons;
            assert_eq!((code(&figures), reasons.len()), (LOSS, 1), "{reasons:?}");
        }
        let replayed = |damage: &str, cut| Figures { damage: Some(damage.into()), cut, ..Figures::default() };
        assert_eq!((code(&replayed("cut", true)), code(&replayed("damaged", false))), (0, LOSS));
        assert_eq!(code(&Figures { unclosed: true, ..Figures::default() }), 0);
    }

    #[test]
    fn a_speed_is_told_where_it_was_measured() {
        let figures = |stream_s, wall_s| Figures { stream_s, wall_s, frames: 147, ..Figures::default() };
        assert!(summary(&figures(2.94, 1.47)).ends_with("2.94 s in 1.47 s (2.0 times real time)"));
        assert!(summary(&figures(2.94, 0.0)).ends_with("147 tracker frames, 0 steps; 2.94 s"));
        assert!(summary(&figures(0.0, 0.0)).ends_with("147 tracker frames, 0 steps"));
    }
}
