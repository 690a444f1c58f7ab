//! Streams with a planted defect, to be found by `calibration::causes`: the rig that is given stays right in its
//! own view, and the truth is known.

use crate::streams::{Knock, Recipe, Scenario, rig_at};
use calibration::causes::Cause;
use nalgebra::{Rotation3, Vector3};
use protocol::blobs::{BlobField, Colour, WHOLE_FRAME};
use protocol::poses::BODY_NAMES;
use protocol::random::Random;
use rig::Rig;

/// A kind of defect.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
#[allow(missing_docs)]
pub enum Defect {
    None,
    CamerasSwapped,
    ColoursSwapped,
    ParitySwapped,
    Progressive,
    StampsShifted,
    Scale,
    MarkerMoved,
    CameraMoved,
    TwoCamerasMoved,
    WrongSize,
    OneCamerasColours,
    MarkersSwapped,
    StampsStep,
    FocalLength,
    Distortion,
    PrincipalPoint,
}

impl Defect {
    /// Every one.
    pub const ALL: [Defect; 11] = [
        Defect::None,
        Defect::CamerasSwapped,
        Defect::ColoursSwapped,
        Defect::ParitySwapped,
        Defect::Progressive,
        Defect::StampsShifted,
        Defect::Scale,
        Defect::MarkerMoved,
        Defect::CameraMoved,
        Defect::TwoCamerasMoved,
        Defect::WrongSize,
    ];

    /// Kinds that were added later: figures by seed are stated for those of [`Defect::ALL`].
    pub const MORE: [Defect; 3] = [Defect::OneCamerasColours, Defect::MarkersSwapped, Defect::StampsStep];

    /// A lens of the rig file is wrong; these are drawn only where they are asked for.
    pub const LENSES: [Defect; 3] = [Defect::FocalLength, Defect::Distortion, Defect::PrincipalPoint];
}

/// A stream as a recorder has it.
pub struct Planted {
    /// The rig that is given.
    pub rig: Rig,
    /// What the recorder has, in the order of arrival.
    pub fields: Vec<BlobField>,
    /// What is wrong; `None` where nothing is.
    pub truth: Option<Cause>,
    /// Since when, s after the first exposure.
    pub since_s: f64,
}

/// Sizes of pictures where they are wrong, px.
const SIZES: [[u32; 2]; 3] = [[640, 480], [768, 576], [1024, 768]];
/// When timestamps step, as a share of the stream.
const STEP: f64 = 0.5;
/// How far a picture of a moved camera moves, px.
const MOVED_PX: (f64, f64) = (0.3, 5.0);

/// By how much a lens of the rig file is wrong: share of its focal length, k1, principal point (px).
const WRONG_LENS: [(f64, f64); 3] = [(0.01, 0.03), (0.05, 0.1), (5.0, 15.0)];

/// A rig with cameras at other places and with other lenses, rates and scans: three on a ring about the eye.
pub fn whole_rig(seed: u64) -> Rig {
    let mut random = Random::new(seed, 4712);
    let shipped = match random.once_in(2) {
        true => Rig::load_or_shipped(None),
        false => Rig::parse(include_str!("../../../assets/rig-200hz.json"), "assets/rig-200hz.json"),
    };
    let hz = [50.0, 100.0, 200.0][random.below(3)];
    let mut rig = rig_at(&shipped.expect("a shipped rig"), hz);
    for camera in &mut rig.cameras {
        let turn = Rotation3::from_axis_angle(&Vector3::z_axis(), random.between(-0.25, 0.25));
        let turned = camera.model().camera_from_world * turn.matrix();
        camera.rotation = std::array::from_fn(|r| std::array::from_fn(|c| turned[(r, c)]));
        // Farther away with a longer lens.
        let farther = random.between(0.9, 1.25);
        camera.t[2] *= farther;
        let longer = farther * random.between(0.92, 1.05);
        (camera.fx, camera.fy) = (camera.fx * longer, camera.fy * longer);
        camera.cx += random.between(-8.0, 8.0);
        camera.cy += random.between(-8.0, 8.0);
        camera.dist[0] += random.between(-0.05, 0.05);
    }
    rig
}

/// The rig with pictures of a size that is not the rig's, of the camera or of all, as a cause.
fn with_wrong_size(rig: &Rig, camera: u32, random: &mut Random) -> (Rig, Cause) {
    let own = [rig.cameras[0].width, rig.cameras[0].height];
    let others: Vec<[u32; 2]> = SIZES.into_iter().filter(|size| *size != own).collect();
    let size_px = random.one_of(&others);
    let camera = if random.once_in(2) { None } else { Some(camera) };
    (with_size(rig.clone(), camera, size_px), Cause::PictureSize { camera, size_px })
}

