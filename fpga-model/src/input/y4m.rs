//! Reads uncompressed clips (YUV4MPEG2, `.y4m`) picture by picture.
//!
//! 8 bits a sample; chroma 4:2:0, 4:1:1, 4:2:2, 4:4:4 or none. It becomes 4:2:2: coarser chroma is
//! repeated, finer chroma averaged in pairs. In an interlaced 4:2:0 picture each field has chroma
//! lines of its own. Samples are in the studio range unless the header says `XCOLORRANGE=FULL`.

use super::{Interlace, Picture, check_size};
use crate::colours::convert::{GREY, chroma_of_full, luma_of_full};
use anyhow::{Context, Result, anyhow, ensure};
use std::io::{BufRead, Read};

/// The first bytes of a clip.
pub const MAGIC: &[u8] = b"YUV4MPEG2";
/// Longest header, and longest line before a picture, bytes.
const MAX_HEADER: u64 = 1024;

/// Chroma subsampling.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
enum Chroma {
    /// None.
    Mono,
    /// Every `across`-th column of every `down`-th line, and whether a plane of opacity follows.
    Planes { across: usize, down: usize, alpha: bool },
}

/// Header of a clip.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub struct Head {
    /// Pixels a line.
    pub width: usize,
    /// Lines of a picture.
    pub height: usize,
    /// Pictures a second, as a fraction; `None` if the header has none.
    pub rate: Option<[u64; 2]>,
    /// Field order.
    pub interlace: Interlace,
    chroma: Chroma,
    full_range: bool,
}

impl Head {
    /// Bytes of the luma plane and of each chroma plane.
    fn plane_bytes(&self) -> [usize; 2] {
        let chroma = match self.chroma {
            Chroma::Mono => 0,
            Chroma::Planes { across, down, .. } => self.width.div_ceil(across) * self.height.div_ceil(down),
        };
        [self.width * self.height, chroma]
    }

    fn picture_bytes(&self) -> u64 {
        let [luma, chroma] = self.plane_bytes();
        let alpha = matches!(self.chroma, Chroma::Planes { alpha: true, .. });
        (luma * (1 + usize::from(alpha)) + 2 * chroma) as u64
    }
}

/// A clip that is being read.
pub struct Clip<R> {
    file: String,
    input: R,
    /// Header.
    pub head: Head,
    /// Pictures begun so far.
    begun: u64,
    raw: Vec<u8>,
}

impl<R: BufRead> Clip<R> {
    /// Reads the header; `file` is its name in messages.
    ///
    /// # Errors
    /// An input that cannot be read, or a header that is malformed or names a format that is not
    /// supported.
    pub fn open(mut input: R, file: &str) -> Result<Self> {
        let head = read_head(&mut input).map_err(|problem| anyhow!("{file}: {problem}"))?;
        Ok(Clip { file: file.into(), input, head, begun: 0, raw: Vec::new() })
    }

    /// The file's name, for messages.
    pub fn file(&self) -> &str {
        &self.file
    }

    /// True where a header comes next, not a picture: another clip follows in the same stream.
    ///
    /// # Errors
    /// An input that cannot be read.
    pub fn begins_anew(&mut self) -> Result<bool> {
        let file = &self.file;
        let next = self.input.fill_buf().map_err(|e| anyhow!("{file}: {e}"))?;
        Ok(next.first() == MAGIC.first())
    }

    /// The clip that follows in the same stream.
    ///
    /// # Errors
    /// As [`Clip::open`].
    pub fn following(self) -> Result<Self> {
        Clip::open(self.input, &self.file)
    }

    /// Reads the next picture into `into`; false at the end of the clip.
    ///
    /// # Errors
    /// An input that cannot be read, or a picture that is incomplete.
    pub fn read(&mut self, into: &mut Picture) -> Result<bool> {
        let (file, input) = (&self.file, &mut self.input);
        let unreadable = |e: std::io::Error| anyhow!("{file}: {e}");
        if input.fill_buf().map_err(unreadable)?.is_empty() {
            return Ok(false);
        }
        self.begun += 1;
        let picture = self.begun;
        let line = read_line(input).map_err(unreadable)?;
        let opened = line.as_deref().is_some_and(|l| l == b"FRAME" || l.starts_with(b"FRAME "));
        ensure!(
            opened,
            "{file}, picture {picture}: expected a line that begins with FRAME, found something else"
        );
        let expected = self.head.picture_bytes();
        self.raw.clear();
        let found = input.take(expected).read_to_end(&mut self.raw).map_err(unreadable)? as u64;
        ensure!(
            found == expected,
            "{file}, picture {picture}: expected {expected} bytes of samples, found the end after {found}"
        );
        self.unpack(into);
        Ok(true)
    }

