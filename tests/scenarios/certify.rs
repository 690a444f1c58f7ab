//! `vitreo certify`, short and beside no load: what it counts, loses and writes. No time is judged.

use protocol::poses::TrackerFrame;
use vitreo_tests::{Observer, Running, instance_name, interrupt, json, next, repository, vitreo};

#[test]
fn a_short_certificate_counts_every_triple_and_is_written_in_three_forms() {
    let folder = tempfile::tempdir().expect("folder");
    let [html, markdown, figures] = ["c.html", "c.md", "c.json"].map(|name| folder.path().join(name));
    let paths = [&html, &markdown, &figures].map(|path| path.to_str().expect("UTF-8"));
    let reports = paths.map(|path| ["--report", path]).concat();
    let name = instance_name();
    let words = ["certify", "--triples", "600", "--at-speed", "400", "--load", "none", "--instance", &name];
    let finished = vitreo(&[&words[..], &reports].concat()).expect_code(0);
    let report = json(&figures);
    assert_eq!(report["format"], "vitreo-certificate-1");
    for (stream, triples) in [("real_time", 600), ("at_speed", 400)] {
        let found = &report[stream];
        assert_eq!((&found["triples"], &found["drops"]), (&triples.into(), &0.into()), "{stream}: {report}");
        assert_eq!(found["blocks_lost"], 0, "{stream}");
    }
    assert_eq!(report["latency"]["count"], 600);
    let histogram = report["latency_histogram"].as_array().expect("a histogram");
    let counted: u64 = histogram.iter().map(|bin| bin["count"].as_u64().expect("a count")).sum();
    assert_eq!(counted, 600, "every latency is in it once");
    assert_eq!([0, 1].map(|n| report["floor"][n]["count"].as_u64()), [Some(150); 2]);
    assert_eq!((&report["stopped"], &report["slowest"]["count"]), (&false.into(), &1.into()));
    let slowest = &report["slowest"]["listed"][0];
    let parts: f64 =
        slowest["parts_ms"].as_array().expect("parts").iter().map(|ms| ms.as_f64().expect("ms")).sum();
    let longest = report["latency"]["max_ms"].as_f64().expect("ms");
    assert!((parts - longest).abs() < 1e-6, "the slowest triple is the longest latency: {slowest}");
    assert!(finished.stderr.contains(" of 800 triples sent"), "it says how far it is: {}", finished.stderr);
    for body in report["bodies"].as_array().expect("bodies") {
        assert_eq!(
            body["static_frames"].as_u64().zip(body["moving_frames"].as_u64()).map(|(a, b)| a + b > 550),
            Some(true),
            "{body}"
        );
        let [noise, error] =
            ["static_noise_um", "moving_error_um"].map(|key| body[key].as_f64().expect("µm"));
        assert!(noise < 20.0 && error < 50.0, "the poses are those of the stream: {body}");
    }
    let page = std::fs::read_to_string(&html).expect("the page");
    assert!(page.contains("<svg") && page.ends_with("</html>\n"), "{page}");
    let page = std::fs::read_to_string(&markdown).expect("the page");
    assert_eq!(page, finished.stdout, "it prints what it writes");
    for heading in ["## Latency", "## Static noise", "## Range of motion", "## Drops"] {
        assert!(page.contains(heading), "{page}");
    }
    // Nothing is written over, and nothing is measured for it.
    let refused = vitreo(&["certify", "--report", paths[0], "--instance", &name]).expect_code(1);
    assert!(refused.stderr.contains("already exists"), "{refused:?}");
}

#[test]
fn one_that_is_stopped_certifies_nothing_and_leaves_nothing() {
    let folder = tempfile::tempdir().expect("folder");
    let page = folder.path().join("c.md");
    let name = instance_name();
    let report = page.to_str().expect("UTF-8");
    let words = ["certify", "--load", "none", "--report", report, "--instance", &name];
    let running = Running::start(&words);
    // It has its instance: from here on signals are its own.
    drop(Observer::join(&name));
    interrupt(running.pid());
    let finished = running.finish().expect_code(130);
    assert!(finished.stderr.contains("nothing is certified") && finished.stdout.is_empty(), "{finished:?}");
    assert_eq!(std::fs::read_dir(folder.path()).expect("folder").count(), 0);
}

#[test]
fn one_that_is_stopped_while_triples_are_sent_certifies_those() {
    let folder = tempfile::tempdir().expect("folder");
    let [page, figures] = ["c.md", "c.json"].map(|name| folder.path().join(name));
    let [markdown, json_file] = [&page, &figures].map(|path| path.to_str().expect("UTF-8"));
    let name = instance_name();
    let words = ["certify", "--triples", "4000", "--at-speed", "1000", "--load", "none", "--instance", &name];
    let running = Running::start(&[&words[..], &["--report", markdown, "--report", json_file]].concat());
    let mut poses = Observer::join(&name).receiver::<TrackerFrame>();
    // The first 200 do not count.
    next(&mut poses, |frame| frame.field > 300);
    interrupt(running.pid());
    let finished = running.finish().expect_code(130);
    let report = json(&figures);
    let sent = report["real_time"]["triples"].as_u64().expect("a count");
    assert!((100..4_000).contains(&sent), "{report}");
    assert_eq!((&report["stopped"], &report["asked"]), (&true.into(), &4_000.into()));
    assert_eq!((&report["real_time"]["drops"], &report["latency"]["count"]), (&0.into(), &sent.into()));
    assert_eq!(
        (report["floor"].as_array().map(Vec::len), &report["at_speed"]),
        (Some(1), &serde_json::Value::Null)
    );
    let said = format!("covers {sent} of 4000 triples");
    assert!(finished.stderr.contains(&said), "{finished:?}");
    let page = std::fs::read_to_string(&page).expect("the page");
    assert!(page.contains(&format!("{sent} of 4000 triples were sent")), "{page}");
}

#[test]
fn a_rig_of_rolling_interlaced_cameras_is_certified_as_well_and_odd_asks_are_refused() {
    let rig = repository().join("assets/rig.json");
    let rig = rig.to_str().expect("UTF-8");
    let name = instance_name();
    let words = ["certify", "--rig", rig, "--triples", "60", "--load", "none", "--instance", &name];
    let finished = vitreo(&words).expect_code(0);
    assert!(finished.stdout.contains("3 cameras, 50 Hz"), "{finished:?}");
    assert!(finished.stdout.contains("| in real time | 60 | 0 |"), "{finished:?}");
    for odd in [["--triples", "0"], ["--report", "a.pdf"], ["--load", "much"], ["--duration", "-1"]] {
        vitreo(&["certify", odd[0], odd[1]]).expect_code(2);
    }
    let absent = vitreo(&["certify", "--rig", "/no/such.json"]);
    assert!(absent.code == Some(1) && absent.stderr.contains("/no/such.json"), "{absent:?}");
}
