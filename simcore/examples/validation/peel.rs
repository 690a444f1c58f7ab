//! Peel force of an adherent strip over its width: Rivlin's and Kendall's formulas, the energy of adhesion given.

use crate::case::{Case, Chart, Depth, Outcome, Series};
use crate::strip::PeelTest;
use serde_json::Value;

/// The case.
pub const CASE: Case = Case {
    name: "peel-force",
    title: "Peel force of an adherent strip",
    ours: "explicit core and adhesion",
    run,
};

fn run(_: &Value, depth: Depth) -> Outcome {
    let mut outcome = Outcome::default().refined_by("spacing, mm");
    outcome.solution = Chart::new("angle, degrees", "force over width, uN/mm");
    let at = |degrees: f64| PeelTest { angle_rad: degrees.to_radians(), ..PeelTest::default() };
    let formula = |i: i32| [60.0 + f64::from(i), at(60.0 + f64::from(i)).kendall_un_per_mm()];
    outcome.solution.line("Kendall", (0..=90).map(formula).collect());
    let mut found = Vec::new();
    for degrees in [90.0, 135.0] {
        let base = at(degrees);
        let mut series = Series::new(format!("{degrees} degrees, uN/mm"), base.kendall_un_per_mm());
        for (spacing_mm, rows) in depth.of(&[(0.2, 5), (0.1, 9)], 1) {
            let measured = PeelTest { spacing_mm, rows, ..base }.run();
            series.found.push([spacing_mm, measured.force_un_per_mm]);
        }
        let finest = series.found.last().copied().unwrap_or([f64::NAN; 2]);
        found.push([degrees, finest[1]]);
        outcome.add(
            series,
            format!("spacing {} mm, range of the bonds {} mm", finest[0], base.range_mm),
            0.05,
        );
    }
    outcome.solution.marks("ours", found);
    outcome
}
