//! What a case of the validation is, and the list of them all. A new case is a file with a `CASE`
//! and a line in [`ALL`].

use super::{balloon, beam, bleb, chain, hencky, lattice, modes, oscillator, patch, peel};
use serde_json::Value;
use tissue::elements::conjugate::Limits;
use tissue::elements::integrator::Settings;

/// Every case, in the order of the page.
pub const ALL: &[Case] = &[
    chain::LINKS,
    chain::CATENARY,
    modes::CHAIN,
    modes::GRID,
    oscillator::CASE,
    lattice::CASE,
    hencky::CASE,
    balloon::BALLOON,
    balloon::CAP,
    patch::CASE,
    beam::CASE,
    peel::CASE,
    bleb::CASE,
];

/// How hard a quasi-static step tries: far beyond what a comparison within 0.1 % needs.
pub const BALANCE: Settings =
    Settings { newton: 120, share: 1e-8, conjugate: Limits { iterations: 1500, share: 1e-3 } };

/// A comparison with a reference that our code did not make.
#[derive(Clone, Copy)]
pub struct Case {
    /// Name of its picture, without `.png`.
    pub name: &'static str,
    /// Title of its picture.
    pub title: &'static str,
    /// Which code of the product runs.
    pub ours: &'static str,
    /// Runs it against the reference figures.
    pub run: fn(&Value, Depth) -> Outcome,
}

/// How far a refinement goes.
#[derive(Clone, Copy, PartialEq, Eq)]
pub enum Depth {
    /// Seconds in a build for checks.
    #[allow(dead_code)]
    Quick,
    /// All of it.
    #[allow(dead_code)]
    Full,
}

impl Depth {
    /// The coarsest `quick` of the resolutions, or all.
    pub fn of<T: Copy>(self, all: &[T], quick: usize) -> Vec<T> {
        let count = if self == Depth::Quick { quick } else { all.len() };
        all[..count].to_vec()
    }
}

/// What a case found.
#[derive(Default)]
pub struct Outcome {
    /// Lines of the table.
    pub rows: Vec<Row>,
    /// The solution beside the reference, for the left half of the picture.
    pub solution: Chart,
    /// Errors over resolutions, for the right half.
    pub refinement: Chart,
}

/// A line of the table.
pub struct Row {
    /// What is compared, with its unit.
    pub quantity: String,
    /// Truth.
    pub reference: f64,
    /// Ours at the finest resolution.
    pub ours: f64,
    /// That resolution.
    pub resolution: String,
    /// Order of convergence; `None` where nothing is refined.
    pub order: Option<f64>,
    /// Error that is allowed, as a share of the reference.
    pub allowed: f64,
}

impl Row {
    /// Error as a share of the reference.
    pub fn error(&self) -> f64 {
        (self.ours - self.reference).abs() / self.reference.abs().max(f64::MIN_POSITIVE)
    }
}

/// Curves over common axes.
#[derive(Default)]
pub struct Chart {
    /// Below the horizontal axis.
    pub across: String,
    /// Beside the vertical one.
    pub up: String,
    /// Both axes logarithmic.
    pub logarithmic: bool,
    /// The curves.
    pub curves: Vec<Curve>,
}

/// A curve.
pub struct Curve {
    /// For the legend.
    pub name: String,
    /// Points.
    pub points: Vec<[f64; 2]>,
    /// Drawn as marks instead of a line.
    pub marks: bool,
}

impl Chart {
    /// Axes without curves yet.
    pub fn new(across: &str, up: &str) -> Self {
        Chart { across: across.into(), up: up.into(), ..Chart::default() }
    }

    /// Adds a line.
    pub fn line(&mut self, name: &str, points: Vec<[f64; 2]>) {
        self.curves.push(Curve { name: name.into(), points, marks: false });
    }

    /// Adds marks.
    pub fn marks(&mut self, name: &str, points: Vec<[f64; 2]>) {
        self.curves.push(Curve { name: name.into(), points, marks: true });
    }
}

/// A quantity at several resolutions.
pub struct Series {
    /// What it is, with its unit.
    pub quantity: String,
    /// Truth.
    pub reference: f64,
    /// Size of an element, step or whatever is refined, and ours there.
    pub found: Vec<[f64; 2]>,
}

impl Series {
    /// No resolution yet.
    pub fn new(quantity: impl Into<String>, reference: f64) -> Self {
        Series { quantity: quantity.into(), reference, found: Vec::new() }
    }
}

impl Outcome {
    /// Adds a quantity: its line in the table, its curve among the errors. `resolution` names the
    /// finest.
    pub fn add(&mut self, series: Series, resolution: impl Into<String>, allowed: f64) {
        let error = |ours: f64| ((ours - series.reference) / series.reference).abs();
        let errors: Vec<[f64; 2]> = series.found.iter().map(|&[h, ours]| [h, error(ours)]).collect();
        let last = series.found.last().map_or(f64::NAN, |f| f[1]);
        self.rows.push(Row {
            quantity: series.quantity.clone(),
            reference: series.reference,
            ours: last,
            resolution: resolution.into(),
            order: order(&series.found, series.reference),
            allowed,
        });
        self.refinement.line(&series.quantity, errors);
    }

    /// Axes of the errors over `size`.
    pub fn refined_by(mut self, size: &str) -> Self {
        self.refinement =
            Chart { across: size.into(), up: "relative error".into(), logarithmic: true, curves: Vec::new() };
        self
    }
}

/// Order of convergence. Of three resolutions or more from the differences of the last three
/// figures, so that what the reference itself neglects (a beam's shear) does not hide it; of two
/// from their errors.
fn order(found: &[[f64; 2]], reference: f64) -> Option<f64> {
    let share = |a: f64, b: f64| (a != 0.0 && b != 0.0).then(|| libm::log((a / b).abs()));
    match found {
        [.., [h1, f1], [h2, f2], [_, f3]] => Some(share(f1 - f2, f2 - f3)? / libm::log(h1 / h2)),
        [[h1, f1], [h2, f2]] => Some(share(f1 - reference, f2 - reference)? / libm::log(h1 / h2)),
        _ => None,
    }
}

/// A number of the reference by its path, such as `catenary/sag`.
pub fn number(reference: &Value, path: &str) -> f64 {
    value(reference, path).as_f64().unwrap_or_else(|| panic!("reference.json: {path}: expected a number"))
}

/// Numbers of the reference.
pub fn numbers(reference: &Value, path: &str) -> Vec<f64> {
    let list = value(reference, path).as_array();
    let list = list.unwrap_or_else(|| panic!("reference.json: {path}: expected a list"));
    list.iter().filter_map(Value::as_f64).collect()
}

/// A value of the reference.
pub fn value<'a>(reference: &'a Value, path: &str) -> &'a Value {
    path.split('/').fold(reference, |v, key| &v[key])
}
