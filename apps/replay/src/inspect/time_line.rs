//! Residuals, NIS and status of a recording over time.

use plots::{Area, COLOURS, Drawn, FONT, Figure};
use plotters::prelude::*;
use protocol::geometry::Validity;
use protocol::limits::{BODIES, MAX_CAMERAS};
use protocol::matches::{MatchFrame, MatchedBlob};
use protocol::poses::{BODY_NAMES, TrackerFrame};

/// Most columns of the picture; frames are put together where there are more.
const COLUMNS: usize = 600;
/// Width of the picture, heights of its three parts, px.
const WIDTH_PX: u32 = 1200;
const HEIGHTS_PX: [u32; 3] = [320, 320, 160];
/// Least height of the last of them in a window, px.
const STATUSES_LEAST_PX: u32 = 108;
/// Mean NIS of a consistent filter: two degrees of freedom a blob.
const EXPECTED_NIS: f64 = 2.0;
/// Around a diagram, left of it and below it, px.
const MARGIN_PX: u32 = 8;
const LEFT_PX: u32 = 52;
const BELOW_PX: u32 = 26;

/// What a frame contributes.
#[derive(Debug, Clone, Copy)]
struct Point {
    exposed_ns: u64,
    /// Number and sum of squared residuals, px², by camera.
    residuals: [(u32, f64); MAX_CAMERAS],
    /// Number and sum of NIS, by body.
    nis: [(u32, f64); BODIES],
    validity: [Validity; BODIES],
    /// Matched blobs that a fit rejected.
    rejected: u32,
}

/// The picture.
#[derive(Debug, Default)]
pub struct TimeLine {
    points: Vec<Point>,
}

impl TimeLine {
    /// Takes a frame.
    pub fn note(&mut self, frame: &TrackerFrame, matches: &MatchFrame) {
        let mut point = Point {
            exposed_ns: frame.instants.exposed,
            residuals: [(0, 0.0); MAX_CAMERAS],
            nis: [(0, 0.0); BODIES],
            validity: frame.bodies.each_ref().map(protocol::poses::BodyState::validity),
            rejected: 0,
        };
        for field in matches.fields() {
            let rejected = |b: &&MatchedBlob| b.outcome().is_matched() && !b.outcome().is_used();
            point.rejected += field.blobs().iter().filter(rejected).count() as u32;
            let Some(residuals) = point.residuals.get_mut(field.camera as usize) else { continue };
            let used = |b: &&MatchedBlob| b.outcome().is_used();
            for (blob, (body, _)) in field.blobs().iter().filter(used).filter_map(|b| Some((b, b.marker()?)))
            {
                let [x, y] = [blob.residual_x_px, blob.residual_y_px].map(f64::from);
                *residuals = (residuals.0 + 1, residuals.1 + x * x + y * y);
                if blob.nis > 0.0 {
                    let nis = &mut point.nis[body];
                    *nis = (nis.0 + 1, nis.1 + f64::from(blob.nis));
                }
            }
        }
        self.points.push(point);
    }

    /// True where a fit rejected a blob of the last frame, or a body was not measured in it.
    pub fn last_is_conspicuous(&self) -> bool {
        let measured = |v: &Validity| *v == Validity::Measured;
        self.points.last().is_some_and(|p| p.rejected > 0 || !p.validity.iter().all(measured))
    }

    /// The time at a column of a picture of that width, s since the first frame; `None` beside the diagram.
    pub fn time_at(&self, x_px: f64, width_px: u32) -> Option<f64> {
        let [left, right] = diagram(width_px);
        let share = (x_px - left) / (right - left);
        (-0.01..=1.01).contains(&share).then(|| share.clamp(0.0, 1.0) * self.end_s())
    }

    /// The column of a time in a picture of that width.
    pub fn x_of(&self, s: f64, width_px: u32) -> u32 {
        let [left, right] = diagram(width_px);
        (left + (right - left) * (s / self.end_s()).clamp(0.0, 1.0)).round() as u32
    }

    /// Time since the first frame, s.
    fn since_s(&self, point: &Point) -> f64 {
        let start = self.points.first().map_or(0, |p| p.exposed_ns);
        point.exposed_ns.saturating_sub(start) as f64 * 1e-9
    }

    fn end_s(&self) -> f64 {
        self.points.last().map_or(0.0, |p| self.since_s(p)).max(0.02)
    }

