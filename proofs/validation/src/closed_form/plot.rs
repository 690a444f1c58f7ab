//! Draws a case: the solution on the left, errors over resolutions on the right. Drawn at twice the
//! size and halved, so that lines are smooth.

use super::case::{Chart, Curve, Outcome};
use font::{Face, line_px};
use image::RgbImage;
use image::imageops::{FilterType, resize};

/// Size of a picture, px.
const SIZE: [u32; 2] = [1120, 440];
/// Factor by which it is drawn larger.
const SCALE: usize = 2;
/// Size of letters while drawing, px.
const LETTER: f32 = 26.0;
const INK: [u8; 3] = [40, 40, 40];
const GREY: [u8; 3] = [225, 225, 225];
/// Told apart by people who do not see all colours (Okabe and Ito).
const COLOURS: [[u8; 3]; 7] = [
    [0, 114, 178],
    [213, 94, 0],
    [0, 158, 115],
    [204, 121, 167],
    [230, 159, 0],
    [86, 180, 233],
    [90, 90, 90],
];

/// A picture that grows under the pen.
struct Canvas {
    image: RgbImage,
    face: Face,
}

/// Where a chart lies: left, top, right and bottom, px while drawing.
type Frame = [f64; 4];

/// The picture of a case.
pub fn draw(title: &str, outcome: &Outcome) -> RgbImage {
    let [w, h] = SIZE.map(|s| s * SCALE as u32);
    let mut canvas = Canvas { image: RgbImage::from_pixel(w, h, image::Rgb([255; 3])), face: Face::new() };
    canvas.text(title, [w as f64 * 0.5, 16.0], 0.5, INK);
    let (top, bottom) = (96.0, f64::from(h) - 100.0);
    let half = f64::from(w) * 0.5;
    canvas.chart(&outcome.solution, [150.0, top, half - 40.0, bottom]);
    canvas.chart(&outcome.refinement, [half + 150.0, top, f64::from(w) - 40.0, bottom]);
    resize(&canvas.image, SIZE[0], SIZE[1], FilterType::Triangle)
}

impl Canvas {
    fn dot(&mut self, x: i64, y: i64, colour: [u8; 3]) {
        if let (Ok(x), Ok(y)) = (u32::try_from(x), u32::try_from(y))
            && x < self.image.width()
            && y < self.image.height()
        {
            self.image.put_pixel(x, y, image::Rgb(colour));
        }
    }

    fn disc(&mut self, [x, y]: [f64; 2], radius: f64, colour: [u8; 3]) {
        let reach = radius.ceil() as i64;
        for (i, j) in (-reach..=reach).flat_map(|i| (-reach..=reach).map(move |j| (i, j))) {
            if ((i * i + j * j) as f64) <= radius * radius {
                self.dot(x as i64 + i, y as i64 + j, colour);
            }
        }
    }

    fn line(&mut self, [x0, y0]: [f64; 2], [x1, y1]: [f64; 2], width: f64, colour: [u8; 3]) {
        let steps = (x1 - x0).abs().max((y1 - y0).abs()).ceil().max(1.0);
        for i in 0..=steps as usize {
            let s = i as f64 / steps;
            self.disc([x0 + s * (x1 - x0), y0 + s * (y1 - y0)], 0.5 * width, colour);
        }
    }

    /// Text whose share `anchor` of its width lies left of `at`; `at` is its top.
    fn text(&mut self, text: &str, at: [f64; 2], anchor: f64, colour: [u8; 3]) {
        let left = at[0] as f32 - anchor as f32 * self.face.width_px(text, LETTER);
        let width = self.image.width();
        self.face.write(&mut self.image, width, [left, at[1] as f32], text, LETTER, colour);
    }

    fn chart(&mut self, chart: &Chart, frame: Frame) {
        let Some(scale) = Scale::around(chart, frame) else { return };
        let [left, top, right, bottom] = frame;
        for tick in scale.ticks(0) {
            let [x, _] = scale.place([tick, scale.low[1]], true);
            self.line([x, top], [x, bottom], 1.0, GREY);
            self.text(&scale.name(tick), [x, bottom + 12.0], 0.5, INK);
        }
        for tick in scale.ticks(1) {
            let [_, y] = scale.place([scale.low[0], tick], true);
            self.line([left, y], [right, y], 1.0, GREY);
            self.text(&scale.name(tick), [left - 10.0, y - 0.5 * f64::from(line_px(LETTER))], 1.0, INK);
        }
        for (a, b) in [([left, top], [left, bottom]), ([left, bottom], [right, bottom])] {
            self.line(a, b, 2.0, INK);
        }
        self.text(&chart.across, [0.5 * (left + right), bottom + 52.0], 0.5, INK);
        self.text(&chart.up, [left - 60.0, top - 34.0], 0.0, INK);
        for (i, curve) in chart.curves.iter().enumerate() {
            self.curve(curve, &scale, COLOURS[i % COLOURS.len()], chart.logarithmic);
        }
        self.legend(chart, frame);
    }

    fn curve(&mut self, curve: &Curve, scale: &Scale, colour: [u8; 3], both: bool) {
        let usable = curve.points.iter().filter(|p| !scale.logarithmic || (p[0] > 0.0 && p[1] > 0.0));
        let places: Vec<[f64; 2]> = usable.map(|&p| scale.place(p, false)).collect();
        if curve.marks || both {
            places.iter().for_each(|&p| self.disc(p, 7.0, colour));
        }
        if !curve.marks {
            places.windows(2).for_each(|w| self.line(w[0], w[1], 4.0, colour));
        }
    }

