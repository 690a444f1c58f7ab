//! Causes that the inputs of two recordings show: what is missing, whose stamps are off, and what was done
//! to the blobs.

use super::blobs::{BlobPair, Matcher, evenly};
use super::causes::{Cause, Confidence, Finding, seconds};
use super::exchanged::{changed_part, swapped_cameras, swapped_colours};
use super::inputs::{FieldPair, FieldPairs, camera_offsets};
use super::models::{Fit, Model, Observed};
use super::side::Side;
use protocol::handles::{HandleState, PedalState};
use rig::Rig;
use rig::camera::Camera;
use std::collections::{BTreeMap, BTreeSet};

/// Fields missing in a row to the end from which on a camera counts as lost.
const LOST_FIELDS: usize = 25;
/// Offsets of stamps that count, ns: jitter of exposures is less.
const STAMPS_NS: u64 = 200_000;
/// What may be left of the blobs' movement where a cause explains it, px RMS: noise of two recordings.
const NOISE_PX: f64 = 0.2;
/// Movement of the blobs below which there is nothing to explain, px RMS.
const NOTHING_PX: f64 = 1e-4;
/// Residuals are taken to have at least this deviation, px: the models are no more exact.
const FLOOR_PX: f64 = 0.02;
/// Decrease of χ² that shows a cause, and by which it must be better than the next.
const SHOWN_CHI2: f64 = 50.0;
/// Blobs of a camera by which the common time of two recordings is found, and the times that are tried: up to a field
/// period either way.
const TIMED_PAIRS: usize = 1000;
const TIME_STEPS: i32 = 80;
const TIME_STEP_S: f64 = 0.25e-3;
/// Movement of a camera's blobs up to which they are the same, px RMS.
const SAME_PX: f64 = 1e-3;
/// Share of the movement that a cause must explain.
const EXPLAINED: f64 = 0.5;
/// Causes that are sought one after the other.
const MOST_CAUSES: usize = 3;

/// What is missing in one of the recordings. Of exchanged cameras, each field counts as the other's.
pub fn missing(a: &Side, b: &Side, fields: &FieldPairs, exchanged: Option<[u32; 2]>) -> Vec<Finding> {
    let mut found = Vec::new();
    let offset = fields.number_offset;
    let sides =
        [('B', &fields.missing_in_b, a, b, offset), ('A', &fields.missing_in_a, b, a, offset.wrapping_neg())];
    for (lacking, missing, has, lacks, offset) in sides {
        let (span, mut beyond) = (numbers_of(lacks), 0);
        for (camera, numbers) in missing {
            let other = exchanged.map(|[x, y]| {
                if *camera == x {
                    y
                } else if *camera == y {
                    x
                } else {
                    *camera
                }
            });
            let is_there = |number: &u64| {
                let own = other.map_or(&[][..], |other| lacks.fields_of(other));
                own.binary_search_by_key(&number.wrapping_add_signed(offset), |f| f.field).is_ok()
            };
            let within = |number: &u64| span.contains(&number.wrapping_add_signed(offset));
            beyond += numbers.iter().filter(|number| !within(number)).count() as u64;
            let absent = numbers.iter().copied().filter(|number| within(number) && !is_there(number));
            let numbers: Vec<u64> = absent.collect();
            if !numbers.is_empty() {
                let last = has.fields_of(*camera).last().map_or(0, |f| f.field);
                let beyond_end = !within(&last);
                found.push(missing_fields(lacking, *camera, &numbers, has, beyond_end));
            }
        }
        if beyond > 0 && !lacks.fields.is_empty() {
            let cause = Cause::Shorter { lacking, fields: beyond };
            found.push(Finding::new(
                cause,
                Confidence::Certain,
                "none of its cameras has fields of these numbers",
            ));
        }
    }
    let handle = |h: &HandleState| {
        (h.seq, format!("handle state {} of instrument {}, field {}", h.seq, h.instrument, h.field))
    };
    found.extend(missing_states(&a.handles, &b.handles, handle));
    let pedal = |p: &PedalState| (p.seq, format!("pedal state {}", p.seq));
    found.extend(missing_states(&a.pedals, &b.pedals, pedal));
    found
}

