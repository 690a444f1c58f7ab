//! Paths of the settings files and their combined contents.

use crate::Problem;
use crate::toml_file::{Entry, read};
use protocol::file::{MAX_SETTINGS_BYTES, read_text};
use std::ffi::OsString;
use std::io::ErrorKind;
use std::os::unix::fs::MetadataExt;
use std::path::{Path, PathBuf};

/// Name of a settings file.
pub const NAME: &str = "vitreo.toml";
/// User id of root.
const ROOT: u32 = 0;
/// Folder of the settings file for all users of the machine.
const SYSTEM: &str = "/etc/vitreo";

/// Search path of the settings files; later files take precedence.
#[derive(Debug, Clone, Default)]
pub struct Files {
    /// Paths in order of precedence, lowest first: machine, user, current folder. The files may be missing.
    pub paths: Vec<PathBuf>,
    /// True if the environment variable of logging is set.
    pub log_variable: bool,
    /// Why the file in the current folder is ignored.
    pub passed_over: Option<String>,
}

impl Files {
    /// Search path for this machine, this user and the current folder.
    pub fn of_this_machine() -> Self {
        let found = Files::from_variables(|name| std::env::var_os(name));
        let passed_over =
            found.paths.last().and_then(|path| reason_to_distrust(path, rustix::process::geteuid().as_raw()));
        Files { passed_over, ..found }
    }

    fn from_variables(variable: impl Fn(&str) -> Option<OsString>) -> Self {
        let folder = |name: &str| variable(name).map(PathBuf::from).filter(|p| p.is_absolute());
        let own = folder("XDG_CONFIG_HOME").or_else(|| folder("HOME").map(|home| home.join(".config")));
        let paths = [Some(PathBuf::from(SYSTEM)), own.map(|f| f.join("vitreo")), Some(PathBuf::from("."))];
        let paths = paths.into_iter().flatten().map(|folder| folder.join(NAME)).collect();
        let log_variable = variable(crate::LOG_VARIABLE).is_some_and(|text| !text.is_empty());
        Files { paths, log_variable, passed_over: None }
    }

    /// Path of the user's own file; `None` without a home folder.
    pub fn of_user(&self) -> Option<&Path> {
        match &self.paths[..] {
            [_, own, _] => Some(own),
            _ => None,
        }
    }

    /// Reads all files; returns their entries in the order of the files.
    ///
    /// # Errors
    /// If a file exists but cannot be read, or is not valid TOML for settings.
    pub fn entries(&self) -> Result<Vec<Entry>, Problem> {
        let mut entries = Vec::new();
        let read_here = self.paths.len() - usize::from(self.passed_over.is_some());
        for (number, path) in self.paths.iter().take(read_here).enumerate() {
            let file = path.display().to_string();
            match read_text(path, MAX_SETTINGS_BYTES) {
                Ok(text) => entries.extend(read(&text, &file, number)?),
                Err(e) if is_absent(e.kind()) => {}
                Err(e) => return Err(Problem { file, line: None, text: e.to_string() }),
            }
        }
        Ok(entries)
    }
}

/// Reason to distrust the file in the current folder: it belongs to neither the user `own` nor root, or every
/// user may write to it.
fn reason_to_distrust(path: &Path, own: u32) -> Option<String> {
    let found = path.metadata().ok()?;
    let why = match (found.uid(), found.mode() & 0o7777) {
        (owner, _) if owner != own && owner != ROOT => format!("it belongs to user {owner}"),
        (_, mode) if mode & 0o002 != 0 => format!("other users may write to it (mode {mode:04o})"),
        _ => return None,
    };
    Some(format!("{}: not read: {why}", path.display()))
}

fn is_absent(kind: ErrorKind) -> bool {
    matches!(kind, ErrorKind::NotFound | ErrorKind::NotADirectory)
}

#[cfg(test)]
mod tests {
    use super::*;

    fn paths_of(variables: &[(&str, &str)]) -> Vec<String> {
        let find = |name: &str| variables.iter().find(|(n, _)| *n == name).map(|(_, v)| OsString::from(v));
        Files::from_variables(find).paths.iter().map(|p| p.display().to_string()).collect()
    }

    #[test]
    fn the_machine_comes_first_then_the_user_then_the_folder() {
        let (system, here) = ("/etc/vitreo/vitreo.toml", "./vitreo.toml");
        assert_eq!(paths_of(&[("HOME", "/h")]), [system, "/h/.config/vitreo/vitreo.toml", here]);
        assert_eq!(
            paths_of(&[("HOME", "/h"), ("XDG_CONFIG_HOME", "/c")]),
            [system, "/c/vitreo/vitreo.toml", here]
        );
        // The XDG convention ignores relative folders. Without a home folder there is no user's file.
        assert_eq!(paths_of(&[("XDG_CONFIG_HOME", "c")]), [system, here]);
    }

    #[test]
    fn a_file_of_another_user_or_one_that_others_may_write_is_not_read() {
        use std::os::unix::fs::PermissionsExt;
        let folder = tempfile::tempdir().unwrap();
        let path = folder.path().join(NAME);
        let own = folder.path().metadata().unwrap().uid();
        assert_eq!(reason_to_distrust(&path, own), None, "there is none");
        std::fs::write(&path, "[run]\nlevel = 2\n").unwrap();
        for (mode, told) in
            [(0o644, None), (0o600, None), (0o666, Some("(mode 0666)")), (0o602, Some("0602"))]
        {
            std::fs::set_permissions(&path, std::fs::Permissions::from_mode(mode)).unwrap();
            let found = reason_to_distrust(&path, own);
            assert_eq!(found.is_some(), told.is_some(), "{mode:o}: {found:?}");
            assert!(found.unwrap_or_default().contains(told.unwrap_or_default()));
        }
        std::fs::set_permissions(&path, std::fs::Permissions::from_mode(0o644)).unwrap();
        if own != ROOT {
            let told = reason_to_distrust(&path, own + 1).unwrap();
            assert!(told.ends_with(&format!("vitreo.toml: not read: it belongs to user {own}")), "{told}");
        }
        std::os::unix::fs::chown(&path, Some(own.max(1)), None).unwrap();
        assert!(reason_to_distrust(&path, own.max(1) + 1).unwrap().contains("it belongs to user"));
        let mut files = Files { paths: vec![path], ..Files::default() };
        assert_eq!(files.entries().unwrap().len(), 1);
        files.passed_over = Some("not read".into());
        assert_eq!(files.entries().unwrap(), []);
    }

    #[test]
    fn what_is_absent_says_nothing_and_what_cannot_be_read_is_told() {
        let folder = tempfile::tempdir().unwrap();
        let files = |path: PathBuf| Files { paths: vec![path], ..Files::default() };
        assert_eq!(files(folder.path().join("none/x.toml")).entries().unwrap(), []);
        let refused = files(folder.path().into()).entries().unwrap_err();
        assert!(refused.to_string().starts_with(&folder.path().display().to_string()), "{refused}");
        let picture = folder.path().join("a.toml");
        std::fs::write(&picture, b"\x89PNG\xff").unwrap();
        assert!(files(picture).entries().unwrap_err().text.contains("a PNG picture"));
    }
}
