//! Step `trocars`: where the shafts pass through the eye's wall, and where the eye turns about.

use crate::folder::{Folder, Outcome, Record};
use crate::live::LiveArgs;
use crate::poses::{Fit, add_figures, instants};
use crate::stream::{Origin, Stream};
use crate::{Refused, refuse};
use anyhow::{Context, Result};
use calibration::cli::{Centre, pivoted, shafts, turned};
use calibration::pivot::{Shaft, of_shafts};
use nalgebra::Vector3;
use protocol::limits::INSTRUMENTS;
use protocol::poses::BODY_NAMES;
use rig::{Rig, Trocar};
use std::path::PathBuf;

/// The world's origin is moved to the eye's centre where it is farther away, mm, and so many standard deviations.
const RECENTRE: (f64, f64) = (0.05, 3.0);
/// Largest play of a shaft in its trocar, mm.
pub const LARGEST_PLAY_MM: f64 = 0.5;
/// A trocar's place should be known so well, mm.
const SHOULD_MM: f64 = 0.1;

/// Arguments of the step.
#[derive(Debug, Clone, clap::Args)]
pub struct TrocarsArgs {
    /// Stream (.mcap, .jsonl) in which the instruments tilt in their trocars and the eye turns.
    #[arg(long, value_name = "STREAM", required_unless_present = "cameras")]
    pub from: Option<PathBuf>,
    /// Or live cameras.
    #[command(flatten)]
    pub live: LiveArgs,
}

/// Runs the step.
///
/// # Errors
/// A stream that cannot be read, or in which nothing turns about its pivot.
pub fn run(folder: &Folder, rig: &Rig, args: &TrocarsArgs) -> Result<Outcome> {
    let origin = Origin::of(args.from.as_deref(), &args.live).context("expected --from or --cameras")?;
    let (stream, seen) = instants(folder, rig, origin)?;
    let (poses, centre) = turned(rig, &seen)?;
    let of_body: Vec<Vec<Shaft>> = (0..INSTRUMENTS).map(|body| shafts(&poses, body)).collect();
    let still = hardly_tilted(&of_body);
    // One instrument may be done without the other.
    if still.len() == INSTRUMENTS {
        return Err(Refused(still).into());
    }
    refuse(loose(&of_body))?;
    let far = centre.as_ref().is_ok_and(|(found, _)| {
        let off = found.point.coords.norm();
        off > RECENTRE.0 && off > RECENTRE.1 * found.sigma_mm.norm()
    });
    let mut outcome = Outcome::default();
    let record = &mut outcome.record;
    record.from = origin.names();
    record.advice.extend(still);
    record.advice.extend(stream.advice());
    note_centre(&centre, record);
    let mut new = rig.clone();
    add_figures(&pivoted(&mut new, &poses, Some(centre), false)?, record);
    record.kept = keep_what_is_better(rig, &mut new, &of_body, record) && !far;
    if far {
        // Computed anew: the centre found above was consumed with the trocars.
        let centre = turned(rig, &seen)?.1;
        let mut moved = new.clone();
        pivoted(&mut moved, &poses, Some(centre), true)?;
        new = recentred(rig, new, moved, &stream, record);
    }
    record.advice.extend(uncertain(&of_body));
    record.summary = format!("trocars moved: {}", moves(rig, &new).join(", "));
    outcome.rig = Some(Rig::parse(&new.to_json(), "of the trocars")?);
    Ok(outcome)
}

/// Advice for instruments whose shafts were tilted too little to meet in a point.
fn hardly_tilted(of_body: &[Vec<Shaft>]) -> Vec<String> {
    let problems = of_body.iter().zip(BODY_NAMES).filter_map(|(s, name)| Some((of_shafts(s).err()?, name)));
    problems
        .map(|(problem, name)| {
            format!(
                "{name}: {problem}: tilt it in its trocar, far to all sides, while eye and markers are seen"
            )
        })
        .collect()
}

