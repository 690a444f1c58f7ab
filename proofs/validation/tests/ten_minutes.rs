//! Ten minutes of every scenario: the tenth minute, of the same motion, noise and faults as the second, is
//! tracked as well. `make hour` does the same for an hour and for every scene.

use rig::Rig;
use validation::streams::Scenario;
use validation::streams::lasting::{Lasting, Minute};

const MINUTES: u64 = 10;

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
        let early = (minute.number == MINUTES).then_some(&minutes[1]);
        assert_eq!(minute.defects(early), [""; 0], "{scenario:?}, minute {}", minute.number);
    }
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
