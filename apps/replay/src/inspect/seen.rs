//! What a camera saw of a field and what the tracker made of it: all that a picture of it needs, and in bytes.

use crate::matched::Matched;
use anyhow::{Context, bail};
use bytemuck::{Pod, Zeroable};
use protocol::blobs::{Blob, BlobField};
use protocol::matches::{MatchedBlob, MatchedField, MissedMarker};
use protocol::poses::{BODY_NAMES, BodyStatus};
use rig::Rig;

/// A blob, and what became of it.
#[repr(C)]
#[derive(Debug, Clone, Copy, PartialEq, Pod, Zeroable)]
pub struct SeenBlob {
    /// What became of it.
    pub matched: MatchedBlob,
    /// Width, px of the frame; 0 where the blobs were not recorded.
    pub width_px: f32,
    /// Variances of the centre in x and y, and their covariance, px² of the frame.
    pub covariance_px2: [f32; 3],
}

/// What one camera saw.
#[derive(Debug, Clone, PartialEq)]
pub struct Panel {
    /// Its id.
    pub camera: u32,
    /// Number of its field.
    pub field: u64,
    /// 0: even lines, 1: odd lines.
    pub parity: u32,
    /// Size of its frame, px.
    pub size_px: [f32; 2],
    /// The blobs.
    pub blobs: Vec<SeenBlob>,
    /// Markers that were predicted and got none.
    pub missed: Vec<MissedMarker>,
}

/// What all cameras saw of a tracker frame.
#[derive(Debug, Clone, PartialEq)]
pub struct Seen {
    /// Field, frame, and status and residual of each body, in words.
    pub title: String,
    /// In the order of the rig.
    pub panels: Vec<Panel>,
}

/// Beginning of a panel in bytes.
#[repr(C)]
#[derive(Clone, Copy, Pod, Zeroable)]
struct Head {
    field: u64,
    camera: u32,
    parity: u32,
    size_px: [f32; 2],
    blobs: u32,
    missed: u32,
}

impl Seen {
    /// Of a tracker frame; the newest field of each camera.
    pub fn new(rig: &Rig, found: &Matched<'_>) -> Self {
        let panels = rig.cameras().into_iter().filter_map(|camera| {
            let its = |f: &&MatchedField| f.camera == camera.id;
            let matches = found.matches.fields().iter().rev().find(its)?;
            let blobs = found.fields.iter().find(|f| (f.camera, f.field) == (camera.id, matches.field));
            Some(Panel::new(matches, blobs, camera.size_px.map(|n| n as f32)))
        });
        let panels = panels.collect();
        let statuses = BODY_NAMES.iter().zip(&found.frame.bodies).map(|(name, body)| {
            let status = BodyStatus::from_wire(body.status).map_or("unknown", |s| s.text());
            format!("{name} {status} {:.2} px", body.residual_px)
        });
        let statuses = statuses.collect::<Vec<_>>().join(", ");
        let title = format!("field {} (frame {}): {statuses}", found.frame.field, found.frame.frame);
        Seen { title, panels }
    }

    /// In bytes.
    pub fn to_bytes(&self) -> Vec<u8> {
        let mut bytes = (self.title.len() as u32).to_ne_bytes().to_vec();
        bytes.extend_from_slice(self.title.as_bytes());
        for panel in &self.panels {
            let Panel { camera, field, parity, size_px, blobs, missed } = panel;
            bytes.extend_from_slice(bytemuck::bytes_of(&Head {
                field: *field,
                camera: *camera,
                parity: *parity,
                size_px: *size_px,
                blobs: blobs.len() as u32,
                missed: missed.len() as u32,
            }));
            bytes.extend_from_slice(bytemuck::cast_slice(blobs));
            bytes.extend_from_slice(bytemuck::cast_slice(missed));
        }
        bytes
    }