/// Notes how far the eye's centre is from the world's origin, or why it was not found.
fn note_centre(centre: &Centre, record: &mut Record) {
    match centre {
        Ok((found, _)) => record.figure(
            "distance of the eye's centre of rotation from the world's origin",
            format!("{:.3} ± {:.3} mm", found.point.coords.norm(), found.sigma_mm.norm()),
        ),
        Err(problem) => {
            record.advice.push(format!("the eye's centre: {problem}: turn the eye about two axes"))
        }
    }
}

/// The rig `moved`, whose origin is the eye's centre, with the trocars of `new`; or `new`, if the blobs fit that better.
fn recentred(rig: &Rig, new: Rig, mut moved: Rig, stream: &Stream, record: &mut Record) -> Rig {
    // Trocars are in the eye's frame, and move with its origin; so do those that were put back.
    restore(&new, &mut moved, rig);
    let [fit, before] = [&moved, &new].map(|rig| Fit::of(rig, &stream.fields));
    record.figure("residual of all blobs with the origin moved there", format!("{fit}; before {before}"));
    if fit.left_px > before.left_px {
        record.notes.push("the world's origin is kept: with it moved, the blobs fit worse".into());
        return new;
    }
    record.notes.push("the world's origin was moved to the eye's centre of rotation".into());
    moved
}

/// Advice for trocars that are not known well enough.
fn uncertain(of_body: &[Vec<Shaft>]) -> Vec<String> {
    let known = of_body.iter().zip(BODY_NAMES).filter_map(|(s, name)| Some((of_shafts(s).ok()?, name)));
    known
        .map(|(found, name)| (found.sigma_mm.norm(), name))
        .filter(|(mm, _)| *mm > SHOULD_MM)
        .map(|(mm, name)| {
            format!("{name}: the uncertainty of its trocar is {mm:.2} mm: tilt it farther, for a minute")
        })
        .collect()
}

/// How far each trocar was moved.
fn moves(rig: &Rig, new: &Rig) -> Vec<String> {
    let mm = |(a, b): (&Trocar, &Trocar)| (Vector3::from(a.p_eye) - Vector3::from(b.p_eye)).norm();
    let pairs = rig.trocars.iter().zip(&new.trocars);
    pairs.map(|pair| format!("{} by {:.3} mm", pair.0.body, mm(pair))).collect()
}

/// Shafts that do not go through one place.
fn loose(of_body: &[Vec<Shaft>]) -> Vec<String> {
    let all =
        of_body.iter().zip(BODY_NAMES).filter_map(|(shafts, name)| Some((of_shafts(shafts).ok()?, name)));
    all.filter(|(found, _)| found.play_mm > LARGEST_PLAY_MM)
        .map(|(found, name)| {
            format!(
                "{name}: its shaft passes its trocar with a play of {:.2} mm, the maximum is {LARGEST_PLAY_MM} mm: was it \
                 in the trocar all the time? Do poses again where residuals are large",
                found.play_mm
            )
        })
        .collect()
}

/// Root mean square distance of shafts from a place, mm.
fn miss_mm(shafts: &[Shaft], place: [f64; 3]) -> f64 {
    let squares: f64 = shafts.iter().map(|s| s.miss(&Vector3::from(place)).norm_squared()).sum();
    (squares / shafts.len().max(1) as f64).sqrt()
}

/// Every second eighth of some shafts, and the others.
fn halves(shafts: &[Shaft]) -> [Vec<Shaft>; 2] {
    let mut halves = [Vec::new(), Vec::new()];
    for (i, shaft) in shafts.iter().enumerate() {
        halves[8 * i / shafts.len() % 2].push(*shaft);
    }
    halves
}

