//! Peel force of an adherent strip over its width: Rivlin's and Kendall's formulas, the energy of
//! adhesion given.

use super::case::{Case, Chart, Depth, Outcome, Series};
use super::strip::PeelTest;
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
    let (mut found, mut extremes) = (Vec::new(), Vec::new());
    for degrees in [90.0, 135.0] {
        let base = at(degrees);
        let mut force = Series::new(format!("{degrees} degrees, uN/mm"), base.kendall_un_per_mm());
        let mut work =
            Series::new(format!("{degrees} degrees: work over area, uN/mm"), base.energy_un_per_mm);
        for (spacing_mm, rows) in depth.of(&[(0.2, 5), (0.1, 9)], 2) {
            let measured = PeelTest { spacing_mm, rows, ..base }.run();
            force.found.push([spacing_mm, measured.force_un_per_mm]);
            work.found.push([spacing_mm, measured.energy_un_per_mm]);
            extremes.extend(measured.range_un_per_mm.map(|f| [degrees, f]));
        }
        let finest = force.found.last().copied().unwrap_or([f64::NAN; 2]);
        found.push([degrees, finest[1]]);
        let resolution = format!("spacing {} mm, range of the bonds {} mm", finest[0], base.range_mm);
        outcome.add(force, &resolution, 0.05);
        outcome.add(work, &resolution, 0.08);
    }
    outcome.solution.marks("ours, mean", found);
    outcome.solution.marks("smallest and largest", extremes);
    outcome
}
