//! Tests of the command line of `vitreo run`.

use super::*;
use clap::Parser;

#[derive(Parser)]
struct Line {
    #[command(flatten)]
    run: RunArgs,
}

fn parse(args: &[&str]) -> Result<RunArgs, String> {
    let line = Line::try_parse_from(std::iter::once(&"run").chain(args));
    line.map(|l| l.run).map_err(|e| e.to_string())
}

#[test]
fn a_display_opens_a_window_unless_told_otherwise() {
    let view = |args: &[&str], display| parse(args).unwrap().view(display);
    assert_eq!(view(&[], true), View::Window);
    assert_eq!(view(&[], false), View::Headless);
    assert_eq!(view(&["--headless"], true), View::Headless);
    assert_eq!(view(&["--window"], false), View::Window);
    assert_eq!(view(&["--no-picture"], true), View::None);
}

#[test]
fn options_that_exclude_each_other_are_refused() {
    for wrong in [
        &["--headless", "--window"][..],
        &["--motion-full"],
        &["--blobs", "b.jsonl"],
        &["--motion", "m.csv", "--blobs", "b", "--rig", "r"],
        &["--duration", "0"],
        &["--duration", "NaN"],
        &["--percentile", "101"],
        &["--inject-delay", "whole-system=3"],
        &["--inject-delay", "tracking=-1"],
        &["--inject-delay", "tracking"],
        &["--no-picture", "--video", "v.y4m"],
    ] {
        assert!(parse(wrong).is_err(), "{wrong:?} was taken");
    }
}

#[test]
fn each_delay_reaches_the_process_of_its_stage() {
    let stages = ["camera", "camera-wait", "tracking", "simulation", "rendering"];
    for (slow, stage) in stages.iter().enumerate() {
        let args = parse(&["--inject-delay", &format!("{stage}=7")]).unwrap();
        let delayed: Vec<Process> = Process::ALL
            .into_iter()
            .filter(|&p| p != Process::Desk)
            .filter(|&p| {
                let given = args.arguments_of(p, View::Headless, None, 0);
                given.windows(2).any(|w| w == ["--inject-delay-ms", "7"] || w == ["--late-camera", "2=7"])
            })
            .collect();
        let owner = [1, 0, 2, 3, 4][slow];
        assert_eq!(delayed, [Process::ALL[owner]], "{stage}");
    }
}

#[test]
fn without_pixels_the_rig_sends_the_blobs_and_is_delayed_itself() {
    let args = parse(&["--direct", "--inject-delay", "camera=7"]).unwrap();
    assert_eq!(args.trackers(), [Process::Tracker]);
    let given = args.arguments_of(Process::VirtualRig, View::Headless, None, 0).join(" ");
    assert_eq!(given, "--inject-delay-ms 7 --seed 1 --direct");
}

#[test]
fn each_process_gets_what_it_understands() {
    let args =
        parse(&["--rig", "r.json", "--scene", "peel", "--seed", "9", "--stills", "s", "--collision", "cpu"])
            .unwrap();
    let of = |p| args.arguments_of(p, View::Headless, Some(2.5), 0).join(" ");
    assert_eq!(of(Process::VirtualRig), "--rig r.json --scene peel --seed 9 --duration 2.5");
    assert_eq!(of(Process::FpgaModel), "--rig r.json");
    assert_eq!(of(Process::Tracker), "--rig r.json");
    assert_eq!(of(Process::Simcore), "--scene peel --collision cpu");
    assert_eq!(of(Process::Renderer), "--rig r.json --scene peel --headless --stills s");
}

#[test]
fn the_renderer_learns_how_the_channels_share_the_display() {
    let args = parse(&["--full-screen", "--monitor", "1", "--arrange", "interleaved"]).unwrap();
    let given = args.arguments_of(Process::Renderer, args.view(false), None, 0).join(" ");
    assert_eq!(given, "--window --arrange interleaved --full-screen --monitor 1");
    assert!(parse(&["--monitor", "1"]).is_err() && parse(&["--headless", "--full-screen"]).is_err());
    assert!(parse(&["--arrange", "cross-eyed"]).unwrap_err().contains("anaglyph"));
}

#[test]
fn the_desk_takes_the_place_of_cameras_and_tracker() {
    let mut args = parse(&["--module", "navigation"]).unwrap();
    assert_eq!(args.source(), Process::VirtualRig);
    assert_eq!(args.trackers(), [Process::Tracker, Process::FpgaModel]);
    args.desk = Some(DeskArgs { input: Some("mouse".into()), inputs: None });
    let given = |args: &RunArgs, p| args.arguments_of(p, View::Window, None, 0).join(" ");
    assert_eq!((args.source(), given(&args, Process::Desk).as_str()), (Process::Desk, "--input mouse"));
    assert!(args.trackers().is_empty());
    assert_eq!(given(&args, Process::Renderer), "--window --desk");
    args.desk = Some(DeskArgs { input: None, inputs: Some("moves.txt".into()) });
    assert_eq!(given(&args, Process::Desk), "--inputs moves.txt");
}

