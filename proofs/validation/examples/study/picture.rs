//! Points of every attempt as a picture: a panel a module, a column a surgeon.

use crate::numbers::mean;
use crate::{CARELESS_BELOW, EXPERT_FROM, Outcome};
use plots::{Area, COLOURS, Drawn, FONT, Figure};
use plotters::prelude::*;
use surgeon::skill::Skill;

/// Size of a panel and of the legend below all, px; panels in a row.
const PANEL_PX: (u32, u32) = (260, 250);
const LEGEND_PX: u32 = 34;
const IN_A_ROW: usize = 4;
/// Size of letters, px.
const LETTER_PX: i32 = 14;
/// Of the bounds between good and bad.
const BOUND: RGBColor = RGBColor(150, 150, 150);

/// The picture of a study.
pub struct StudyPlot<'a> {
    /// A panel each.
    pub outcomes: &'a [Outcome],
    /// A colour each.
    pub surgeons: &'a [Skill],
}

impl StudyPlot<'_> {
    fn rows(&self) -> usize {
        self.outcomes.len().div_ceil(IN_A_ROW).max(1)
    }
}

impl Figure for StudyPlot<'_> {
    fn size_px(&self) -> (u32, u32) {
        (PANEL_PX.0 * IN_A_ROW as u32, PANEL_PX.1 * self.rows() as u32 + LEGEND_PX)
    }

    fn draw<B: DrawingBackend>(&self, area: &Area<B>) -> Drawn<B> {
        let (panels, legend) = area.split_vertically(PANEL_PX.1 * self.rows() as u32);
        for (outcome, panel) in self.outcomes.iter().zip(panels.split_evenly((self.rows(), IN_A_ROW))) {
            draw_panel(&panel, outcome)?;
        }
        for (i, (surgeon, colour)) in self.surgeons.iter().zip(COLOURS.into_iter().cycle()).enumerate() {
            let (x, y) = (44 + 200 * i as i32, 8);
            legend.draw(&Rectangle::new([(x, y + 1), (x + 12, y + 13)], colour.filled()))?;
            legend.draw(&Text::new(surgeon.name, (x + 20, y), (FONT, LETTER_PX)))?;
        }
        Ok(())
    }
}

fn draw_panel<B: DrawingBackend>(area: &Area<B>, outcome: &Outcome) -> Drawn<B> {
    let surgeons = outcome.scores.len();
    let mut chart = ChartBuilder::on(area)
        .caption(&outcome.module, (FONT, LETTER_PX))
        .margin(6)
        .y_label_area_size(34)
        .build_cartesian_2d(0.0..surgeons.max(1) as f64, 0.0..100.0)?;
    let mut mesh = chart.configure_mesh();
    mesh.disable_x_mesh().disable_x_axis().light_line_style(WHITE).y_labels(6);
    mesh.y_label_formatter(&|points| format!("{points:.0}")).label_style((FONT, LETTER_PX)).draw()?;
    let across = |points: f64| PathElement::new(vec![(0.0, points), (surgeons as f64, points)], BOUND);
    chart.draw_series([EXPERT_FROM, CARELESS_BELOW].map(across))?;
    for (s, colour) in (0..surgeons).zip(COLOURS.into_iter().cycle()) {
        let (begin, totals) = (s as f64, outcome.totals(s));
        // Beside each other by seed, so that equal ones stay visible.
        let step = 0.7 / (totals.len().max(2) - 1) as f64;
        let points = totals.iter().enumerate().map(|(i, points)| (begin + 0.15 + i as f64 * step, *points));
        chart.draw_series(points.map(|point| Circle::new(point, 2, colour.filled())))?;
        let mean = mean(&totals);
        chart.draw_series([PathElement::new(
            vec![(begin + 0.1, mean), (begin + 0.9, mean)],
            BLACK.stroke_width(2),
        )])?;
    }
    Ok(())
}
