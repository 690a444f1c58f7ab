//! Shapes of the instruments as closed low-poly meshes, in the instrument's frame: tip at the
//! origin, +z to the handle, jaws open in the x–z plane.

use protocol::handles::Tool;
use protocol::handles::{JAW_LENGTH_MM, JAW_TAPER};

/// Sides of a round shaft.
const SIDES: usize = 16;

/// A triangle, mm.
pub type Facet = [[f64; 3]; 3];

/// An instrument's shape.
#[derive(Debug, Clone, PartialEq)]
pub struct ToolMesh {
    /// What does not move.
    pub shaft: Vec<Facet>,
    /// The jaw on the +x side, closed; the other is its mirror image. Empty without jaws.
    pub jaw: Vec<Facet>,
}

impl ToolMesh {
    /// The shape of `tool` with a shaft of radius `radius_mm`, drawn up to `length_mm` from the tip.
    pub fn new(tool: Tool, radius_mm: f64, length_mm: f64) -> Self {
        match tool {
            Tool::Forceps => ToolMesh {
                shaft: tube(radius_mm, JAW_LENGTH_MM, length_mm.max(JAW_LENGTH_MM) + 1.0),
                jaw: half_cone(radius_mm),
            },
            // Their working ends differ by far less than a pixel of the collision image.
            Tool::LightPipe | Tool::Pick | Tool::Vitrector | Tool::Needle => {
                ToolMesh { shaft: tube(radius_mm, 0.0, length_mm + 1.0), jaw: Vec::new() }
            }
        }
    }

    /// Calls `draw` for each triangle with the jaws opened by `jaw_rad` (angle between them).
    pub fn for_each(&self, jaw_rad: f64, mut draw: impl FnMut(Facet)) {
        self.shaft.iter().for_each(|f| draw(*f));
        let (sin, cos) = (libm::sin(jaw_rad * 0.5), libm::cos(jaw_rad * 0.5));
        for facet in &self.jaw {
            let open = facet.map(|p| open_about_pivot(p, sin, cos));
            draw(open);
            draw(open.map(|[x, y, z]| [-x, y, z]));
        }
    }
}

/// Turns a point about the pivot (0, y, jaw length) so that a tip on +x goes further to +x.
fn open_about_pivot([x, y, z]: [f64; 3], sin: f64, cos: f64) -> [f64; 3] {
    let below = JAW_LENGTH_MM - z;
    [x * cos + below * sin, y, JAW_LENGTH_MM - (below * cos - x * sin)]
}

/// Points of a regular polygon with its first corner on +x, over `corners` of a turn.
fn arc(radius: f64, z: f64, corners: usize, turn: f64) -> Vec<[f64; 3]> {
    let angle = |i: usize| turn * i as f64 / SIDES as f64 * std::f64::consts::TAU;
    (0..corners).map(|i| [radius * libm::cos(angle(i)), radius * libm::sin(angle(i)), z]).collect()
}

/// A closed prism or cone frustum between two outlines of as many corners.
fn solid(low: &[[f64; 3]], high: &[[f64; 3]]) -> Vec<Facet> {
    let n = low.len();
    let mut facets = Vec::new();
    for (i, j) in (0..n).map(|i| (i, (i + 1) % n)) {
        facets.push([low[i], low[j], high[j]]);
        facets.push([low[i], high[j], high[i]]);
    }
    for i in 1..n - 1 {
        facets.push([low[0], low[i + 1], low[i]]);
        facets.push([high[0], high[i], high[i + 1]]);
    }
    facets
}

fn tube(radius: f64, from_z: f64, to_z: f64) -> Vec<Facet> {
    solid(&arc(radius, from_z, SIDES, 1.0), &arc(radius, to_z, SIDES, 1.0))
}

/// Half of a cone on the +x side, from the narrow tip to the pivot.
fn half_cone(radius: f64) -> Vec<Facet> {
    let half = |radius: f64, z: f64| {
        let mut outline = arc(radius, z, SIDES / 2 + 1, 1.0);
        // From −90° to +90° about z: the flat side faces the other jaw.
        outline.iter_mut().for_each(|p| *p = [p[1], -p[0], p[2]]);
        outline
    };
    solid(&half(radius * JAW_TAPER, 0.0), &half(radius, JAW_LENGTH_MM))
}

#[cfg(test)]
mod tests {
    use super::*;
    use std::collections::HashMap;

    fn closed(facets: &[Facet]) -> bool {
        let key = |p: [f64; 3]| p.map(|c| (c * 1e6).round() as i64);
        let mut edges: HashMap<_, i32> = HashMap::new();
        for f in facets {
            for (a, b) in [(f[0], f[1]), (f[1], f[2]), (f[2], f[0])] {
                let (a, b) = (key(a), key(b));
                *edges.entry(if a < b { (a, b) } else { (b, a) }).or_default() += if a < b { 1 } else { -1 };
            }
        }
        edges.values().all(|&n| n == 0)
    }

    #[test]
    fn meshes_are_closed() {
        for tool in [Tool::Forceps, Tool::LightPipe] {
            let mesh = ToolMesh::new(tool, 0.25, 2.0);
            assert!(closed(&mesh.shaft), "{tool:?} shaft");
            assert!(closed(&mesh.jaw), "{tool:?} jaw");
        }
    }

    #[test]
    fn jaws_open_along_x_by_the_angle() {
        let mesh = ToolMesh::new(Tool::Forceps, 0.25, 2.0);
        let reach = |jaw: f64| {
            let mut tip = 0.0f64;
            mesh.for_each(jaw, |f| f.iter().filter(|p| p[2] < 0.5).for_each(|p| tip = tip.max(p[0])));
            tip
        };
        let closed = 0.25 * JAW_TAPER;
        assert!((reach(0.0) - closed).abs() < 1e-9);
        let expected = JAW_LENGTH_MM * libm::sin(0.25) + closed * libm::cos(0.25);
        assert!((reach(0.5) - expected).abs() < 1e-9);
    }

    #[test]
    fn the_tip_is_the_origin() {
        let mut lowest = f64::INFINITY;
        ToolMesh::new(Tool::LightPipe, 0.25, 2.0)
            .for_each(0.0, |f| f.iter().for_each(|p| lowest = lowest.min(p[2])));
        assert_eq!(lowest, 0.0);
    }
}
