//! Step `colours`: from pictures of the markers, what the cameras take for which colour.
//!
//! Hues heap up where markers are ([`clusters`]). Each colour of the rig gets the heap that fits, its median and its
//! spread; a class ends half-way to its neighbour at the latest. The proposal is then tried on the pictures, and what it
//! finds is drawn.

pub mod clusters;

use crate::folder::{Folder, Outcome, Record};
use crate::pictures::{PicturesArgs, of_size};
use crate::refuse;
use anyhow::Result;
use blob_stream::FieldHead;
use clusters::{Heap, heaps, matched};
use fpga_model::colours::Class;
use fpga_model::colours::file::ColourFile;
use fpga_model::colours::learn::{Samples, apart_deg, hue_deg};
use fpga_model::commands::extractor::{Extractor, Tuning};
use fpga_model::input::source::Shot;
use fpga_model::input::{Interlace, Picture, overlay};
use protocol::blobs::{BLOB_SATURATED, Colour};
use rig::Rig;
use std::collections::BTreeMap;

/// Two colours are at least so far apart, degrees of hue.
pub const LEAST_APART_DEG: f64 = 24.0;
/// And so many times their spread.
const SPREADS: f64 = 6.0;
/// The ground is at most this bright, luma.
pub const BRIGHTEST_GROUND: u8 = 90;
/// Chroma of a marker below which it is reported as pale.
const PALE: f64 = 40.0;
/// Share of blobs with saturated pixels from which it is reported.
const SATURATED_SHARE: f64 = 0.3;
/// A class is so much wider than what was seen, for other light; and its widest, degrees.
const MARGIN: f64 = 1.5;
const WIDEST_DEG: f64 = 60.0;
/// Most samples of a picture.
const SAMPLES: usize = 400_000;

/// A picture that is looked at.
pub struct Shown {
    /// Id of its camera.
    pub camera: u32,
    /// Its file.
    pub file: String,
    /// It.
    pub picture: Picture,
}

/// Runs the step.
///
/// # Errors
/// Pictures that cannot be read, or show too little; see [`proposed`].
pub fn run(folder: &Folder, rig: &Rig, args: &PicturesArgs) -> Result<Outcome> {
    let shown = load(rig, args)?;
    let there = folder.colours();
    let before = ColourFile::load_or_shipped(there.as_deref())?;
    let (file, mut record) = proposed(rig, &shown)?;
    record.from = args.names();
    let [found, old] = [&file, &before].map(|f| Tried::new(f, rig, &shown));
    let kept = old.score() > found.score();
    let tried = if kept { old } else { found };
    tried.advise(rig, &mut record);
    let mut outcome = Outcome::default();
    for (camera, png) in tried.pictures {
        let caption = format!("camera {camera}: the blobs that are found");
        outcome.pictures.push((format!("colours-cam{camera}.png"), caption, png?));
    }
    record.kept = kept;
    if kept {
        record.notes.push("the previous colours find more markers in these pictures and are kept".into());
    }
    outcome.colours = (!kept || there.is_none()).then(|| if kept { before.text() } else { file.text() });
    outcome.record = record;
    Ok(outcome)
}

fn load(rig: &Rig, args: &PicturesArgs) -> Result<Vec<Shown>> {
    let ids: Vec<u32> = rig.cameras.iter().map(|c| c.id).collect();
    // A few pictures of each camera say all that there is to say.
    let args = PicturesArgs { max_pictures: args.max_pictures.min(8), ..args.clone() };
    let mut shown = Vec::new();
    args.each(rig, &args.feeds(&ids)?, &mut |camera, _, file, picture| {
        if let Some(own) = rig.cameras.iter().find(|c| c.id == camera) {
            of_size(file, camera, [own.width, own.height], [picture.width, picture.height])?;
            shown.push(Shown { camera, file: file.into(), picture: picture.clone() });
        }
        Ok(())
    })?;
    refuse(Vec::from_iter(shown.is_empty().then(|| {
        format!("{} contains no complete picture: record longer, or use --every 1", args.names().join(", "))
    })))?;
    Ok(shown)
}

/// Colours of a rig's markers that have a hue, and how many markers have each.
fn colours_of(rig: &Rig) -> BTreeMap<u32, (Colour, usize)> {
    let mut all = BTreeMap::new();
    for marker in rig.bodies.iter().flat_map(|b| &b.markers).filter(|m| m.colour != Colour::White) {
        all.entry(marker.colour as u32).or_insert((marker.colour, 0)).1 += 1;
    }
    all
}

/// The luma below which half of the pixels lie.
fn ground(shown: &[Shown]) -> u8 {
    let mut counts = [0u64; 256];
    shown.iter().flat_map(|s| &s.picture.luma).for_each(|v| counts[usize::from(*v)] += 1);
    let half = counts.iter().sum::<u64>() / 2;
    let mut sum = 0;
    let at = counts.iter().position(|n| {
        sum += n;
        sum > half
    });
    at.unwrap_or(0) as u8
}

