//! What a camera sees of the markers: discs that shafts and nearer markers hide in part, merged where
//! they are of one colour and touch, with noise that falls with the root of the area.

use super::motion::{Motion, Placed};
use nalgebra::{Point3, Vector2, Vector3};
use protocol::blobs::{Blob, BlobField, Colour, WHOLE_FRAME, field_line};
use protocol::limits::BODIES;
use protocol::poses::BODY_NAMES;
use protocol::random::Random;
use rig::camera::Camera;
use rig::{BodyType, Rig};
use std::f64::consts::PI;

/// Standard deviation of a column and of a frame's line for an area of 1 px of the field, px.
const NOISE_PX: [f64; 2] = [0.61, 1.23];
/// Noise of a blob's centre.
#[derive(Debug, Clone, Copy, PartialEq)]
pub(super) struct Noise {
    /// Standard deviations of a column and of a frame's line, px: for an area of 1 px of the field if it falls with
    /// the root of the area, else for every area.
    pub px: [f64; 2],
    pub falls: bool,
}

impl Noise {
    /// That of the blobs that are drawn here.
    pub const DRAWN: Noise = Noise { px: NOISE_PX, falls: true };

    /// Standard deviations of a column and a frame's line of a blob, px.
    pub fn sigma_px(&self, area_px: f64) -> Vector2<f64> {
        Vector2::from(self.px) / if self.falls { libm::sqrt(area_px.max(1.0)) } else { 1.0 }
    }
}

/// Relative noise of an area.
const AREA_NOISE: f64 = 0.012;
/// Points of a disc by which hidden parts are found.
const POINTS: usize = 160;
/// Share of a disc below which nothing is found of it.
const LEAST_SEEN: f64 = 0.12;

/// Image of a marker.
pub(super) struct Disc {
    pub body: usize,
    pub marker: usize,
    pub centre: Vector2<f64>,
    /// Half axes, px of the frame.
    pub radii: Vector2<f64>,
    depth: f64,
    pub colour: Colour,
}

/// Image of a shaft.
pub(super) struct Shaft {
    body: usize,
    from: Vector2<f64>,
    along: Vector2<f64>,
    length: f64,
    /// Half width and depth at both ends.
    half: [f64; 2],
    depth: [f64; 2],
}

impl Disc {
    /// True if it hides a point of another disc.
    fn hides(&self, p: &Vector2<f64>, depth: f64) -> bool {
        self.depth < depth && (p - self.centre).component_div(&self.radii).norm_squared() < 1.0
    }
}

impl Shaft {
    fn hides(&self, p: &Vector2<f64>, depth: f64) -> bool {
        let off = p - self.from;
        let along = off.dot(&self.along);
        if !(0.0..self.length).contains(&along) {
            return false;
        }
        let share = along / self.length;
        let mix = |ends: &[f64; 2]| ends[0] + (ends[1] - ends[0]) * share;
        mix(&self.depth) < depth && off.perp(&self.along).abs() < mix(&self.half)
    }
}

/// A blob without place: two thirds of its box's width high in lines of the field.
pub(super) fn blob(colour: Colour, area_px: f64, width_px: f64) -> Blob {
    Blob {
        area_px,
        width_px,
        height_px: 0.546 * width_px,
        var_x_px2: protocol::blobs::DEFAULT_VARIANCE_PX2,
        var_y_px2: protocol::blobs::DEFAULT_VARIANCE_PX2,
        colour: colour as u32,
        ..bytemuck::Zeroable::zeroed()
    }
}

/// What there is to see: everything at the instant of a field, and when its lines are exposed.
pub(super) struct Scene<'a> {
    pub motion: &'a Motion,
    pub t_s: f64,
    /// By how much a line of the frame is exposed later than the one above it, s.
    pub row_s: f64,
}

impl Scene<'_> {
    /// Everything when line `y_px` of a frame of `height_px` lines is exposed.
    fn at_line(&self, y_px: f64, height_px: u32) -> Placed {
        self.motion.at(self.t_s + (y_px - 0.5 * f64::from(height_px)) * self.row_s)
    }

    /// A point of a body, at `p` at the field's instant, when the line that shows it is exposed.
    fn when_seen(
        &self,
        camera: &Camera,
        body: usize,
        in_body: Point3<f64>,
        mut p: Point3<f64>,
    ) -> Option<Point3<f64>> {
        // Each round is nearer by the speed of the image in lines over that of the read-out, some hundredths.
        for _ in 0..if self.row_s == 0.0 { 0 } else { 4 } {
            let line = camera.project(&p)?.y;
            p = self.at_line(line, camera.size_px[1]).bodies[body] * in_body;
        }
        Some(p)
    }
}

/// What a field shows.
pub(super) struct Seen {
    /// Sets of markers that have a blob, by body.
    pub markers: [u32; BODIES],
    /// Markers of each blob that is of more than one.
    pub merged: Vec<Vec<Part>>,
}

/// A marker's part of a blob.
#[derive(Debug, Clone, Copy, PartialEq)]
pub(super) struct Part {
    pub body: usize,
    pub marker: usize,
    /// What is seen of it, px of the field.
    pub area_px: f64,
}

/// A blob before noise.
#[derive(Debug, Clone)]
pub(super) struct Spot {
    pub centre: Vector2<f64>,
    /// px of the field.
    pub area_px: f64,
    /// Of its box, px of the frame.
    pub size: Vector2<f64>,
    pub colour: Colour,
    pub parts: Vec<Part>,
}

