//! Boards to be printed: as SVG, and as PNG that says its size.

use crate::board::{Board, Pattern, Target};
use crate::charuco::CharucoBoard;
use anyhow::{Context, Result, ensure};
use std::fmt::Write;
use std::io::Cursor;

/// Diameter of a printed dot, as a share of the dots' distance.
const DOT: f64 = 0.5;
/// Largest picture, px a side.
const MOST_PX: f64 = 20_000.0;
/// mm of an inch.
const INCH_MM: f64 = 25.4;

/// Something dark on white paper, mm from the top left of the board.
#[derive(Debug, Clone, Copy, PartialEq)]
enum Shape {
    /// Left, top, width, height.
    Rectangle([f64; 4]),
    /// Middle and radius.
    Disc([f64; 3]),
}

/// A board on paper.
#[derive(Debug, Clone, PartialEq)]
pub struct Printed {
    shapes: Vec<Shape>,
    /// Width and height without the margin, mm.
    pub size_mm: [f64; 2],
    /// White around the board, mm.
    pub margin_mm: f64,
}

impl Printed {
    /// A board with so much white around it.
    pub fn new(target: &Target, margin_mm: f64) -> Self {
        let (shapes, size_mm) = match target {
            Target::Charuco(board) => charuco(board),
            Target::Whole(board) => match board.pattern {
                Pattern::Chessboard => chessboard(board),
                Pattern::Dots => dots(board),
            },
        };
        Printed { shapes, size_mm, margin_mm }
    }

    /// Size of the paper that is drawn on, mm.
    pub fn paper_mm(&self) -> [f64; 2] {
        self.size_mm.map(|v| v + 2.0 * self.margin_mm)
    }

    /// As SVG, whose units are mm.
    pub fn svg(&self) -> String {
        let ([w, h], margin) = (self.paper_mm(), self.margin_mm);
        let mut out = format!(
            "<svg xmlns=\"http://www.w3.org/2000/svg\" width=\"{w}mm\" height=\"{h}mm\" viewBox=\"0 0 {w} {h}\">\n\
             <rect width=\"{w}\" height=\"{h}\" fill=\"white\"/>\n\
             <g transform=\"translate({margin} {margin})\" shape-rendering=\"crispEdges\">\n"
        );
        for shape in &self.shapes {
            let line = match shape {
                Shape::Rectangle([x, y, w, h]) => {
                    format!("<rect x=\"{x:.6}\" y=\"{y:.6}\" width=\"{w:.6}\" height=\"{h:.6}\"/>")
                }
                Shape::Disc([x, y, r]) => format!("<circle cx=\"{x:.6}\" cy=\"{y:.6}\" r=\"{r:.6}\"/>"),
            };
            let _ = writeln!(out, "{line}");
        }
        out + "</g>\n</svg>\n"
    }

    /// As a PNG of so many pixels an inch, which it says itself.
    ///
    /// # Errors
    /// A picture that would be too large.
    pub fn png(&self, dpi: f64) -> Result<Vec<u8>> {
        let scale = dpi / INCH_MM;
        let [w, h] = self.paper_mm().map(|v| (v * scale).round());
        ensure!(
            w.max(h) <= MOST_PX && w.min(h) >= 1.0,
            "--dpi: expected a picture of at most {MOST_PX} px a side, found {w}×{h}"
        );
        let mut picture = image::GrayImage::from_pixel(w as u32, h as u32, image::Luma([255]));
        for shape in &self.shapes {
            self.paint(&mut picture, shape, scale);
        }
        let mut bytes = Cursor::new(Vec::new());
        picture.write_to(&mut bytes, image::ImageFormat::Png)?;
        with_resolution(bytes.into_inner(), (1e3 * scale).round() as u32).context("PNG")
    }

    /// Pixels whose middles a shape covers.
    fn paint(&self, picture: &mut image::GrayImage, shape: &Shape, scale: f64) {
        let [x0, y0, x1, y1] = match *shape {
            Shape::Rectangle([x, y, w, h]) => [x, y, x + w, y + h],
            Shape::Disc([x, y, r]) => [x - r, y - r, x + r, y + r],
        };
        // Pixel i covers i to i + 1; rounding must not open a gap between what touches.
        let first = |v: f64| ((v + self.margin_mm) * scale - 0.5 - 1e-6).ceil().max(0.0) as u32;
        for py in first(y0)..first(y1).min(picture.height()) {
            for px in first(x0)..first(x1).min(picture.width()) {
                let mm = |p: u32| (f64::from(p) + 0.5) / scale - self.margin_mm;
                let inside = match *shape {
                    Shape::Rectangle(_) => true,
                    Shape::Disc([x, y, r]) => (mm(px) - x).hypot(mm(py) - y) <= r,
                };
                if inside {
                    picture.put_pixel(px, py, image::Luma([0]));
                }
            }
        }
    }
}

/// The squares of one colour of a board of `columns`×`rows` squares.
fn squares(columns: usize, rows: usize, side: f64, dark: impl Fn(i32, i32) -> bool) -> Vec<Shape> {
    let all = (0..rows as i32).flat_map(|y| (0..columns as i32).map(move |x| (x, y)));
    let square =
        |(x, y): (i32, i32)| Shape::Rectangle([f64::from(x) * side, f64::from(y) * side, side, side]);
    all.filter(|(x, y)| dark(*x, *y)).map(square).collect()
}

/// Corners of the board are those inside: there is one square more than corners. The first square is dark, as
/// [`Board::find`] has it.
fn chessboard(board: &Board) -> (Vec<Shape>, [f64; 2]) {
    let (columns, rows, side) = (board.columns + 1, board.rows + 1, board.pitch_mm);
    let shapes = squares(columns, rows, side, |x, y| (x + y) % 2 == 0);
    (shapes, [columns as f64 * side, rows as f64 * side])
}

