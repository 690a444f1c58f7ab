//! What `calibrate waved` does with a judged stream: it refines what the judge found to be elsewhere, and keeps what
//! held-out instants speak for.
//!
//! The gauge follows from the judgement: what was moved is free, and all else holds the frames of the bodies and of
//! the world. Without that, a marker that was moved would drag the frame of its body along, and residuals would
//! not show it.

use crate::CalibrationError;
use crate::bundle::{Freedom, Part, PriorSigmas};
use crate::causes::together::WIDE;
use crate::causes::{Cause, Judgement, Verdict, measure};
use crate::self_calibration::{SelfCalibration, refine_stream_free};
use protocol::blobs::BlobField;
use protocol::poses::BODY_NAMES;
use rig::Rig;

/// Where the cause is not known, a refined rig must leave less than this share of what the rig as it was leaves of
/// held-out instants: freedom alone takes away a little of what no place of a camera explains, a parity for one.
const OF_UNKNOWN: f64 = 0.75;

/// What came of it.
pub enum Mended {
    /// A rig that predicts held-out instants better.
    Better {
        /// The rig.
        found: Box<SelfCalibration>,
        /// What the rig as it was, and one that is refined by the first half, leave of the second half, px.
        held_out_px: [f64; 2],
    },
    /// Nothing, and why.
    Nothing(String),
}

/// What a cause has moved; `None` where waved instruments cannot mend it.
fn parts(rig: &Rig, cause: &Cause) -> Option<Vec<Part>> {
    let camera = |id: u32| rig.cameras.iter().position(|c| c.id == id).map(Part::Camera);
    match cause {
        Cause::CameraMoved { camera: id, .. } => Some(vec![camera(*id)?]),
        Cause::CamerasMoved { cameras } => cameras.iter().map(|id| camera(*id)).collect(),
        Cause::MarkerMoved { body, marker, .. } => {
            let body = BODY_NAMES.iter().position(|name| name == body)?;
            Some(vec![Part::Marker(body, *marker)])
        }
        Cause::Drifted => Some(Vec::new()),
        _ => None,
    }
}

/// What may be refined, or why nothing may.
fn freedom(rig: &Rig, known: &PriorSigmas, judgement: &Judgement) -> Result<Freedom, String> {
    let of = |elsewhere| Freedom { known: *known, elsewhere, wide: WIDE, ..Freedom::default() };
    if judgement.verdict != Verdict::Explained {
        return Ok(of(Vec::new()));
    }
    let causes = || judgement.explanations.iter().map(|e| &e.cause);
    if causes().any(|cause| parts(rig, cause).is_none()) {
        return Err("waved instruments cannot correct that".into());
    }
    if causes().filter(|cause| matches!(cause, Cause::MarkerMoved { .. })).count() > 1 {
        return Err("the stream does not say which marker was moved, and tips depend on it".into());
    }
    Ok(of(causes().next().and_then(|cause| parts(rig, cause)).unwrap_or_default()))
}

/// Refines a rig by a stream that was judged.
///
/// # Errors
/// Too few usable instants in either half, or a problem without a solution.
pub fn mend(
    rig: &Rig,
    fields: &[BlobField],
    known: &PriorSigmas,
    judgement: &Judgement,
    most: usize,
    progress: &mut dyn FnMut(usize, f64),
) -> Result<Mended, CalibrationError> {
    let free = match freedom(rig, known, judgement) {
        Ok(free) => free,
        Err(why) => return Ok(Mended::Nothing(why)),
    };
    let instants = || fields.iter().map(|f| f.exposed_ns);
    let [first, last] = [instants().min().unwrap_or(0), instants().max().unwrap_or(0)];
    let half = first + (last - first) / 2;
    let (learnt_by, rest): (Vec<BlobField>, Vec<BlobField>) =
        fields.iter().partition(|f| f.exposed_ns < half);
    let learnt = refine_stream_free(rig, &learnt_by, &free, most, progress)?.bundle.rig(rig);
    let held_out_px = [rig, &learnt].map(|rig| measure(rig, &rest).mean().sqrt());
    let share = if judgement.verdict == Verdict::Unknown { OF_UNKNOWN } else { 1.0 };
    if held_out_px[1] >= share * held_out_px[0] {
        let [before, after] = held_out_px;
        return Ok(Mended::Nothing(format!(
            "the refined rig predicts held-out instants no better: residuals {after:.3} px, with the previous rig \
             {before:.3} px"
        )));
    }
    let found = Box::new(refine_stream_free(rig, fields, &free, most, progress)?);
    Ok(Mended::Better { found, held_out_px })
}
