//! Reads every recorded hand under `VITREO_DATA`; without the data the test says so and passes.

use surgeon::motion::recorded::RecordedMotion;

#[test]
fn every_recorded_hand_is_read_and_split() {
    let Some(folder) = skips::data("motion/m2s2_tremor") else { return };
    let paths = std::fs::read_dir(folder).unwrap().map(|entry| entry.unwrap().path());
    let recordings: Vec<_> = paths.filter(|p| p.extension().is_some_and(|e| e == "csv")).collect();
    assert!(!recordings.is_empty(), "no CSV file in motion/m2s2_tremor");
    for path in recordings {
        let hand = RecordedMotion::load(&path).unwrap_or_else(|e| panic!("{e}"));
        let fast = hand.fast_part();
        // 5,001 or 7,502 samples at 250 Hz lie before the padding.
        assert!((19.9..30.1).contains(&hand.length_s()), "{}: {} s", path.display(), hand.length_s());
        let n = 2000;
        let instants = (0..n).map(|i| f64::from(i) * 2.0 * hand.length_s() / f64::from(n));
        let rms = (instants.map(|t| fast.at(t).norm_squared()).sum::<f64>() / f64::from(n)).sqrt();
        assert!((0.003..0.3).contains(&rms), "{}: {rms} mm above 1 Hz", path.display());
        let whole = hand.at(3.0) - hand.at(3.004);
        assert!(whole.norm() < 0.1, "{}: {} mm in 4 ms", path.display(), whole.norm());
    }
}
