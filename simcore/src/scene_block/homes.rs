//! Where the nodes of a scene's tissue lay at the start: what is drawn on it stays with it by that.

use crate::world::World;
use nalgebra::Vector3;
use protocol::scene::{FAR_FROM_EDGE_MM, SceneHome};
use std::f64::consts::PI;
use tissue::sheet::mesh::SheetMesh;

/// Of every node, in the order of the scene's nodes: the membrane's, those of the retina under a
/// bonded membrane, those of a retina of its own.
pub(super) fn homes(world: &World) -> Vec<SceneHome> {
    let (sheet, radius_mm) = (world.sheet(), world.scene().eye.retina_radius_mm as f32);
    let starts = || (0..sheet.nodes()).map(|n| sheet.start_position(n));
    let membrane = starts().zip(from_edge_mm(sheet));
    let under = starts().map(|p| (p * (radius_mm / p.norm().max(f32::MIN_POSITIVE)), FAR_FROM_EDGE_MM));
    let under = under.take(if world.adhesion().is_some() { sheet.nodes() } else { 0 });
    let retina = world.retina().map_or(&[][..], |r| &r.home_mm).iter().map(|p| (*p, FAR_FROM_EDGE_MM));
    let all = membrane.chain(under).chain(retina).enumerate();
    all.map(|(n, (p, from_edge_mm))| SceneHome { position_mm: p.into(), node: n as u32, from_edge_mm })
        .collect()
}

/// Way of each node to the sheet's edge, mm. It is that of an endless straight edge from which as much
/// would come: ∫ ds/r² along the edge, which is π/d at the distance d from a line. So it is right beside
/// a side, less in a corner, and has no crease between two sides.
fn from_edge_mm(sheet: &SheetMesh) -> Vec<f32> {
    let at = |n: usize| sheet.start_position(n).map(f64::from);
    let edges: Vec<[Vector3<f64>; 2]> = sheet.edges().map(|ends| ends.map(|n| at(n as usize))).collect();
    let way = |p: Vector3<f64>| PI / edges.iter().map(|&e| nearness(p, e)).sum::<f64>();
    (0..sheet.nodes()).map(|n| (way(at(n)) as f32).min(FAR_FROM_EDGE_MM)).collect()
}

/// ∫ ds/r² along the piece of a line between `a` and `b`, seen from `p`.
fn nearness(p: Vector3<f64>, [a, b]: [Vector3<f64>; 2]) -> f64 {
    const LEAST_MM: f64 = 1e-3;
    let length = (b - a).norm().max(LEAST_MM);
    let along = (b - a) / length;
    let from = (a - p).dot(&along);
    let away = ((p - a).norm_squared() - from * from).max(LEAST_MM * LEAST_MM).sqrt();
    (libm::atan2(from + length, away) - libm::atan2(from, away)) / away
}

#[cfg(test)]
mod tests {
    use super::*;
    use scene::SceneFile;

    #[test]
    fn every_node_has_its_home_and_a_membranes_edge_is_where_it_was_cut_out() {
        let scene = SceneFile::load("peel").unwrap();
        let size_mm = scene.membrane.as_ref().unwrap().size_mm;
        let world = World::new(&scene).unwrap();
        let homes = homes(&world);
        assert!(homes.iter().enumerate().all(|(i, h)| h.node as usize == i));
        for home in &homes[..world.sheet().nodes()] {
            let [x, y, _] = home.position_mm.map(f64::from);
            let inside = (size_mm[0] / 2.0 - x.abs()).min(size_mm[1] / 2.0 - y.abs());
            // Along the sphere it is a little farther.
            // It is less in the corners and near the far sides, never more.
            let way = f64::from(home.from_edge_mm);
            assert!(way < inside + 0.05 && way > 0.25 * inside - 0.05, "{home:?}: {inside}");
        }
    }

    #[test]
    fn beside_a_long_edge_it_is_the_distance_and_less_in_a_corner() {
        let (x, y) = (Vector3::x() * 1e3, Vector3::y() * 1e3);
        let way = |edges: &[[Vector3<f64>; 2]], p: Vector3<f64>| {
            PI / edges.iter().map(|&e| nearness(p, e)).sum::<f64>()
        };
        for d in [0.01, 0.4, 3.0] {
            let (line, p) = ([-x, x], Vector3::new(0.0, d, 0.0));
            assert!((way(&[line], p) / d - 1.0).abs() < 2e-3);
            let pieces = [[-x, Vector3::zeros()], [Vector3::zeros(), x]];
            assert!((way(&pieces, p) / d - 1.0).abs() < 2e-3, "in however many pieces");
            let corner = [[Vector3::zeros(), x], [Vector3::zeros(), y]];
            assert!(way(&corner, Vector3::new(d, d, 0.0)) < 0.7 * d);
        }
    }
}