/// Numbers of the camera-fields of a recording, from the first to the last; of none all.
fn numbers_of(side: &Side) -> std::ops::RangeInclusive<u64> {
    let numbers = || side.fields.iter().map(|f| f.field);
    numbers().min().unwrap_or(0)..=numbers().max().unwrap_or(u64::MAX)
}

/// Single fields, or all from some instant on. `beyond_end`: the camera goes on when the other recording has
/// ended.
fn missing_fields(lacking: char, camera: u32, numbers: &[u64], has: &Side, beyond_end: bool) -> Finding {
    let own = has.fields_of(camera);
    let absent: BTreeSet<u64> = numbers.iter().copied().collect();
    let last = numbers.last().copied().unwrap_or(0);
    let until = own.partition_point(|f| f.field <= last);
    let near_end = own.len() - until < LOST_FIELDS || beyond_end;
    let at_the_end = own[..until].iter().rev().take_while(|f| absent.contains(&f.field)).count();
    let count = numbers.len() as u64;
    if at_the_end >= LOST_FIELDS && near_end {
        let from_s = seconds(has.start_ns(), own[until - at_the_end].exposed_ns);
        let evidence = format!("{at_the_end} fields to the end are in the other recording");
        return Finding::new(Cause::CameraLost { camera, from_s, lacking }, Confidence::Certain, evidence);
    }
    let what = format!("field {} of camera {camera}", numbers[0]);
    let evidence = format!("{count} of {} fields of the camera", own.len());
    Finding::new(Cause::InputMissing { what, count, lacking }, Confidence::Certain, evidence)
}

/// States that one recording lacks, by number. Of states before the first or behind the last of a
/// recording nothing is said: it began or ended there.
fn missing_states<T>(a: &[T], b: &[T], name: impl Fn(&T) -> (u64, String)) -> Vec<Finding> {
    let numbers = |states: &[T]| states.iter().map(&name).collect::<BTreeMap<u64, String>>();
    let [a, b] = [numbers(a), numbers(b)];
    let sides = [('B', &a, &b), ('A', &b, &a)];
    let of = sides.into_iter().filter_map(|(lacking, has, lacks)| {
        let (first, last) = (lacks.keys().next()?, lacks.keys().next_back()?);
        let gone: Vec<&String> =
            has.range(first..=last).filter(|(n, _)| !lacks.contains_key(n)).map(|(_, what)| what).collect();
        let (what, count) = ((*gone.first()?).clone(), gone.len() as u64);
        let evidence = format!("{count} of {} numbers", has.len());
        Some(Finding::new(Cause::InputMissing { what, count, lacking }, Confidence::Certain, evidence))
    });
    of.collect()
}

/// Cameras whose stamps are off against the others, ms.
fn stamps(fields: &FieldPairs) -> BTreeMap<u32, f64> {
    let offsets = camera_offsets(&fields.pairs);
    let off =
        offsets.into_iter().map(|(camera, offset)| (camera, offset.wrapping_sub(fields.clock_offset_ns)));
    off.filter(|(_, off)| off.unsigned_abs() >= STAMPS_NS)
        .map(|(camera, off)| (camera, off as f64 * 1e-6))
        .collect()
}

