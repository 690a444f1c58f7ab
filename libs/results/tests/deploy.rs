//! The job files of `deploy/`: they are run here as Slurm and Kubernetes would, with a stand-in for
//! the program that writes down what it is given.

use std::os::unix::fs::PermissionsExt;
use std::path::{Path, PathBuf};
use std::process::Command;
use tempfile::TempDir;
use yaml_rust2::{Yaml, YamlLoader};

fn deploy(name: &str) -> PathBuf {
    Path::new(env!("CARGO_MANIFEST_DIR")).join("../../packaging/deploy").join(name)
}

/// A folder with a program `vitreo` that writes its arguments into `given` and ends with a code, and
/// a `scontrol` that writes its own into `asked`.
fn stand_in(code: u8) -> TempDir {
    let folder = tempfile::tempdir().unwrap();
    let (program, given) = (folder.path().join("vitreo"), folder.path().join("given"));
    std::fs::write(&program, format!("#!/bin/sh\necho \"$@\" > '{}'\nexit {code}\n", given.display()))
        .unwrap();
    std::fs::set_permissions(&program, PermissionsExt::from_mode(0o755)).unwrap();
    let (control, asked) = (folder.path().join("scontrol"), folder.path().join("asked"));
    std::fs::write(&control, format!("#!/bin/sh\necho \"$@\" > '{}'\n", asked.display())).unwrap();
    std::fs::set_permissions(&control, PermissionsExt::from_mode(0o755)).unwrap();
    folder
}

/// Runs a shell with the stand-in in its path; the code it ends with and what the stand-in was
/// given.
fn run(folder: &TempDir, words: &[&str], variables: &[(&str, &str)]) -> (i32, String) {
    let path = format!("{}:/usr/bin:/bin", folder.path().display());
    let mut command = Command::new("sh");
    command.args(words).env_clear().env("PATH", path).envs(variables.iter().copied());
    let code = command.output().unwrap().status.code().unwrap();
    (code, std::fs::read_to_string(folder.path().join("given")).unwrap_or_default().trim().to_owned())
}

#[test]
fn a_slurm_task_scores_its_shard() {
    let script = deploy("slurm-score.sh");
    let script = script.to_str().unwrap();
    let task = [
        ("SLURM_ARRAY_TASK_ID", "3"),
        ("SLURM_ARRAY_TASK_COUNT", "64"),
        ("SLURM_ARRAY_TASK_MAX", "63"),
        ("SLURM_CPUS_PER_TASK", "4"),
    ];
    let words = [script, "list.txt", "scores", "--resimulate"];
    let given = "score --manifest list.txt --shard 3/64 --out scores --resume --jobs 4 --resimulate";
    for (code, ends_with) in [(0, 0), (1, 1), (3, 0), (5, 5)] {
        assert_eq!(
            run(&stand_in(code), &words, &task),
            (ends_with, given.into()),
            "the program ends with {code}"
        );
    }
    let alone = [
        ("SLURM_ARRAY_TASK_ID", "17"),
        ("SHARDS", "64"),
        ("SLURM_ARRAY_TASK_COUNT", "1"),
        ("SLURM_ARRAY_TASK_MAX", "17"),
    ];
    assert!(run(&stand_in(0), &words, &alone).1.contains("--shard 17/64"));
    assert_eq!(run(&stand_in(0), &words, &alone[..1]).1, "", "nobody says how many there are");
    let gaps = [("SLURM_ARRAY_TASK_ID", "4"), ("SLURM_ARRAY_TASK_COUNT", "3"), ("SLURM_ARRAY_TASK_MAX", "4")];
    assert_eq!(run(&stand_in(0), &words, &gaps), (2, String::new()));
    assert_eq!(run(&stand_in(0), &words, &[]).0, 2, "outside Slurm");
    assert_eq!(run(&stand_in(0), &words[..2], &task).0, 2, "without a folder to write to");
}

