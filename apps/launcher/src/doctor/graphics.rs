//! Checks for display, graphics hardware, Vulkan loader and Vulkan drivers.

use super::Check;
use crate::machine::has_display;
use std::fs;
use std::path::{Path, PathBuf};

/// Folders in which the Vulkan loader searches driver manifests, unless `VK_DRIVER_FILES` is set.
const MANIFEST_FOLDERS: [&str; 3] =
    ["/usr/share/vulkan/icd.d", "/etc/vulkan/icd.d", "/usr/local/share/vulkan/icd.d"];
/// Folders in which shared libraries are searched.
const LIBRARY_FOLDERS: [&str; 6] = [
    "/usr/lib/x86_64-linux-gnu",
    "/usr/lib/aarch64-linux-gnu",
    "/usr/lib64",
    "/usr/lib",
    "/lib",
    "/usr/local/lib",
];
/// Command that installs loader and software driver on Debian and its derivatives.
const INSTALL: &str = "sudo apt-get install mesa-vulkan-drivers libvulkan1";

pub(super) fn checks() -> Vec<Check> {
    vec![
        display(has_display()),
        hardware(&devices()),
        loader(library("libvulkan.so.1")),
        drivers(&manifests()),
    ]
}

fn display(present: bool) -> Check {
    let found =
        if present { "present: vitreo run opens a window" } else { "none: pictures are drawn headless" };
    Check::ok("display", found)
}

/// Device files of graphics hardware.
fn devices() -> Vec<String> {
    let names = |folder: &str, prefix: &'static str| -> Vec<String> {
        let entries = fs::read_dir(folder).into_iter().flatten().flatten();
        let found = entries.filter(|e| e.file_name().to_string_lossy().starts_with(prefix));
        found.map(|e| e.path().display().to_string()).collect()
    };
    let mut all = names("/dev/dri", "renderD");
    all.extend(names("/dev", "nvidia0"));
    all.sort();
    all
}

fn hardware(devices: &[String]) -> Check {
    if devices.is_empty() {
        let found = "none: the picture is drawn by the processor, at a lower quality tier";
        return Check::warn(
            "graphics hardware",
            found,
            "use a machine with a graphics card for full quality",
        );
    }
    Check::ok("graphics hardware", devices.join(", "))
}

/// Path of a shared library, if it is installed.
fn library(name: &str) -> Option<PathBuf> {
    LIBRARY_FOLDERS.iter().map(|f| Path::new(f).join(name)).find(|p| p.exists())
}

fn loader(path: Option<PathBuf>) -> Check {
    match path {
        Some(path) => Check::ok("Vulkan loader", path.display().to_string()),
        None => Check::fail("Vulkan loader", "libvulkan.so.1 is absent", format!("{INSTALL}; or {WITHOUT}")),
    }
}

/// Command that runs without graphics.
const WITHOUT: &str = "vitreo run --no-picture";

/// Manifest of a Vulkan driver.
#[derive(Debug, Clone, PartialEq, Eq)]
struct Manifest {
    file: PathBuf,
    /// The library named in the manifest, and whether it exists; `None` if the manifest names none.
    library: Option<(String, bool)>,
}

/// Manifests of the drivers that the Vulkan loader would find.
fn manifests() -> Vec<Manifest> {
    let named = std::env::var("VK_DRIVER_FILES").or_else(|_| std::env::var("VK_ICD_FILENAMES"));
    let files: Vec<PathBuf> = match named {
        Ok(list) => list.split(':').map(PathBuf::from).collect(),
        Err(_) => {
            let home = std::env::var("HOME").unwrap_or_default();
            let own = format!("{home}/.local/share/vulkan/icd.d");
            let folders = MANIFEST_FOLDERS.into_iter().chain([own.as_str()]);
            let files = folders.flat_map(|f| fs::read_dir(f).into_iter().flatten().flatten());
            files.map(|e| e.path()).filter(|p| p.extension().is_some_and(|e| e == "json")).collect()
        }
    };
    let read = |file: PathBuf| {
        let text = fs::read_to_string(&file).ok()?;
        let library = driver_library(&text);
        let library = library.map(|l| {
            let exists = library_exists(&l);
            (l, exists)
        });
        Some(Manifest { file, library })
    };
    let mut all: Vec<Manifest> = files.into_iter().filter_map(read).collect();
    all.sort_by(|a, b| a.file.cmp(&b.file));
    all
}

/// The `library_path` in a manifest.
fn driver_library(text: &str) -> Option<String> {
    let json: serde_json::Value = serde_json::from_str(text).ok()?;
    Some(json.get("ICD")?.get("library_path")?.as_str()?.to_string())
}

fn library_exists(path: &str) -> bool {
    Path::new(path).is_file() || library(path).is_some()
}

fn drivers(manifests: &[Manifest]) -> Check {
    let name = "Vulkan driver";
    let works = |m: &&Manifest| m.library.as_ref().is_some_and(|(_, exists)| *exists);
    let title = |m: &Manifest| m.file.file_stem().unwrap_or_default().to_string_lossy().into_owned();
    let good: Vec<String> = manifests.iter().filter(works).map(title).collect();
    if !good.is_empty() {
        return Check::ok(name, good.join(", "));
    }
    let broken: Vec<String> = manifests.iter().map(title).collect();
    let found = match broken.is_empty() {
        true => "none".to_string(),
        false => format!("driver manifests whose library is missing: {}", broken.join(", ")),
    };
    Check::fail(name, found, format!("{INSTALL}; or {WITHOUT}"))
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::doctor::State;

    fn manifest(library: Option<(&str, bool)>) -> Manifest {
        let library = library.map(|(l, exists)| (l.to_string(), exists));
        Manifest { file: "/usr/share/vulkan/icd.d/lvp_icd.x86_64.json".into(), library }
    }

    #[test]
    fn a_manifest_is_read() {
        let text = r#"{"ICD": {"api_version": "1.3", "library_path": "libvulkan_lvp.so"}, "file_format_version": "1.0.0"}"#;
        assert_eq!(driver_library(text).as_deref(), Some("libvulkan_lvp.so"));
        for damaged in ["", "{}", "[1]", "{\"ICD\": 3}"] {
            assert_eq!(driver_library(damaged), None);
        }
    }

    #[test]
    fn a_driver_needs_its_library() {
        assert_eq!(drivers(&[manifest(Some(("l.so", true)))]).state, State::Ok);
        for none in [&[][..], &[manifest(None)], &[manifest(Some(("l.so", false)))]] {
            let check = drivers(none);
            assert_eq!(check.state, State::Fail);
            assert!(check.mend.unwrap().contains("mesa-vulkan-drivers"));
        }
        assert_eq!(loader(None).state, State::Fail);
        assert_eq!(hardware(&[]).state, State::Warn);
    }
}
