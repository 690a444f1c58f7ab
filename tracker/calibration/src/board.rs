//! Boards in pictures: chessboards, grids of dots and ChArUco boards, as points in a known order.

use crate::charuco::CharucoBoard;
use crate::grey_image::GreyImage;
use crate::grid::{self, Node};
use crate::target_problem::Correspondence;
use crate::{corners, dots};
use nalgebra::{Point3, Vector2};

/// What is printed on the board.
#[derive(Debug, Clone, Copy, PartialEq, Eq, clap::ValueEnum)]
pub enum Pattern {
    /// Dark and light squares; the points are the inner corners.
    Chessboard,
    /// Round dots in rows and columns; the points are their centres.
    Dots,
}

/// A board.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct Board {
    /// What is printed.
    pub pattern: Pattern,
    /// Points in a row.
    pub columns: usize,
    /// Rows.
    pub rows: usize,
    /// Distance of neighbouring points, mm.
    pub pitch_mm: f64,
}

/// Why a board was not found; of two reasons the greater one says more.
#[derive(Debug, Clone, PartialEq, Eq, PartialOrd, Ord, thiserror::Error)]
pub enum BoardError {
    /// Nothing of the kind is in the picture.
    #[error("no {0} found")]
    Nothing(&'static str),
    /// Some of the points hang together, but not all that there should be.
    #[error("expected a grid of {columns}×{rows} points, found {found} that are connected")]
    Incomplete {
        /// Of the board.
        columns: usize,
        /// Of the board.
        rows: usize,
        /// Largest connected set.
        found: usize,
    },
    /// Corners, but no markers that say which.
    #[error(
        "found {corners} corners, but fewer than two markers of the board, which identify them: check \
         --charuco (and --legacy)"
    )]
    Unnamed {
        /// Corners of any board.
        corners: usize,
    },
    /// Some named corners, but too few for a view.
    #[error("found {found} corners of the board, expected at least {fewest} that do not lie on a line")]
    Few {
        /// Corners with names.
        found: usize,
        /// How many are needed.
        fewest: usize,
    },
}

/// Any board that is looked for in pictures.
#[derive(Debug, Clone, Copy, PartialEq)]
pub enum Target {
    /// A board that is seen whole or not at all.
    Whole(Board),
    /// A board whose corners have names, so that parts of it do.
    Charuco(CharucoBoard),
}

impl Target {
    /// The points of the board that a picture shows.
    ///
    /// # Errors
    /// A picture without the board, or with too small a part of it.
    pub fn find(&self, picture: &GreyImage) -> Result<Vec<Correspondence>, BoardError> {
        match self {
            Target::Whole(board) => board.find(picture),
            Target::Charuco(board) => board.find(picture),
        }
    }
}

/// Pictures are first looked at no larger than this; the points are then refined at full size.
const LOOK_PX: usize = 1000;
/// Window of the last refinement: a share of the distance to the nearest corner, within bounds, px.
const WINDOW: (f64, isize, isize) = (0.35, 3, 12);

impl Board {
    /// The points of the board in its own frame, row by row; z = 0.
    pub fn points(&self) -> Vec<Point3<f64>> {
        let at = |i: usize, pitch: f64| {
            Point3::new((i % self.columns) as f64 * pitch, (i / self.columns) as f64 * pitch, 0.0)
        };
        (0..self.columns * self.rows).map(|i| at(i, self.pitch_mm)).collect()
    }

    /// The board in a picture.
    ///
    /// A board with an odd sum of columns and rows, if a chessboard, has one orientation only: the
    /// first inner field is dark. Others are ambiguous by half a turn (square ones by a quarter):
    /// their first point is the one nearest to the picture's top-left, so cameras that are to be
    /// calibrated together must not see them upside down.
    ///
    /// # Errors
    /// A picture without the board, or with a part of it.
    pub fn find(&self, picture: &GreyImage) -> Result<Vec<Correspondence>, BoardError> {
        let mut level = picture.clone();
        let mut scale = 1.0;
        let mut nearest = BoardError::Nothing(self.what());
        loop {
            if level.width.max(level.height) <= LOOK_PX || scale == 1.0 {
                match self.at_level(&level) {
                    Ok(points) => {
                        // Pixel k of a halved picture is the mean of 2k and 2k+1.
                        let full = |p: Vector2<f64>| p * scale + Vector2::repeat((scale - 1.0) / 2.0);
                        return Ok(self.finish(picture, points.into_iter().map(full).collect()));
                    }
                    Err(problem) => nearest = nearest.max(problem),
                }
            }
            if level.width.min(level.height) < 200 {
                return Err(nearest);
            }
            level = level.halved();
            scale *= 2.0;
        }
    }

