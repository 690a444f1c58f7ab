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
