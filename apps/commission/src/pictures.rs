//! Pictures of several cameras: from files and folders by their names, from clips, and from live cameras.
//!
//! A camera that is interlaced may bring its fields one by one: two of them make a picture.
//!
//! The name says of which camera a picture is: `cam0/007.png`, `cam0-007.png`, `camera-0.png`. What is left of the name
//! is the view: pictures of one view were taken at one time. A clip (`cam0.y4m`) or a pipe is one camera, and its k-th
//! picture that is looked at is view k. A recording of fields (`.mcap`) has all its cameras. Interlaced pictures are taken
//! whole: what they show must be held still.

use crate::Refused;
use crate::live::{self, Choice};
use anyhow::{Context, Result, bail, ensure};
use fpga_model::input::recorded::Recorded;
use fpga_model::input::source::{Reading, Source};
use fpga_model::input::whole::{WholePictures, is_recording, woven};
use fpga_model::input::{Interlace, Picture};
use rig::Rig;
use rig::sensor::Scan;
use settings::commands::cameras::Stream;
use std::collections::BTreeMap;
use std::path::{Path, PathBuf};

/// Most pictures of a camera.
pub const MOST: usize = 400;
/// Endings of picture files, and of clips.
const STILLS: [&str; 3] = ["png", "jpg", "jpeg"];
const CLIP: &str = "y4m";

/// Where pictures come from.
#[derive(Debug, Clone, Default, clap::Args)]
pub struct PicturesArgs {
    /// Pictures (PNG, JPEG), clips or pipes (Y4M), or folders of them. The name gives the camera: cam0/007.png,
    /// cam0-007.png, cam0.y4m; pictures of several cameras with the same number were taken together. Or one recording
    /// of all cameras (.mcap), made by vitreo cameras --record-fields. The step poses also accepts one stream (.mcap,
    /// .jsonl) of waved instruments.
    #[arg(long, value_name = "PATH", num_args = 1.., required_unless_present = "cameras", help_heading = "Pictures")]
    pub from: Vec<PathBuf>,
    /// Live cameras in the order of the rig: v4l2:/dev/videoN, genicam:NAME or y4m:PIPE, with settings as for vitreo run
    /// --cameras.
    #[arg(
        long,
        value_name = "SPEC,...",
        value_delimiter = ',',
        conflicts_with = "from",
        help_heading = "Pictures"
    )]
    pub cameras: Vec<Stream>,
    /// Use every Nth picture of clips and live cameras.
    #[arg(
        long, value_name = "N", default_value_t = 25, value_parser = settings::commands::numbers::whole::<u64>(1, 100_000),
        help_heading = "Pictures"
    )]
    pub every: u64,
    /// Use at most N pictures per camera; live capture then stops.
    #[arg(
        long, alias = "most", value_name = "N", default_value_t = 40, value_parser = max_pictures,
        help_heading = "Pictures"
    )]
    pub max_pictures: usize,
}

fn max_pictures(text: &str) -> Result<usize, String> {
    let number = text.parse().ok().filter(|n| (1..=MOST).contains(n));
    number.ok_or_else(|| format!("expected 1 to {MOST}"))
}

/// What looks at a picture: its camera, its view, the name of its file, and itself.
pub type Look<'a> = dyn FnMut(u32, &str, &str, &Picture) -> Result<()> + 'a;

/// The pictures of one camera.
#[derive(Debug, Clone, PartialEq, Eq)]
pub struct Feed {
    /// Id of the camera in the rig.
    pub camera: u32,
    /// What is read.
    pub kind: Kind,
}

/// What is read.
#[derive(Debug, Clone, PartialEq, Eq)]
pub enum Kind {
    /// Files by view.
    Stills(BTreeMap<String, PathBuf>),
    /// A clip, or a pipe by its name.
    Clip(PathBuf),
    /// A live camera.
    Live,
    /// A recording of several cameras.
    Recording(PathBuf),
}

