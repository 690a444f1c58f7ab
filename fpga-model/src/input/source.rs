//! Sequence of the pictures: camera, field number and instant of each.
//!
//! Still images are pictures of camera 0; clip or device `i` is camera `i`. Without a list of
//! fields, pictures are numbered from 0, and picture `k` was exposed `k + 1` periods after the
//! origin of time (an instant of 0 would mean none): the period of a clip is its own, that of
//! stills and of clips without a rate is that of a field at 50 Hz. A recording of pixels says camera, number, parity and
//! instants of each of its fields. With a list (`fields.jsonl`),
//! the `k`-th line of a camera belongs to the `k`-th picture of its clip, or the `k`-th line to the
//! `k`-th still; list and pictures must end together.

use super::camera::Camera;
use super::recorded::{CUT, Recorded};
use super::y4m::{Clip, MAGIC};
use super::{FieldView, Interlace, Picture, still};
use crate::colours::ColourTable;
use anyhow::{Context, Result, anyhow, bail, ensure};
use blob_stream::{FieldHead, HeadReader};
use protocol::blobs::WHOLE_FRAME;
use protocol::limits::{FIELD_PERIOD_NS, MAX_CAMERAS};
use recording::PixelsReader;
use std::collections::VecDeque;
use std::io::{BufRead, BufReader};
use std::os::unix::fs::FileTypeExt;
use std::path::{Path, PathBuf};

/// Name that stands for a clip on the standard input.
pub use protocol::file::STDIN;

/// Options of reading.
#[derive(Clone, Default)]
pub struct Reading {
    /// Samples of still images that become black and white.
    pub levels: Option<still::Levels>,
    /// Field order; `None` for that of the clip.
    pub interlace: Option<Interlace>,
    /// Invert luma.
    pub dark: bool,
    /// Remove chroma.
    pub grey: bool,
    /// Make every pixel black that has none of these classes.
    pub key: Option<ColourTable>,
}

/// An opened clip: a file or the standard input.
type Input = Box<dyn BufRead>;

/// Where the fields of one camera come from.
enum Kind {
    Stills(VecDeque<PathBuf>),
    Clip(Clip<Input>),
    Camera(Camera),
    Recorded(Box<Recorded>),
}

/// The fields of one camera.
struct Feed {
    kind: Kind,
    reading: Reading,
    picture: Picture,
    interlace: Interlace,
    /// Parities of the fields of `picture` that have not been taken.
    waiting: &'static [u32],
    /// Fields taken.
    taken: u64,
    /// File of `picture`.
    file: String,
}

impl Feed {
    fn new(kind: Kind, reading: &Reading) -> Self {
        let (own, file) = match &kind {
            Kind::Stills(_) => (Interlace::Progressive, String::new()),
            Kind::Clip(clip) => (clip.head.interlace, clip.file().into()),
            Kind::Camera(camera) => (Interlace::Progressive, camera.file().into()),
            Kind::Recorded(recorded) => (Interlace::Progressive, recorded.file().into()),
        };
        Feed {
            kind,
            interlace: reading.interlace.unwrap_or(own),
            reading: reading.clone(),
            picture: Picture::default(),
            waiting: &[],
            taken: 0,
            file,
        }
    }

    /// Field period, ns, as a fraction.
    fn period_ns(&self) -> [u64; 2] {
        let fields = self.interlace.parities().len() as u64;
        match &self.kind {
            Kind::Clip(Clip { head, .. }) => match head.rate {
                Some([n, d]) => [1_000_000_000 * d, n * fields],
                None => [FIELD_PERIOD_NS, 1],
            },
            Kind::Stills(_) | Kind::Camera(_) | Kind::Recorded(_) => [FIELD_PERIOD_NS, 1],
        }
    }

    /// What a recording says of the field that was read last.
    fn recorded_head(&self) -> Option<FieldHead> {
        let Kind::Recorded(recorded) = &self.kind else { return None };
        let header = recorded.header?;
        let (cam, seq, parity) = (header.camera, header.field, header.parity);
        Some(FieldHead { cam, seq, t_ns: header.exposed_ns, t_rx_ns: header.read_out_ns(), parity })
    }

    /// Warns where a recording ends in the middle.
    fn warn_if_cut(&self) {
        if let Kind::Recorded(recorded) = &self.kind
            && recorded.is_cut()
        {
            let last = recorded.header.map_or("it has no field of this camera".into(), |h| {
                format!("its last field is {}", h.field)
            });
            tracing::warn!("{}: {CUT}: camera {}: {last}", recorded.file(), recorded.camera());
        }
    }

