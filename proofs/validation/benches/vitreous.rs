//! Cost of the vitreous on one core: `cargo bench -p validation --bench vitreous [-- --json]`.
//! Medians, µs.
//!
//! The peer is the textbook form of ChainMail: a plain queue, each element looked at again whenever
//! a neighbour moved, until every limit holds. It gives the same places (checked here), since the
//! least move is unique. It has the same duties besides: a list of what moved, each once, of which
//! each is looked at for the wall and for what holds it. `bare textbook` has none of these.

use ipc::clock::now;
use nalgebra::{Isometry3, Translation3, UnitQuaternion, Vector3};
use scene::SceneFile;
use std::collections::VecDeque;
use tissue::vitreous::chainmail::{Chainmail, Mail};
use tissue::vitreous::lattice::{LINKS, Lattice};
use tissue::vitreous::state::{VitreousState, living_links};
use tissue::vitreous::{Shaft, Vitreous};

/// Way of the tool, µm: the one that the step's budget is stated for.
const WAY_UM: i16 = 200;
const ROUNDS: usize = 41;

struct Row {
    method: &'static str,
    elements: usize,
    step_us: f64,
}

fn median(mut values: Vec<f64>) -> f64 {
    values.sort_by(f64::total_cmp);
    values[values.len() / 2]
}

fn timed(work: impl FnOnce()) -> f64 {
    let begin = now();
    work();
    (now() - begin) as f64 * 1e-3
}

fn scene(cells: u32) -> SceneFile {
    let mut scene = SceneFile::load("vitrectomy").expect("the shipped scene is tested");
    scene.vitreous.as_mut().expect("it has a vitreous").lattice = cells;
    scene
}

/// A shaft from `tip` towards the trocar of the first instrument.
fn pose(tip: Vector3<f64>) -> Isometry3<f64> {
    let along = Vector3::new(7.85, 4.53, 7.86) - tip;
    let turn = UnitQuaternion::rotation_between(&Vector3::z(), &along).expect("not opposite");
    Isometry3::from_parts(Translation3::from(tip), turn)
}

/// How the chain mail is moved.
#[derive(Clone, Copy, PartialEq)]
enum Way {
    Ours,
    Textbook,
    Bare,
}

/// One element pulled by 0.2 mm again and again until 2 mm: the chain mail alone.
fn single(cells: u32, how: Way) -> (f64, usize, VitreousState) {
    let scene = scene(cells);
    let lattice = Lattice::new(&scene, scene.vitreous.as_ref().expect("it has one"));
    let mut state = VitreousState::new(&lattice);
    let links = living_links(&lattice, &state);
    let mail = Mail { lattice: &lattice, links: &links };
    let mut chainmail = Chainmail::new(&lattice);
    let mut textbook = Textbook::new(lattice.len());
    let middle = cells as i32 / 2;
    let element = lattice.element([middle; 3]).expect("the middle exists");
    let (mut times, mut moved) = (Vec::new(), 0);
    for _ in 0..10 {
        times.push(timed(|| {
            moved = match how {
                Way::Ours => {
                    chainmail.push(mail, &mut state, 0, &[(element as u32, WAY_UM)], &mut |_| ()).moved
                        as usize
                }
                Way::Textbook => {
                    let moved = textbook.pull::<true>(mail, &mut state.shift_um[0], element);
                    assert_eq!(textbook.beyond(&lattice, &state), 0, "nothing holds and no wall is met");
                    moved
                }
                Way::Bare => textbook.pull::<false>(mail, &mut state.shift_um[0], element),
            };
        }));
    }
    (times[9], moved, state)
}

/// A plain queue, and what it moved.
struct Textbook {
    queue: VecDeque<usize>,
    moved: Vec<usize>,
    /// Round in which an element was last moved.
    seen: Vec<u32>,
    round: u32,
}

impl Textbook {
    fn new(elements: usize) -> Self {
        let queue = VecDeque::with_capacity(elements);
        Textbook { queue, moved: Vec::with_capacity(elements), seen: vec![0; elements], round: 0 }
    }