/// The number after `cam` or `camera` in a name, and the name without both.
pub fn camera_in(name: &str) -> Option<(u32, String)> {
    let lower = name.to_ascii_lowercase();
    let at = lower.rfind("cam")?;
    let after = &lower[at + 3..];
    let after = after.strip_prefix("era").unwrap_or(after);
    let number = after.trim_start_matches(['-', '_', ' ']);
    let digits = number.find(|c: char| !c.is_ascii_digit()).unwrap_or(number.len());
    let camera = number[..digits].parse().ok()?;
    let rest = [&name[..at], &name[name.len() - (number.len() - digits)..]].concat();
    Some((camera, rest.trim_matches(['-', '_', ' ', '.']).to_owned()))
}

/// Camera and view of a file: its own name says so, or that of its folder.
fn named(path: &Path) -> Option<(u32, String)> {
    let stem = path.file_stem()?.to_str()?;
    camera_in(stem).or_else(|| {
        let folder = path.parent()?.file_name()?.to_str()?;
        camera_in(folder).map(|(camera, _)| (camera, stem.to_owned()))
    })
}

fn ending(path: &Path) -> String {
    path.extension().and_then(|e| e.to_str()).unwrap_or_default().to_ascii_lowercase()
}

/// The pictures and clips in a path: itself, or what is in it and in its folders.
fn files_in(path: &Path, depth: u32, found: &mut Vec<PathBuf>) -> Result<()> {
    let about = || path.display().to_string();
    if !std::fs::metadata(path).with_context(about)?.is_dir() {
        found.push(path.into());
        return Ok(());
    }
    let mut entries: Vec<PathBuf> =
        std::fs::read_dir(path).with_context(about)?.map(|e| Ok(e?.path())).collect::<Result<_>>()?;
    entries.sort();
    for entry in entries {
        let known = STILLS.contains(&&*ending(&entry)) || ending(&entry) == CLIP;
        if known || (entry.is_dir() && depth > 0) {
            files_in(&entry, depth - 1, found)?;
        }
    }
    Ok(())
}

impl PicturesArgs {
    /// The pictures of each camera, of cameras with these ids alone.
    ///
    /// # Errors
    /// A path that cannot be read, a name that says no camera or one that there is not, a view twice.
    pub fn feeds(&self, ids: &[u32]) -> Result<Vec<Feed>> {
        if !self.cameras.is_empty() {
            return Ok(ids.iter().map(|&camera| Feed { camera, kind: Kind::Live }).collect());
        }
        if let [path] = &self.from[..]
            && is_recording(path)
        {
            return of_recording(path, ids);
        }
        let mut files = Vec::new();
        self.from.iter().try_for_each(|path| files_in(path, 2, &mut files))?;
        let mut feeds: BTreeMap<u32, Kind> = BTreeMap::new();
        for path in files {
            let name = path.display();
            let Some((camera, view)) = named(&path) else {
                bail!(
                    "{name}: expected a name with the camera's number, such as cam0-007.png or cam0/007.png"
                );
            };
            ensure!(ids.contains(&camera), "{name}: the rig has no camera {camera}; its cameras are {ids:?}");
            // What has no ending of a picture is a clip: a pipe, a device.
            let is_clip = !STILLS.contains(&&*ending(&path));
            let empty = if is_clip { Kind::Clip(PathBuf::new()) } else { Kind::Stills(BTreeMap::new()) };
            match feeds.entry(camera).or_insert(empty) {
                Kind::Stills(views) if !is_clip => {
                    if let Some(first) = views.insert(view, path.clone()) {
                        bail!("{name}: has the camera and the view of {}", first.display());
                    }
                }
                Kind::Clip(clip) if is_clip && clip.as_os_str().is_empty() => *clip = path,
                _ => bail!("{name}: expected pictures or one clip of camera {camera}, found more"),
            }
        }
        ensure!(!feeds.is_empty(), "expected pictures (PNG, JPEG) or clips (Y4M), found none");
        Ok(feeds.into_iter().map(|(camera, kind)| Feed { camera, kind }).collect())
    }

