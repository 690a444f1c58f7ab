//! `vitreo sweep`: recordings run again with a constant at several values, and what each value makes of
//! the poses.

use crate::what_if::outcome::Outcome;
use crate::what_if::setting;
use anyhow::Context;
use outputs::progress::files_bar;
use outputs::{Outputs, println};
use plots::line_plot::{Line, LinePlot};
use plots::{Format, bytes};
use protocol::geometry::Validity;
use protocol::limits::BODIES;
use protocol::poses::{BODY_NAMES, BodyState, EYE, TrackerFrame};
use recording::{Item, Recording};
use results::parquet_file;
use results::table::{Cells, Column, Table};
use settings::commands::{Assignment, SweepArgs, WhatIfArgs};
use std::collections::HashMap;
use std::path::{Path, PathBuf};
use std::process::ExitCode;
use std::sync::Mutex;
use std::sync::atomic::{AtomicUsize, Ordering};

/// What a value made of a recording.
#[derive(Debug, Clone, PartialEq)]
pub struct Row {
    /// The recording.
    pub file: String,
    /// The value.
    pub value: f64,
    /// Tracker frames.
    pub frames: u64,
    /// Share of the frames in which each body was measured.
    pub tracked: [f64; BODIES],
    /// Distance of tips from the recorded ones, and of the eye's wall, µm RMS; where both measured.
    pub moved_um: [f64; BODIES],
    /// Image residuals of measured bodies, px RMS.
    pub residual_px: [f64; BODIES],
    /// Hash of the last state.
    pub state_hash: u64,
}

/// Runs it.
///
/// # Errors
/// Where a recording or a value is refused, or an output cannot be written.
pub fn run(args: &SweepArgs) -> anyhow::Result<ExitCode> {
    let mut outputs = Outputs::new(args.force.force)
        .reading_all(args.files.iter().flat_map(|file| recording::files_of(file)));
    for path in [&args.parquet, &args.plot].into_iter().flatten() {
        outputs.claim(path)?;
    }
    let rows = sweep(args)?;
    print(&args.set.key, &rows);
    if let Some(path) = &args.parquet {
        let mut file = outputs.create(path)?;
        parquet_file::write(&table(&args.set.key, &rows), &mut file, &[]).context("the table")?;
        file.finish()?;
    }
    if let Some(path) = &args.plot {
        outputs.write(path, bytes(&plot(&args.set.key, &rows), Format::of(path)?)?)?;
    }
    Ok(ExitCode::SUCCESS)
}

/// All files with all values, several at a time; in the order of files and values.
fn sweep(args: &SweepArgs) -> anyhow::Result<Vec<Row>> {
    let runs: Vec<(&PathBuf, f64)> =
        args.files.iter().flat_map(|file| args.set.values.iter().map(move |value| (file, *value))).collect();
    let jobs =
        args.jobs.map_or_else(|| std::thread::available_parallelism().map_or(1, usize::from), |n| n as usize);
    let (next, bar) = (AtomicUsize::new(0), files_bar(runs.len() as u64, "runs"));
    let done: Mutex<Vec<(usize, anyhow::Result<Row>)>> = Mutex::default();
    let work = || {
        loop {
            let at = next.fetch_add(1, Ordering::Relaxed);
            let Some((file, value)) = runs.get(at) else { return };
            let row = run_one(file, &args.set.key, *value);
            if row.is_err() {
                // What is left would be thrown away.
                next.store(runs.len(), Ordering::Relaxed);
            }
            done.lock().unwrap_or_else(std::sync::PoisonError::into_inner).push((at, row));
            bar.inc(1);
        }
    };
    std::thread::scope(|scope| (0..jobs.min(runs.len())).for_each(|_| drop(scope.spawn(work))));
    bar.finish_and_clear();
    let mut done = done.into_inner().unwrap_or_else(std::sync::PoisonError::into_inner);
    done.sort_by_key(|(at, _)| *at);
    done.into_iter().map(|(_, row)| row).collect()
}

/// A recording with one value.
///
/// # Errors
/// Where recording or value are refused.
pub fn run_one(file: &Path, key: &str, value: f64) -> anyhow::Result<Row> {
    let recording = Recording::open(file)?;
    let set = vec![Assignment { key: key.into(), value }];
    let setting = setting(&recording, &WhatIfArgs { set, ..WhatIfArgs::default() })?;
    let mut recorded: HashMap<(u64, u64), Box<TrackerFrame>> = HashMap::new();
    for item in recording.items_of(&["poses"]).filter_map(Result::ok) {
        if let (_, Item::Poses(frame)) = item {
            recorded.insert((frame.field, frame.frame), frame);
        }
    }
    let mut sums = [Sums::default(); BODIES];
    let mut row = Row {
        file: file.display().to_string(),
        value,
        frames: 0,
        tracked: [0.0; BODIES],
        moved_um: [0.0; BODIES],
        residual_px: [0.0; BODIES],
        state_hash: 0,
    };
    Outcome::new(&recording, &setting)?.run(|_, item| {
        match item {
            Item::Poses(frame) => {
                row.frames += 1;
                let before = recorded.get(&(frame.field, frame.frame));
                for (body, sums) in sums.iter_mut().enumerate() {
                    sums.add(body, &frame.bodies[body], before.map(|before| &before.bodies[body]));
                }
            }
            Item::Step(step) => row.state_hash = step.state_hash,
            _ => {}
        }
        Ok(())
    })?;
    for (body, sums) in sums.iter().enumerate() {
        row.tracked[body] = sums.measured as f64 / row.frames.max(1) as f64;
        row.moved_um[body] = (sums.moved_um2 / sums.both.max(1) as f64).sqrt();
        row.residual_px[body] = (sums.residual_px2 / sums.measured.max(1) as f64).sqrt();
    }
    Ok(row)
}

