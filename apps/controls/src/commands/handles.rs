//! `vitreo handles`: what the encoders in the handles send, live, and the calibration of their jaws.

use super::person::{Answer, Person};
use crate::encoder::{Heard, LineReader};
use crate::process::line::{Got, Line};
use anyhow::{Context, Result, anyhow, bail, ensure};
use ipc::clock::{now, sleep_until};
use outputs::{Force, Outputs};
use protocol::limits::INSTRUMENTS;
use rig::Rig;
use rig::handles::RigHandle;
use settings::commands::controls::HandlesSpec;
use std::collections::VecDeque;
use std::path::PathBuf;

/// Time between two looks, ns.
const LOOK_NS: u64 = 20_000_000;
/// Time after Enter in which samples still count, ns.
const AFTER_NS: u64 = 100_000_000;
/// Samples of which the middle one counts.
const KEPT: usize = 101;

/// Arguments of `vitreo handles`.
#[derive(Debug, Clone, clap::Args)]
#[command(
    after_help = "Shows each handle's input and errors until Ctrl-C. --calibrate asks you to close and open the \
    jaws and writes RIG with a handles section to --output (docs/handles.md)."
)]
pub struct HandlesArgs {
    /// Serial port: serial:/dev/ttyUSB0[?baud=115200].
    #[arg(value_name = "SPEC")]
    pub handles: HandlesSpec,
    /// Calibrate the jaws for this rig.
    #[arg(long, value_name = "RIG.json", requires = "output")]
    pub calibrate: Option<PathBuf>,
    /// File for the rig with the calibrated handles.
    #[arg(short, long, value_name = "FILE.json", requires = "calibrate")]
    pub output: Option<PathBuf>,
    /// Angle of the jaws when open, rad.
    #[arg(long, value_name = "RAD", default_value_t = 0.9, value_parser = opening)]
    pub open_rad: f64,
    /// `--force`.
    #[command(flatten)]
    pub force: Force,
}

fn opening(text: &str) -> Result<f64, String> {
    let value: f64 = text.parse().map_err(|_| format!("expected radians, found '{text}'"))?;
    if (0.02..=2.0).contains(&value) { Ok(value) } else { Err("expected 0.02 to 2 rad".into()) }
}

/// Shows or calibrates.
///
/// # Errors
/// Where the line or the rig is refused, the output exists, or no handle was heard.
pub fn run(args: &HandlesArgs) -> Result<()> {
    let mut outputs = Outputs::new(args.force.force).reading(&args.handles.path);
    let rig = args.calibrate.as_deref().map(Rig::load).transpose()?;
    if let (Some(rig), Some(output)) = (&args.calibrate, &args.output) {
        outputs.add_input(rig);
        outputs.claim(output)?;
    }
    let mut person = Person::new()?;
    let mut listener = Listener::open(&args.handles)?;
    let (Some(mut rig), Some(output)) = (rig, &args.output) else { return watch(&mut listener, &mut person) };
    rig.handles = calibrate(&mut listener, &mut person, &rig, args.open_rad)?;
    let text = rig.to_json() + "\n";
    Rig::parse(&text, "the calibrated rig")?;
    outputs.write(output, text)?;
    outputs::println!(
        "{} is written; vitreo run --rig {} --handles {}",
        output.display(),
        outputs::shell_word(output.display()),
        outputs::shell_word(&args.handles)
    );
    Ok(())
}

/// One handle as it was heard.
#[derive(Debug, Clone, Default)]
struct Hand {
    /// The newest counts.
    counts: VecDeque<i32>,
    tool: String,
}

impl Hand {
    /// The middle one of the newest counts: noise does not move it.
    fn count(&self) -> Option<i32> {
        let mut counts: Vec<i32> = self.counts.iter().copied().collect();
        counts.sort_unstable();
        counts.get(counts.len() / 2).copied()
    }
}

/// Listens to a line.
struct Listener {
    line: Line,
    reader: LineReader,
    hands: [Hand; INSTRUMENTS],
    samples: u64,
    missing: u64,
    bad: u64,
    newest_bad: String,
}

impl Listener {
    fn open(spec: &HandlesSpec) -> Result<Self> {
        let mut line = Line::new(&spec.path, Some(spec.baud));
        line.open(now()).map_err(|why| anyhow!("{spec} {why}"))?;
        let (reader, hands) = (LineReader::default(), <[Hand; INSTRUMENTS]>::default());
        Ok(Listener { line, reader, hands, samples: 0, missing: 0, bad: 0, newest_bad: String::new() })
    }

