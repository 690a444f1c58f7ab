//! Ten minutes of every scenario: the tenth minute, of the same motion, noise and faults as the second, is
//! tracked as well. `make hour` does the same for an hour and for every scene.

use protocol::rig::Rig;
use validation::streams::Scenario;
use validation::streams::lasting::{Lasting, Minute};

const MINUTES: u64 = 10;
/// Largest ratio of the errors of the last minute to those of the second.
const ERROR_RATIO: f64 = 1.1;
/// Largest loss of coverage between them.
const COVERAGE_LOSS: f64 = 0.001;

fn check(scenario: Scenario) {
    let mut lasting = Lasting::new(&Rig::load_or_shipped(None).expect("the shipped rig"), scenario, 11);
    let minutes: Vec<Minute> = (0..MINUTES).map(|_| lasting.minute()).collect();
    for minute in &minutes {
        let [tips, shown] = minute.errors_um();
        println!(
            "{} minute {}: {} frames of {} exposures, {} tips of {tips:.2} µm, {} shown of {shown:.1} µm, coverage {:.4}",
            scenario.name(),
            minute.number,
            minute.frames,
            minute.exposures,
            minute.score.tips_um.len(),
            minute.score.shown_um.len(),
            minute.score.coverage(),
        );
        assert!(minute.score.tips_um.len() > 3_000 && minute.score.shown_um.len() > 5_000);
        assert_eq!(minute.restarts, 0, "{scenario:?}, minute {}", minute.number);
        assert!(minute.frames + 2 >= minute.exposures, "{scenario:?}: frames are missing");
    }
    let (early, late) = (&minutes[1], &minutes[MINUTES as usize - 1]);
    for (late, early) in late.errors_um().into_iter().zip(early.errors_um()) {
        assert!(late <= ERROR_RATIO * early, "{scenario:?}: {late} µm, {early} µm in the second minute");
    }
    let lost = early.score.coverage() - late.score.coverage();
    assert!(lost <= COVERAGE_LOSS, "{scenario:?}: coverage fell by {lost}");
}

#[test]
fn nominal() {
    check(Scenario::Nominal);
}

#[test]
fn asynchronous() {
    check(Scenario::Async);
}

#[test]
fn tremor() {
    check(Scenario::Tremor);
}

#[test]
fn hard() {
    check(Scenario::Hard);
}

#[test]
fn withdrawn_and_back() {
    check(Scenario::Withdrawn);
}

#[test]
fn at_rest() {
    check(Scenario::Rest);
}
