//! Trajectories in the format of the TUM RGB-D benchmark, which `evo` and others read: a file a body,
//! `timestamp tx ty tz qx qy qz qw` a line, s and m, comments behind `#`.
//!
//! Measured poses alone are in it, each at the instant of its exposure. Instants are of the wall clock where the
//! recording knows it, as in viewers, else of the recording's own clock.

use outputs::{Names, OutputFile, Outputs};
use protocol::geometry::{Pose, Validity};
use protocol::limits::BODIES;
use protocol::poses::{BODY_NAMES, TrackerFrame};
use protocol::time::Nanos;
use recording::Provenance;
use std::io::{self, Write};
use std::path::Path;

/// Files in the folder.
const FILES: Names = &[["inst0", ".tum"], ["inst1", ".tum"], ["eye", ".tum"]];

/// Trajectories that are written.
pub struct Trajectories {
    bodies: [Option<Trajectory>; BODIES],
    realtime_offset_ns: u64,
}

struct Trajectory {
    out: OutputFile,
    last_ns: Option<Nanos>,
    poses: u64,
}

impl Trajectories {
    /// Of one body into a file, or of each into a file of its name in a folder.
    ///
    /// # Errors
    /// Where a file exists or cannot be written.
    pub fn open(
        to: &Path,
        body: Option<&str>,
        provenance: &Provenance,
        outputs: &mut Outputs,
    ) -> anyhow::Result<Self> {
        let realtime_offset_ns = provenance.realtime_offset_ns();
        if body.is_none() {
            outputs.claim_folder(to, FILES)?;
        }
        let mut bodies = [const { None }; BODIES];
        for (name, place) in BODY_NAMES.into_iter().zip(&mut bodies) {
            let out = match body {
                Some(wanted) if wanted == name => outputs.create(to)?,
                Some(_) => continue,
                None => outputs.create(&to.join(format!("{name}.tum")))?,
            };
            let mut trajectory = Trajectory { out, last_ns: None, poses: 0 };
            trajectory.begin(name, realtime_offset_ns != 0)?;
            *place = Some(trajectory);
        }
        Ok(Trajectories { bodies, realtime_offset_ns })
    }

    /// Takes a frame.
    ///
    /// # Errors
    /// Where a file cannot be written.
    pub fn take(&mut self, frame: &TrackerFrame) -> io::Result<()> {
        let at_ns = frame.instants.exposed;
        for (body, trajectory) in frame.bodies.iter().zip(&mut self.bodies) {
            let measured = body.validity() == Validity::Measured && body.blobs_used > 0;
            if let Some(trajectory) = trajectory.as_mut().filter(|_| measured) {
                trajectory.pose(at_ns, at_ns.wrapping_add(self.realtime_offset_ns), &body.world_from_body)?;
            }
        }
        Ok(())
    }

    /// Ends the files; the names of bodies of which there was no pose.
    ///
    /// # Errors
    /// Where a file cannot be written.
    pub fn finish(self) -> anyhow::Result<Vec<&'static str>> {
        let mut empty = Vec::new();
        for (name, trajectory) in BODY_NAMES.into_iter().zip(self.bodies) {
            let Some(Trajectory { out, poses, .. }) = trajectory else { continue };
            out.finish()?;
            if poses == 0 {
                empty.push(name);
            }
        }
        Ok(empty)
    }
}

impl Trajectory {
    fn begin(&mut self, body: &str, wall_clock: bool) -> io::Result<()> {
        let clock = if wall_clock { "wall-clock time since 1970" } else { "the recording's clock" };
        writeln!(
            self.out,
            "# {body} of a vitreo recording: measured poses, world from body, at their exposures"
        )?;
        writeln!(self.out, "# timestamp (s, {clock}) tx ty tz (m) qx qy qz qw")
    }

