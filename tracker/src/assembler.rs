//! Assembles camera-fields into frames. Pure: the present instant is an argument.
//!
//! A frame is made for each exposure of the reference camera, the fastest that is alive, of several the lowest id.
//! With t its exposure and P the period of the rig's fastest camera, the frame's period is (t + ε − P, t + ε]: in it
//! every camera of that rate, genlocked (within ε of t) or free-running (anywhere), has one field, and a slower one
//! has one where it is due: whole periods of its own after its last. The frame closes
//! - `Inputs`: the fields of the period are there of every living camera that has one in it;
//! - `TimeOut`: `CAMERA_WAIT_NS` after the first field of this exposure arrived, or half a period where that is
//!   less;
//! - `NextField`: a later field of the reference camera came first.
//!
//! Where the reference camera itself misses a field, the lowest camera genlocked to it takes its
//! place after the same wait. Without such a camera the frame is made for the instant at which the
//! reference camera should have exposed, from the earlier fields of the others, so frames keep
//! their spacing. A field that arrives after its frame was closed goes into the next one. A camera
//! that has sent nothing for several periods is not waited for until it sends again. Nor is a field of a slower
//! camera that cannot come in time, because its lines take longer to read out than those of the reference camera.
//!
//! A frame has the number of the reference camera's field. Where that is a slower camera (the fastest ones are dead,
//! or missed a field), whose numbers rise more slowly, it is the number that a field of the fastest would have.

mod refusal;

pub use refusal::Refusal;

use crate::tracker::Reference;
use protocol::blobs::{BlobField, WHOLE_FRAME};
use protocol::limits::{CAMERA_WAIT_NS, MAX_CAMERAS, MAX_FIELDS_USED};
use protocol::message::Message;
use protocol::poses::ClosedBy;
use protocol::time::Nanos;
use rig::Rig;
use rig::sensor::{Scan, Sensor};

/// Exposures of genlocked cameras differ by less than this (ε), ns.
const GENLOCK_NS: u64 = 500_000;
/// A camera is alive for this many periods after its last field arrived, and for this time at least, ns.
const ALIVE_PERIODS: u64 = 4;
const ALIVE_NS: u64 = 80_000_000;
/// Time of consecutive old fields of a camera after which its clock counts as set back, ns.
const CLOCK_SET_BACK_NS: u64 = 500_000_000;

impl CameraState {
    /// Of the camera with this sensor.
    fn new(sensor: &Sensor) -> Self {
        let Sensor { scan, period_ns, .. } = *sensor;
        CameraState { in_rig: true, scan, period_ns, read_out_ns: sensor.read_out_ns(), ..Self::default() }
    }

    /// Before its first field.
    fn fresh(&self) -> Self {
        let CameraState { in_rig, scan, period_ns, read_out_ns, .. } = *self;
        CameraState { in_rig, scan, period_ns, read_out_ns, ..Self::default() }
    }

    /// The first exposure after `begin_ns` that follows from the last by whole periods, ns.
    fn due_after_ns(&self, begin_ns: Nanos) -> Nanos {
        let periods = begin_ns.saturating_sub(self.last_exposed_ns) / self.period_ns.max(1) + 1;
        self.last_exposed_ns.saturating_add(periods.saturating_mul(self.period_ns))
    }
}

/// State of a camera.
#[derive(Debug, Clone, Copy, Default)]
struct CameraState {
    in_rig: bool,
    scan: Scan,
    /// From field to field, ns.
    period_ns: u64,
    /// From an exposure until its lines are read out, ns.
    read_out_ns: u64,
    last_exposed_ns: Nanos,
    last_field: u64,
    last_arrival_ns: Nanos,
    refused_in_a_row: u32,
}

/// A frame that waits for no more fields.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub struct ClosedFrame {
    /// The exposure it is for.
    pub reference: Reference,
    /// Why it was closed.
    pub closed_by: ClosedBy,
    /// Wait from the arrival of the first field of this exposure, at most that of a late camera.
    pub waited_ns: u64,
    /// Instant at which the wait ended.
    pub taken_ns: Nanos,
}

/// A field not yet consumed.
#[derive(Clone, Copy)]
struct Pending {
    arrival_ns: Nanos,
    field: BlobField,
}

