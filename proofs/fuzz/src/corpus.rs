//! Inputs to begin with, made of the repository's real files, and the folders of those that are kept.

mod recorded;

pub use recorded::{camera_fields, journals, recorded_blocks, recordings, resting_frame, tracker_frames};

use crate::targets::Target;
use std::fs;
use std::io::Cursor;
use std::path::{Path, PathBuf};

/// The root of the repository.
pub fn repository() -> PathBuf {
    Path::new(env!("CARGO_MANIFEST_DIR")).ancestors().nth(2).expect("fuzz lies in the workspace").to_owned()
}

/// File of the inputs of a target that reach something of their own: each with its length before it
/// (`u32`, little-endian).
pub fn kept_file(target: &Target) -> PathBuf {
    repository().join("proofs/fuzz/corpus").join(target.name)
}

/// The inputs of a target that are kept.
pub fn kept(target: &Target) -> Vec<Vec<u8>> {
    let bytes = fs::read(kept_file(target)).unwrap_or_default();
    let (mut rest, mut inputs) = (&bytes[..], Vec::new());
    while let Some((length, after)) = rest.split_first_chunk::<4>() {
        let length = u32::from_le_bytes(*length) as usize;
        let (input, after) = after.split_at_checked(length).unwrap_or((after, &[]));
        inputs.push(input.to_vec());
        rest = after;
    }
    inputs
}

/// Writes the file of kept inputs; none where there are none.
///
/// # Errors
/// What the operating system refuses.
pub fn keep(target: &Target, inputs: &[Vec<u8>]) -> std::io::Result<()> {
    let with_length = |input: &Vec<u8>| [&(input.len() as u32).to_le_bytes()[..], input].concat();
    let path = kept_file(target);
    if inputs.is_empty() {
        return if path.exists() { fs::remove_file(path) } else { Ok(()) };
    }
    fs::create_dir_all(path.parent().expect("a folder"))?;
    fs::write(path, inputs.iter().flat_map(with_length).collect::<Vec<u8>>())
}

/// Folder of the inputs on which a target once failed.
pub fn crash_folder(target: &Target) -> PathBuf {
    repository().join("proofs/fuzz/crashes").join(target.name)
}

/// The files of a folder by name; none where there is no such folder.
pub fn files_in(folder: &Path) -> Vec<(PathBuf, Vec<u8>)> {
    let mut paths: Vec<PathBuf> =
        fs::read_dir(folder).into_iter().flatten().flatten().map(|e| e.path()).collect();
    paths.sort();
    paths.into_iter().filter_map(|p| fs::read(&p).ok().map(|bytes| (p, bytes))).collect()
}

/// What a target begins with: its seeds and the kept inputs.
pub fn of(target: &Target) -> Vec<Vec<u8>> {
    let failed = files_in(&crash_folder(target)).into_iter().map(|(_, bytes)| bytes);
    (target.seeds)().into_iter().chain(kept(target)).chain(failed).collect()
}

/// A file of the repository.
pub fn file(path: &str) -> Vec<u8> {
    fs::read(repository().join(path)).unwrap_or_else(|e| panic!("{path}: {e}"))
}

/// The first bytes of a file of the repository, up to the end of a line.
pub fn head(path: &str, bytes: usize) -> Vec<u8> {
    let mut head = file(path);
    head.truncate(bytes);
    let end = head.iter().rposition(|b| *b == b'\n').map_or(head.len(), |i| i + 1);
    head.truncate(end);
    head
}

/// Every file with this ending in and below folders of the repository.
pub fn shipped(folders: &[&str], ending: &str) -> Vec<Vec<u8>> {
    let mut paths = Vec::new();
    folders.iter().for_each(|folder| walk(&repository().join(folder), ending, &mut paths));
    paths.sort();
    paths.iter().map(|p| fs::read(p).expect("a file of the repository")).collect()
}

fn walk(folder: &Path, ending: &str, found: &mut Vec<PathBuf>) {
    for entry in fs::read_dir(folder).expect("a folder of the repository").flatten() {
        let path = entry.path();
        if path.is_dir() {
            walk(&path, ending, found);
        } else if path.extension().is_some_and(|e| e == ending) {
            found.push(path);
        }
    }
}