/// What was done to the blobs of paired fields. `step` is called for each step of the search.
pub fn of_blobs(a: &Side, b: &Side, fields: &FieldPairs, step: &dyn Fn()) -> Vec<Finding> {
    let (Some(rig), false) = (&a.rig, fields.pairs.is_empty()) else { return Vec::new() };
    let cameras = rig.cameras();
    if let Some(swapped) = swapped_cameras(a, b, fields, &cameras) {
        return vec![swapped];
    }
    let (recoloured, mut found) = swapped_colours(a, b, fields);
    let matcher = Matcher::new(a, b, rig, recoloured, fields.clock_offset_ns);
    let (mut pairs, mut looked_at): (Vec<BlobPair>, usize) = (Vec::new(), 0);
    for camera in &cameras {
        let own: Vec<FieldPair> = fields.pairs.iter().filter(|p| p.a.camera == camera.id).copied().collect();
        let matched = matcher.matched(camera, changed_part(a, b, &own));
        looked_at += matched.looked_at;
        pairs.extend(matched.pairs);
        step();
    }
    let same: BTreeSet<u32> =
        cameras.iter().map(|c| c.id).filter(|id| are_same(&cameras, &pairs, *id)).collect();
    let followed = follow_stamps(&cameras, &mut pairs);
    let mut shifted = stamps(fields);
    shifted.retain(|camera, _| !followed.contains(camera));
    let from_blobs = match pairs.len() * 2 < looked_at {
        true if looked_at > 0 => vec![Finding::new(
            Cause::OtherMotion { rms_px: 1.0 },
            Confidence::Possible,
            format!("{} of {looked_at} blobs have a partner near them", pairs.len()),
        )],
        _ => explain(rig, &cameras, pairs, step),
    };
    for (camera, by_ms) in shifted {
        found.push(stamp_finding(camera, by_ms, same.contains(&camera), fields));
    }
    found.extend(from_blobs);
    found
}

/// Whether the blobs of a camera are the same in both recordings.
fn are_same(cameras: &[Camera], pairs: &[BlobPair], camera: u32) -> bool {
    let own: Vec<BlobPair> = pairs.iter().filter(|pair| pair.camera == camera).cloned().collect();
    let moved_px2 = Observed { cameras, pairs: &own }.unexplained_px2();
    !own.is_empty() && moved_px2 < SAME_PX * SAME_PX * own.len() as f64
}

/// Stamps that are off: certain where the blobs are the same all the same. Where only two cameras sent,
/// either may be the one.
fn stamp_finding(camera: u32, by_ms: f64, same_blobs: bool, fields: &FieldPairs) -> Finding {
    let cameras: BTreeSet<u32> = fields.pairs.iter().map(|p| p.a.camera).collect();
    let sure = if cameras.len() < 3 || !same_blobs { Confidence::Possible } else { Confidence::Certain };
    let blobs = if same_blobs { "its blobs are the same" } else { "its blobs do not follow" };
    let evidence =
        format!("its stamps are off against those of {} other cameras, and {blobs}", cameras.len() - 1);
    Finding::new(Cause::ClockShifted { camera, by_ms }, sure, evidence)
}

/// Takes out what blobs moved because they were exposed at other instants, as their stamps say: of cameras
/// that run freely, each run has phases of its own. Returns the cameras of which that explains something.
fn follow_stamps(cameras: &[Camera], pairs: &mut [BlobPair]) -> BTreeSet<u32> {
    let mut followed = BTreeSet::new();
    let common_s = common_time(cameras, pairs);
    pairs.iter_mut().for_each(|pair| pair.stamped_later_s += common_s);
    for camera in cameras {
        let own = |pair: &&BlobPair| pair.camera == camera.id;
        let (mut before, mut after) = (Vec::new(), Vec::new());
        for pair in pairs.iter().filter(own) {
            let mut less = pair.clone();
            less.moved_px -= pair.moved_after(pair.stamped_later_s);
            before.push(pair.clone());
            after.push(less);
        }
        let px2 = |pairs: &[BlobPair]| Observed { cameras, pairs }.unexplained_px2();
        let (left_px2, variance) =
            (px2(&after), (px2(&after) / after.len().max(1) as f64).max(FLOOR_PX * FLOOR_PX));
        if (px2(&before) - left_px2) / variance > SHOWN_CHI2 {
            followed.insert(camera.id);
            pairs.iter_mut().filter(|pair| pair.camera == camera.id).for_each(|pair| {
                pair.moved_px -= pair.moved_after(pair.stamped_later_s);
            });
        }
    }
    followed
}

