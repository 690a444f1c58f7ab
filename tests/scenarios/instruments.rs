//! What is drawn is what touches: the instruments' drawn meshes and those of the collision have the
//! same tips, hooks, shafts and jaw openings.

use collision::tool_mesh::ToolMesh;
use protocol::handles::Tool;
use renderer::tools::{JAW_LENGTH_MM, Models, NOMINAL_CANNULA_MM, Shaft};

/// Largest difference of a measure, mm.
const SAME_MM: f64 = 0.005;
/// A light pipe's fibre stands out of its end by this, mm: nothing is touched by it.
const FIBRE_MM: f64 = 0.02;

/// A triangle, mm.
type Facet = [[f64; 3]; 3];

/// The drawn mesh with its jaws opened as `place.wgsl` does.
fn drawn(tool: Tool, radius_mm: f64, jaw_rad: f64) -> Vec<Facet> {
    let shaft = Shaft { radius_mm: radius_mm as f32, length_mm: 60.0, cannula_mm: NOMINAL_CANNULA_MM };
    let pivot = f64::from(JAW_LENGTH_MM);
    let turned = |v: &renderer::layout::MetalVertex| {
        let [x, y, z] = v.position.map(f64::from);
        let (sin, cos) = (-f64::from(v.part) * 0.5 * jaw_rad).sin_cos();
        [cos * x + sin * (z - pivot), y, cos * (z - pivot) - sin * x + pivot]
    };
    let mesh = Models::shipped().unwrap().of(tool).mesh(&shaft);
    let corner = |i: &u32| turned(&mesh.vertices[*i as usize]);
    mesh.indices.chunks_exact(3).map(|t| [corner(&t[0]), corner(&t[1]), corner(&t[2])]).collect()
}

fn touching(tool: Tool, radius_mm: f64, jaw_rad: f64) -> Vec<Facet> {
    ToolMesh::new(tool, radius_mm, 4.0).facets(jaw_rad)
}

/// Where the edges of a mesh pass a height: the meshes have corners at different heights, but the
/// same sections.
fn cut(mesh: &[Facet], height: f64) -> Vec<[f64; 3]> {
    let edges = mesh.iter().flat_map(|[a, b, c]| [(a, b), (b, c), (c, a)]);
    let crossing = edges.filter(|(a, b)| (a[2] < height) != (b[2] < height));
    let at = |(a, b): (&[f64; 3], &[f64; 3])| {
        let share = (height - a[2]) / (b[2] - a[2]);
        [0, 1, 2].map(|c| a[c] + share * (b[c] - a[c]))
    };
    crossing.map(at).collect()
}

/// Least and greatest of one coordinate of points.
fn extent(points: &[[f64; 3]], axis: usize) -> [f64; 2] {
    let of_axis = points.iter().map(|p| p[axis]);
    of_axis.fold([f64::MAX, f64::MIN], |[low, high], c| [low.min(c), high.max(c)])
}

/// Corners of a mesh up to a height.
fn below(mesh: &[Facet], height: f64) -> Vec<[f64; 3]> {
    mesh.iter().flatten().copied().filter(|p| p[2] <= height).collect()
}

fn assert_same(what: &str, a: [f64; 2], b: [f64; 2]) {
    let apart = (a[0] - b[0]).abs().max((a[1] - b[1]).abs());
    assert!(apart <= SAME_MM, "{what}: drawn {a:?}, touching {b:?}");
}

#[test]
fn tips_and_shafts_agree() {
    for (tool, radius) in
        [(Tool::Forceps, 0.25), (Tool::Forceps, 0.3), (Tool::LightPipe, 0.25), (Tool::Pick, 0.25)]
            .into_iter()
            .chain([(Tool::Vitrector, 0.25), (Tool::Needle, f64::from(NOMINAL_CANNULA_MM))])
    {
        // A needle's radius in the collision is that of its cannula.
        let shaft = if tool == Tool::Needle { 0.25 } else { radius };
        let (drawn, touching) = (drawn(tool, shaft, 0.0).concat(), touching(tool, radius, 0.0).concat());
        let tip = |points: &[[f64; 3]]| points.iter().map(|p| p[2]).fold(f64::MAX, f64::min);
        let stands_out = if tool == Tool::LightPipe { FIBRE_MM } else { 0.0 };
        assert!((tip(&drawn) + stands_out - tip(&touching)).abs() <= SAME_MM, "{tool:?}: the tip");
        // The shaft where both are plain; the drawn one has no corners between 4 and 60 mm.
        let reach = |points: &[[f64; 3]]| points.iter().map(|p| p[0].hypot(p[1])).fold(0.0, f64::max);
        if tool != Tool::Needle && tool != Tool::Pick {
            assert!((reach(&drawn) - reach(&touching)).abs() <= SAME_MM, "{tool:?}: the shaft");
        }
    }
}

#[test]
fn jaws_open_alike() {
    for (radius, jaw) in [0.25, 0.3].into_iter().flat_map(|r| [0.0, 0.2, 0.5, 1.0].map(|j| (r, j))) {
        let (drawn, touching) = (drawn(Tool::Forceps, radius, jaw), touching(Tool::Forceps, radius, jaw));
        let case = format!("radius {radius}, jaws {jaw}");
        let [low, same] =
            [&drawn, &touching].map(|m| m.iter().flatten().map(|p| p[2]).fold(f64::MAX, f64::min));
        assert_same(&format!("{case}, lowest"), [low; 2], [same; 2]);
        // The outer sides, of a jaw opened wide above its tip's end.
        for above in [0.02, 0.1, 0.3, 0.6, 1.0].map(|h| low + h) {
            let [a, b] = [&drawn, &touching].map(|mesh| extent(&cut(mesh, above), 0));
            assert_same(&format!("{case}, width at {above:.2} mm"), a, b);
        }
        // Near the tips the jaws are solid; further up the drawn ones are hollowed between tip and
        // pivot.
        for above in [0.02, 0.06].map(|h| low + h) {
            let [a, b] = [&drawn, &touching].map(|mesh| extent(&cut(mesh, above), 1));
            assert_same(&format!("{case}, depth at {above:.2} mm"), a, b);
            let [a, b] = [&drawn, &touching].map(|mesh| {
                let right = cut(mesh, above).into_iter().filter(|p| p[0] >= -1e-9);
                right.map(|p| p[0]).fold(f64::MAX, f64::min)
            });
            assert_same(&format!("{case}, gap at {above:.2} mm"), [a; 2], [b; 2]);
        }
    }
}

#[test]
fn the_hook_reaches_alike() {
    let (drawn, touching) = (drawn(Tool::Pick, 0.25, 0.0), touching(Tool::Pick, 0.25, 0.0));
    for axis in 0..2 {
        let [a, b] = [&drawn, &touching].map(|mesh| extent(&below(mesh, 0.125), axis));
        // The hook at the height where both are cut; the shaft's neck is as thick.
        assert_same(&format!("hook, axis {axis}"), a, b);
    }
    let [a, b] = [&drawn, &touching].map(|mesh| extent(&below(mesh, 0.125), 2));
    assert_same("hook, height", a, b);
}
