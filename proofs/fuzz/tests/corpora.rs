//! Every kept input and every one that once failed is taken in by its target without a panic, within
//! a second (on a machine that does nothing else) and within the memory allowed.

use fuzz::{corpus, targets, watch};
use std::panic::{AssertUnwindSafe, catch_unwind};

#[test]
fn kept_inputs_harm_nothing() {
    let mut failed = Vec::new();
    let mut replayed = 0;
    for target in targets::all() {
        for (i, input) in corpus::of(&target).into_iter().enumerate() {
            replayed += 1;
            if catch_unwind(AssertUnwindSafe(|| (target.run)(&input))).is_err() {
                failed.push(format!(
                    "{} input {i}: {}",
                    target.name,
                    String::from_utf8_lossy(&input[..input.len().min(200)])
                ));
            }
        }
    }
    assert!(failed.is_empty(), "{failed:#?}");
    assert!(replayed > 100, "{replayed}");
    assert!(watch::peak_memory() < watch::MOST_MEMORY, "{} bytes", watch::peak_memory());
}

#[test]
fn the_kept_inputs_are_few_bytes_and_belong_to_a_target() {
    let mut bytes = 0;
    for folder in ["proofs/fuzz/corpus", "proofs/fuzz/crashes"] {
        for entry in std::fs::read_dir(corpus::repository().join(folder)).into_iter().flatten().flatten() {
            let name = entry.file_name().to_string_lossy().into_owned();
            assert!(targets::named(&name).is_some(), "{folder}/{name} belongs to no target");
            let size = |p: &std::path::Path| p.metadata().map_or(0, |m| m.len());
            let inside = corpus::files_in(&entry.path());
            bytes += size(&entry.path()) + inside.iter().map(|(p, _)| size(p)).sum::<u64>();
        }
    }
    assert!(bytes <= 2 << 20, "{bytes} bytes");
}
