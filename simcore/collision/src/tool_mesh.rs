//! Shapes of the instruments as closed low-poly meshes, in the instrument's frame: tip at the
//! origin, +z to the handle, jaws open in the x–z plane, the pick's hook along +x.

use protocol::handles::Tool;
use protocol::handles::{HOOK_LENGTH_MM, HOOK_THICKNESS_MM, JAW_LENGTH_MM, JAW_TAPER};

/// A triangle, mm.
pub type Facet = [[f64; 3]; 3];

/// An instrument's shape.
#[derive(Debug, Clone, PartialEq)]
pub struct ToolMesh {
    /// What does not move.
    pub shaft: Vec<Facet>,
    /// The jaw on the +x side, closed; the other is its mirror image. Empty without jaws.
    pub jaw: Vec<Facet>,
    /// What reaches out to the side and can lift tissue; it does not move. Empty without a hook.
    pub hook: Vec<Facet>,
}

/// Height at which a pick's shaft has its full radius, mm.
const NECK_MM: f64 = 0.8;
/// Thickness and width of the hook at its end as a share of those at its root.
const HOOK_TAPER: f64 = 0.5;

/// How finely a shape is cut into triangles.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub struct Detail {
    /// Sides of a round shaft, a multiple of two.
    pub sides: usize,
    /// Rings along a shaft or a jaw.
    pub rings: usize,
}

/// What the simulation draws.
pub const PLAIN: Detail = Detail { sides: 16, rings: 1 };
/// A forceps of about 2,000 triangles, as the paper's.
pub const FINE: Detail = Detail { sides: 32, rings: 14 };

impl ToolMesh {
    /// The shape of `tool` with a shaft of radius `radius_mm`, drawn up to `length_mm` from the
    /// tip.
    pub fn new(tool: Tool, radius_mm: f64, length_mm: f64) -> Self {
        Self::with_detail(tool, radius_mm, length_mm, PLAIN)
    }

    /// The same shape, more finely.
    pub fn with_detail(tool: Tool, radius_mm: f64, length_mm: f64, detail: Detail) -> Self {
        let bare = |shaft| ToolMesh { shaft, jaw: Vec::new(), hook: Vec::new() };
        let end = length_mm + 1.0;
        match tool {
            Tool::Forceps => {
                let shaft = tube(radius_mm, JAW_LENGTH_MM, length_mm.max(JAW_LENGTH_MM) + 1.0, detail);
                ToolMesh { jaw: half_cone(radius_mm, detail), ..bare(shaft) }
            }
            Tool::Pick => ToolMesh { hook: hook(), ..bare(necked(radius_mm, end, detail)) },
            // The port is a hole in the shaft, smaller than a few pixels of the collision image. A
            // needle's radius is given.
            Tool::LightPipe | Tool::Vitrector | Tool::Needle => bare(tube(radius_mm, 0.0, end, detail)),
        }
    }

    /// All triangles with the jaws opened by `jaw_rad`.
    pub fn facets(&self, jaw_rad: f64) -> Vec<Facet> {
        let mut facets = Vec::new();
        self.for_each(jaw_rad, |facet| facets.push(facet));
        facets
    }

    /// Calls `draw` for each triangle with the jaws opened by `jaw_rad` (angle between them).
    pub fn for_each(&self, jaw_rad: f64, mut draw: impl FnMut(Facet)) {
        self.shaft.iter().for_each(|f| draw(*f));
        self.for_each_aside(jaw_rad, draw);
    }