    /// Reads the next field and returns its parity; `None` at the end.
    fn advance(&mut self) -> Result<Option<u32>> {
        if self.waiting.is_empty() {
            let found = match &mut self.kind {
                Kind::Clip(clip) => clip.read(&mut self.picture)?,
                Kind::Camera(camera) => camera.read(&mut self.picture)?,
                Kind::Recorded(recorded) => recorded.read(&mut self.picture)?,
                Kind::Stills(paths) => match paths.pop_front() {
                    None => false,
                    Some(path) => {
                        self.file = path.display().to_string();
                        still::read(&path, self.reading.levels, &mut self.picture)?;
                        true
                    }
                },
            };
            if !found {
                self.warn_if_cut();
                return Ok(None);
            }
            ensure!(
                self.interlace == Interlace::Progressive || self.picture.height >= 2,
                "{}: expected at least 2 lines in an interlaced picture, found 1",
                self.file
            );
            if self.reading.dark {
                self.picture.invert();
            }
            if let Some(table) = &self.reading.key {
                self.picture.key(table);
            }
            if self.reading.grey {
                self.picture.desaturate();
            }
            self.waiting = self.interlace.parities();
        }
        let Some((&parity, rest)) = self.waiting.split_first() else { return Ok(None) };
        self.waiting = rest;
        self.taken += 1;
        Ok(Some(parity))
    }
}

/// A field to scan.
pub struct Shot<'a> {
    /// Camera, number and instants of the field.
    pub head: FieldHead,
    /// Its pixels.
    pub view: FieldView<'a>,
    /// True if its lines are every second one of a frame.
    pub is_field: bool,
    /// True if it is a picture of its own, not one of a clip.
    pub is_still: bool,
    /// True if it comes from a live camera; the caller stamps its instants.
    pub is_live: bool,
    /// The file it comes from.
    pub file: &'a str,
}

/// All pictures in sequence.
pub struct Source {
    feeds: Vec<Feed>,
    fields: Option<(String, HeadReader)>,
    /// Next feed without a list.
    turn: usize,
}

impl Source {
    /// Opens stills or clips, with a list of fields or without.
    ///
    /// # Errors
    /// Paths that do not fit each other, a picture or a list that cannot be opened.
    pub fn open(paths: &[PathBuf], fields: Option<&Path>, reading: &Reading) -> Result<Self> {
        let what: Vec<What> = paths.iter().map(|p| What::is(p)).collect::<Result<_, _>>()?;
        let feeds = match what.iter().filter(|&&w| w != What::Still).count() {
            0 if paths.is_empty() => bail!("expected at least one picture or clip"),
            0 => vec![Feed::new(Kind::Stills(paths.iter().cloned().collect()), reading)],
            _ if what.contains(&What::Recording) => {
                ensure!(paths.len() == 1, "expected one recording of pixels alone, which has all cameras");
                ensure!(
                    fields.is_none(),
                    "--fields: a recording of pixels contains its own field numbers; omit --fields"
                );
                ensure!(
                    reading.interlace.is_none(),
                    "--interlaced: a recording of pixels has single fields; omit --interlaced"
                );
                recorded(&paths[0], reading)?
            }
            n if n < paths.len() => bail!("expected either still images or clips, found both"),
            n if n > MAX_CAMERAS => bail!("expected at most {MAX_CAMERAS} clips, found {n}"),
            _ => {
                let kinds = paths.iter().zip(what).map(|(path, what)| what.open(path));
                kinds.map(|kind| Ok(Feed::new(kind?, reading))).collect::<Result<_>>()?
            }
        };
        let open = |path: &Path| anyhow::Ok((path.display().to_string(), HeadReader::open(path)?));
        let fields = fields.map(open).transpose()?;
        Ok(Source { feeds, fields, turn: 0 })
    }

