//! Encoding and writing of pictures: stills, video, small JPEGs. A thread of its own does the work;
//! the display never waits for it. Pictures that it cannot take are dropped and counted.

pub mod mp4;
pub mod picture;
pub mod planes;
pub mod video;
pub mod y4m;

use crate::readback::Picture;
use crate::stereo::{Arrangement, arrange};
use image::{ExtendedColorType, ImageFormat};
use outputs::{OutputError, Outputs, STILLS};
use protocol::time::Nanos;
use std::path::{Path, PathBuf};
use std::sync::mpsc::{Receiver, SyncSender, TrySendError, sync_channel};
use std::thread::JoinHandle;
use video::{Video, VideoError};

/// Pictures in flight at most.
const POOL: usize = 3;
/// The thread's own niceness, on top of the process's.
const NICENESS: i32 = 15;

/// Files to write and their shape.
#[derive(Debug, Clone)]
pub struct OutputConfig {
    /// Folder for stills.
    pub stills: Option<PathBuf>,
    /// Video file.
    pub video: Option<PathBuf>,
    /// Write over files that exist.
    pub force: bool,
    /// Size of a channel of the video's pictures, px.
    pub video_px: [u32; 2],
    /// Pictures a second of the video.
    pub video_hz: u32,
    /// How the channels share a still or a picture of the video; small pictures keep them side by
    /// side.
    pub arrangement: Arrangement,
}

/// What to do with a picture.
#[derive(Debug, Clone, Copy, Default, PartialEq, Eq)]
pub struct PictureRequest {
    /// Number of the frame.
    pub frame: u64,
    /// Field shown.
    pub field: u64,
    /// When the picture was complete.
    pub displayed: Nanos,
    /// Save it as a numbered still.
    pub still: bool,
    /// Save it as `last.png`.
    pub last: bool,
    /// Encode it as a small JPEG.
    pub jpeg: bool,
    /// How many times to write it into the video.
    pub video: u64,
}

impl PictureRequest {
    /// True if there is nothing to do.
    pub fn is_empty(&self) -> bool {
        !(self.still || self.last || self.jpeg || self.video > 0)
    }
}

struct Job {
    picture: Picture,
    jpeg: Vec<u8>,
    request: PictureRequest,
    error: Option<String>,
}

/// The writing thread and its pool of pictures.
pub struct Output {
    jobs: Option<SyncSender<Job>>,
    done: Receiver<Job>,
    pool: Vec<Job>,
    thread: Option<JoinHandle<Option<String>>>,
    /// The first file that could not be written, and why.
    problem: Option<String>,
    /// Pictures dropped because none of the pool was free.
    pub dropped: u64,
    /// Pictures of the video among them, in whose place the next one stands, so that the video keeps
    /// the time.
    owed: u64,
}

impl Output {
    /// Opens the files and starts the thread; `first_tier` gives the largest picture.
    ///
    /// # Errors
    /// If a folder or file is refused, or the thread cannot be started.
    pub fn start(config: &OutputConfig, first_tier: usize) -> anyhow::Result<Self> {
        let mut outputs = Outputs::new(config.force);
        if let Some(folder) = &config.stills {
            outputs.claim_folder(folder, STILLS)?;
        }
        let [width_px, height_px] = config.video_px;
        let video_px = config.arrangement.size_px(width_px, height_px);
        let video = config.video.as_deref().map(|path| outputs.grow(path)).transpose()?;
        let video = video.map(|file| Video::begin(file, video_px, config.video_hz)).transpose()?;
        let (stills, arrangement) = (config.stills.clone(), config.arrangement);
        let mut writer = Writer { stills, video, arrangement };
        let (jobs, inbox) = sync_channel::<Job>(POOL);
        let (outbox, done) = sync_channel::<Job>(POOL);
        let thread = std::thread::Builder::new().name("pictures".into()).spawn(move || {
            let _ = rustix::process::nice(NICENESS);
            for mut job in inbox {
                job.error = writer.write(&mut job).err().map(|e| e.to_string());
                if outbox.send(job).is_err() {
                    break;
                }
            }
            writer.finish().err().map(|e| e.to_string())
        })?;
        let job = || Job {
            picture: Picture::with_room(first_tier),
            jpeg: Vec::with_capacity(protocol::limits::MAX_PICTURE_BYTES),
            request: PictureRequest::default(),
            error: None,
        };
        let pool = (0..POOL).map(|_| job()).collect();
        Ok(Self { jobs: Some(jobs), done, pool, thread: Some(thread), problem: None, dropped: 0, owed: 0 })
    }

