//! ZCOLL and the exact pair query beside other methods: membranes of 1k to 1M triangles, displaced
//! again before every frame, against a forceps of 2k triangles. One thread.
//!
//! `cargo bench -p validation --bench collision` prints tables like the paper's Tables 1 and 2; with `--
//! --json` one object a line. `-- --small` stops at 10k triangles, `-- METHOD` measures only
//! methods whose names contain that. The column "found" is that of the first frame, which all
//! methods see alike.

mod grid;
mod obb;
mod parry;
mod parts;
mod peers;
mod queries;
mod setting;
mod spheres;
mod trees;

use peers::{Method, methods};
use setting::{Frame, SIZES, Setting};
use std::time::{Duration, Instant};

/// Time spent on a method at a size, about.
const EACH: Duration = Duration::from_millis(1500);
/// Fewest and most frames of a method at a size.
const FRAMES: [usize; 2] = [7, 401];

/// Medians of a method at a size.
struct Row {
    method: &'static str,
    triangles: usize,
    /// µs.
    update: f64,
    query: f64,
    total: f64,
    exact: bool,
    returns: &'static str,
    /// In the first frame.
    found: usize,
}

fn median(values: &mut [f64]) -> f64 {
    values.sort_by(f64::total_cmp);
    values[values.len() / 2]
}

/// Runs one method over as many frames as fit its time; on the first few, exact methods must find
/// the same pairs as `truth`.
fn measure(method: &mut dyn Method, setting: &mut Setting, truth: &mut Vec<Vec<(u32, u32)>>) -> Row {
    let mut times: [Vec<f64>; 3] = Default::default();
    let mut found = 0;
    let begun = Instant::now();
    while times[0].len() < FRAMES[0] || (begun.elapsed() < EACH && times[0].len() < FRAMES[1]) {
        let number = times[0].len();
        setting.displace(number);
        let frame: Frame = setting.frame();
        let start = Instant::now();
        method.update(&frame);
        let updated = Instant::now();
        let count = method.query(&frame);
        let end = Instant::now();
        if number == 0 {
            assert!(count > 0, "{} must see something", method.name());
            found = count;
        }
        let us = |d: Duration| d.as_secs_f64() * 1e6;
        times[0].push(us(updated - start));
        times[1].push(us(end - updated));
        times[2].push(us(end - start));
        if method.exact() && number < FRAMES[0] {
            let mut pairs = method.pairs();
            pairs.sort_unstable();
            if truth.len() == number {
                truth.push(pairs);
            } else {
                assert_eq!(pairs, truth[number], "{} differs in frame {number}", method.name());
            }
        }
    }
    let [mut update, mut query, mut total] = times;
    Row {
        method: method.name(),
        triangles: setting.triangles.len(),
        update: median(&mut update),
        query: median(&mut query),
        total: median(&mut total),
        exact: method.exact(),
        returns: method.returns(),
        found,
    }
}

fn print_json(row: &Row) {
    let round = |v: f64| (v * 100.0).round() / 100.0;
    let object = serde_json::json!({
        "method": row.method, "triangles": row.triangles, "update_us": round(row.update),
        "query_us": round(row.query), "total_us": round(row.total), "exact": row.exact, "returns": row.returns,
        "found": row.found,
    });
    println!("{object}");
}

fn print_row(row: &Row) {
    let exact = if row.exact { "yes" } else { "" };
    println!(
        "{:>9}  {:16} {:>11.1} {:>11.1} {:>11.1}  {:5}  {:>5}  {}",
        row.triangles, row.method, row.update, row.query, row.total, exact, row.found, row.returns
    );
}

/// The paper's Table 2 (Wagner, Schill, Männer 2002; µs) beside the rows of this run.
fn print_table_2(rows: &[Row]) {
    let at = |method: &str, size: usize| {
        let row = rows.iter().find(|r| r.method == method && r.triangles == SIZES[size].triangles());
        row.map_or("–".to_owned(), |r| format!("{:.1} µs", r.total))
    };
    let best = |size: usize| {
        let of_parry =
            rows.iter().filter(|r| r.method.starts_with("parry") && r.triangles == SIZES[size].triangles());
        of_parry.map(|r| r.total).fold(f64::INFINITY, f64::min)
    };
    println!("\nThe paper's Table 2, instrument of 2k triangles   1k membrane        3k membrane");
    println!("  ZCOLL run, paper (AGP graphics adapter, 2002)   2,300 µs           2,500 µs");
    println!("  RAPID preprocessing + run, paper                50,700 µs          81,000 µs");
    println!("  SOLID tree update + run, paper                  1,500 + <100 µs    4,500 + <100 µs");
    for method in [
        "zcoll-cpu",
        "zcoll-gpu",
        "exact",
        "parry-bvh",
        "parry-manifolds",
        "obb-rebuilt",
        "grid",
        "spheres",
        "brute",
    ] {
        println!("  {method:16} here                           {:18} {}", at(method, 0), at(method, 1));
    }
    println!();
    for (i, size) in SIZES.iter().enumerate() {
        let zcoll = rows.iter().find(|r| r.method == "zcoll-cpu" && r.triangles == size.triangles());
        if let Some(zcoll) = zcoll.filter(|_| best(i).is_finite()) {
            let times = best(i) / zcoll.total;
            println!(
                "  {:>9} triangles: zcoll-cpu {times:.1} × faster than the best parry3d path",
                size.triangles()
            );
        }
    }
}

fn main() {
    let has = |flag: &str| std::env::args().any(|arg| arg == flag);
    let (json, small) = (has("--json"), has("--small"));
    let only: Vec<String> = std::env::args().skip(1).filter(|arg| !arg.starts_with("--")).collect();
    if !json {
        println!("{}", validation::compiled::line(&["collision", "validation", "parry3d"]));
        println!("triangles  method            update µs    query µs    total µs  exact  found  returns");
    }
    let mut rows = Vec::new();
    for size in SIZES.iter().filter(|s| !small || s.triangles() < 50_000) {
        let mut setting = Setting::new(*size);
        let mut truth = Vec::new();
        for make in methods(size.triangles()) {
            let Some(mut method) = make(&setting) else { continue };
            if !only.is_empty() && !only.iter().any(|name| method.name().contains(name.as_str())) {
                continue;
            }
            let row = measure(&mut *method, &mut setting, &mut truth);
            if json {
                print_json(&row)
            } else {
                print_row(&row)
            }
            rows.push(row);
        }
    }
    if !json {
        if only.is_empty() {
            parts::print_table_1();
        }
        print_table_2(&rows);
    }
}