fn dots(board: &Board) -> (Vec<Shape>, [f64; 2]) {
    let (pitch, radius) = (board.pitch_mm, DOT * board.pitch_mm / 2.0);
    let disc = |i: usize| {
        let [x, y] = [i % board.columns, i / board.columns].map(|k| k as f64 * pitch + radius);
        Shape::Disc([x, y, radius])
    };
    let size = [board.columns, board.rows].map(|n| (n as f64 - 1.0) * pitch + 2.0 * radius);
    ((0..board.columns * board.rows).map(disc).collect(), size)
}

fn charuco(board: &CharucoBoard) -> (Vec<Shape>, [f64; 2]) {
    let side = board.square_mm;
    let mut shapes = squares(board.columns, board.rows, side, |x, y| !board.is_white((x, y)));
    let modules = board.dictionary.side + 2;
    let module = board.marker_mm / modules as f64;
    let rim = (side - board.marker_mm) / 2.0;
    for (id, (x, y)) in board.squares().enumerate() {
        let [left, top] = [x, y].map(|v| f64::from(v) * side + rim);
        for i in 0..modules * modules {
            let (c, r) = (i % modules, i / modules);
            // The border: beyond the first and the last bit.
            let white = c > 0 && r > 0 && board.dictionary.is_white(id, c - 1, r - 1);
            if !white {
                let at = |k: usize| k as f64 * module;
                shapes.push(Shape::Rectangle([left + at(c), top + at(r), module, module]));
            }
        }
    }
    (shapes, [board.columns as f64 * side, board.rows as f64 * side])
}

/// A PNG that says how many pixels of it are a metre: a chunk pHYs behind the first one, IHDR.
fn with_resolution(png: Vec<u8>, per_metre: u32) -> Option<Vec<u8>> {
    const HEAD: usize = 8 + 4 + 4 + 13 + 4;
    let (head, rest) = png.split_at_checked(HEAD)?;
    let mut chunk = b"pHYs".to_vec();
    chunk.extend([per_metre.to_be_bytes(), per_metre.to_be_bytes()].concat());
    chunk.push(1);
    let length = (chunk.len() as u32 - 4).to_be_bytes();
    let check = check_sum(&chunk).to_be_bytes();
    Some([head, &length, &chunk, &check, rest].concat())
}

/// The CRC of PNG: CRC-32 of ISO 3309.
fn check_sum(bytes: &[u8]) -> u32 {
    let step = |mut crc: u32, byte: &u8| {
        crc ^= u32::from(*byte);
        for _ in 0..8 {
            crc = if crc & 1 == 1 { crc >> 1 ^ 0xEDB8_8320 } else { crc >> 1 };
        }
        crc
    };
    !bytes.iter().fold(u32::MAX, step)
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::grey_image::GreyImage;
    use std::path::Path;

    /// The board pixel by pixel as OpenCV draws it.
    #[test]
    fn charuco_boards_are_those_of_opencv() {
        let folder = Path::new(env!("CARGO_MANIFEST_DIR")).join("../../tests/data/charuco/printed");
        for (file, board, legacy) in [
            ("plain.png", "7x5,10,7.5,DICT_4X4_50", false),
            ("legacy.png", "7x6,10,7.5,DICT_4X4_100", true),
            ("six.png", "5x4,10,8,DICT_6X6_250", false),
        ] {
            let board = CharucoBoard { legacy, ..CharucoBoard::parse(board).unwrap() };
            let theirs = GreyImage::load(&folder.join(file)).unwrap();
            let dpi = theirs.width as f64 / (10.0 * board.columns as f64) * INCH_MM;
            let png = Printed::new(&Target::Charuco(board), 0.0).png(dpi).unwrap();
            let own = GreyImage::decode(&png, file).unwrap();
            assert!(own == theirs, "{file}");
        }
    }

    /// What is printed is what is looked for.
    #[test]
    fn printed_boards_are_found() {
        let whole = |pattern, columns, rows| Target::Whole(Board { pattern, columns, rows, pitch_mm: 10.0 });
        let charuco = Target::Charuco(CharucoBoard::parse("7x5,10,7,DICT_5X5_50").unwrap());
        for (target, first) in
            [(whole(Pattern::Chessboard, 8, 5), 20.0), (whole(Pattern::Dots, 7, 6), 12.5), (charuco, 20.0)]
        {
            let printed = Printed::new(&target, 10.0);
            let picture = GreyImage::decode(&printed.png(4.0 * INCH_MM).unwrap(), "f").unwrap().blurred(0.7);
            let found = target.find(&picture).unwrap_or_else(|e| panic!("{target:?}: {e}"));
            let off = found[0].pixel.map(|v| (v + 0.5) / 4.0 - first).norm();
            assert!(off < 0.05, "{target:?}: {off} mm");
        }
    }

    #[test]
    fn sizes_are_said_in_the_files() {
        let target = Target::Charuco(CharucoBoard::parse("3x3,10").unwrap());
        let printed = Printed::new(&target, 5.0);
        assert_eq!(printed.paper_mm(), [40.0; 2]);
        assert!(printed.svg().contains("width=\"40mm\" height=\"40mm\" viewBox=\"0 0 40 40\""));
        let png = printed.png(254.0).unwrap();
        let at = png.windows(4).position(|w| w == b"pHYs").unwrap();
        assert_eq!(png[at + 4..at + 13], [0, 0, 0x27, 0x10, 0, 0, 0x27, 0x10, 1]);
        assert!(printed.png(1e6).unwrap_err().to_string().contains("at most 20000 px"));
        assert_eq!(check_sum(b"123456789"), 0xCBF4_3926);
    }
}