/// Collects camera-fields into frames.
pub struct FrameAssembler {
    /// From frame to frame, ns: that from field to field of the fastest camera.
    period_ns: u64,
    /// Longest wait for a late camera, ns.
    wait_ns: u64,
    cameras: [CameraState; MAX_CAMERAS],
    /// Fields not yet consumed, by exposure.
    pending: Vec<Pending>,
    used: Vec<BlobField>,
    last_frame_ns: Nanos,
    /// Number of the last frame's field.
    last_field: u64,
    refused: u32,
}

impl FrameAssembler {
    /// For a checked rig.
    pub fn new(rig: &Rig) -> Self {
        let mut cameras = [CameraState::default(); MAX_CAMERAS];
        for sensor in rig.sensors() {
            if let Some(state) = cameras.get_mut(sensor.camera as usize) {
                *state = CameraState::new(&sensor);
            }
        }
        FrameAssembler {
            period_ns: rig.field_period_ns(),
            wait_ns: CAMERA_WAIT_NS.min(rig.field_period_ns() / 2),
            cameras,
            pending: Vec::with_capacity(MAX_FIELDS_USED),
            used: Vec::with_capacity(MAX_FIELDS_USED),
            last_frame_ns: 0,
            last_field: 0,
            refused: 0,
        }
    }

    /// Forgets everything but the rig.
    pub fn reset(&mut self) {
        for camera in &mut self.cameras {
            *camera = camera.fresh();
        }
        self.pending.clear();
        self.used.clear();
        (self.last_frame_ns, self.last_field) = (0, 0);
        self.refused = 0;
    }

    /// Discards the waiting fields after a pause of the process; returns their number.
    pub fn pass_over(&mut self) -> u64 {
        let waiting = self.pending.len() as u64;
        self.pending.clear();
        waiting
    }

    /// Fields refused since the start.
    pub fn refused(&self) -> u32 {
        self.refused
    }

    /// The fields of the frame closed last, in the order of consumption.
    pub fn used(&self) -> &[BlobField] {
        &self.used
    }

    /// Adds a field of a stream at `now`, and calls `closed` with every frame that timed out before
    /// it or is complete with it, and with the fields of that frame. A refused field is only
    /// counted.
    pub fn add(&mut self, field: &BlobField, now: Nanos, mut closed: impl FnMut(&[BlobField], ClosedFrame)) {
        while let Some(frame) = self.expired(now) {
            closed(&self.used, frame);
        }
        let _ = self.push(field, now);
        while let Some(frame) = self.complete(now) {
            closed(&self.used, frame);
        }
    }

    /// Adds a field that arrives at `now`. Afterwards [`FrameAssembler::complete`] must be called
    /// until it returns `None`.
    ///
    /// # Errors
    /// A field that is invalid, of an unknown camera, from the future or not newer than the
    /// camera's last.
    pub fn push(&mut self, field: &BlobField, now: Nanos) -> Result<(), Refusal> {
        let checked = self.check(field, now);
        if let Err(refusal) = checked {
            self.refused = self.refused.saturating_add(1);
            return Err(refusal);
        }
        // Before the first field every camera counts as alive.
        if self.cameras.iter().all(|c| c.last_arrival_ns == 0) {
            for camera in &mut self.cameras {
                camera.last_arrival_ns = now;
            }
        }
        let camera = &mut self.cameras[field.camera as usize];
        camera.last_exposed_ns = field.exposed_ns;
        camera.last_field = field.field;
        camera.last_arrival_ns = now;
        camera.refused_in_a_row = 0;
        if self.pending.len() == MAX_FIELDS_USED {
            self.pending.remove(0);
            self.refused = self.refused.saturating_add(1);
        }
        let key = |f: &BlobField| (f.exposed_ns, f.camera);
        let at = self.pending.partition_point(|p| key(&p.field) < key(field));
        self.pending.insert(at, Pending { arrival_ns: now, field: *field });
        Ok(())
    }

    fn check(&mut self, field: &BlobField, now: Nanos) -> Result<(), Refusal> {
        let id = field.camera;
        let Some(camera) = self.cameras.get_mut(id as usize).filter(|c| c.in_rig) else {
            return Err(Refusal::UnknownCamera(id));
        };
        if field.validate().is_err() {
            return Err(Refusal::Invalid);
        }
        if (field.parity == WHOLE_FRAME) != (camera.scan == Scan::Progressive) {
            let scan = camera.scan.name();
            return Err(Refusal::OtherScan { camera: id, parity: field.parity, scan });
        }
        if field.exposed_ns > now {
            return Err(Refusal::FromTheFuture(id));
        }
        let last_ns = camera.last_exposed_ns;
        let twice = last_ns > 0 && field.field == camera.last_field;
        if field.exposed_ns <= last_ns || twice {
            camera.refused_in_a_row += 1;
            let for_ns = u64::from(camera.refused_in_a_row) * camera.period_ns;
            if for_ns < CLOCK_SET_BACK_NS || twice {
                return Err(Refusal::NotNewer { camera: id, exposed_ns: field.exposed_ns, last_ns });
            }
            self.last_frame_ns = 0;
        }
        Ok(())
    }