    /// Lets `fill` fill a free picture and sends it to the thread. Without a free one the request
    /// is dropped and counted.
    ///
    /// # Errors
    /// Those of `fill`.
    pub fn submit<E>(
        &mut self,
        mut request: PictureRequest,
        fill: impl FnOnce(&mut Picture) -> Result<(), E>,
    ) -> Result<(), E> {
        if request.video > 0 {
            request.video += std::mem::take(&mut self.owed);
        }
        let (Some(mut job), Some(jobs)) = (self.pool.pop(), &self.jobs) else {
            self.drop_picture(&request);
            return Ok(());
        };
        let filled = fill(&mut job.picture);
        job.request = request;
        if filled.is_err() {
            self.pool.push(job);
            return filled;
        }
        if let Err(TrySendError::Full(job) | TrySendError::Disconnected(job)) = jobs.try_send(job) {
            self.drop_picture(&job.request);
            self.pool.push(job);
        }
        Ok(())
    }

    fn drop_picture(&mut self, request: &PictureRequest) {
        self.dropped += 1;
        self.owed += request.video;
    }

    /// Takes finished pictures back; calls `finished` with each small JPEG and what it is of.
    pub fn collect(&mut self, mut finished: impl FnMut(PictureRequest, &[u8])) {
        while let Ok(job) = self.done.try_recv() {
            if job.error.is_none() && job.request.jpeg {
                finished(job.request, &job.jpeg);
            }
            self.take_back(job);
        }
    }

    /// The first file that could not be written, and why.
    pub fn problem(&self) -> Option<&str> {
        self.problem.as_deref()
    }

    fn take_back(&mut self, mut job: Job) {
        let error = job.error.take();
        self.problem = self.problem.take().or(error);
        self.pool.push(job);
    }

    /// Waits until a picture of the pool is free.
    pub fn wait_for_slot(&mut self) {
        if self.pool.is_empty()
            && let Ok(job) = self.done.recv()
        {
            self.take_back(job);
        }
    }

    /// Finishes the pictures in flight and closes the files; returns the first error of all.
    pub fn finish(mut self) -> Option<String> {
        self.jobs = None;
        while let Ok(job) = self.done.recv() {
            self.take_back(job);
        }
        let unclosed = self.thread.take().and_then(|thread| thread.join().ok().flatten());
        self.problem.or(unclosed)
    }
}

struct Writer {
    stills: Option<PathBuf>,
    video: Option<Video>,
    arrangement: Arrangement,
}

impl Writer {
    fn write(&mut self, job: &mut Job) -> Result<(), Box<dyn std::error::Error>> {
        if job.request.jpeg {
            picture::small_jpeg(&job.picture, &mut job.jpeg)?;
        }
        arrange(&mut job.picture, self.arrangement);
        if let Some(folder) = &self.stills {
            if job.request.still {
                save_png(&folder.join(format!("frame-{:06}.png", job.request.frame)), &job.picture)?;
            }
            if job.request.last {
                save_png(&folder.join("last.png"), &job.picture)?;
            }
        }
        if let (Some(video), count @ 1..) = (&mut self.video, job.request.video) {
            video.write(&job.picture, count)?;
        }
        Ok(())
    }

    fn finish(&mut self) -> Result<(), VideoError> {
        self.video.as_mut().map_or(Ok(()), Video::finish)
    }
}

/// Saves `picture` as a PNG, in the place of one that is there; the file appears whole or not at
/// all.
///
/// # Errors
/// If the file cannot be written.
pub fn save_png(path: &Path, picture: &Picture) -> Result<(), SaveError> {
    let (rgb, size) = (picture::rgb(picture), [picture.width_px, picture.height_px]);
    outputs::save(Outputs::new(true).create(path)?, |file| {
        image::write_buffer_with_format(
            file,
            &rgb,
            size[0],
            size[1],
            ExtendedColorType::Rgb8,
            ImageFormat::Png,
        )?;
        Ok(())
    })
}

