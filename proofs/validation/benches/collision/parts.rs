//! The parts of a look of ZCOLL on the processor and on an adapter, as in the paper's Table 1.

use crate::median;
use crate::setting::{SIZES, Setting};
use collision::instrument_image::{InstrumentImage, Volume};
use collision::zcoll::{Part, Zcoll};
use std::time::Instant;

/// Looks at each size.
const LOOKS: usize = 401;

/// Medians of drawing, comparing and retrieving, and of a whole look, µs.
fn parts(setting: &mut Setting) -> [f64; 4] {
    let volume = Volume { half_mm: 0.75, near_mm: -0.25, depth_mm: 1.5, resolution: 32 };
    let (mesh, jaw_rad) = Setting::tool();
    let mut image = InstrumentImage::of_mesh(mesh, &volume);
    image.prepare(jaw_rad, &volume);
    let mut zcoll = Zcoll::new(volume, &setting.triangles, setting.nodes()).expect("a sheet");
    let mut times: [Vec<f64>; 4] = Default::default();
    for number in 0..LOOKS {
        setting.displace(number);
        let frame = setting.frame();
        let begun = Instant::now();
        let mut last = begun;
        let found = zcoll.query_in_parts(&image, &frame.instrument_from_eye, &frame.surface, &mut |part| {
            let now = Instant::now();
            let place = [Part::Drawn, Part::Compared, Part::Retrieved].iter().position(|p| *p == part);
            times[place.expect("a part of the table")].push((now - last).as_secs_f64() * 1e6);
            last = now;
        });
        times[3].push(begun.elapsed().as_secs_f64() * 1e6);
        assert!(found.pixels > 0, "look {number} must see something");
    }
    assert!(times.iter().all(|t| t.len() == LOOKS), "every part of every look is timed");
    times.each_mut().map(|t| median(t))
}

/// Medians of drawing, analysis and read-back by the adapter's clock, and of a whole look by the host's, µs; the adapter's
/// name. `None` without an adapter or timestamps.
#[cfg(feature = "gpu")]
fn parts_on_adapter(setting: &mut Setting) -> Option<([f64; 4], String)> {
    use collision::gpu::{GpuDevice, GpuZcoll};
    let volume = Volume { half_mm: 0.75, near_mm: -0.25, depth_mm: 1.5, resolution: 32 };
    let (mesh, jaw_rad) = Setting::tool();
    let mut image = InstrumentImage::of_mesh(mesh, &volume);
    image.prepare(jaw_rad, &volume);
    let device =
        GpuDevice::open().map_err(|error| eprintln!("parts on an adapter left out: {error}")).ok()?;
    let name = device.name().to_string();
    let mut zcoll = GpuZcoll::new(device, volume, &setting.triangles, setting.nodes()).expect("memory");
    if !zcoll.time_parts() {
        eprintln!("parts on an adapter left out: {name} has no timestamps");
        return None;
    }
    let mut times: [Vec<f64>; 4] = Default::default();
    for number in 0..LOOKS {
        setting.displace(number);
        let frame = setting.frame();
        let begun = Instant::now();
        let found = zcoll
            .query(&image.ahead(), &frame.instrument_from_eye, &frame.surface)
            .expect("the adapter must not fail");
        let all = begun.elapsed().as_secs_f64() * 1e6;
        assert!(found.pixels > 0, "look {number} must see something");
        let parts = zcoll.part_times().expect("the adapter must not fail").expect("parts are timed");
        let each = [parts.draw, parts.analyse, parts.read_back].map(|ns| ns * 1e-3);
        times.iter_mut().zip(each.into_iter().chain([all])).for_each(|(of, time)| of.push(time));
    }
    Some((times.each_mut().map(|t| median(t)), name))
}

#[cfg(not(feature = "gpu"))]
fn parts_on_adapter(_: &mut Setting) -> Option<([f64; 4], String)> {
    None
}

/// The paper's Table 1 (Wagner, Schill, Männer 2002) beside ours.
pub fn print_table_1() {
    let [small, large] = [0, 1].map(|i| parts(&mut Setting::new(SIZES[i])));
    let line = |part: &str, paper: &str, n: usize| {
        println!("  {part:38} {paper:20} {:>6.2} µs   {:>6.2} µs", small[n], large[n]);
    };
    println!(
        "\nThe paper's Table 1, medians of {LOOKS} looks    2002: 1k, 3k         1k membrane  3k membrane"
    );
    line("A, drawing the membrane", "0.4 ms, 0.6 ms", 0);
    println!("  B, C, read-back of depth and colour    0.4 ms, 0.3 ms       none: drawn in memory");
    line("D, analysis: pixels, triangles", "0.8 ms (with below)", 1);
    line("D, retrieval: nodes", "", 2);
    line("all", "2.3 ms, 2.5 ms", 3);
    let [small, large] = [0, 1].map(|i| parts_on_adapter(&mut Setting::new(SIZES[i])));
    let (Some((small, name)), Some((large, _))) = (small, large) else { return };
    println!("  the same on {name}, parts by its own clock:");
    let names = [
        "A, drawing",
        "D, analysis and retrieval",
        "B, C, read-back of the results",
        "all, by the host's clock",
    ];
    for (n, part) in names.iter().enumerate() {
        println!("  {part:38} {:20} {:>6.0} µs   {:>6.0} µs", "", small[n], large[n]);
    }
}