/// Sums over the frames of a body.
#[derive(Debug, Clone, Copy, Default)]
struct Sums {
    measured: u64,
    both: u64,
    moved_um2: f64,
    residual_px2: f64,
}

impl Sums {
    fn add(&mut self, body: usize, state: &BodyState, before: Option<&BodyState>) {
        if state.validity() != Validity::Measured {
            return;
        }
        self.measured += 1;
        self.residual_px2 += state.residual_px * state.residual_px;
        let Some(before) = before.filter(|before| before.validity() == Validity::Measured) else { return };
        let [p, q] = [before, state].map(|s| s.world_from_body.isometry());
        let moved_um = match body {
            // The angle of equal rotations is rounded.
            EYE if before.world_from_body == state.world_from_body => 0.0,
            EYE => p.rotation.angle_to(&q.rotation) * 1e3 * crate::diff::poses::EYE_WALL_MM,
            _ => (q.translation.vector - p.translation.vector).norm() * 1e3,
        };
        self.both += 1;
        self.moved_um2 += moved_um * moved_um;
    }
}

fn print(key: &str, rows: &[Row]) {
    println!(
        "{key:>14}  frames  tracked inst0 inst1 eye     moved, µm RMS inst0 inst1 eye   residual, px   file"
    );
    for row in rows {
        let [t0, t1, t2] = row.tracked;
        let [m0, m1, m2] = row.moved_um;
        let [r0, r1, r2] = row.residual_px;
        println!(
            "{:>14} {:>7}  {t0:>9.4} {t1:.4} {t2:.4} {m0:>17.2} {m1:.2} {m2:.2}   {r0:.3} {r1:.3} {r2:.3}   {}",
            row.value, row.frames, row.file
        );
    }
}

/// The rows as a table.
fn table(key: &str, rows: &[Row]) -> Table {
    let column = |name: &str, cells| Column { name: name.into(), cells };
    let mut columns = vec![
        column("file", Cells::Text(rows.iter().map(|r| Some(r.file.clone())).collect())),
        column("key", Cells::Text(rows.iter().map(|_| Some(key.to_owned())).collect())),
        column("value", Cells::Real(rows.iter().map(|r| Some(r.value)).collect())),
        column("frames", Cells::Natural(rows.iter().map(|r| Some(r.frames)).collect())),
    ];
    for (body, name) in BODY_NAMES.iter().enumerate() {
        let real =
            |of: fn(&Row) -> &[f64; BODIES]| Cells::Real(rows.iter().map(|r| Some(of(r)[body])).collect());
        columns.push(column(&format!("{name}_tracked_share"), real(|r| &r.tracked)));
        columns.push(column(&format!("{name}_moved_rms_um"), real(|r| &r.moved_um)));
        columns.push(column(&format!("{name}_residual_rms_px"), real(|r| &r.residual_px)));
    }
    columns.push(column("state_hash", Cells::Natural(rows.iter().map(|r| Some(r.state_hash)).collect())));
    Table { columns, rows: rows.len() }
}

/// How far each body moves, by value; the mean of the squares over the files.
fn plot(key: &str, rows: &[Row]) -> LinePlot {
    let mut values: Vec<f64> = rows.iter().map(|row| row.value).collect();
    values.sort_by(f64::total_cmp);
    values.dedup();
    let of_body = |body: usize| {
        let point = |value: &f64| {
            let own: Vec<f64> = rows.iter().filter(|r| r.value == *value).map(|r| r.moved_um[body]).collect();
            [*value, (own.iter().map(|um| um * um).sum::<f64>() / own.len().max(1) as f64).sqrt()]
        };
        Line { name: BODY_NAMES[body].into(), points: values.iter().map(point).collect() }
    };
    LinePlot {
        title: format!("How far poses move from the recorded ones with {key}"),
        across: key.into(),
        up: "distance, µm RMS".into(),
        lines: (0..BODIES).map(of_body).collect(),
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::test_runs::golden;
    use settings::commands::Range;

    #[test]
    fn rows_stand_in_the_order_of_files_and_values_however_many_run_at_a_time() {
        let built_in = tracker::tuning::Tuning::default().tremor_ripple_db;
        let values = vec![built_in, 0.75 * built_in, 0.25 * built_in];
        let sweep_with = |jobs| {
            let set = Range { key: "tracker.tremor_ripple_db".into(), values: values.clone() };
            let files = vec![golden().path().to_path_buf()];
            let args = SweepArgs {
                files,
                set,
                jobs: Some(jobs),
                parquet: None,
                plot: None,
                force: Default::default(),
            };
            sweep(&args).unwrap()
        };
        let rows = sweep_with(1);
        assert_eq!(rows, sweep_with(3));
        assert_eq!(rows.iter().map(|r| r.value).collect::<Vec<_>>(), values);
        assert_eq!(
            (rows[0].moved_um, rows[0].frames),
            ([0.0; BODIES], 100),
            "the built-in value changes nothing"
        );
        assert!(rows[2].moved_um[0] > rows[1].moved_um[0] && rows[1].moved_um[0] > 0.0, "{rows:?}");
        let table = table("tracker.tremor_ripple_db", &rows);
        assert_eq!((table.rows, table.columns.len()), (3, 14));
    }

    #[test]
    fn a_value_that_is_refused_ends_it() {
        let refused = run_one(golden().path(), "tracker.gate", 0.0).unwrap_err();
        assert!(format!("{refused:#}").contains("gate"), "{refused:#}");
    }
}