/// Why a picture could not be saved.
#[derive(Debug, thiserror::Error)]
pub enum SaveError {
    /// The file is refused.
    #[error(transparent)]
    Output(#[from] OutputError),
    /// The picture could not be encoded or written.
    #[error(transparent)]
    Image(#[from] image::ImageError),
}

#[cfg(test)]
mod tests {
    use super::*;

    fn picture(value: u8) -> Picture {
        Picture { width_px: 8, height_px: 4, rgba: vec![value; 8 * 4 * 4] }
    }

    fn config(folder: Option<&Path>, arrangement: Arrangement) -> OutputConfig {
        OutputConfig {
            stills: folder.map(Into::into),
            video: folder.map(|f| f.join("v.y4m")),
            video_px: [4, 4],
            video_hz: 25,
            force: false,
            arrangement,
        }
    }

    #[test]
    fn stills_video_and_jpeg_are_written() {
        let folder = tempfile::tempdir().unwrap();
        let folder = folder.path();
        let config = config(Some(folder), Arrangement::SideBySide);
        let mut output = Output::start(&config, 8).unwrap();
        let request = PictureRequest {
            frame: 7,
            still: true,
            last: true,
            jpeg: true,
            video: 2,
            ..PictureRequest::default()
        };
        let fill = |p: &mut Picture| {
            *p = picture(90);
            Ok::<(), ()>(())
        };
        output.submit(request, fill).unwrap();
        (0..POOL).for_each(|_| output.wait_for_slot());
        assert_eq!(output.finish(), None);
        let still = image::open(folder.join("frame-000007.png")).unwrap().to_rgb8();
        assert_eq!((still.dimensions(), still.get_pixel(3, 3).0), ((8, 4), [90; 3]));
        assert!(folder.join("last.png").is_file());
        let video = std::fs::read(folder.join("v.y4m")).unwrap();
        assert_eq!(video.windows(5).filter(|w| w == b"FRAME").count(), 2);
    }

    #[test]
    fn files_are_arranged_and_small_pictures_are_not() {
        let folder = tempfile::tempdir().unwrap();
        let folder = folder.path();
        let mut output = Output::start(&config(Some(folder), Arrangement::Right), 8).unwrap();
        let fill = |p: &mut Picture| {
            *p = picture(90);
            p.rgba.chunks_mut(32).for_each(|row| row[16..].fill(30));
            Ok::<(), ()>(())
        };
        let request = PictureRequest { still: true, jpeg: true, video: 1, ..PictureRequest::default() };
        output.submit(request, fill).unwrap();
        let mut jpeg = None;
        while jpeg.is_none() {
            output.collect(|_, bytes| jpeg = Some(bytes.to_vec()));
            std::thread::yield_now();
        }
        assert_eq!(output.finish(), None);
        let still = image::open(folder.join("frame-000000.png")).unwrap().to_rgb8();
        assert_eq!((still.dimensions(), still.get_pixel(1, 1).0), ((4, 4), [30; 3]));
        let video = std::fs::read(folder.join("v.y4m")).unwrap();
        assert!(video.starts_with(b"YUV4MPEG2 W4 H4 "));
        assert_eq!(image::load_from_memory(&jpeg.unwrap()).unwrap().width(), 8);
    }

    #[test]
    fn a_full_pool_drops_and_counts() {
        let config = config(None, Arrangement::default());
        let mut output = Output::start(&config, 8).unwrap();
        let held: Vec<Job> = output.pool.drain(..).collect();
        let filled =
            output.submit(PictureRequest { jpeg: true, ..PictureRequest::default() }, |_| Err("not asked"));
        assert_eq!((filled, output.dropped, held.len()), (Ok(()), 1, POOL));
        output.finish();
    }

    #[test]
    fn a_video_keeps_the_time_where_pictures_are_dropped() {
        let folder = tempfile::tempdir().unwrap();
        let mut output = Output::start(&config(Some(folder.path()), Arrangement::default()), 8).unwrap();
        let submit = |output: &mut Output, video| {
            let fill = |p: &mut Picture| {
                *p = picture(90);
                Ok::<(), ()>(())
            };
            output.submit(PictureRequest { video, ..PictureRequest::default() }, fill).unwrap();
        };
        let held: Vec<Job> = output.pool.drain(..).collect();
        (0..2).for_each(|_| submit(&mut output, 2));
        output.pool.extend(held);
        submit(&mut output, 1);
        assert_eq!((output.dropped, output.finish()), (2, None));
        let video = std::fs::read(folder.path().join("v.y4m")).unwrap();
        assert_eq!(video.windows(5).filter(|w| w == b"FRAME").count(), 5);
    }

    #[test]
    fn a_video_of_another_ending_is_refused() {
        let folder = tempfile::tempdir().unwrap();
        let video = Some(folder.path().join("v.avi"));
        let other = OutputConfig { video, ..config(None, Arrangement::default()) };
        let told = Output::start(&other, 8).err().expect("refused").to_string();
        assert!(told.contains("v.avi") && told.contains(".mp4"), "{told}");
    }

    #[test]
    fn a_file_that_fills_the_disk_is_told_at_once_and_at_the_end() {
        let folder = tempfile::tempdir().unwrap();
        let video = folder.path().join("full.y4m");
        std::os::unix::fs::symlink("/dev/full", &video).unwrap();
        let full =
            OutputConfig { video: Some(video), video_px: [256, 256], ..config(None, Arrangement::default()) };
        let mut output = Output::start(&full, 8).unwrap();
        for _ in 0..100 {
            output.wait_for_slot();
            let request = PictureRequest { video: 1, ..PictureRequest::default() };
            let fill = |p: &mut Picture| {
                *p = Picture { width_px: 512, height_px: 256, rgba: vec![50; 4 * 512 * 256] };
                Ok::<(), ()>(())
            };
            output.submit(request, fill).unwrap();
        }
        assert!(output.problem().is_some(), "so much is in no buffer");
        assert!(output.finish().is_some_and(|p| p.contains("full.y4m") && p.contains("disk is full")));
    }

    #[test]
    fn an_impossible_folder_is_an_error() {
        let impossible = config(Some(Path::new("/proc/nowhere/stills")), Arrangement::default());
        assert!(Output::start(&impossible, 8).is_err());
    }
}
