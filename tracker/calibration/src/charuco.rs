//! ChArUco boards: chessboards with a marker in every white square, so that each corner that is seen has a name and
//! parts of a board are as good as whole ones.
//!
//! The corners are those of a chessboard ([`crate::corners`]); edges between them show which are connected
//! ([`lattice`]), the markers between them which part of the board it is ([`markers`], [`naming`]). Layout and markers
//! are those of OpenCV's `CharucoBoard`.

mod codes;
pub mod dictionary;
mod lattice;
mod markers;
mod naming;
#[cfg(test)]
mod tests;

use crate::board::BoardError;
use crate::corners::{self, Corner};
use crate::grey_image::GreyImage;
use crate::linear::plane_of;
use crate::target_problem::Correspondence;
use dictionary::Dictionary;
use lattice::Cell;
use nalgebra::{Point3, Vector2};
use std::collections::BTreeMap;

/// A board.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct CharucoBoard {
    /// Squares in a row.
    pub columns: usize,
    /// Rows of squares.
    pub rows: usize,
    /// Side of a square, mm.
    pub square_mm: f64,
    /// Side of a marker with its black border, mm.
    pub marker_mm: f64,
    /// Whose markers they are.
    pub dictionary: Dictionary,
    /// Boards of an even number of rows begin with a white square, as OpenCV drew them before 4.6.
    pub legacy: bool,
}

/// A marker's side as a share of its square's, where none is given.
const MARKER: f64 = 0.75;
/// Shares that can be read: a wider marker leaves no white rim, the bits of a narrower one are too small.
const MARKERS: std::ops::RangeInclusive<f64> = 0.4..=0.92;
/// Dictionary where none is given: the smallest that has enough markers, of these.
const USUAL: [&str; 4] = ["DICT_4X4_50", "DICT_4X4_100", "DICT_4X4_250", "DICT_4X4_1000"];
/// Most squares of a side.
const MOST: u32 = 60;
/// Fewest corners that are worth a view: a homography has eight unknowns and a pose six.
const FEWEST: usize = 6;
/// Pictures are looked at no larger than this, px.
const LOOK_PX: usize = 2000;
/// Pictures no larger than this are looked at twice as large, where corners are missing.
const SMALL_PX: usize = 1000;
/// Smallest picture that is looked at, px.
const LEAST_PX: usize = 100;
/// Smoothing of the picture in which edges are followed, px.
const SMOOTHING_PX: f64 = 1.0;
/// Window of the last refinement: bounds, px.
const WINDOW: (isize, isize) = (3, 12);

impl CharucoBoard {
    /// Reads `COLUMNSxROWS[,SQUARE[,MARKER[,DICTIONARY]]]`: squares, mm.
    ///
    /// # Errors
    /// What was expected in which place.
    pub fn parse(text: &str) -> Result<Self, String> {
        let mut words = text.split(',').map(str::trim);
        let size = words.next().unwrap_or_default();
        let pair = size.split_once(['x', '×']);
        let pair = pair.and_then(|(a, b)| Some([a.parse::<u32>().ok()?, b.parse::<u32>().ok()?]));
        let sane = pair.filter(|p| p.iter().all(|n| (3..=MOST).contains(n)));
        let [columns, rows] = sane
            .ok_or_else(|| {
                format!("squares: expected two numbers from 3 to {MOST}, as in 7x5, found {size:?}")
            })?
            .map(|n| n as usize);
        let mut length = |name: &str, usual: f64| match words.next() {
            None => Ok(usual),
            Some(word) => {
                let sane = word.parse().ok().filter(|v: &f64| (1e-3..=1e5).contains(v));
                sane.ok_or_else(|| format!("{name}: expected mm above 0, found {word:?}"))
            }
        };
        let square_mm = length("square", 1.0)?;
        let marker_mm = length("marker", MARKER * square_mm)?;
        if !MARKERS.contains(&(marker_mm / square_mm)) {
            let [least, most] = [MARKERS.start(), MARKERS.end()].map(|share| share * square_mm);
            return Err(format!(
                "marker: expected {least:.3} to {most:.3} mm in squares of {square_mm} mm, found {marker_mm}"
            ));
        }
        let needed = columns * rows / 2;
        let dictionary = match words.next() {
            Some(name) => Dictionary::named(name).ok_or_else(|| {
                format!("dictionary: expected DICT_4X4_50 to DICT_6X6_1000, found {name:?}")
            })?,
            None => {
                let mut usual = USUAL.iter().filter_map(|name| Dictionary::named(name));
                usual.find(|d| d.count() >= needed).ok_or("squares: expected at most 1000 white ones")?
            }
        };
        if let Some(more) = words.next() {
            return Err(format!("expected nothing after the dictionary, found {more:?}"));
        }
        let (name, markers) = (dictionary.name(), dictionary.count());
        if markers < needed {
            return Err(format!(
                "dictionary: a board of {columns}×{rows} squares has {needed} markers, {name} only {markers}"
            ));
        }
        Ok(CharucoBoard { columns, rows, square_mm, marker_mm, dictionary, legacy: false })
    }

    /// True if a square (column, row) is white and has a marker, on the board and beyond.
    pub fn is_white(&self, (x, y): Cell) -> bool {
        let begins_white = self.legacy && self.rows.is_multiple_of(2);
        (x + y).rem_euclid(2) == i32::from(!begins_white)
    }

