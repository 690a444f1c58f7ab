//! What `calibrate waved` does with a judged stream: it refines what the judge found to be elsewhere, and keeps what
//! held-out instants speak for.
//!
//! The gauge follows from the judgement: what was moved is free, and all else holds the frames of the bodies and of
//! the world. Without that, a marker that was moved would drag the frame of its body along, and residuals would
//! not show it.

use crate::CalibrationError;
use crate::bundle::{Freedom, Part, PriorSigmas};
use crate::causes::together::{WIDE, estimate};
use crate::causes::{Cause, Judgement, Verdict, measure};
use crate::frames::undetermined;
use crate::self_calibration::{SelfCalibration, refine_stream_free};
use protocol::blobs::BlobField;
use protocol::poses::BODY_NAMES;
use rig::Rig;

/// Time after the begin of a defect, by which its instant is not known, ns, and least length of what follows, ns.
const AFTER_NS: (u64, u64) = (500_000_000, 2_000_000_000);
/// A refined rig must leave less than this share of what the rig as it was leaves of held-out instants. Nearly the same is
/// no reason to change a rig.
const BETTER: f64 = 0.98;
/// Where the cause is not known, a refined rig must leave less than this share of what the rig as it was leaves of
/// held-out instants: freedom alone takes away a little of what no place of a camera explains, a parity for one.
const OF_UNKNOWN: f64 = 0.75;

/// Result of a refinement.
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
pub(crate) fn parts(rig: &Rig, cause: &Cause) -> Option<Vec<Part>> {
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
    let of = |elsewhere: Vec<Part>| Freedom {
        known: *known,
        unnamed: elsewhere.is_empty(),
        elsewhere,
        wide: WIDE,
        ..Freedom::default()
    };
    if judgement.verdict != Verdict::Explained {
        return Ok(of(Vec::new()));
    }
    let causes = || judgement.explanations.iter().map(|e| &e.cause);
    if let Some(Cause::Lens { camera, .. }) = causes().find(|cause| matches!(cause, Cause::Lens { .. })) {
        return Err(format!(
            "the lens of camera {camera} is wrong, and refined camera poses would only hide it"
        ));
    }
    if causes().any(|cause| parts(rig, cause).is_none()) {
        return Err("waving the instruments cannot correct this cause".into());
    }
    if causes().filter(|cause| matches!(cause, Cause::MarkerMoved { .. })).count() > 1 {
        return Err(
            "the stream does not determine which marker moved, and a wrong choice would displace the tip"
                .into(),
        );
    }
    Ok(of(causes().next().and_then(|cause| parts(rig, cause)).unwrap_or_default()))
}

/// True where no certain part of the rig is named: then everything is free, and takes up a wrong lens as well.
fn is_not_pinned(judgement: &Judgement) -> bool {
    let several = judgement.explanations.iter().any(|e| e.cause == Cause::Drifted);
    judgement.verdict == Verdict::Unknown || several
}

/// True where nothing but noise speaks against a rig.
fn leaves_noise(rig: &Rig, fields: &[BlobField]) -> bool {
    estimate(rig, fields).is_ok_and(|found| found.above.is_noise())
}

fn begin_and_end(fields: &[BlobField]) -> [u64; 2] {
    let instants = || fields.iter().map(|f| f.exposed_ns);
    [instants().min().unwrap_or(0), instants().max().unwrap_or(0)]
}

/// The fields since a defect began, or why they do not suffice.
fn affected(fields: &[BlobField], judgement: &Judgement) -> Result<Vec<BlobField>, String> {
    if judgement.since_s <= 0.0 {
        return Ok(fields.to_vec());
    }
    let [first, last] = begin_and_end(fields);
    let from = first + (judgement.since_s * 1e9) as u64 + AFTER_NS.0;
    if last.saturating_sub(from) < AFTER_NS.1 {
        return Err(format!(
            "the rig changed {:.1} s after the beginning of the stream, {:.1} s before its end: record at least \
             {:.1} s after the change",
            judgement.since_s,
            (last - first) as f64 * 1e-9 - judgement.since_s,
            (AFTER_NS.0 + AFTER_NS.1) as f64 * 1e-9
        ));
    }
    Ok(fields.iter().filter(|f| f.exposed_ns >= from).copied().collect())
}

/// Why a refined rig is not kept; `held_out_px` as in [`Mended::Better`], `rest` the fields that it was not refined by.
fn why_not(judgement: &Judgement, held_out_px: [f64; 2], learnt: &Rig, rest: &[BlobField]) -> Option<String> {
    let [before, after] = held_out_px;
    let (share, must) = match judgement.verdict {
        Verdict::Unknown => (OF_UNKNOWN, "with an unknown cause, it must be"),
        _ => (BETTER, "it must be"),
    };
    if after >= share * before {
        return Some(format!(
            "the refined rig does not predict held-out instants better: residual {after:.4} px, previous rig {before:.4} px; \
             {must} at most {:.4} px",
            share * before
        ));
    }
    (is_not_pinned(judgement) && !leaves_noise(learnt, rest)).then(|| {
        "the refined rig's residuals are above the noise, so the fault is not in the positions of cameras and markers, \
         and refined ones would only hide it"
            .into()
    })
}

/// Refines a rig by a stream that was judged, or by what of it follows a change.
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
    // What was before a camera or a marker moved speaks against what is true since.
    let fields = &match affected(fields, judgement) {
        Ok(fields) => fields,
        Err(why) => return Ok(Mended::Nothing(why)),
    };
    let [first, last] = begin_and_end(fields);
    let half = first + (last - first) / 2;
    let (learnt_by, rest): (Vec<BlobField>, Vec<BlobField>) =
        fields.iter().partition(|f| f.exposed_ns < half);
    let learnt = refine_stream_free(rig, &learnt_by, &free, most, progress)?.bundle.rig(rig);
    let held_out_px = [rig, &learnt].map(|rig| measure(rig, &rest).mean().sqrt());
    if let Some(why) = why_not(judgement, held_out_px, &learnt, &rest) {
        return Ok(Mended::Nothing(why));
    }
    let found = Box::new(refine_stream_free(rig, fields, &free, most, progress)?);
    // Where the moved parts are named, all others hold the frames.
    let which = if free.unnamed { undetermined(rig, &found.bundle, known.marker_mm) } else { None };
    Ok(which.map_or(Mended::Better { found, held_out_px }, Mended::Nothing))
}