    /// Closes a frame that is complete, or overtaken by the next one.
    pub fn complete(&mut self, now: Nanos) -> Option<ClosedFrame> {
        let reference = self.open_reference(now)?;
        let is_next = |f: &BlobField| f.camera == reference.camera && f.exposed_ns > reference.exposed_ns;
        let overtaken = self.pending.iter().any(|p| is_next(&p.field));
        let full = self.pending.len() == MAX_FIELDS_USED;
        let first = self.first_arrival(&reference);
        if self.has_all(&reference, now) {
            Some(self.close(&reference, ClosedBy::Inputs, first, now))
        } else if overtaken || full {
            Some(self.close(&reference, ClosedBy::NextField, first, now))
        } else {
            None
        }
    }

    /// The end of the present wait for a late camera; `None` while there is none.
    pub fn deadline(&self, now: Nanos) -> Option<Nanos> {
        Some(self.open(now)?.1 + self.wait_ns)
    }

    /// The frame that is waited for, and the instant at which the wait began.
    fn open(&self, now: Nanos) -> Option<(Reference, Nanos)> {
        let came = |reference: Reference| (reference, self.first_arrival(&reference));
        let there = self.open_reference(now).map(came);
        there.or_else(|| self.missed(now)).or_else(|| self.substitute().map(came))
    }

    /// Closes a frame whose wait has ended at `now`.
    pub fn expired(&mut self, now: Nanos) -> Option<ClosedFrame> {
        if now < self.deadline(now)? {
            return None;
        }
        let (reference, first) = self.open(now)?;
        Some(self.close(&reference, ClosedBy::TimeOut, first, now))
    }

    /// Closes an open frame at the end of a stream.
    pub fn flush(&mut self, now: Nanos) -> Option<ClosedFrame> {
        let reference = self.open_reference(now).or_else(|| self.substitute())?;
        let first = self.first_arrival(&reference);
        Some(self.close(&reference, ClosedBy::TimeOut, first, now))
    }

    fn is_alive(&self, camera: usize, now: Nanos) -> bool {
        let state = &self.cameras[camera];
        state.in_rig
            && now.saturating_sub(state.last_arrival_ns) <= (ALIVE_PERIODS * state.period_ns).max(ALIVE_NS)
    }

    /// The fastest camera that is alive, of several the lowest.
    fn reference_camera(&self, now: Nanos) -> Option<usize> {
        (0..MAX_CAMERAS).filter(|&c| self.is_alive(c, now)).min_by_key(|&c| (self.cameras[c].period_ns, c))
    }

    /// True if an exposure belongs to a period without a frame yet.
    fn is_new(&self, exposed_ns: Nanos) -> bool {
        self.last_frame_ns == 0 || exposed_ns > self.last_frame_ns + self.period_ns / 4
    }

    /// The oldest pending field of the reference camera that has no frame yet.
    fn open_reference(&self, now: Nanos) -> Option<Reference> {
        let camera = self.reference_camera(now)? as u32;
        let mut fields = self.pending.iter().map(|p| &p.field);
        fields.find(|f| f.camera == camera && self.is_new(f.exposed_ns)).map(|f| self.reference_of(f))
    }

    /// The lowest camera with a field of a period in which the reference camera has none.
    fn substitute(&self) -> Option<Reference> {
        let due_ns =
            if self.last_frame_ns == 0 { 0 } else { self.last_frame_ns + self.period_ns - GENLOCK_NS };
        let fields = || self.pending.iter().map(|p| &p.field).filter(move |f| f.exposed_ns >= due_ns);
        let first_ns = fields().next()?.exposed_ns;
        let together = fields().filter(|f| f.exposed_ns <= first_ns + GENLOCK_NS);
        let order = |f: &&BlobField| (self.cameras[f.camera as usize].period_ns, f.camera);
        together.min_by_key(order).map(|f| self.reference_of(f))
    }

