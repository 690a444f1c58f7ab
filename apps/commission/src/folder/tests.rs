//! The folder: what is refused, what is kept, and that any text is read or refused.

use super::*;
use proptest::prelude::*;

#[test]
fn a_folder_of_something_else_is_left_alone() {
    let folder = tempfile::tempdir().unwrap();
    let path = folder.path().join("new");
    assert_eq!(Folder::open(&path).unwrap().state.next(), Some(Step::Colours));
    std::fs::create_dir(&path).unwrap();
    std::fs::write(path.join("rig.json"), "{}").unwrap();
    let told = Folder::open(&path).err().unwrap().to_string();
    assert!(told.contains("holds rig.json but no commission.json"), "{told}");
    let file = folder.path().join("file");
    std::fs::write(&file, "").unwrap();
    assert!(Folder::open(&file).err().unwrap().to_string().contains("expected a folder"));
}

#[test]
fn what_was_there_is_kept_beside_and_a_step_is_done_once() {
    let folder = tempfile::tempdir().unwrap();
    let mut own = Folder::open(folder.path()).unwrap();
    let mut rig = Rig::load_or_shipped(None).unwrap();
    for fx in [1500.0, 1501.0] {
        rig.cameras[0].fx = fx;
        let mut outcome = Outcome { rig: Some(rig.clone()), ..Outcome::default() };
        outcome.pictures.push(("a.png".into(), "shows <a>".into(), vec![1, 2, 3]));
        own.take(Step::Lenses, outcome).unwrap();
    }
    let again = Folder::open(folder.path()).unwrap();
    assert_eq!(again.state, own.state);
    assert_eq!(again.rig(None).unwrap().cameras[0].fx, 1501.0);
    let before = Rig::load(&folder.path().join("rig-before-lenses.json")).unwrap();
    assert_eq!(before.cameras[0].fx, 1500.0);
    assert!(again.claim(Step::Lenses, false).unwrap_err().to_string().contains("--force"));
    again.claim(Step::Lenses, true).unwrap();
    again.claim(Step::Poses, false).unwrap();
    let page = std::fs::read_to_string(folder.path().join("report.html")).unwrap();
    assert!(page.contains("data:image/png;base64,AQID") && page.contains("shows &lt;a&gt;"), "{page}");
    let other = folder.path().join("other.json");
    std::fs::write(&other, rig.to_json()).unwrap();
    assert!(again.rig(Some(&other)).unwrap_err().to_string().contains("exists already and is continued"));
    again.rig(Some(&folder.path().join("rig.json"))).unwrap();
}

#[test]
fn formats_and_names_that_cannot_be_are_refused_in_words() {
    for (text, named) in [
        ("{", "x.json"),
        (r#"{"format": "vitreo-rig-1", "steps": {}}"#, "vitreo-commission-1"),
        (r#"{"format": "vitreo-commission-1", "steps": {"lunch": {}}}"#, "lunch"),
        (
            r#"{"format": "vitreo-commission-1", "steps": {"check": {"from": [], "summary": "", "kept": false,
            "figures": [], "notes": [], "advice": [], "pictures": [["../../etc/passwd", "x"]]}}}"#,
            "expected a name such as rig.png",
        ),
    ] {
        let told = State::parse(text, "x.json").unwrap_err().to_string();
        assert!(told.contains(named), "{told}");
    }
}

proptest! {
    #[test]
    fn any_text_is_read_or_refused(text in ".{0,200}") {
        let _ = State::parse(&text, "any");
    }

    #[test]
    fn what_is_written_is_read(summary in ".{0,40}", figure in ".{0,20}", kept: bool) {
        let mut state = State::default();
        let record = Record { summary, kept, figures: vec![(figure.clone(), figure)], ..Record::default() };
        state.steps.insert(Step::Check, record);
        let text = serde_json::to_string(&state).unwrap();
        prop_assert_eq!(State::parse(&text, "own").unwrap(), state);
    }
}
