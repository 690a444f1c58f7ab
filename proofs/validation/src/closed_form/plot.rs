//! Draws a case: the solution on the left, errors over resolutions on the right.

use super::case::{Chart, Curve, Outcome};
use plots::{Area, COLOURS, Drawn, FONT, Figure};
use plotters::coord::ranged1d::{AsRangedCoord, Ranged, ValueFormatter};
use plotters::prelude::*;
use std::ops::Range;

/// Size of a picture, px.
const SIZE_PX: (u32, u32) = (1120, 440);
/// Size of letters, px.
const LETTER_PX: i32 = 13;

/// The picture of a case.
pub struct CasePlot<'a> {
    /// Above it.
    pub title: &'a str,
    /// What is drawn.
    pub outcome: &'a Outcome,
}

impl Figure for CasePlot<'_> {
    fn size_px(&self) -> (u32, u32) {
        SIZE_PX
    }

    fn draw<B: DrawingBackend>(&self, area: &Area<B>) -> Drawn<B> {
        let below = area.titled(self.title, (FONT, 17))?;
        let (left, right) = below.split_horizontally(SIZE_PX.0 / 2);
        draw_chart(&left, &self.outcome.solution)?;
        draw_chart(&right, &self.outcome.refinement)
    }
}

fn draw_chart<B: DrawingBackend>(area: &Area<B>, chart: &Chart) -> Drawn<B> {
    let Some([across, up]) = ranges(chart) else { return Ok(()) };
    if chart.logarithmic {
        let [across, up] = [across, up].map(|range| range.log_scale());
        draw_curves(area, chart, across, up, &|value| format!("{value}"))
    } else {
        draw_curves(area, chart, across, up, &|value| short(*value))
    }
}

fn draw_curves<B, X, Y>(
    area: &Area<B>,
    chart: &Chart,
    across: X,
    up: Y,
    number: &dyn Fn(&f64) -> String,
) -> Drawn<B>
where
    B: DrawingBackend,
    X: AsRangedCoord<Value = f64>,
    Y: AsRangedCoord<Value = f64>,
    X::CoordDescType: ValueFormatter<f64> + Ranged<ValueType = f64>,
    Y::CoordDescType: ValueFormatter<f64> + Ranged<ValueType = f64>,
{
    let mut drawn = ChartBuilder::on(area)
        .margin(12)
        .x_label_area_size(44)
        .y_label_area_size(74)
        .build_cartesian_2d(across, up)?;
    let mut mesh = drawn.configure_mesh();
    mesh.light_line_style(WHITE).x_desc(&chart.across).y_desc(&chart.up).x_labels(7).y_labels(7);
    mesh.x_label_formatter(&number).y_label_formatter(&number).label_style((FONT, LETTER_PX)).draw()?;
    for (curve, colour) in chart.curves.iter().zip(COLOURS.into_iter().cycle()) {
        let points: Vec<(f64, f64)> = usable(chart, curve).map(|[x, y]| (x, y)).collect();
        let (marks, line) = (curve.marks || chart.logarithmic, !curve.marks);
        let in_legend = move |(x, y)| {
            let middle = (x + 9, y);
            let stroke = colour.stroke_width(if line { 2 } else { 0 });
            let path = PathElement::new(vec![(x, y), (x + 18, y)], stroke);
            EmptyElement::at((0, 0)) + path + Circle::new(middle, if marks { 4 } else { 0 }, colour.filled())
        };
        if line {
            let path = PathElement::new(points.clone(), colour.stroke_width(2));
            drawn.draw_series([path])?.label(&curve.name).legend(in_legend);
        }
        if marks {
            let series = drawn.draw_series(points.iter().map(|p| Circle::new(*p, 4, colour.filled())))?;
            if !line {
                series.label(&curve.name).legend(in_legend);
            }
        }
    }
    let mut legend = drawn.configure_series_labels();
    legend
        .position(emptiest_corner(chart))
        .background_style(WHITE.mix(0.8))
        .label_font((FONT, LETTER_PX))
        .draw()
}

/// Points that can be drawn on the axes of a chart.
fn usable<'a>(chart: &'a Chart, curve: &'a Curve) -> impl Iterator<Item = [f64; 2]> + 'a {
    let fits = |p: &[f64; 2]| p.iter().all(|c| c.is_finite() && (!chart.logarithmic || *c > 0.0));
    curve.points.iter().copied().filter(fits)
}

fn all_usable(chart: &Chart) -> impl Iterator<Item = [f64; 2]> + '_ {
    chart.curves.iter().flat_map(|curve| usable(chart, curve))
}

/// What the axes span: all points, and some room; nothing where there is no point.
fn ranges(chart: &Chart) -> Option<[Range<f64>; 2]> {
    all_usable(chart).next()?;
    Some([0, 1].map(|axis| {
        let values = all_usable(chart).map(|p| p[axis]);
        let [low, high] = values.fold([f64::MAX, f64::MIN], |[l, h], v| [l.min(v), h.max(v)]);
        if chart.logarithmic {
            // At least a decade, so that there is a number on the axis.
            let spare = libm::sqrt((12.0 * low / high).max(1.3));
            return low / spare..high * spare;
        }
        let span = (high - low).max(1e-9);
        low - 0.05 * span..high + 0.08 * span
    }))
}

/// The corner in whose quarter the fewest points lie.
fn emptiest_corner(chart: &Chart) -> SeriesLabelPosition {
    use SeriesLabelPosition::{LowerLeft, LowerRight, UpperLeft, UpperRight};
    let scaled = |v: f64| if chart.logarithmic { libm::log10(v) } else { v };
    let Some(ranges) = ranges(chart) else { return LowerRight };
    let middle = ranges.map(|r| 0.5 * (scaled(r.start) + scaled(r.end)));
    let points = |right: bool, above: bool| {
        let inside =
            |p: &[f64; 2]| (scaled(p[0]) > middle[0]) == right && (scaled(p[1]) > middle[1]) == above;
        all_usable(chart).filter(inside).count()
    };
    let corners = [
        (LowerRight, true, false),
        (UpperLeft, false, true),
        (UpperRight, true, true),
        (LowerLeft, false, false),
    ];
    let emptiest = corners.into_iter().min_by_key(|(_, right, above)| points(*right, *above));
    emptiest.map_or(LowerRight, |(corner, ..)| corner)
}

/// A number without the zeros at its end.
fn short(value: f64) -> String {
    let text = format!("{value:.6}");
    let text = text.trim_end_matches('0').trim_end_matches('.');
    if text == "-0" { "0".into() } else { text.into() }
}