    /// From its bytes.
    ///
    /// # Errors
    /// Where they are not those that [`Seen::to_bytes`] made.
    pub fn from_bytes(bytes: &[u8]) -> anyhow::Result<Self> {
        let mut rest = bytes;
        let length = u32::from_ne_bytes(take(&mut rest, 4)?.try_into()?);
        let title = std::str::from_utf8(take(&mut rest, length as usize)?)?.to_owned();
        let mut panels = Vec::new();
        while !rest.is_empty() {
            let head: Head = bytemuck::pod_read_unaligned(take(&mut rest, size_of::<Head>())?);
            let Head { field, camera, parity, size_px, blobs, missed } = head;
            let (blobs, missed) = (elements(&mut rest, blobs)?, elements(&mut rest, missed)?);
            panels.push(Panel { camera, field, parity, size_px, blobs, missed });
        }
        Ok(Seen { title, panels })
    }
}

impl Panel {
    fn new(matches: &MatchedField, blobs: Option<&BlobField>, size_px: [f32; 2]) -> Self {
        let of = |matched: &MatchedBlob| {
            let blob: Option<&Blob> = blobs.and_then(|f| f.blobs().get(matched.blob as usize));
            SeenBlob {
                matched: *matched,
                width_px: blob.map_or(0.0, |b| b.width_px as f32),
                covariance_px2: blob
                    .map_or([0.0; 3], |b| [b.var_x_px2, b.var_y_px2, b.cov_xy_px2].map(|v| v as f32)),
            }
        };
        Panel {
            camera: matches.camera,
            field: matches.field,
            parity: matches.parity,
            size_px,
            blobs: matches.blobs().iter().map(of).collect(),
            missed: matches.missed().to_vec(),
        }
    }
}

fn take<'a>(rest: &mut &'a [u8], count: usize) -> anyhow::Result<&'a [u8]> {
    let Some((taken, left)) = rest.split_at_checked(count) else {
        bail!("a field ends {} bytes early", count - rest.len());
    };
    *rest = left;
    Ok(taken)
}

fn elements<T: Pod>(rest: &mut &[u8], count: u32) -> anyhow::Result<Vec<T>> {
    let bytes = (count as usize).checked_mul(size_of::<T>()).context("more elements than there are bytes")?;
    Ok(take(rest, bytes)?.chunks_exact(size_of::<T>()).map(bytemuck::pod_read_unaligned).collect())
}

#[cfg(test)]
pub mod tests {
    use super::*;
    use proptest::prelude::*;

    /// With so many blobs in each panel.
    pub fn sample(title: &str, blobs: &[usize]) -> Seen {
        let blob = |n: usize| SeenBlob {
            matched: MatchedBlob { x_px: n as f32, nis: 0.5, ..Zeroable::zeroed() },
            width_px: 6.0,
            covariance_px2: [0.01, 0.02, 0.003],
        };
        let panel = |(camera, count): (usize, &usize)| Panel {
            camera: camera as u32,
            field: 1 << 40,
            parity: 1,
            size_px: [768.0, 576.0],
            blobs: (0..*count).map(blob).collect(),
            missed: vec![MissedMarker { body: 2, marker: 3, x_px: 5.0, y_px: 7.0 }; count % 3],
        };
        Seen { title: title.into(), panels: blobs.iter().enumerate().map(panel).collect() }
    }

    proptest! {
        #[test]
        fn bytes_give_what_was_seen(title in ".{0,80}", blobs in prop::collection::vec(0usize..70, 0..9)) {
            let seen = sample(&title, &blobs);
            prop_assert_eq!(Seen::from_bytes(&seen.to_bytes()).unwrap(), seen);
        }

        #[test]
        fn bytes_that_are_cut_or_changed_are_no_reason_to_panic(
            blobs in prop::collection::vec(0usize..9, 1..4), at in 0usize..400, value: u8, cut in 1usize..400,
        ) {
            let bytes = sample("field 1", &blobs).to_bytes();
            let mut changed = bytes.clone();
            let place = at % bytes.len();
            changed[place] = value;
            let _ = Seen::from_bytes(&changed);
            // One that ends between two panels is whole.
            let panels = sample("field 1", &blobs[..blobs.len() - 1]).to_bytes().len();
            let short = bytes.len() - 1 - cut % (bytes.len() - panels - 1).max(1);
            prop_assert!(short == panels || Seen::from_bytes(&bytes[..short]).is_err());
        }
    }
}