/// The first lines of every file of this name below a folder.
pub fn lines_of(folder: &str, name: &str, lines: usize) -> Vec<Vec<u8>> {
    let mut paths = Vec::new();
    let ending = name.rsplit('.').next().unwrap_or_default();
    walk(&repository().join(folder), ending, &mut paths);
    paths.retain(|p| p.ends_with(name));
    paths.sort();
    let first = |path: &PathBuf| {
        let text = fs::read_to_string(path).expect("a file of the repository");
        text.lines().take(lines).flat_map(|l| [l, "\n"]).collect::<String>().into_bytes()
    };
    paths.iter().map(first).collect()
}

/// A recorded hand of so many samples that draws circles.
pub fn motion(samples: usize) -> Vec<u8> {
    let line = |i: usize| {
        let turn = i as f64 / 40.0;
        format!("{i},{:.1},{:.1},{:.1},0\n", turn.sin(), turn.cos(), turn.sin() * 0.2)
    };
    (0..samples).map(line).collect::<String>().into_bytes()
}

fn encoded(picture: image::DynamicImage, format: image::ImageFormat) -> Vec<u8> {
    let mut bytes = Cursor::new(Vec::new());
    picture.write_to(&mut bytes, format).expect("memory");
    bytes.into_inner()
}

/// Small pictures of the kinds that are read.
pub fn pictures() -> Vec<Vec<u8>> {
    use image::DynamicImage as Image;
    use image::ImageFormat::{Jpeg, Png};
    let colour = image::RgbImage::from_fn(17, 18, |x, y| image::Rgb([(x * 15) as u8, (y * 13) as u8, 99]));
    let deep = image::ImageBuffer::from_fn(20, 17, |x, y| image::Luma([(x * 3000 + y) as u16]));
    let grey = Image::ImageRgb8(colour.clone()).to_luma8();
    vec![
        encoded(colour.clone().into(), Png),
        encoded(colour.into(), Jpeg),
        encoded(grey.clone().into(), Jpeg),
        encoded(grey.into(), Png),
        encoded(Image::ImageLuma16(deep), Png),
        encoded(Image::new_rgba16(16, 16), Png),
    ]
}

/// A board of which all corners are found.
pub fn charuco_pictures() -> Vec<Vec<u8>> {
    use calibration::{board::Target, charuco::CharucoBoard, printed::Printed};
    let board = CharucoBoard::parse("5x4,10,8,DICT_4X4_50").expect("a board");
    vec![Printed::new(&Target::Charuco(board), 4.0).png(3.0 * 25.4).expect("a small picture")]
}

/// Pictures as large as a photograph of the fundus must be.
pub fn photographs() -> Vec<Vec<u8>> {
    let plain = image::RgbImage::from_pixel(512, 512, image::Rgb([180, 90, 40]));
    vec![
        encoded(plain.clone().into(), image::ImageFormat::Png),
        encoded(plain.into(), image::ImageFormat::Jpeg),
        pictures().swap_remove(0),
    ]
}

/// A store with an attempt, and an empty one.
pub fn stores() -> Vec<Vec<u8>> {
    let folder = tempfile::tempdir().expect("a folder");
    let path = folder.path().join("store.sqlite");
    let mut store = results::Store::open_or_create(&path).expect("a store");
    let points = results::Points { key: "time".into(), ..results::Points::default() };
    let attempt =
        results::Attempt { module: "peeling".into(), metrics: vec![points], ..results::Attempt::default() };
    store.add("anna", &attempt).expect("an attempt");
    drop(store);
    vec![fs::read(&path).expect("a store"), Vec::new()]
}

/// A file in memory, for readers that want a path.
pub struct Scratch {
    _folder: tempfile::TempDir,
    path: PathBuf,
}

impl Scratch {
    /// In shared memory where there is some.
    ///
    /// # Panics
    /// Where no folder can be made.
    #[allow(clippy::new_without_default)]
    pub fn new() -> Self {
        let memory = tempfile::Builder::new().prefix("vitreo-fuzz-").tempdir_in("/dev/shm");
        let folder = memory.or_else(|_| tempfile::tempdir()).expect("a folder");
        let path = folder.path().join("input");
        Scratch { _folder: folder, path }
    }

    /// The file with these bytes.
    ///
    /// # Panics
    /// Where it cannot be written.
    pub fn with(&self, bytes: &[u8]) -> &Path {
        fs::write(&self.path, bytes).expect("the scratch file");
        &self.path
    }
}