/// The rig with pictures of another size: those of a camera, or of all.
fn with_size(mut rig: Rig, camera: Option<u32>, size_px: [u32; 2]) -> Rig {
    for own in rig.cameras.iter_mut().filter(|c| camera.is_none_or(|id| id == c.id)) {
        let across = f64::from(size_px[0]) / f64::from(own.width);
        let down = f64::from(size_px[1]) / f64::from(own.height);
        (own.fx, own.cx, own.width) = (own.fx * across, own.cx * across, size_px[0]);
        (own.fy, own.cy, own.height) = (own.fy * down, own.cy * down, size_px[1]);
    }
    rig
}

/// Draws a stream of `seconds` with a defect on the shipped rig; which camera, marker or colour, and how much, follows from the
/// seed. Defects of cameras begin at `from_s`.
pub fn plant(defect: Defect, scenario: Scenario, seed: u64, seconds: f64, from_s: f64) -> Planted {
    plant_on(Rig::load_or_shipped(None).expect("the shipped rig"), defect, scenario, seed, seconds, from_s)
}

/// The same on another rig.
pub fn plant_on(
    rig: Rig,
    defect: Defect,
    scenario: Scenario,
    seed: u64,
    seconds: f64,
    from_s: f64,
) -> Planted {
    let mut random = Random::new(seed, 4711);
    let recipe = Recipe { scenario, seed, seconds, knocks: vec![] };
    let camera = rig.cameras[random.below(rig.cameras.len())].id;
    let mut planted = Planted { fields: Vec::new(), truth: None, since_s: 0.0, rig };
    planted.plant(defect, recipe, camera, from_s, &mut random);
    planted
}

/// Makes the rig file wrong, of which the stream shows nothing.
fn spoil_rig(rig: &mut Rig, defect: Defect, camera: u32, seed: u64, random: &mut Random) -> Cause {
    match defect {
        Defect::Scale => {
            // The rig file has the cameras too far away, or too near.
            let factor = 1.0 + random.between(0.012, 0.03) * if seed.is_multiple_of(2) { 1.0 } else { -1.0 };
            rig.cameras.iter_mut().flat_map(|c| &mut c.t).for_each(|t| *t *= factor);
            Cause::Scale { camera: None, factor }
        }
        Defect::MarkersSwapped => swap_markers(rig, random),
        _ => spoil_lens(rig, defect, camera, random),
    }
}

impl Planted {
    /// Draws the stream with the defect, which begins at `from_s` where it is one of cameras.
    fn plant(&mut self, defect: Defect, recipe: Recipe, camera: u32, from_s: f64, random: &mut Random) {
        let rig = self.rig.clone();
        match defect {
            Defect::Scale
            | Defect::FocalLength
            | Defect::Distortion
            | Defect::PrincipalPoint
            | Defect::MarkersSwapped => {
                let cause = spoil_rig(&mut self.rig, defect, camera, recipe.seed, random);
                self.draw(&recipe, &rig, Some(cause));
            }
            Defect::StampsStep => {
                self.draw(&recipe, &rig, of_blobs(Defect::StampsShifted, &rig, camera, random));
                self.spoil_from(from_s.max(STEP * recipe.seconds));
            }
            Defect::MarkerMoved => {
                let (true_rig, cause) = with_moved_marker(&rig, random);
                self.draw(&recipe, &true_rig, Some(cause));
            }
            Defect::CameraMoved | Defect::TwoCamerasMoved => {
                self.knock(defect, recipe, camera, from_s, random)
            }
            Defect::WrongSize => {
                let (seen_by, cause) = with_wrong_size(&rig, camera, random);
                self.draw(&recipe, &seen_by, Some(cause));
            }
            Defect::Progressive => {
                self.fields = recipe.draw_progressive(&rig).fields;
                self.truth = Some(Cause::Progressive { camera: None });
            }
            _ => {
                self.draw(&recipe, &rig, of_blobs(defect, &rig, camera, random));
                self.spoil_from(from_s);
            }
        }
    }

    /// Draws the stream as a rig sees it, and notes what is wrong.
    fn draw(&mut self, recipe: &Recipe, seen_by: &Rig, truth: Option<Cause>) {
        self.fields = recipe.draw(seen_by).fields;
        self.truth = truth;
    }

