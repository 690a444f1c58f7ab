//! A board in the pictures of several cameras, and what is wrong with how it was held.

use crate::pictures::{PicturesArgs, of_size};
use anyhow::Result;
use calibration::board::{BoardError, Target};
use calibration::grey_image::GreyImage;
pub use calibration::halves::{half, rms_with};
use calibration::target_problem::TargetView;
use fpga_model::input::Picture;
use rig::Rig;
use std::collections::BTreeMap;

/// Fewest pictures of a camera that show the board.
pub const FEWEST: usize = 8;
/// Least share of the picture that the board fills, by the median picture.
pub const LEAST_FILL: f64 = 0.04;
/// Of nine parts of a picture the board was seen in at least so many, over all pictures.
pub const FEWEST_PARTS: usize = 7;
/// Smallest picture that is looked at.
const SMALLEST: usize = 16;

/// What one camera saw.
#[derive(Debug, Clone, PartialEq)]
pub struct Seen {
    /// Its id in the rig, and its place in the file.
    pub id: u32,
    /// The index of the camera in the rig's file.
    pub index: usize,
    /// Size of its pictures, px.
    pub size_px: [u32; 2],
    /// Pictures that were looked at.
    pub pictures: usize,
    /// Pictures in which a part of a board was seen, but not all of it.
    pub parts_only: usize,
    /// The board, where it was found.
    pub sheets: Vec<TargetView>,
}

/// What all of them saw.
pub struct Boards {
    /// By camera, those that have pictures.
    pub cameras: Vec<Seen>,
}

fn grey(picture: &Picture) -> GreyImage {
    GreyImage::new(picture.width, picture.height, picture.luma.iter().map(|v| f32::from(*v)).collect())
}

/// Looks for the board in all pictures.
///
/// # Errors
/// Pictures that cannot be read, or are of another size than the rig says.
pub fn look(rig: &Rig, args: &PicturesArgs, board: &Target) -> Result<Boards> {
    let ids: Vec<u32> = rig.cameras.iter().map(|c| c.id).collect();
    let feeds = args.feeds(&ids)?;
    let mut views: BTreeMap<String, usize> = BTreeMap::new();
    let mut cameras: Vec<Seen> = Vec::new();
    for (index, camera) in rig.cameras.iter().enumerate() {
        if feeds.iter().any(|f| f.camera == camera.id) {
            let size_px = [camera.width, camera.height];
            cameras.push(Seen {
                id: camera.id,
                index,
                size_px,
                pictures: 0,
                parts_only: 0,
                sheets: Vec::new(),
            });
        }
    }
    args.each(rig, &feeds, &mut |camera, view, file, picture| {
        let Some(seen) = cameras.iter_mut().find(|c| c.id == camera) else { return Ok(()) };
        of_size(file, camera, seen.size_px, [picture.width, picture.height])?;
        seen.pictures += 1;
        let next = views.len();
        let view = *views.entry(view.to_owned()).or_insert(next);
        let found = if picture.width.min(picture.height) < SMALLEST {
            Err(BoardError::Nothing("board"))
        } else {
            board.find(&grey(picture))
        };
        match found {
            Ok(samples) => {
                let name = format!("camera {camera}, {file}");
                seen.sheets.push(TargetView { name, camera: seen.index, view, samples });
            }
            Err(BoardError::Incomplete { .. } | BoardError::Few { .. } | BoardError::Unnamed { .. }) => {
                seen.parts_only += 1;
            }
            Err(BoardError::Nothing(_)) => {}
        }
        Ok(())
    })?;
    Ok(Boards { cameras })
}

impl Seen {
    /// What is wrong with how the board was shown to this camera, for a lens if `for_lens`.
    pub fn advice(&self, for_lens: bool) -> Vec<String> {
        let (id, found, all) = (self.id, self.sheets.len(), self.pictures);
        if all < FEWEST {
            return vec![format!("camera {id}: {all} pictures, at least {FEWEST} are needed: take 20")];
        }
        if found < FEWEST {
            let what = if 2 * self.parts_only > all - found {
                "keep all of it in the picture, and check --board or --charuco"
            } else {
                "move it nearer, light it evenly, and check --board or --charuco"
            };
            return vec![format!(
                "camera {id} saw the board in {found} of {all} pictures, at least {FEWEST} are needed: {what}"
            )];
        }
        let mut said = Vec::new();
        let fill = self.fill();
        if fill < LEAST_FILL {
            said.push(format!(
                "camera {id}: the board fills {:.1} % of the picture, at least {:.0} % are needed: bring it \
                 nearer, or use a larger one",
                100.0 * fill,
                100.0 * LEAST_FILL
            ));
        }
        let bare = self.bare_parts();
        if for_lens && bare.len() > 9 - FEWEST_PARTS {
            said.push(format!(
                "camera {id} never saw the board at the {} of its picture: hold it there, too",
                bare.join(", ")
            ));
        }
        said
    }

