//! `vitreo inspect`: the cameras' view of a field and what the tracker made of it, or residuals over time; as
//! pictures, or both in a window.

mod browse;
mod field_view;
mod frame_store;
mod seen;
mod time_line;
mod window;

use crate::matched;
use crate::residuals::rig_of;
use anyhow::bail;
use ipc::logging::{inform, warn};
use outputs::Outputs;
use outputs::exit::{LOSS, WrongUse};
use plots::{Format, bytes};
use recording::{Recording, RecordingError};
use settings::commands::InspectArgs;
use std::ops::ControlFlow;
use std::process::ExitCode;

/// Runs it.
///
/// # Errors
/// Where the recording cannot be read or does not hold the field, or the picture cannot be written.
pub fn run(args: &InspectArgs) -> anyhow::Result<ExitCode> {
    let recording = Recording::open(&args.file)?;
    let rig = rig_of(&recording)?;
    if args.window {
        return Ok(ended(window::run(&recording, &rig, args.field)?.damage));
    }
    let format = Format::of(&args.output)?;
    let mut outputs = Outputs::new(args.force.force).reading_all(recording::files_of(&args.file));
    outputs.claim(&args.output)?;
    let mut view = None;
    let mut line = time_line::TimeLine::default();
    let mut span: Option<[u64; 2]> = None;
    let outcome = matched::run(&recording, &rig, "inspect", |found| {
        let number = found.frame.field;
        let [low, high] = span.unwrap_or([number; 2]);
        span = Some([low.min(number), high.max(number)]);
        match args.field {
            None => line.note(found.frame, found.matches),
            Some(field) if field == number => {
                view = Some(seen::Seen::new(&rig, &found));
                return Ok(ControlFlow::Break(()));
            }
            Some(_) => {}
        }
        Ok(ControlFlow::Continue(()))
    })?;
    let picture = match (args.field, view, span) {
        (_, _, None) => bail!("{}: contains no tracker frame", args.file.display()),
        (Some(field), None, Some([low, high])) => {
            let holds = format!("it contains fields {low} to {high}");
            return Err(WrongUse(format!("{}: no field {field}; {holds}", args.file.display())).into());
        }
        (Some(_), Some(seen), _) => {
            bytes(&field_view::FieldView { seen: &seen, size_px: None, alone: None }, format)?
        }
        (None, ..) => bytes(&time_line::TimeLinePicture::from(&line), format)?,
    };
    outputs.write(&args.output, picture)?;
    let what = args.field.map_or("residuals, NIS and status over time".into(), |n| format!("field {n}"));
    let how = if outcome.recorded { "as recorded" } else { "as this tracker finds it in the blobs" };
    inform(&format!("{}: {what}, {how}", args.output.display()));
    Ok(ended(outcome.damage))
}

/// Says what is wrong with the recording, if something is.
fn ended(damage: Option<RecordingError>) -> ExitCode {
    let Some(damage) = damage else { return ExitCode::SUCCESS };
    warn(&damage.to_string());
    ExitCode::from(LOSS)
}
