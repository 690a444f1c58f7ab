//! ChArUco boards in pictures that OpenCV drew, beside what OpenCV finds in them.

use super::*;
use proptest::prelude::*;
use std::collections::HashMap;
use std::path::{Path, PathBuf};

/// Pixels from the truth at which a corner has a wrong name.
const WRONG_PX: f64 = 2.0;

fn folder() -> PathBuf {
    Path::new(env!("CARGO_MANIFEST_DIR")).join("../../tests/data/charuco")
}

fn rows(folder: &Path, file: &str) -> Vec<Vec<String>> {
    let text = std::fs::read_to_string(folder.join(file)).unwrap();
    text.lines().skip(1).map(|line| line.split(',').map(str::to_owned).collect()).collect()
}

/// Corners by picture and id, and whether they are clear.
fn corners_of(folder: &Path, file: &str) -> HashMap<(String, usize), (Vector2<f64>, bool)> {
    let of = |row: Vec<String>| {
        let at = Vector2::new(row[2].parse().unwrap(), row[3].parse().unwrap());
        ((row[0].clone(), row[1].parse().unwrap()), (at, row.get(4).is_some_and(|c| c == "1")))
    };
    rows(folder, file).into_iter().map(of).collect()
}

/// How a detector did.
#[derive(Debug, Default, Clone, Copy)]
struct Score {
    clear: usize,
    found: usize,
    squares: f64,
    wrong: usize,
}

impl Score {
    fn add(&mut self, other: Score) {
        self.clear += other.clear;
        self.found += other.found;
        self.squares += other.squares;
        self.wrong += other.wrong;
    }

    fn rms(&self) -> f64 {
        (self.squares / self.found.max(1) as f64).sqrt()
    }
}

/// Scores of one picture: ours and OpenCV's.
fn scores(folder: &Path, board: &CharucoBoard, name: &str) -> [Score; 2] {
    let (truth, theirs) = (corners_of(folder, "truth.csv"), corners_of(folder, "opencv.csv"));
    let picture = GreyImage::load(&folder.join(name)).unwrap();
    let own = board.find_any(&picture).unwrap_or_default();
    let own: Vec<(usize, Vector2<f64>)> = own.iter().map(|s| (board.id_at(&s.point), s.pixel)).collect();
    let theirs: Vec<_> =
        theirs.into_iter().filter(|(k, _)| k.0 == name).map(|(k, (at, _))| (k.1, at)).collect();
    let clear = truth.iter().filter(|(k, c)| k.0 == name && c.1).count();
    [own, theirs].map(|found| {
        let mut score = Score { clear, ..Score::default() };
        for (id, at) in found {
            let (truth, clear) = truth[&(name.to_owned(), id)];
            let off = (at - truth).norm();
            if off >= WRONG_PX {
                println!("{name}: corner {id} is {off:.1} px off");
                score.wrong += 1;
            }
            if off < WRONG_PX && clear {
                score.found += 1;
                score.squares += off * off;
            }
        }
        score
    })
}

fn board_of(row: &[String]) -> CharucoBoard {
    let text = format!("{}x{},{},{},{}", row[1], row[2], row[3], row[4], row[5]);
    CharucoBoard { legacy: row[6] == "1", ..CharucoBoard::parse(&text).unwrap() }
}

/// Scores of all pictures of a folder, printed.
fn compare(folder: &Path) -> Vec<(String, [Score; 2])> {
    let line = |name: &str, [own, theirs]: &[Score; 2]| {
        println!(
            "{name}: {} and OpenCV {} of {}, rms {:.3} and {:.3} px, wrong {} and {}",
            own.found,
            theirs.found,
            own.clear,
            own.rms(),
            theirs.rms(),
            own.wrong,
            theirs.wrong
        );
    };
    let all: Vec<_> = rows(folder, "pictures.csv")
        .iter()
        .map(|row| (row[0].clone(), scores(folder, &board_of(row), &row[0])))
        .collect();
    let mut sum = [Score::default(); 2];
    for (name, both) in &all {
        line(name, both);
        sum.iter_mut().zip(both).for_each(|(sum, score)| sum.add(*score));
    }
    line("all", &sum);
    all
}

/// In every picture no corner has a wrong name, and as many are found as OpenCV finds, about as exactly.
#[test]
fn boards_drawn_by_opencv_are_read_as_well_as_by_opencv() {
    let all = compare(&folder());
    assert_eq!(all.len(), 9);
    for (name, [own, theirs]) in &all {
        assert_eq!(own.wrong, 0, "{name}");
        assert!(own.found >= theirs.found, "{name}: {own:?} {theirs:?}");
        assert!(own.rms() < (1.5 * theirs.rms()).max(0.1), "{name}: {own:?} {theirs:?}");
    }
    let [found, clear] = all.iter().fold([0, 0], |n, (_, [own, _])| [n[0] + own.found, n[1] + own.clear]);
    assert!(found * 100 >= clear * 90, "{found} of {clear}");
}

