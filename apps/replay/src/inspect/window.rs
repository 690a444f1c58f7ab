//! The window of `vitreo inspect`: the cameras' view of a field above, time below, and keys that lead through both.

use super::browse::{Browser, FrameSummary, Order, rows};
use super::field_view::{FieldView, legend};
use super::frame_store::{FrameStore, FrameWriter};
use super::seen::Seen;
use super::time_line::{TimeLine, TimeLinePicture};
use crate::matched;
use anyhow::bail;
use image::RgbImage;
use image::imageops::replace;
use ipc::logging::inform;
use outputs::Outputs;
use outputs::exit::WrongUse;
use plots::{Area, Drawn, FONT, Figure};
use plotters::prelude::*;
use recording::Recording;
use renderer::present::picture::{Event, PictureWindow};
use rig::Rig;
use std::ops::ControlFlow;
use std::path::{Path, PathBuf};
use std::time::{Duration, Instant};

/// Size of the window at the start, px.
const SIZE_PX: [u32; 2] = [1500, 920];
/// Least size of a picture that is drawn; a smaller window shows a part of it.
const LEAST_PX: [u32; 2] = [480, 480];
/// Height of the line that says where one is, px.
const LINE_PX: u32 = 30;
/// Height of the time line as a share of the window, and at least, px.
const TIME_SHARE: f64 = 0.42;
const TIME_LEAST_PX: u32 = 240;
/// Between two looks while nothing is due, and while it plays.
const LOOK: Duration = Duration::from_millis(100);
const PLAYING: Duration = Duration::from_millis(5);
/// Frames that are read between two looks at whether the window was closed.
const FRAMES_A_LOOK: usize = 64;
const CURSOR: image::Rgb<u8> = image::Rgb([200, 0, 0]);

/// Shows a recording until the person ends it, beginning with `field`.
///
/// # Errors
/// Where there is no display, or the recording does not hold the field, or cannot be read.
pub fn run(recording: &Recording, rig: &Rig, field: Option<u64>) -> anyhow::Result<matched::Outcome> {
    // First: if no window can open, the user learns it at once.
    let title = format!("vitreo inspect {}", recording.path().display());
    let mut window = PictureWindow::open(&title, SIZE_PX)?;
    let (mut writer, mut line, mut frames) = (FrameWriter::new()?, TimeLine::default(), Vec::new());
    let mut closed = false;
    let outcome = matched::run(recording, rig, "inspect", |found| {
        writer.add(&Seen::new(rig, &found))?;
        line.note(found.frame, found.matches);
        frames.push(FrameSummary {
            exposed_ns: found.frame.instants.exposed,
            field: found.frame.field,
            conspicuous: line.last_is_conspicuous(),
        });
        // Looking at a window takes longer than a frame.
        let looks = frames.len().is_multiple_of(FRAMES_A_LOOK);
        closed = looks && window.wait(Duration::ZERO).contains(&Event::Closed);
        Ok(if closed { ControlFlow::Break(()) } else { ControlFlow::Continue(()) })
    })?;
    if closed {
        return Ok(outcome);
    }
    let name = recording.path().display();
    let (Some(first), Some(last)) = (frames.first(), frames.last()) else {
        bail!("{name}: contains no tracker frame");
    };
    let at = match field {
        None => 0,
        Some(field) => frames.iter().position(|m| m.field == field).ok_or_else(|| {
            let holds = format!("it contains fields {} to {}", first.field, last.field);
            WrongUse(format!("{name}: no field {field}; {holds}"))
        })?,
    };
    let browser = Browser::new(frames, at, rig.cameras().len());
    let mut show = Show { window, frame_store: writer.finish()?, line, browser, drawn: None, played: None };
    show.serve()?;
    Ok(outcome)
}

struct Show {
    window: PictureWindow,
    frame_store: FrameStore,
    line: TimeLine,
    browser: Browser,
    /// The time line in the size in which it is shown.
    drawn: Option<RgbImage>,
    /// Since when it plays, and from what time, s.
    played: Option<(Instant, f64)>,
}

impl Show {
    fn serve(&mut self) -> anyhow::Result<()> {
        let mut picture = self.draw()?;
        loop {
            let wait = if self.browser.playing { PLAYING } else { LOOK };
            let happened = self.window.wait(wait);
            let mut changed = self.play_on();
            for what in &happened {
                match what {
                    Event::Closed => return Ok(()),
                    Event::Uncovered => changed = true,
                    Event::Point(at) => changed |= self.point(*at),
                    Event::Press(key) => {
                        changed = true;
                        match self.browser.press(*key) {
                            Order::Quit => return Ok(()),
                            Order::Save => self.browser.said = self.save(&picture),
                            Order::Draw => {}
                        }
                    }
                }
            }
            if changed {
                picture = self.draw()?;
            }
        }
    }

