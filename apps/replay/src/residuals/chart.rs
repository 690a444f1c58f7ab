//! The picture of residuals, a row a camera: mean and RMS of every marker, and mean residuals by their place
//! in the frame, which show lenses and parity.

use diagnosis::ResidualRow;
use plots::{Area, COLOURS, Drawn, FONT, Figure};
use plotters::prelude::*;
use protocol::limits::MAX_CAMERAS;
use protocol::matches::MatchFrame;
use rig::Rig;

/// Cells across and down a frame.
const CELLS: [usize; 2] = [16, 12];
/// Blobs of a cell that give a mean.
const ENOUGH: u64 = 20;
/// Width of the markers' panel, of the frame's, and the height of a row, px.
const ROW_PX: (u32, u32, u32) = (640, 480, 360);

/// Sum and number of the residuals of a cell.
type Cell = ([f64; 2], u64);

/// Residuals by their place in the frame of each camera.
pub struct Grid {
    sizes_px: [Option<[f64; 2]>; MAX_CAMERAS],
    cells: Vec<[[Cell; CELLS[0]]; CELLS[1]]>,
}

impl Grid {
    /// Of the cameras of a rig.
    pub fn new(rig: &Rig) -> Self {
        let mut sizes_px = [None; MAX_CAMERAS];
        for camera in rig.cameras() {
            if let Some(size) = sizes_px.get_mut(camera.id as usize) {
                *size = Some(camera.size_px.map(f64::from));
            }
        }
        Grid { sizes_px, cells: vec![Default::default(); MAX_CAMERAS] }
    }

    /// Takes what became of the blobs of a frame.
    pub fn note(&mut self, matches: &MatchFrame) {
        for field in matches.fields() {
            let camera = field.camera as usize;
            let Some(Some(size)) = self.sizes_px.get(camera) else { continue };
            for blob in field.blobs().iter().filter(|b| b.outcome().is_used()) {
                let place = [blob.x_px, blob.y_px].map(f64::from);
                let [column, line] = std::array::from_fn(|i| {
                    ((place[i] / size[i] * CELLS[i] as f64).max(0.0) as usize).min(CELLS[i] - 1)
                });
                let (sum, count) = &mut self.cells[camera][line][column];
                sum[0] += f64::from(blob.residual_x_px);
                sum[1] += f64::from(blob.residual_y_px);
                *count += 1;
            }
        }
    }

    /// Places (px) and mean residuals (px) of a camera's cells with enough blobs.
    fn means(&self, camera: usize, size: [f64; 2]) -> Vec<([f64; 2], [f64; 2])> {
        let lines = self.cells[camera].iter().enumerate();
        let cells = lines.flat_map(|(y, line)| line.iter().enumerate().map(move |(x, cell)| ([x, y], cell)));
        let enough = cells.filter(|(_, (_, count))| *count >= ENOUGH);
        enough
            .map(|(at, (sum, count))| {
                let place = std::array::from_fn(|i| (at[i] as f64 + 0.5) * size[i] / CELLS[i] as f64);
                (place, sum.map(|s| s / *count as f64))
            })
            .collect()
    }
}

/// The picture.
pub struct Chart<'a> {
    cameras: Vec<(usize, [f64; 2])>,
    rows: &'a [ResidualRow],
    grid: &'a Grid,
    /// Half height of the markers' panels, px of residual.
    reach_px: f64,
}

impl<'a> Chart<'a> {
    /// Of the cameras of a rig.
    pub fn new(rig: &Rig, rows: &'a [ResidualRow], grid: &'a Grid) -> Self {
        let cameras = rig.cameras().into_iter().map(|c| (c.id as usize, c.size_px.map(f64::from))).collect();
        let farthest = rows.iter().flat_map(|r| (0..2).map(|i| r.mean_px[i].abs() + r.rms_px[i]));
        let reach_px = 1.1 * farthest.fold(0.05, f64::max);
        Chart { cameras, rows, grid, reach_px }
    }