    /// Draws the stream with a camera, or with it and another one, moved from an instant on.
    fn knock(&mut self, defect: Defect, recipe: Recipe, camera: u32, from_s: f64, random: &mut Random) {
        let mut cameras = vec![camera];
        if defect == Defect::TwoCamerasMoved {
            let others: Vec<u32> = self.rig.cameras.iter().map(|c| c.id).filter(|id| *id != camera).collect();
            cameras.push(random.one_of(&others));
            cameras.sort_unstable();
        }
        let knocks: Vec<Knock> = cameras.iter().map(|id| knock(&self.rig, *id, from_s, random)).collect();
        self.truth = Some(match cameras[..] {
            [a, b] => Cause::CamerasMoved { cameras: [a, b] },
            _ => Cause::CameraMoved { camera, turn_deg: knocks[0].turn.norm().to_degrees(), shift_mm: 0.0 },
        });
        self.fields = Recipe { knocks, ..recipe }.draw(&self.rig).fields;
        self.since_s = from_s;
    }

    /// Does to the blobs from an instant on, s after the first, what the defect does.
    fn spoil_from(&mut self, from_s: f64) {
        let Some(cause) = &self.truth else { return };
        let begin = self.fields.iter().map(|f| f.exposed_ns).min().unwrap_or(0);
        let from_ns = begin + (from_s * 1e9) as u64;
        let late = self.fields.iter_mut().filter(|f| f.exposed_ns >= from_ns);
        late.for_each(|field| spoil(cause, field));
        self.since_s = from_s;
    }
}

/// Makes a lens of the rig file wrong.
fn spoil_lens(rig: &mut Rig, defect: Defect, id: u32, random: &mut Random) -> Cause {
    let own = rig.cameras.iter_mut().find(|c| c.id == id).expect("a camera of the rig");
    let at = Defect::LENSES.iter().position(|of| *of == defect).expect("a defect of a lens");
    let (least, most) = WRONG_LENS[at];
    let by = random.between(least, most) * if random.once_in(2) { 1.0 } else { -1.0 };
    let mut truth = (1.0, [0.0, 0.0], 0.0);
    match defect {
        Defect::FocalLength => {
            (own.fx, own.fy) = (own.fx * (1.0 + by), own.fy * (1.0 + by));
            truth.0 = 1.0 / (1.0 + by);
        }
        Defect::Distortion => {
            own.dist[0] += by;
            truth.2 = -by;
        }
        _ => {
            own.cx += by;
            truth.1[0] = -by;
        }
    }
    Cause::Lens { camera: id, focal: truth.0, centre_px: truth.1, k1: truth.2 }
}

/// A camera that was turned a little about its own centre.
fn knock(rig: &Rig, camera: u32, at_s: f64, random: &mut Random) -> Knock {
    let to = Vector3::new(random.normal(), random.normal(), 0.3 * random.normal());
    let focal_px = rig.cameras.iter().find(|c| c.id == camera).map_or(1.0, |c| c.fx);
    // By how much the middle of the picture moves.
    let across = to.xy().norm().max(0.1);
    let turn = to / across * (random.between(MOVED_PX.0, MOVED_PX.1) / focal_px);
    Knock { camera, at_s, turn, shift_mm: Vector3::zeros(), goes_on: false }
}

/// A defect that changes blobs.
fn of_blobs(defect: Defect, rig: &Rig, camera: u32, random: &mut Random) -> Option<Cause> {
    Some(match defect {
        Defect::CamerasSwapped => {
            let other = rig.cameras.iter().map(|c| c.id).filter(|id| *id != camera);
            let other: Vec<u32> = other.collect();
            let mut cameras = [camera, random.one_of(&other)];
            cameras.sort_unstable();
            Cause::CamerasSwapped { cameras }
        }
        Defect::ColoursSwapped | Defect::OneCamerasColours => {
            let all = rig.bodies.iter().flat_map(|b| b.markers.iter().map(|m| m.colour));
            let all: Vec<Colour> = all.collect::<std::collections::BTreeSet<_>>().into_iter().collect();
            let first = random.below(all.len());
            let mut colours = [all[first], all[(first + 1 + random.below(all.len() - 1)) % all.len()]];
            colours.sort_unstable();
            let cameras = if defect == Defect::OneCamerasColours { vec![camera] } else { Vec::new() };
            Cause::ColoursSwapped { colours, cameras }
        }
        Defect::ParitySwapped => {
            let camera = if random.once_in(2) { None } else { Some(camera) };
            Cause::ParitySwapped { camera }
        }
        Defect::StampsShifted => {
            let by_ms = random.between(1.0, 10.0) * if random.once_in(2) { 1.0 } else { -1.0 };
            Cause::ClockShifted { camera, by_ms }
        }
        _ => return None,
    })
}

