//! Where files of settings lie, and what they say together.

use crate::Problem;
use crate::toml_file::{Entry, read};
use protocol::file::{MAX_SETTINGS_BYTES, read_text};
use std::ffi::OsString;
use std::io::ErrorKind;
use std::path::{Path, PathBuf};

/// Name of a file of settings.
pub const NAME: &str = "vitreo.toml";
/// The folder of the one for all users of a machine.
const SYSTEM: &str = "/etc/vitreo";

/// The files that are looked for; later ones win.
#[derive(Debug, Clone, Default)]
pub struct Files {
    /// In order, whether they exist or not.
    pub paths: Vec<PathBuf>,
    /// Whether the variable of logging is set.
    pub log_variable: bool,
}

impl Files {
    /// Those of this machine, this user and this folder.
    pub fn of_this_machine() -> Self {
        Files::from_variables(|name| std::env::var_os(name))
    }

    fn from_variables(variable: impl Fn(&str) -> Option<OsString>) -> Self {
        let folder = |name: &str| variable(name).map(PathBuf::from).filter(|p| p.is_absolute());
        let own = folder("XDG_CONFIG_HOME").or_else(|| folder("HOME").map(|home| home.join(".config")));
        let paths = [Some(PathBuf::from(SYSTEM)), own.map(|f| f.join("vitreo")), Some(PathBuf::from("."))];
        let paths = paths.into_iter().flatten().map(|folder| folder.join(NAME)).collect();
        let log_variable = variable(crate::LOG_VARIABLE).is_some_and(|text| !text.is_empty());
        Files { paths, log_variable }
    }

    /// The user's own file: between the machine's and the folder's. `None` without a home.
    pub fn of_user(&self) -> Option<&Path> {
        match &self.paths[..] {
            [_, own, _] => Some(own),
            _ => None,
        }
    }

    /// Everything that the files say, in their order.
    ///
    /// # Errors
    /// Where one cannot be read, or is no TOML of this form.
    pub fn entries(&self) -> Result<Vec<Entry>, Problem> {
        let mut entries = Vec::new();
        for (number, path) in self.paths.iter().enumerate() {
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

fn is_absent(kind: ErrorKind) -> bool {
    matches!(kind, ErrorKind::NotFound | ErrorKind::NotADirectory)
}

#[cfg(test)]
mod tests {
    use super::*;

    fn places(variables: &[(&str, &str)]) -> Vec<String> {
        let find = |name: &str| variables.iter().find(|(n, _)| *n == name).map(|(_, v)| OsString::from(v));
        Files::from_variables(find).paths.iter().map(|p| p.display().to_string()).collect()
    }

    #[test]
    fn the_machine_comes_first_then_the_user_then_the_folder() {
        let (system, here) = ("/etc/vitreo/vitreo.toml", "./vitreo.toml");
        assert_eq!(places(&[("HOME", "/h")]), [system, "/h/.config/vitreo/vitreo.toml", here]);
        assert_eq!(
            places(&[("HOME", "/h"), ("XDG_CONFIG_HOME", "/c")]),
            [system, "/c/vitreo/vitreo.toml", here]
        );
        // A relative folder is none, says the convention; without a home there is no file of a user.
        assert_eq!(places(&[("XDG_CONFIG_HOME", "c")]), [system, here]);
    }

    #[test]
    fn what_is_absent_says_nothing_and_what_cannot_be_read_is_told() {
        let folder = tempfile::tempdir().unwrap();
        let files = |path: PathBuf| Files { paths: vec![path], log_variable: false };
        assert_eq!(files(folder.path().join("none/x.toml")).entries().unwrap(), []);
        let refused = files(folder.path().into()).entries().unwrap_err();
        assert!(refused.to_string().starts_with(&folder.path().display().to_string()), "{refused}");
        let picture = folder.path().join("a.toml");
        std::fs::write(&picture, b"\x89PNG\xff").unwrap();
        assert!(files(picture).entries().unwrap_err().text.contains("a PNG picture"));
    }
}
