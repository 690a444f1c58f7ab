//! Exposure, gain and trigger of a GenICam camera.

use super::refused;
use anyhow::{Result, anyhow, ensure};
use aravis::Auto;
use aravis::prelude::*;
use settings::commands::cameras::{Trigger, Wanted};

/// A value that is kept to this share is the one that was asked for: cameras have steps.
const SAME: f64 = 0.01;

/// Sets what is wanted, and says what was set.
pub(super) fn all(camera: &aravis::Camera, wanted: &Wanted) -> Result<String> {
    let mut texts = Vec::new();
    if let Some(us) = wanted.exposure_us {
        let has = camera.is_exposure_time_available().unwrap_or(false);
        ensure!(has, "has no adjustable exposure: omit exposure_us");
        if camera.is_exposure_auto_available().unwrap_or(false) {
            camera.set_exposure_time_auto(Auto::Off).map_err(refused)?;
            texts.push("manual exposure".into());
        }
        let us = f64::from(us);
        within("exposure_us", us, camera.exposure_time_bounds().map_err(refused)?)?;
        camera.set_exposure_time(us).map_err(refused)?;
        kept("exposure_us", us, camera.exposure_time().map_err(refused)?)?;
        texts.push(format!("exposure {us} µs"));
    }
    if let Some(gain) = wanted.gain {
        let has = camera.is_gain_available().unwrap_or(false);
        ensure!(has, "has no adjustable gain: omit gain");
        if camera.is_gain_auto_available().unwrap_or(false) {
            camera.set_gain_auto(Auto::Off).map_err(refused)?;
            texts.push("manual gain".into());
        }
        let gain = f64::from(gain);
        within("gain", gain, camera.gain_bounds().map_err(refused)?)?;
        camera.set_gain(gain).map_err(refused)?;
        kept("gain", gain, camera.gain().map_err(refused)?)?;
        texts.push(format!("gain {gain}"));
    }
    if let Some(wanted) = wanted.trigger {
        texts.push(trigger(camera, wanted)?);
    }
    Ok(texts.join(", "))
}

/// What can be set, a line each.
pub(super) fn settable(camera: &aravis::Camera) -> Option<String> {
    let range = |key: &str, (low, high): (f64, f64)| format!("{key}={low:.0} to {high:.0}");
    let exposure = camera.is_exposure_time_available().unwrap_or(false);
    let gain = camera.is_gain_available().unwrap_or(false);
    let all = [
        exposure.then(|| camera.exposure_time_bounds().ok()).flatten().map(|b| range("exposure_us", b)),
        gain.then(|| camera.gain_bounds().ok()).flatten().map(|b| range("gain", b)),
        line(camera).ok().map(|_| "trigger=internal or external".into()),
    ];
    let all: Vec<String> = all.into_iter().flatten().collect();
    (!all.is_empty()).then(|| format!("can be set: {}", all.join(", ")))
}

/// The first line in of a camera that begins exposures.
fn line(camera: &aravis::Camera) -> Result<String> {
    let sources = camera.dup_available_trigger_sources().map_err(refused)?;
    let found = sources.iter().find(|source| source.starts_with("Line"));
    found.map(ToString::to_string).ok_or_else(|| anyhow!("has no input line for a trigger: omit trigger"))
}

fn trigger(camera: &aravis::Camera, wanted: Trigger) -> Result<String> {
    if wanted == Trigger::Internal {
        camera.clear_triggers().map_err(refused)?;
        return Ok("trigger internal".into());
    }
    let line = line(camera)?;
    camera.set_trigger(&line).map_err(refused)?;
    Ok(format!("trigger external ({line})"))
}

/// Refuses what is out of a feature's range.
fn within(key: &str, asked: f64, (low, high): (f64, f64)) -> Result<()> {
    ensure!((low..=high).contains(&asked), "expected {key}={low} to {high}, found {asked}");
    Ok(())
}

/// Refuses a value that is not the one asked for.
fn kept(key: &str, asked: f64, found: f64) -> Result<()> {
    let same = (found - asked).abs() <= SAME * asked.abs().max(1.0);
    ensure!(same, "did not keep {key}={asked}: it reports {found}");
    Ok(())
}