/// What is to be added to every stamp so that the blobs follow best, s: the clock of the second recording is
/// known by its stamps only as far as its cameras exposed as before. The median over the cameras, so that one
/// whose clock is off does not count.
fn common_time(cameras: &[Camera], pairs: &[BlobPair]) -> f64 {
    let own =
        |camera: &Camera| pairs.iter().filter(|pair| pair.camera == camera.id).cloned().collect::<Vec<_>>();
    let mut times: Vec<f64> =
        cameras.iter().map(own).filter(|own| !own.is_empty()).map(|own| best_time(&own)).collect();
    times.sort_by(f64::total_cmp);
    // Of two in the middle the nearer to none: of two cameras the one whose clock is off does not count.
    let middle = &times[times.len().saturating_sub(1) / 2..(times.len() / 2 + 1).min(times.len())];
    middle.iter().copied().min_by(|s, t| s.abs().total_cmp(&t.abs())).unwrap_or(0.0)
}

/// What is to be added to the stamps of a camera so that its blobs follow best, s.
fn best_time(pairs: &[BlobPair]) -> f64 {
    let sample = evenly(pairs, TIMED_PAIRS);
    let left_px2 = |time_s: f64| -> f64 {
        let residual = |pair: &BlobPair| pair.moved_px - pair.moved_after(pair.stamped_later_s + time_s);
        sample.iter().map(|pair| residual(pair).norm_squared().min(1.0)).sum()
    };
    let times = (-TIME_STEPS..=TIME_STEPS).map(|n| f64::from(n) * TIME_STEP_S);
    let best = times.map(|time_s| (left_px2(time_s), time_s)).min_by(|p, q| p.0.total_cmp(&q.0));
    // Blobs that are the same need none.
    best.filter(|(left, _)| *left < 0.9 * left_px2(0.0)).map_or(0.0, |(_, time_s)| time_s)
}

/// The causes that explain how blobs moved, the best first, until noise is left.
fn explain(rig: &Rig, cameras: &[Camera], pairs: Vec<BlobPair>, step: &dyn Fn()) -> Vec<Finding> {
    let (all, mut left, mut found) = (pairs.len() as f64, pairs, Vec::new());
    if all == 0.0 {
        return found;
    }
    let moved_px2 = Observed { cameras, pairs: &left }.unexplained_px2();
    let rms = |px2: f64| (px2 / all).sqrt();
    if rms(moved_px2) < NOTHING_PX {
        return found;
    }
    let mut left_px2 = moved_px2;
    while found.len() < MOST_CAUSES {
        let observed = Observed { cameras, pairs: &left };
        let mut fits = candidates(rig, cameras, &observed, step);
        fits.sort_by(|p, q| cost(p).total_cmp(&cost(q)));
        let Some(best) = fits.first().cloned() else { break };
        let variance = (best.left_px2 / all).max(FLOOR_PX * FLOOR_PX);
        let gain = (left_px2 - best.left_px2) / variance;
        if gain < SHOWN_CHI2 + best.parameters.len() as f64 || best.left_px2 > left_px2 * EXPLAINED {
            break;
        }
        let alike = fits[1..].iter().filter(|fit| !is_same_thing(fit, &best));
        let alike: Vec<Fit> =
            alike.filter(|fit| (fit.left_px2 - best.left_px2) / variance < SHOWN_CHI2).cloned().collect();
        let evidence = format!(
            "explains {:.1} % of the difference of {} blobs, {:.2} px RMS; the remainder is {:.3} px",
            100.0 * (1.0 - best.left_px2 / left_px2),
            all,
            rms(left_px2),
            rms(best.left_px2)
        );
        let sure = if alike.is_empty() { Confidence::Likely } else { Confidence::Possible };
        found.push(Finding::new(cause_of(&best, cameras), sure, evidence.clone()));
        found.extend(alike.iter().map(|fit| Finding::new(cause_of(fit, cameras), sure, "explains as much")));
        (left, left_px2) = (observed.less(&best), best.left_px2);
        if rms(left_px2) < NOISE_PX / 2.0 || !alike.is_empty() {
            break;
        }
    }
    finish(found, rms(moved_px2), rms(left_px2))
}

/// Where much is left, what was found is no more than possible, and the motion is another one.
fn finish(mut found: Vec<Finding>, moved_px: f64, left_px: f64) -> Vec<Finding> {
    if left_px > NOISE_PX {
        found.iter_mut().for_each(|f| f.confidence = Confidence::Possible);
        let evidence =
            format!("no change of cameras, clocks or markers explains the remaining {left_px:.2} px");
        found.push(Finding::new(Cause::OtherMotion { rms_px: moved_px }, Confidence::Possible, evidence));
    } else if found.is_empty() {
        let evidence = "no change of cameras, clocks or markers explains a part of it";
        found.push(Finding::new(Cause::BlobNoise { rms_px: moved_px }, Confidence::Possible, evidence));
    }
    found
}

