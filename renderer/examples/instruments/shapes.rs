//! Shapes of the instruments, instrument frame, mm: tip at the origin, handle towards +z; port,
//! hook and jaw plane along +x. All are drawn at 25 gauge; the renderer widens them for other
//! gauges.

use glam::DVec3;
use protocol::handles::{
    HOOK_LENGTH_MM, HOOK_THICKNESS_MM, JAW_LENGTH_MM, JAW_TAPER, PORT_HEIGHT_MM, PORT_RADIUS_MM,
};
use std::f64::consts::TAU;

/// Radius of the shaft: 25 gauge.
const R: f64 = renderer::tools::NOMINAL_RADIUS_MM as f64;
/// Length of the shaft from the tip.
const LENGTH: f64 = renderer::tools::NOMINAL_LENGTH_MM as f64;
/// Radius of the needle's cannula: 41 gauge.
const CANNULA: f64 = renderer::tools::NOMINAL_CANNULA_MM as f64;
/// Corners of a round cross-section.
const SIDES: usize = 24;

/// A triangle, counter-clockwise from outside.
pub type Facet = [DVec3; 3];

/// Triangles of one material.
pub struct Surface {
    /// Its name in the file.
    pub material: &'static str,
    /// Positions relative to the part.
    pub triangles: Vec<Facet>,
}

/// A closed body that is a node of its own.
pub struct Part {
    /// Name of the node.
    pub name: &'static str,
    /// Where the node lies; a jaw turns about it.
    pub at: DVec3,
    /// What it is made of; together they are closed.
    pub surfaces: Vec<Surface>,
}

/// An instrument.
pub struct Shape {
    /// Name of the file and of its root.
    pub name: &'static str,
    /// Its parts.
    pub parts: Vec<Part>,
}

/// Every instrument.
pub fn all() -> [Shape; 5] {
    [forceps(), light_pipe(), pick(), vitrector(), needle()]
}

fn metal(name: &'static str, triangles: Vec<Facet>) -> Part {
    Part { name, at: DVec3::ZERO, surfaces: vec![Surface { material: "metal", triangles }] }
}

/// End-gripping forceps: the jaws touch at their tips and leave a slot towards the pivot.
fn forceps() -> Shape {
    let pivot = DVec3::Z * JAW_LENGTH_MM;
    let jaw = half_cone();
    let jaw_part = |name, side: f64| {
        let flip = |f: &Facet| {
            let [a, b, c] = f.map(|p| DVec3::new(side * p.x, p.y, p.z) - pivot);
            if side > 0.0 { [a, b, c] } else { [a, c, b] }
        };
        Part { at: pivot, ..metal(name, jaw.iter().map(flip).collect()) }
    };
    let shaft = tube(&[[JAW_LENGTH_MM, 0.92 * R], [JAW_LENGTH_MM + 0.03, R], [LENGTH, R]]);
    let parts = vec![metal("shaft", shaft), jaw_part("jaw-plus", 1.0), jaw_part("jaw-minus", -1.0)];
    Shape { name: "forceps", parts }
}

/// The jaw on the +x side: half of a cone whose flat side faces the other jaw, hollowed between tip
/// and pivot.
fn half_cone() -> Vec<Facet> {
    let outline = |&[z, slot]: &[f64; 2]| {
        let radius = R * (JAW_TAPER + (1.0 - JAW_TAPER) * z / JAW_LENGTH_MM);
        let reach = libm::acos(slot);
        let corner = |i: usize| {
            let angle = reach * (2.0 * i as f64 / SIDES as f64 * 2.0 - 1.0);
            DVec3::new(radius * libm::cos(angle), radius * libm::sin(angle), z)
        };
        (0..=SIDES / 2).map(corner).collect()
    };
    // Height, and half width of the slot as a share of the radius.
    let heights = [
        [0.0, 0.0],
        [0.20, 0.0],
        [0.30, 0.30],
        [0.45, 0.45],
        [0.75, 0.5],
        [1.1, 0.45],
        [1.3, 0.2],
        [JAW_LENGTH_MM, 0.0],
    ];
    loft(&heights.iter().map(outline).collect::<Vec<Vec<DVec3>>>())
}