    /// Returns how often an element was looked at.
    fn pull<const LISTED: bool>(&mut self, mail: Mail, shift: &mut [i16], element: usize) -> usize {
        shift[element] += WAY_UM;
        self.queue.push_back(element);
        self.round += 1;
        self.moved.clear();
        let mut looks = 0;
        while let Some(e) = self.queue.pop_front() {
            looks += 1;
            if LISTED && self.seen[e] != self.round {
                self.seen[e] = self.round;
                self.moved.push(e);
            }
            for k in (0..LINKS).filter(|k| mail.links[e] >> k & 1 == 1) {
                let other = mail.lattice.neighbour(e, k);
                let (ahead, kinds) = (k % 2 == 1, &mail.lattice.limit[k / 2]);
                let kind = if k / 2 != 0 { &kinds[2] } else { &kinds[usize::from(!ahead)] };
                let least = i32::from(shift[e]) - i32::from(kind[if ahead { e } else { other }]);
                if i32::from(shift[other]) < least {
                    shift[other] = least as i16;
                    self.queue.push_back(other);
                }
            }
        }
        looks
    }

    /// How many of those moved are held, or beyond the wall.
    fn beyond(&self, lattice: &Lattice, state: &VitreousState) -> usize {
        let bad = |&&e: &&usize| state.is_adhered(e) || !lattice.is_inside(state.place_um(lattice, e));
        self.moved.iter().filter(bad).count()
    }
}

/// A whole shaft that goes to and fro by 3 mm in steps of 0.2 mm, with everything that a step of
/// the simulation does.
fn shaft(cells: u32, rows: &mut Vec<Row>) {
    let mut gel = Vitreous::new(&scene(cells)).expect("it has one");
    let mut state = gel.start();
    let mut times: [Vec<f64>; 5] = Default::default();
    let tip = |i: usize| {
        let phase = i as f64 * 0.2 / 3.0;
        let way = (phase % 2.0 - 1.0).abs() * 3.0;
        Vector3::new(way - 1.5, 1.0, -5.0)
    };
    for i in 0..6 * ROUNDS {
        let way = [pose(tip(i)), pose(tip(i + 1))];
        times[0].push(timed(|| _ = gel.carry(&mut state, &Shaft { way, radius_mm: 0.25 })));
        let port = tip(i + 1);
        let cone = |at: &Vector3<f64>| {
            let way = at - port;
            (way.x > 0.8 * way.norm()).then(|| 0.05 / way.norm())
        };
        times[1].push(timed(|| _ = gel.suck(&mut state, port, 1.5, cone)));
        times[2].push(timed(|| gel.relax(&mut state)));
        gel.free();
        times[3].push(timed(|| _ = gel.look(&mut state)));
        times[4].push(timed(|| _ = gel.draw(&state)));
    }
    let names = ["shaft 0.2 mm", "suction cone", "relaxation", "traction", "densities"];
    let elements = gel.lattice().elements();
    let total: f64 = times.iter().map(|t| median(t.clone())).sum();
    rows.extend(names.into_iter().zip(times).map(|(method, t)| Row { method, elements, step_us: median(t) }));
    rows.push(Row { method: "one step, sum", elements, step_us: total });
}

fn main() {
    if !std::env::args().any(|a| a == "--json") {
        println!("{}", validation::compiled::line(&["tissue", "validation"]));
    }
    let mut rows = Vec::new();
    for cells in [32, 64, 96] {
        let runs: Vec<_> = (0..ROUNDS).map(|_| single(cells, Way::Ours)).collect();
        let step_us = median(runs.iter().map(|r| r.0).collect());
        let method = match cells {
            32 => "vitreous-32",
            64 => "vitreous-64",
            _ => "vitreous-96",
        };
        rows.push(Row { method, elements: runs[0].1, step_us });
        for (how, method) in [(Way::Textbook, "textbook queue"), (Way::Bare, "bare textbook")] {
            let peers: Vec<_> = (0..ROUNDS).map(|_| single(cells, how)).collect();
            assert!(peers[0].2.shift_um == runs[0].2.shift_um, "both find the least move");
            let step_us = median(peers.iter().map(|r| r.0).collect());
            rows.push(Row { method, elements: peers[0].1, step_us });
        }
        shaft(cells, &mut rows);
    }
    if std::env::args().any(|a| a == "--json") {
        for Row { method, elements, step_us } in rows {
            println!("{{\"method\":\"{method}\",\"elements\":{elements},\"step_us\":{step_us:.1}}}");
        }
        return;
    }
    println!("{:>16} {:>10} {:>10}", "", "elements", "µs");
    for Row { method, elements, step_us } in rows {
        println!("{method:>16} {elements:>10} {step_us:>10.1}");
    }
}
