//! A substep of the mass-spring core beside other methods, and a whole `World::step`; one thread.
//!
//! `cargo bench -p validation --bench tissue` prints tables, with `-- --json` one object a line
//! `{"method", "springs", "step_us", …}`. Times are medians over repeated batches; the fastest
//! batch stands beside them, since it is what a quiet machine gives. Every method computes damped
//! structural springs with a test for tearing, and moves the nodes; ours has the limits of
//! acceleration and speed and both rules of tearing besides.

mod meshes;
mod peers;
mod roofline;
mod worlds;

use meshes::{Mesh, SIDES, tissue};
use peers::{EdgeLoop, Gather, Peer, Xpbd};
use scene::MembraneIntegrator;
use std::time::Instant;
use tissue::sheet::implicit::Implicit;
use tissue::sheet::material::Material;
use tissue::sheet::mesh::SheetMesh;
use tissue::sheet::solver::{Alarms, Solver};
use tissue::sheet::state::SheetState;

/// Batches of a method at a size, and springs a batch goes through, about: short, so that most
/// batches are not interrupted on a machine that does other work.
const BATCHES: usize = 301;
const SPRINGS: usize = 100_000;
/// A method that takes longer for all its batches gets fewer, µs.
const LONGEST_US: f64 = 1e6;
/// Substep of the paper's Table 4, µs, at 600, 1.5k and 4.5k springs (2002).
const PAPER_US: [Option<f64>; 4] = [Some(500.0), Some(1500.0), Some(4000.0), None];
/// What is asked for, µs.
const ASKED_US: [f64; 4] = [1.2, 2.8, 8.0, 250.0];

/// Median and fastest batch, µs a step.
#[derive(Clone, Copy)]
struct Time {
    median: f64,
    best: f64,
}

struct Row {
    method: String,
    springs: usize,
    time: Time,
}

fn measure(springs: usize, mut step: impl FnMut()) -> Time {
    let steps = (SPRINGS / springs).max(1);
    let mut batch = || {
        let begin = Instant::now();
        (0..steps).for_each(|_| step());
        begin.elapsed().as_secs_f64() * 1e6 / steps as f64
    };
    let first_us = batch() * steps as f64;
    let batches = ((LONGEST_US / first_us) as usize).clamp(5, BATCHES);
    let mut times: Vec<f64> = (0..batches).map(|_| batch()).collect();
    times.sort_by(f64::total_cmp);
    Time { median: times[batches / 2], best: times[0] }
}

/// Our core on a sheet that swings.
struct Core {
    sheet: SheetMesh,
    state: SheetState,
    solver: Solver,
    tissue: Material,
    alarms: u64,
}

impl Core {
    fn new(sheet: SheetMesh, tissue: Material) -> Self {
        let mut state = sheet.start();
        let mut solver = Solver::new(&sheet);
        solver.refresh(&sheet, &state, &tissue);
        for (i, v) in state.velocity_mm_s[2].iter_mut().enumerate() {
            *v = ((i * 37 % 101) as f32 - 50.0) * 0.01;
        }
        Core { sheet, state, solver, tissue, alarms: 0 }
    }

    fn step(&mut self) {
        let alarms = self.solver.accelerate(&self.sheet, &self.state, &self.tissue);
        self.alarms += u64::from(alarms != Alarms::default());
        self.solver.integrate(&mut self.state, &self.tissue);
    }

    fn measure(mut self, method: &str) -> Row {
        let springs = self.sheet.structural;
        let time = measure(springs, || self.step());
        assert_eq!(self.alarms, 0, "the bench must not tear");
        assert!(tissue::sheet::guard::all_finite(&self.state));
        Row { method: method.to_owned(), springs, time }
    }
}

/// The same sheet with an integrator for stiff tissue. A node in the middle is pulled to and fro
/// before every step: at rest there would be no balance to look for.
fn stiff(sheet: &SheetMesh, choice: MembraneIntegrator, method: &str) -> Row {
    let mut core = Core::new(sheet.clone(), tissue(false));
    let mut implicit = Implicit::of(choice, sheet, &core.tissue).expect("not the explicit core");
    implicit.refresh(sheet, &core.state, &core.tissue);
    let (pulled, mut by_mm) = (sheet.nodes() / 2, 0.01);
    let time = measure(sheet.structural, || {
        core.state.position_mm[2][pulled] += by_mm;
        by_mm = -by_mm;
        core.solver.accelerate(&core.sheet, &core.state, &core.tissue);
        implicit.integrate(&mut core.state, &core.tissue, &core.solver);
    });
    assert!(tissue::sheet::guard::all_finite(&core.state));
    Row { method: method.to_owned(), springs: sheet.structural, time }
}

