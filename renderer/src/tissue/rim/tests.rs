//! Rims over a lattice as wide as the mesh of the simulation, measured.

use super::*;

const RADIUS_MM: f32 = 11.5;
const PITCH_MM: f32 = 0.65;
/// Nodes along and across the tests' lattice.
const ACROSS: i32 = 15;

/// Flat coordinates of the lattice's nodes, mm: triangles of equal sides.
fn flat(node: u32) -> Vec2 {
    let (i, j) = (node as i32 % ACROSS - ACROSS / 2, node as i32 / ACROSS - ACROSS / 2);
    Vec2::new(i as f32 + 0.5 * j as f32, j as f32 * 0.75f32.sqrt()) * PITCH_MM
}

/// Where a node at these coordinates is, `height` over the choroid.
fn lifted(at: Vec2, height: f32) -> Vec3 {
    Vec3::new(at.x, at.y, -RADIUS_MM).normalize() * (RADIUS_MM - height)
}

fn lattice() -> Vec<[u32; 3]> {
    let n = ACROSS as u32;
    let square = |(i, j)| {
        let a: u32 = j * n + i;
        [[a, a + 1, a + n], [a + 1, a + n + 1, a + n]]
    };
    (0..n - 1).flat_map(|j| (0..n - 1).map(move |i| (i, j))).flat_map(square).collect()
}

/// A drawn corner: where it is on the retina, mm, and its height.
type Corner = (Vec2, f32);

/// What is drawn of retina whose nodes are off where `off` says so, `height` high.
fn drawn(off: impl Fn(Vec2) -> bool, height: impl Fn(Vec2) -> f32) -> Vec<[Corner; 3]> {
    sheet(off, height, true)
}

/// The same, or the mesh as it was sent.
fn sheet(off: impl Fn(Vec2) -> bool, height: impl Fn(Vec2) -> f32, rounded: bool) -> Vec<[Corner; 3]> {
    let all = lattice();
    let count = (ACROSS * ACROSS) as usize;
    let is_loose = |t: &[u32; 3]| t.iter().any(|&n| off(flat(n)));
    let loose: Vec<_> = all.iter().copied().filter(is_loose).collect();
    let beside = |t: &[u32; 3]| t.iter().any(|n| loose.iter().flatten().any(|m| n == m));
    let lying: Vec<_> = all.iter().copied().filter(|t| !is_loose(t) && beside(t)).collect();
    let (mut rim, mut triangles) = (Rim::default(), Vec::new());
    if rounded {
        rim.divide(count, &loose, &lying, &mut triangles);
    } else {
        triangles.clone_from(&loose);
    }
    let vertex = |n: u32| {
        let at = flat(n);
        let h = if off(at) { height(at) } else { 0.0 };
        TissueVertex { position: lifted(at, h).to_array(), normal: [0.0; 3], more: [0.0; 2] }
    };
    let mut vertices: Vec<_> = (0..count as u32).map(vertex).collect();
    rim.place(&mut vertices, |_| false);
    assert_eq!(vertices.len(), count + rim.middles.len());
    let corner = |n: u32| {
        let p = Vec3::from(vertices[n as usize].position);
        (p.truncate() * (RADIUS_MM / -p.z), RADIUS_MM - p.length())
    };
    triangles.iter().map(|t| t.map(corner)).collect()
}

/// Height of what is drawn at `at`; 0 where it is the fundus.
fn height_at(drawn: &[[Corner; 3]], at: Vec2) -> f32 {
    let inside = |[a, b, c]: &[Corner; 3]| {
        let whole = (b.0 - a.0).perp_dot(c.0 - a.0);
        let [u, v] = [(at - a.0).perp_dot(c.0 - a.0) / whole, (b.0 - a.0).perp_dot(at - a.0) / whole];
        (u > -1e-4 && v > -1e-4 && u + v < 1.0 + 1e-4).then_some(a.1 + u * (b.1 - a.1) + v * (c.1 - a.1))
    };
    drawn.iter().find_map(inside).unwrap_or(0.0)
}