    /// Goes on where it plays, as time does; true if another frame is due.
    fn play_on(&mut self) -> bool {
        if !self.browser.playing {
            self.played = None;
            return false;
        }
        let before = self.browser.at();
        let (since, from_s) =
            *self.played.get_or_insert_with(|| (Instant::now(), self.browser.time_s(self.browser.at())));
        self.browser.go_to_time(from_s + since.elapsed().as_secs_f64());
        if self.browser.is_at_end() {
            self.browser.playing = false;
            return true;
        }
        self.browser.at() != before
    }

    /// Goes to the place of the time line under the pointer; true if there is one.
    fn point(&mut self, [x, y]: [f64; 2]) -> bool {
        let [width, height] = self.size_px();
        if y < f64::from(height - time_px(height)) {
            return false;
        }
        let Some(s) = self.line.time_at(x, width) else { return false };
        self.browser.playing = false;
        self.browser.go_to_time(s);
        true
    }

    fn size_px(&self) -> [u32; 2] {
        let [width, height] = self.window.size_px();
        [width.max(LEAST_PX[0]), height.max(LEAST_PX[1])]
    }

    /// Draws and shows what the person looks at.
    fn draw(&mut self) -> anyhow::Result<RgbImage> {
        let [width, height] = self.size_px();
        let below = time_px(height);
        let seen = self.frame_store.get(self.browser.at())?;
        let size_px = Some([width, height - below - LINE_PX]);
        let view = FieldView { seen: &seen, size_px, alone: self.browser.alone };
        let above = Above { line: self.browser.line(), view, help: self.browser.help };
        let mut picture = RgbImage::new(width, height);
        replace(&mut picture, &plots::pixels(&above)?, 0, 0);
        if self.drawn.as_ref().is_none_or(|drawn| drawn.dimensions() != (width, below)) {
            self.drawn = Some(plots::pixels(&TimeLinePicture { line: &self.line, size_px: [width, below] })?);
        }
        if let Some(drawn) = &self.drawn {
            replace(&mut picture, drawn, 0, i64::from(height - below));
        }
        let x = self.line.x_of(self.browser.time_s(self.browser.at()), width);
        (height - below..height).for_each(|y| picture.put_pixel(x.min(width - 1), y, CURSOR));
        self.window.show(picture.as_raw(), [width, height])?;
        Ok(picture)
    }

    /// Writes the picture into the folder of the person, and says what became of it.
    fn save(&self, picture: &RgbImage) -> String {
        let path = PathBuf::from(format!("inspect-{}.png", self.browser.field()));
        match write(&path, picture) {
            Ok(()) => {
                inform(&format!("{}: written", path.display()));
                format!("saved as {}", path.display())
            }
            Err(why) => format!("not saved: {why:#}"),
        }
    }
}

fn write(path: &Path, picture: &RgbImage) -> anyhow::Result<()> {
    let mut outputs = Outputs::new(false);
    outputs.claim(path)?;
    let mut bytes = std::io::Cursor::new(Vec::new());
    picture.write_to(&mut bytes, image::ImageFormat::Png)?;
    Ok(outputs.write(path, bytes.into_inner())?)
}

/// Height of the time line in a window of that height, px.
fn time_px(height: u32) -> u32 {
    ((f64::from(height) * TIME_SHARE) as u32).max(TIME_LEAST_PX)
}

/// What stands above the time line.
struct Above<'a> {
    line: String,
    view: FieldView<'a>,
    help: bool,
}

impl Figure for Above<'_> {
    fn size_px(&self) -> (u32, u32) {
        let (width, height) = self.view.size_px();
        (width, height + LINE_PX)
    }

    fn draw<B: DrawingBackend>(&self, area: &Area<B>) -> Drawn<B> {
        area.draw(&Text::new(self.line.clone(), (14, 9), (FONT, 17)))?;
        let (_, below) = area.split_vertically(LINE_PX);
        if !self.help {
            return self.view.draw(&below);
        }
        for (n, (keys, text)) in rows().enumerate() {
            let y = 14 + 22 * n as i32;
            below.draw(&Text::new(keys, (30, y), (FONT, 16)))?;
            below.draw(&Text::new(text, (190, y), (FONT, 16)))?;
        }
        legend(&below, (760, 14))
    }
}
