//! What undoes a cause without a parameter, or with one: changes of the blobs or of the rig.

use super::Cause;
use protocol::blobs::{BlobField, Colour, WHOLE_FRAME, field_line, frame_line};
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
    causes.extend(sizes(rig, fields));
    causes
}

/// Usual sizes of pictures, px.
const SIZES: [[u32; 2]; 14] = [
    [320, 240],
    [360, 288],
    [640, 480],
    [640, 512],
    [720, 480],
    [720, 576],
    [768, 576],
    [800, 600],
    [1024, 768],
    [1280, 720],
    [1280, 960],
    [1280, 1024],
    [1920, 1080],
    [1920, 1200],
];

/// Pictures of all cameras, or of one, of another size that holds all blobs.
fn sizes(rig: &Rig, fields: &[BlobField]) -> Vec<Cause> {
    let reach = |id: Option<u32>| {
        let own = fields.iter().filter(|f| id.is_none_or(|id| f.camera == id));
        let places = own.flat_map(|f| f.blobs().iter().map(|b| [b.x_px, f.y_frame_px(b)]));
        places.fold([0.0, 0.0], |[w, h]: [f64; 2], [x, y]| [w.max(x), h.max(y)])
    };
    let mut causes = Vec::new();
    for camera in rig.cameras.iter().map(|c| Some(c.id)).chain([None]) {
        let [w, h] = reach(camera);
        let of = |c: &&rig::RigCamera| camera.is_none_or(|id| id == c.id);
        let own: Vec<[u32; 2]> = rig.cameras.iter().filter(of).map(|c| [c.width, c.height]).collect();
        let holds = |size: &&[u32; 2]| f64::from(size[0]) > w && f64::from(size[1]) > h;
        let others = SIZES.iter().filter(holds).filter(|size| !own.contains(size));
        causes.extend(others.map(|size_px| Cause::PictureSize { camera, size_px: *size_px }));
    }
    causes
}

/// The factors from pictures of a size to those that the rig has.
fn resized(rig: &Rig, camera: u32, size_px: [u32; 2]) -> [f64; 2] {
    let own = rig.cameras.iter().find(|c| c.id == camera);
    own.map_or([1.0; 2], |c| {
        [f64::from(c.width) / f64::from(size_px[0]), f64::from(c.height) / f64::from(size_px[1])]
    })
}

/// Every two of some.
fn pairs<T: Copy>(of: &[T]) -> impl Iterator<Item = [T; 2]> + '_ {
    of.iter().enumerate().flat_map(move |(i, a)| of[i + 1..].iter().map(move |b| [*a, *b]))
}

/// The blobs as they would be without the cause, in the order of arrival.
pub fn undone(rig: &Rig, cause: &Cause, fields: &[BlobField]) -> Vec<BlobField> {
    let mut fields = fields.to_vec();
    fields.iter_mut().for_each(|field| undo(rig, cause, field));
    fields
}

fn undo(rig: &Rig, cause: &Cause, field: &mut BlobField) {
    let is_it = |camera: &Option<u32>, of: u32| camera.is_none_or(|id| id == of);
    match cause {
        Cause::CamerasSwapped { cameras } => field.camera = exchanged(*cameras, field.camera),
        Cause::ColoursSwapped { colours, cameras }
            if cameras.is_empty() || cameras.contains(&field.camera) =>
        {
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
        Cause::PictureSize { camera, size_px } if is_it(camera, field.camera) => {
            let [across, down] = resized(rig, field.camera, *size_px);
            let (count, parity) = (field.blobs().len(), field.parity);
            for blob in &mut field.blobs[..count] {
                let y = frame_line(blob.y_field_px, parity);
                (blob.x_px, blob.y_field_px) = (blob.x_px * across, field_line(y * down, parity));
                (blob.width_px, blob.height_px) = (blob.width_px * across, blob.height_px * down);
                blob.area_px *= across * down;
            }
        }
        _ => {}
    }
}

/// The rig as it would be without the cause, where that is an entry of its file.
pub fn amended(rig: &Rig, cause: &Cause) -> Rig {
    let ([of_a, of_b], [a, b]) = match *cause {
        Cause::MarkersSwapped { body, markers } => ([body; 2], markers),
        Cause::MarkerColoursSwapped { bodies, markers } => (bodies, markers),
        _ => return rig.clone(),
    };
    let mut amended = rig.clone();
    let colour = |body: &str, marker: usize| rig.body(body).map(|b| b.markers[marker].colour);
    for (body, marker, colour) in [(of_a, a, colour(of_b, b)), (of_b, b, colour(of_a, a))] {
        let own = amended.bodies.iter_mut().find(|own| own.name == body);
        if let (Some(own), Some(colour)) = (own, colour) {
            own.markers[marker].colour = colour;
        }
    }
    amended
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
        let (sizes, causes): (Vec<Cause>, Vec<Cause>) =
            causes.into_iter().partition(|c| matches!(c, Cause::PictureSize { .. }));
        assert_eq!(causes.len(), 3 + 21 + 4);
        for cause in &causes {
            let once = undone(&rig, cause, &fields);
            assert_ne!(bytes(&once), bytes(&fields), "{cause}");
            assert_eq!(bytes(&undone(&rig, cause, &once)), bytes(&fields), "{cause}");
        }
        // Every usual size but the rig's own, of each camera and of all.
        assert_eq!(sizes.len(), 4 * (SIZES.len() - 1));
        let mut field = fields[0];
        (field.parity, field.blobs[0].x_px, field.blobs[0].y_field_px) = (1, 320.0, 119.5);
        let halves = Cause::PictureSize { camera: Some(field.camera), size_px: [640, 480] };
        let whole = undone(&rig, &halves, &[field])[0];
        assert!((whole.blobs[0].x_px - 360.0).abs() < 1e-9);
        assert!((whole.y_frame_px(&whole.blobs[0]) - 288.0).abs() < 1e-9);
        let late = Cause::ClockShifted { camera: 1, by_ms: 3.0 };
        let moved = undone(&rig, &late, &fields);
        let shifts = moved.iter().zip(&fields).filter(|(m, f)| m.exposed_ns + 3_000_000 == f.exposed_ns);
        assert_eq!(shifts.count(), 4);
    }
}
