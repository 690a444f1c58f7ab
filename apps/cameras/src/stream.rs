//! A live stream of pictures (YUV4MPEG2), checked against the camera that it stands for.
//!
//! A progressive picture of half the height of a frame is a field, an interlaced one of the height of
//! a frame is two; anything else is refused. A header in the middle of a stream begins another clip,
//! which is checked as the first one was.

use anyhow::{Result, bail, ensure};
use fpga_model::colours::convert::BLACK;
use fpga_model::input::y4m::{Clip, Head};
use fpga_model::input::{Interlace, Picture};
use rig::sensor::Scan;
use std::io::BufRead;

/// A picture is black where no sample is brighter than black by this, grey levels: as bright as the
/// faintest marker would have to be.
const SEEN: u8 = 24;
/// Samples that are looked at together.
const TOGETHER: usize = 4096;
/// Rates that differ by less than this share are the same.
const SAME_RATE: f64 = 0.01;

/// The camera that a stream stands for.
#[derive(Debug, Clone, PartialEq)]
pub struct Expected {
    /// Width and height of its frames, px.
    pub frame_px: [u32; 2],
    /// Whether its fields are whole frames.
    pub scan: Scan,
    /// Fields a second.
    pub field_hz: f64,
    /// A parity was given, which interlaced pictures have themselves.
    pub has_parity: bool,
}

impl Expected {
    /// Refuses pictures that are not the camera's.
    fn check(&self, head: &Head) -> Result<()> {
        let [width, height] = self.frame_px.map(|n| n as usize);
        let found = [head.width, head.height];
        let interlaced = head.interlace != Interlace::Progressive;
        if self.scan == Scan::Progressive {
            ensure!(
                !interlaced && found == [width, height],
                "has {} of {}×{} px; the rig expects whole frames of {width}×{height} px (Ip), because its \
                 scan is progressive",
                if interlaced { "interlaced frames" } else { "pictures" },
                found[0],
                found[1]
            );
            if self.has_parity {
                bail!("has whole frames, which have all lines: omit ?parity");
            }
            return Ok(());
        }
        let what = if interlaced { "interlaced frames" } else { "progressive pictures" };
        ensure!(
            found == [width, if interlaced { height } else { height / 2 }],
            "has {what} of {}×{} px; the rig expects fields of {width}×{} px (Ip) or interlaced frames of \
             {width}×{height} px (It, Ib)",
            found[0],
            found[1],
            height / 2
        );
        if interlaced && self.has_parity {
            bail!("has interlaced frames, which contain the order of their fields: omit ?parity");
        }
        Ok(())
    }

    /// What the header says of the rate, where that is not the camera's.
    fn other_rate(&self, head: &Head) -> Option<String> {
        let [pictures, seconds] = head.rate?;
        let hz = pictures as f64 / seconds as f64 * head.interlace.parities().len() as f64;
        let same = (hz / self.field_hz - 1.0).abs() < SAME_RATE;
        (!same).then(|| format!("has {hz:.2} fields per second; the rig's {:.2} are used", self.field_hz))
    }
}

/// A stream that is being read.
pub struct PictureStream<R> {
    clip: Option<Clip<R>>,
    expected: Expected,
    /// How its pictures are interlaced.
    pub interlace: Interlace,
    /// What is odd about its rate, in words, until it is taken.
    pub note: Option<String>,
    /// Pictures that were read since the newest header.
    pub count: u64,
}

impl<R: BufRead> PictureStream<R> {
    /// Reads the header.
    ///
    /// # Errors
    /// A header that is malformed, or pictures that are not the camera's; the text follows its name.
    pub fn open(input: R, expected: Expected) -> Result<Self> {
        let interlace = Interlace::Progressive;
        let mut stream = PictureStream { clip: None, expected, interlace, note: None, count: 0 };
        stream.take(Clip::open(input, NAME))?;
        Ok(stream)
    }

    fn take(&mut self, clip: Result<Clip<R>>) -> Result<()> {
        let clip = clip?;
        self.expected.check(&clip.head)?;
        (self.interlace, self.note) = (clip.head.interlace, self.expected.other_rate(&clip.head));
        (self.clip, self.count) = (Some(clip), 0);
        Ok(())
    }

    /// Reads the next picture; false at the end of the stream.
    ///
    /// # Errors
    /// A picture that is incomplete, or what is no picture; the stream is then of no more use.
    pub fn read(&mut self, into: &mut Picture) -> Result<bool> {
        let Some(clip) = &mut self.clip else { bail!("contains nothing readable") };
        if clip.begins_anew()? {
            let following = self.clip.take().map(Clip::following);
            following.map_or(Ok(()), |clip| self.take(clip))?;
        }
        let is_read = self.clip.as_mut().map_or(Ok(false), |clip| clip.read(into))?;
        self.count += u64::from(is_read);
        Ok(is_read)
    }
}

/// What errors of the clip begin with.
const NAME: &str = "is not YUV4MPEG2";

/// True where nothing in the picture is brighter than black.
pub fn is_black(picture: &Picture) -> bool {
    let brightest = |samples: &[u8]| samples.iter().copied().max().unwrap_or(0);
    picture.luma.chunks(TOGETHER).all(|samples| brightest(samples) < BLACK + SEEN)
}

#[cfg(test)]
mod tests {
    use super::*;

    fn expected() -> Expected {
        Expected { frame_px: [4, 4], scan: Scan::Interlaced, field_hz: 50.0, has_parity: false }
    }