    /// Means of what `of` gives, over as many frames as go into a column; breaks where there is nothing.
    fn curve(&self, of: impl Fn(&Point) -> (u32, f64)) -> Vec<Vec<(f64, f64)>> {
        let mut parts = vec![Vec::new()];
        for chunk in self.points.chunks(self.points.len().div_ceil(COLUMNS).max(1)) {
            let (count, sum) = chunk.iter().map(&of).fold((0, 0.0), |(n, s), (m, t)| (n + m, s + t));
            match (count, parts.last_mut()) {
                (1.., Some(part)) => part.push((self.since_s(&chunk[0]), sum / f64::from(count))),
                (_, Some(part)) if !part.is_empty() => parts.push(Vec::new()),
                _ => {}
            }
        }
        parts
    }

    fn residuals<B: DrawingBackend>(&self, area: &Area<B>) -> Drawn<B> {
        let curves: Vec<(String, Curve)> = (0..MAX_CAMERAS)
            .map(|camera| {
                let mut curve = self.curve(|p| p.residuals[camera]);
                curve.iter_mut().flatten().for_each(|(_, squares)| *squares = squares.sqrt());
                (format!("camera {camera}"), curve)
            })
            .filter(|(_, curve)| curve.iter().any(|part| !part.is_empty()))
            .collect();
        self.curves(area, "residuals, RMS px", &curves, None)
    }

    fn nis<B: DrawingBackend>(&self, area: &Area<B>) -> Drawn<B> {
        let of_body = |body: usize| (BODY_NAMES[body].to_owned(), self.curve(|p| p.nis[body]));
        let curves: Vec<(String, Curve)> = (0..BODIES).map(of_body).collect();
        let caption = "NIS, mean of the blobs (2 where predictions hold)";
        self.curves(area, caption, &curves, Some(EXPECTED_NIS))
    }

    /// Curves over time, with a grey line at what is expected. The scale holds 99 % of the points.
    fn curves<B: DrawingBackend>(
        &self,
        area: &Area<B>,
        caption: &str,
        curves: &[(String, Curve)],
        expected: Option<f64>,
    ) -> Drawn<B> {
        let mut all: Vec<f64> = curves.iter().flat_map(|(_, c)| c.iter().flatten().map(|p| p.1)).collect();
        all.sort_by(f64::total_cmp);
        let high = all.get(all.len().saturating_sub(1) * 99 / 100).copied().unwrap_or(0.0);
        let top = 1.25 * high.max(expected.unwrap_or(0.05));
        let mut chart = ChartBuilder::on(area)
            .caption(caption, (FONT, 15))
            .margin(MARGIN_PX)
            .x_label_area_size(BELOW_PX)
            .y_label_area_size(LEFT_PX)
            .build_cartesian_2d(0.0..self.end_s(), 0.0..top)?;
        chart.configure_mesh().light_line_style(WHITE).x_desc("s").label_style((FONT, 12)).draw()?;
        if let Some(at) = expected {
            let line = vec![(0.0, at), (self.end_s(), at)];
            chart.draw_series([PathElement::new(line, COLOURS[7].stroke_width(1))])?;
        }
        for ((name, curve), colour) in curves.iter().zip(COLOURS) {
            // What is above the scale runs along its top.
            let cut = |part: &[(f64, f64)]| part.iter().map(|(t, v)| (*t, v.min(top))).collect::<Vec<_>>();
            chart
                .draw_series(curve.iter().map(|part| PathElement::new(cut(part), colour.stroke_width(2))))?
                .label(name.as_str())
                .legend(move |(x, y)| PathElement::new([(x, y), (x + 16, y)], colour.stroke_width(2)));
        }
        chart
            .configure_series_labels()
            .position(SeriesLabelPosition::UpperRight)
            .background_style(WHITE.mix(0.8))
            .border_style(RGBColor(200, 200, 200))
            .label_font((FONT, 12))
            .draw()
    }

    /// A bar a body: green measured, yellow predicted, red lost.
    fn statuses<B: DrawingBackend>(&self, area: &Area<B>) -> Drawn<B> {
        let mut chart = ChartBuilder::on(area)
            .caption("green: measured, yellow: predicted only, red: lost", (FONT, 15))
            .margin(MARGIN_PX)
            .x_label_area_size(BELOW_PX)
            .y_label_area_size(LEFT_PX)
            .build_cartesian_2d(0.0..self.end_s(), BODIES as f64 - 0.5..-0.5)?;
        let name = |y: &f64| {
            let whole = (y.round() - y).abs() < 1e-6 && *y > -0.4;
            BODY_NAMES
                .get(y.round().max(0.0) as usize)
                .filter(|_| whole)
                .map_or(String::new(), |n| (*n).into())
        };
        chart
            .configure_mesh()
            .disable_mesh()
            .x_desc("s")
            .y_labels(BODIES)
            .y_label_formatter(&name)
            .label_style((FONT, 12))
            .draw()?;
        for body in 0..BODIES {
            let bars = self.runs(body).into_iter().map(|(validity, from, to)| {
                let y = body as f64;
                Rectangle::new([(from, y - 0.35), (to, y + 0.35)], colour(validity).filled())
            });
            chart.draw_series(bars)?;
        }
        Ok(())
    }

