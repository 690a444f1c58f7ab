//! Lines over a common axis, with a legend.

use crate::{Area, COLOURS, Drawn, FONT, Figure};
use plotters::prelude::*;

/// Size of the picture, px.
const SIZE_PX: (u32, u32) = (960, 420);
/// Points of a line that are drawn at most: two for each column of the picture.
const POINTS: usize = 2 * SIZE_PX.0 as usize;

/// A line.
#[derive(Debug, Clone)]
pub struct Line {
    /// Its name.
    pub name: String,
    /// Its points, in the order in which they are joined.
    pub points: Vec<[f64; 2]>,
}

/// A plot.
#[derive(Debug, Clone)]
pub struct LinePlot {
    /// Above it.
    pub title: String,
    /// What runs across.
    pub across: String,
    /// What runs up.
    pub up: String,
    /// The lines; those without a point are left out.
    pub lines: Vec<Line>,
}

impl Figure for LinePlot {
    fn size_px(&self) -> (u32, u32) {
        SIZE_PX
    }

    fn draw<B: DrawingBackend>(&self, area: &Area<B>) -> Drawn<B> {
        let [across, up] = [0, 1].map(|axis| self.range(axis));
        let mut chart = ChartBuilder::on(area)
            .caption(&self.title, (FONT, 18))
            .margin(12)
            .x_label_area_size(42)
            .y_label_area_size(64)
            .build_cartesian_2d(across[0]..across[1], up[0].min(0.0)..up[1])?;
        chart
            .configure_mesh()
            .x_desc(&self.across)
            .y_desc(&self.up)
            .label_style((FONT, 13))
            .axis_desc_style((FONT, 14))
            .light_line_style(WHITE)
            .draw()?;
        for (line, colour) in self.lines.iter().zip(COLOURS).filter(|(line, _)| !line.points.is_empty()) {
            let points: Vec<(f64, f64)> = thinned(&line.points).into_iter().map(|[x, y]| (x, y)).collect();
            chart
                .draw_series([PathElement::new(points, colour.stroke_width(2))])?
                .label(&line.name)
                .legend(move |(x, y)| PathElement::new(vec![(x, y), (x + 18, y)], colour.stroke_width(3)));
        }
        let mut legend = chart.configure_series_labels();
        legend.background_style(WHITE.mix(0.8)).border_style(BLACK.mix(0.3)).label_font((FONT, 14)).draw()
    }
}

impl LinePlot {
    /// Least and largest of an axis, never alike.
    fn range(&self, axis: usize) -> [f64; 2] {
        let values = self.lines.iter().flat_map(|line| &line.points).map(|point| point[axis]);
        let [low, high] =
            values.fold([f64::MAX, f64::MIN], |[low, high], value| [low.min(value), high.max(value)]);
        match low < high {
            true => [low, high],
            false if low == high => [low - 0.5, high + 0.5],
            false => [0.0, 1.0],
        }
    }
}

/// Of many points, the lowest and the highest of each stretch: what stands out is kept.
fn thinned(points: &[[f64; 2]]) -> Vec<[f64; 2]> {
    if points.len() <= POINTS {
        return points.to_vec();
    }
    let length = points.len().div_ceil(POINTS / 2);
    let by_height = |p: &&[f64; 2], q: &&[f64; 2]| p[1].total_cmp(&q[1]);
    let ends = points.chunks(length).filter_map(|stretch| {
        let (low, high) = (stretch.iter().min_by(by_height)?, stretch.iter().max_by(by_height)?);
        Some(if low[0] <= high[0] { [*low, *high] } else { [*high, *low] })
    });
    ends.flatten().collect()
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::{Format, bytes};

    fn plot(points: Vec<[f64; 2]>) -> LinePlot {
        let line = Line { name: "inst0".into(), points };
        LinePlot { title: "Title".into(), across: "s".into(), up: "µm".into(), lines: vec![line] }
    }

    #[test]
    fn a_plot_has_its_words_and_its_line_and_may_be_empty() {
        let text =
            String::from_utf8(bytes(&plot(vec![[0.0, 1.0], [2.0, 3.0]]), Format::Svg).unwrap()).unwrap();
        assert!(["Title", "inst0", "µm", "<polyline"].iter().all(|word| text.contains(word)), "{text}");
        for points in [vec![], vec![[1.0, 1.0]], vec![[1.0, 0.0]; 3]] {
            assert!(!bytes(&plot(points), Format::Png).unwrap().is_empty());
        }
    }

    #[test]
    fn what_stands_out_of_many_points_is_kept() {
        let mut points: Vec<[f64; 2]> = (0..50_000).map(|n| [f64::from(n), 1.0]).collect();
        points[31_415][1] = 9.0;
        let thin = thinned(&points);
        assert!(thin.len() <= POINTS && thin.contains(&[31_415.0, 9.0]), "{}", thin.len());
        assert!(thin.windows(2).all(|pair| pair[0][0] <= pair[1][0]));
    }
}