    /// The squares with markers, in the order of their ids.
    pub fn squares(&self) -> impl Iterator<Item = Cell> + '_ {
        let all = (0..self.rows as i32).flat_map(|y| (0..self.columns as i32).map(move |x| (x, y)));
        all.filter(|square| self.is_white(*square))
    }

    /// The square of a marker; `None` for one that the board lacks.
    fn square_of(&self, id: usize) -> Option<Cell> {
        self.squares().nth(id)
    }

    /// The inner corners, row by row.
    fn corners(&self) -> impl Iterator<Item = Cell> + use<> {
        let (columns, rows) = (self.columns as i32 - 1, self.rows as i32 - 1);
        (0..rows).flat_map(move |y| (0..columns).map(move |x| (x, y)))
    }

    fn has(&self, (x, y): Cell) -> bool {
        (0..self.columns as i32 - 1).contains(&x) && (0..self.rows as i32 - 1).contains(&y)
    }

    /// Number of an inner corner, row by row: OpenCV's id.
    pub fn id(&self, (x, y): Cell) -> usize {
        y as usize * (self.columns - 1) + x as usize
    }

    /// Number of the corner at a point of the board's frame.
    pub fn id_at(&self, point: &Point3<f64>) -> usize {
        let [x, y] = [point.x, point.y].map(|v| (v / self.square_mm).round() as i32 - 1);
        self.id((x, y))
    }

    /// An inner corner in the board's frame: mm from the outer corner of the first square, z = 0.
    fn point(&self, (x, y): Cell) -> Point3<f64> {
        Point3::new(f64::from(x + 1), f64::from(y + 1), 0.0) * self.square_mm
    }

    /// The corners of the board that a picture shows and that can be named.
    ///
    /// # Errors
    /// A picture without corners, without markers of the board, or with too few corners for a view.
    pub fn find(&self, picture: &GreyImage) -> Result<Vec<Correspondence>, BoardError> {
        let samples = self.find_any(picture)?;
        let found = samples.len();
        if found < FEWEST || plane_of(&samples).is_err() {
            return Err(BoardError::Few { found, fewest: FEWEST });
        }
        Ok(samples)
    }

    /// As [`Self::find`], with as few corners as there are.
    ///
    /// # Errors
    /// A picture in which no corner can be named.
    pub fn find_any(&self, picture: &GreyImage) -> Result<Vec<Correspondence>, BoardError> {
        let (mut level, mut scale) = (picture.clone(), 1.0);
        let mut best = BTreeMap::new();
        let mut seen = 0;
        let mut look = |level: &GreyImage, scale: f64| {
            let (corners, named) = self.at_level(level);
            seen = seen.max(corners);
            // Pixel k of a halved picture is the mean of 2k and 2k+1.
            let full = |p: Vector2<f64>| p * scale + Vector2::repeat((scale - 1.0) / 2.0);
            if named.len() > best.len() {
                best = named.into_iter().map(|(cell, p)| (cell, full(p))).collect();
            }
            best.len() == self.corners().count()
        };
        let mut all = false;
        while !all && level.width.min(level.height) >= LEAST_PX {
            all = level.width.max(level.height) <= LOOK_PX && look(&level, scale);
            level = level.halved();
            scale *= 2.0;
        }
        if !all && picture.width.max(picture.height) <= SMALL_PX {
            look(&picture.doubled(), 0.5);
        }
        if best.is_empty() {
            return Err(if seen < 4 {
                BoardError::Nothing("corners of a chessboard")
            } else {
                BoardError::Unnamed { corners: seen }
            });
        }
        Ok(self.refined(picture, best))
    }

    /// Corners of any board, and those of this one.
    fn at_level(&self, picture: &GreyImage) -> (usize, BTreeMap<Cell, Vector2<f64>>) {
        let corners: Vec<Corner> = corners::find(picture);
        let smooth = picture.blurred(SMOOTHING_PX);
        let size = self.marker_mm / self.square_mm;
        let parts = lattice::parts(&smooth, &corners, (1.0 - size) / 2.0);
        let part = |part: &lattice::Part| {
            let markers = markers::read(picture, &corners, part, &self.dictionary, size);
            naming::named(self, part, &markers)
        };
        let mut named = naming::united(parts.iter().filter(|p| p.len() >= 3).map(part));
        naming::completed(self, &corners, &mut named);
        let mut places = named.into_iter().map(|(cell, i)| (cell, corners[i].at)).collect();
        naming::consistent(&mut places);
        (corners.len(), places)
    }

    /// The corners refined in the full picture, in a window that no marker reaches into; what moves off is left out.
    fn refined(&self, picture: &GreyImage, places: BTreeMap<Cell, Vector2<f64>>) -> Vec<Correspondence> {
        let rim = (1.0 - self.marker_mm / self.square_mm) / 2.0;
        let square = |cell: &Cell| {
            let beside = [(1, 0), (-1, 0), (0, 1), (0, -1)].map(|(x, y)| (cell.0 + x, cell.1 + y));
            let steps = beside.iter().filter_map(|c| Some((places.get(c)? - places[cell]).norm()));
            steps.fold(f64::INFINITY, f64::min)
        };
        let refine = |(cell, at): (&Cell, &Vector2<f64>)| {
            let half = (rim * square(cell)).min(f64::from(WINDOW.1 as i32)) as isize;
            Some((*cell, corners::refined(picture, *at, half.clamp(WINDOW.0, WINDOW.1))?))
        };
        let mut exact: BTreeMap<Cell, Vector2<f64>> = places.iter().filter_map(refine).collect();
        naming::consistent(&mut exact);
        let sample = |(cell, pixel): (Cell, Vector2<f64>)| Correspondence { pixel, point: self.point(cell) };
        let mut samples: Vec<(usize, Correspondence)> =
            exact.into_iter().map(|(cell, at)| (self.id(cell), sample((cell, at)))).collect();
        samples.sort_by_key(|s| s.0);
        samples.into_iter().map(|s| s.1).collect()
    }
}
