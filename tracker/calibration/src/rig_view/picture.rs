//! How well tips are known over the workspace, as maps at three heights.

use super::Viewer;
use nalgebra::Point3;
use plots::{Area, Drawn, FONT, Figure};
use plotters::prelude::*;
use protocol::limits::INSTRUMENTS;
use protocol::poses::BODY_NAMES;

/// Side of a map, its frame included, and height of the strip of words below all, px.
const MAP_PX: u32 = 240;
const STRIP_PX: u32 = 60;
/// Squares along a side of a map.
const SQUARES: i32 = 36;
/// Heights of the maps as shares of the workspace's radius.
const HEIGHTS: [f64; 3] = [-0.5, 0.0, 0.5];
/// Accuracy that ends each colour, µm, and its colour: from dark to pale, for any colour vision.
const CLASSES: [(f64, RGBColor); 5] = [
    (2.5, RGBColor(8, 48, 107)),
    (5.0, RGBColor(33, 113, 181)),
    (10.0, RGBColor(107, 174, 214)),
    (25.0, RGBColor(198, 219, 239)),
    (f64::INFINITY, RGBColor(253, 174, 97)),
];
/// Where a frame does not determine the pose.
const FREE: RGBColor = RGBColor(178, 24, 43);

/// Maps of both instruments.
pub struct Maps<'a> {
    /// Of the rig.
    pub viewer: &'a Viewer<'a>,
    /// Of its workspace, mm.
    pub radius_mm: f64,
}

fn colour(sigma_um: Option<f64>) -> RGBColor {
    let class = |um: f64| CLASSES.iter().find(|(end, _)| um <= *end).map(|c| c.1);
    sigma_um.and_then(class).unwrap_or(FREE)
}

impl Maps<'_> {
    fn map<B: DrawingBackend>(&self, area: &Area<B>, instrument: usize, height: f64) -> Drawn<B> {
        let z = height * self.radius_mm;
        let side = (MAP_PX - 40) as i32;
        let [left, top] = [20, 30];
        let style = (FONT, 13).into_font().color(&BLACK);
        let name = BODY_NAMES[instrument];
        area.draw(&Text::new(format!("{name}, z = {z:.1} mm"), (left, 8), style))?;
        let edge = |i: i32| i * side / SQUARES;
        for (i, j) in (0..SQUARES).flat_map(|i| (0..SQUARES).map(move |j| (i, j))) {
            let at = |k: i32| (f64::from(2 * k + 1) / f64::from(SQUARES) - 1.0) * self.radius_mm;
            // Up on paper is +y.
            let tip = Point3::new(at(i), -at(j), z);
            if tip.coords.norm() > self.radius_mm {
                continue;
            }
            let fill = colour(self.viewer.place(instrument, tip).sigma_um).filled();
            let corners = [(left + edge(i), top + edge(j)), (left + edge(i + 1), top + edge(j + 1))];
            area.draw(&Rectangle::new(corners, fill))?;
        }
        let frame = [(left, top), (left + side, top + side)];
        area.draw(&Rectangle::new(frame, RGBColor(200, 200, 200)))
    }
}

impl Figure for Maps<'_> {
    fn size_px(&self) -> (u32, u32) {
        (MAP_PX * HEIGHTS.len() as u32, MAP_PX * INSTRUMENTS as u32 + STRIP_PX)
    }

    fn draw<B: DrawingBackend>(&self, area: &Area<B>) -> Drawn<B> {
        let (maps, strip) = area.split_vertically(MAP_PX * INSTRUMENTS as u32);
        for (i, area) in maps.split_evenly((INSTRUMENTS, HEIGHTS.len())).iter().enumerate() {
            self.map(area, i / HEIGHTS.len(), HEIGHTS[i % HEIGHTS.len()])?;
        }
        let style = (FONT, 13).into_font().color(&BLACK);
        let radius = self.radius_mm;
        let words = format!("Tip from one frame, µm (σ, worst direction); x right, y up, ±{radius} mm");
        strip.draw(&Text::new(words, (20, 6), style.clone()))?;
        let names = ["to 2.5", "5", "10", "25", "more", "free"];
        let colours = CLASSES.iter().map(|c| c.1).chain([FREE]);
        for (k, (name, colour)) in names.iter().zip(colours).enumerate() {
            let x = 20 + 110 * k as i32;
            strip.draw(&Rectangle::new([(x, 30), (x + 24, 46)], colour.filled()))?;
            strip.draw(&Text::new(*name, (x + 30, 32), style.clone()))?;
        }
        Ok(())
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn colours_follow_the_accuracy() {
        assert_eq!(colour(None), FREE);
        assert_eq!([1.0, 2.5, 3.0, 26.0].map(|um| colour(Some(um))), [0, 0, 1, 4].map(|i| CLASSES[i].1));
        assert_eq!(colour(Some(f64::NAN)), FREE);
    }
}
