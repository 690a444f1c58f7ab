//! The paper's Fig. 7: the Utah teapot pressed into a plastic membrane, with the deformation
//! vectors.
//!
//! `cargo run --release -p validation --example teapot [PICTURE.png]`. The teapot is the instrument
//! of a ZCOLL camera; it comes down in small steps, and after each look the nodes are moved by
//! their vectors (Eq. 1) and stay there: plastic. On the left the teapot lies in the membrane, on
//! the right it is gone, and every sixth node shows the way it was pushed, from blue (0) to red.

mod canvas;

use anyhow::Context;
use canvas::{Canvas, Colour, Corner};
use collision::instrument_image::{InstrumentImage, Volume};
use collision::surface::Surface;
use collision::tool_mesh::{Facet, ToolMesh};
use collision::zcoll::Zcoll;
use nalgebra::{Isometry3, Point3, Vector3};

const TEAPOT: &str = include_str!("../../../../assets/meshes/teapot.obj");
/// mm in a unit of the mesh: the teapot becomes 3.2 mm long.
const SCALE: f64 = 0.1;
/// Squares of the membrane, and the side of one, mm.
const SQUARES: [usize; 2] = [230, 130];
const SIDE_MM: f64 = 0.018;
/// How deep the teapot is pressed in, mm, and by how much in each step.
const DEPTH_MM: f64 = 0.95;
const STEP_MM: f64 = 0.05;
/// One panel of the picture, px.
const PANEL: [u32; 2] = [760, 560];

/// Vertices, and the three of each triangle.
type Mesh = (Vec<Point3<f64>>, Vec<[usize; 3]>);

/// Vertices and triangles of the teapot, lying on its side, its lowest point at the origin's
/// height.
fn teapot() -> anyhow::Result<Mesh> {
    let (mut points, mut triangles) = (Vec::new(), Vec::new());
    for (number, line) in TEAPOT.lines().enumerate() {
        let words: Vec<&str> = line.split_whitespace().collect();
        let place = || format!("teapot.obj, line {}: {line}", number + 1);
        match words[..] {
            ["v", x, y, z] => {
                let number = |text: &str| text.parse::<f64>().with_context(place);
                points.push(Point3::new(number(x)?, number(y)?, number(z)?) * SCALE);
            }
            ["f", a, b, c] => {
                let index = |text: &str| {
                    let index = text.parse::<usize>().ok().filter(|i| (1..=points.len()).contains(i));
                    index.map(|i| i - 1).with_context(place)
                };
                triangles.push([index(a)?, index(b)?, index(c)?]);
            }
            _ => {}
        }
    }
    let lowest = points.iter().map(|p| p.z).fold(f64::INFINITY, f64::min);
    points.iter_mut().for_each(|p| p.z -= lowest);
    Ok((points, triangles))
}

/// A flat membrane around the origin.
struct Membrane {
    rest: Vec<Point3<f64>>,
    position_mm: [Vec<f32>; 3],
    triangles: Vec<[u32; 3]>,
}

impl Membrane {
    fn flat() -> Self {
        let [nx, ny] = SQUARES;
        let at = |i: usize, n: usize| (i as f64 - n as f64 * 0.5) * SIDE_MM;
        let rest: Vec<Point3<f64>> = (0..=ny)
            .flat_map(|row| (0..=nx).map(move |column| Point3::new(at(column, nx), at(row, ny), 0.0)))
            .collect();
        let node = |row: usize, column: usize| (row * (nx + 1) + column) as u32;
        let triangles = (0..ny)
            .flat_map(|r| (0..nx).map(move |c| (r, c)))
            .flat_map(|(r, c)| {
                let [a, b, d, e] = [node(r, c), node(r, c + 1), node(r + 1, c), node(r + 1, c + 1)];
                [[a, b, e], [a, e, d]]
            })
            .collect();
        let position_mm = [0, 1, 2].map(|k| rest.iter().map(|p| p[k] as f32).collect());
        Membrane { rest, position_mm, triangles }
    }

    fn point(&self, node: usize) -> Point3<f64> {
        Point3::from(self.position_mm.each_ref().map(|axis| f64::from(axis[node])))
    }
}

/// Presses the teapot in; where its lowest point is then.
fn press(membrane: &mut Membrane, facets: Vec<Facet>) -> anyhow::Result<f64> {
    let volume = Volume { half_mm: 2.1, near_mm: -0.25, depth_mm: 2.5, resolution: 256 };
    let mut image =
        InstrumentImage::of_mesh(ToolMesh { shaft: facets, jaw: Vec::new(), hook: Vec::new() }, &volume);
    image.prepare(0.0, &volume);
    let mut zcoll = Zcoll::new(volume, &membrane.triangles, membrane.rest.len())?;
    let alive = vec![1; membrane.triangles.len()];
    let steps = (DEPTH_MM / STEP_MM).round() as usize;
    for step in 1..=steps {
        let at = -STEP_MM * step as f64;
        let position_mm = membrane.position_mm.each_ref().map(Vec::as_slice);
        let surface = Surface { position_mm, triangles: &membrane.triangles, alive: &alive };
        let found = zcoll.query(&image, &Isometry3::translation(0.0, 0.0, -at), &surface);
        for (node, way) in zcoll.displaced() {
            membrane.position_mm[2][node] -= zcoll.volume().depth_steps_mm(way) as f32;
        }
        if step == steps {
            let Volume { resolution, .. } = volume;
            let nodes = zcoll.displaced().count();
            eprintln!(
                "last of {steps} looks at {resolution} × {resolution}: {} pixels, {} triangles, {nodes} nodes moved",
                found.pixels,
                zcoll.triangles().count()
            );
        }
    }
    Ok(-DEPTH_MM)
}