fn light_pipe() -> Shape {
    // Length of fibre that stands out of the steel and glows, mm.
    const BARE: f64 = 0.3;
    let face = f64::from(renderer::tools::FIBRE_FACE_MM);
    let shaft = tube(&[[BARE, 0.80 * R], [BARE + 0.02, 0.94 * R], [BARE + 0.05, R], [LENGTH, R]]);
    let fibre = tube(&[[face, 0.5 * R], [0.5 * face, 0.66 * R], [0.02, 0.74 * R], [BARE + 0.01, 0.76 * R]]);
    let glass = Surface { material: "fibre", triangles: fibre };
    let fibre = Part { name: "fibre", at: DVec3::ZERO, surfaces: vec![glass] };
    Shape { name: "light-pipe", parts: vec![metal("shaft", shaft), fibre] }
}

/// A membrane pick: a bar across the end of a thinned shaft, its under side at the height of the
/// tip.
fn pick() -> Shape {
    let neck = 0.5 * HOOK_THICKNESS_MM;
    let shaft = tube(&[[0.0, 0.8 * neck], [0.02, neck], [0.8, R], [LENGTH, R]]);
    let outline = |&[along, share]: &[f64; 2]| {
        let (half, high) = (0.5 * HOOK_THICKNESS_MM * share, HOOK_THICKNESS_MM * share);
        let corner = |i: usize| {
            let (sin, cos) = libm::sincos(i as f64 / SIDES as f64 * TAU);
            DVec3::new(along * HOOK_LENGTH_MM, half * sin, 0.5 * high - 0.5 * high * cos)
        };
        (0..SIDES).map(corner).collect()
    };
    let bar = [[0.0, 1.0], [0.5, 0.8], [0.93, 0.55], [0.98, 0.42], [1.0, 0.2]];
    let hook = loft(&bar.iter().map(outline).collect::<Vec<Vec<DVec3>>>());
    Shape { name: "pick", parts: vec![metal("shaft", shaft), metal("hook", hook)] }
}

/// A needle: a thin blunt cannula in a shaft.
fn needle() -> Shape {
    let cannula = tube(&[[0.0, 0.8 * CANNULA], [0.01, CANNULA], [4.1, CANNULA]]);
    let shaft = tube(&[[3.9, 0.5 * R], [4.0, 0.62 * R], [4.3, R], [LENGTH, R]]);
    Shape { name: "needle", parts: vec![metal("shaft", shaft), metal("cannula", cannula)] }
}

/// Sides of the shaft's cross-section that the port's surroundings take.
const PORT_SIDES: usize = 10;
/// Steps of the shaft beside the port.
const PORT_LEVELS: usize = 8;
/// Heights over and under the port's middle where its surroundings end, as shares of its radius.
const PORT_REACH: f64 = 1.4;
/// Depth of the port.
const PORT_DEPTH_MM: f64 = 0.2;

/// A shaft with a rounded closed end and a hole in its side.
fn vitrector() -> Shape {
    let [low, high] = [-1.0, 1.0].map(|s| PORT_HEIGHT_MM + s * PORT_REACH * PORT_RADIUS_MM);
    let end = [[0.0, 0.62 * R], [0.012, 0.78 * R], [0.035, 0.92 * R], [0.07, R], [low, R]];
    let mut wall = open_tube(&end);
    wall.extend(open_tube(&[[high, R], [LENGTH, R]]));
    wall.extend(cap(&ring(end[0]), false));
    wall.extend(cap(&ring([LENGTH, R]), true));
    // Beside the port's surroundings the shaft is plain.
    let half = PORT_SIDES / 2;
    let levels: Vec<Vec<DVec3>> =
        (0..=PORT_LEVELS).map(|k| ring([low + (high - low) * k as f64 / PORT_LEVELS as f64, R])).collect();
    for (pair, i) in levels.windows(2).flat_map(|pair| (half..SIDES - half).map(move |i| (pair, i))) {
        let j = (i + 1) % SIDES;
        let [below, above] = [&pair[0], &pair[1]];
        wall.extend([[below[i], below[j], above[j]], [below[i], above[j], above[i]]]);
    }
    let around = surroundings(&levels);
    let rim: Vec<DVec3> = around.iter().map(|p| on_rim(*p)).collect();
    wall.extend(strip(&around, &rim));
    let floor: Vec<DVec3> = rim.iter().map(|p| *p - DVec3::X * (p.x - R + PORT_DEPTH_MM)).collect();
    let mut hole = strip(&rim, &floor);
    hole.extend(cap(&floor, true));
    let surfaces =
        vec![Surface { material: "metal", triangles: wall }, Surface { material: "port", triangles: hole }];
    Shape { name: "vitrector", parts: vec![Part { name: "shaft", at: DVec3::ZERO, surfaces }] }
}

