//! What undoes a cause without a parameter, or with one: changes of the blobs or of the rig.

use super::Cause;
use protocol::blobs::{BlobField, Colour, WHOLE_FRAME};
use rig::Rig;
use std::collections::BTreeSet;

/// The causes without a parameter that a rig and its blobs allow.
pub fn discrete(rig: &Rig, fields: &[BlobField]) -> Vec<Cause> {
    let ids: Vec<u32> = rig.cameras.iter().map(|c| c.id).collect();
    let colours: BTreeSet<Colour> =
        rig.bodies.iter().flat_map(|b| b.markers.iter().map(|m| m.colour)).collect();
    let seen: BTreeSet<u32> = fields.iter().flat_map(|f| f.blobs().iter().map(|b| b.colour)).collect();
    // A colour that the rig has not may stand for one of its own.
    let others = Colour::ALL.into_iter().filter(|c| seen.contains(&(*c as u32)));
    let colours: Vec<Colour> =
        colours.into_iter().chain(others).collect::<BTreeSet<_>>().into_iter().collect();
    let mut causes = Vec::new();
    causes.extend(pairs(&ids).map(|cameras| Cause::CamerasSwapped { cameras }));
    causes.extend(pairs(&colours).map(|colours| Cause::ColoursSwapped { colours, cameras: Vec::new() }));
    let each = || ids.iter().map(|id| Some(*id)).chain([None]);
    causes.extend(each().map(|camera| Cause::ParitySwapped { camera }));
    causes
}

/// Every two of some.
fn pairs<T: Copy>(of: &[T]) -> impl Iterator<Item = [T; 2]> + '_ {
    of.iter().enumerate().flat_map(move |(i, a)| of[i + 1..].iter().map(move |b| [*a, *b]))
}

/// The blobs as they would be without the cause, in the order of arrival.
pub fn undone(cause: &Cause, fields: &[BlobField]) -> Vec<BlobField> {
    let mut fields = fields.to_vec();
    fields.iter_mut().for_each(|field| undo(cause, field));
    fields
}

fn undo(cause: &Cause, field: &mut BlobField) {
    let is_it = |camera: &Option<u32>, of: u32| camera.is_none_or(|id| id == of);
    match cause {
        Cause::CamerasSwapped { cameras } => field.camera = exchanged(*cameras, field.camera),
        Cause::ColoursSwapped { colours, .. } => {
            let count = field.blobs().len();
            for blob in &mut field.blobs[..count] {
                blob.colour = exchanged(colours.map(|c| c as u32), blob.colour);
            }
        }
        Cause::ParitySwapped { camera } if is_it(camera, field.camera) => {
            field.parity ^= u32::from(field.parity < WHOLE_FRAME);
        }
        Cause::ClockShifted { camera, by_ms } if *camera == field.camera => {
            let shift = (by_ms * 1e6) as i64;
            field.exposed_ns = field.exposed_ns.saturating_add_signed(-shift).max(1);
        }
        _ => {}
    }
}

fn exchanged([a, b]: [u32; 2], value: u32) -> u32 {
    match value {
        v if v == a => b,
        v if v == b => a,
        v => v,
    }
}

/// The rig with the places of cameras as near as the cause says that they are.
pub fn rescaled(rig: &Rig, factor: f64) -> Rig {
    let mut rig = rig.clone();
    rig.cameras.iter_mut().flat_map(|c| &mut c.t).for_each(|t| *t /= factor);
    rig
}

#[cfg(test)]
mod tests {
    use super::*;
    use bytemuck::Zeroable;
    use protocol::blobs::Blob;

    #[test]
    fn what_is_done_twice_is_undone() {
        let rig = Rig::load_or_shipped(None).unwrap();
        let mut fields = Vec::new();
        for n in 0..12u32 {
            let mut field =
                BlobField { camera: n % 3, parity: n / 3 % 2, exposed_ns: 1 << 30, ..Zeroable::zeroed() };
            Colour::ALL.iter().for_each(|c| field.push(Blob { colour: *c as u32, ..Zeroable::zeroed() }));
            fields.push(field);
        }
        let bytes = |fields: &[BlobField]| bytemuck::cast_slice::<_, u8>(fields).to_vec();
        let causes = discrete(&rig, &fields);
        assert_eq!(causes.len(), 3 + 21 + 4);
        for cause in &causes {
            let once = undone(cause, &fields);
            assert_ne!(bytes(&once), bytes(&fields), "{cause}");
            assert_eq!(bytes(&undone(cause, &once)), bytes(&fields), "{cause}");
        }
        let late = Cause::ClockShifted { camera: 1, by_ms: 3.0 };
        let moved = undone(&late, &fields);
        let shifts = moved.iter().zip(&fields).filter(|(m, f)| m.exposed_ns + 3_000_000 == f.exposed_ns);
        assert_eq!(shifts.count(), 4);
    }
}