    /// Mean (dot) and RMS (bar) of the markers of a camera, column beside line.
    fn markers<B: DrawingBackend>(&self, area: &Area<B>, camera: usize) -> Drawn<B> {
        let rows: Vec<&ResidualRow> = self.rows.iter().filter(|r| r.camera == camera).collect();
        let count = rows.len().max(1) as f64;
        let mut chart = ChartBuilder::on(area)
            .caption(format!("camera {camera}: mean ± RMS by marker, px"), (FONT, 15))
            .margin(8)
            .x_label_area_size(28)
            .y_label_area_size(44)
            .build_cartesian_2d(-0.5..count - 0.5, -self.reach_px..self.reach_px)?;
        let name = |x: &f64| {
            let whole = (x.round() - x).abs() < 1e-6;
            let row = rows.get(x.round() as usize).filter(|_| whole);
            row.map_or(String::new(), |r| format!("{}.{}", r.body, r.marker))
        };
        chart
            .configure_mesh()
            .disable_x_mesh()
            .light_line_style(WHITE)
            .x_labels(rows.len().max(2))
            .x_label_formatter(&name)
            .y_label_formatter(&|y| format!("{y:+.2}"))
            .label_style((FONT, 12))
            .draw()?;
        for (axis, (name, colour)) in [("x", COLOURS[0]), ("y", COLOURS[1])].into_iter().enumerate() {
            let shift = if axis == 0 { -0.12 } else { 0.12 };
            let bars = rows.iter().enumerate().map(|(n, r)| {
                ErrorBar::new_vertical(
                    n as f64 + shift,
                    r.mean_px[axis] - r.rms_px[axis],
                    r.mean_px[axis],
                    r.mean_px[axis] + r.rms_px[axis],
                    colour.filled(),
                    6,
                )
            });
            chart
                .draw_series(bars)?
                .label(name)
                .legend(move |(x, y)| Circle::new((x + 8, y), 4, colour.filled()));
        }
        chart
            .configure_series_labels()
            .position(SeriesLabelPosition::UpperRight)
            .background_style(WHITE)
            .border_style(RGBColor(200, 200, 200))
            .label_font((FONT, 12))
            .draw()
    }

    /// Mean residuals over the frame of a camera, enlarged.
    fn frame<B: DrawingBackend>(&self, area: &Area<B>, camera: usize, size: [f64; 2]) -> Drawn<B> {
        let means = self.grid.means(camera, size);
        let longest = means.iter().map(|(_, r)| r[0].hypot(r[1])).fold(1e-3, f64::max);
        // The longest arrow is as long as two cells.
        let enlarge = 2.0 * size[0] / CELLS[0] as f64 / longest;
        let mut chart = ChartBuilder::on(area)
            .caption(format!("mean residual by place, × {enlarge:.0} (longest {longest:.2} px)"), (FONT, 15))
            .margin(8)
            .x_label_area_size(28)
            .y_label_area_size(36)
            .build_cartesian_2d(0.0..size[0], size[1]..0.0)?;
        chart
            .configure_mesh()
            .light_line_style(WHITE)
            .x_label_formatter(&|x| format!("{x:.0}"))
            .y_label_formatter(&|y| format!("{y:.0}"))
            .label_style((FONT, 12))
            .draw()?;
        chart.draw_series(means.iter().map(|(at, r)| {
            let end = (at[0] + r[0] * enlarge, at[1] + r[1] * enlarge);
            PathElement::new(vec![(at[0], at[1]), end], COLOURS[1].stroke_width(2))
        }))?;
        chart.draw_series(means.iter().map(|(at, _)| Circle::new((at[0], at[1]), 2, COLOURS[0].filled())))?;
        Ok(())
    }
}

impl Figure for Chart<'_> {
    fn size_px(&self) -> (u32, u32) {
        (ROW_PX.0 + ROW_PX.1, ROW_PX.2 * self.cameras.len() as u32)
    }

    fn draw<B: DrawingBackend>(&self, area: &Area<B>) -> Drawn<B> {
        for ((camera, size), row) in self.cameras.iter().zip(area.split_evenly((self.cameras.len(), 1))) {
            let (markers, frame) = row.split_horizontally(ROW_PX.0);
            self.markers(&markers, *camera)?;
            self.frame(&frame, *camera, *size)?;
        }
        Ok(())
    }
}