/// Classes for the colours of a rig from pictures of its markers.
///
/// # Errors
/// A ground that is too bright, a colour that is in no picture, two that are too near each other.
pub fn proposed(rig: &Rig, shown: &[Shown]) -> Result<(ColourFile, Record)> {
    let ground = ground(shown);
    refuse(Vec::from_iter((ground > BRIGHTEST_GROUND).then(|| {
        format!("the background is too bright (luma {ground}, at most {BRIGHTEST_GROUND}): cover what is behind the markers with black, or shorten the exposure")
    })))?;
    let shipped = ColourFile::load_or_shipped(None)?;
    let least = ground.max(shipped.black).saturating_add(shipped.low);
    let mut samples = Vec::new();
    for Shown { picture, .. } in shown {
        let (w, n) = (picture.width, picture.luma.len());
        let lit = (0..n).step_by(n.div_ceil(SAMPLES).max(1)).filter(|&i| picture.luma[i] >= least);
        samples.extend(lit.map(|i| picture.pixel(i % w, i / w)));
    }
    let (colours, found) = (colours_of(rig), heaps(&samples));
    let wanted: Vec<Colour> = colours.values().map(|c| c.0).collect();
    let pairs = matched(&wanted, &found);
    refuse(absent(&wanted, &pairs, &found))?;
    let chosen: Vec<(Colour, &Heap)> =
        wanted.iter().zip(&pairs).filter_map(|(&colour, heap)| Some((colour, &found[(*heap)?]))).collect();
    refuse(too_near(&chosen))?;
    let mut record = Record::default();
    for heap in (0..found.len()).filter(|i| !pairs.contains(&Some(*i))).map(|i| &found[i]) {
        record.advice.push(format!(
            "the pictures show a hue of {:.0}° that no marker has: cover or remove what has this colour",
            heap.hue_deg
        ));
    }
    let mut classes = classes(&chosen)?;
    if rig.bodies.iter().flat_map(|b| &b.markers).any(|m| m.colour == Colour::White) {
        classes.push(Class::of_reference(Colour::White));
    }
    let mut file = ColourFile::of_classes(&classes);
    file.black = ground.max(16);
    describe(&file, &chosen, &mut record);
    Ok((file, record))
}

fn absent(wanted: &[Colour], pairs: &[Option<usize>], found: &[Heap]) -> Vec<String> {
    let hue_of = |i: usize| found[i].hue_deg;
    let missing = wanted.iter().zip(pairs).filter(|(_, heap)| heap.is_none()).map(|(c, _)| *c);
    let say = |colour: Colour| {
        let usual = hue_deg(&colour.reference());
        let near = wanted.iter().zip(pairs).filter_map(|(c, heap)| Some((*c, hue_of((*heap)?))));
        let near = near.min_by(|a, b| apart_deg(a.1, usual).total_cmp(&apart_deg(b.1, usual)));
        let or = near.map_or(String::new(), |(c, hue)| {
            let name = c.name();
            format!(
                "; if it is in the pictures, its paint is too close to {name} (hue {hue:.0}°): use \
                another paint, or correct the white balance"
            )
        });
        let name = colour.name();
        format!(
            "{name}: no picture shows a marker of this colour: turn the instruments until all are seen, with more light{or}"
        )
    };
    missing.map(say).collect()
}

/// Pairs of colours that cannot be distinguished.
fn too_near(chosen: &[(Colour, &Heap)]) -> Vec<String> {
    let mut said = Vec::new();
    for (i, (a, first)) in chosen.iter().enumerate() {
        for (b, second) in &chosen[i + 1..] {
            let apart = apart_deg(first.hue_deg, second.hue_deg);
            let least = LEAST_APART_DEG.max(SPREADS * (first.sigma_deg() + second.sigma_deg()) / 2.0);
            if apart < least {
                let (a, b, x, y) = (a.name(), b.name(), first.hue_deg, second.hue_deg);
                said.push(format!(
                    "{a} (hue {x:.0}°) and {b} (hue {y:.0}°) are too close: {apart:.0}° apart, at least \
                     {least:.0}° are needed: paint one of them in another colour, or correct light and \
                     white balance"
                ));
            }
        }
    }
    said
}

fn classes(chosen: &[(Colour, &Heap)]) -> Result<Vec<Class>> {
    let learnt = chosen.iter().map(|(colour, heap)| {
        let mut samples = Samples::default();
        samples.add(heap.samples.iter().copied());
        samples.class(*colour).map_err(|problem| crate::Refused(vec![problem]).into())
    });
    let learnt: Vec<Class> = learnt.collect::<Result<_>>()?;
    let widest = |class: &Class| {
        let others = learnt.iter().filter(|o| o.colour != class.colour);
        others
            .map(|o| apart_deg(hue_deg(&o.reference), hue_deg(&class.reference)) / 2.0)
            .fold(WIDEST_DEG, f64::min)
    };
    let wide = |c: &Class| Class { tolerance_deg: (MARGIN * c.tolerance_deg).min(widest(c)).round(), ..*c };
    Ok(learnt.iter().map(wide).collect())
}