    /// The exposure that the reference camera missed, if free-running cameras have earlier fields;
    /// with the instant at which its field should have arrived.
    fn missed(&self, now: Nanos) -> Option<(Reference, Nanos)> {
        let id = self.reference_camera(now)?;
        let camera = &self.cameras[id];
        // Of a slower one nothing is due.
        if camera.period_ns != self.period_ns || self.last_frame_ns == 0 || camera.last_exposed_ns == 0 {
            return None;
        }
        let behind_ns = (self.last_frame_ns + self.period_ns / 4).saturating_sub(camera.last_exposed_ns);
        let periods = behind_ns / self.period_ns + 1;
        let due_ns = camera.last_exposed_ns + periods * self.period_ns;
        let others = || self.pending.iter().map(|p| p.field.exposed_ns);
        let genlocked = others().any(|t| t.abs_diff(due_ns) <= GENLOCK_NS);
        let before = others().any(|t| t < due_ns && t + self.period_ns > due_ns + GENLOCK_NS);
        let delay_ns = camera.last_arrival_ns.saturating_sub(camera.last_exposed_ns);
        let field = camera.last_field.saturating_add(periods);
        let reference = Reference { camera: id as u32, field, exposed_ns: due_ns };
        (before && !genlocked).then_some((reference, due_ns + delay_ns))
    }

    /// Arrival of the first field of this exposure.
    fn first_arrival(&self, reference: &Reference) -> Nanos {
        let same = |f: &BlobField| f.exposed_ns.abs_diff(reference.exposed_ns) <= GENLOCK_NS;
        self.pending.iter().filter(|p| same(&p.field)).map(|p| p.arrival_ns).min().unwrap_or(0)
    }

    fn has_all(&self, reference: &Reference, now: Nanos) -> bool {
        let begin_ns = (reference.exposed_ns + GENLOCK_NS).saturating_sub(self.period_ns);
        (0..MAX_CAMERAS).all(|c| {
            let camera = &self.cameras[c];
            !self.is_alive(c, now)
                || camera.last_exposed_ns > begin_ns
                || (camera.period_ns > self.period_ns && !self.is_awaited(camera, reference, begin_ns))
        })
    }

    /// True if a field of a slower camera is due in the frame that begins at `begin_ns`, and can come in time.
    fn is_awaited(&self, camera: &CameraState, reference: &Reference, begin_ns: Nanos) -> bool {
        // Before its first field nothing is known of when it exposes.
        if camera.last_exposed_ns == 0 {
            return true;
        }
        let due_ns = camera.due_after_ns(begin_ns);
        let first_ns = reference.exposed_ns + self.cameras[reference.camera as usize].read_out_ns;
        due_ns <= reference.exposed_ns + GENLOCK_NS
            && due_ns + camera.read_out_ns <= first_ns + GENLOCK_NS + self.wait_ns
    }

    /// A field as the one that a frame is for.
    fn reference_of(&self, field: &BlobField) -> Reference {
        let own_ns = self.cameras[field.camera as usize].period_ns;
        let number = if own_ns == self.period_ns {
            field.field
        } else if self.last_frame_ns == 0 {
            field.field.saturating_mul(own_ns) / self.period_ns
        } else {
            let since_ns = field.exposed_ns.saturating_sub(self.last_frame_ns);
            self.last_field.saturating_add((since_ns + self.period_ns / 2) / self.period_ns)
        };
        Reference { camera: field.camera, field: number, exposed_ns: field.exposed_ns }
    }

    fn close(&mut self, reference: &Reference, closed_by: ClosedBy, first: Nanos, now: Nanos) -> ClosedFrame {
        let taken_ns = if closed_by == ClosedBy::TimeOut { now.min(first + self.wait_ns) } else { now };
        let waited_ns = taken_ns.saturating_sub(first).min(self.wait_ns);
        let end = self.pending.partition_point(|p| p.field.exposed_ns <= reference.exposed_ns + GENLOCK_NS);
        self.used.clear();
        self.used.extend(self.pending[..end].iter().map(|p| p.field));
        self.pending.drain(..end);
        (self.last_frame_ns, self.last_field) = (reference.exposed_ns, reference.field);
        ClosedFrame { reference: *reference, closed_by, waited_ns, taken_ns }
    }
}

#[cfg(test)]
mod tests;
