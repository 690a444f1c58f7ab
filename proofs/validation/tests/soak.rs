//! Forty random programmes of five seconds; `make soak` runs a thousand of sixty. Seeds are printed
//! with what goes wrong.

use simcore::world::no_clock;
use validation::soak::run;

#[test]
fn forty_random_programmes_do_no_harm_and_repeat() {
    let outcomes: Vec<_> = (0..40).map(|seed| run(seed, 5.0, &mut no_clock)).collect();
    let failures: Vec<String> =
        outcomes.iter().filter_map(|o| o.as_ref().err()).map(ToString::to_string).collect();
    assert!(failures.is_empty(), "{}", failures.join("\n"));
    let events: u64 = outcomes.iter().flatten().map(|o| o.events).sum();
    assert!(events > 400, "the programmes must do something: {events} events");
    let kinds = |o: &&validation::soak::Outcome| o.scene.clone();
    let scenes: std::collections::BTreeSet<String> = outcomes.iter().flatten().map(|o| kinds(&o)).collect();
    assert!(scenes.len() >= 2, "{scenes:?}");
}

#[test]
fn another_seed_is_another_programme() {
    let [a, b] = [1, 2].map(|seed| run(seed, 0.5, &mut no_clock).unwrap().hash);
    assert_ne!(a, b);
}

/// Tests are built with the development profile: optimised a little, but with every debug assertion
/// and with whole numbers checked for overflow. So the programmes above, and these four, are those
/// of a debug build; the same hashes in a release build: `tests/determinism.rs`.
#[test]
fn four_short_programmes_run_in_a_debug_build() {
    if !cfg!(debug_assertions) {
        println!("not a debug build: nothing to see here");
        return;
    }
    let overflows = std::panic::catch_unwind(|| std::hint::black_box(u8::MAX) + std::hint::black_box(1));
    assert!(overflows.is_err(), "overflow checks are on in this profile");
    for seed in 100..104 {
        let outcome = run(seed, 2.0, &mut no_clock).unwrap_or_else(|e| panic!("{e}"));
        assert!(outcome.tool_steps.iter().sum::<u64>() == 2 * outcome.steps);
    }
}
