//! Tests of live streams: lines, clocks, order, silence.

use super::*;
use proptest::prelude::*;
use protocol::message::Message;
use std::convert::Infallible;

const MS: u64 = 1_000_000;
const PERIOD: u64 = 20 * MS;

fn line(cam: u32, seq: u64, t_ns: u64) -> String {
    let blob = r#"{"x":1,"y":2,"area":30,"colour":"red","w":6,"h":5}"#;
    let t_rx_ns = t_ns + 24 * MS;
    format!(
        "{{\"cam\":{cam},\"seq\":{seq},\"t_ns\":{t_ns},\"t_rx_ns\":{t_rx_ns},\"parity\":0,\"blobs\":[{blob}]}}\n"
    )
}

/// What was heard: (camera, number, exposure) of every field, and every text.
#[derive(Default)]
struct Notes {
    fields: Vec<(u32, u64, u64)>,
    texts: Vec<String>,
}

impl Notes {
    fn hear(&mut self, heard: Heard<'_>) -> Result<(), Infallible> {
        match heard {
            Heard::Field(field) => {
                assert!(field.validate().is_ok());
                self.fields.push((field.camera, field.field, field.exposed_ns));
            }
            Heard::Bad(text) => self.texts.push(text),
            Heard::Begun(why) => self.texts.push(format!("begun {why}")),
        }
        Ok(())
    }
}

fn take(stream: &mut LiveStream, notes: &mut Notes, text: &str, at: u64) {
    stream.take(text.as_bytes(), at, |heard| notes.hear(heard)).unwrap();
}

/// Bits that depend on the seed alone.
fn random(state: &mut u64) -> u64 {
    *state ^= *state << 13;
    *state ^= *state >> 7;
    *state ^= *state << 17;
    *state
}

#[test]
fn bad_lines_are_named_and_the_next_one_counts() {
    let mut stream = LiveStream::new("FIFO f", [0, 2]);
    let mut notes = Notes::default();
    let good = line(0, 4, 48 * MS);
    let cases = [
        ("nonsense\n".to_owned(), "line 2: expected one camera-field in JSON"),
        (good.replace("\"seq\":4,", ""), "line 3: column 116: missing key seq"),
        (good.replace("\"cam\":0", "\"cam\":1"), "line 4: cam: expected a camera of the rig, found 1"),
        (good.replace("\"cam\":0", "\"cam\":9"), "line 5: cam: expected 0 to 7"),
        (good.replace("\"x\":1", "\"x\":NaN"), "line 6: column"),
        (good.replace("72000000", "7"), "line 7: expected t_rx_ns at most 10 s after t_ns"),
        (format!("{}\n", "x".repeat(MAX_LINE_BYTES + 1)), "line 8: expected at most 65536 bytes"),
    ];
    take(&mut stream, &mut notes, &good, 1_000 * MS);
    for (text, named) in &cases {
        take(&mut stream, &mut notes, text, 1_001 * MS);
        let told = notes.texts.last().unwrap();
        assert!(told.starts_with("blob stream FIFO f, ") && told.contains(named), "{told}");
    }
    stream.take(&[0xff, 0xfe, b'\n', b'\n'], 1_002 * MS, |heard| notes.hear(heard)).unwrap();
    assert!(notes.texts.last().unwrap().contains("line 9: expected text in UTF-8"), "{:?}", notes.texts);
    take(&mut stream, &mut notes, &line(2, 4, 48 * MS), 1_003 * MS);
    let figures = stream.figures();
    assert_eq!((figures.lines, figures.bad, figures.fields), (10, 8, 2));
    assert_eq!(notes.fields, [(0, 4, 976 * MS), (2, 4, 976 * MS)]);
}

#[test]
fn a_line_may_come_in_pieces_and_its_rest_with_the_end_of_the_writer() {
    let mut stream = LiveStream::new("f", [0]);
    let mut notes = Notes::default();
    let (first, second) = (line(0, 1, 48 * MS), line(0, 2, 68 * MS));
    let text = first + second.trim_end();
    for (i, byte) in text.bytes().enumerate() {
        stream.take(&[byte], 100 * MS + i as u64, |heard| notes.hear(heard)).unwrap();
    }
    assert_eq!(notes.fields.len(), 1);
    stream.writer_gone(120 * MS, |heard| notes.hear(heard)).unwrap();
    assert_eq!(notes.fields.iter().map(|f| f.1).collect::<Vec<_>>(), [1, 2]);
}

