//! What `vitreo calibrate dots` refuses or notes beside the calibration itself: wrong points by their lines, pictures
//! and lists that were confused, positions in another unit, and a rig that could not be written.

use crate::agreement::WrongPoint;
use crate::fixed_dots::CameraPrior;
use crate::lens::pinhole_camera;
use crate::median;
use crate::rig_output::rig_with;
use crate::target_problem::TargetView;
use anyhow::{Context, Result, bail};
use nalgebra::{Point3, Vector2, Vector3};
use rig::Rig;
use rig::camera::Camera;
use tracker::rig_check::FARTHEST_CAMERA_MM;

/// Wrong points that are named one by one.
const NAMED: usize = 5;
/// A list fits a camera of the old rig with at most this median error, as a share of the picture's width.
const FITS: f64 = 0.01;
/// It fits another camera than its own if that leaves so much smaller errors.
const RATHER: f64 = 3.0;
/// How near the ratio of two scales is to a power of ten if units were confused, in decades.
const DECADE: f64 = 0.05;

/// Where the points of a list come from.
#[derive(Debug, Clone, Default)]
pub struct Source {
    /// `line` or `entry`.
    pub counted: &'static str,
    /// Line or entry of each point; empty for dots found in a picture.
    pub lines: Vec<usize>,
}

/// Names the points that were left out.
pub fn left_out(wrong: &[WrongPoint], sheets: &[TargetView], sources: &[Source]) -> Vec<String> {
    let of_sheet = |(s, sheet): (usize, &TargetView)| {
        let own: Vec<&WrongPoint> = wrong.iter().filter(|w| w.sheet == s).collect();
        let (first, all) = (own.iter().take(NAMED), sheet.samples.len());
        let named: Vec<String> = first.map(|w| name_of(w, sheet, sources.get(s))).collect();
        let more = match own.len().saturating_sub(NAMED) {
            0 => String::new(),
            more => format!("; and {more} more"),
        };
        (!own.is_empty()).then(|| {
            format!(
                "camera {} ({}): {} of {all} points contradict the others and are left out: {}{more}. Are they \
                 reflections, or other dots?",
                sheet.camera,
                sheet.name,
                own.len(),
                named.join("; "),
            )
        })
    };
    sheets.iter().enumerate().filter_map(of_sheet).collect()
}

fn name_of(wrong: &WrongPoint, sheet: &TargetView, source: Option<&Source>) -> String {
    let at = sheet.samples[wrong.sample].pixel;
    let line = source.and_then(|s| Some(format!("{} {}", s.counted, s.lines.get(wrong.sample)?)));
    let off = if wrong.off_px.is_finite() {
        format!("off by {:.0} px", wrong.off_px)
    } else {
        "behind the camera".into()
    };
    format!("{} at ({:.0}, {:.0}), {off}", line.unwrap_or_else(|| "a dot".into()), at.x, at.y)
}

/// Refuses, before anything is computed, a template into which cameras like these cannot be written.
pub fn writable(template: &Rig, before: &[CameraPrior], from: &str) -> Result<()> {
    let stand_in = |(c, before): (usize, &CameraPrior)| {
        let (id, size) = match before {
            CameraPrior::Size(size) => (c as u32, *size),
            CameraPrior::Lens(camera) => (camera.id, camera.size_px),
        };
        let [w, h] = size.map(f64::from);
        pinhole_camera(id, size, Vector2::repeat(w), Vector2::new(w, h) / 2.0)
    };
    let cameras: Vec<Camera> = before.iter().enumerate().map(stand_in).collect();
    let mut sizes: Vec<String> =
        cameras.iter().map(|c| format!("{}×{}", c.size_px[0], c.size_px[1])).collect();
    sizes.dedup();
    let named = || {
        format!(
            "{from} does not fit {} cameras of {} px, so no rig can be written",
            cameras.len(),
            sizes.join(" and ")
        )
    };
    rig_with(template, &cameras).map(drop).with_context(named)
}

