//! Planted defects, and what the commands say of them: table of `docs/calibration.md`.

use clap::Parser;
use std::sync::Mutex;
use std::sync::atomic::{AtomicU64, Ordering};
use validation::judged::{Said, draw_lens, said, said_of};
use validation::planted::Defect;

/// Plants a defect in a stream of every seed and draws further streams of intact rigs, every second one on a rig of its
/// own, and prints what rig check, drift, pivot, waved and the end of replay report of them.
#[derive(Parser)]
struct Args {
    /// Streams with a planted defect; one of the kinds is "none".
    #[arg(long, default_value_t = 100)]
    seeds: u64,
    /// Further streams of intact rigs: they show how often there is a false alarm.
    #[arg(long, default_value_t = 100)]
    intact: u64,
    /// First seed. Those from 20001 on were not used to set limits; from 30001 on all kinds of defects are planted, and
    /// from 40001 on streams also have strong tremor or everything that makes tracking hard.
    #[arg(long, default_value_t = 40_001)]
    from: u64,
    /// Plant nothing but wrong lenses in the seeds with a defect.
    #[arg(long)]
    lenses: bool,
}

fn main() {
    let Args { seeds, intact, from, lenses } = Args::parse();
    let end = from + seeds + intact;
    let (next, all) = (AtomicU64::new(from), Mutex::new(Vec::new()));
    let work = || {
        loop {
            let seed = next.fetch_add(1, Ordering::Relaxed);
            if seed >= end {
                break;
            }
            let (whole, is_intact) = (seed % 2 == 1, seed >= from + seeds);
            let found = match lenses && !is_intact {
                true => said_of(seed, whole, draw_lens(seed, whole)),
                false => said(seed, whole, is_intact),
            };
            print_said(&found);
            all.lock().expect("no thread panics").push(found);
        }
    };
    std::thread::scope(|scope| (0..2).for_each(|_| drop(scope.spawn(work))));
    let all = all.into_inner().expect("no thread panics");
    table(&all);
    println!(
        "\n{} streams of seeds {from} to {}, {} on rigs of their own",
        all.len(),
        end - 1,
        count(&all, |s| s.whole)
    );
    println!("faulty rigs reported as valid: {}", count(&all, Said::holds_wrongly));
    println!("wrong or incomplete single cause: {}", count(&all, Said::is_blamed_wrongly));
    println!(
        "false alarms: {} of {} intact rigs",
        count(&all, Said::is_false_alarm),
        count(&all, |s| s.defect == Defect::None)
    );
    println!("right: {} of {}", count(&all, |s| s.right), all.len());
}

/// What was compared.
fn print_said(said: &Said) {
    let rig = if said.whole { "own rig" } else { "shipped rig" };
    let verdict = if said.right { "right" } else { "NOT NAMED" };
    eprintln!(
        "seed {} ({rig}), planted: {}\n    {verdict}: {}; {:.4} px above the noise\n    rig check: {}; drift: {}; pivot: {}; waved: {}; replay: {}",
        said.seed,
        said.truth,
        said.judgement.text(),
        said.judgement.above_px,
        if said.rig_check_reports { "reports" } else { "silent" },
        if said.drift_holds { "the rig holds" } else { "it does not" },
        if said.judgement.holds { "accepts" } else { "refuses" },
        match &said.waved {
            Ok([before, after]) => format!("held-out instants {before:.3} -> {after:.3} px"),
            Err(why) => format!("nothing written, {why}"),
        },
        if said.replay_is_silent { "silent" } else { "warns" },
    );
}

fn count(all: &[Said], of: impl Fn(&Said) -> bool) -> usize {
    all.iter().filter(|said| of(said)).count()
}

fn table(all: &[Said]) {
    println!(
        "| defect | streams | named alone | among several | not named | `rig check` reports | `drift`: holds | `pivot` accepts | `waved` writes | `replay` warns |"
    );
    println!("|---|---|---|---|---|---|---|---|---|---|");
    for defect in Defect::ALL.into_iter().chain(Defect::MORE).chain(Defect::LENSES) {
        let of = |test: &dyn Fn(&Said) -> bool| count(all, |s| s.defect == defect && test(s));
        println!(
            "| {defect:?} | {} | {} | {} | {} | {} | {} | {} | {} | {} |",
            of(&|_| true),
            of(&|s| s.right && s.judgement.explanations.len() <= 1),
            of(&|s| s.right && s.judgement.explanations.len() > 1),
            of(&|s| !s.right),
            of(&|s| s.rig_check_reports),
            of(&|s| s.drift_holds),
            of(&|s| s.judgement.holds),
            of(&|s| s.waved.is_ok()),
            of(&|s| !s.replay_is_silent),
        );
    }
}