    /// Share of the picture that the board fills: the median of all pictures.
    pub fn fill(&self) -> f64 {
        let area = |sheet: &TargetView| {
            let of = |axis: usize| {
                let values = sheet.samples.iter().map(|s| s.pixel[axis]);
                let (low, high) = values.fold((f64::MAX, f64::MIN), |(l, h), v| (l.min(v), h.max(v)));
                high - low
            };
            of(0) * of(1) / self.size_px.map(f64::from).iter().product::<f64>()
        };
        let mut areas: Vec<f64> = self.sheets.iter().map(area).collect();
        areas.sort_by(f64::total_cmp);
        areas.get(areas.len() / 2).copied().unwrap_or(0.0)
    }

    /// Ninths of the picture in which no point of the board ever was.
    pub fn bare_parts(&self) -> Vec<&'static str> {
        const NAMES: [&str; 9] = [
            "top left",
            "top",
            "top right",
            "left",
            "middle",
            "right",
            "bottom left",
            "bottom",
            "bottom right",
        ];
        let mut seen = [false; 9];
        for sample in self.sheets.iter().flat_map(|s| &s.samples) {
            let third = |axis: usize| {
                (sample.pixel[axis] * 3.0 / f64::from(self.size_px[axis])).clamp(0.0, 2.9) as usize
            };
            seen[3 * third(1) + third(0)] = true;
        }
        NAMES.into_iter().zip(seen).filter(|(_, seen)| !seen).map(|(name, _)| name).collect()
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use calibration::target_problem::Correspondence;
    use nalgebra::{Point3, Vector2};

    /// A square of points about a place, `side` px wide.
    fn sheet(at: [f64; 2], side: f64, view: usize) -> TargetView {
        let corner = |(x, y): (f64, f64)| Correspondence {
            pixel: Vector2::new(at[0] + x * side, at[1] + y * side),
            point: Point3::new(x, y, 0.0),
        };
        let samples = [(0.0, 0.0), (1.0, 0.0), (0.0, 1.0), (1.0, 1.0)].map(corner).to_vec();
        TargetView { name: String::new(), camera: 0, view, samples }
    }

    fn seen(sheets: Vec<TargetView>, pictures: usize, parts_only: usize) -> Seen {
        Seen { id: 2, index: 2, size_px: [720, 576], pictures, parts_only, sheets }
    }

    #[test]
    fn what_is_wrong_is_said_with_what_helps() {
        let middle = |n: usize| (0..n).map(|v| sheet([260.0, 190.0], 190.0, v)).collect::<Vec<_>>();
        let say = |seen: Seen| seen.advice(true).join("; ");
        assert_eq!(
            say(seen(middle(3), 40, 2)),
            "camera 2 saw the board in 3 of 40 pictures, at least 8 are needed: move it nearer, light it evenly, and \
             check --board or --charuco"
        );
        assert!(
            say(seen(middle(3), 40, 30))
                .contains("keep all of it in the picture, and check --board or --charuco")
        );
        assert!(say(seen(middle(5), 5, 0)).contains("5 pictures, at least 8 are needed: take 20"));
        let small = (0..9).map(|v| sheet([80.0 * v as f64, 60.0 * v as f64], 30.0, v)).collect();
        assert!(say(seen(small, 9, 0)).contains("the board fills 0.2 % of the picture"), "too small");
        let left = (0..9).map(|v| sheet([10.0, 40.0 * v as f64], 260.0, v)).collect();
        let told = say(seen(left, 9, 0));
        assert_eq!(
            told,
            "camera 2 never saw the board at the top right, right, bottom right of its picture: hold it there, too"
        );
        let one_sided = (0..9).map(|v| sheet([10.0, 40.0 * v as f64], 200.0, v)).collect();
        assert!(seen(one_sided, 9, 0).advice(false).is_empty(), "places need no full picture");
        let all = [10.0, 260.0, 500.0].iter().flat_map(|x| [10.0, 190.0, 370.0].map(|y| [*x, y]));
        let all = all.enumerate().map(|(v, at)| sheet(at, 190.0, v)).collect();
        assert_eq!(say(seen(all, 9, 0)), "");
    }

    #[test]
    fn halves_are_of_views() {
        let sheets: Vec<TargetView> = [4, 4, 7, 9].map(|v| sheet([0.0; 2], 1.0, v)).to_vec();
        let views = |odd| half(&sheets, odd).iter().map(|s| s.view).collect::<Vec<_>>();
        assert_eq!((views(false), views(true)), (vec![4, 4, 9], vec![7]));
    }
}
