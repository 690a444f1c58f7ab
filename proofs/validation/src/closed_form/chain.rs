//! Chains that hang from two points: 20 links that hardly stretch, and finer and finer ones against
//! the catenary.

use super::case::{BALANCE, Case, Chart, Depth, Outcome, Series, number, numbers};
use super::net::{Link, Net, NetSpec};
use serde_json::Value;

/// Twenty links: as their stiffness grows, the chain of rigid links.
pub const LINKS: Case = Case {
    name: "hanging-chain",
    title: "Hanging chain of 20 links",
    ours: "quasi-static springs",
    run: links,
};

/// Ever shorter links: the catenary.
pub const CATENARY: Case =
    Case { name: "catenary", title: "Catenary", ours: "quasi-static springs", run: catenary };

/// Weight of the whole chain, µN.
const WEIGHT: f64 = 19.0;

/// A chain of `count` links, at rest on an arc that is as long as it; then heavy, balanced while
/// its stiffness grows to `stiffness`·`count`: the chain as a whole then has `stiffness`.
fn hang(length: f64, span: f64, count: usize, weights: f64, stiffness: f64) -> Net {
    let mut start: Option<Vec<[f64; 3]>> = None;
    let mut soft = 1e3f64;
    loop {
        let now = soft.min(stiffness);
        let mut net = chain(length, span, count, now);
        for node in 1..count {
            net.pull(node, [0.0, -weights, 0.0]);
            if let Some(start) = &start {
                net.put(node, start[node]);
            }
        }
        let left = net.balance(&BALANCE);
        assert!(left < 1e-6, "a chain of {count} links and stiffness {now} does not balance: {left}");
        if now >= stiffness {
            return net;
        }
        start = Some((0..=count).map(|n| net.at(n)).collect());
        soft *= 10.0;
    }
}

fn chain(length: f64, span: f64, count: usize, stiffness: f64) -> Net {
    let link = length / count as f64;
    let at = |n: usize| {
        let s = n as f64 / count as f64;
        [span * s, -1.1 * s * (1.0 - s) * length, 0.0]
    };
    let ends = |n: usize| [n as u32, n as u32 + 1];
    let links = (0..count).map(|n| Link { ends: ends(n), stiffness: stiffness * count as f64, rest: link });
    Net::new(&NetSpec {
        nodes: (0..=count).map(at).collect(),
        links: links.collect(),
        pinned: vec![0, count as u32],
        mass_g: 1e-3,
        ..NetSpec::default()
    })
}

fn links(reference: &Value, depth: Depth) -> Outcome {
    let of = |key: &str| number(reference, &format!("hanging_chain_20_links/{key}"));
    let (length, span) = (of("length"), of("span"));
    let mut sag = Series::new("sag, mm", of("max_sag"));
    let mut pull = Series::new("horizontal pull / link weight", of("H_over_mg"));
    let mut outcome = Outcome::default().refined_by("weight / stiffness, mm");
    for stiffness in depth.of(&[1e4, 1e5, 1e6], 2) {
        let net = hang(length, span, 20, WEIGHT / 19.0, stiffness);
        let compliance = WEIGHT / stiffness;
        sag.found.push([compliance, -net.at(10)[1]]);
        // The first link carries half of the 19 joints and points along its pull; tensions
        // themselves would be differences of lengths that agree to the last bits of single
        // precision.
        let [x, y, _] = net.at(1);
        pull.found.push([compliance, 9.5 * x / -y]);
        outcome.solution = Chart::new("x, mm", "height, mm");
        let joints = |x: f64, y: f64| [x, -y];
        let x = numbers(reference, "hanging_chain_20_links/x");
        let y = numbers(reference, "hanging_chain_20_links/sag_at_joint");
        outcome.solution.line("reference", x.iter().zip(&y).map(|(x, y)| joints(*x, *y)).collect());
        outcome.solution.marks("ours", (0..=20).map(|n| [net.at(n)[0], net.at(n)[1]]).collect());
    }
    let resolution = format!("20 links, stretched by {:.0e}", pull.found.last().map_or(0.0, |p| p[0]));
    outcome.add(sag, &resolution, 0.01);
    outcome.add(pull, &resolution, 0.01);
    outcome
}

fn catenary(reference: &Value, depth: Depth) -> Outcome {
    let of = |key: &str| number(reference, &format!("catenary/{key}"));
    let (length, span, a) = (of("length"), of("span"), of("a"));
    let mut sag = Series::new("sag, mm", of("sag"));
    let mut outcome = Outcome::default().refined_by("length of a link, mm");
    let stiffness = 1e6;
    for count in depth.of(&[10, 20, 40, 80], 3) {
        let net = hang(length, span, count, WEIGHT / count as f64, stiffness);
        sag.found.push([length / count as f64, -net.at(count / 2)[1]]);
        let curve = |i: usize| {
            let x = span * i as f64 / 60.0;
            [x, a * (libm::cosh((x - 0.5 * span) / a) - libm::cosh(0.5 * span / a))]
        };
        outcome.solution = Chart::new("x, mm", "height, mm");
        outcome.solution.line("reference", (0..=60).map(curve).collect());
        outcome.solution.marks("ours", (0..=count).map(|n| [net.at(n)[0], net.at(n)[1]]).collect());
    }
    let finest = sag.found.len();
    outcome.add(sag, format!("{} links", 10 << (finest - 1)), 0.01);
    outcome
}
