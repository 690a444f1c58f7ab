//! `vitreo pedal`: what a pedal does, live, and a mapping learnt from a person who presses it.

use super::person::{Answer, Person};
use crate::inputs::Inputs;
use crate::learn::Learner;
use crate::mapping::Mapping;
use crate::process::device::PedalDevice;
use crate::process::pedal::load;
use anyhow::{Context, Result, bail};
use ipc::clock::{now, sleep_until};
use outputs::{Force, Outputs};
use protocol::optics::PedalButton;
use settings::commands::controls::PedalSpec;
use std::path::PathBuf;

/// Time between two looks, ns.
const LOOK_NS: u64 = 20_000_000;

/// Arguments of `vitreo pedal`.
#[derive(Debug, Clone, clap::Args)]
#[command(
    after_help = "Shows every axis and button as it moves, and its meaning by the mapping, until Ctrl-C. --learn \
    asks for each input in turn and writes a mapping for vitreo run --pedal (docs/controls.md)."
)]
pub struct PedalArgs {
    /// The pedal: evdev:/dev/input/eventN[,MAPPING] or hidraw:/dev/hidrawN[,MAPPING]; without a mapping, raw
    /// inputs are shown.
    #[arg(value_name = "SPEC")]
    pub pedal: PedalSpec,
    /// Learn a mapping from presses of the pedal and write it to this file.
    #[arg(long, value_name = "FILE.toml")]
    pub learn: Option<PathBuf>,
    /// `--force`.
    #[command(flatten)]
    pub force: Force,
}

/// What is asked for: the pedal's axis or button, and its name for a person.
const AXES: [&str; 2] = [
    "the pedal of the first axis (suction, injection, zoom)",
    "the pedal of the second axis (cutting, focus)",
];
const BUTTONS: [(PedalButton, &str); 8] = [
    (PedalButton::Lens, "the button of the wide-angle lens"),
    (PedalButton::Filter, "the button of the lamp's filters"),
    (PedalButton::Inverter, "the button of the inverter"),
    (PedalButton::Magnify, "the button that magnifies"),
    (PedalButton::Reduce, "the button that reduces"),
    (PedalButton::Pause, "the button that pauses"),
    (PedalButton::Restart, "the button that restarts the attempt"),
    (PedalButton::Next, "the button of the next level"),
];

/// Shows or learns.
///
/// # Errors
/// Where the mapping or the device is refused, the output exists, or nothing was learnt.
pub fn run(args: &PedalArgs) -> Result<()> {
    let mapping = if args.pedal.mapping.is_some() { load(&args.pedal)? } else { None };
    let mut outputs = Outputs::new(args.force.force).reading(&args.pedal.path);
    if let Some(file) = &args.learn {
        outputs.claim(file)?;
    }
    let mut pedal = PedalDevice::new(&args.pedal, mapping, false);
    pedal.open_if_due(now()).map_err(|why| anyhow::anyhow!("{} {why}", args.pedal))?;
    let mut person = Person::new()?;
    match &args.learn {
        None => watch(&mut pedal, &mut person),
        Some(file) => {
            let learnt =
                Walk { pedal: &mut pedal, person: &mut person, name: args.pedal.to_string() }.learn()?;
            outputs.write(file, learnt.to_toml())?;
            outputs::println!(
                "{} is written; vitreo run --pedal {}",
                file.display(),
                outputs::shell_word(format!(
                    "{}{},{}",
                    args.pedal.interface.prefix(),
                    args.pedal.path.display(),
                    file.display()
                ))
            );
            Ok(())
        }
    }
}

/// Shows the device until Ctrl-C, or until it is gone for good.
fn watch(pedal: &mut PedalDevice, person: &mut Person) -> Result<()> {
    let begun = now();
    while !person.has_left() {
        let at = now();
        let gone = pedal.take(at, Some(begun));
        person.show(&line(&pedal.inputs, pedal.mapping.as_ref()))?;
        if gone || !pedal.is_there() {
            person.end_line();
            outputs::println!("the pedal was disconnected");
            return Ok(());
        }
        sleep_until(at + LOOK_NS);
    }
    person.end_line();
    Ok(())
}