#[test]
fn a_slurm_task_whose_worker_was_killed_is_queued_again_twice() {
    let script = deploy("slurm-score.sh");
    let words = [script.to_str().unwrap(), "list.txt", "scores"];
    let asked = |code, restarts| {
        let task = [
            ("SLURM_JOB_ID", "812"),
            ("SLURM_ARRAY_TASK_ID", "3"),
            ("SHARDS", "64"),
            ("SLURM_RESTART_COUNT", restarts),
        ];
        let folder = stand_in(code);
        run(&folder, &words, &task[..if restarts.is_empty() { 3 } else { 4 }]);
        std::fs::read_to_string(folder.path().join("asked")).unwrap_or_default().trim().to_owned()
    };
    let again = "requeue 812";
    assert_eq!([asked(137, ""), asked(1, "0"), asked(137, "1")], [again; 3]);
    assert_eq!([asked(137, "2"), asked(0, ""), asked(2, ""), asked(3, ""), asked(5, "")], [""; 5]);
}

fn at<'y>(yaml: &'y Yaml, path: &[&str]) -> &'y Yaml {
    path.iter().fold(yaml, |yaml, key| key.parse::<usize>().map_or_else(|_| &yaml[*key], |i| &yaml[i]))
}

#[test]
fn a_pod_scores_its_shard() {
    let text = std::fs::read_to_string(deploy("kubernetes-score.yaml")).unwrap();
    let documents = YamlLoader::load_from_str(&text).unwrap();
    let [job] = documents.as_slice() else { panic!("one document") };
    let name = |path: &[&str]| at(job, path).as_str().unwrap_or_default().to_owned();
    assert_eq!((name(&["apiVersion"]), name(&["kind"])), ("batch/v1".into(), "Job".into()));
    assert_eq!(name(&["spec", "completionMode"]), "Indexed");
    let pod = &["spec", "template", "spec"];
    assert_eq!(
        at(&job[pod[0]][pod[1]][pod[2]], &["restartPolicy"]).as_str(),
        Some("Never"),
        "a failure policy needs it"
    );
    let rules = at(job, &["spec", "podFailurePolicy", "rules"]).as_vec().unwrap();
    let rules = rules.iter().map(|r| (r["action"].as_str().unwrap(), r["onExitCodes"]["values"][0].as_i64()));
    let rules: Vec<_> = rules.collect();
    assert_eq!(rules, [("FailJob", Some(2)), ("FailIndex", Some(5))], "what another try would not mend");
    let container = at(job, &["spec", "template", "spec", "containers", "0"]);
    let variables = container["env"].as_vec().unwrap();
    let value = |name: &str| {
        let found = variables.iter().find(|v| v["name"].as_str() == Some(name));
        found.and_then(|v| v["value"].as_str()).unwrap_or_else(|| panic!("{name}"))
    };
    let shards = value("SHARDS");
    assert_eq!(at(job, &["spec", "completions"]).as_i64().map(|n| n.to_string()).as_deref(), Some(shards));
    let folders: Vec<&str> = container["volumeMounts"]
        .as_vec()
        .unwrap()
        .iter()
        .map(|m| m["mountPath"].as_str().unwrap())
        .collect();
    assert!(
        ["MANIFEST", "OUT"].iter().all(|v| folders.iter().any(|f| value(v).starts_with(f))),
        "{folders:?}"
    );
    let words: Vec<&str> = container["command"].as_vec().unwrap().iter().filter_map(Yaml::as_str).collect();
    assert_eq!(words, ["/bin/sh", "-c"]);
    let line = container["args"][0].as_str().unwrap();
    let pod = [
        ("SHARDS", shards),
        ("MANIFEST", value("MANIFEST")),
        ("OUT", value("OUT")),
        ("JOB_COMPLETION_INDEX", "9"),
    ];
    let given = format!(
        "score --manifest /recordings/manifest.txt --shard 9/{shards} --out /scores --resume --jobs 4"
    );
    for (code, ends_with) in [(0, 0), (1, 1), (2, 2), (3, 0)] {
        assert_eq!(
            run(&stand_in(code), &["-c", line], &pod),
            (ends_with, given.clone()),
            "the program ends with {code}"
        );
    }
    assert_ne!(run(&stand_in(0), &["-c", line], &pod[..3]).0, 0, "outside an indexed job");
}
