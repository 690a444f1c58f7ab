//! Learning curves as a picture.

use crate::curve::{Curve, by_module, longest};
use plots::{Area, COLOURS, Drawn, FONT, Figure, Format, bytes};
use plotters::prelude::*;

/// Size of the panel of a module; the panels of several stand below each other, px.
const SIZE_PX: (u32, u32) = (960, 600);
/// Height of its legend, px; rows and columns of names in it.
const LEGEND_PX: u32 = 100;
const LEGEND: [usize; 2] = [4, 2];
/// Size of letters, px.
const LETTER_PX: i32 = 14;

/// A picture of the curves, a panel for each module: a point an attempt, its deviation as a bar, joined by lines.
///
/// # Errors
/// Where the drawing fails.
pub fn png(curves: &[Curve]) -> anyhow::Result<Vec<u8>> {
    bytes(&Curves(curves), Format::Png)
}

struct Curves<'a>(&'a [Curve]);

impl Figure for Curves<'_> {
    fn size_px(&self) -> (u32, u32) {
        (SIZE_PX.0, SIZE_PX.1 * by_module(self.0).count().max(1) as u32)
    }

    fn draw<B: DrawingBackend>(&self, area: &Area<B>) -> Drawn<B> {
        let panels = area.split_evenly((by_module(self.0).count().max(1), 1));
        for (curves, panel) in by_module(self.0).zip(&panels) {
            let (chart, names) = panel.split_vertically(SIZE_PX.1 - LEGEND_PX);
            draw_curves(&chart, curves)?;
            draw_legend(&names, curves)?;
        }
        Ok(())
    }
}

/// Curves of one module, with a colour each; the colours come again where they run out.
fn coloured(curves: &[Curve]) -> impl Iterator<Item = (&Curve, RGBColor)> {
    // Without the last, a grey, which looks like an axis.
    curves.iter().zip(COLOURS[..COLOURS.len() - 1].iter().copied().cycle())
}

fn draw_curves<B: DrawingBackend>(area: &Area<B>, curves: &[Curve]) -> Drawn<B> {
    let attempts = longest(curves).max(1);
    let mut chart = ChartBuilder::on(area)
        .caption(&curves[0].module, (FONT, 18))
        .margin(14)
        .x_label_area_size(42)
        .y_label_area_size(54)
        .build_cartesian_2d(0.5..attempts as f64 + 0.5, 0.0..100.0)?;
    chart
        .configure_mesh()
        .disable_x_mesh()
        .light_line_style(WHITE)
        .x_desc("Attempt")
        .y_desc("Points")
        .x_labels(attempts.clamp(2, 20))
        .x_label_formatter(&|attempt| {
            if (attempt - attempt.round()).abs() < 1e-6 { format!("{attempt:.0}") } else { String::new() }
        })
        .y_label_formatter(&|points| format!("{points:.0}"))
        .label_style((FONT, LETTER_PX))
        .draw()?;
    for (curve, colour) in coloured(curves) {
        let inside = |points: f64| points.clamp(0.0, 100.0);
        let scores = (1..).map(f64::from).zip(&curve.scores);
        let known = scores.filter(|(_, (points, sigma))| points.is_finite() && sigma.is_finite());
        let known: Vec<_> = known.map(|(at, &(points, sigma))| (at, points, sigma)).collect();
        let points: Vec<_> = known.iter().map(|(at, points, _)| (*at, inside(*points))).collect();
        chart.draw_series([PathElement::new(points.clone(), colour.stroke_width(2))])?;
        chart.draw_series(points.iter().map(|point| Circle::new(*point, 5, colour.filled())))?;
        chart.draw_series(known.iter().map(|(at, points, sigma)| {
            let [low, high] = [points - sigma, points + sigma].map(inside);
            ErrorBar::new_vertical(*at, low, inside(*points), high, colour.stroke_width(2), 8)
        }))?;
    }
    Ok(())
}

