//! The cameras' view of a field, one panel a camera: blobs with their covariance, the marker each was matched
//! to, predictions, residuals, and what was not used and why.

use crate::matched::Matched;
use plots::{Area, COLOURS, Drawn, FONT, Figure};
use plotters::prelude::*;
use protocol::blobs::{Blob, BlobField};
use protocol::matches::{BlobUse, MatchedBlob, MatchedField};
use rig::Rig;

/// Enlargement of residuals.
const ENLARGED: f64 = 20.0;
/// Enlargement of the standard deviations of blobs, some hundredths of a pixel.
const DEVIATIONS_ENLARGED: f64 = 200.0;
/// Width of a panel, px.
const PANEL_PX: u32 = 900;
/// Height of the line of text above all, px.
const HEAD_PX: u32 = 34;
/// Corners of an ellipse.
const CORNERS: usize = 36;

const PREDICTED: RGBColor = RGBColor(120, 120, 120);

/// One camera of the field.
struct Panel {
    camera: u32,
    field: u64,
    size_px: [f64; 2],
    matches: MatchedField,
    /// As recorded; `None` where it is missing.
    blobs: Option<BlobField>,
}

/// The picture.
pub struct FieldView {
    title: String,
    panels: Vec<Panel>,
}

impl FieldView {
    /// Of a tracker frame; the newest field of each camera.
    pub fn new(rig: &Rig, found: &Matched<'_>) -> Self {
        let mut panels = Vec::new();
        for camera in rig.cameras() {
            let its = |f: &&MatchedField| f.camera == camera.id;
            let Some(matches) = found.matches.fields().iter().rev().find(its) else { continue };
            let blobs = found.fields.iter().find(|f| (f.camera, f.field) == (camera.id, matches.field));
            panels.push(Panel {
                camera: camera.id,
                field: matches.field,
                size_px: camera.size_px.map(f64::from),
                matches: *matches,
                blobs: blobs.copied(),
            });
        }
        let statuses = protocol::poses::BODY_NAMES.iter().zip(&found.frame.bodies).map(|(name, body)| {
            let status = protocol::poses::BodyStatus::from_wire(body.status);
            format!("{name} {} {:.2} px", status.map_or("unknown", |s| s.text()), body.residual_px)
        });
        let statuses = statuses.collect::<Vec<_>>().join(", ");
        let title = format!(
            "field {} (frame {}): {statuses}; residuals × {ENLARGED}, \
             standard deviations × {DEVIATIONS_ENLARGED}",
            found.frame.field, found.frame.frame
        );
        FieldView { title, panels }
    }
}

impl Figure for FieldView {
    fn size_px(&self) -> (u32, u32) {
        let heights = self.panels.iter().map(Panel::height_px);
        let columns = self.panels.len().clamp(1, 2) as u32;
        let rows = self.panels.len().div_ceil(2).max(1) as u32;
        (PANEL_PX * columns, HEAD_PX + rows * heights.max().unwrap_or(100))
    }

    fn draw<B: DrawingBackend>(&self, area: &Area<B>) -> Drawn<B> {
        area.draw(&Text::new(self.title.clone(), (14, 10), (FONT, 17)))?;
        let (_, below) = area.split_vertically(HEAD_PX);
        let columns = self.panels.len().clamp(1, 2);
        let parts = below.split_evenly((self.panels.len().div_ceil(2).max(1), columns));
        self.panels.iter().zip(&parts).try_for_each(|(panel, part)| panel.draw(part))?;
        match parts.get(self.panels.len()) {
            Some(free) => legend(free),
            None => Ok(()),
        }
    }
}

impl Panel {
    fn height_px(&self) -> u32 {
        (f64::from(PANEL_PX) * self.size_px[1] / self.size_px[0]) as u32
    }

