//! Poses for exchange: `t_ns,t_out_ns,body,valid,x,y,z,qw,qx,qy,qz,kind`, one row a body and
//! instant.
//!
//! `t_ns` is the instant for which the pose is, `t_out_ns` the one at which it was available; tip
//! in the world in mm, quaternion world-from-body. A row of kind `meas` is `valid` only where a
//! blob of that body was used in that frame; a row of kind `pred` where the body is not lost.

use protocol::geometry::{Pose, Validity};
use protocol::poses::{BODY_NAMES, TrackerFrame};
use protocol::predict::predict;
use protocol::time::Nanos;
use std::io::{self, Write};

/// Writes rows of poses.
pub struct PosesCsv<W: Write> {
    out: W,
}

impl<W: Write> PosesCsv<W> {
    /// Writes the header.
    ///
    /// # Errors
    /// Where it cannot be written.
    pub fn new(mut out: W) -> io::Result<Self> {
        writeln!(out, "t_ns,t_out_ns,body,valid,x,y,z,qw,qx,qy,qz,kind")?;
        Ok(PosesCsv { out })
    }

    /// The bodies of a frame that was available at `out_ns`, for its own instant.
    ///
    /// # Errors
    /// Where they cannot be written.
    pub fn measured(&mut self, frame: &TrackerFrame, out_ns: Nanos) -> io::Result<()> {
        for (body, name) in frame.bodies.iter().zip(BODY_NAMES) {
            let valid = body.validity() == Validity::Measured && body.blobs_used > 0;
            self.row([frame.instants.exposed, out_ns], name, valid, &body.world_from_body, "meas")?;
        }
        Ok(())
    }

    /// The bodies predicted from `frame` to `at_ns` by a viewer that took it at `latched_ns`.
    ///
    /// # Errors
    /// Where they cannot be written.
    pub fn predicted(&mut self, frame: &TrackerFrame, latched_ns: Nanos, at_ns: Nanos) -> io::Result<()> {
        for (body, name) in BODY_NAMES.into_iter().enumerate() {
            let shown = predict(frame, body, at_ns);
            let valid = shown.validity != Validity::Lost;
            self.row([at_ns, latched_ns], name, valid, &shown.world_from_body, "pred")?;
        }
        Ok(())
    }

    fn row(&mut self, at: [Nanos; 2], body: &str, valid: bool, pose: &Pose, kind: &str) -> io::Result<()> {
        let ([t, t_out], [x, y, z]) = (at, pose.position_mm);
        let [qw, qx, qy, qz] = pose.rotation_wxyz;
        let valid = u8::from(valid);
        writeln!(self.out, "{t},{t_out},{body},{valid},{x},{y},{z},{qw},{qx},{qy},{qz},{kind}")
    }

    /// What it was written to.
    pub fn into_inner(self) -> W {
        self.out
    }
}

/// What a display shows: for every refresh the newest pose that was there `lead_ns` before it.
#[derive(Debug)]
pub struct DisplayClock {
    hz: f64,
    lead_ns: u64,
    /// Newest frame and when it was available.
    newest: Option<(Box<TrackerFrame>, Nanos)>,
    /// Number of the next refresh.
    next: u64,
}

impl DisplayClock {
    /// Refreshes at k / `hz` of the stream's clock.
    pub fn new(hz: f64, lead_ns: u64) -> Self {
        DisplayClock { hz, lead_ns, newest: None, next: 0 }
    }

    fn refresh_ns(&self, k: u64) -> Nanos {
        (k as f64 * 1e9 / self.hz).round() as Nanos
    }

    /// Takes a new frame; first shows `show(frame, latched_ns, at_ns)` all refreshes that latched
    /// before it was available.
    ///
    /// # Errors
    /// Those of `show`.
    pub fn advance(
        &mut self,
        frame: &TrackerFrame,
        out_ns: Nanos,
        show: impl FnMut(&TrackerFrame, Nanos, Nanos) -> io::Result<()>,
    ) -> io::Result<()> {
        // A tracker answers in order, whatever the fields' instants say.
        let out_ns = self.newest.as_ref().map_or(out_ns, |(_, last)| out_ns.max(*last));
        if self.newest.is_none() {
            let first = (out_ns + self.lead_ns) as f64 * self.hz / 1e9;
            self.next = (first.floor() as u64).saturating_sub(1);
            while self.refresh_ns(self.next) < out_ns + self.lead_ns {
                self.next += 1;
            }
        }
        self.show_until(out_ns, show)?;
        self.newest = Some((Box::new(*frame), out_ns));
        Ok(())
    }

    /// Shows the refreshes that latch before `until_ns`.
    ///
    /// # Errors
    /// Those of `show`.
    pub fn show_until(
        &mut self,
        until_ns: Nanos,
        mut show: impl FnMut(&TrackerFrame, Nanos, Nanos) -> io::Result<()>,
    ) -> io::Result<()> {
        let Some((frame, _)) = &self.newest else { return Ok(()) };
        loop {
            let at = self.refresh_ns(self.next);
            let latched = at - self.lead_ns;
            if latched >= until_ns {
                return Ok(());
            }
            show(frame, latched, at)?;
            self.next += 1;
        }
    }

    /// When the newest frame was available.
    pub fn newest_out_ns(&self) -> Option<Nanos> {
        self.newest.as_ref().map(|(_, out)| *out)
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use bytemuck::Zeroable;

    fn frame(number: u64) -> TrackerFrame {
        let mut frame = TrackerFrame::zeroed();
        frame.frame = number;
        frame.instants.exposed = 40_000_000 + number * 20_000_000;
        for body in &mut frame.bodies {
            body.world_from_body = Pose::IDENTITY;
        }
        frame.bodies[0].validity = Validity::Measured as u32;
        frame.bodies[0].blobs_used = 4;
        frame.bodies[1].validity = Validity::Predicted as u32;
        frame
    }

    #[test]
    fn only_measured_bodies_are_valid() {
        let mut bytes = Vec::new();
        let mut csv = PosesCsv::new(&mut bytes).unwrap();
        csv.measured(&frame(0), 65_000_000).unwrap();
        let text = String::from_utf8(bytes).unwrap();
        let rows: Vec<&str> = text.lines().collect();
        assert_eq!(rows[0], "t_ns,t_out_ns,body,valid,x,y,z,qw,qx,qy,qz,kind");
        assert_eq!(rows[1], "40000000,65000000,inst0,1,0,0,0,1,0,0,0,meas");
        assert_eq!(rows[2], "40000000,65000000,inst1,0,0,0,0,1,0,0,0,meas");
        assert_eq!(rows[3], "40000000,65000000,eye,0,0,0,0,1,0,0,0,meas");
    }

    #[test]
    fn a_display_shows_the_newest_frame_that_was_there_in_time() {
        let mut clock = DisplayClock::new(100.0, 15_000_000);
        let mut shown = Vec::new();
        let mut show = |f: &TrackerFrame, latched: u64, at: u64| {
            assert_eq!(at - latched, 15_000_000);
            shown.push((f.frame, at / 1_000_000));
            Ok(())
        };
        // Available at 65, 85 and 84 ms (which counts as 85): refreshes at 80, 90, 100 ms ….
        clock.advance(&frame(0), 65_000_000, &mut show).unwrap();
        clock.advance(&frame(1), 85_000_000, &mut show).unwrap();
        clock.advance(&frame(2), 84_000_000, &mut show).unwrap();
        clock.show_until(106_000_000, &mut show).unwrap();
        assert_eq!(shown, [(0, 80), (0, 90), (2, 100), (2, 110), (2, 120)]);
    }
}