/// Draws triangles with normals averaged at the corners.
fn draw(
    canvas: &mut Canvas,
    points: &[Point3<f64>],
    triangles: impl Iterator<Item = [usize; 3]> + Clone,
    colour: &Colour,
    gloss: f64,
) {
    let mut normals = vec![Vector3::zeros(); points.len()];
    // Corners at one place are one corner: the teapot's patches share none.
    let mut first = std::collections::HashMap::new();
    let key = |p: &Point3<f64>| p.coords.map(f64::to_bits).data.0[0];
    let corner: Vec<usize> =
        points.iter().enumerate().map(|(i, p)| *first.entry(key(p)).or_insert(i)).collect();
    for t in triangles.clone() {
        let [a, b, c] = t.map(|i| points[i]);
        let normal = (b - a).cross(&(c - a));
        t.iter().for_each(|&i| normals[corner[i]] += normal);
    }
    for t in triangles {
        canvas.triangle(t.map(|i| -> Corner { (points[i], normals[corner[i]]) }), colour, gloss);
    }
}

/// Blue, green, yellow, red for 0 to 1.
fn scale(share: f64) -> Colour {
    let stops =
        [[0.05, 0.15, 0.7], [0.0, 0.5, 0.5], [0.85, 0.65, 0.05], [0.75, 0.03, 0.03]].map(Colour::from);
    let at = share.clamp(0.0, 1.0) * 3.0;
    let k = (at as usize).min(2);
    stops[k].lerp(&stops[k + 1], at - k as f64)
}

fn main() -> anyhow::Result<()> {
    let path = std::env::args().nth(1).unwrap_or_else(|| "teapot.png".into());
    let (points, triangles) = teapot()?;
    let facets = triangles.iter().map(|t| t.map(|i| points[i].coords.into())).collect();
    let mut membrane = Membrane::flat();
    let at_mm = press(&mut membrane, facets)?;
    let mut picture = image::RgbImage::new(2 * PANEL[0], PANEL[1]);
    let nodes: Vec<Point3<f64>> = (0..membrane.rest.len()).map(|n| membrane.point(n)).collect();
    for panel in 0..2 {
        let (eye, target) = (Point3::new(0.5, -3.9, 5.4), Point3::new(0.0, -0.05, -0.1));
        let mut canvas = Canvas::new(PANEL[0], PANEL[1], eye, target, 0.47);
        let sheet = membrane.triangles.iter().map(|t| t.map(|n| n as usize));
        draw(&mut canvas, &nodes, sheet, &Colour::new(0.72, 0.42, 0.36), 0.12);
        grid(&mut canvas, &nodes);
        if panel == 0 {
            let raised: Vec<_> = points.iter().map(|p| p + Vector3::z() * at_mm).collect();
            draw(&mut canvas, &raised, triangles.iter().copied(), &Colour::new(0.55, 0.6, 0.66), 0.5);
        } else {
            vectors(&mut canvas, &membrane, &nodes);
        }
        image::imageops::replace(&mut picture, &canvas.finish(), i64::from(panel * PANEL[0]), 0);
    }
    picture.save(&path).with_context(|| path.clone())?;
    eprintln!("wrote {path}");
    Ok(())
}

/// Every tenth line of the membrane.
fn grid(canvas: &mut Canvas, nodes: &[Point3<f64>]) {
    let across = SQUARES[0] + 1;
    for n in 0..nodes.len() {
        let (row, column) = (n / across, n % across);
        if column + 1 < across && row % 10 == 0 {
            canvas.line(&nodes[n], &nodes[n + 1], 0.7, &Colour::new(0.3, 0.12, 0.1));
        }
        if row < SQUARES[1] && column % 10 == 0 {
            canvas.line(&nodes[n], &nodes[n + across], 0.7, &Colour::new(0.3, 0.12, 0.1));
        }
    }
}

/// The way of every sixth node that was moved, by its length.
fn vectors(canvas: &mut Canvas, membrane: &Membrane, nodes: &[Point3<f64>]) {
    let across = SQUARES[0] + 1;
    for (n, (rest, now)) in membrane.rest.iter().zip(nodes).enumerate() {
        let way = (now - rest).norm();
        if (n / across).is_multiple_of(6) && (n % across).is_multiple_of(6) && way > 0.01 {
            canvas.line(rest, now, 1.6, &scale(way / DEPTH_MM));
        }
    }
}