#[test]
fn a_writer_that_begins_again_goes_on_in_numbers_and_time() {
    let mut stream = LiveStream::new("f", [0, 1]);
    let mut notes = Notes::default();
    let mut at = 5_000 * MS;
    for round in 0..3u64 {
        stream.writer_came();
        for k in 0..10 {
            // Each writer counts from 0 on a clock of its own.
            let t = 48 * MS + 3_600_000 * MS * (round % 2) + k * PERIOD;
            (0..2).for_each(|cam| take(&mut stream, &mut notes, &line(cam, k, t), at));
            at += PERIOD;
        }
        at += 300 * MS;
    }
    assert_eq!(notes.fields.len(), 60);
    for camera in 0..2 {
        let own: Vec<_> = notes.fields.iter().filter(|f| f.0 == camera).collect();
        assert_eq!(own.iter().map(|f| f.1).collect::<Vec<_>>(), (0..30).collect::<Vec<_>>());
        assert!(own.is_sorted_by(|a, b| a.2 < b.2));
    }
    let figures = stream.figures();
    assert_eq!((figures.writers, figures.time_bases, figures.doubtful), (3, 3, 0));
}

#[test]
fn lines_that_come_twice_or_late_are_left_out() {
    let mut stream = LiveStream::new("f", [0]);
    let mut notes = Notes::default();
    for (k, t) in [(1, 100), (2, 120), (2, 120), (1, 100), (3, 140)] {
        take(&mut stream, &mut notes, &line(0, k, t * MS), (1_000 + t) * MS);
    }
    assert_eq!(notes.fields.iter().map(|f| f.1).collect::<Vec<_>>(), [1, 2, 3]);
    assert_eq!(stream.figures().out_of_order, 2);
}

#[test]
fn a_stamp_that_is_wrong_alone_costs_its_line_and_one_that_lasts_ties_the_clocks_anew() {
    let hour = 3_600_000 * MS;
    let mut stream = LiveStream::new("f", [0]);
    let mut notes = Notes::default();
    let stamp = |k: u64| match k {
        200 => hour,
        300.. => 48 * MS + k * PERIOD - 2_000 * MS,
        _ => 48 * MS + k * PERIOD,
    };
    for k in 0..400 {
        take(&mut stream, &mut notes, &line(0, k, stamp(k)), 9_000 * MS + k * PERIOD);
    }
    assert_eq!(notes.texts.len(), 4, "{:?}", notes.texts);
    assert!(notes.texts[1].contains("line 201: t_rx_ns") && notes.texts[1].ends_with("3595952 ms ahead"));
    assert!(notes.texts[2].ends_with("1980 ms back"), "{:?}", notes.texts);
    assert!(notes.texts[3].starts_with("begun its stamps jumped back"), "{:?}", notes.texts);
    assert_eq!((notes.fields.len(), stream.figures().doubtful), (398, 2));
    let spacing = notes.fields.windows(2).map(|w| w[1].2 - w[0].2);
    assert!(spacing.into_iter().all(|s| s == PERIOD || s == 2 * PERIOD), "one is missing at each");
}

#[test]
fn a_shift_back_by_less_than_a_second_is_taken_over_after_two() {
    let mut clock = ClockMap::default();
    let mut begun = Vec::new();
    for k in 0..1_000u64 {
        let stamp = 10_000 * MS + k * PERIOD - if k >= 500 { 300 * MS } else { 0 };
        if let Mapped::By { begun: Some(why), .. } = clock.map(stamp, 50_000 * MS + k * PERIOD) {
            begun.push((k, why));
        }
    }
    assert_eq!(begun, [(0, Begun::First), (600, Begun::Late)]);
}

/// A million lines of three cameras: 92 hours' worth of jitter in an hour and three quarters.
#[test]
fn jitter_moves_no_exposure_and_the_guess_follows_a_drift_slowly() {
    let (mut clock, mut seed) = (ClockMap::default(), 7u64);
    let mut last: Option<i128> = None;
    let mut worst = 0;
    for k in 0..1_000_000u64 {
        let true_ns = 1_000_000 * MS + k * PERIOD / 3;
        // The writer's clock runs 50 ppm fast.
        let stamp = true_ns + true_ns / 20_000;
        let delay = random(&mut seed) % (if k.is_multiple_of(97) { 15 * MS } else { 2 * MS });
        let Mapped::By { shift_ns, begun, .. } = clock.map(stamp, true_ns + delay) else {
            panic!("line {k} is doubted");
        };
        assert_eq!(begun, (k == 0).then_some(Begun::First), "line {k}");
        let error = (i128::from(stamp) + shift_ns - i128::from(true_ns)).abs();
        if k > 600 {
            worst = worst.max(error);
            let step = last.map_or(0, |last| (shift_ns - last).abs());
            assert!(step < i128::from(MS), "line {k}: a step of {step} ns");
        }
        last = Some(shift_ns);
    }
    assert!(worst < i128::from(MS), "{worst} ns");
}

