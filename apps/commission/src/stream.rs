//! Streams of blobs: recordings (`.mcap`) and `blobs.jsonl`, and whether they say enough.

use crate::live::{self, LiveArgs};
use crate::{Refused, refuse};
use anyhow::Result;
use calibration::cli::fields_in;
use calibration::observations::{FrameObservations, collect};
use calibration::self_calibration::{spread, usable};
use fpga_model::input::whole::is_recording;
use protocol::blobs::BlobField;
use rig::Rig;
use settings::commands::cameras as stream;
use std::path::Path;

/// Shortest stream, s.
pub const SHORTEST_S: f64 = 2.5;
/// Recommended duration of a stream, s.
const SHOULD_S: f64 = 20.0;
/// Fewest instants at which bodies are seen well enough.
pub const FEWEST_INSTANTS: usize = 40;
/// Most instants that are used.
pub const MOST_INSTANTS: usize = 400;
/// Least share of a camera's fields that have blobs.
const LEAST_SEEN: f64 = 0.3;

/// Where a stream comes from.
#[derive(Debug, Clone, Copy)]
pub enum Origin<'a> {
    /// A recording or a file of blobs.
    File(&'a Path),
    /// Live cameras, watched for so many seconds.
    Live(&'a [stream::Stream], f64),
}

impl<'a> Origin<'a> {
    /// Of the options of a step; `None` without any.
    pub fn of(from: Option<&'a Path>, live: &'a LiveArgs) -> Option<Self> {
        from.map(Origin::File)
            .or_else(|| (!live.cameras.is_empty()).then_some(Origin::Live(&live.cameras, live.seconds)))
    }

    /// As it is named in a record.
    pub fn names(self) -> Vec<String> {
        match self {
            Origin::File(path) => vec![path.display().to_string()],
            Origin::Live(cameras, _) => cameras.iter().map(ToString::to_string).collect(),
        }
    }
}

/// A stream.
pub struct Stream {
    /// Its fields.
    pub fields: Vec<BlobField>,
    /// From first to last field, s.
    pub seconds: f64,
}

/// True of what has blobs, by its name; a recording of pixels has pictures.
pub fn is_stream(path: &Path) -> bool {
    path.extension().is_some_and(|e| e == "mcap" || e == "jsonl") && !is_recording(path)
}

/// Reads a stream or live cameras, and judges whether it can be one of this rig. The blobs of a recording of pixels and of cameras are
/// found by `colours`, or by the shipped ones.
///
/// # Errors
/// A file that cannot be read; a stream that is short, lacks a camera, or is of another rig.
pub fn load(rig: &Rig, origin: Origin<'_>, colours: Option<&Path>) -> Result<Stream> {
    let fields = match origin {
        Origin::File(path) => fields_in(path, colours.filter(|_| is_recording(path)))?.1,
        Origin::Live(cameras, seconds) => live::blobs(rig, cameras, seconds, colours)?,
    };
    let instants = fields.iter().map(|f| f.exposed_ns);
    let (first, last) = instants.fold((u64::MAX, 0), |(a, b), t| (a.min(t), b.max(t)));
    let stream = Stream { seconds: last.saturating_sub(first) as f64 * 1e-9, fields };
    let name = origin.names().join(",");
    let mut said = Vec::new();
    if stream.seconds < SHORTEST_S {
        said.push(format!(
            "{name}: the stream lasts {:.1} s, at least {SHORTEST_S} s are needed: record half a minute",
            stream.seconds
        ));
    }
    let strange = stream.fields.iter().map(|f| f.camera).find(|id| rig.cameras.iter().all(|c| c.id != *id));
    if let Some(id) = strange {
        said.push(format!(
            "{name}: has fields of camera {id}, which the rig lacks: is it a stream of this rig?"
        ));
    }
    for camera in &rig.cameras {
        let own = || stream.fields.iter().filter(|f| f.camera == camera.id);
        let (all, lit) = (own().count(), own().filter(|f| f.count > 0).count());
        let id = camera.id;
        if all == 0 && !stream.fields.is_empty() {
            said.push(format!("{name}: no field of camera {id}: is it connected?"));
        } else if (lit as f64) < LEAST_SEEN * all as f64 {
            let share = 100.0 * lit as f64 / all as f64;
            said.push(format!(
                "camera {id} saw blobs in {share:.0} % of its fields: turn it to the instruments, and do colours again"
            ));
        }
    }
    refuse(said)?;
    Ok(stream)
}

impl Stream {
    /// What was seen with a rig, spread over the stream.
    ///
    /// # Errors
    /// Too few instants at which bodies are seen well enough.
    pub fn seen(&self, rig: &Rig) -> Result<Vec<FrameObservations>> {
        let seen = spread(collect(rig, &self.fields), MOST_INSTANTS);
        enough(rig, &seen)?;
        Ok(seen)
    }

    /// What would make the stream a better one.
    pub fn advice(&self) -> Option<String> {
        let short = self.seconds < SHOULD_S;
        short.then(|| format!("the stream lasts {:.0} s only: half a minute would give more", self.seconds))
    }
}

/// Refuses what shows too little.
fn enough(rig: &Rig, seen: &[FrameObservations]) -> Result<(), Refused> {
    let found = usable(rig, seen).len();
    refuse(Vec::from_iter((found < FEWEST_INSTANTS).then(|| {
        format!(
            "bodies were seen well enough by two cameras at {found} instants, at least {FEWEST_INSTANTS} are needed: \
             move slowly, keep instruments and eye in view of all cameras, and do colours and poses (from a \
             board) first"
        )
    })))
}