/// What a fit leaves, with the penalty of its parameters.
fn cost(fit: &Fit) -> f64 {
    fit.left_px2 + fit.parameters.len() as f64 * FLOOR_PX * FLOOR_PX * 4.0
}

/// Fits of everything in the catalogue.
fn candidates(rig: &Rig, cameras: &[Camera], observed: &Observed<'_>, step: &dyn Fn()) -> Vec<Fit> {
    let markers: BTreeSet<_> = observed.pairs.iter().filter_map(|pair| pair.marker).collect();
    let of_camera = |id: u32| [Model::Turned(id), Model::Moved(id), Model::Focal(Some(id)), Model::Clock(id)];
    let models = cameras.iter().flat_map(|camera| of_camera(camera.id));
    let all = models.chain([Model::Focal(None)]).chain(markers.into_iter().map(Model::Marker));
    let fits = all.filter_map(|model| {
        step();
        observed.fit(model)
    });
    fits.filter(|fit| is_plausible(rig, fit)).collect()
}

/// Refuses sizes outside of what can happen: they are fits of something else.
fn is_plausible(rig: &Rig, fit: &Fit) -> bool {
    let norm = |values: &[f64]| values.iter().map(|v| v * v).sum::<f64>().sqrt();
    let period_ms = rig.field_period_ns() as f64 * 1e-6;
    match fit.model {
        Model::Turned(_) => norm(&fit.parameters) < 5.0,
        Model::Moved(_) => norm(&fit.parameters[..3]) < 5.0 && norm(&fit.parameters[3..]) < 5.0,
        Model::Focal(_) => norm(&fit.parameters) < 20.0,
        Model::Clock(_) => norm(&fit.parameters) < period_ms,
        Model::Marker(_) => norm(&fit.parameters) < 2.0,
    }
}

/// True for a turn and a movement of one camera.
fn is_same_thing(fit: &Fit, best: &Fit) -> bool {
    let camera = |model: Model| match model {
        Model::Turned(camera) | Model::Moved(camera) => Some(camera),
        _ => None,
    };
    camera(fit.model).is_some() && camera(fit.model) == camera(best.model)
}

fn cause_of(fit: &Fit, cameras: &[Camera]) -> Cause {
    let p = &fit.parameters;
    let norm = |values: &[f64]| values.iter().map(|v| v * v).sum::<f64>().sqrt();
    match fit.model {
        Model::Turned(camera) => Cause::CameraMoved { camera, turn_deg: norm(p), shift_mm: 0.0 },
        Model::Moved(camera) => {
            let shift_mm = cameras.iter().find(|c| c.id == camera).map_or(0.0, |c| centre_shift(c, p));
            Cause::CameraMoved { camera, turn_deg: norm(&p[..3]), shift_mm }
        }
        Model::Focal(camera) => Cause::Scale { camera, factor: 1.0 + p[0] * 0.01 },
        // Exposed later, with the same stamps: the stamps are early.
        Model::Clock(camera) => Cause::ClockShifted { camera, by_ms: -p[0] },
        Model::Marker(id) => Cause::marker_moved(id.body, id.marker, [p[0], p[1], p[2]]),
    }
}

/// How far the centre of projection moved by a turn (degrees) and a shift in the camera's frame, mm.
fn centre_shift(camera: &Camera, p: &[f64]) -> f64 {
    let turn = nalgebra::Rotation3::new(nalgebra::Vector3::new(p[0], p[1], p[2]) * 1f64.to_radians());
    let moved = Camera {
        camera_from_world: turn.matrix() * camera.camera_from_world,
        translation_mm: turn * camera.translation_mm + nalgebra::Vector3::new(p[3], p[4], p[5]),
        ..camera.clone()
    };
    (moved.centre_in_world() - camera.centre_in_world()).norm()
}
