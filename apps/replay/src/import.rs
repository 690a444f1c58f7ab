//! `vitreo import`: a rig and a blob stream of another tool become a recording.

use crate::misfits::Misfits;
use crate::new_recording::{NewRecording, claim};
use anyhow::{Context, ensure};
use blob_stream::BlobReader;
use ipc::logging::{inform, warn};
use outputs::Outputs;
use outputs::progress::counter;
use protocol::file::{MAX_SETTINGS_BYTES, read_text};
use protocol::limits::MAX_BLOBS;
use recording::{Item, Provenance, Source};
use rig::Rig;
use scene::{DEFAULT_SCENE, SceneFile};
use settings::commands::ImportArgs;
use std::collections::BTreeMap;
use std::path::Path;
use std::process::ExitCode;

/// What went into the recording.
#[derive(Debug, Default, PartialEq, Eq)]
struct Imported {
    fields: u64,
    blobs: u64,
    left_out: u64,
    misfits: Misfits,
}

impl Imported {
    /// What the tracker will not use, and why.
    fn warnings(&self) -> Vec<String> {
        let left_out = self.left_out;
        let dropped =
            (left_out > 0).then(|| format!("{left_out} blobs dropped: a field keeps the first {MAX_BLOBS}"));
        let misfits =
            self.misfits.words().into_iter().map(|what| format!("{what}: they will not be tracked"));
        dropped.into_iter().chain(misfits).collect()
    }
}

/// Runs it. A stream that is refused half-way leaves no file behind.
///
/// # Errors
/// Where rig or stream are refused, or the recording cannot be written.
pub fn run(args: &ImportArgs) -> anyhow::Result<ExitCode> {
    let scene = args.scene.as_deref().unwrap_or(DEFAULT_SCENE);
    let mut outputs = Outputs::new(args.force.force).reading_all([&args.rig, &args.blobs]).reading(scene);
    claim(&args.output, &args.writing, &mut outputs)?;
    let rig = Rig::load(&args.rig).context("--rig")?;
    let rig_json =
        read_text(&args.rig, MAX_SETTINGS_BYTES).with_context(|| args.rig.display().to_string())?;
    let provenance = provenance(rig_json, &args.blobs, scene)?;
    let stream = BlobReader::open(&args.blobs)?;
    let output = NewRecording::begin(&args.output, &args.writing, &mut outputs)?;
    let imported = copy(stream, &rig, &output, &provenance)?;
    ensure!(imported.fields > 0, "blob stream {}: contains no field", args.blobs.display());
    output.appear()?;
    let Imported { fields, blobs, .. } = imported;
    inform(&format!("{}: {fields} camera-fields with {blobs} blobs written", args.output.display()));
    imported.warnings().iter().for_each(|text| warn(text));
    Ok(ExitCode::SUCCESS)
}

/// What a recording of foreign blobs says of itself; the rig is kept as its file has it.
pub(crate) fn provenance(rig_json: String, blobs: &Path, scene: &str) -> anyhow::Result<Provenance> {
    let file = SceneFile::load(scene)?;
    let key = |key: &str, value: String| BTreeMap::from([(key.to_string(), value)]);
    Ok(Provenance {
        rig_json,
        scene_name: scene.into(),
        scene_toml: file.to_toml(),
        source: Source::Import,
        seeds: BTreeMap::new(),
        config: key("blobs", blobs.display().to_string()),
        versions: key("vitreo", env!("CARGO_PKG_VERSION").into()),
    })
}

fn copy(
    stream: BlobReader,
    rig: &Rig,
    output: &NewRecording,
    provenance: &Provenance,
) -> anyhow::Result<Imported> {
    let sensors = rig.sensors();
    let bar = counter("camera-fields");
    let mut writer = output.writer(provenance)?;
    let mut imported = Imported::default();
    for field in stream {
        let field = field?;
        imported.fields += 1;
        imported.blobs += u64::from(field.count);
        imported.left_out += u64::from(field.blobs_left_out);
        imported.misfits.note(&sensors, &field);
        writer.write(field.blobs_out_ns, &Item::Blobs(Box::new(field)))?;
        bar.inc(1);
    }
    writer.finish()?;
    bar.finish_and_clear();
    Ok(imported)
}

#[cfg(test)]
mod tests {
    use super::*;
    use outputs::Force;
    use recording::Recording;
    use settings::commands::WritingArgs;
    use std::path::PathBuf;

