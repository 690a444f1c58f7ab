//! The cameras' view of a field, one panel a camera: blobs with their covariance, the marker each was matched
//! to, predictions, residuals, and what was not used and why.

use super::seen::{Panel, Seen, SeenBlob};
use plots::{Area, COLOURS, Drawn, FONT, Figure};
use plotters::prelude::*;
use protocol::matches::{BlobUse, MatchedBlob};

/// Enlargement of residuals.
const ENLARGED: f64 = 20.0;
/// Enlargement of the standard deviations of blobs, some hundredths of a pixel.
const DEVIATIONS_ENLARGED: f64 = 200.0;
/// Width of a panel, px.
const PANEL_PX: u32 = 900;
/// Height of the line of text above all, px.
const HEAD_PX: u32 = 34;
/// Height of the caption of a panel, px.
const CAPTION_PX: u32 = 24;
/// Width of the legend, px.
const LEGEND_PX: u32 = 450;
/// Corners of an ellipse.
const CORNERS: usize = 36;

const PREDICTED: RGBColor = RGBColor(120, 120, 120);

/// The picture.
#[derive(Debug)]
pub struct FieldView<'a> {
    /// What is drawn.
    pub seen: &'a Seen,
    /// Width and height, px; as large as is good to look at if `None`.
    pub size_px: Option<[u32; 2]>,
    /// The only camera that is shown: its place in the rig.
    pub alone: Option<usize>,
}

impl FieldView<'_> {
    fn panels(&self) -> &[Panel] {
        let all = &self.seen.panels;
        self.alone.and_then(|n| all.get(n..=n)).unwrap_or(all)
    }

    /// Columns that panels stand in: in a window those with which they are largest.
    fn columns(&self) -> usize {
        let count = self.panels().len().max(1);
        let Some([width, height]) = self.size_px else { return count.min(2) };
        let shape = self.panels().first().map_or(0.75, |p| f64::from(p.size_px[1] / p.size_px[0]));
        let size = |columns: usize| {
            let rows = count.div_ceil(columns);
            (f64::from(width) / columns as f64).min(f64::from(height) / rows as f64 / shape)
        };
        (1..=count).max_by(|a, b| size(*a).total_cmp(&size(*b))).unwrap_or(1)
    }
}

impl Figure for FieldView<'_> {
    fn size_px(&self) -> (u32, u32) {
        if let Some([width, height]) = self.size_px {
            return (width, height);
        }
        let height = |p: &Panel| (f64::from(PANEL_PX) * f64::from(p.size_px[1] / p.size_px[0])) as u32;
        let columns = self.columns();
        let rows = self.panels().len().div_ceil(columns).max(1) as u32;
        let highest = self.panels().iter().map(height).max();
        (PANEL_PX * columns as u32, HEAD_PX + rows * highest.unwrap_or(100))
    }

    fn draw<B: DrawingBackend>(&self, area: &Area<B>) -> Drawn<B> {
        let scale = format!("; residuals × {ENLARGED}, standard deviations × {DEVIATIONS_ENLARGED}");
        area.draw(&Text::new(self.seen.title.clone() + &scale, (14, 10), (FONT, 17)))?;
        let (_, below) = area.split_vertically(HEAD_PX);
        let columns = self.columns();
        let parts = below.split_evenly((self.panels().len().div_ceil(columns).max(1), columns));
        self.panels().iter().zip(&parts).try_for_each(|(panel, part)| panel.draw(part))?;
        match (parts.get(self.panels().len()), self.panels()) {
            (Some(free), _) => legend(free, (70, 40)),
            (None, [only]) => {
                let beside = only.fitted(&below).0.dim_in_pixel().0 + LEGEND_PX;
                if beside < below.dim_in_pixel().0 {
                    legend(&below, ((beside - LEGEND_PX + 40) as i32, 40))
                } else {
                    Ok(())
                }
            }
            _ => Ok(()),
        }
    }
}

impl Panel {
    /// The part of an area in which the frame keeps its shape, and its pixels for one of the frame.
    fn fitted<B: DrawingBackend>(&self, area: &Area<B>) -> (Area<B>, f64) {
        let [columns, lines] = self.size_px.map(f64::from);
        let [beside, above] = [36 + 16, CAPTION_PX + 24 + 16].map(f64::from);
        let (width, height) = area.dim_in_pixel();
        let scale =
            ((f64::from(width) - beside) / columns).min((f64::from(height) - above) / lines).max(0.01);
        let size = (scale * columns + beside, scale * lines + above);
        let part = area.clone().shrink((0, 0), (size.0 as u32, size.1 as u32));
        (part, scale)
    }