    fn what(&self) -> &'static str {
        match self.pattern {
            Pattern::Chessboard => "corners of a chessboard",
            Pattern::Dots => "round dots",
        }
    }

    fn at_level(&self, picture: &GreyImage) -> Result<Vec<Vector2<f64>>, BoardError> {
        let candidates: Vec<Vec<Node>> = match self.pattern {
            Pattern::Chessboard => {
                let node = |c: &corners::Corner| Node { at: c.at, lines: c.lines };
                vec![corners::find(picture).iter().map(node).collect()]
            }
            Pattern::Dots => [true, false].map(|dark| dots::nodes(&dots::find(picture, dark))).into(),
        };
        let mut largest = 0;
        for nodes in &candidates {
            match grid::find(nodes, self.columns, self.rows) {
                Ok(order) => return Ok(order.into_iter().map(|n| nodes[n].at).collect()),
                Err(found) => largest = largest.max(found),
            }
        }
        if largest < 4 {
            return Err(BoardError::Nothing(self.what()));
        }
        Err(BoardError::Incomplete { columns: self.columns, rows: self.rows, found: largest })
    }

    /// Refines the points in the full picture and brings them into the board's order.
    fn finish(&self, picture: &GreyImage, points: Vec<Vector2<f64>>) -> Vec<Correspondence> {
        let ordered = self.oriented(picture, points);
        let refined: Vec<Vector2<f64>> = match self.pattern {
            Pattern::Dots => ordered,
            Pattern::Chessboard => (0..ordered.len())
                .map(|i| {
                    let half = (WINDOW.0 * self.nearest(&ordered, i)) as isize;
                    let half = half.clamp(WINDOW.1, WINDOW.2);
                    corners::refined(picture, ordered[i], half).unwrap_or(ordered[i])
                })
                .collect(),
        };
        self.points().into_iter().zip(refined).map(|(point, pixel)| Correspondence { pixel, point }).collect()
    }

    fn nearest(&self, points: &[Vector2<f64>], i: usize) -> f64 {
        let others = points.iter().enumerate().filter(|(j, _)| *j != i);
        others.map(|(_, p)| (p - points[i]).norm()).fold(f64::MAX, f64::min)
    }

    /// Right-handed in the picture (columns to the right means rows down), then turned as
    /// [`Self::find`] says.
    fn oriented(&self, picture: &GreyImage, mut points: Vec<Vector2<f64>>) -> Vec<Vector2<f64>> {
        let (w, n) = (self.columns, points.len());
        let right = points[w - 1] - points[0];
        let down = points[n - w] - points[0];
        if right.perp(&down) < 0.0 {
            points = (0..n).map(|i| points[(n / w - 1 - i / w) * w + i % w]).collect();
        }
        let half_turn = |p: &[Vector2<f64>]| p.iter().rev().copied().collect::<Vec<_>>();
        if self.pattern == Pattern::Chessboard && (self.columns + self.rows) % 2 == 1 {
            let dark_first = self.field_contrast(picture, &points) < 0.0;
            return if dark_first { points } else { half_turn(&points) };
        }
        let mut turns = vec![points.clone(), half_turn(&points)];
        if self.columns == self.rows {
            let quarter: Vec<_> = (0..n).map(|i| points[(w - 1 - i % w) * w + i / w]).collect();
            turns.extend([half_turn(&quarter), quarter]);
        }
        let top_left = |p: &Vec<Vector2<f64>>| p[0].x + p[0].y;
        turns.into_iter().min_by(|a, b| top_left(a).total_cmp(&top_left(b))).unwrap_or(points)
    }

    /// Mean brightness of the inner fields of the first field's colour less that of the others.
    fn field_contrast(&self, picture: &GreyImage, points: &[Vector2<f64>]) -> f64 {
        let fields = (0..(self.columns - 1) * (self.rows - 1)).map(|i| {
            let (c, r) = (i % (self.columns - 1), i / (self.columns - 1));
            let corner = r * self.columns + c;
            let around = [corner, corner + 1, corner + self.columns, corner + self.columns + 1];
            let middle = around.map(|k| points[k]).iter().sum::<Vector2<f64>>() / 4.0;
            f64::from(picture.between(middle)) * if (c + r) % 2 == 0 { 1.0 } else { -1.0 }
        });
        fields.sum()
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use nalgebra::{Isometry3, Vector3};
    use rig::camera::Camera;

    /// A lens with some distortion for pictures of this width.
    fn camera(width: u32) -> Camera {
        let scale = f64::from(width) / 640.0;
        let size = [width, width * 3 / 4];
        let centre = Vector2::new(f64::from(size[0]), f64::from(size[1])) / 2.0;
        let mut camera = crate::lens::pinhole_camera(0, size, Vector2::new(600.0, 600.0) * scale, centre);
        camera.distortion = [-0.2, 0.05, 0.0, 0.0, 0.0];
        camera
    }

    /// Draws a board as a camera sees it: each pixel the mean of 16 rays.
    fn draw(board: &Board, camera: &Camera, place: &Isometry3<f64>) -> GreyImage {
        let [w, h] = camera.size_px.map(|n| n as usize);
        let inverse = place.inverse();
        let brightness = |x: f64, y: f64| {
            let ray = camera.ray_in_world(Vector2::new(x, y)).unwrap();
            let (o, d) = (inverse.translation.vector, inverse.rotation * ray);
            let p = (o - d * (o.z / d.z)) / board.pitch_mm;
            let (across, down) = (board.columns as f64, board.rows as f64);
            match board.pattern {
                // The field before the first point is dark, and so is the first inner one.
                Pattern::Chessboard if (-1.0..across).contains(&p.x) && (-1.0..down).contains(&p.y) => {
                    if (p.x.floor() + p.y.floor()) as i64 % 2 == 0 { 30.0 } else { 220.0 }
                }
                Pattern::Dots => {
                    let n = Vector2::new(
                        p.x.round().clamp(0.0, across - 1.0),
                        p.y.round().clamp(0.0, down - 1.0),
                    );
                    if (p.xy() - n).norm() < 0.25 { 30.0 } else { 220.0 }
                }
                Pattern::Chessboard => 220.0,
            }
        };
        let pixel = |i: usize| {
            let (x, y) = ((i % w) as f64, (i / w) as f64);
            let rays = (0..16)
                .map(|k| brightness(x + f64::from(k % 4) / 4.0 - 0.375, y + f64::from(k / 4) / 4.0 - 0.375));
            (rays.sum::<f64>() / 16.0) as f32
        };
        GreyImage::new(w, h, (0..w * h).map(pixel).collect()).blurred(0.7)
    }

    fn place(board: &Board, tilt: Vector3<f64>, distance: f64) -> Isometry3<f64> {
        let turned = Isometry3::new(Vector3::zeros(), tilt);
        let middle =
            Vector3::new(board.columns as f64 - 1.0, board.rows as f64 - 1.0, 0.0) * board.pitch_mm / 2.0;
        Isometry3::from_parts((Vector3::new(0.0, 0.0, distance) - turned * middle).into(), turned.rotation)
    }

    /// Finds the board and compares every point with where it was drawn.
    fn check(board: &Board, width: u32, tilt: Vector3<f64>, within_px: f64) {
        let (camera, place) = (camera(width), place(board, tilt, 130.0));
        let found = board.find(&draw(board, &camera, &place)).unwrap_or_else(|e| panic!("{tilt:?}: {e}"));
        for sample in &found {
            let truth = camera.project(&(place * sample.point)).unwrap();
            let off = (sample.pixel - truth).norm();
            assert!(off < within_px, "{tilt:?}: {} is {off:.3} px off", sample.point);
        }
        assert_eq!(found.len(), board.columns * board.rows);
    }

    #[test]
    fn chessboards_are_found_in_their_one_orientation() {
        let board = Board { pattern: Pattern::Chessboard, columns: 8, rows: 5, pitch_mm: 10.0 };
        // None along the pixels: 16 rays draw such edges in steps of a quarter pixel.
        let tilts = [[0.05, 0.03, 0.1], [0.5, -0.3, 0.2], [-0.6, 0.4, 2.9], [0.2, 0.5, -1.2]];
        tilts.into_iter().for_each(|tilt| check(&board, 640, tilt.into(), 0.05));
    }

    #[test]
    fn large_pictures_are_refined_at_full_size() {
        let board = Board { pattern: Pattern::Chessboard, columns: 6, rows: 5, pitch_mm: 14.0 };
        check(&board, 1400, Vector3::new(0.3, -0.2, 0.1), 0.08);
    }

    #[test]
    fn ambiguous_boards_begin_at_the_top_left() {
        for (columns, rows, pattern) in
            [(7, 5, Pattern::Chessboard), (5, 5, Pattern::Chessboard), (7, 6, Pattern::Dots)]
        {
            let board = Board { pattern, columns, rows, pitch_mm: 10.0 };
            check(&board, 640, Vector3::new(0.3, 0.2, 0.3), 0.15);
        }
    }

    #[test]
    fn dots_are_found_dark_and_tilted() {
        let board = Board { pattern: Pattern::Dots, columns: 9, rows: 7, pitch_mm: 9.0 };
        for tilt in [[0.0, 0.0, 0.0], [0.4, -0.3, 0.2], [-0.5, 0.2, -0.3]] {
            check(&board, 640, tilt.into(), 0.15);
        }
    }

    #[test]
    fn a_hidden_corner_is_reported() {
        let board = Board { pattern: Pattern::Chessboard, columns: 8, rows: 5, pitch_mm: 10.0 };
        let (camera, place) = (camera(640), place(&board, Vector3::new(0.2, 0.1, 0.0), 130.0));
        let picture = draw(&board, &camera, &place);
        let at = camera.project(&(place * board.points()[12])).unwrap();
        let cover = |i: usize| {
            let p = Vector2::new((i % 640) as f64, (i / 640) as f64);
            if (p - at).norm() < 14.0 { 120.0 } else { picture.at(p.x as isize, p.y as isize) }
        };
        let covered = GreyImage::new(640, 480, (0..640 * 480).map(cover).collect());
        let told = board.find(&covered).unwrap_err();
        assert!(matches!(told, BoardError::Incomplete { found: 36..=39, .. }), "{told}");
        let blank = GreyImage::new(640, 480, vec![100.0; 640 * 480]);
        assert!(matches!(board.find(&blank), Err(BoardError::Nothing(_))));
    }
}