    const LINE: &str = r#"{"cam":0,"seq":3,"t_ns":40,"t_rx_ns":70,"parity":1,"blobs":[{"x":1.5,"y":2.5,"area":3.0,"colour":"red","w":1.0,"h":1.0}]}"#;

    fn rig_in(directory: &Path) -> PathBuf {
        let rig = directory.join("rig.json");
        std::fs::write(&rig, Rig::load_or_shipped(None).unwrap().to_json()).unwrap();
        rig
    }

    /// Of `b.jsonl` into `b.mcap`.
    fn args_in(folder: &Path, rig: PathBuf) -> ImportArgs {
        ImportArgs {
            rig,
            blobs: folder.join("b.jsonl"),
            scene: None,
            output: folder.join("b.mcap"),
            writing: WritingArgs::default(),
            force: Force::default(),
        }
    }

    #[test]
    fn every_line_arrives_even_twice_and_out_of_order() {
        let directory = tempfile::tempdir().unwrap();
        let rig = rig_in(directory.path());
        let args = args_in(directory.path(), rig);
        let earlier = LINE.replace("\"seq\":3", "\"seq\":2");
        std::fs::write(&args.blobs, format!("{LINE}\n{LINE}\n{earlier}\n")).unwrap();
        run(&args).unwrap();
        let recording = Recording::open(&args.output).unwrap();
        assert_eq!(recording.provenance().source, Source::Import);
        assert_eq!(recording.provenance().rig_json, std::fs::read_to_string(&args.rig).unwrap());
        let fields = recording.items().map(|item| match item.unwrap() {
            (70, Item::Blobs(field)) => field.field,
            other => panic!("{other:?}"),
        });
        assert_eq!(fields.collect::<Vec<_>>(), [3, 3, 2]);
    }

    #[test]
    fn fields_that_do_not_fit_the_rig_are_kept_and_warned_of() {
        let directory = tempfile::tempdir().unwrap();
        let args = args_in(directory.path(), rig_in(directory.path()));
        let [foreign, whole] = [("\"cam\":0", "\"cam\":5"), ("\"parity\":1", "\"parity\":2")]
            .map(|(from, to)| LINE.replace(from, to));
        std::fs::write(&args.blobs, format!("{LINE}\n{foreign}\n{whole}\n{whole}\n")).unwrap();
        let mut outputs = Outputs::new(false);
        claim(&args.output, &args.writing, &mut outputs).unwrap();
        let output = NewRecording::begin(&args.output, &args.writing, &mut outputs).unwrap();
        let provenance = provenance(String::new(), &args.blobs, DEFAULT_SCENE).unwrap();
        let rig = Rig::load(&args.rig).unwrap();
        let imported = copy(BlobReader::open(&args.blobs).unwrap(), &rig, &output, &provenance).unwrap();
        assert_eq!((imported.fields, imported.misfits), (4, Misfits { foreign: 1, odd_parity: 2 }));
        let warnings = imported.warnings();
        assert!(warnings[0].starts_with("1 fields of cameras that the rig lacks"), "{warnings:?}");
        assert!(warnings[1].starts_with("2 fields of a parity"), "{warnings:?}");
    }

    #[test]
    fn a_stream_without_a_field_is_refused_and_leaves_no_file() {
        let directory = tempfile::tempdir().unwrap();
        let rig = rig_in(directory.path());
        let args = args_in(directory.path(), rig);
        for text in ["", "\n\n"] {
            std::fs::write(&args.blobs, text).unwrap();
            let error = format!("{:#}", run(&args).unwrap_err());
            assert!(error.contains("b.jsonl: contains no field"), "{error}");
            assert!(!args.output.exists());
        }
    }

    #[test]
    fn a_bad_line_is_named_and_leaves_no_file() {
        let directory = tempfile::tempdir().unwrap();
        let rig = rig_in(directory.path());
        let (blobs, output) = (directory.path().join("b.jsonl"), directory.path().join("b.mcap"));
        std::fs::write(&blobs, format!("{LINE}\n{{\"cam\":0}}\n")).unwrap();
        let args = ImportArgs {
            rig,
            blobs,
            scene: None,
            output,
            writing: WritingArgs::default(),
            force: Force::default(),
        };
        let error = format!("{:#}", run(&args).unwrap_err());
        assert!(error.contains("b.jsonl") && error.contains("line 2"), "{error}");
        assert!(!args.output.exists());
    }
}
