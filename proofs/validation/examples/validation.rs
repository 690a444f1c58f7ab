//! Compares the tissue solvers with closed forms and independent solutions, and draws each
//! comparison.
//!
//! `cargo run --release -p validation --example validation [FOLDER [CASE…]]`: pictures into FOLDER
//! (`docs/validation`), the table of `docs/validation.md` to stdout. Exit code 1 where an error is
//! larger than allowed. The references lie in `tests/data/analytic/reference.json`;
//! `proofs/validation/tests/truth.rs` runs the same cases at coarse resolutions.

use std::path::{Path, PathBuf};
use std::process::ExitCode;
use validation::closed_form::case::{ALL, Case, Depth, Outcome};
use validation::closed_form::plot::CasePlot;

fn main() -> ExitCode {
    let mut arguments = std::env::args().skip(1);
    let root = Path::new(env!("CARGO_MANIFEST_DIR")).join("../..");
    let folder = arguments.next().map_or_else(|| root.join("docs/validation"), PathBuf::from);
    let names: Vec<String> = arguments.collect();
    let text = std::fs::read_to_string(root.join("tests/data/analytic/reference.json"));
    let reference = serde_json::from_str(&text.expect("tests/data/analytic/reference.json is there"));
    let reference = reference.expect("it is JSON");
    std::fs::create_dir_all(&folder).expect("a folder for the pictures");
    println!("| case | quantity | reference | vitreo | error | allowed | resolution | order |");
    println!("|---|---|---|---|---|---|---|---|");
    let mut wrong = 0;
    for case in ALL.iter().filter(|c| names.is_empty() || names.iter().any(|n| n == c.name)) {
        let begin = std::time::Instant::now();
        let outcome = (case.run)(&reference, Depth::Full);
        wrong += print_case(case, &outcome);
        let path = folder.join(case.name).with_extension("png");
        let picture = CasePlot { title: case.title, outcome: &outcome };
        let picture = plots::bytes(&picture, plots::Format::Png).expect("finite figures are drawn");
        std::fs::write(&path, picture).expect("a picture is written");
        eprintln!("{} ({:.1} s)", path.display(), begin.elapsed().as_secs_f64());
    }
    if wrong > 0 {
        eprintln!("{wrong} figures are farther off than allowed");
    }
    ExitCode::from(u8::from(wrong > 0))
}

/// Prints the lines of a case; returns how many are wrong.
fn print_case(case: &Case, outcome: &Outcome) -> usize {
    for row in &outcome.rows {
        let order = row.order.map_or_else(|| "-".into(), |o| format!("{o:.1}"));
        println!(
            "| [{}](validation/{}.png) ({}) | {} | {:.6} | {:.6} | {:.3} % | {} % | {} | {order} |",
            case.title,
            case.name,
            case.ours,
            row.quantity,
            row.reference,
            row.ours,
            100.0 * row.error(),
            // Rounded, so that 1e-9 is not printed with seventeen digits.
            (1e12 * row.allowed).round() / 1e10,
            row.resolution,
        );
    }
    outcome.rows.iter().filter(|r| r.error().is_nan() || r.error() > r.allowed).count()
}