fn describe(file: &ColourFile, chosen: &[(Colour, &Heap)], record: &mut Record) {
    let classes: Vec<Class> = file.classes().into_iter().filter(|c| c.colour != Colour::White).collect();
    let mut nearest = (f64::MAX, String::new());
    for (i, class) in classes.iter().enumerate() {
        let hue = hue_deg(&class.reference);
        let sigma = chosen.iter().find(|c| c.0 == class.colour).map_or(0.0, |c| c.1.sigma_deg());
        let [y, cb, cr] = class.reference.map(f64::from);
        let chroma = (cb - 128.0).hypot(cr - 128.0);
        let name = class.colour.name();
        record.figure(
            name,
            format!(
                "hue {hue:.0}° ± {:.0}° (seen ± {sigma:.1}°), luma {y:.0}, chroma {chroma:.0}, counts from {}",
                class.tolerance_deg, class.least_chroma
            ),
        );
        if chroma < PALE {
            record.advice.push(format!("{name} is pale (chroma {chroma:.0}): use brighter, whiter light"));
        }
        for other in &classes[i + 1..] {
            let apart = apart_deg(hue, hue_deg(&other.reference));
            if apart < nearest.0 {
                nearest = (apart, format!("{name} and {}", other.colour.name()));
            }
        }
    }
    record.figure("ground", format!("luma {}", file.black));
    let all = classes.len();
    record.summary = match nearest {
        (apart, pair) if apart < 360.0 => {
            format!("{all} colours; the nearest two, {pair}, are {apart:.0}° apart")
        }
        _ => format!("{all} colours"),
    };
}

/// What some classes find in the pictures.
struct Tried {
    /// By camera: pictures, and blobs by colour of the picture that shows most of it.
    counts: BTreeMap<u32, (usize, BTreeMap<u32, usize>)>,
    /// By picture, the markers of the rig's colours, no more than there are.
    markers: usize,
    blobs: usize,
    saturated: usize,
    /// The last picture of each camera with its blobs drawn in.
    pictures: BTreeMap<u32, Result<Vec<u8>, image::ImageError>>,
}

impl Tried {
    fn new(file: &ColourFile, rig: &Rig, shown: &[Shown]) -> Self {
        let tuning = Tuning::default();
        let colours = colours_of(rig);
        let mut extractor = Extractor::new(file, &tuning);
        let (counts, pictures) = (BTreeMap::new(), BTreeMap::new());
        let mut tried = Tried { counts, markers: 0, blobs: 0, saturated: 0, pictures };
        for (seq, Shown { camera, file, picture }) in shown.iter().enumerate() {
            let head = FieldHead { cam: *camera, seq: seq as u64, t_ns: 1, t_rx_ns: 1, parity: 0 };
            let view = picture.view(Interlace::Progressive, 0);
            extractor.scan(&Shot { head, view, is_field: false, is_still: true, is_live: false, file });
            let own = tried.counts.entry(*camera).or_default();
            own.0 += 1;
            for (code, (_, number)) in &colours {
                let seen = extractor.blobs.iter().filter(|b| b.colour == *code).count();
                let most = own.1.entry(*code).or_default();
                *most = seen.max(*most);
                tried.markers += seen.min(*number);
            }
            tried.blobs += extractor.blobs.len();
            tried.saturated += extractor.blobs.iter().filter(|b| b.flags & BLOB_SATURATED != 0).count();
            let drawn = overlay::draw(&view, extractor.blobs.iter().zip(&extractor.boxes), 1);
            tried.pictures.insert(*camera, overlay::png(&drawn));
        }
        tried
    }

    fn score(&self) -> usize {
        self.markers
    }

    fn advise(&self, rig: &Rig, record: &mut Record) {
        let colours = colours_of(rig);
        for (camera, (pictures, most)) in &self.counts {
            let mut found = Vec::new();
            for (code, (colour, markers)) in &colours {
                let (name, seen) = (colour.name(), most.get(code).copied().unwrap_or(0));
                found.push(format!("{seen} {name}"));
                if seen == 0 {
                    record.advice.push(format!(
                        "camera {camera} shows no {name} marker in {pictures} pictures: check that it is in \
                         view and lit"
                    ));
                }
                if seen > *markers {
                    record.advice.push(format!(
                        "camera {camera}: {seen} {name} blobs in one picture, but the rig has {markers} such markers: \
                         another object there is {name}: cover it"
                    ));
                }
            }
            record.figure(format!("camera {camera}: most blobs in a picture"), found.join(", "));
        }
        let share = self.saturated as f64 / self.blobs.max(1) as f64;
        if share > SATURATED_SHARE {
            record.advice.push(format!(
                "{:.0} % of the blobs hold saturated pixels: shorten the exposure, or dim the light",
                100.0 * share
            ));
        }
    }
}