fn dome(at: Vec2) -> f32 {
    (1.2 * (1.0 - at.length_squared() / 4.0)).max(0.0)
}

/// How far the line at which the sheet is `level` high strays from a circle, root of the mean square,
/// mm, and the sharpest bend in it (rad), over steps of a fifth of a millimetre.
fn line_at(drawn: &[[Corner; 3]], level: f32) -> (f32, f32) {
    const STEPS: usize = 64;
    let way = |k: usize| Vec2::from_angle(k as f32 * std::f32::consts::TAU / STEPS as f32);
    let outermost = |k: usize| {
        let mut r = 3.2;
        while height_at(drawn, way(k) * r) < level {
            r -= 0.004;
        }
        r
    };
    let line: Vec<f32> = (0..STEPS).map(outermost).collect();
    let mean = line.iter().sum::<f32>() / STEPS as f32;
    let strays = (line.iter().map(|r| (r - mean).powi(2)).sum::<f32>() / STEPS as f32).sqrt();
    let at = |k: usize| way(k % STEPS) * line[k % STEPS];
    let bend = |k: usize| (at(k + 1) - at(k)).angle_to(at(k + 2) - at(k + 1)).abs();
    (strays, (0..STEPS).map(bend).fold(0.0, f32::max))
}

#[test]
fn the_rim_of_a_bleb_is_round() {
    let off = |at: Vec2| at.length() < 2.0;
    let [mesh, rounded] = [false, true].map(|rounded| line_at(&sheet(off, dome, rounded), 0.05));
    println!("strays by {} mm, bends by {} rad; the mesh by {} and {}", rounded.0, rounded.1, mesh.0, mesh.1);
    assert!(rounded.0 < 0.6 * mesh.0 && rounded.1 < 0.6 * mesh.1, "{rounded:?}, the mesh {mesh:?}");
}

#[test]
fn little_moves_when_nodes_are_released() {
    let released = |r: f32| move |at: Vec2| at.length() < r;
    let (before, after) = (
        drawn(released(1.6), dome),
        drawn(released(2.3), |at| if at.length() < 1.6 { dome(at) } else { 0.0 }),
    );
    assert_ne!(before.len(), after.len());
    for (i, j) in (-20..=20).flat_map(|i| (-20..=20).map(move |j| (i, j))) {
        let at = Vec2::new(i as f32, j as f32) * 0.15;
        let moved = (height_at(&before, at) - height_at(&after, at)).abs();
        assert!(moved < 0.01, "{moved} mm at {at}");
    }
}

#[test]
fn retina_that_lies_stays_on_the_choroid_and_a_flat_one_on_its_sphere() {
    let flat = drawn(|at| at.length() < 1.5, |_| 0.0);
    assert!(flat.iter().flatten().all(|c| c.1.abs() < 1e-5));
    let high = drawn(|at| at.length() < 1.5, |_| 1.0);
    assert!(high.iter().flatten().all(|c| (-1e-5..1.0 + 1e-5).contains(&c.1)));
    assert!(high.iter().flatten().filter(|c| c.0.length() < 0.6).all(|c| c.1 > 0.99), "but for the rim");
}

#[test]
fn pieces_cover_their_triangle_without_gaps() {
    for sides in 0..8u32 {
        let middles = [0, 1, 2].map(|i| (sides & 1 << i != 0).then_some(3 + i));
        let corners = [Vec2::ZERO, Vec2::X, Vec2::Y];
        let at = |v: u32| match v {
            0..3 => corners[v as usize],
            _ => 0.5 * (corners[v as usize - 3] + corners[(v as usize - 2) % 3]),
        };
        let mut area = 0.0;
        pieces(&[0, 1, 2], middles, |[a, b, c]| {
            let piece = (at(b) - at(a)).perp_dot(at(c) - at(a));
            assert!(piece > 0.1, "{sides}: turned over or empty");
            area += piece;
        });
        assert!((area - 1.0f32).abs() < 1e-6, "{sides}: {area}");
    }
}
