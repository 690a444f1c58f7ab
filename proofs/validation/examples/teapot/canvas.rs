//! A small renderer for the picture: perspective, a z-buffer, light from one side, lines with a
//! width; four samples a pixel.

use image::{Rgb, RgbImage};
use nalgebra::{Isometry3, Matrix4, Perspective3, Point3, Vector3};

/// Samples along each side of a pixel.
const FINE: u32 = 2;
/// Lines are drawn so much nearer than they are (share of depth), so that they lie on what they
/// touch.
const LINE_BIAS: f64 = 2e-4;

/// A colour, linear.
pub type Colour = Vector3<f64>;

/// A picture in the making.
pub struct Canvas {
    width: u32,
    height: u32,
    colour: Vec<Colour>,
    depth: Vec<f64>,
    clip_from_world: Matrix4<f64>,
    eye: Point3<f64>,
}

/// Corner of a triangle: place and normal.
pub type Corner = (Point3<f64>, Vector3<f64>);

impl Canvas {
    /// A picture of `width` × `height` pixels, seen from `eye` towards `target`, +z up, `angle_rad`
    /// high.
    pub fn new(width: u32, height: u32, eye: Point3<f64>, target: Point3<f64>, angle_rad: f64) -> Self {
        let (width, height) = (width * FINE, height * FINE);
        let view = Isometry3::look_at_rh(&eye, &target, &Vector3::z());
        let lens = Perspective3::new(f64::from(width) / f64::from(height), angle_rad, 0.5, 50.0);
        let pixels = (width * height) as usize;
        let row = |y: u32| {
            let t = f64::from(y) / f64::from(height);
            Colour::new(0.93, 0.945, 0.96) * (1.0 - 0.25 * t)
        };
        Canvas {
            colour: (0..pixels as u32).map(|i| row(i / width)).collect(),
            depth: vec![f64::INFINITY; pixels],
            clip_from_world: lens.as_matrix() * view.to_homogeneous(),
            width,
            height,
            eye,
        }
    }

    /// Sample coordinates and depth.
    fn project(&self, p: &Point3<f64>) -> Option<Vector3<f64>> {
        let clip = self.clip_from_world * p.to_homogeneous();
        let ndc = Point3::from_homogeneous(clip).filter(|_| clip.w > 0.0)?;
        let x = (ndc.x * 0.5 + 0.5) * f64::from(self.width);
        let y = (0.5 - ndc.y * 0.5) * f64::from(self.height);
        Some(Vector3::new(x, y, ndc.z))
    }

    /// Light that a surface of this colour sends to the eye: a lamp, the sky, a highlight.
    fn shade(&self, p: &Point3<f64>, normal: &Vector3<f64>, colour: &Colour, gloss: f64) -> Colour {
        let lamp = Vector3::new(-0.55, -0.35, 0.75).normalize();
        let to_eye = (self.eye - p).normalize();
        let n = normal.normalize();
        let n = if n.dot(&to_eye) < 0.0 { -n } else { n };
        let diffuse = n.dot(&lamp).max(0.0);
        let sky = 0.5 + 0.5 * n.z;
        let shine = n.dot(&(lamp + to_eye).normalize()).max(0.0).powi(40);
        colour * (0.8 * diffuse + 0.3 * sky + 0.04) + Colour::repeat(gloss * shine)
    }

    /// Draws a triangle.
    pub fn triangle(&mut self, corners: [Corner; 3], colour: &Colour, gloss: f64) {
        let [Some(a), Some(b), Some(c)] = corners.map(|(p, _)| self.project(&p)) else { return };
        let cross = |p: &Vector3<f64>, q: &Vector3<f64>, x: f64, y: f64| {
            (q.x - p.x) * (y - p.y) - (q.y - p.y) * (x - p.x)
        };
        let area = cross(&a, &b, c.x, c.y);
        if area == 0.0 {
            return;
        }
        let span = |k: usize, end: u32| {
            let (low, high) = (a[k].min(b[k]).min(c[k]), a[k].max(b[k]).max(c[k]));
            (low.floor().max(0.0) as u32)..(high.ceil().clamp(0.0, f64::from(end)) as u32)
        };
        for y in span(1, self.height) {
            for x in span(0, self.width) {
                let (px, py) = (f64::from(x) + 0.5, f64::from(y) + 0.5);
                let w =
                    [cross(&b, &c, px, py), cross(&c, &a, px, py), cross(&a, &b, px, py)].map(|w| w / area);
                if w.iter().any(|w| *w < 0.0) {
                    continue;
                }
                let depth = w[0] * a.z + w[1] * b.z + w[2] * c.z;
                let sample = (y * self.width + x) as usize;
                if depth < self.depth[sample] {
                    let mix = |k: usize| (corners[k].0.coords * w[k], corners[k].1 * w[k]);
                    let [m0, m1, m2] = [mix(0), mix(1), mix(2)];
                    let p = Point3::from(m0.0 + m1.0 + m2.0);
                    self.depth[sample] = depth;
                    self.colour[sample] = self.shade(&p, &(m0.1 + m1.1 + m2.1), colour, gloss);
                }
            }
        }
    }

    /// Draws a line of `width` pixels.
    pub fn line(&mut self, from: &Point3<f64>, to: &Point3<f64>, width: f64, colour: &Colour) {
        let [Some(a), Some(b)] = [from, to].map(|p| self.project(p)) else { return };
        let way = b - a;
        let length = way.xy().norm().max(1e-9);
        let reach = width * f64::from(FINE) * 0.5;
        let span = |k: usize, end: u32| {
            let (low, high) = (a[k].min(b[k]) - reach, a[k].max(b[k]) + reach);
            (low.floor().max(0.0) as u32)..(high.ceil().clamp(0.0, f64::from(end)) as u32)
        };
        for y in span(1, self.height) {
            for x in span(0, self.width) {
                let d = nalgebra::Vector2::new(f64::from(x) + 0.5 - a.x, f64::from(y) + 0.5 - a.y);
                let t = (d.dot(&way.xy()) / (length * length)).clamp(0.0, 1.0);
                if (d - way.xy() * t).norm() > reach {
                    continue;
                }
                let depth = a.z + way.z * t - LINE_BIAS;
                let sample = (y * self.width + x) as usize;
                if depth < self.depth[sample] {
                    (self.depth[sample], self.colour[sample]) = (depth, *colour);
                }
            }
        }
    }

    /// The picture, samples averaged, as sRGB.
    pub fn finish(&self) -> RgbImage {
        let byte = |c: f64| (c.clamp(0.0, 1.0).powf(1.0 / 2.2) * 255.0).round() as u8;
        RgbImage::from_fn(self.width / FINE, self.height / FINE, |x, y| {
            let fine = (0..FINE).flat_map(|dy| (0..FINE).map(move |dx| (x * FINE + dx, y * FINE + dy)));
            let sum: Colour = fine.map(|(x, y)| self.colour[(y * self.width + x) as usize]).sum();
            let mean = sum / f64::from(FINE * FINE);
            Rgb([mean.x, mean.y, mean.z].map(byte))
        })
    }
}