/// Names of the curves; where there are more than fit, the last line says how many are not named.
fn draw_legend<B: DrawingBackend>(area: &Area<B>, curves: &[Curve]) -> Drawn<B> {
    let [rows, columns] = LEGEND;
    let (places, width) = (rows * columns, (SIZE_PX.0 as i32 - 40) / columns as i32);
    let named = if curves.len() > places { places - 1 } else { curves.len() };
    let place = |i: usize| (20 + (i / rows) as i32 * width, 6 + (i % rows) as i32 * 20);
    let style = (FONT, LETTER_PX).into_text_style(area);
    for (i, (curve, colour)) in coloured(curves).take(named).enumerate() {
        let (x, y) = place(i);
        area.draw(&Rectangle::new([(x, y + 1), (x + 12, y + 13)], colour.filled()))?;
        let mut label = curve.label.clone();
        while area.estimate_text_size(&label, &style)?.0 as i32 > width - 40 && label.pop().is_some() {}
        area.draw(&Text::new(label, (x + 20, y), style.clone()))?;
    }
    if named < curves.len() {
        let (x, y) = place(named);
        let more = format!("and {} more", curves.len() - named);
        area.draw(&Text::new(more, (x + 20, y), style))?;
    }
    Ok(())
}

#[cfg(test)]
mod tests {
    use super::*;
    use image::RgbImage;

    fn curve(label: &str, scores: &[f64]) -> Curve {
        Curve {
            module: "shadow".into(),
            label: label.into(),
            scores: scores.iter().map(|s| (*s, 3.0)).collect(),
        }
    }

    fn plot(curves: &[Curve]) -> RgbImage {
        image::load_from_memory(&png(curves).unwrap()).unwrap().to_rgb8()
    }

    /// Pixels of a curve's colour: how many, and their mean row.
    fn of_colour(picture: &RgbImage, curve: usize) -> (u32, f64) {
        let RGBColor(r, g, b) = COLOURS[curve];
        let rows = picture.enumerate_pixels().filter(|(_, _, p)| p.0 == [r, g, b]).map(|(_, y, _)| y);
        // The legend's block stands lower than the axis.
        let rows: Vec<u32> = rows.filter(|y| y % SIZE_PX.1 < SIZE_PX.1 - LEGEND_PX).collect();
        (rows.len() as u32, rows.iter().map(|y| f64::from(*y)).sum::<f64>() / rows.len().max(1) as f64)
    }

    #[test]
    fn higher_scores_stand_higher_and_a_curve_has_one_colour() {
        let at = |score: f64| of_colour(&plot(&[curve("a", &[score; 3])]), 0);
        let [(pixels, low), (_, middle), (_, high)] = [10.0, 50.0, 90.0].map(at);
        assert!(pixels > 100, "{pixels} pixels of the curve");
        assert!(
            ((low - middle) - (middle - high)).abs() < 2.0 && low - high > 300.0,
            "{low} {middle} {high}"
        );
        assert_eq!(of_colour(&plot(&[curve("a", &[60.0])]), 1).0, 0, "one curve, one colour");
    }

    #[test]
    fn each_module_has_a_panel_of_its_own() {
        let other = Curve { module: "forceps".into(), ..curve("a", &[20.0]) };
        let two = [curve("a", &[0.0, 60.0]), curve("b", &[90.0])];
        let picture = plot(&[std::slice::from_ref(&other), &two[..]].concat());
        assert_eq!(picture.dimensions(), (SIZE_PX.0, 2 * SIZE_PX.1));
        let half = |top| image::imageops::crop_imm(&picture, 0, top, SIZE_PX.0, SIZE_PX.1).to_image();
        assert!(half(0) == plot(&[other]) && half(SIZE_PX.1) == plot(&two));
        let inked = |picture: &RgbImage| of_colour(picture, 1).0;
        assert!(inked(&half(0)) == 0 && inked(&half(SIZE_PX.1)) > 80, "a colour for each trainee");
    }

    #[test]
    fn odd_numbers_and_crowds_are_drawn_too() {
        let crowd: Vec<Curve> =
            (0..40).map(|i| curve(&"wide name ".repeat(12), &[f64::from(i); 300])).collect();
        plot(&crowd);
        plot(&[]);
        plot(&[curve("a", &[f64::NAN, f64::INFINITY, -1e300])]);
    }
}
