//! `vitreo inspect`: the cameras' view of a field and what the tracker made of it, or residuals over time.

mod field_view;
mod time_line;

use crate::matched;
use crate::residuals::rig_of;
use anyhow::bail;
use ipc::logging::{inform, warn};
use outputs::Outputs;
use outputs::exit::{LOSS, WrongUse};
use plots::{Format, bytes};
use recording::Recording;
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
                view = Some(field_view::FieldView::new(&rig, &found));
                return Ok(ControlFlow::Break(()));
            }
            Some(_) => {}
        }
        Ok(ControlFlow::Continue(()))
    })?;
    let picture = match (args.field, view, span) {
        (_, _, None) => bail!("{}: holds no tracker frame", args.file.display()),
        (Some(field), None, Some([low, high])) => {
            let holds = format!("it holds fields {low} to {high}");
            return Err(
                WrongUse(format!("{}: no frame of field {field}; {holds}", args.file.display())).into()
            );
        }
        (Some(_), Some(view), _) => bytes(&view, format)?,
        (None, ..) => bytes(&line, format)?,
    };
    outputs.write(&args.output, picture)?;
    let what = args.field.map_or("residuals, NIS and status over time".into(), |n| format!("field {n}"));
    let how = if outcome.recorded { "as recorded" } else { "as this tracker finds it in the blobs" };
    inform(&format!("{}: {what}, {how}", args.output.display()));
    let Some(damage) = outcome.damage else { return Ok(ExitCode::SUCCESS) };
    warn(&damage.to_string());
    Ok(ExitCode::from(LOSS))
}