    fn draw<B: DrawingBackend>(&self, area: &Area<B>) -> Drawn<B> {
        let (area, scale) = self.fitted(area);
        let [columns, lines] = self.size_px.map(f64::from);
        let mut chart = ChartBuilder::on(&area)
            .caption(self.caption(), (FONT, 15))
            .margin(8)
            .x_label_area_size(24)
            .y_label_area_size(36)
            .build_cartesian_2d(0.0..columns, lines..0.0)?;
        chart
            .configure_mesh()
            .light_line_style(WHITE)
            .bold_line_style(RGBColor(235, 235, 235))
            .x_label_formatter(&|x| format!("{x:.0}"))
            .y_label_formatter(&|y| format!("{y:.0}"))
            .label_style((FONT, 12))
            .draw()?;
        let radius = |b: &SeenBlob| radius_px(b, scale);
        let line = |b: &SeenBlob, width| colour(b.matched.outcome()).stroke_width(width);
        let predicted = self.blobs.iter().filter_map(|b| b.matched.predicted_px());
        chart.draw_series(predicted.map(|at| cross(at, PREDICTED)))?;
        chart.draw_series(self.missed.iter().map(|m| cross([m.x_px, m.y_px], COLOURS[3])))?;
        let known = self.blobs.iter().filter(|b| b.width_px > 0.0);
        chart.draw_series(known.map(|b| PathElement::new(ellipse(b), line(b, 1))))?;
        chart.draw_series(self.blobs.iter().map(|b| Circle::new(place(b), radius(b), line(b, 2))))?;
        chart.draw_series(self.blobs.iter().filter(|b| b.matched.outcome().is_matched()).map(|b| {
            let (x, y) = place(b);
            let [right, down] = [b.matched.residual_x_px, b.matched.residual_y_px].map(f64::from);
            PathElement::new(vec![(x, y), (x + ENLARGED * right, y + ENLARGED * down)], BLACK.stroke_width(2))
        }))?;
        chart.draw_series(self.blobs.iter().map(|b| {
            label(place(b), f64::from(radius(b)) / scale, text(&b.matched), colour(b.matched.outcome()))
        }))?;
        chart.draw_series(self.missed.iter().map(|m| {
            let at = (f64::from(m.x_px), f64::from(m.y_px));
            label(at, 5.0 / scale, format!("{} unseen", name(m.body as usize, m.marker as usize)), COLOURS[3])
        }))?;
        Ok(())
    }

    fn caption(&self) -> String {
        let used = self.blobs.iter().filter(|b| b.matched.outcome().is_used()).count();
        let (all, missed) = (self.blobs.len(), self.missed.len());
        let lines = ["even", "odd", "all"].get(self.parity as usize).unwrap_or(&"?");
        format!(
            "camera {}, field {} ({lines}): {used} of {all} blobs used, {missed} markers unseen",
            self.camera, self.field
        )
    }
}

fn place(b: &SeenBlob) -> (f64, f64) {
    (f64::from(b.matched.x_px), f64::from(b.matched.y_px))
}

/// Radius of a blob in a picture of that scale, px; of one that was not recorded, a small one.
fn radius_px(b: &SeenBlob, scale: f64) -> i32 {
    if b.width_px > 0.0 { (f64::from(b.width_px) * scale / 2.0).clamp(3.0, 40.0) as i32 } else { 5 }
}

fn name(body: usize, marker: usize) -> String {
    protocol::poses::BODY_NAMES.get(body).map_or(String::new(), |body| format!("{body}.{marker}"))
}

/// The marker of a used blob; else why it was not used, with the nearest marker.
fn text(b: &MatchedBlob) -> String {
    let name = b.marker().map_or(String::new(), |(body, marker)| name(body, marker));
    match b.outcome() {
        BlobUse::Used => name,
        BlobUse::UsedInPart => format!("{name} in part"),
        other => format!("{} {name}", other.text()).trim_end().to_owned(),
    }
}

fn colour(outcome: BlobUse) -> RGBColor {
    match outcome {
        BlobUse::Used => COLOURS[2],
        BlobUse::UsedInPart => COLOURS[5],
        BlobUse::Outlier | BlobUse::BadFit => COLOURS[1],
        BlobUse::Duplicate | BlobUse::Gated | BlobUse::WrongSize => COLOURS[0],
        _ => COLOURS[7],
    }
}