#[test]
fn real_cameras_take_the_place_of_script_and_rig() {
    let args = parse(&["--cameras", "driver", "--rig", "r.json", "--scene", "trim", "--seed", "3"]).unwrap();
    assert!(!args.is_scripted() && parse(&["--scene", "trim"]).unwrap().is_scripted());
    assert_eq!(args.source(), Process::VirtualRig);
    assert_eq!(args.trackers(), [Process::Tracker, Process::FpgaModel]);
    let given = |args: &RunArgs| args.arguments_of(Process::VirtualRig, View::None, Some(9.0), 1).join(" ");
    assert_eq!(given(&args), "--rig r.json");
    let blobs = parse(&["--cameras", "driver", "--rig", "r.json", "--direct"]).unwrap();
    assert_eq!((blobs.trackers(), given(&blobs).as_str()), (&[Process::Tracker][..], "--rig r.json"));
    assert!(parse(&["--unscripted", "--blobs", "b", "--rig", "r"]).is_err());
    let streams = ["--cameras", "y4m:a,y4m:b?parity=1", "--rig", "r.json", "--scene", "trim", "--seed", "3"];
    let streams = parse(&streams).unwrap();
    assert_eq!(given(&streams), "--rig r.json --scene trim --cameras y4m:a,y4m:b?parity=1 --duration 9");
    assert!(!streams.is_scripted() && streams.trackers().contains(&Process::FpgaModel));
    let invented = parse(&["--cameras", "virtual", "--rig", "r.json"]).unwrap();
    assert!(invented.is_scripted() && given(&invented).contains("--seed 1 --duration 9"));
    assert!(parse(&["--cameras", "y4m:a,b", "--rig", "r.json"]).is_err());
    // A script's length must not end the attempt of a person.
    let of_module = parse(&["--module", "navigation", "--cameras", "driver", "--rig", "r.json"]).unwrap();
    let composed = Composed::new("navigation", 1, "expert", 1).unwrap();
    assert_eq!(of_module.with_scene_of(Some(&composed)).duration, None);
}

#[test]
fn faults_reach_the_cameras_and_nobody_else() {
    let args = parse(&["--faults", "mild,dropped", "--fault-log", "f.jsonl"]).unwrap();
    let of = |p, restarts| args.arguments_of(p, View::Headless, None, restarts).join(" ");
    let cameras = of(Process::VirtualRig, 0);
    assert_eq!(cameras, "--seed 1 --faults mild,dropped --fault-log f.jsonl");
    assert!(of(Process::VirtualRig, 1).ends_with("f-2.jsonl"), "a restart keeps what was written");
    assert!(!of(Process::Tracker, 0).contains("fault") && !of(Process::Simcore, 0).contains("fault"));
    assert!(parse(&["--fault-log", "f"]).is_err(), "no faults, no log");
    for option in ["--rig", "--motion", "--budgets", "--fundus", "--instruments", "--faults"] {
        let missing = parse(&[option, "/nowhere/f.toml"]).unwrap().prepare().unwrap_err().to_string();
        assert!(missing.starts_with(&format!("{option} /nowhere/f.toml: No such file")), "{missing}");
    }
}

#[test]
fn a_restarted_renderer_does_not_write_over_what_there_is() {
    let args = parse(&["--video", "out/a.y4m"]).unwrap();
    let film = |restarts| args.arguments_of(Process::Renderer, View::Headless, None, restarts).pop();
    assert_eq!(film(0).as_deref(), Some("out/a.y4m"));
    assert_eq!(film(2).as_deref(), Some("out/a-3.y4m"));
}

#[test]
fn the_percentile_of_the_command_line_wins() {
    assert_eq!(parse(&["--percentile", "95"]).unwrap().budget_table().unwrap().percentile, 95.0);
    assert_eq!(parse(&[]).unwrap().budget_table().unwrap(), Budgets::default());
}

#[test]
fn every_process_of_ours_is_traced_and_no_foreign_one() {
    let given = |words: &[&str], process| {
        let args = parse(words).unwrap().arguments_of(process, View::Headless, None, 0);
        let at = args.iter().position(|arg| arg == "--trace-spans");
        at.map(|at| args[at + 1].parse::<u32>().unwrap() / ipc::trace::SPANS_PER_SECOND)
    };
    for process in Process::ALL {
        assert_eq!(given(&[], process), None);
        assert_eq!(given(&["--trace-out", "t.json"], process), Some(30));
        assert_eq!(given(&["--trace-out", "t.json", "--trace-seconds", "600"], process), Some(600));
    }
    let real = ["--trace-out", "t.json", "--cameras", "driver", "--rig", "r.json"];
    assert_eq!(given(&real, Process::VirtualRig), None);
    assert_eq!(given(&real, Process::Tracker), Some(30));
}
