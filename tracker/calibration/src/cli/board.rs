//! `vitreo calibrate board`: a board to be printed.

use super::target::BoardArgs;
use crate::printed::Printed;
use anyhow::bail;
use ipc::logging::inform;
use outputs::exit::WrongUse;
use outputs::{Force, Outputs, println};
use std::path::PathBuf;
use std::process::ExitCode;

/// Arguments of `vitreo calibrate board`.
#[derive(Debug, Clone, clap::Args)]
pub struct DrawArgs {
    #[command(flatten)]
    pub board: BoardArgs,
    /// File for the board, .svg or .png. Print it at 100 % and check its size with a ruler.
    #[arg(short, long, value_name = "FILE")]
    pub output: PathBuf,
    /// Width of the white margin, mm.
    #[arg(long, value_name = "MM", default_value = "10", value_parser = margin, allow_negative_numbers = true)]
    pub margin: f64,
    /// Resolution of a PNG, pixels per inch.
    #[arg(long, value_name = "DPI", default_value = "600", value_parser = super::positive, allow_negative_numbers = true)]
    pub dpi: f64,
    /// Whether files that exist are written over.
    #[command(flatten)]
    pub force: Force,
}

fn margin(text: &str) -> Result<f64, String> {
    let sane = text.parse().ok().filter(|v: &f64| (0.0..=1000.0).contains(v));
    sane.ok_or_else(|| "expected 0 to 1000 mm".into())
}

impl DrawArgs {
    /// Looks at what will be written.
    pub fn claim(&self) -> anyhow::Result<()> {
        Ok(Outputs::new(self.force.force).claim(&self.output)?)
    }
}

/// Runs `vitreo calibrate board`.
///
/// # Errors
/// No board, a file of another kind, or a picture that would be too large.
pub fn draw(args: &DrawArgs) -> anyhow::Result<ExitCode> {
    let printed = Printed::new(&args.board.board()?, args.margin);
    let ending = args.output.extension().and_then(|e| e.to_str()).map(str::to_ascii_lowercase);
    let bytes = match ending.as_deref() {
        Some("svg") => printed.svg().into_bytes(),
        Some("png") => printed.png(args.dpi)?,
        _ => {
            let name = args.output.display();
            bail!(WrongUse(format!("--output {name}: expected a name that ends in .svg or .png")))
        }
    };
    Outputs::new(args.force.force).write(&args.output, bytes)?;
    let ([w, h], [x, y]) = (printed.size_mm, printed.paper_mm());
    println!("board: {w:.2} × {h:.2} mm on {x:.2} × {y:.2} mm; print it at 100 % and measure it");
    inform(&format!("{} written", args.output.display()));
    Ok(ExitCode::SUCCESS)
}