    /// As they are named in a record.
    pub fn names(&self) -> Vec<String> {
        let files = self.from.iter().map(|p| p.display().to_string());
        files.chain(self.cameras.iter().map(ToString::to_string)).collect()
    }

    /// Hands each picture to `look`: its camera, its view and the name of its file. Clips and live cameras take turns,
    /// so that pictures of one view come together.
    ///
    /// # Errors
    /// A picture that cannot be read; those of `look`.
    pub fn each(&self, rig: &Rig, feeds: &[Feed], look: &mut Look<'_>) -> Result<()> {
        if !self.cameras.is_empty() {
            let choice = Choice { every: self.every, most: self.max_pictures };
            return live::pictures(rig, &self.cameras, choice, look);
        }
        let reading = Reading { interlace: Some(Interlace::Progressive), ..Reading::default() };
        let mut clips: Vec<(u32, PathBuf)> = Vec::new();
        for feed in feeds {
            let views = match &feed.kind {
                Kind::Clip(path) => {
                    clips.push((feed.camera, path.clone()));
                    continue;
                }
                Kind::Recording(path) => {
                    self.each_of_recording(feed.camera, path, look)?;
                    continue;
                }
                Kind::Stills(views) => views,
                Kind::Live => continue,
            };
            // Spread over all where there are more.
            let used = self.max_pictures.min(views.len());
            let chosen: Vec<_> = (0..used).map(|i| i * views.len() / used).collect();
            for (_, (view, path)) in views.iter().enumerate().filter(|(i, _)| chosen.contains(i)) {
                let mut source = Source::open(std::slice::from_ref(path), None, &reading)?;
                let shot = source.take()?.context("a picture")?;
                look(feed.camera, view, &path.display().to_string(), shot.view.picture)?;
            }
        }
        if clips.is_empty() { Ok(()) } else { self.each_of_clips(rig, &clips, &reading, look) }
    }

    fn each_of_recording(&self, camera: u32, path: &Path, look: &mut Look<'_>) -> Result<()> {
        let (mut pictures, mut picture) = (WholePictures::open(path, camera)?, Picture::default());
        let mut used = 0;
        while let Some(number) = pictures.read(&mut picture)? {
            // Pictures of one number were taken together.
            if !number.is_multiple_of(self.every) {
                continue;
            }
            let (view, file) = (format!("{:04}", number / self.every), path.display());
            look(camera, &view, &format!("{file}, camera {camera}, picture {number}"), &picture)?;
            used += 1;
            if used == self.max_pictures {
                break;
            }
        }
        Ok(())
    }

    fn each_of_clips(
        &self,
        rig: &Rig,
        clips: &[(u32, PathBuf)],
        reading: &Reading,
        look: &mut Look<'_>,
    ) -> Result<()> {
        let paths: Vec<PathBuf> = clips.iter().map(|c| c.1.clone()).collect();
        let mut source = Source::open(&paths, None, reading)?;
        let mut fields: Vec<Fields> = clips.iter().map(|(id, _)| Fields::of(rig, *id)).collect();
        let last = self.every * (self.max_pictures as u64 - 1);
        while let Some(shot) = source.take()? {
            let (clip, picture) = (shot.head.cam as usize, shot.view.picture);
            let are_fields = fields[clip].size_px == Some([picture.width, picture.height]);
            let number = if are_fields { shot.head.seq / 2 } else { shot.head.seq };
            if number > last {
                break;
            }
            if !number.is_multiple_of(self.every) {
                continue;
            }
            let (view, name) =
                (format!("{:04}", number / self.every), format!("{}, picture {number}", shot.file));
            if !are_fields {
                look(clips[clip].0, &view, &name, picture)?;
            } else if let Some(whole) = fields[clip].whole(picture) {
                look(clips[clip].0, &view, &name, &whole)?;
            }
        }
        Ok(())
    }
}

