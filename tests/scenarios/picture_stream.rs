//! The picture stream for a console: small JPEGs of both channels at a bounded rate, whoever reads
//! them or not.

use ipc::clock::now;
use ipc::wait;
use protocol::frames::FrameRecord;
use renderer::gpu::Gpu;
use vitreo_tests::{Observer, Running, WATCHDOG, instance_name, next};

/// Pictures a second that a renderer sends by default.
const RATE_HZ: f64 = 2.0;
/// Widest picture, both channels, px.
const WIDEST_PX: u32 = 640;
/// Pictures looked at.
const PICTURES: usize = 4;

#[test]
fn a_console_gets_small_pictures_and_a_reader_that_sleeps_delays_no_frame() {
    if let Err(e) = Gpu::headless() {
        return skips::skip(&e);
    }
    let name = instance_name();
    let running = Running::start(&["run", "--headless", "--direct", "--duration", "8", "--instance", &name]);
    let observer = Observer::join(&name);
    // One that opens the channel and never reads.
    let _sleeper = observer.pictures();
    let mut pictures = observer.pictures();
    let mut frames = observer.receiver::<FrameRecord>();
    let deadline = now() + WATCHDOG.as_nanos() as u64;
    let mut seen: Vec<(u64, u64)> = Vec::new();
    while seen.len() < PICTURES && now() < deadline {
        wait(&[&pictures], 5_000_000);
        while let Some(sample) = pictures.receive().expect("channel works") {
            let header = sample.header();
            let jpeg = &sample.payload()[..header.bytes as usize];
            let format = image::guess_format(jpeg).expect("a picture");
            assert_eq!(format, image::ImageFormat::Jpeg);
            let picture = image::load_from_memory(jpeg).expect("a whole JPEG").to_rgb8();
            assert!(
                picture.width() <= WIDEST_PX && picture.width() * 2 == picture.height() * 5,
                "two of 5:4"
            );
            let brightest = picture.pixels().map(|p| p[0]).max().unwrap_or(0);
            assert!(brightest > 100, "the lit retina is on it: {brightest}");
            seen.push((header.frame, header.displayed));
        }
    }
    assert_eq!(seen.len(), PICTURES, "pictures came: {seen:?}");
    assert!(seen.windows(2).all(|w| w[0].0 < w[1].0 && w[0].1 < w[1].1), "each is newer: {seen:?}");
    let span_s = (seen[PICTURES - 1].1 - seen[0].1) as f64 * 1e-9;
    assert!((PICTURES as f64) <= RATE_HZ * span_s + 2.0, "{PICTURES} pictures within {span_s} s");
    // The display went on: far more frames than pictures, whatever the readers did.
    let last = seen[PICTURES - 1].0;
    next(&mut frames, |frame| frame.frame > last);
    assert!(last - seen[0].0 > 3 * PICTURES as u64, "frames between pictures: {seen:?}");
    running.finish().expect_code(0);
}
