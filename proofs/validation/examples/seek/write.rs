//! The recording that is measured.

use super::Args;
use outputs::Outputs;
use protocol::limits::FIELD_PERIOD_NS;
use validation::live_recording::Live;

/// Writes it.
pub fn run(args: &Args) -> anyhow::Result<()> {
    let mut output = Outputs::new(args.force).grow(&args.file)?;
    let fields = args.minutes * 60_000_000_000 / FIELD_PERIOD_NS;
    let style = indicatif::ProgressStyle::with_template("{msg} {bar:40} minute {pos}/{len} {eta}")?;
    let bar = indicatif::ProgressBar::new(args.minutes).with_style(style).with_message("recording");
    let live = Live { scene: &args.scene, fields, seed: args.seed };
    live.record(output.handle()?, output.path(), |number| bar.set_position(number * args.minutes / fields))?;
    output.appear()?;
    bar.finish_and_clear();
    println!("{}: {fields} fields, {} MB", args.file.display(), args.file.metadata()?.len() / 1_000_000);
    Ok(())
}
