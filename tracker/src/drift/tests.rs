//! The estimation of drift on blobs without noise.

use super::*;
use crate::pose_math::{Vector6, box_plus};
use nalgebra::Matrix2;
use rig::Rig;

/// Blobs of body 0 as the cameras of `real` see it, at the `n`-th of many poses.
fn blobs(real: &RigModel, n: u32) -> (Isometry3<f64>, Vec<BlobMatch>) {
    let t = f64::from(n) * 0.1;
    let turn = Vector3::new(0.4 * t.sin(), 0.3 * (1.3 * t).cos(), 0.9 * (0.7 * t).sin());
    let pose = Isometry3::new(Vector3::new((0.9 * t).sin(), (1.1 * t).cos(), -3.0 + t.cos()), turn);
    let mut matches = Vec::new();
    for (camera, model) in real.cameras.iter().enumerate() {
        let Some(model) = model else { continue };
        for (marker, m) in real.bodies[0].markers.iter().enumerate() {
            let pixel = project_marker(m, &PoseMatrix::from(&pose), model).unwrap().pixel;
            let covariance = Matrix2::identity() * 0.0025;
            let (blob, dt_s, area_ratio, clean, outlier) = (0, 0.0, 1.0, true, false);
            matches.push(BlobMatch {
                camera,
                blob,
                marker,
                pixel,
                covariance,
                dt_s,
                area_ratio,
                clean,
                outlier,
            });
        }
    }
    (pose, matches)
}

/// The estimate for a rig with one shifted marker of body 0, from poses that have errors
/// themselves.
fn estimated(shift: Vector3<f64>) -> (RigModel, DriftReport) {
    let nominal = RigModel::new(&Rig::load_or_shipped(None).unwrap());
    let (mut real, mut rig) = (nominal.clone(), nominal.clone());
    real.bodies[0].markers[1].position += shift;
    let mut drift = DriftEstimator::new(&nominal);
    for n in 0..600 {
        let (pose, matches) = blobs(&real, n);
        let wrong = box_plus(&pose, &(Vector6::repeat(1e-3) * f64::from(n % 5)));
        drift.add_residuals(&rig, 0, &wrong, &[Vector3::zeros(); 2], &matches);
        drift.step(&mut rig);
    }
    (rig, *drift.report())
}

#[test]
fn a_marker_that_moved_alone_is_found() {
    let shift = Vector3::new(0.0, 0.012, 0.0);
    let (rig, report) = estimated(shift);
    assert!(report.detected && report.is_large(), "{report}");
    assert!(report.to_string().contains("drifted"), "{report}");
    // The middle of three in a line: bent out of it, which no pose explains. The others share
    // it.
    let y = |m: usize| rig.bodies[0].markers[m].position.y;
    let nominal = RigModel::new(&Rig::load_or_shipped(None).unwrap());
    let y0 = |m: usize| nominal.bodies[0].markers[m].position.y;
    let along = |m: usize| nominal.bodies[0].markers[m].position.z;
    let share = (along(1) - along(0)) / (along(2) - along(0));
    let bend = |y: &dyn Fn(usize) -> f64| y(1) - y(0) - share * (y(2) - y(0));
    let found = bend(&y) - bend(&y0);
    assert!((found - 0.012).abs() < 0.0015, "{found}");
}

#[test]
fn a_rig_that_did_not_move_is_left_alone() {
    let (rig, report) = estimated(Vector3::zeros());
    assert!(!report.detected && !report.is_large(), "{report}");
    assert!(report.to_string().contains("no drift"), "{report}");
    assert_eq!(rig, RigModel::new(&Rig::load_or_shipped(None).unwrap()));
}

/// Which blobs are used in a frame.
type Uses = fn(u32, &BlobMatch) -> bool;

/// 10⁶ frames of residuals that noise, a bias, one camera alone or a rest make: sums stay symmetric and
/// bounded, corrections within their limits, and none is dropped.
#[test]
fn a_million_frames_of_adverse_residuals_leave_it_sound() {
    const FRAMES: u32 = 200_000;
    let nominal = RigModel::new(&Rig::load_or_shipped(None).unwrap());
    let cases: [(&str, Uses, f64, bool); 5] = [
        ("noise", |_, _| true, 0.0, true),
        ("a bias", |_, _| true, 2.0, true),
        ("one camera", |_, m| m.camera == 0, 0.5, true),
        ("one frame in ten", |n, _| n % 10 == 0, 0.5, true),
        ("rest", |_, _| true, 0.3, false),
    ];
    for (name, used, bias_px, moves) in cases {
        let (mut rig, mut drift) = (nominal.clone(), DriftEstimator::new(&nominal));
        let poses: Vec<_> = (0..if moves { 100 } else { 1 }).map(|n| blobs(&nominal, n)).collect();
        for n in 0..FRAMES {
            let (pose, matches) = &poses[n as usize % poses.len()];
            let noise =
                |k: u64| (protocol::random::unit_interval(protocol::random::nth(k, n.into())) - 0.5) * 0.2;
            let mut matches: Vec<BlobMatch> = matches.iter().copied().filter(|m| used(n, m)).collect();
            for (k, m) in matches.iter_mut().enumerate() {
                let k = 2 * k as u64;
                m.pixel += Vector2::new(noise(k) + bias_px * f64::from(m.camera == 0), noise(k + 1));
            }
            drift.add_residuals(&rig, 0, pose, &[Vector3::zeros(); 2], &matches);
            assert!(drift.step(&mut rig) || drift.column > 0, "{name}: sums were dropped at {n}");
            if n % 997 == 0 || n + 1 == FRAMES {
                assert_sound(&drift, name);
            }
        }
        println!("{name}: {FRAMES} frames, evidence {:.2}", drift.report().evidence);
    }
}

fn assert_sound(drift: &DriftEstimator, name: &str) {
    let (n, sums) = (drift.parameters, &drift.information);
    let largest = sums.iter().fold(0.0f64, |most, v| most.max(v.abs()));
    assert!(largest.is_finite() && largest < 1e9, "{name}: {largest}");
    for r in 0..n {
        for c in 0..r {
            assert_eq!(sums[r * n + c], sums[c * n + r], "{name}: {r}, {c}");
        }
    }
    assert!(drift.applied.iter().all(|a| a.abs() <= k::DRIFT_LIMIT), "{name}: {:?}", drift.applied);
}