    /// The next field; `None` at the end.
    ///
    /// # Errors
    /// A picture or a line of the list that is refused, or a list that does not fit the pictures.
    pub fn take(&mut self) -> Result<Option<Shot<'_>>> {
        let found = if self.fields.is_some() { self.next_listed()? } else { self.next_in_turn()? };
        Ok(found.map(|(i, parity, head)| {
            let feed = &self.feeds[i];
            let (listed, is_still) = (self.fields.is_some(), matches!(feed.kind, Kind::Stills(_)));
            Shot {
                head,
                view: feed.picture.view(feed.interlace, parity),
                is_field: match &feed.kind {
                    Kind::Recorded(_) => head.parity < WHOLE_FRAME,
                    _ => feed.interlace != Interlace::Progressive || (listed && !is_still),
                },
                is_still,
                is_live: matches!(feed.kind, Kind::Camera(_)),
                file: &feed.file,
            }
        }))
    }

    /// The next field in turn; cameras take turns until all are at their end.
    fn next_in_turn(&mut self) -> Result<Option<(usize, u32, FieldHead)>> {
        for _ in 0..self.feeds.len() {
            let i = self.turn;
            self.turn = (i + 1) % self.feeds.len();
            let feed = &mut self.feeds[i];
            if let Some(parity) = feed.advance()? {
                let [n, d] = feed.period_ns().map(u128::from);
                let t_ns = (u128::from(feed.taken) * n / d).clamp(1, u64::MAX.into()) as u64;
                let numbered = FieldHead { cam: i as u32, seq: feed.taken - 1, t_ns, t_rx_ns: t_ns, parity };
                let head = feed.recorded_head().unwrap_or(numbered);
                return Ok(Some((i, parity, head)));
            }
        }
        Ok(None)
    }

    /// The field of the list's next line.
    fn next_listed(&mut self) -> Result<Option<(usize, u32, FieldHead)>> {
        let Some((file, list)) = &mut self.fields else { return Ok(None) };
        let Some(head) = list.next().transpose()? else {
            return self.expect_end().map(|()| None);
        };
        let place = format!("{file}, line {}", list.line_no());
        let stills = matches!(self.feeds[0].kind, Kind::Stills(_));
        let i = if stills { 0 } else { head.cam as usize };
        let clips = self.feeds.len();
        let feed = self.feeds.get_mut(i).with_context(|| {
            let (last, found) = (clips - 1, head.cam);
            format!("{place}: cam: expected 0 to {last}, one for each of {clips} clips, found {found}")
        })?;
        let Some(parity) = feed.advance()? else {
            let (n, file) = (feed.taken, if stills { "the images" } else { &feed.file });
            bail!("{place}: expected picture {} in {file}, found the end after {n}", n + 1);
        };
        ensure!(
            feed.interlace == Interlace::Progressive || parity == head.parity,
            "{place}: parity: expected {parity}, which field {} of {} has, found {}",
            feed.taken,
            feed.file,
            head.parity
        );
        Ok(Some((i, parity, head)))
    }

    /// Checks that no picture is left after the list.
    fn expect_end(&mut self) -> Result<()> {
        let Some((list, lines)) = &self.fields else { return Ok(()) };
        for feed in &mut self.feeds {
            let n = feed.taken;
            let more = match &feed.kind {
                Kind::Stills(paths) => !paths.is_empty(),
                Kind::Clip(_) => feed.advance()?.is_some(),
                Kind::Camera(_) | Kind::Recorded(_) => false,
            };
            let what = if feed.file.is_empty() { "the images" } else { &feed.file };
            ensure!(
                !more,
                "{list}, line {}: expected a line for picture {} of {what}, found the end of the list",
                lines.line_no(),
                n + 1
            );
        }
        Ok(())
    }
}

/// The cameras of a recording of pixels.
fn recorded(path: &Path, reading: &Reading) -> Result<Vec<Feed>> {
    let cameras = Recorded::head(path)?.cameras;
    let (most, found) = (MAX_CAMERAS, cameras.len());
    ensure!(found <= most, "{}: expected at most {most} cameras, found {found}", path.display());
    let feed = |camera: u32| Ok(Feed::new(Kind::Recorded(Box::new(Recorded::open(path, camera)?)), reading));
    cameras.into_iter().map(feed).collect()
}

fn open(path: &Path) -> Result<Input> {
    if path.as_os_str() == STDIN {
        return Ok(Box::new(BufReader::new(std::io::stdin())));
    }
    let opened = protocol::file::open(path).map_err(|e| anyhow!("{}: {e}", path.display()))?;
    Ok(Box::new(BufReader::with_capacity(1 << 16, opened)))
}

/// Kind of input at a path.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
enum What {
    Still,
    Clip,
    Camera,
    Recording,
}

impl What {
    /// Classifies a file by its first bytes, anything else by its file type: it can be read only
    /// once.
    fn is(path: &Path) -> Result<Self> {
        let read_error = |e: std::io::Error| anyhow!("{}: {e}", path.display());
        if path.as_os_str() == STDIN {
            return Ok(What::Clip);
        }
        let kind = std::fs::metadata(path).map_err(read_error)?.file_type();
        if kind.is_dir() {
            return Err(read_error(std::io::ErrorKind::IsADirectory.into()));
        }
        if kind.is_char_device() {
            return Ok(What::Camera);
        }
        if !kind.is_file() {
            return Ok(What::Clip);
        }
        let mut input = open(path)?;
        let begin = input.fill_buf().map_err(read_error)?;
        Ok(match (begin.starts_with(MAGIC), PixelsReader::is_mcap(begin)) {
            (true, _) => What::Clip,
            (_, true) => What::Recording,
            _ => What::Still,
        })
    }