    /// Takes in what has come; returns whether the line is gone.
    fn take(&mut self) -> bool {
        let mut buffer = [0; 4096];
        loop {
            let bytes = match self.line.read(&mut buffer) {
                Got::Nothing => return false,
                Got::Closed => return true,
                Got::Bytes(bytes) => bytes,
            };
            let Listener { reader, hands, samples, missing, bad, newest_bad, .. } = self;
            reader.take(&buffer[..bytes], |heard| match heard {
                Heard::Sample(sample) => {
                    *samples += 1;
                    let hand = &mut hands[sample.handle as usize];
                    if hand.counts.len() == KEPT {
                        hand.counts.pop_front();
                    }
                    hand.counts.push_back(sample.count);
                    hand.tool = sample
                        .tool
                        .map_or_else(|| "no tool reported".into(), |tool| format!("{tool:?}").to_lowercase());
                }
                Heard::Gap(lines) => *missing += u64::from(lines),
                Heard::Bad(why) => (*bad, *newest_bad) = (*bad + 1, why.to_string()),
                Heard::Restart => {}
            });
        }
    }

    fn text(&self) -> String {
        let of = |(i, hand): (usize, &Hand)| match hand.counts.back() {
            Some(count) => format!("handle {i}: {count} ({})", hand.tool),
            None => format!("handle {i}: nothing yet"),
        };
        let hands: Vec<String> = self.hands.iter().enumerate().map(of).collect();
        let mut text = format!("{}  {} samples", hands.join("  "), self.samples);
        if self.missing > 0 {
            text += &format!(", {} missing", self.missing);
        }
        if self.bad > 0 {
            text += &format!(", {} lines refused ({})", self.bad, self.newest_bad);
        }
        text
    }
}

fn watch(listener: &mut Listener, person: &mut Person) -> Result<()> {
    while !person.has_left() {
        let at = now();
        let gone = listener.take();
        person.show(&listener.text())?;
        if gone {
            person.end_line();
            outputs::println!("the line was disconnected");
            return Ok(());
        }
        sleep_until(at + LOOK_NS);
    }
    person.end_line();
    Ok(())
}

/// Asks to close and to open the jaws; returns the section of the rig. What it says of handles that are not
/// heard stays.
fn calibrate(
    listener: &mut Listener,
    person: &mut Person,
    rig: &Rig,
    open_rad: f64,
) -> Result<Vec<RigHandle>> {
    let closed = counts(listener, person, "Close the jaws of all handles, hold them, and press Enter.")?;
    let open = counts(listener, person, "Let them open fully, and press Enter.")?;
    ensure!(
        closed.iter().zip(&open).any(|(c, o)| c.is_some() && o.is_some()),
        "no handle sent a sample; check the line with vitreo handles, without --calibrate"
    );
    let hand = |i: usize| -> Result<Option<RigHandle>> {
        let instrument = i as u32;
        let (Some(closed), Some(open)) = (closed[i], open[i]) else {
            outputs::println!("handle {i} sent no sample");
            return Ok(rig.handle(instrument).copied());
        };
        ensure!(
            open.abs_diff(closed) >= 8,
            "handle {i}: expected counts that are at least 8 apart, found {closed} closed and {open} open: were the jaws moved?"
        );
        outputs::println!("handle {i}: {closed} closed, {open} open");
        Ok(Some(RigHandle { instrument, closed, open, open_rad }))
    };
    let hands: Vec<Option<RigHandle>> =
        (0..INSTRUMENTS).map(hand).collect::<Result<_>>().context("nothing was written")?;
    Ok(hands.into_iter().flatten().collect())
}

/// The count of each handle when Enter is pressed, and a moment later: a line delivers late.
fn counts(
    listener: &mut Listener,
    person: &mut Person,
    question: &str,
) -> Result<[Option<i32>; INSTRUMENTS]> {
    person.ask(question)?;
    listener.hands.iter_mut().for_each(|hand| hand.counts.clear());
    let mut until = None;
    loop {
        if until.is_some_and(|until| now() >= until) {
            return Ok(std::array::from_fn(|i| listener.hands[i].count()));
        }
        let answer = person.answer()?;
        // Everything that was sent before Enter.
        let gone = listener.take();
        person.show_beside(&listener.text())?;
        match answer {
            _ if until.is_some() => {}
            Answer::Enter => until = Some(now() + AFTER_NS),
            Answer::Over => bail!("standard input ended; nothing was written"),
            Answer::None if gone => bail!("the line was disconnected; nothing was written"),
            Answer::None => {}
        }
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn the_middle_count_is_not_moved_by_noise() {
        let hand =
            |counts: &[i32]| Hand { counts: counts.iter().copied().collect(), tool: String::new() }.count();
        assert_eq!(hand(&[5, i32::MAX, 4, 6, i32::MIN]), Some(5));
        assert_eq!((hand(&[7]), hand(&[])), (Some(7), None));
    }

    #[test]
    fn openings_are_in_radians() {
        assert_eq!(opening("0.5"), Ok(0.5));
        for text in ["45", "0", "wide", "nan", ""] {
            assert!(opening(text).is_err(), "{text}");
        }
    }
}
