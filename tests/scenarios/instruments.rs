//! What is drawn is what touches: the instruments' drawn meshes and those of the collision have the same tips, hooks, shafts and
//! jaw openings.

use protocol::handles::Tool;
use renderer::tools::{JAW_LENGTH_MM, Models, NOMINAL_CANNULA_MM, Shaft};
use simcore::collision::tool_mesh::ToolMesh;

/// Largest difference of a measure, mm.
const SAME_MM: f64 = 0.005;
/// A light pipe's fibre stands out of its end by this, mm: nothing is touched by it.
const FIBRE_MM: f64 = 0.02;

/// Positions of the drawn mesh with its jaws opened as `place.wgsl` does.
fn drawn(tool: Tool, radius_mm: f64, jaw_rad: f64) -> Vec<[f64; 3]> {
    let shaft = Shaft { radius_mm: radius_mm as f32, length_mm: 60.0, cannula_mm: NOMINAL_CANNULA_MM };
    let pivot = f64::from(JAW_LENGTH_MM);
    let turned = |v: &renderer::layout::MetalVertex| {
        let [x, y, z] = v.position.map(f64::from);
        let (sin, cos) = (-f64::from(v.part) * 0.5 * jaw_rad).sin_cos();
        [cos * x + sin * (z - pivot), y, cos * (z - pivot) - sin * x + pivot]
    };
    Models::shipped().unwrap().of(tool).mesh(&shaft).vertices.iter().map(turned).collect()
}

fn touching(tool: Tool, radius_mm: f64, jaw_rad: f64) -> Vec<[f64; 3]> {
    ToolMesh::new(tool, radius_mm, 4.0).facets(jaw_rad).concat()
}

/// Least and greatest of one coordinate of the points between two heights.
fn extent(points: &[[f64; 3]], axis: usize, [from, to]: [f64; 2]) -> [f64; 2] {
    let inside = points.iter().filter(|p| (from..=to).contains(&p[2])).map(|p| p[axis]);
    inside.fold([f64::MAX, f64::MIN], |[low, high], c| [low.min(c), high.max(c)])
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
        let (drawn, touching) = (drawn(tool, shaft, 0.0), touching(tool, radius, 0.0));
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
        // Of a jaw opened wide the tip rises.
        let end = [-1.0, 0.45];
        for axis in 0..2 {
            let [a, b] = [&drawn, &touching].map(|points| extent(points, axis, end));
            assert_same(&format!("radius {radius}, jaws {jaw}, axis {axis}"), a, b);
        }
        let gap = |points: &[[f64; 3]]| {
            let low = points.iter().map(|p| p[2]).fold(f64::MAX, f64::min);
            let tips = points.iter().filter(|p| p[2] < low + 0.02 && p[0] >= -1e-9).map(|p| p[0]);
            tips.fold(f64::MAX, f64::min)
        };
        assert_same(&format!("radius {radius}, jaws {jaw}, gap"), [gap(&drawn); 2], [gap(&touching); 2]);
    }
}

#[test]
fn the_hook_reaches_alike() {
    let (drawn, touching) = (drawn(Tool::Pick, 0.25, 0.0), touching(Tool::Pick, 0.25, 0.0));
    for axis in 0..2 {
        let [a, b] = [&drawn, &touching].map(|points| extent(points, axis, [-1.0, 0.125]));
        // The hook at the height where both are cut; the shaft's neck is as thick.
        assert_same(&format!("hook, axis {axis}"), a, b);
    }
    let [a, b] = [&drawn, &touching].map(|points| extent(points, 2, [-1.0, 0.125]));
    assert_same("hook, height", a, b);
}