    /// Fills `into` from the raw planes.
    fn unpack(&self, into: &mut Picture) {
        let head = &self.head;
        let [luma, chroma] = head.plane_bytes();
        (into.width, into.height) = (head.width, head.height);
        into.as_read.clear();
        into.luma.clear();
        into.luma.extend_from_slice(&self.raw[..luma]);
        let (blue, rest) = self.raw[luma..].split_at(chroma);
        for (to, from) in [(&mut into.blue, blue), (&mut into.red, &rest[..chroma])] {
            to.clear();
            to.resize(head.width.div_ceil(2) * head.height, GREY);
            if let Chroma::Planes { across, down, .. } = head.chroma {
                spread(head, from, [across, down], to);
            }
        }
        if head.full_range {
            into.luma.iter_mut().for_each(|s| *s = luma_of_full(*s));
            into.blue.iter_mut().chain(&mut into.red).for_each(|s| *s = chroma_of_full(*s));
        }
    }
}

/// Resamples a chroma plane to every second column of every line.
fn spread(head: &Head, from: &[u8], [across, down]: [usize; 2], to: &mut [u8]) {
    let from_width = head.width.div_ceil(across);
    let last_line = head.height.div_ceil(down) - 1;
    for (y, line) in to.chunks_exact_mut(head.width.div_ceil(2)).enumerate() {
        let source = match (down, head.interlace) {
            (1, _) => y,
            (_, Interlace::Progressive) => y / 2,
            // Lines 0 and 2 share chroma line 0, lines 1 and 3 chroma line 1, and so on.
            _ => (y / 4 * 2 + y % 2).min(last_line),
        };
        let samples = &from[source * from_width..][..from_width];
        match across {
            1 => {
                for (sample, pair) in line.iter_mut().zip(samples.chunks(2)) {
                    let sum: u32 = pair.iter().map(|&v| u32::from(v)).sum();
                    *sample = sum.div_ceil(pair.len() as u32) as u8;
                }
            }
            2 => line.copy_from_slice(samples),
            _ => line.iter_mut().enumerate().for_each(|(x, s)| *s = samples[x / 2]),
        }
    }
}

/// A line without its end; `None` if it is longer than allowed or has no end.
fn read_line(input: &mut impl BufRead) -> std::io::Result<Option<Vec<u8>>> {
    let mut line = Vec::new();
    input.by_ref().take(MAX_HEADER).read_until(b'\n', &mut line)?;
    Ok((line.pop() == Some(b'\n')).then_some(line))
}

fn read_head(input: &mut impl BufRead) -> Result<Head> {
    let line = read_line(input)?;
    let line =
        line.with_context(|| format!("expected a header line of at most {MAX_HEADER} bytes, found none"))?;
    let text = std::str::from_utf8(&line).map_err(|_| anyhow!("expected a header of plain text"))?;
    parse_head(text).map_err(anyhow::Error::msg)
}

/// Parses the header line; the error is its defect.
fn parse_head(line: &str) -> Result<Head, String> {
    let mut words = line.split(' ');
    if words.next() != Some("YUV4MPEG2") {
        return Err("expected a clip that begins with YUV4MPEG2".into());
    }
    let (mut width, mut height) = (0, 0);
    let (mut rate, mut interlace, mut full_range) = (None, Interlace::Progressive, false);
    let mut chroma = parse_chroma("420")?;
    for word in words.filter(|w| !w.is_empty()) {
        let value = word.get(1..).unwrap_or("");
        match word.as_bytes()[0] {
            b'W' => width = pixels(word, value)?,
            b'H' => height = pixels(word, value)?,
            b'F' => rate = parse_rate(word, value)?,
            b'I' => interlace = parse_interlace(word, value)?,
            b'C' => chroma = parse_chroma(value)?,
            b'X' => full_range = parse_range(value, full_range)?,
            b'A' => {}
            _ => return Err(format!("header: expected W, H, F, I, A, C or X, found {word:?}")),
        }
    }
    check_size(width, height).map_err(|defect| format!("header: {defect}"))?;
    if interlace != Interlace::Progressive && height < 2 {
        return Err("header: expected at least 2 lines in an interlaced picture, found 1".into());
    }
    Ok(Head { width: width as usize, height: height as usize, rate, interlace, chroma, full_range })
}

