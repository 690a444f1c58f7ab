//! The bound of streams that were drawn, of the same streams read from files, and of instruments that are taken out
//! or do not move.

use super::bound::TipBound;
use super::motion::Motion;
use super::*;
use std::fmt::Write;

const SECONDS: f64 = 6.0;

fn drawn(scenario: Scenario, seed: u64) -> Stream {
    let rig = Rig::load_or_shipped(None).unwrap();
    Recipe { scenario, seed, seconds: SECONDS, knocks: vec![] }.draw(&rig)
}

/// The stream as files of another generator, read again.
fn read_again(stream: &Stream) -> Stream {
    let folder = tempfile::tempdir().unwrap();
    let columns = "x y z qw qx qy qz present".split(' ');
    let mut truth = "t_ns".to_owned();
    for body in ["inst0", "inst1", "eye"] {
        columns.clone().for_each(|column| write!(truth, ",{body}_{column}").unwrap());
    }
    for n in 0..(SECONDS * 1e3) as u64 {
        let placed = stream.motion.at(n as f64 * 1e-3);
        write!(truth, "\n{}", n * 1_000_000).unwrap();
        for (pose, present) in placed.bodies.iter().zip(placed.present) {
            let (p, q) = (pose.translation.vector, pose.rotation.coords);
            let present = f64::from(u8::from(present));
            for value in [p.x, p.y, p.z, q.w, q.x, q.y, q.z, present] {
                write!(truth, ",{value:.9}").unwrap();
            }
        }
    }
    let blobs: Vec<String> = stream.fields.iter().map(blob_stream::write_line).collect();
    let files = [("truth.csv", truth), ("blobs.jsonl", blobs.join("\n")), ("rig.json", stream.rig.to_json())];
    files.iter().for_each(|(name, text)| std::fs::write(folder.path().join(name), text).unwrap());
    Stream::read(folder.path()).unwrap()
}

/// Bounds of an instrument where it is in the eye, with the instants.
fn bounds(stream: &Stream, instrument: usize, every: usize) -> Vec<(f64, f64)> {
    let mut bound = TipBound::new(stream, instrument);
    let instants = stream.sightings.iter().map(|s| s.exposed_s).filter(|t_s| (0.5..5.5).contains(t_s));
    let there = instants.filter(|t_s| stream.motion.at(*t_s).present[instrument]);
    there.step_by(every).filter_map(|t_s| Some((t_s, bound.at_um(t_s)?))).collect()
}

/// Ratios of the bounds of the same stream, one after the other.
fn ratios(of: &Stream, to: &Stream) -> Vec<f64> {
    let [of, to] = [of, to].map(|stream| bounds(stream, 0, 60));
    assert!(of.len() > 8 && of.len() == to.len());
    of.iter().zip(&to).map(|((_, of), (_, to))| of / to).collect()
}

#[test]
fn a_stream_that_is_read_from_files_has_the_bound_of_the_one_that_was_drawn() {
    for (scenario, seed) in [(Scenario::Nominal, 1), (Scenario::Async, 2), (Scenario::Hard, 3)] {
        let stream = drawn(scenario, seed);
        let mut read = read_again(&stream);
        let ([column, line], falls) = read.noise_px();
        assert!(
            falls && (column / 0.61 - 1.0).abs() < 0.04 && (line / 1.23 - 1.0).abs() < 0.04,
            "{column} {line}"
        );
        // With spectra that are estimated from so few seconds.
        let estimated = ratios(&read, &stream);
        assert!(estimated.iter().all(|ratio| (0.96..1.04).contains(ratio)), "{scenario:?}: {estimated:?}");
        // With those of the generator only the assignment of blobs to markers and the interpolated truth remain.
        let Motion::Recorded(recorded) = &mut read.motion else { panic!("it is recorded") };
        recorded.spectra = [0, 1].map(|instrument| stream.motion.spectra(instrument).clone());
        read.noise = stream.noise;
        let known = ratios(&read, &stream);
        println!("{scenario:?}: estimated {estimated:.3?}, known {known:.4?}");
        assert!(known.iter().all(|ratio| (ratio - 1.0).abs() < 0.002), "{scenario:?}: {known:?}");
    }
}

/// What is known of a withdrawal can only help: a stream that is read holds its tips as they are, and knows less.
#[test]
fn an_instrument_that_is_taken_out_is_known_no_worse_than_any_other() {
    let stream = drawn(Scenario::Withdrawn, 1);
    let read = read_again(&stream);
    let taken_out = usize::from(stream.sightings.iter().all(|s| stream.motion.at(s.exposed_s).present[0]));
    let [known, unknown] = [&stream, &read].map(|s| bounds(s, taken_out, 3));
    let is_moved = |t_s: f64| (2.4..4.0).contains(&t_s) || (4.38..5.28).contains(&t_s);
    let moved: Vec<_> = known.iter().zip(&unknown).filter(|((t_s, _), _)| is_moved(*t_s)).collect();
    assert!(moved.len() > 40, "{} instants", moved.len());
    for ((t_s, known), (_, unknown)) in moved {
        assert!(known < &(1.1 * unknown), "{known} and {unknown} µm at {t_s} s");
    }
}

#[test]
fn the_bound_of_what_does_not_move_falls_as_the_root_of_time() {
    let stream = drawn(Scenario::Rest, 1);
    let all = bounds(&stream, 1, 1);
    let at = |wanted: f64| all.iter().find(|(t_s, _)| *t_s >= wanted).unwrap();
    let ((early_s, early_um), (late_s, late_um)) = (at(1.0), at(5.0));
    let expected = libm::sqrt((early_s - BEGIN_NS * 1e-9) / (late_s - BEGIN_NS * 1e-9));
    assert!((late_um / early_um / expected - 1.0).abs() < 0.03, "{early_um} and {late_um} µm");
}
