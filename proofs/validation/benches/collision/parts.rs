//! The parts of a look of ZCOLL on the processor, as in the paper's Table 1.

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
}
