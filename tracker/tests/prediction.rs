//! Prediction of real hands: the recordings of tremor in `motion/m2s2_tremor` (surgeons and novices
//! under a microscope, 250 Hz), sampled as the cameras would, 40 ms ahead.

use bytemuck::Zeroable;
use nalgebra::Vector3;
use protocol::geometry::{Pose, Validity};
use protocol::limits::FIELD_PERIOD_NS;
use protocol::poses::BodyState;
use protocol::predict::predict_body;
use std::path::Path;
use tracker::predictor::TipPredictor;

/// Rows of a recording per field: 250 Hz against 50 Hz.
const ROWS_PER_FIELD: usize = 5;
/// Fields ahead: 40 ms.
const AHEAD: usize = 2;
/// Fields given to the predictor to adapt to the hand.
const SETTLE: usize = 50;

/// Positions of a recording, mm; the zeros that pad its end are dropped.
fn positions(path: &Path) -> Vec<Vector3<f64>> {
    let text = std::fs::read_to_string(path).unwrap();
    let row = |line: &str| {
        let n: Vec<f64> = line.split(',').filter_map(|v| v.trim().parse().ok()).collect();
        (n.len() >= 4).then(|| Vector3::new(n[1], n[2], n[3]))
    };
    let mut rows: Vec<_> = text.lines().filter_map(row).collect();
    while rows.last().is_some_and(|p| p.norm() == 0.0) {
        rows.pop();
    }
    rows.into_iter().step_by(ROWS_PER_FIELD).collect()
}

fn rms_um(errors: impl Iterator<Item = Vector3<f64>>) -> f64 {
    let (sum, n) = errors.fold((0.0, 0), |(sum, n), e| (sum + e.norm_squared(), n + 1));
    (sum / f64::from(n)).sqrt() * 1e3
}

/// RMS errors 40 ms ahead, µm: the last pose, constant velocity, the predictor.
fn errors(tips: &[Vector3<f64>]) -> [f64; 3] {
    let mut predictor = TipPredictor::default();
    let mut predictions = Vec::with_capacity(tips.len());
    for (n, tip) in tips.iter().enumerate() {
        let at = (n as u64 + 1) * FIELD_PERIOD_NS;
        let mut body = BodyState::zeroed();
        body.world_from_body = Pose { position_mm: (*tip).into(), ..Pose::IDENTITY };
        body.validity = Validity::Measured as u32;
        predictor.observe(at, FIELD_PERIOD_NS, true, |_| *tip);
        predictor.write_to(at, |_| *tip, &mut body.predictor);
        let ahead = predict_body(&body, AHEAD as f64 * FIELD_PERIOD_NS as f64 * 1e-9);
        predictions.push(Vector3::from(ahead.world_from_body.position_mm));
    }
    let fields = || SETTLE..tips.len() - AHEAD;
    let last = rms_um(fields().map(|n| tips[n] - tips[n + AHEAD]));
    let steady = rms_um(fields().map(|n| tips[n] + (tips[n] - tips[n - 1]) * AHEAD as f64 - tips[n + AHEAD]));
    [last, steady, rms_um(fields().map(|n| predictions[n] - tips[n + AHEAD]))]
}

#[test]
fn real_hands_are_foreseen_better_than_by_habit() {
    let Some(folder) = skips::data("motion/m2s2_tremor") else { return };
    let mut files: Vec<_> = std::fs::read_dir(folder).unwrap().flatten().map(|f| f.path()).collect();
    files.retain(|f| f.extension().is_some_and(|e| e == "csv"));
    files.sort();
    println!("40 ms ahead, RMS in µm{:20}  last pose  constant velocity  predictor  ratio", "");
    let mut ratios = Vec::new();
    for file in &files {
        let [last, steady, ours] = errors(&positions(file));
        let ratio = last.min(steady) / ours;
        println!(
            "{:42}  {last:9.1}  {steady:17.1}  {ours:8.1}  {ratio:5.2}",
            file.file_stem().unwrap_or_default().to_string_lossy()
        );
        ratios.push(ratio);
    }
    ratios.sort_by(f64::total_cmp);
    let median = 0.5 * (ratios[(ratios.len() - 1) / 2] + ratios[ratios.len() / 2]);
    println!("median {median:.3} of {} hands", files.len());
    assert!(files.len() >= 10, "{} hands", files.len());
    assert!(median >= 1.25, "median ratio {median}");
}