    /// Later poses alone: readers expect instants that grow.
    fn pose(&mut self, at_ns: Nanos, stamp_ns: Nanos, pose: &Pose) -> io::Result<()> {
        if self.last_ns.is_some_and(|last| at_ns <= last) {
            return Ok(());
        }
        self.last_ns = Some(at_ns);
        self.poses += 1;
        let [x, y, z] = pose.position_mm.map(|mm| mm * 1e-3);
        let [qw, qx, qy, qz] = pose.rotation_wxyz;
        let (s, ns) = (stamp_ns / 1_000_000_000, stamp_ns % 1_000_000_000);
        writeln!(self.out, "{s}.{ns:09} {x} {y} {z} {qx} {qy} {qz} {qw}")
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use recording::{Item, Recording};

    /// Numbers of the lines that are no comments.
    fn read(file: &Path) -> Vec<[f64; 8]> {
        let text = std::fs::read_to_string(file).unwrap();
        let rows = text.lines().filter(|line| !line.starts_with('#'));
        let numbers = rows.map(|line| {
            let row: Vec<f64> = line.split(' ').map(|cell| cell.parse().unwrap()).collect();
            row.try_into().unwrap()
        });
        numbers.collect()
    }

    #[test]
    fn every_measured_pose_is_there_in_metres_and_seconds() {
        let golden = Path::new(env!("CARGO_MANIFEST_DIR")).join("../../tests/data/golden/peel-2s.mcap");
        let recording = Recording::open(&golden).unwrap();
        let offset = 1_764_000_000_000_000_000_u64;
        let config = [(recording::REALTIME_OFFSET.to_string(), offset.to_string())].into();
        let folder = tempfile::tempdir().unwrap();
        let (all, alone) = (folder.path().join("all"), folder.path().join("one.tum"));
        let provenance = Provenance { config, ..Provenance::default() };
        let mut outputs = Outputs::new(false);
        let mut of_all = Trajectories::open(&all, None, &provenance, &mut outputs).unwrap();
        let mut of_one =
            Trajectories::open(&alone, Some("inst1"), &Provenance::default(), &mut outputs).unwrap();
        let mut measured: [Vec<(u64, Pose)>; BODIES] = Default::default();
        for item in recording.items_of(&["poses"]) {
            let Item::Poses(frame) = item.unwrap().1 else { continue };
            of_all.take(&frame).unwrap();
            of_one.take(&frame).unwrap();
            // Twice is once.
            of_one.take(&frame).unwrap();
            for (body, measured) in frame.bodies.iter().zip(&mut measured) {
                if body.validity() == Validity::Measured && body.blobs_used > 0 {
                    measured.push((frame.instants.exposed, body.world_from_body));
                }
            }
        }
        assert!(of_all.finish().unwrap().is_empty() && of_one.finish().unwrap().is_empty());
        for (name, measured) in BODY_NAMES.iter().zip(&measured) {
            let rows = read(&all.join(format!("{name}.tum")));
            assert!(rows.len() == measured.len() && rows.len() > 50, "{name}: {}", rows.len());
            for ([t, x, y, z, qx, qy, qz, qw], (at, pose)) in rows.iter().zip(measured) {
                assert!((t - (at + offset) as f64 * 1e-9).abs() < 1e-6);
                let position = [x, y, z].map(|metres| metres * 1e3);
                assert!(position.iter().zip(pose.position_mm).all(|(a, b)| (a - b).abs() < 1e-12));
                assert_eq!([*qw, *qx, *qy, *qz], pose.rotation_wxyz);
                let norm = qx * qx + qy * qy + qz * qz + qw * qw;
                assert!((norm - 1.0).abs() < 1e-6, "a unit quaternion");
            }
        }
        let rows = read(&alone);
        assert_eq!(rows.len(), measured[1].len());
        assert!((rows[0][0] - measured[1][0].0 as f64 * 1e-9).abs() < 1e-6, "the recording's clock");
        assert!(Trajectories::open(&all, None, &provenance, &mut Outputs::new(false)).is_err(), "it exists");
    }
}