    fn open(self, path: &Path) -> Result<Kind> {
        match self {
            What::Still => Ok(Kind::Stills([path.to_path_buf()].into())),
            What::Clip => Clip::open(open(path)?, &path.display().to_string()).map(Kind::Clip),
            What::Camera => Camera::open(path).map(Kind::Camera),
            What::Recording => bail!("{}: expected one recording of pixels alone", path.display()),
        }
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    fn folder_with(files: &[(&str, &[u8])]) -> (tempfile::TempDir, Vec<PathBuf>) {
        let folder = tempfile::tempdir().unwrap();
        let paths = files.iter().map(|(name, bytes)| {
            let path = folder.path().join(name);
            std::fs::write(&path, bytes).unwrap();
            path
        });
        let paths = paths.collect();
        (folder, paths)
    }

    /// A clip of pictures of 2 × 2 px, each of one grey.
    fn clip(head: &str, greys: &[u8]) -> Vec<u8> {
        let mut bytes = format!("YUV4MPEG2 W2 H2 {head} Cmono\n").into_bytes();
        greys.iter().for_each(|&g| bytes.extend([&b"FRAME\n"[..], &[g; 4]].concat()));
        bytes
    }

    /// Camera, number, instant, parity and a pixel of a field.
    type Told = (u32, u64, u64, u32, u8);

    fn all(source: &mut Source) -> Result<Vec<Told>> {
        let mut found = Vec::new();
        while let Some(shot) = source.take()? {
            let FieldHead { cam, seq, t_ns, parity, .. } = shot.head;
            found.push((cam, seq, t_ns, parity, shot.view.pixel_as_read(0, 0)[0]));
        }
        Ok(found)
    }

    #[test]
    fn clips_take_turns_at_their_own_rates() {
        let (_folder, paths) =
            folder_with(&[("a", &clip("F50:1", &[20, 21])), ("b", &clip("F25:1 Ib", &[30]))]);
        let mut source = Source::open(&paths, None, &Reading::default()).unwrap();
        let expected = [
            (0, 0, 20_000_000, 0, 20),
            (1, 0, 20_000_000, 1, 30),
            (0, 1, 40_000_000, 0, 21),
            (1, 1, 40_000_000, 0, 30),
        ];
        assert_eq!(all(&mut source).unwrap(), expected);
    }

    #[test]
    fn a_list_decides_over_order_and_instants_and_must_fit() {
        let line = |cam: u32, seq: u64| {
            format!(r#"{{"cam":{cam},"seq":{seq},"t_ns":{},"t_rx_ns":9,"parity":1}}"#, 100 + seq)
        };
        let run = |lines: &[String]| {
            let text = lines.join("\n");
            let files =
                [("a", &clip("F50:1", &[20, 21])[..]), ("b", &clip("F50:1", &[30])), ("f", text.as_bytes())];
            let (_folder, mut paths) = folder_with(&files);
            let list = paths.pop();
            all(&mut Source::open(&paths, list.as_deref(), &Reading::default()).unwrap())
        };
        let fits = [line(1, 7), line(0, 7), line(0, 9)];
        let expected = [(1, 7, 107, 1, 30), (0, 7, 107, 1, 20), (0, 9, 109, 1, 21)];
        assert_eq!(run(&fits).unwrap(), expected);
        let refused = |lines: &[String], named: &str| {
            let error = run(lines).unwrap_err().to_string();
            assert!(error.contains(named) && error.contains("/f"), "{named}: {error}");
        };
        refused(&fits[..2], "expected a line for picture 2 of");
        refused(&[&fits[..], &[line(1, 8)]].concat(), "line 4: expected picture 2 in");
        refused(&[line(2, 7)], "line 1: cam: expected 0 to 1");
        refused(&["{}".into()], "line 1: column 2: missing key");
    }

    #[test]
    fn arguments_that_do_not_fit_are_refused() {
        let still = [0x89, b'P', b'N', b'G'];
        let (folder, paths) = folder_with(&[("a.y4m", &clip("", &[20])), ("b.png", &still)]);
        let refused =
            |paths: &[PathBuf]| Source::open(paths, None, &Reading::default()).err().unwrap().to_string();
        assert!(refused(&paths).contains("found both"));
        assert!(refused(&[]).contains("at least one"));
        assert!(refused(&vec![paths[0].clone(); 9]).contains("at most 8 clips"));
        assert!(refused(&[folder.path().into()]).contains("directory"));
        assert!(refused(&[folder.path().join("none")]).contains("No such file"));
        assert!(refused(&["/dev/null".into()]).contains("expected a Video4Linux2 camera"));
    }
}