    /// Stretches of one validity of a body: from, to, s.
    fn runs(&self, body: usize) -> Vec<(Validity, f64, f64)> {
        let mut runs: Vec<(Validity, f64, f64)> = Vec::new();
        for point in &self.points {
            let (validity, at) = (point.validity[body], self.since_s(point));
            match runs.last_mut() {
                Some((last, _, to)) if *last == validity => *to = at,
                Some((.., to)) => {
                    *to = at;
                    runs.push((validity, at, at));
                }
                None => runs.push((validity, at, at)),
            }
        }
        runs
    }
}

/// A curve with its breaks.
type Curve = Vec<Vec<(f64, f64)>>;

fn colour(validity: Validity) -> RGBColor {
    match validity {
        Validity::Measured => COLOURS[2],
        Validity::Predicted => RGBColor(240, 200, 60),
        Validity::Lost => COLOURS[1],
    }
}

/// First and last column of the diagrams of a picture of that width.
fn diagram(width_px: u32) -> [f64; 2] {
    [MARGIN_PX + LEFT_PX, width_px.saturating_sub(MARGIN_PX + 1)].map(f64::from)
}

/// The picture in a size.
pub struct TimeLinePicture<'a> {
    /// What is drawn.
    pub line: &'a TimeLine,
    /// Width and height, px.
    pub size_px: [u32; 2],
}

impl<'a> From<&'a TimeLine> for TimeLinePicture<'a> {
    fn from(line: &'a TimeLine) -> Self {
        TimeLinePicture { line, size_px: [WIDTH_PX, HEIGHTS_PX.iter().sum()] }
    }
}

impl Figure for TimeLinePicture<'_> {
    fn size_px(&self) -> (u32, u32) {
        self.size_px.into()
    }

    fn draw<B: DrawingBackend>(&self, area: &Area<B>) -> Drawn<B> {
        let all: u32 = HEIGHTS_PX.iter().sum();
        let statuses = (HEIGHTS_PX[2] * self.size_px[1] / all).max(STATUSES_LEAST_PX);
        let curves = self.size_px[1].saturating_sub(statuses) / 2;
        let (above, below) = area.split_vertically(curves);
        self.line.residuals(&above)?;
        let (above, below) = below.split_vertically(curves);
        self.line.nis(&above)?;
        self.line.statuses(&below)
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use bytemuck::Zeroable;

    #[test]
    fn curves_break_where_nothing_was_seen_and_stretches_join() {
        let mut line = TimeLine::default();
        for n in 0..100u64 {
            let mut frame = TrackerFrame::zeroed();
            frame.instants.exposed = 1_000_000_000 + n * 20_000_000;
            let lost = (40..60).contains(&n);
            frame.bodies[1].validity = if lost { Validity::Lost } else { Validity::Measured } as u32;
            let mut matches = MatchFrame { field_count: 1, ..Zeroable::zeroed() };
            if !lost {
                let field = &mut matches.fields_mut()[0];
                field.push(MatchedBlob {
                    body: 1,
                    residual_x_px: 0.3,
                    residual_y_px: 0.4,
                    nis: 2.5,
                    ..Zeroable::zeroed()
                });
            }
            line.note(&frame, &matches);
        }
        let curve = line.curve(|p| p.residuals[0]);
        assert_eq!(curve.iter().map(Vec::len).collect::<Vec<_>>(), [40, 40]);
        assert!((curve[1][0].0 - 1.2).abs() < 1e-9 && (curve[1][0].1 - 0.25).abs() < 1e-6);
        let runs = line.runs(1);
        assert_eq!(runs.len(), 3);
        assert!((runs[1].1 - 0.8).abs() < 1e-9 && (runs[1].2 - 1.2).abs() < 1e-9, "{runs:?}");
        let png = plots::bytes(&TimeLinePicture::from(&line), plots::Format::Png).unwrap();
        let picture = image::load_from_memory(&png).unwrap().to_rgb8();
        let of = |c: RGBColor| picture.pixels().filter(|p| p.0 == [c.0, c.1, c.2]).count();
        for (s, width) in [(0.0, 1200), (1.0, 1200), (1.98, 700)] {
            let back = line.time_at(f64::from(line.x_of(s, width)), width).unwrap();
            assert!((back - s).abs() < 1.98 / 600.0, "{s} s at {width} px: {back}");
        }
        assert!(line.time_at(10.0, 1200).is_none() && line.last_is_conspicuous());
        // The other two are lost all the time.
        assert!(of(COLOURS[1]) > of(COLOURS[2]) && of(COLOURS[2]) > 1000);
    }
}
