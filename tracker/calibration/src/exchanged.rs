//! Whether the lists or pictures of cameras were given in another order than the cameras of a rig.

use crate::halves::rms_with;
use crate::target_problem::TargetView;
use rig::camera::Camera;

/// The rig fits in another order if its residual is below this share of that as given, and of the picture's width.
const FITS: [f64; 2] = [0.2, 0.01];
/// Most cameras of which all orders are tried; of more, two are exchanged.
const ALL_ORDERS: usize = 4;

/// Says which cameras are exchanged; `None` if the rig fits as well in the order given.
pub fn exchange(rig: &[Camera], sheets: &[TargetView]) -> Option<String> {
    let as_given = rms_with(rig, sheets);
    let fits = |order: &Vec<usize>| {
        let same_size = order.iter().enumerate().all(|(c, &of)| rig[c].size_px == rig[of].size_px);
        let of = |s: &TargetView| TargetView { camera: order[s.camera], ..s.clone() };
        same_size.then(|| rms_with(rig, &sheets.iter().map(of).collect::<Vec<_>>()))
    };
    let tried = orders(rig.len()).into_iter().filter_map(|order| Some((fits(&order)?, order)));
    let (px, order) = tried.min_by(|a, b| a.0.total_cmp(&b.0))?;
    let width = f64::from(rig[0].size_px[0]);
    if !(px < FITS[0] * as_given && px < FITS[1] * width) {
        return None;
    }
    let named = |(c, &of): (usize, &usize)| {
        let name = sheets.iter().find(|s| s.camera == c).map_or("", |s| s.name.as_str());
        (c != of).then(|| format!("expected camera {c} of the rig in place {c} ({name}), found camera {of}"))
    };
    let named: Vec<String> = order.iter().enumerate().filter_map(named).collect();
    Some(format!(
        "lists or pictures are exchanged between cameras: {}. With them exchanged the rig as given leaves {px:.2} px, as they \
         are {as_given:.1} px",
        named.join(", ")
    ))
}

/// Orders of cameras other than the given one: in place `c` there is camera `order[c]`.
fn orders(cameras: usize) -> Vec<Vec<usize>> {
    let given: Vec<usize> = (0..cameras).collect();
    let mut all = vec![given.clone()];
    // Every exchange of two of every order so far; from four cameras on, those of the given order only.
    let rounds = if cameras <= ALL_ORDERS { cameras } else { 1 };
    for _ in 1..=rounds {
        for order in all.clone() {
            for (a, b) in (0..cameras).flat_map(|a| (a + 1..cameras).map(move |b| (a, b))) {
                let mut other = order.clone();
                other.swap(a, b);
                if !all.contains(&other) {
                    all.push(other);
                }
            }
        }
    }
    all.retain(|order| *order != given);
    all
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn all_orders_of_few_cameras_are_tried() {
        assert_eq!((orders(1).len(), orders(2).len(), orders(3).len(), orders(4).len()), (0, 1, 5, 23));
        assert_eq!(orders(5).len(), 10);
    }
}