/// Single fields of an interlaced camera, of which two make a picture.
struct Fields {
    /// Their width and lines; `None` of a progressive camera.
    size_px: Option<[usize; 2]>,
    /// The first of two, which has the even lines, until the second comes.
    first: Option<Picture>,
}

impl Fields {
    /// Those that a clip of a camera may consist of.
    fn of(rig: &Rig, id: u32) -> Self {
        let sensor = rig.sensor(id);
        let size_px = [sensor.size_px[0] as usize, sensor.lines() as usize];
        Fields { size_px: (sensor.scan == Scan::Interlaced).then_some(size_px), first: None }
    }

    /// Takes the next field; with every second one, the picture of both.
    fn whole(&mut self, field: &Picture) -> Option<Picture> {
        match self.first.take() {
            Some(first) => Some(woven(&first, field, true)),
            None => {
                self.first = Some(field.clone());
                None
            }
        }
    }
}

/// The cameras of a recording of fields.
fn of_recording(path: &Path, ids: &[u32]) -> Result<Vec<Feed>> {
    let cameras = Recorded::head(path)?.cameras;
    if let Some(camera) = cameras.iter().find(|camera| !ids.contains(camera)) {
        bail!("{}: the rig has no camera {camera}; its cameras are {ids:?}", path.display());
    }
    let feed = |camera| Feed { camera, kind: Kind::Recording(path.into()) };
    Ok(cameras.into_iter().map(feed).collect())
}

/// Refuses a picture of another size than its camera's.
///
/// # Errors
/// Both sizes, and what may be wrong.
pub fn of_size(file: &str, camera: u32, expected: [u32; 2], found: [usize; 2]) -> Result<()> {
    let ([w, h], [x, y]) = (expected, found);
    if [w as usize, h as usize] != [x, y] {
        return Err(Refused(vec![format!(
            "{file}: {x}×{y} px, but camera {camera} of the rig has {w}×{h} px: give the pictures of camera {camera}, \
             or a rig (--rig) that has this size"
        )])
        .into());
    }
    Ok(())
}

#[cfg(test)]
mod tests {
    use super::*;
    use proptest::prelude::*;

    #[test]
    fn names_say_camera_and_view() {
        for (path, camera, view) in [
            ("a/cam0/007.png", 0, "007"),
            ("cam12-007.png", 12, "007"),
            ("x/camera-1.png", 1, ""),
            ("Camera 2_b.jpg", 2, "b"),
            ("board3_cam1.png", 1, "board3"),
            ("cam0/cam1-5.png", 1, "5"),
        ] {
            assert_eq!(named(Path::new(path)), Some((camera, view.into())), "{path}");
        }
        for path in ["a.png", "cam.png", "scam/a.png", "cam99999999999/a.png"] {
            assert_eq!(named(Path::new(path)), None, "{path}");
        }
    }

    #[test]
    fn files_become_feeds_or_are_refused_by_name() {
        let folder = tempfile::tempdir().unwrap();
        let write = |name: &str| {
            let path = folder.path().join(name);
            std::fs::create_dir_all(path.parent().unwrap()).unwrap();
            std::fs::write(path, "").unwrap();
        };
        ["cam0/1.png", "cam0/2.png", "cam1/1.png", "notes.txt"].iter().for_each(|name| write(name));
        let args = PicturesArgs {
            from: vec![folder.path().into()],
            max_pictures: 9,
            every: 1,
            ..PicturesArgs::default()
        };
        let feeds = args.feeds(&[0, 1]).unwrap();
        let views = |i: usize| match &feeds[i].kind {
            Kind::Stills(views) => views.keys().cloned().collect::<Vec<_>>(),
            _ => Vec::new(),
        };
        assert_eq!((feeds.len(), views(0), views(1)), (2, vec!["1".into(), "2".into()], vec!["1".into()]));
        let refused = |ids: &[u32]| args.feeds(ids).unwrap_err().to_string();
        assert!(refused(&[0]).contains("the rig has no camera 1"), "{}", refused(&[0]));
        write("cam0-1.png");
        assert!(refused(&[0, 1]).contains("has the camera and the view of"), "{}", refused(&[0, 1]));
        std::fs::remove_file(folder.path().join("cam0-1.png")).unwrap();
        write("cam1.y4m");
        assert!(refused(&[0, 1]).contains("or one clip of camera 1"), "{}", refused(&[0, 1]));
        std::fs::remove_file(folder.path().join("cam1.y4m")).unwrap();
        write("board.png");
        assert!(
            refused(&[0, 1]).contains("board.png: expected a name with the camera's number"),
            "{}",
            refused(&[0, 1])
        );
    }

