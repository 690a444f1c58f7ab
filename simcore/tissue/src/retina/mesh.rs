//! The whole retina as a triangle mesh on the rear hemisphere: rings around the fovea, ring k with
//! 6k nodes.
//!
//! Ring k of n lies at the polar angle π/2·k/n from −z. Near the fovea, where surgery happens,
//! triangles are nearly equilateral (sides within 10 %); towards the equator they narrow to two
//! thirds. Of n rings there are 1 + 3n(n + 1) nodes and 6n² triangles; the last ring is the ora
//! serrata, where the retina ends and always holds.

use nalgebra::Vector3;

/// Nodes of ring `k` begin here.
fn first(k: usize) -> usize {
    if k == 0 { 0 } else { 1 + 3 * k * (k - 1) }
}

/// Node `j` of ring `k`, counted around.
fn node(k: usize, j: usize) -> u32 {
    let around = if k == 0 { 0 } else { j % (6 * k) };
    (first(k) + around) as u32
}

/// Nodes of a mesh of `rings` rings.
pub fn nodes(rings: u32) -> usize {
    first(rings as usize + 1)
}

/// Triangles of a mesh of `rings` rings.
pub fn triangles(rings: u32) -> usize {
    6 * (rings as usize).pow(2)
}

/// Positions (eye frame, mm) and triangles (counter-clockwise seen from the inside of the eye).
pub fn hemisphere(radius_mm: f64, rings: u32) -> (Vec<[f32; 3]>, Vec<[u32; 3]>) {
    let n = rings as usize;
    let mut positions = Vec::with_capacity(nodes(rings));
    for k in 0..=n {
        let polar = std::f64::consts::FRAC_PI_2 * k as f64 / n as f64;
        for j in 0..(6 * k).max(1) {
            let azimuth = std::f64::consts::TAU * j as f64 / (6 * k).max(1) as f64;
            let (out, down) = (libm::sin(polar), libm::cos(polar));
            let p = Vector3::new(out * libm::cos(azimuth), out * libm::sin(azimuth), -down) * radius_mm;
            positions.push(p.map(|c| c as f32).into());
        }
    }
    let mut triangles = Vec::with_capacity(self::triangles(rings));
    for k in 0..n {
        for sector in 0..6 {
            let (inner, outer) = (sector * k, sector * (k + 1));
            for i in 0..=k {
                triangles.push([node(k, inner + i), node(k + 1, outer + i), node(k + 1, outer + i + 1)]);
            }
            for i in 0..k {
                triangles.push([node(k, inner + i), node(k + 1, outer + i + 1), node(k, inner + i + 1)]);
            }
        }
    }
    (positions, triangles)
}

/// The nodes of the last ring.
pub fn ora(rings: u32) -> Vec<u32> {
    (first(rings as usize)..nodes(rings)).map(|n| n as u32).collect()
}

#[cfg(test)]
mod tests {
    use super::*;
    use std::collections::HashMap;

    fn at(p: &[[f32; 3]], n: u32) -> Vector3<f64> {
        Vector3::from(p[n as usize]).map(f64::from)
    }

    #[test]
    fn counts_follow_the_formulas_and_the_mesh_is_a_disc() {
        for rings in [1, 2, 5, 28] {
            let (p, t) = hemisphere(11.5, rings);
            assert_eq!((p.len(), t.len()), (nodes(rings), triangles(rings)));
            let mut edges: HashMap<[u32; 2], u32> = HashMap::new();
            for [a, b, c] in &t {
                for (x, y) in [(a, b), (b, c), (c, a)] {
                    *edges.entry([*x.min(y), *x.max(y)]).or_default() += 1;
                }
            }
            assert!(edges.values().all(|&n| n == 1 || n == 2), "manifold");
            let rim = edges.iter().filter(|(_, n)| **n == 1).map(|(e, _)| e);
            let ora = ora(rings);
            assert!(rim.into_iter().all(|e| e.iter().all(|n| ora.contains(n))), "its only rim is the ora");
            let euler = nodes(rings) as i64 - edges.len() as i64 + t.len() as i64;
            assert_eq!(euler, 1, "a disc");
        }
    }

    #[test]
    fn area_approaches_that_of_the_hemisphere_with_the_square_of_the_mesh_width() {
        let exact = std::f64::consts::TAU * 11.5 * 11.5;
        let error = |rings| {
            let (p, t) = hemisphere(11.5, rings);
            let area = |[a, b, c]: &[u32; 3]| {
                let normal = (at(&p, *b) - at(&p, *a)).cross(&(at(&p, *c) - at(&p, *a)));
                assert!(normal.dot(&at(&p, *a)) < 0.0, "faces the inside");
                0.5 * normal.norm()
            };
            1.0 - t.iter().map(area).sum::<f64>() / exact
        };
        let (coarse, fine) = (error(10), error(20));
        assert!(coarse > 0.0 && (3.8..4.2).contains(&(coarse / fine)), "{coarse} {fine}");
    }

    #[test]
    fn triangles_near_the_fovea_are_well_shaped() {
        let (p, t) = hemisphere(11.5, 28);
        // Nodes of a ring lie π/3 ring spacings apart; the longest side crosses one such cell.
        let longest = (1.0 + std::f64::consts::FRAC_PI_3.powi(2)).sqrt();
        let near = |t: &&[u32; 3]| t.iter().all(|&n| at(&p, n).z < -11.5 * 0.9);
        for [a, b, c] in t.iter().filter(near) {
            let mut sides = [(a, b), (b, c), (c, a)].map(|(x, y)| (at(&p, *x) - at(&p, *y)).norm());
            sides.sort_by(f64::total_cmp);
            assert!(sides[2] / sides[0] < longest, "{sides:?}");
        }
    }
}
