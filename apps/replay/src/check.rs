//! `vitreo check`: whether recordings are whole, in order and without gaps.

mod items;

use ipc::logging::{warn, with_causes};
use items::{Checker, Finding};
use outputs::exit::LOSS;
use outputs::println;
use recording::Recording;
use rig::Rig;
use scene::SceneFile;
use serde::Serialize;
use settings::commands::CheckArgs;
use std::path::Path;
use std::process::ExitCode;

/// What was found in a recording.
#[derive(Debug, Default, Serialize)]
struct Report {
    file: String,
    /// Records and their checksums; compared are messages that could be read.
    records: Finding,
    /// Rig, scene and end of the file.
    contents: Finding,
    order: Finding,
    clocks: Finding,
    gaps: Finding,
}

impl Report {
    fn findings(&self) -> [(&'static str, &Finding); 5] {
        let Report { records, contents, order, clocks, gaps, .. } = self;
        [("records", records), ("contents", contents), ("order", order), ("clocks", clocks), ("gaps", gaps)]
    }

    fn is_good(&self) -> bool {
        self.findings().iter().all(|(_, finding)| finding.problems == 0) && self.records.compared > 0
    }

    fn print(&self) {
        println!("{}", self.file);
        for (name, Finding { compared, problems, first }) in self.findings() {
            match problems {
                0 => println!("  {name:<9} ok      {compared} compared"),
                _ => println!("  {name:<9} WRONG   {problems} of {compared}"),
            }
            first.iter().filter(|text| !text.is_empty()).for_each(|text| println!("            {text}"));
        }
    }
}

/// Runs it. Exit code 3 where a recording is not as it should be.
///
/// # Errors
/// Where the one recording that is named cannot be read at all.
pub fn run(args: &CheckArgs) -> anyhow::Result<ExitCode> {
    let mut code = ExitCode::SUCCESS;
    for file in &args.files {
        match check(file) {
            Ok(report) => {
                if args.json {
                    println!("{}", serde_json::to_string(&report)?);
                } else {
                    report.print();
                }
                if !report.is_good() {
                    code = ExitCode::from(LOSS);
                }
            }
            Err(problem) if args.files.len() == 1 => return Err(problem),
            Err(problem) => {
                warn(&with_causes(problem.as_ref()));
                code = ExitCode::from(LOSS);
            }
        }
    }
    Ok(code)
}

fn check(file: &Path) -> anyhow::Result<Report> {
    let recording = Recording::open_in_doubt(file)?;
    let mut report = Report { file: file.display().to_string(), ..Report::default() };
    contents(&recording, &mut report.contents);
    let mut checker = Checker::default();
    for item in recording.items() {
        match item {
            Ok((at, item)) => {
                report.records.compared += 1;
                checker.take(at, &item);
            }
            Err(problem) => report.records.add(1, || problem.to_string()),
        }
    }
    if report.records.compared == 0 {
        report.records.add(1, || "no message can be read".into());
    }
    (report.order, report.clocks, report.gaps) = (checker.order, checker.clocks, checker.gaps);
    Ok(report)
}

/// What stands around the messages.
fn contents(recording: &Recording, finding: &mut Finding) {
    let provenance = recording.provenance();
    if let Some(doubt) = recording.doubt() {
        finding.add(1, || doubt.to_string());
    }
    finding.check(recording.is_finished(), || "the recording was not closed properly".into());
    let rig = Rig::parse(&provenance.rig_json, "of the recording");
    let rig = rig.map_err(|problem| problem.to_string());
    let works = rig.and_then(|rig| tracker::rig_check::check(&rig).map_err(|problem| problem.to_string()));
    finding.check(works.is_ok(), || works.err().unwrap_or_default());
    let scene = SceneFile::parse(&provenance.scene_toml, "of the recording");
    finding.check(scene.is_ok(), || scene.err().map(|problem| problem.to_string()).unwrap_or_default());
}

#[cfg(test)]
mod tests {
    use super::*;
    use recording::{Item, Writer};
    use std::path::PathBuf;

    fn golden() -> PathBuf {
        Path::new(env!("CARGO_MANIFEST_DIR")).join("../../tests/data/golden/peel-2s.mcap")
    }

    #[test]
    fn a_good_recording_is_compared_in_everything() {
        let report = check(&golden()).unwrap();
        assert!(report.is_good(), "{report:?}");
        assert!(report.findings().iter().all(|(_, finding)| finding.compared > 0), "{report:?}");
    }

    #[test]
    fn a_lost_field_and_a_cut_end_are_found() {
        let folder = tempfile::tempdir().unwrap();
        let (lost, cut) = (folder.path().join("lost.mcap"), folder.path().join("cut.mcap"));
        let recording = Recording::open(&golden()).unwrap();
        let mut writer = Writer::create(&lost, recording.provenance()).unwrap();
        let mut fields = 0;
        for item in recording.items() {
            let (at, item) = item.unwrap();
            fields += u32::from(matches!(item, Item::Blobs(_)));
            if !(matches!(item, Item::Blobs(_)) && fields == 60) {
                writer.write(at, &item).unwrap();
            }
        }
        writer.finish().unwrap();
        let report = check(&lost).unwrap();
        assert_eq!((report.gaps.problems, report.records.problems), (1, 0), "{report:?}");
        assert!(report.gaps.first[0].contains("camera"), "{report:?}");
        let whole = std::fs::read(golden()).unwrap();
        std::fs::write(&cut, &whole[..whole.len() / 2]).unwrap();
        let report = check(&cut).unwrap();
        assert!(report.records.problems > 0 && report.contents.problems == 1, "{report:?}");
        std::fs::write(&cut, "no recording").unwrap();
        assert!(check(&cut).unwrap_err().to_string().contains("cut.mcap"));
    }
}