fn pixels(word: &str, value: &str) -> Result<u64, String> {
    value.parse().map_err(|_| format!("header: expected W and H with a number of pixels, found {word:?}"))
}

/// `F0:0` means that the rate is not known.
fn parse_rate(word: &str, value: &str) -> Result<Option<[u64; 2]>, String> {
    let numbers =
        value.split_once(':').and_then(|(n, d)| Some([n.parse::<u32>().ok()?, d.parse::<u32>().ok()?]));
    match numbers {
        Some([0, 0]) => Ok(None),
        Some([n, d]) if n > 0 && d > 0 => Ok(Some([u64::from(n), u64::from(d)])),
        _ => Err(format!("header: expected a rate such as F50:1, found {word:?}")),
    }
}

fn parse_interlace(word: &str, value: &str) -> Result<Interlace, String> {
    match value {
        "p" | "?" => Ok(Interlace::Progressive),
        "t" => Ok(Interlace::Top),
        "b" => Ok(Interlace::Bottom),
        _ => Err(format!("header: expected Ip, It or Ib, found {word:?}")),
    }
}

fn parse_range(value: &str, before: bool) -> Result<bool, String> {
    match value.strip_prefix("COLORRANGE=") {
        None => Ok(before),
        Some("FULL") => Ok(true),
        Some("LIMITED") => Ok(false),
        Some(other) => Err(format!("header: expected XCOLORRANGE=FULL or LIMITED, found {other:?}")),
    }
}