/// What a device says, and what a mapping makes of it.
fn line(inputs: &Inputs, mapping: Option<&Mapping>) -> String {
    let mut words: Vec<String> = inputs.heard().map(|(input, value)| format!("{input} {value}")).collect();
    if !inputs.report().is_empty() {
        words.push(inputs.report().iter().map(|byte| format!("{byte:02x}")).collect::<Vec<_>>().join(" "));
    }
    if words.is_empty() {
        words.push("nothing yet: press the pedal".into());
    }
    let Some(mapping) = mapping else { return words.join("  ") };
    let pressed = mapping.pressed(inputs);
    let held: Vec<String> = BUTTONS
        .iter()
        .filter(|(button, _)| button.is_in(pressed.buttons))
        .map(|(button, _)| format!("{button:?}").to_lowercase())
        .collect();
    let [first, second] = pressed.axes;
    let mode = format!("{:?}", pressed.mode).to_lowercase();
    format!("{}  →  {mode} {first:+.2} {second:+.2} {}", words.join("  "), held.join(" "))
}

/// The walk through everything that can be pressed.
struct Walk<'a> {
    pedal: &'a mut PedalDevice,
    person: &'a mut Person,
    name: String,
}

impl Walk<'_> {
    fn learn(&mut self) -> Result<Mapping> {
        let mut learner = Learner::new(self.pedal.interface(), &self.name);
        self.look("Let go of everything, then press Enter.")?;
        for (axis, what) in AXES.into_iter().enumerate() {
            self.step(what, |pressed, released| {
                learner.axis(axis, pressed, released).map(|i| i.to_string())
            })?;
        }
        for (button, what) in BUTTONS {
            self.step(what, |pressed, released| {
                learner.button(button, pressed, released).map(|i| i.to_string())
            })?;
        }
        learner.mapping().context("nothing was learnt: no axis or button moved")
    }

    /// Asks for one of them, pressed and let go.
    fn step(&mut self, what: &str, mut learn: impl FnMut(&Inputs, &Inputs) -> Option<String>) -> Result<()> {
        let before = self.pedal.inputs.clone();
        let pressed = self.look(&format!(
            "Press {what} fully, hold it, and press Enter; press only Enter if the pedal has none."
        ))?;
        if pressed == before {
            return Ok(());
        }
        let released = self.look("Let go of it, and press Enter.")?;
        let learnt = learn(&pressed, &released);
        let text = learnt.map_or("  left out: nothing new moved".into(), |input| format!("  {input}"));
        self.person.ask(&text)
    }

    /// Shows the device until Enter; returns where everything stood then.
    fn look(&mut self, question: &str) -> Result<Inputs> {
        self.person.ask(question)?;
        loop {
            let answer = self.person.answer()?;
            // Everything that was done before Enter.
            let gone = self.pedal.take(now(), Some(0));
            self.person.show_beside(&line(&self.pedal.inputs, None))?;
            match answer {
                Answer::Enter => return Ok(self.pedal.inputs.clone()),
                Answer::Over => bail!("standard input ended; nothing was written"),
                Answer::None if gone => bail!("the pedal was disconnected; nothing was written"),
                Answer::None => {}
            }
        }
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::events::{ABS, Event, KEY};

    #[test]
    fn a_line_says_what_moves_and_what_it_means() {
        let mut inputs = Inputs::default();
        assert!(line(&inputs, None).contains("press the pedal"));
        inputs.note(Event { at_us: 0, kind: KEY, code: 30, value: 1 });
        inputs.note(Event { at_us: 0, kind: KEY, code: 46, value: 1 });
        inputs.note(Event { at_us: 0, kind: ABS, code: 2, value: -7 });
        assert_eq!(line(&inputs, None), "ABS_Z -7  KEY_A 1  KEY_C 1");
        let mapping = Mapping::load("keyboard-switch").unwrap();
        assert!(line(&inputs, Some(&mapping)).ends_with("→  aspirate +1.00 +0.00 lens"));
        let mut inputs = Inputs::default();
        inputs.note_report(&[4, 255]);
        let mapping = Mapping::load("three-pedals").unwrap();
        assert_eq!(line(&inputs, Some(&mapping)).trim_end(), "04 ff  →  zoom +1.00 +0.00");
    }
}
