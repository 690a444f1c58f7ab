//! Meshes of the cases: discs of rings and spheres made of an icosahedron.

use std::collections::BTreeMap;
use tissue::elements::Point;

/// A disc of `radius` in the plane z = 0: its middle, then `rings` rings of 6, 12, 18 … nodes; the
/// last ring is the rim. Triangles are counter-clockwise seen from +z.
pub fn disc(radius: f64, rings: u32) -> (Vec<Point>, Vec<[u32; 3]>) {
    let first = |ring: u32| if ring == 0 { 0 } else { 1 + 3 * ring * (ring - 1) };
    let node = |ring: u32, k: u32| if ring == 0 { 0 } else { first(ring) + k % (6 * ring) };
    let mut nodes = vec![Point::zeros()];
    let mut triangles = Vec::new();
    for ring in 1..=rings {
        for k in 0..6 * ring {
            let angle = std::f64::consts::TAU * f64::from(k) / f64::from(6 * ring);
            let r = radius * f64::from(ring) / f64::from(rings);
            nodes.push(Point::new(r * libm::cos(angle), r * libm::sin(angle), 0.0));
        }
        for sector in 0..6 {
            for k in 0..ring {
                let (inner, outer) = (sector * (ring - 1) + k, sector * ring + k);
                triangles.push([node(ring, outer), node(ring, outer + 1), node(ring - 1, inner)]);
                if k + 1 < ring {
                    triangles.push([node(ring - 1, inner), node(ring, outer + 1), node(ring - 1, inner + 1)]);
                }
            }
        }
    }
    (nodes, triangles)
}

/// Nodes of the rim of [`disc`].
pub fn is_rim(node: usize, rings: u32) -> bool {
    node as u32 > 3 * rings * (rings - 1)
}

/// Share of each node in the area, mm².
pub fn areas(nodes: &[Point], triangles: &[[u32; 3]]) -> Vec<f64> {
    let mut areas = vec![0.0; nodes.len()];
    for t in triangles {
        let [a, b, c] = t.map(|n| nodes[n as usize]);
        t.iter().for_each(|&n| areas[n as usize] += (b - a).cross(&(c - a)).norm() / 6.0);
    }
    areas
}

/// A sphere of radius 1 mm: an icosahedron whose triangles were cut into four `times` times, seen
/// from outside.
pub fn sphere(times: u32) -> (Vec<Point>, Vec<[u32; 3]>) {
    let g = 0.5 * (1.0 + libm::sqrt(5.0));
    let corners = [(-1.0, g), (1.0, g), (-1.0, -g), (1.0, -g)];
    let mut nodes: Vec<Point> = Vec::new();
    nodes.extend(corners.map(|(a, b)| Point::new(a, b, 0.0).normalize()));
    nodes.extend(corners.map(|(a, b)| Point::new(0.0, a, b).normalize()));
    nodes.extend(corners.map(|(a, b)| Point::new(b, 0.0, a).normalize()));
    let edge = nodes[0].metric_distance(&nodes[1]) * 1.01;
    let mut triangles = Vec::new();
    for (a, b, c) in (0..12).flat_map(|a| (a + 1..12).flat_map(move |b| (b + 1..12).map(move |c| (a, b, c))))
    {
        let [p, q, r] = [a, b, c].map(|n: usize| nodes[n]);
        if (p - q).norm() < edge && (q - r).norm() < edge && (r - p).norm() < edge {
            let outward = (q - p).cross(&(r - p)).dot(&p) > 0.0;
            triangles.push(if outward { [a, b, c] } else { [a, c, b] }.map(|n| n as u32));
        }
    }
    for _ in 0..times {
        (nodes, triangles) = cut(nodes, &triangles);
    }
    (nodes, triangles)
}

fn cut(mut nodes: Vec<Point>, triangles: &[[u32; 3]]) -> (Vec<Point>, Vec<[u32; 3]>) {
    let mut middles = BTreeMap::new();
    let mut middle = |a: u32, b: u32| {
        *middles.entry([a.min(b), a.max(b)]).or_insert_with(|| {
            nodes.push((nodes[a as usize] + nodes[b as usize]).normalize());
            nodes.len() as u32 - 1
        })
    };
    let mut finer = Vec::new();
    for &[a, b, c] in triangles {
        let (ab, bc, ca) = (middle(a, b), middle(b, c), middle(c, a));
        finer.extend([[a, ab, ca], [ab, b, bc], [ca, bc, c], [ab, bc, ca]]);
    }
    (nodes, finer)
}
