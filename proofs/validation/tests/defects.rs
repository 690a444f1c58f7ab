//! Planted defects are named by `vitreo diff`: one of every kind; `make defects` plants a hundred.

use validation::defects::{KINDS, Outcome, Verdict, run};

#[test]
fn a_defect_of_every_kind_is_named_and_none_wrongly() {
    let outcomes: Vec<Outcome> =
        (0..KINDS).map(|seed| run(seed).expect("recordings can be written")).collect();
    for outcome in &outcomes {
        let found: Vec<String> = outcome.found.iter().map(|finding| finding.text()).collect();
        println!("seed {} {:?}: {:?}: {found:?}", outcome.seed, outcome.verdict, outcome.defect);
    }
    let of = |verdict| outcomes.iter().filter(|outcome| outcome.verdict == verdict).count();
    assert_eq!((of(Verdict::Wrong), outcomes.len()), (0, KINDS as usize));
    assert!(of(Verdict::Right) + 1 >= outcomes.len(), "{} of {KINDS}", of(Verdict::Right));
}
