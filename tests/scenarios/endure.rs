//! The short form of `make endure`.

use vitreo_tests::endure::{Blow, Campaign, run};

#[test]
fn ten_kills_and_five_stops_cost_time_alone() {
    let folder = tempfile::tempdir().expect("folder");
    let run_args = ["--no-picture", "--direct"].map(String::from).to_vec();
    for (seed, blow, blows) in [(1, Blow::Kill, 10), (2, Blow::Stop(1.0), 5)] {
        let campaign = Campaign { blow, blows, gap_s: [0.3, 1.5], seed, run: run_args.clone() };
        let outcome = run(&campaign, folder.path(), |_| {});
        assert!(outcome.survived() && outcome.blows >= blows, "{outcome:#?}");
        assert!(outcome.poses[0] > 100, "{outcome:#?}");
    }
}
