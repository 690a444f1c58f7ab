//! How often which durations came: outlines of histograms over each other, both axes logarithmic, so that a single
//! long one is seen beside thousands of short ones.

use crate::{Area, COLOURS, Drawn, FONT, Figure};
use plotters::prelude::*;

/// Size of the picture, px.
const SIZE_PX: (u32, u32) = (960, 380);
/// Where an empty bin is drawn: below one.
const NOTHING: f64 = 0.5;

/// How often values came that lie between two bounds, above 0.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct Bin {
    /// Its lower end.
    pub from: f64,
    /// Its upper end.
    pub to: f64,
    /// How often.
    pub count: u64,
}

/// Histograms over a common axis; the bins of each adjoin and rise.
#[derive(Debug, Clone)]
pub struct Histogram {
    /// Above it.
    pub title: String,
    /// What runs across.
    pub across: String,
    /// What is counted.
    pub up: String,
    /// Each with its name; those without a bin are left out.
    pub series: Vec<(String, Vec<Bin>)>,
}

impl Figure for Histogram {
    fn size_px(&self) -> (u32, u32) {
        SIZE_PX
    }

    fn draw<B: DrawingBackend>(&self, area: &Area<B>) -> Drawn<B> {
        let ([left, right], most) = self.range();
        let mut chart = ChartBuilder::on(area)
            .caption(&self.title, (FONT, 18))
            .margin(12)
            .x_label_area_size(42)
            .y_label_area_size(72)
            .build_cartesian_2d((left..right).log_scale(), (NOTHING..2.0 * most).log_scale())?;
        chart
            .configure_mesh()
            .x_desc(&self.across)
            .y_desc(&self.up)
            .label_style((FONT, 13))
            .axis_desc_style((FONT, 14))
            .light_line_style(WHITE)
            .draw()?;
        for ((name, bins), colour) in
            self.series.iter().zip(COLOURS).filter(|((_, bins), _)| !bins.is_empty())
        {
            chart
                .draw_series([PathElement::new(outline(bins), colour.stroke_width(2))])?
                .label(name)
                .legend(move |(x, y)| PathElement::new(vec![(x, y), (x + 18, y)], colour.stroke_width(3)));
        }
        let mut legend = chart.configure_series_labels();
        legend.position(SeriesLabelPosition::UpperRight);
        legend.background_style(WHITE.mix(0.8)).border_style(BLACK.mix(0.3)).label_font((FONT, 14)).draw()
    }
}

impl Histogram {
    /// Both ends of the axis, and the largest count.
    fn range(&self) -> ([f64; 2], f64) {
        let bins = || self.series.iter().flat_map(|(_, bins)| bins);
        let ends = bins().fold([f64::MAX, 0.0f64], |[low, high], bin| [low.min(bin.from), high.max(bin.to)]);
        let most = bins().map(|bin| bin.count).max().unwrap_or(0).max(1) as f64;
        (if ends[0] < ends[1] { ends } else { [0.1, 1.0] }, most)
    }
}

/// The outline of the bars, from the left to the right.
fn outline(bins: &[Bin]) -> Vec<(f64, f64)> {
    let height = |bin: &Bin| if bin.count == 0 { NOTHING } else { bin.count as f64 };
    let tops = bins.iter().flat_map(|bin| [(bin.from, height(bin)), (bin.to, height(bin))]);
    let ends = bins.first().zip(bins.last()).map(|(first, last)| [(first.from, NOTHING), (last.to, NOTHING)]);
    let [first, last] = ends.unwrap_or([(1.0, NOTHING); 2]);
    std::iter::once(first).chain(tops).chain([last]).collect()
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::{Format, bytes};

    fn bin(from: f64, to: f64, count: u64) -> Bin {
        Bin { from, to, count }
    }

    #[test]
    fn a_histogram_has_its_words_and_its_outline_and_may_be_empty() {
        let series = vec![("poses".to_owned(), vec![bin(0.1, 0.2, 900), bin(0.2, 0.4, 0), bin(0.4, 0.8, 1)])];
        let figure =
            Histogram { title: "Title".into(), across: "ms".into(), up: "poses of a bin".into(), series };
        let text = String::from_utf8(bytes(&figure, Format::Svg).unwrap()).unwrap();
        assert!(["Title", "poses", "ms", "<polyline"].iter().all(|word| text.contains(word)), "{text}");
        let empty = Histogram { series: vec![("none".into(), vec![])], ..figure };
        assert!(!bytes(&empty, Format::Png).unwrap().is_empty());
    }

    #[test]
    fn an_outline_begins_and_ends_below_one_and_a_single_one_stands_out() {
        let points = outline(&[bin(1.0, 2.0, 7), bin(2.0, 4.0, 0), bin(4.0, 8.0, 1)]);
        let expected =
            [(1.0, 0.5), (1.0, 7.0), (2.0, 7.0), (2.0, 0.5), (4.0, 0.5), (4.0, 1.0), (8.0, 1.0), (8.0, 0.5)];
        assert_eq!(points, expected);
    }
}