fn peer(mut peer: impl Peer, springs: usize) -> Row {
    let time = measure(springs, || peer.step());
    assert!(peer.sum().is_finite());
    Row { method: peer.name().to_owned(), springs, time }
}

/// Rows of ours before those of peers.
const OURS: usize = 5;

/// All methods at one size.
fn rows(side: u32) -> Vec<Row> {
    let (regular, irregular) = (Mesh::regular(side).sheet(), Mesh::irregular(side).sheet());
    let springs = irregular.structural;
    vec![
        Core::new(irregular.clone(), tissue(false)).measure("vitreo"),
        Core::new(regular, tissue(false)).measure("vitreo-regular"),
        Core::new(irregular.clone(), tissue(true)).measure("vitreo-bending"),
        stiff(&irregular, MembraneIntegrator::Implicit, "vitreo-implicit"),
        stiff(&irregular, MembraneIntegrator::QuasiStatic, "vitreo-quasi-static"),
        peer(EdgeLoop::new(&irregular), springs),
        peer(EdgeLoop::shuffled(&irregular), springs),
        peer(Gather::new(&irregular), springs),
        peer(Xpbd::new(&irregular), springs),
    ]
}

fn round(v: f64) -> f64 {
    (v * 1000.0).round() / 1000.0
}

fn print_json(row: &Row, share: Option<roofline::Share>) {
    let mut object = serde_json::json!({
        "method": row.method, "springs": row.springs,
        "step_us": round(row.time.median), "best_us": round(row.time.best),
    });
    if let Some(share) = share {
        object["roofline_share"] = round(share.of_best).into();
        object["roofline_bound"] = share.bound.into();
    }
    println!("{object}");
}

fn print_row(row: &Row, share: Option<roofline::Share>) {
    let share = share.map_or(String::new(), |s| format!("{:3.0} % of {}", s.of_best * 100.0, s.bound));
    println!(
        "{:>8}  {:20} {:>10.2} {:>10.2} {:>8.2}  {share}",
        row.springs,
        row.method,
        row.time.median,
        row.time.best,
        row.time.median * 1e3 / row.springs as f64,
    );
}

fn main() {
    let has = |flag: &str| std::env::args().any(|arg| arg == flag);
    let (json, small) = (has("--json"), has("--small"));
    let machine = roofline::Machine::measure();
    if !json {
        machine.print();
        println!("{}", validation::compiled::line(&["tissue", "validation"]));
        println!("\n springs  method                  step µs    best µs  ns/spring  roofline");
    }
    for (i, &side) in SIDES.iter().enumerate().filter(|(i, _)| !small || *i < 3) {
        let rows = rows(side);
        for row in &rows {
            let share = (row.method == "vitreo").then(|| machine.share(row.springs, row.time.best));
            if json { print_json(row, share) } else { print_row(row, share) }
        }
        if !json {
            print_beside(&rows, i);
        }
    }
    worlds::report(json);
    if !json {
        print_engines();
    }
}

/// The paper's figure, what is asked for, and the fastest peer.
fn print_beside(rows: &[Row], i: usize) {
    let ours = rows[0].time.median;
    let peer = rows[OURS..].iter().map(|r| r.time.median).fold(f64::INFINITY, f64::min);
    let paper = PAPER_US[i].map_or(String::new(), |us| format!("paper (2002) {us:.0} µs, "));
    println!(
        "          {paper}asked for {:.1} µs; fastest peer of this run is {:.1} × slower\n",
        ASKED_US[i],
        peer / ours
    );
}

/// Engines measured once on a machine of this kind, one thread, one iteration, without tearing; µs
/// a step.
fn print_engines() {
    println!("\nEngines, measured before on a machine of this kind (µs):  616    1,496    4,641  150,976");
    for (name, us) in [
        ("NvCloth (SSE)", [1.5, 3.5, 10.2, 329.0]),
        ("Vega FEM, mass-spring + Euler", [4.0, 10.3, 32.0, 1081.0]),
        ("Jolt soft body", [8.1, 18.0, 49.0, 1918.0]),
        ("Warp on CPU", [8.0, 13.0, 32.0, 881.0]),
        ("Bullet soft body", [13.0, 32.0, 101.0, 7000.0]),
        ("PositionBasedDynamics", [20.0, 41.0, 109.0, 5108.0]),
    ] {
        println!("  {name:50} {:>8} {:>8} {:>8} {:>8}", us[0], us[1], us[2], us[3]);
    }
}