/// Refuses lists that fit other cameras of the rig as given than their own.
pub fn in_order(rig: &Rig, sheets: &[TargetView]) -> Result<()> {
    let cameras = rig.cameras();
    let median_px = |sheet: &TargetView, camera: &Camera| {
        let error = |s: &crate::target_problem::Correspondence| {
            camera.project(&s.point).map_or(f64::INFINITY, |at| (at - s.pixel).norm())
        };
        median(sheet.samples.iter().map(error)).unwrap_or(f64::INFINITY)
    };
    let exchanged = |sheet: &TargetView| {
        let own = cameras.get(sheet.camera)?;
        let own_px = median_px(sheet, own);
        let fits = |camera: &&Camera| {
            let px = median_px(sheet, camera);
            px <= FITS * f64::from(camera.size_px[0]) && RATHER * px < own_px
        };
        let other = cameras.iter().filter(|c| c.id != own.id).find(fits)?;
        Some(format!(
            "{} was given for camera {}, but fits camera {}: {:.1} px instead of {own_px:.1}",
            sheet.name,
            own.id,
            other.id,
            median_px(sheet, other)
        ))
    };
    let exchanged: Vec<String> = sheets.iter().filter_map(exchanged).collect();
    if !exchanged.is_empty() {
        bail!(
            "the rig as given fits if lists are exchanged: {}. Expected one list per camera in the order of the rig; if the \
             cameras changed places, exchange their ids in the rig file",
            exchanged.join("; ")
        );
    }
    Ok(())
}

/// Mean distance between cameras, mm; `None` of fewer than two.
fn mean_baseline(cameras: &[Camera]) -> Option<f64> {
    let pairs = cameras.iter().enumerate().flat_map(|(i, a)| cameras[i + 1..].iter().map(move |b| (a, b)));
    let apart: Vec<f64> = pairs.map(|(a, b)| (a.centre_in_world() - b.centre_in_world()).norm()).collect();
    (!apart.is_empty()).then(|| apart.iter().sum::<f64>() / apart.len() as f64)
}

/// Distance of a camera from the middle of its dots, mm.
fn distance_mm(camera: &Camera, sheet: &TargetView) -> f64 {
    let sum = sheet.samples.iter().map(|s| s.point.coords).sum::<Vector3<f64>>();
    let middle = Point3::from(sum / sheet.samples.len().max(1) as f64);
    (camera.centre_in_world() - middle).norm()
}

/// Says how large the cloud of dots is and how far away the cameras stand. Positions in centimetres give a rig that is as
/// consistent as one in mm, and of a size that other rigs have; only a person who knows this one sees it.
pub fn size_of(cameras: &[Camera], sheets: &[TargetView]) -> String {
    let dots = || sheets.iter().flat_map(|sheet| &sheet.samples).map(|s| s.point.coords);
    let least = dots().fold(Vector3::repeat(f64::INFINITY), |least, dot| least.inf(&dot));
    let most = dots().fold(Vector3::repeat(f64::NEG_INFINITY), |most, dot| most.sup(&dot));
    let extent: Vec<String> = (most - least).iter().map(|mm| rounded(*mm)).collect();
    let away = cameras.iter().zip(sheets).map(|(camera, sheet)| distance_mm(camera, sheet));
    let [nearest, farthest] = away.fold([f64::INFINITY, 0.0], |[a, b], mm: f64| [a.min(mm), b.max(mm)]);
    let [nearest, farthest] = [nearest, farthest].map(rounded);
    let away = if nearest == farthest { nearest } else { format!("{nearest} to {farthest}") };
    format!(
        "dots span {} mm; cameras stand {away} mm away from them. If this is wrong, the positions of the dots are not in \
         mm",
        extent.join(" × ")
    )
}

/// A length to three digits or so.
fn rounded(mm: f64) -> String {
    let decimals = if mm < 1.0 {
        3
    } else if mm < 10.0 {
        1
    } else {
        0
    };
    format!("{mm:.decimals$}")
}

/// What is wrong with the scale of a result, if positions of dots seem to be in another unit than mm. `old` is the rig
/// as given, if its cameras are the same.
pub fn other_unit(
    cameras: &[Camera],
    sheets: &[TargetView],
    template: &Rig,
    old: Option<&Rig>,
) -> Option<String> {
    let ratio = old.and_then(|old| Some(mean_baseline(cameras)? / mean_baseline(&old.cameras())?));
    if let Some(ratio) = ratio.filter(|ratio| ratio.is_normal()) {
        let decades = ratio.log10();
        if decades.round() != 0.0 && (decades - decades.round()).abs() < DECADE {
            return Some(format!(
                "the cameras are {ratio:.4} times as far apart as in the rig as given: expected positions of the dots in mm"
            ));
        }
    }
    let nearest = template.workspace.tip_radius;
    cameras.iter().zip(sheets).find_map(|(camera, sheet)| {
        let mm = distance_mm(camera, sheet);
        (!(nearest..=FARTHEST_CAMERA_MM).contains(&mm)).then(|| {
            format!(
                "camera {} is {mm:.2} mm from the middle of its dots, expected {nearest} to {FARTHEST_CAMERA_MM} mm: are \
                 the positions of the dots in mm?",
                camera.id
            )
        })
    })
}