/// Other pictures of `packaging/tools/charuco_pictures.py`, named by VITREO_CHARUCO: for tables, and to look for wrong
/// names in thousands. Of those at the rim of what covers them a few are some px off; another corner is a square away.
#[test]
fn a_folder_that_is_named_is_compared_too() {
    let Ok(folder) = std::env::var("VITREO_CHARUCO") else { return };
    let all = compare(Path::new(&folder));
    let [wrong, found] = all.iter().fold([0, 0], |n, (_, [own, _])| [n[0] + own.wrong, n[1] + own.found]);
    assert!(1000 * wrong <= found, "{wrong} of {found}");
}

#[test]
fn another_board_names_nothing() {
    let picture = GreyImage::load(&folder().join("plain.png")).unwrap();
    // Other markers, and the same ones on a board of another shape.
    for other in ["7x5,10,7.5,DICT_6X6_50", "10x8,10,7.5,DICT_4X4_50"] {
        let board = CharucoBoard::parse(other).unwrap();
        let told = board.find(&picture).map(|s| s.len());
        assert!(matches!(told, Err(BoardError::Unnamed { corners: 24.. })), "{other}: {told:?}");
    }
    let chessboard = folder().join("../chessboards/left01.jpg");
    let told = CharucoBoard::parse("10x7").unwrap().find(&GreyImage::load(&chessboard).unwrap());
    assert!(matches!(told, Err(BoardError::Unnamed { .. })), "{told:?}");
    let blank = GreyImage::new(320, 240, vec![90.0; 320 * 240]);
    let told = CharucoBoard::parse("7x5").unwrap().find(&blank);
    assert!(matches!(told, Err(BoardError::Nothing(_))), "{told:?}");
}

#[test]
fn options_say_what_a_board_is_or_what_is_wrong() {
    let board = CharucoBoard::parse("7x5, 2.5, 1.8, dict_5x5_100").unwrap();
    assert_eq!((board.columns, board.rows, board.square_mm, board.marker_mm), (7, 5, 2.5, 1.8));
    assert_eq!((board.dictionary.name().as_str(), board.squares().count()), ("DICT_5X5_100", 17));
    assert_eq!(CharucoBoard::parse("20x15").unwrap().dictionary.name(), "DICT_4X4_250");
    for (text, told) in [
        ("", "two numbers from 3 to 60"),
        ("7", "as in 7x5, found \"7\""),
        ("2x5", "from 3 to 60"),
        ("7x5,0", "square: expected mm above 0"),
        ("7x5,x", "found \"x\""),
        ("7x5,2.5,nan", "marker: expected mm above 0"),
        ("7x5,2.5,2.5", "marker: expected 1.000 to 2.300 mm"),
        ("7x5,2.5,1.8,DICT_7X7_50", "expected DICT_4X4_50 to DICT_6X6_1000"),
        ("20x15,2.5,1.8,DICT_4X4_50", "has 150 markers, DICT_4X4_50 only 50"),
        ("7x5,2.5,1.8,DICT_4X4_50,1", "expected nothing after the dictionary"),
        ("60x60", "at most 1000"),
    ] {
        let said = CharucoBoard::parse(text).unwrap_err();
        assert!(said.contains(told), "{text}: {said}");
    }
}

proptest! {
    #[test]
    fn any_option_is_a_board_or_refused(text in "[0-9x,. DICT_4-6a-z]{0,40}") {
        if let Ok(board) = CharucoBoard::parse(&text) {
            prop_assert!(board.squares().count() <= board.dictionary.count());
        }
    }

    /// What is no board is none, however it looks.
    #[test]
    fn any_picture_is_a_board_or_none(seed in 0u64..1000, width in 100usize..160, cell in 3usize..20) {
        let board = CharucoBoard::parse("4x3").unwrap();
        let noise = |i: usize| {
            let (x, y) = ((i % width / cell) as u64, (i / width / cell) as u64);
            let hash = ((x * 73_856_093) ^ (y * 19_349_663) ^ (seed * 83_492_791)).wrapping_mul(0x9E37_79B9_7F4A_7C15);
            if hash >> 63 == 1 { 220.0 } else { 30.0 }
        };
        let picture = GreyImage::new(width, 120, (0..width * 120).map(noise).collect());
        let found = board.find_any(&picture).unwrap_or_default();
        prop_assert!(found.is_empty(), "{found:?}");
    }
}