fn parse_chroma(value: &str) -> Result<Chroma, String> {
    let planes = |across, down, alpha| Ok(Chroma::Planes { across, down, alpha });
    match value {
        "mono" => Ok(Chroma::Mono),
        "420" | "420jpeg" | "420mpeg2" | "420paldv" => planes(2, 2, false),
        "411" => planes(4, 1, false),
        "422" => planes(2, 1, false),
        "444" => planes(1, 1, false),
        "444alpha" => planes(1, 1, true),
        _ => Err(format!(
            "header: expected a colour space of 8 bits a sample \
             (C420, C420jpeg, C420mpeg2, C420paldv, C411, C422, C444, C444alpha or Cmono), found {:?}",
            format!("C{value}")
        )),
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use proptest::prelude::*;

    fn read_all(bytes: &[u8]) -> Result<Vec<Picture>> {
        let mut clip = Clip::open(bytes, "c.y4m")?;
        let (mut all, mut picture) = (Vec::new(), Picture::default());
        while clip.read(&mut picture)? {
            all.push(picture.clone());
        }
        Ok(all)
    }

    fn clip(head: &str, samples: &[u8]) -> Vec<u8> {
        [head.as_bytes(), b"\nFRAME\n", samples].concat()
    }

    #[test]
    fn each_sampling_comes_out_as_every_second_column() {
        // 4 × 2 pixels; luma 16…23, then Cb, then Cr.
        let luma: Vec<u8> = (16..24).collect();
        let cases: [(&str, &[u8], [u8; 4]); 5] = [
            ("C420jpeg", &[50, 60, 150, 160], [50, 60, 50, 60]),
            ("C411", &[50, 60, 150, 160], [50, 50, 60, 60]),
            ("C422", &[50, 60, 70, 80, 150, 160, 170, 180], [50, 60, 70, 80]),
            ("C444", &[50, 52, 60, 62, 70, 72, 80, 82, 0, 0, 0, 0, 0, 0, 0, 0], [51, 61, 71, 81]),
            ("Cmono", &[], [128; 4]),
        ];
        for (space, chroma, blue) in cases {
            let bytes = clip(&format!("YUV4MPEG2 W4 H2 F25:1 Ip {space}"), &[&luma[..], chroma].concat());
            let all = read_all(&bytes).unwrap();
            assert_eq!((all.len(), &all[0].luma, &all[0].blue[..]), (1, &luma, &blue[..]), "{space}");
        }
    }

    #[test]
    fn interlaced_chroma_stays_in_its_field() {
        let bytes = clip("YUV4MPEG2 W2 H8 It C420paldv", &[&[16; 16][..], &[1, 2, 3, 4], &[0; 4]].concat());
        assert_eq!(read_all(&bytes).unwrap()[0].blue, [1, 2, 1, 2, 3, 4, 3, 4]);
        let bytes = clip("YUV4MPEG2 W1 H3 Ib C420paldv", &[&[16; 3][..], &[1, 2], &[0; 2]].concat());
        assert_eq!(read_all(&bytes).unwrap()[0].blue, [1, 2, 1]);
    }

    #[test]
    fn full_range_becomes_studio_range() {
        let bytes = clip("YUV4MPEG2 W2 H1 C422 XCOLORRANGE=FULL", &[0, 255, 128, 255]);
        let picture = &read_all(&bytes).unwrap()[0];
        assert_eq!((&picture.luma[..], picture.blue[0], picture.red[0]), (&[16, 235][..], 128, 240));
    }

    #[test]
    fn defects_are_named() {
        let head = "YUV4MPEG2 W4 H2 F25:1 Ip C422";
        let cases = [
            ("".into(), "a header line"),
            (b"RIFF\n".to_vec(), "begins with YUV4MPEG2"),
            (vec![b'Y'; 5000], "at most 1024 bytes"),
            (clip(&head.replace("W4", "W0"), &[]), "found 0x2"),
            (clip(&head.replace("W4", "W99999999"), &[]), "found 99999999x2"),
            (clip(&head.replace(" H2", ""), &[]), "found 4x0"),
            (clip(&head.replace("W4", "Wx"), &[]), "found \"Wx\""),
            (clip(&head.replace("C422", "C420p10"), &[]), "found \"C420p10\""),
            (clip(&head.replace("C422", "Cmono16"), &[]), "found \"Cmono16\""),
            (clip(&head.replace("25:1", "25:0"), &[]), "F50:1"),
            (clip(&head.replace("Ip", "Im"), &[]), "found \"Im\""),
            (clip(&head.replace("Ip", "Zp"), &[]), "found \"Zp\""),
            (clip(head, &[16; 15]), "picture 1: expected 16 bytes of samples, found the end after 15"),
            (clip(head, &[16; 20]), "picture 2: expected a line that begins with FRAME"),
            (format!("{head}\nFRAMES\n").into(), "picture 1: expected a line that begins with FRAME"),
        ];
        for (bytes, named) in cases {
            let error = read_all(&bytes).unwrap_err().to_string();
            assert!(error.starts_with("c.y4m") && error.contains(named), "{named}: {error}");
        }
    }

    proptest! {
        #[test]
        fn damaged_clips_are_read_or_refused(
            space in prop::sample::select(vec!["420", "411", "422", "444", "444alpha", "mono"]),
            (w, h, cut) in (1usize..9, 2usize..9, 0usize..400),
            damage in prop::collection::vec((0usize..400, any::<u8>()), 0..4),
        ) {
            let mut bytes = clip(&format!("YUV4MPEG2 W{w} H{h} F50:1 It A1:1 C{space}"), &[100; 300]);
            for (at, with) in damage {
                if let Some(byte) = bytes.get_mut(at) {
                    *byte = with;
                }
            }
            bytes.truncate(cut);
            for picture in read_all(&bytes).unwrap_or_default() {
                prop_assert_eq!(picture.luma.len(), picture.width * picture.height);
                prop_assert_eq!(picture.blue.len(), picture.red.len());
                prop_assert_eq!(picture.blue.len(), picture.chroma_width() * picture.height);
            }
        }

        #[test]
        fn memory_follows_the_bytes_not_the_header(w in 1u64..=8192, h in 1u64..=4096) {
            let bytes = clip(&format!("YUV4MPEG2 W{w} H{h} C444"), &[16; 2]);
            let mut clip = Clip::open(&bytes[..], "c.y4m").unwrap();
            let refused = clip.read(&mut Picture::default()).is_err();
            prop_assert!(refused || w * h * 3 <= 2);
            prop_assert!(clip.raw.capacity() <= 1 << 16, "{} bytes", clip.raw.capacity());
        }
    }
}