    /// Calls `draw` for each triangle of what reaches beside the shaft: hook and jaws.
    pub fn for_each_aside(&self, jaw_rad: f64, mut draw: impl FnMut(Facet)) {
        self.hook.iter().for_each(|f| draw(*f));
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

/// Points of a regular polygon of `sides` with its first corner on +x, over its first `corners`.
fn arc(radius: f64, z: f64, sides: usize, corners: usize) -> Vec<[f64; 3]> {
    let angle = |i: usize| i as f64 / sides as f64 * std::f64::consts::TAU;
    (0..corners).map(|i| [radius * libm::cos(angle(i)), radius * libm::sin(angle(i)), z]).collect()
}

/// A closed body through outlines of as many corners each.
fn solid(outlines: &[Vec<[f64; 3]>]) -> Vec<Facet> {
    let mut facets = Vec::new();
    for pair in outlines.windows(2) {
        let (low, high) = (&pair[0], &pair[1]);
        let n = low.len();
        for (i, j) in (0..n).map(|i| (i, (i + 1) % n)) {
            facets.push([low[i], low[j], high[j]]);
            facets.push([low[i], high[j], high[i]]);
        }
    }
    if let [low, .., high] = outlines {
        for i in 1..low.len() - 1 {
            facets.push([low[0], low[i + 1], low[i]]);
            facets.push([high[0], high[i], high[i + 1]]);
        }
    }
    facets
}

/// Heights of the rings between two ends.
fn heights(from_z: f64, to_z: f64, rings: usize) -> impl Iterator<Item = f64> {
    (0..=rings).map(move |i| from_z + (to_z - from_z) * i as f64 / rings as f64)
}

fn tube(radius: f64, from_z: f64, to_z: f64, detail: Detail) -> Vec<Facet> {
    let ring = |z| arc(radius, z, detail.sides, detail.sides);
    solid(&heights(from_z, to_z, detail.rings).map(ring).collect::<Vec<_>>())
}

/// A shaft that begins as thin as the hook is thick.
fn necked(radius: f64, to_z: f64, detail: Detail) -> Vec<Facet> {
    let ring = |radius, z| arc(radius, z, detail.sides, detail.sides);
    let end = HOOK_THICKNESS_MM * 0.5;
    let neck = if end < radius { end } else { radius };
    solid(&[ring(neck, 0.0), ring(radius, NECK_MM), ring(radius, to_z.max(NECK_MM) + 1.0)])
}

/// A tapering bar from the axis along +x; its under side lies at the tip's height.
fn hook() -> Vec<Facet> {
    let outline = |x: f64, share: f64| {
        let (half, high) = (HOOK_THICKNESS_MM * 0.5 * share, HOOK_THICKNESS_MM * share);
        vec![[x, -half, 0.0], [x, half, 0.0], [x, half, high], [x, -half, high]]
    };
    solid(&[outline(0.0, 1.0), outline(HOOK_LENGTH_MM, HOOK_TAPER)])
}

/// Half of a cone on the +x side, from the narrow tip to the pivot.
fn half_cone(radius: f64, detail: Detail) -> Vec<Facet> {
    let half = |z: f64| {
        let taper = JAW_TAPER + (1.0 - JAW_TAPER) * (z / JAW_LENGTH_MM);
        let mut outline = arc(radius * taper, z, detail.sides, detail.sides / 2 + 1);
        // From −90° to +90° about z: the flat side faces the other jaw.
        outline.iter_mut().for_each(|p| *p = [p[1], -p[0], p[2]]);
        outline
    };
    solid(&heights(0.0, JAW_LENGTH_MM, detail.rings).map(half).collect::<Vec<_>>())
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
        let tools = [Tool::Forceps, Tool::LightPipe, Tool::Pick, Tool::Vitrector, Tool::Needle];
        for (tool, detail) in tools.map(|t| [(t, PLAIN), (t, FINE)]).concat() {
            let mesh = ToolMesh::with_detail(tool, 0.25, 2.0, detail);
            assert!(closed(&mesh.shaft), "{tool:?} shaft");
            assert!(closed(&mesh.jaw), "{tool:?} jaw");
            assert!(closed(&mesh.hook), "{tool:?} hook");
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
        for tool in [Tool::LightPipe, Tool::Pick] {
            let mut lowest = f64::INFINITY;
            ToolMesh::new(tool, 0.25, 2.0)
                .for_each(0.0, |f| f.iter().for_each(|p| lowest = lowest.min(p[2])));
            assert_eq!(lowest, 0.0);
        }
    }

    #[test]
    fn the_hook_reaches_beyond_the_shaft_on_one_side() {
        let mesh = ToolMesh::new(Tool::Pick, 0.25, 2.0);
        let mut ends = [0.0f64; 2];
        mesh.for_each(0.0, |f| {
            f.iter().for_each(|p| ends = [ends[0].min(p[0]), ends[1].max(p[0])]);
        });
        assert_eq!(ends[1], HOOK_LENGTH_MM);
        assert!((ends[0] + 0.25).abs() < 1e-9, "the shaft's radius on the other side");
    }
}