    /// In the corner that holds the fewest points.
    fn legend(&mut self, chart: &Chart, [left, top, right, bottom]: Frame) {
        let names = chart.curves.iter().map(|c| self.face.width_px(&c.name, LETTER));
        let longest = f64::from(names.fold(0.0, f32::max));
        let (line, wide) = (f64::from(line_px(LETTER)), longest + 56.0);
        let high = line * chart.curves.len() as f64;
        let Some(scale) = Scale::around(chart, [left, top, right, bottom]) else { return };
        let inside = |corner: &[f64; 2]| {
            let near = |p: &&[f64; 2]| {
                let [x, y] = scale.place(**p, false);
                (corner[0]..corner[0] + wide).contains(&x) && (corner[1]..corner[1] + high).contains(&y)
            };
            chart.curves.iter().flat_map(|c| &c.points).filter(near).count()
        };
        let (far, low) = (right - wide - 10.0, bottom - high - 14.0);
        let corners = [[far, low], [left + 16.0, top + 8.0], [far, top + 8.0], [left + 16.0, low]];
        let corner = corners.iter().min_by_key(|c| inside(c)).copied().unwrap_or([far, low]);
        for y in 0..high as i64 {
            (-8..wide as i64).for_each(|x| self.dot(corner[0] as i64 + x, corner[1] as i64 + y, [255; 3]));
        }
        for (i, curve) in chart.curves.iter().enumerate() {
            let y = corner[1] + line * i as f64;
            let colour = COLOURS[i % COLOURS.len()];
            let middle = y + 0.5 * f64::from(line_px(LETTER));
            if !curve.marks {
                self.line([corner[0], middle], [corner[0] + 36.0, middle], 4.0, colour);
            }
            if curve.marks || chart.logarithmic {
                self.disc([corner[0] + 18.0, middle], 7.0, colour);
            }
            self.text(&curve.name, [corner[0] + 48.0, y], 0.0, INK);
        }
    }
}

/// From the chart's numbers to the picture.
struct Scale {
    low: [f64; 2],
    high: [f64; 2],
    logarithmic: bool,
    frame: Frame,
}

impl Scale {
    fn around(chart: &Chart, frame: Frame) -> Option<Self> {
        let logarithmic = chart.logarithmic;
        let usable =
            |p: &&[f64; 2]| p.iter().all(|c| c.is_finite()) && (!logarithmic || (p[0] > 0.0 && p[1] > 0.0));
        let points = || chart.curves.iter().flat_map(|c| &c.points).filter(usable);
        let (mut low, mut high) = ([f64::INFINITY; 2], [f64::NEG_INFINITY; 2]);
        for point in points() {
            for axis in 0..2 {
                let c = if logarithmic { libm::log10(point[axis]) } else { point[axis] };
                (low[axis], high[axis]) = (low[axis].min(c), high[axis].max(c));
            }
        }
        if !low.iter().all(|l| l.is_finite()) {
            return None;
        }
        for axis in 0..2 {
            let span = (high[axis] - low[axis]).max(1e-9);
            (low[axis], high[axis]) = (low[axis] - 0.05 * span, high[axis] + 0.08 * span);
            if logarithmic {
                // At least a decade, so that there is a number on the axis.
                let spare = (1.1 - (high[axis] - low[axis])).max(0.0) * 0.5;
                (low[axis], high[axis]) = (low[axis] - spare, high[axis] + spare);
            }
        }
        Some(Scale { low, high, logarithmic, frame })
    }

    /// Of a point; `scaled` where it is already a logarithm on logarithmic axes.
    fn place(&self, p: [f64; 2], scaled: bool) -> [f64; 2] {
        let c = if self.logarithmic && !scaled { p.map(libm::log10) } else { p };
        let share = [0, 1].map(|a: usize| (c[a] - self.low[a]) / (self.high[a] - self.low[a]));
        let [left, top, right, bottom] = self.frame;
        [left + share[0] * (right - left), bottom - share[1] * (bottom - top)]
    }

    fn ticks(&self, axis: usize) -> Vec<f64> {
        let (low, high) = (self.low[axis], self.high[axis]);
        let step = if self.logarithmic {
            ((high - low) / 6.0).ceil().max(1.0)
        } else {
            let rough = (high - low) / 6.0;
            let ten = libm::pow(10.0, rough.log10().floor());
            [1.0, 2.0, 5.0, 10.0].map(|m| m * ten).into_iter().find(|s| *s >= rough).unwrap_or(rough)
        };
        let first = (low / step).ceil() as i64;
        (first..).map(|i| i as f64 * step).take_while(|t| *t <= high).collect()
    }

    fn name(&self, tick: f64) -> String {
        if self.logarithmic {
            return match tick as i32 {
                -2 => "0.01".into(),
                -1 => "0.1".into(),
                0 => "1".into(),
                1 => "10".into(),
                n => format!("10^{n}"),
            };
        }
        let text = format!("{tick:.6}");
        let text = text.trim_end_matches('0').trim_end_matches('.');
        if text == "-0" { "0".into() } else { text.into() }
    }
}