/// The border of the port's surroundings, counter-clockwise seen from +x, y to the right, z up.
fn surroundings(levels: &[Vec<DVec3>]) -> Vec<DVec3> {
    let half = PORT_SIDES / 2;
    let (left, right) = (SIDES - half, half);
    let along =
        |level: &[DVec3]| -> Vec<DVec3> { (0..=PORT_SIDES).map(|i| level[(left + i) % SIDES]).collect() };
    let inner = 1..levels.len() - 1;
    let up = inner.clone().map(|k| levels[k][right]);
    let down = inner.rev().map(|k| levels[k][left]);
    let top = along(&levels[levels.len() - 1]).into_iter().rev();
    along(&levels[0]).into_iter().chain(up).chain(top).chain(down).collect()
}

/// The point of the port's rim in the direction of `border` from its middle, on the shaft's
/// surface.
fn on_rim(border: DVec3) -> DVec3 {
    let out = glam::DVec2::new(border.y, border.z - PORT_HEIGHT_MM).normalize() * PORT_RADIUS_MM;
    DVec3::new(libm::sqrt(R * R - out.x * out.x), out.x, PORT_HEIGHT_MM + out.y)
}

/// A round cross-section, its first corner on +x.
fn ring([z, radius]: [f64; 2]) -> Vec<DVec3> {
    let corner = |i: usize| {
        let (sin, cos) = libm::sincos(i as f64 / SIDES as f64 * TAU);
        DVec3::new(radius * cos, radius * sin, z)
    };
    (0..SIDES).map(corner).collect()
}

/// Quads between two closed outlines that run counter-clockwise seen from where the second one
/// lies.
fn strip(low: &[DVec3], high: &[DVec3]) -> Vec<Facet> {
    let n = low.len();
    let quad = |i: usize| {
        let j = (i + 1) % n;
        [[low[i], low[j], high[j]], [low[i], high[j], high[i]]]
    };
    (0..n).flat_map(quad).collect()
}

/// A lid over an outline: a fan about its middle.
fn cap(outline: &[DVec3], facing_on: bool) -> Vec<Facet> {
    let middle = outline.iter().sum::<DVec3>() / outline.len() as f64;
    let side = |i: usize| {
        let (a, b) = (outline[i], outline[(i + 1) % outline.len()]);
        if facing_on { [middle, a, b] } else { [middle, b, a] }
    };
    (0..outline.len()).map(side).collect()
}

/// A closed body through outlines of as many corners each.
fn loft(outlines: &[Vec<DVec3>]) -> Vec<Facet> {
    let mut facets: Vec<Facet> = outlines.windows(2).flat_map(|pair| strip(&pair[0], &pair[1])).collect();
    facets.extend(cap(&outlines[0], false));
    facets.extend(cap(&outlines[outlines.len() - 1], true));
    facets
}

/// The side of a body of revolution through (height, radius).
fn open_tube(profile: &[[f64; 2]]) -> Vec<Facet> {
    profile.windows(2).flat_map(|pair| strip(&ring(pair[0]), &ring(pair[1]))).collect()
}

/// A closed body of revolution.
fn tube(profile: &[[f64; 2]]) -> Vec<Facet> {
    loft(&profile.iter().map(|&at| ring(at)).collect::<Vec<_>>())
}