/// Puts back each trocar that fits one half of its shafts better than what is found from the other; true where all
/// are.
fn keep_what_is_better(rig: &Rig, new: &mut Rig, of_body: &[Vec<Shaft>], record: &mut Record) -> bool {
    let mut kept = 0;
    for old in &rig.trocars {
        let Some(body) = BODY_NAMES.iter().position(|n| *n == old.body).filter(|b| *b < of_body.len()) else {
            continue;
        };
        let [first, rest] = halves(&of_body[body]);
        let Some(now) = new.trocars.iter_mut().find(|t| t.body == old.body) else { continue };
        if now.p_eye == old.p_eye {
            continue;
        }
        // Where a half was tilted too little, all of them found it.
        let found = of_shafts(&first).map_or(now.p_eye, |found| found.point.coords.into());
        let [found, before] = [found, old.p_eye].map(|place| miss_mm(&rest, place));
        record.figure(
            format!("{}: distance of the other half's shafts from the trocar", old.body),
            format!("{found:.4} mm; from the previous trocar {before:.4} mm"),
        );
        if before < found {
            *now = old.clone();
            kept += 1;
            record.notes.push(format!("{}: the previous trocar fits as well and is kept", old.body));
        }
    }
    kept > 0 && new.trocars == rig.trocars
}

/// Of a rig that was moved to the eye's centre, the trocars of `chosen`, moved along.
fn restore(chosen: &Rig, whole: &mut Rig, before: &Rig) {
    let eye = BODY_NAMES[protocol::poses::EYE];
    let first = |rig: &Rig| rig.body(eye).and_then(|b| b.markers.first()).map(|m| Vector3::from(m.p));
    let Some((old, new)) = first(before).zip(first(whole)) else { return };
    for trocar in &mut whole.trocars {
        if let Some(own) = chosen.trocars.iter().find(|t| t.body == trocar.body) {
            trocar.sigma = own.sigma;
            trocar.p_eye = (Vector3::from(own.p_eye) + new - old).into();
        }
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use nalgebra::Point3;

    fn shaft(through: [f64; 3], i: usize) -> Shaft {
        let t = i as f64;
        let direction = Vector3::new(0.3 * (1.3 * t).sin(), 0.3 * (2.1 * t).cos(), 1.0).normalize();
        Shaft { origin: Point3::from(through) - 9.0 * direction, direction }
    }

    /// The trocar that the shafts pass stays, whatever was found instead; one that they miss gives way.
    #[test]
    fn the_better_trocar_stays() {
        let mut rig = Rig::load_or_shipped(None).unwrap();
        let of_body: Vec<Vec<Shaft>> = (0..INSTRUMENTS)
            .map(|body| (0..80).map(|i| shaft(rig.trocar(BODY_NAMES[body]).unwrap().p_eye, i)).collect())
            .collect();
        let truth = rig.clone();
        let mut worse = rig.clone();
        worse.trocars[0].p_eye[1] += 0.2;
        let mut record = Record::default();
        // What was found from noise lies beside; the shafts of each half meet in the true place, too, and win by nothing.
        rig.trocars[0].p_eye[0] += 0.1;
        let mut new = truth.clone();
        assert!(!keep_what_is_better(&rig, &mut new, &of_body, &mut record));
        assert_eq!(new, truth, "the old one is missed by 0.1 mm");
        let mut flat = of_body.clone();
        flat[0] = (0..80).map(|_| shaft(truth.trocars[0].p_eye, 1)).collect();
        assert!(keep_what_is_better(&truth, &mut worse, &flat, &mut record));
        assert_eq!(worse, truth);
        assert!(record.notes[0].contains("is kept"), "{:?}", record.notes);
    }

    #[test]
    fn shafts_that_pass_nowhere_in_particular_are_told() {
        let loose_shafts: Vec<Shaft> =
            (0..80).map(|i| shaft([3.0 * (0.7 * i as f64).sin(), 2.0, 8.0], i)).collect();
        let tight: Vec<Shaft> = (0..80).map(|i| shaft([5.0, 2.0, 8.0], i)).collect();
        let told = loose(&[tight, loose_shafts]);
        assert!(
            told.len() == 1 && told[0].starts_with("inst1: its shaft passes its trocar with a play"),
            "{told:?}"
        );
    }
}
