//! A recorded blob stream, read at the start and played with its own spacing.

use anyhow::{Result, bail, ensure};
use blob_stream::BlobReader;
use blob_stream::live::delay_defect;
use bytemuck::Zeroable;
use protocol::blobs::{Blob, BlobField};
use rig::Rig;
use rig::sensor::{Scan, Sensor};
use std::path::Path;

/// A stream in memory: fields without their blobs, and all blobs in one row.
pub struct BlobPlayback {
    fields: Vec<Entry>,
    blobs: Vec<Blob>,
    sensors: Vec<Sensor>,
}

struct Entry {
    field: u64,
    exposed_ns: u64,
    received_ns: u64,
    camera: u32,
    parity: u32,
    blobs_left_out: u32,
    blobs: std::ops::Range<usize>,
}

impl BlobPlayback {
    /// Reads a stream of the cameras of `rig`.
    ///
    /// # Errors
    /// A line that cannot be read, a field that contradicts the rig, or a stream without fields.
    pub fn load(path: &Path, rig: &Rig) -> Result<Self> {
        let file = path.display();
        let mut stream = BlobPlayback { fields: Vec::new(), blobs: Vec::new(), sensors: rig.sensors() };
        for field in BlobReader::open(path)? {
            let field = field?;
            let (number, camera) = (field.field, field.camera);
            if let Some(problem) = defect(&field, rig) {
                bail!("blob stream {file}, field {number} of camera {camera}: {problem}");
            }
            stream.push(&field);
        }
        ensure!(!stream.fields.is_empty(), "blob stream {file}: expected at least one field, found none");
        Ok(stream)
    }

    fn push(&mut self, field: &BlobField) {
        let from = self.blobs.len();
        self.blobs.extend_from_slice(field.blobs());
        self.fields.push(Entry {
            field: field.field,
            exposed_ns: field.exposed_ns,
            received_ns: field.blobs_out_ns,
            camera: field.camera,
            parity: field.parity,
            blobs_left_out: field.blobs_left_out,
            blobs: from..self.blobs.len(),
        });
    }

    fn read_out_ns(&self, camera: u32) -> u64 {
        self.sensors.iter().find(|s| s.camera == camera).map_or(0, Sensor::read_out_ns)
    }

    /// Fields in the stream.
    pub fn count(&self) -> usize {
        self.fields.len()
    }

    /// When field `i` is due, ns after the start; a field out of order is due at once.
    pub fn due_ns(&self, i: usize) -> u64 {
        self.fields[i].received_ns.saturating_sub(self.fields[0].received_ns)
    }

    /// Fills `out` with field `i` as if the first one were received at `start_ns`.
    pub fn field(&self, i: usize, start_ns: u64, out: &mut BlobField) {
        let entry = &self.fields[i];
        *out = BlobField::zeroed();
        (out.field, out.camera, out.parity) = (entry.field, entry.camera, entry.parity);
        out.blobs_left_out = entry.blobs_left_out;
        let shift = i128::from(start_ns) - i128::from(self.fields[0].received_ns);
        let shifted = |t: u64| (i128::from(t) + shift).clamp(1, i128::from(u64::MAX)) as u64;
        out.exposed_ns = shifted(entry.exposed_ns);
        out.blobs_out_ns = shifted(entry.received_ns);
        out.read_out_ns = out.exposed_ns.saturating_add(self.read_out_ns(entry.camera)).min(out.blobs_out_ns);
        let blobs = &self.blobs[entry.blobs.clone()];
        out.blobs[..blobs.len()].copy_from_slice(blobs);
        out.count = blobs.len() as u32;
    }
}

/// Contradiction of a field to the rig or in itself.
fn defect(field: &BlobField, rig: &Rig) -> Option<String> {
    if !rig.cameras.iter().any(|c| c.id == field.camera) {
        return Some(format!("expected a camera of the rig, found {}", field.camera));
    }
    let sensor = rig.sensor(field.camera);
    if !sensor.has_parity(field.parity) {
        let expected = match sensor.scan {
            Scan::Interlaced => "parity 0 or 1 of an interlaced camera",
            Scan::Progressive => "parity 2, whole frames, of a progressive camera",
        };
        return Some(format!("expected {expected}, found {}", field.parity));
    }
    delay_defect(field)
}

#[cfg(test)]
mod tests {
    use super::*;

    fn load(text: &str) -> Result<BlobPlayback> {
        static NUMBER: std::sync::atomic::AtomicU32 = std::sync::atomic::AtomicU32::new(0);
        let number = NUMBER.fetch_add(1, std::sync::atomic::Ordering::Relaxed);
        let path = std::env::temp_dir().join(format!("vitreo-stream-{}-{number}.jsonl", std::process::id()));
        std::fs::write(&path, text).unwrap();
        let stream = BlobPlayback::load(&path, &Rig::load_or_shipped(None).unwrap());
        std::fs::remove_file(&path).unwrap();
        stream
    }

    fn line(cam: u32, seq: u64, t_ns: u64, t_rx_ns: u64) -> String {
        let blob = r#"{"x":1,"y":2,"area":30,"colour":"red","w":6,"h":5}"#;
        format!(
            "{{\"cam\":{cam},\"seq\":{seq},\"t_ns\":{t_ns},\"t_rx_ns\":{t_rx_ns},\"parity\":0,\"blobs\":[{blob}]}}\n"
        )
    }

    #[test]
    fn spacing_and_age_are_kept() {
        let stream =
            load(&(line(0, 4, 48_000_000, 72_000_000) + &line(1, 4, 48_100_000, 72_300_000))).unwrap();
        assert_eq!((stream.count(), stream.due_ns(0), stream.due_ns(1)), (2, 0, 300_000));
        let mut out = BlobField::zeroed();
        stream.field(1, 5_000_000_000, &mut out);
        assert_eq!((out.camera, out.field, out.count), (1, 4, 1));
        assert_eq!((out.exposed_ns, out.blobs_out_ns), (4_976_100_000, 5_000_300_000));
        assert_eq!(out.read_out_ns, 4_976_100_000 + 20_432_000);
    }

    #[test]
    fn fields_out_of_order_are_due_at_once() {
        let stream =
            load(&(line(0, 4, 50_000_000, 72_000_000) + &line(0, 3, 30_000_000, 52_000_000))).unwrap();
        assert_eq!(stream.due_ns(1), 0);
    }

    #[test]
    fn defects_are_named() {
        let error = |text: &str| load(text).err().unwrap().to_string();
        assert!(error(&line(5, 0, 1, 2)).contains("a camera of the rig, found 5"));
        assert!(error(&line(0, 7, 30, 20)).contains("field 7 of camera 0"));
        assert!(error("\n").contains("at least one field"));
        assert!(error("{}").contains("line 1"));
    }
}