#[test]
fn what_was_told_is_followed_by_counts_and_silences_are_told_once() {
    let mut complaints = Complaints::default();
    let told: Vec<String> =
        (0..2_500u64).filter_map(|i| complaints.note(format!("line {i}"), i * MS)).collect();
    assert_eq!(told.len(), 7, "{told:?}");
    assert_eq!(told[4], "line 4");
    assert_eq!(told[5], "1000 more of 1005; the last: line 1004");
    assert_eq!(complaints.rest(2_500 * MS).unwrap(), "495 more of 2500; the last: line 2499");
    assert_eq!(complaints.rest(2_500 * MS), None);

    let mut silence = Silence::default();
    assert!(!silence.begins(9_000 * MS), "the first is waited for elsewhere");
    silence.note(10_000 * MS);
    assert!(!silence.begins(10_499 * MS) && silence.begins(10_500 * MS) && !silence.begins(10_600 * MS));
    assert_eq!((silence.note(12_000 * MS), silence.note(12_020 * MS)), (Some(2_000 * MS), None));
    silence.excuse(20_000 * MS);
    assert!(!silence.begins(20_020 * MS));
    assert_eq!((silence.count(), silence.longest_ns()), (1, 2_000 * MS));
}

#[test]
fn quantiles_of_the_jitter_are_a_thousandth_too_high_at_most() {
    let mut jitter = delays();
    assert_eq!(at_ms(&jitter, 0.5), 0.0);
    (1..=1_000).for_each(|i| jitter.saturating_record(i * 10_000));
    for (share, ms) in [(0.5, 5.0), (0.99, 9.9), (1.0, 10.0)] {
        let found = at_ms(&jitter, share);
        assert!(found >= ms && found <= ms * 1.001, "{share}: {found}");
    }
    jitter.saturating_record(u64::MAX);
    assert!(at_ms(&jitter, 1.0) >= 1e6);
}

#[test]
fn figures_are_read_back_and_told_in_words() {
    let folder = tempfile::tempdir().unwrap();
    assert_eq!(LiveFigures::left_in(folder.path()), None);
    let figures =
        LiveFigures { source: "FIFO f".into(), lines: 12, bad: 1, writers: 2, ..Default::default() };
    std::fs::write(LiveFigures::file(folder.path()), serde_json::to_vec(&figures).unwrap()).unwrap();
    assert_eq!(LiveFigures::left_in(folder.path()).as_ref(), Some(&figures));
    assert!(figures.text().starts_with("FIFO f: 12 lines, 1 bad; 2 writers, "), "{}", figures.text());
    assert_eq!(figures.short(), "live: 12 lines, 1 bad, 2 writers");
}

proptest! {
    /// However the bytes are cut, the lines are the same.
    #[test]
    fn lines_do_not_depend_on_how_they_arrive(
        text in prop::collection::vec(prop_oneof![4 => Just(b'x'), 1 => Just(b'\n')], 0..200),
        cuts in prop::collection::vec(1usize..40, 1..50),
    ) {
        let collect = |pieces: &mut dyn Iterator<Item = &[u8]>| {
            let (mut splitter, mut lines) = (LineSplitter::default(), Vec::new());
            let mut note = |n: u64, line: Result<&[u8], TooLong>| -> Result<(), Infallible> {
                lines.push((n, line.map(<[u8]>::to_vec)));
                Ok(())
            };
            pieces.for_each(|piece| splitter.feed(piece, &mut note).unwrap());
            splitter.end(&mut note).unwrap();
            lines
        };
        let whole = collect(&mut std::iter::once(&text[..]));
        let mut rest = &text[..];
        let mut cuts = cuts.iter().cycle();
        let mut pieces = std::iter::from_fn(|| {
            let (piece, after) = rest.split_at_checked((*cuts.next()?).min(rest.len()))?;
            rest = after;
            (!piece.is_empty()).then_some(piece)
        });
        let cut = collect(&mut pieces);
        prop_assert_eq!(&cut, &whole);
        let expected = text.split(|b| *b == b'\n').count() - usize::from(text.is_empty() || text.ends_with(b"\n"));
        prop_assert_eq!(whole.len(), expected);
    }

    /// Whatever stamps a writer gives, what comes out of each camera goes forward and is not ahead of now.
    #[test]
    fn what_comes_out_is_in_order_whatever_the_stamps(
        lines in prop::collection::vec((0u32..3, any::<u64>(), prop_oneof![any::<u64>(), 1..10_000_000_000u64]), 1..200),
    ) {
        let (mut stream, mut notes) = (LiveStream::new("f", 0..3), Notes::default());
        let mut at = 100_000 * MS;
        for (cam, seq, t) in lines {
            at += 7 * MS;
            let before = notes.fields.len();
            take(&mut stream, &mut notes, &line(cam, seq, t.clamp(1, u64::MAX - 24 * MS)), at);
            prop_assert!(notes.fields[before..].iter().all(|f| f.2 <= at), "{:?}", notes.fields.last());
        }
        for camera in 0..3 {
            let own: Vec<_> = notes.fields.iter().filter(|f| f.0 == camera).collect();
            prop_assert!(own.windows(2).all(|w| w[0].1 < w[1].1 && w[0].2 < w[1].2), "{own:?}");
        }
    }
}