/// What the picture's signs mean.
pub fn legend<B: DrawingBackend>(area: &Area<B>, (left, top): (i32, i32)) -> Drawn<B> {
    let signs: [(&str, RGBColor); 7] = [
        ("used: the marker it was matched to; black line: residual", colour(BlobUse::Used)),
        (
            "used in part: hidden, clipped or merged, by its size, its flags or what is predicted to lie before it",
            colour(BlobUse::UsedInPart),
        ),
        ("outlier or bad fit: matched, and rejected by the fit", colour(BlobUse::Outlier)),
        ("duplicate, gated, wrong size: near a marker, and not its blob", colour(BlobUse::Gated)),
        ("all others: near no marker, or not looked at", colour(BlobUse::Unassigned)),
        ("+ predicted place of a marker", PREDICTED),
        ("+ predicted in the frame, and no blob was matched", COLOURS[3]),
    ];
    for (n, (text, colour)) in signs.into_iter().enumerate() {
        let y = top + 30 * n as i32;
        if let Some(text) = text.strip_prefix("+ ") {
            area.draw(&Cross::new((left, y + 6), 7, colour.stroke_width(2)))?;
            area.draw(&Text::new(text, (left + 26, y), (FONT, 16)))?;
        } else {
            area.draw(&Circle::new((left, y + 6), 8, colour.stroke_width(2)))?;
            area.draw(&Text::new(text, (left + 26, y), (FONT, 16)))?;
        }
    }
    let ellipse = "thin ellipse: one standard deviation of the centre, enlarged";
    area.draw(&Text::new(ellipse, (left + 26, top + 30 * signs.len() as i32), (FONT, 16)))
}

type Point = (f64, f64);

fn cross(at: [f32; 2], colour: RGBColor) -> plotters::element::Cross<Point, i32> {
    Cross::new((f64::from(at[0]), f64::from(at[1])), 6, colour.stroke_width(1))
}

/// A text below a blob of that radius, px of the frame.
fn label(at: Point, radius_px: f64, text: String, colour: RGBColor) -> Text<'static, Point, String> {
    use plotters::style::text_anchor::{HPos, Pos, VPos};
    let mut style = TextStyle::from((FONT, 13)).pos(Pos::new(HPos::Center, VPos::Top));
    style.color = colour.to_backend_color();
    Text::new(text, (at.0, at.1 + radius_px + 5.0), style)
}

/// One standard deviation of the centre of a blob about its place, enlarged.
fn ellipse(b: &SeenBlob) -> Vec<Point> {
    let [xx, yy, xy] = b.covariance_px2.map(f64::from);
    // The Cholesky factor of the covariance takes the circle to the ellipse.
    let a = xx.max(0.0).sqrt();
    let c = if a > 0.0 { xy / a } else { 0.0 };
    let d = (yy - c * c).max(0.0).sqrt();
    let (x, y) = place(b);
    let corner = |n: usize| {
        let (sin, cos) = (n as f64 / CORNERS as f64 * std::f64::consts::TAU).sin_cos();
        (x + DEVIATIONS_ENLARGED * a * cos, y + DEVIATIONS_ENLARGED * (c * cos + d * sin))
    };
    (0..=CORNERS).map(corner).collect()
}

#[cfg(test)]
mod tests {
    use super::*;
    use bytemuck::Zeroable;

    #[test]
    fn an_ellipse_has_the_deviations_of_its_blob() {
        let matched = MatchedBlob { x_px: 100.0, y_px: 50.0, ..Zeroable::zeroed() };
        let outline = ellipse(&SeenBlob { matched, width_px: 6.0, covariance_px2: [0.04, 0.09, -0.03] });
        let reach = |of: fn(&Point) -> f64| outline.iter().map(of).fold(f64::MIN, f64::max);
        assert!((reach(|p| p.0) - 140.0).abs() < 0.5 && (reach(|p| p.1) - 110.0).abs() < 0.5);
        let right = outline.iter().max_by(|a, b| a.0.total_cmp(&b.0)).unwrap();
        assert!(right.1 < 50.0, "the covariance is negative");
    }

    #[test]
    fn frames_keep_their_shape_and_fill_the_window() {
        let seen = super::super::seen::tests::sample("field 1", &[14, 14, 14]);
        let columns =
            |width, height| FieldView { seen: &seen, size_px: Some([width, height]), alone: None }.columns();
        assert_eq!([columns(1500, 460), columns(900, 900), columns(300, 900)], [3, 2, 1]);
        let mut pixels = vec![0; 3 * 900 * 400];
        let area = BitMapBackend::with_buffer(&mut pixels, (900, 400)).into_drawing_area();
        let (part, scale) = seen.panels[0].fitted(&area);
        let (width, height) = part.dim_in_pixel();
        assert!(width <= 900 && height <= 400, "{width} by {height}");
        let [columns, lines] = [width - 52, height - CAPTION_PX - 40].map(f64::from);
        assert!((columns / 768.0 - scale).abs() < 0.01 && (lines / 576.0 - scale).abs() < 0.01);
    }

    #[test]
    fn what_is_not_used_says_why_and_of_which_marker() {
        let blob = |outcome: BlobUse, body| {
            text(&MatchedBlob { outcome: outcome as u32, body, marker: 2, ..Zeroable::zeroed() })
        };
        assert_eq!(blob(BlobUse::Used, 0), "inst0.2");
        assert_eq!(blob(BlobUse::Gated, 2), "gated eye.2");
        assert_eq!(blob(BlobUse::NotTracked, 3), "not tracked");
    }
}
