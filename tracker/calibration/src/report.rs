//! What a calibration found, for a person and for a program.

use crate::lens::{EXTRINSICS, LENS, LENS_NAMES, lens_of};
use crate::target_problem::{Residual, rms};
use nalgebra::Vector3;
use rig::camera::Camera;
use serde::Serialize;
use std::fmt;

/// A value with its standard deviation; 0 where it was held.
#[derive(Debug, Clone, Copy, PartialEq, Serialize)]
pub struct Value {
    /// The value.
    pub value: f64,
    /// Its standard deviation, same unit.
    pub sigma: f64,
}

/// A camera.
#[derive(Debug, Clone, Serialize)]
pub struct CameraReport {
    /// Id in the rig.
    pub id: u32,
    /// fx fy cx cy (px), k1 k2 p1 p2 k3.
    pub lens: Vec<(&'static str, Value)>,
    /// Centre of projection in the world, mm (the target's unit).
    pub centre_in_world_mm: [f64; 3],
    /// Standard deviations of the camera's place: rotation (mrad) and translation (mm).
    pub place_sigma: [f64; EXTRINSICS],
    /// Root mean square length of its residuals, px.
    pub rms_px: f64,
    /// Points that took part.
    pub points: usize,
}

/// A picture, list, or stretch of a stream.
#[derive(Debug, Clone, Serialize)]
pub struct ViewReport {
    /// Its name.
    pub name: String,
    /// Points that took part.
    pub points: usize,
    /// Root mean square length of the residuals, px.
    pub rms_px: f64,
    /// Longest residual, px.
    pub worst_px: f64,
}

/// A figure that only one kind of calibration has.
#[derive(Debug, Clone, Serialize)]
pub struct Figure {
    /// What it is.
    pub name: String,
    /// How much.
    pub value: f64,
    /// Its standard deviation, where there is one.
    #[serde(skip_serializing_if = "Option::is_none")]
    pub sigma: Option<f64>,
    /// Unit of both; empty for a plain number.
    pub unit: &'static str,
}

/// What was found.
#[derive(Debug, Clone, Default, Serialize)]
pub struct Report {
    /// Which calibration.
    pub task: &'static str,
    /// Root mean square length of all residuals, px.
    pub rms_px: f64,
    /// Standard deviation of one image coordinate, px.
    pub sigma_px: f64,
    /// Iterations of the last solve.
    pub iterations: usize,
    /// By camera.
    pub cameras: Vec<CameraReport>,
    /// By picture.
    pub sheets: Vec<ViewReport>,
    /// Further figures.
    pub figures: Vec<Figure>,
    /// What a person should know: what was held fixed, what was left out.
    pub notes: Vec<String>,
}

impl Report {
    /// Adds a figure.
    pub fn figure(&mut self, name: impl Into<String>, value: f64, unit: &'static str) {
        self.figures.push(Figure { name: name.into(), value, sigma: None, unit });
    }

    /// Adds a figure with its standard deviation.
    pub fn uncertain(&mut self, name: impl Into<String>, [value, sigma]: [f64; 2], unit: &'static str) {
        self.figures.push(Figure { name: name.into(), value, sigma: Some(sigma), unit });
    }

    /// As JSON.
    pub fn to_json(&self) -> String {
        serde_json::to_string_pretty(self).expect("numbers and names only")
    }
}

/// Report of a camera; `sigmas` of its lens and place.
pub fn camera_report(
    camera: &Camera,
    sigmas: &[f64; LENS + EXTRINSICS],
    residuals: &[Residual],
    index: usize,
) -> CameraReport {
    let own = residuals.iter().copied().filter(|r| r.camera == index);
    let values = lens_of(camera).into_iter().zip(sigmas).map(|(value, &sigma)| Value { value, sigma });
    let mut place_sigma: [f64; EXTRINSICS] = std::array::from_fn(|i| sigmas[LENS + i]);
    place_sigma[..3].iter_mut().for_each(|rad| *rad *= 1e3);
    let centre: Vector3<f64> = camera.centre_in_world().coords;
    CameraReport {
        id: camera.id,
        lens: LENS_NAMES.into_iter().zip(values).collect(),
        centre_in_world_mm: centre.into(),
        place_sigma,
        rms_px: rms(own.clone()),
        points: own.count(),
    }
}

/// Reports of sheets by name.
pub fn view_reports<'a>(names: impl Iterator<Item = &'a str>, residuals: &[Residual]) -> Vec<ViewReport> {
    let sheet = |(i, name): (usize, &str)| {
        let own = residuals.iter().copied().filter(|r| r.sheet == i);
        ViewReport {
            name: name.into(),
            points: own.clone().count(),
            rms_px: rms(own.clone()),
            worst_px: own.map(|r| r.error.norm()).fold(0.0, f64::max),
        }
    };
    names.enumerate().map(sheet).collect()
}

impl fmt::Display for Report {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        if !self.sheets.is_empty() {
            writeln!(f, "{:<28} {:>7} {:>9} {:>9}", "picture", "points", "rms px", "worst px")?;
            for s in &self.sheets {
                writeln!(f, "{:<28} {:>7} {:>9.3} {:>9.3}", s.name, s.points, s.rms_px, s.worst_px)?;
            }
        }
        for c in &self.cameras {
            writeln!(f, "camera {}: {} points, rms {:.3} px", c.id, c.points, c.rms_px)?;
            for (name, v) in &c.lens {
                // Enough digits to show the uncertainty.
                let digits = if name.starts_with(['f', 'c']) { 2 } else { 5 };
                match v.sigma {
                    0.0 => writeln!(f, "  {name:<3} {:>12.digits$}   fixed", v.value)?,
                    sigma => writeln!(f, "  {name:<3} {:>12.digits$} ± {sigma:.digits$}", v.value)?,
                }
            }
            let [x, y, z] = c.centre_in_world_mm;
            writeln!(f, "  centre in the world {x:.4} {y:.4} {z:.4} mm")?;
            if c.place_sigma.iter().any(|s| *s > 0.0) {
                let [a, b, g, x, y, z] = c.place_sigma;
                writeln!(f, "  pose uncertainty ± {a:.3} {b:.3} {g:.3} mrad, {x:.4} {y:.4} {z:.4} mm")?;
            }
        }
        for figure in &self.figures {
            let sigma = figure.sigma.map(|s| format!(" ± {s:.4}")).unwrap_or_default();
            // Counts are whole.
            let digits = if figure.unit.is_empty() && figure.value.fract() == 0.0 { 0 } else { 4 };
            writeln!(f, "{:<54} {:>10.digits$}{sigma} {}", figure.name, figure.value, figure.unit)?;
        }
        for note in &self.notes {
            writeln!(f, "note: {note}")?;
        }
        if self.rms_px > 0.0 {
            write!(f, "rms of all residuals {:.4} px", self.rms_px)?;
            match self.sigma_px {
                0.0 => writeln!(f)?,
                sigma => writeln!(f, "; one coordinate ± {sigma:.4} px")?,
            }
        }
        Ok(())
    }
}