/// Adds the blobs of all markers.
pub(super) fn see(
    rig: &Rig,
    camera: &Camera,
    scene: &Scene<'_>,
    field: &mut BlobField,
    random: &mut Random,
) -> Seen {
    let mut markers = [0; BODIES];
    let (discs, shafts) = images(rig, camera, scene);
    let mut spots: Vec<Spot> = Vec::new();
    for (i, disc) in discs.iter().enumerate() {
        let (mut sum, mut seen) = (Vector2::zeros(), 0);
        let mut low = Vector2::repeat(f64::MAX);
        let mut high = Vector2::repeat(f64::MIN);
        for k in 0..POINTS {
            // A spiral of equal areas (Vogel 1979).
            let r = libm::sqrt((k as f64 + 0.5) / POINTS as f64);
            let (s, c) = libm::sincos(2.399_963_229_728_653 * k as f64);
            let p = disc.centre + disc.radii.component_mul(&Vector2::new(r * c, r * s));
            let by_disc =
                |(j, o): (usize, &Disc)| j != i && o.colour != disc.colour && o.hides(&p, disc.depth);
            let hidden = discs.iter().enumerate().any(by_disc)
                || shafts.iter().any(|s| s.body != disc.body && s.hides(&p, disc.depth));
            if !hidden {
                (sum, seen) = (sum + p, seen + 1);
                (low, high) = (low.inf(&p), high.sup(&p));
            }
        }
        let share = f64::from(seen) / POINTS as f64;
        let inside =
            disc.centre.iter().zip(camera.size_px).all(|(v, n)| (2.0..f64::from(n) - 2.0).contains(v));
        if share > LEAST_SEEN && inside {
            let centre = if seen as usize == POINTS { disc.centre } else { sum / f64::from(seen) };
            let size = if seen as usize == POINTS { disc.radii * 2.0 } else { high - low };
            markers[disc.body] |= 1 << disc.marker;
            let area_px = share * 0.5 * PI * disc.radii.x * disc.radii.y;
            let parts = vec![Part { body: disc.body, marker: disc.marker, area_px }];
            spots.push(Spot { centre, area_px, size, colour: disc.colour, parts });
        }
    }
    merge(&mut spots);
    // A whole frame has twice the lines of a field.
    let whole = if field.parity == WHOLE_FRAME { 2.0 } else { 1.0 };
    for Spot { centre, area_px, size, colour, .. } in &spots {
        let noise = NOISE_PX.map(|n| n * random.normal() / libm::sqrt(area_px.max(1.0)));
        field.push(Blob {
            x_px: centre.x + noise[0],
            y_field_px: field_line(centre.y + noise[1], field.parity),
            height_px: 0.5 * whole * size.y,
            ..blob(*colour, whole * area_px * (1.0 + AREA_NOISE * random.normal()), size.x)
        });
    }
    let merged = spots.into_iter().map(|spot| spot.parts).filter(|parts| parts.len() > 1).collect();
    Seen { markers, merged }
}

/// Discs of one colour that touch become one.
pub(super) fn merge(spots: &mut Vec<Spot>) {
    let mut i = 0;
    while i < spots.len() {
        let touching = (i + 1..spots.len()).find(|&j| {
            let (a, b) = (&spots[i], &spots[j]);
            a.colour == b.colour
                && (a.centre - b.centre).component_div(&((a.size + b.size) * 0.5)).norm() < 1.0
        });
        let Some(j) = touching else {
            i += 1;
            continue;
        };
        let b = spots.remove(j);
        let a = &mut spots[i];
        let area_px = a.area_px + b.area_px;
        a.size = (a.centre - b.centre).abs() + (a.size + b.size) * 0.5;
        a.centre = (a.centre * a.area_px + b.centre * b.area_px) / area_px;
        a.area_px = area_px;
        a.parts.extend(b.parts);
    }
}

/// Images of all markers and shafts.
pub(super) fn images(rig: &Rig, camera: &Camera, scene: &Scene<'_>) -> (Vec<Disc>, Vec<Shaft>) {
    let placed = scene.motion.at(scene.t_s);
    let (mut discs, mut shafts) = (Vec::new(), Vec::new());
    for (body, name) in BODY_NAMES.iter().enumerate() {
        let Some(own) = rig.body(name) else { continue };
        let pose = &placed.bodies[body];
        for (index, marker) in own.markers.iter().enumerate() {
            let in_body = Point3::from(Vector3::from(marker.p));
            let Some(p) = scene.when_seen(camera, body, in_body, pose * in_body) else { continue };
            let Some(centre) = camera.project(&p) else { continue };
            let depth = camera.in_camera(&p).z;
            discs.push(Disc {
                body,
                marker: index,
                centre,
                radii: camera.focal_px * (marker.r / depth),
                depth,
                colour: marker.colour,
            });
        }
        if own.kind == BodyType::Instrument {
            shafts.extend(shaft(camera, pose, own.shaft_r.unwrap_or(0.25), body));
        }
    }
    (discs, shafts)
}

fn shaft(camera: &Camera, pose: &nalgebra::Isometry3<f64>, radius: f64, body: usize) -> Option<Shaft> {
    // As much of it as lies in the eye.
    let ends = [0.0, 22.0].map(|z| pose * Point3::new(0.0, 0.0, z));
    let pixels = [camera.project(&ends[0])?, camera.project(&ends[1])?];
    let depth = ends.map(|p| camera.in_camera(&p).z);
    let between = pixels[1] - pixels[0];
    Some(Shaft {
        body,
        from: pixels[0],
        along: between.try_normalize(1e-6)?,
        length: between.norm(),
        half: depth.map(|d| camera.focal_px.y * radius / d),
        depth,
    })
}