fn spoil(cause: &Cause, field: &mut BlobField) {
    let exchanged = |pair: [u32; 2], v: u32| pair.iter().position(|p| *p == v).map_or(v, |at| pair[1 - at]);
    match cause {
        Cause::CamerasSwapped { cameras } => field.camera = exchanged(*cameras, field.camera),
        Cause::ColoursSwapped { colours, cameras }
            if cameras.is_empty() || cameras.contains(&field.camera) =>
        {
            let count = field.blobs().len();
            let pair = colours.map(|c| c as u32);
            field.blobs[..count].iter_mut().for_each(|b| b.colour = exchanged(pair, b.colour));
        }
        Cause::ParitySwapped { camera } if camera.is_none_or(|id| id == field.camera) => {
            field.parity ^= u32::from(field.parity < WHOLE_FRAME);
        }
        Cause::ClockShifted { camera, by_ms } if *camera == field.camera => {
            field.exposed_ns = field.exposed_ns.saturating_add_signed((by_ms * 1e6) as i64);
        }
        _ => {}
    }
}

/// Gives two markers of different colours each other's colour.
fn swap_markers(rig: &mut Rig, random: &mut Random) -> Cause {
    let of_body = |b: usize| rig.body(BODY_NAMES[b]).map_or(&[][..], |body| &body.markers);
    let all: Vec<(usize, usize)> =
        (0..BODY_NAMES.len()).flat_map(|b| (0..of_body(b).len()).map(move |m| (b, m))).collect();
    let colour = |(b, m): (usize, usize)| of_body(b)[m].colour;
    let one = random.one_of(&all);
    let others: Vec<(usize, usize)> = all.into_iter().filter(|other| colour(*other) != colour(one)).collect();
    let other = random.one_of(&others);
    let (first, second) = (one.min(other), one.max(other));
    let swapped = [(first, colour(second)), (second, colour(first))];
    for ((body, marker), colour) in swapped {
        let own = rig.bodies.iter_mut().find(|b| b.name == BODY_NAMES[body]).expect("a body of each name");
        own.markers[marker].colour = colour;
    }
    match (first, second) {
        ((a, m), (b, n)) if a == b => Cause::MarkersSwapped { body: BODY_NAMES[a], markers: [m, n] },
        ((a, m), (b, n)) => {
            Cause::MarkerColoursSwapped { bodies: [BODY_NAMES[a], BODY_NAMES[b]], markers: [m, n] }
        }
    }
}

/// The rig with one marker beside its place.
fn with_moved_marker(rig: &Rig, random: &mut Random) -> (Rig, Cause) {
    let mut moved = rig.clone();
    let body = random.below(BODY_NAMES.len());
    let own = moved.bodies.iter_mut().find(|b| b.name == BODY_NAMES[body]).expect("a body of each name");
    let marker = random.below(own.markers.len());
    let to = Vector3::new(random.normal(), random.normal(), random.normal()).normalize();
    let shift = to * random.between(0.05, 0.3);
    let p = &mut own.markers[marker].p;
    *p = (Vector3::from(*p) + shift).into();
    (moved, Cause::marker_moved(body, marker, shift.into()))
}

/// True if an explanation is the truth: the same cause of the same camera, marker or colours.
pub fn is_truth(named: &Cause, truth: &Cause) -> bool {
    match (named, truth) {
        (Cause::ClockShifted { camera: a, by_ms: x }, Cause::ClockShifted { camera: b, by_ms: y }) => {
            a == b && (x - y).abs() < 1.5
        }
        (Cause::Scale { factor: a, .. }, Cause::Scale { factor: b, .. }) => (a - b).abs() < 0.006,
        (Cause::MarkerMoved { body: a, marker: m, .. }, Cause::MarkerMoved { body: b, marker: n, .. }) => {
            (a, m) == (b, n)
        }
        (Cause::Lens { camera: a, focal: f, .. }, Cause::Lens { camera: b, focal: g, .. }) => {
            a == b && (f - g).abs() < 0.006
        }
        (Cause::CameraMoved { camera: a, .. }, Cause::CameraMoved { camera: b, .. }) => a == b,
        (a, b) => a == b,
    }
}