    /// Two pipes are read in turns, one picture in `every`, and left after `max_pictures`.
    #[test]
    fn clips_take_turns() {
        let folder = tempfile::tempdir().unwrap();
        let clip = |name: &str, first: u8| {
            let frame = |k: u8| [&b"FRAME\n"[..], &[first + k; 256], &[128; 128]].concat();
            let frames: Vec<u8> = (0..9).flat_map(frame).collect();
            let path = folder.path().join(name);
            std::fs::write(&path, [&b"YUV4MPEG2 W16 H16 F25:1 Ip C420jpeg\n"[..], &frames].concat()).unwrap();
            path
        };
        let from = vec![clip("cam4.y4m", 30), clip("cam5.y4m", 100)];
        let args = PicturesArgs { from, max_pictures: 3, every: 2, ..PicturesArgs::default() };
        let mut seen = Vec::new();
        let rig = Rig::load_or_shipped(None).unwrap();
        args.each(&rig, &args.feeds(&[4, 5]).unwrap(), &mut |camera, view, file, picture| {
            assert!(file.ends_with(&format!("picture {}", 2 * view.parse::<u32>().unwrap())), "{file}");
            seen.push((camera, view.to_owned(), picture.width));
            Ok(())
        })
        .unwrap();
        let expected = |(view, camera): (u32, u32)| (camera, format!("{view:04}"), 16);
        let expected: Vec<_> = (0..3).flat_map(|v| [(v, 4), (v, 5)]).map(expected).collect();
        assert_eq!(seen, expected);
    }

    /// An interlaced camera that brings fields: each picture has the lines of two of them.
    #[test]
    fn fields_of_a_pipe_are_put_together() {
        let folder = tempfile::tempdir().unwrap();
        let mut rig = Rig::load_or_shipped(None).unwrap();
        rig.frame = None;
        rig.cameras.iter_mut().for_each(|camera| (camera.width, camera.height) = (16, 8));
        let frame = |k: u8| [&b"FRAME\n"[..], &[30 + k; 64], &[128; 64]].concat();
        let clip = [&b"YUV4MPEG2 W16 H4 F50:1 Ip C422\n"[..], &(0..13).flat_map(frame).collect::<Vec<u8>>()]
            .concat();
        let path = folder.path().join("cam0.y4m");
        std::fs::write(&path, clip).unwrap();
        let args = PicturesArgs { from: vec![path], max_pictures: 3, every: 2, ..PicturesArgs::default() };
        let mut seen = Vec::new();
        args.each(&rig, &args.feeds(&[0]).unwrap(), &mut |_, view, _, picture| {
            assert_eq!([picture.width, picture.height], [16, 8]);
            seen.push((view.to_owned(), [picture.luma[0], picture.luma[16]]));
            Ok(())
        })
        .unwrap();
        let pair = |k: u8| [30 + k, 31 + k];
        let expected =
            [("0000".to_owned(), pair(0)), ("0001".to_owned(), pair(4)), ("0002".to_owned(), pair(8))];
        assert_eq!(seen, expected);
    }

    proptest! {
        #[test]
        fn any_name_is_read_or_says_nothing(name in ".{0,30}", number in 0u32..1000) {
            let _ = camera_in(&name);
            prop_assert_eq!(camera_in(&format!("cam{number}-7")), Some((number, "7".into())));
        }
    }
}