    fn draw<B: DrawingBackend>(&self, area: &Area<B>) -> Drawn<B> {
        let used = self.matches.blobs().iter().filter(|b| b.outcome().is_used()).count();
        let (all, missed) = (self.matches.blobs().len(), self.matches.missed().len());
        let lines = if self.matches.parity == 0 { "even" } else { "odd" };
        let caption = format!(
            "camera {}, field {} ({lines} lines): {used} of {all} blobs used, {missed} markers without",
            self.camera, self.field
        );
        let mut chart = ChartBuilder::on(area)
            .caption(caption, (FONT, 15))
            .margin(8)
            .x_label_area_size(24)
            .y_label_area_size(36)
            .build_cartesian_2d(0.0..self.size_px[0], self.size_px[1]..0.0)?;
        chart
            .configure_mesh()
            .light_line_style(WHITE)
            .bold_line_style(RGBColor(235, 235, 235))
            .x_label_formatter(&|x| format!("{x:.0}"))
            .y_label_formatter(&|y| format!("{y:.0}"))
            .label_style((FONT, 12))
            .draw()?;
        let blobs = self.matches.blobs();
        chart.draw_series(blobs.iter().filter_map(|b| Some(cross(b.predicted_px()?, PREDICTED))))?;
        let missed = self.matches.missed();
        chart.draw_series(missed.iter().map(|m| cross([m.x_px, m.y_px], COLOURS[3])))?;
        let seen =
            |b: &MatchedBlob| self.blobs.as_ref().and_then(|f| f.blobs().get(b.blob as usize).copied());
        chart.draw_series(blobs.iter().filter_map(|b| {
            let outline = ellipse(b, &seen(b)?);
            Some(PathElement::new(outline, colour(b.outcome()).stroke_width(1)))
        }))?;
        chart.draw_series(
            blobs
                .iter()
                .map(|b| Circle::new(place(b), radius_px(seen(b)), colour(b.outcome()).stroke_width(2))),
        )?;
        chart.draw_series(blobs.iter().filter(|b| b.outcome().is_matched()).map(|b| {
            let (x, y) = place(b);
            let end = (x + ENLARGED * f64::from(b.residual_x_px), y + ENLARGED * f64::from(b.residual_y_px));
            PathElement::new(vec![(x, y), end], BLACK.stroke_width(2))
        }))?;
        chart.draw_series(
            blobs.iter().map(|b| label(place(b), radius_px(seen(b)), text(b), colour(b.outcome()))),
        )?;
        chart.draw_series(missed.iter().map(|m| {
            let at = (f64::from(m.x_px), f64::from(m.y_px));
            label(at, 5, format!("{} unseen", name(m.body as usize, m.marker as usize)), COLOURS[3])
        }))?;
        Ok(())
    }
}

fn place(b: &MatchedBlob) -> (f64, f64) {
    (f64::from(b.x_px), f64::from(b.y_px))
}

/// Radius of a blob in the picture, px; of one that was not recorded, a small one.
fn radius_px(seen: Option<Blob>) -> i32 {
    seen.map_or(5, |blob| (blob.width_px * f64::from(PANEL_PX) / 768.0 / 2.0).clamp(3.0, 40.0) as i32)
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
fn legend<B: DrawingBackend>(area: &Area<B>) -> Drawn<B> {
    let signs: [(&str, RGBColor); 7] = [
        ("used: the marker it was matched to; black line: residual", colour(BlobUse::Used)),
        ("used in part: hidden, clipped or merged, by its size or flags", colour(BlobUse::UsedInPart)),
        ("outlier or bad fit: matched, and rejected by the fit", colour(BlobUse::Outlier)),
        ("duplicate, gated, wrong size: near a marker, and not its blob", colour(BlobUse::Gated)),
        ("all others: near no marker, or not looked at", colour(BlobUse::Unassigned)),
        ("+ predicted place of a marker", PREDICTED),
        ("+ predicted in the frame, and no blob was matched", COLOURS[3]),
    ];
    for (n, (text, colour)) in signs.into_iter().enumerate() {
        let y = 40 + 30 * n as i32;
        if let Some(text) = text.strip_prefix("+ ") {
            area.draw(&Cross::new((70, y + 6), 7, colour.stroke_width(2)))?;
            area.draw(&Text::new(text, (96, y), (FONT, 16)))?;
        } else {
            area.draw(&Circle::new((70, y + 6), 8, colour.stroke_width(2)))?;
            area.draw(&Text::new(text, (96, y), (FONT, 16)))?;
        }
    }
    let ellipse = "thin ellipse: one standard deviation of the centre, enlarged";
    area.draw(&Text::new(ellipse, (96, 40 + 30 * signs.len() as i32), (FONT, 16)))
}

type Point = (f64, f64);

fn cross(at: [f32; 2], colour: RGBColor) -> plotters::element::Cross<Point, i32> {
    Cross::new((f64::from(at[0]), f64::from(at[1])), 6, colour.stroke_width(1))
}

/// A text below a blob of that radius, px of the picture.
fn label(at: Point, radius_px: i32, text: String, colour: RGBColor) -> Text<'static, Point, String> {
    use plotters::style::text_anchor::{HPos, Pos, VPos};
    let mut style = TextStyle::from((FONT, 13)).pos(Pos::new(HPos::Center, VPos::Top));
    style.color = colour.to_backend_color();
    Text::new(text, (at.0, at.1 + f64::from(radius_px) * 0.9 + 5.0), style)
}

/// One standard deviation of the centre of a blob about its place, enlarged.
fn ellipse(b: &MatchedBlob, blob: &Blob) -> Vec<Point> {
    let (xx, yy, xy) = (blob.var_x_px2, blob.var_y_px2, blob.cov_xy_px2);
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
        let blob = Blob { var_x_px2: 0.04, var_y_px2: 0.09, cov_xy_px2: -0.03, ..Zeroable::zeroed() };
        let at = MatchedBlob { x_px: 100.0, y_px: 50.0, ..Zeroable::zeroed() };
        let outline = ellipse(&at, &blob);
        let reach = |of: fn(&Point) -> f64| outline.iter().map(of).fold(f64::MIN, f64::max);
        assert!((reach(|p| p.0) - 140.0).abs() < 0.5 && (reach(|p| p.1) - 110.0).abs() < 0.5);
        let right = outline.iter().max_by(|a, b| a.0.total_cmp(&b.0)).unwrap();
        assert!(right.1 < 50.0, "the covariance is negative");
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