    fn clip(head: &str, pictures: usize, luma: u8) -> Vec<u8> {
        let lines = if head.contains("H4") { 4 } else { 2 };
        let picture = [&b"FRAME\n"[..], &vec![luma; 4 * lines], &vec![128; 4 * lines]].concat();
        [head.as_bytes(), b" C422\n", &picture.repeat(pictures)].concat()
    }

    /// Luma of the pictures, and how the stream ended.
    fn read(bytes: &[u8], expected: Expected) -> (Vec<u8>, Result<()>) {
        let mut all = Vec::new();
        let mut stream = match PictureStream::open(bytes, expected) {
            Ok(stream) => stream,
            Err(refused) => return (all, Err(refused)),
        };
        let mut picture = Picture::default();
        loop {
            match stream.read(&mut picture) {
                Ok(true) => all.push(picture.luma[0]),
                Ok(false) => return (all, Ok(())),
                Err(problem) => return (all, Err(problem)),
            }
        }
    }

    #[test]
    fn fields_and_interlaced_frames_are_taken() {
        let bytes = clip("YUV4MPEG2 W4 H2 F50:1 Ip", 3, 40);
        assert!(matches!(read(&bytes, expected()), (luma, Ok(())) if luma == [40; 3]));
        for (flag, parities) in [("It", [0, 1]), ("Ib", [1, 0])] {
            let bytes = clip(&format!("YUV4MPEG2 W4 H4 F25:1 {flag}"), 1, 40);
            let stream = PictureStream::open(&bytes[..], expected()).unwrap();
            assert_eq!((stream.interlace.parities(), &stream.note), (&parities[..], &None));
        }
    }

    #[test]
    fn what_is_not_the_cameras_is_refused_by_name() {
        let with_parity = Expected { has_parity: true, ..expected() };
        for (head, expected, named) in [
            (
                "YUV4MPEG2 W4 H4 Ip",
                expected(),
                "progressive pictures of 4×4 px; the rig expects fields of 4×2 px",
            ),
            ("YUV4MPEG2 W4 H2 It", expected(), "interlaced frames of 4×2 px"),
            ("YUV4MPEG2 W6 H2 Ip", expected(), "6×2"),
            ("YUV4MPEG2 W4 H4 It", with_parity, "omit ?parity"),
            ("YUV4MPEG2 W4 H2 Ip C420p10", expected(), "a colour space of 8 bits a sample"),
            ("RIFF", expected(), "begins with YUV4MPEG2"),
        ] {
            let (luma, ended) = read(&clip(head, 1, 40), expected);
            let told = ended.unwrap_err().to_string();
            assert!(luma.is_empty() && told.contains(named), "{head}: {told}");
        }
    }

    #[test]
    fn a_progressive_camera_takes_whole_frames_alone() {
        let whole = Expected { scan: Scan::Progressive, ..expected() };
        let bytes = clip("YUV4MPEG2 W4 H4 F50:1 Ip", 2, 40);
        assert!(matches!(read(&bytes, whole.clone()), (luma, Ok(())) if luma == [40; 2]));
        let with_parity = Expected { has_parity: true, ..whole.clone() };
        for (head, expected, named) in [
            (
                "YUV4MPEG2 W4 H2 Ip",
                whole.clone(),
                "pictures of 4×2 px; the rig expects whole frames of 4×4 px",
            ),
            ("YUV4MPEG2 W4 H4 It", whole, "has interlaced frames of 4×4 px"),
            ("YUV4MPEG2 W4 H4 Ip", with_parity, "omit ?parity"),
        ] {
            let told = read(&clip(head, 1, 40), expected).1.unwrap_err().to_string();
            assert!(told.contains(named), "{head}: {told}");
        }
    }

    #[test]
    fn another_header_begins_another_clip_that_is_checked_too() {
        let field = clip("YUV4MPEG2 W4 H2 F50:1 Ip", 1, 40);
        let twice = [field.clone(), clip("YUV4MPEG2 W4 H2 F50:1 Ip", 2, 50)].concat();
        assert!(matches!(read(&twice, expected()), (luma, Ok(())) if luma == [40, 50, 50]));
        let mut stream = PictureStream::open(&twice[..], expected()).unwrap();
        let count =
            |stream: &mut PictureStream<_>| (stream.read(&mut Picture::default()).unwrap(), stream.count);
        assert_eq!([(); 4].map(|()| count(&mut stream)), [(true, 1), (true, 1), (true, 2), (false, 2)]);
        let (luma, ended) = read(&[field, clip("YUV4MPEG2 W4 H4 Ip", 1, 40)].concat(), expected());
        let told = ended.unwrap_err().to_string();
        assert!(luma == [40] && told.contains("progressive pictures of 4×4"), "{told}");
    }

    #[test]
    fn a_rate_that_is_not_the_rigs_is_noted() {
        let note = |rate: &str| {
            let bytes = clip(&format!("YUV4MPEG2 W4 H2 {rate} Ip"), 0, 0);
            PictureStream::open(&bytes[..], expected()).unwrap().note
        };
        assert_eq!((note("F50:1"), note("F0:0"), note("F50001:1000")), (None, None, None));
        assert!(note("F25:1").unwrap().contains("has 25.00 fields per second"));
    }

    #[test]
    fn a_picture_with_one_marker_is_not_black() {
        let mut picture = Picture { luma: vec![BLACK + SEEN - 1; 3 * TOGETHER], ..Picture::default() };
        assert!(is_black(&picture));
        picture.luma[2 * TOGETHER + 7] = BLACK + SEEN;
        assert!(!is_black(&picture));
    }
}
