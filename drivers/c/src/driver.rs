//! A driver in a run: what it sends, checked, and what it reads.

use crate::code::{Code, Failure, failure};
use crate::heart::{Heart, Pulse};
use crate::roles::{self, READS_EVENTS, READS_HEALTH, READS_POSES, SENDERS};
use crate::seats::Seat;
use ipc::clock::{now, sleep_until};
use ipc::outside::invited;
use ipc::{BlockSender, Instance, Loan, Queue, Receiver, Sender, wait};
use protocol::blobs::BlobField;
use protocol::events::Event;
use protocol::fields::FieldHeader;
use protocol::handles::{HandleState, PedalState};
use protocol::health::{Health, Process, STATE_DEGRADED, STATE_FINISHED, STATE_RUNNING};
use protocol::message::Message;
use protocol::poses::TrackerFrame;
use protocol::time::Nanos;

/// Time between two looks for a run, ns.
const LOOK_NS: u64 = 20_000_000;
/// Longest wait for a message without a look whether the run has ended, ns.
const SLICE_NS: u64 = 20_000_000;
/// Longest name of a driver, bytes.
const MAX_NAME: usize = 32;
/// Age above which what is sent cannot be of a live device, ns: its stamp is of another clock.
const OLDEST_NS: u64 = 10_000_000_000;
/// Poses, handles and pedals may be predicted so far ahead, ns; a camera has exposed what it sends.
const PREDICTED_NS: u64 = 1_000_000_000;

/// A field of pixels that is being written.
struct Lent {
    header: FieldHeader,
    loan: Loan<FieldHeader>,
}

/// A driver.
pub struct Driver {
    name: String,
    processes: Vec<Process>,
    blobs: Option<Sender<BlobField>>,
    handles: Option<Sender<HandleState>>,
    pedal: Option<Sender<PedalState>>,
    poses: Option<Sender<TrackerFrame>>,
    fields: Option<BlockSender<FieldHeader>>,
    lent: Option<Lent>,
    read_poses: Option<Receiver<TrackerFrame>>,
    read_events: Option<Receiver<Event>>,
    read_health: Option<Receiver<Health>>,
    roles: u32,
    heart: Heart,
    /// Of the channels that it sends on. After the heart: who comes next finds this one gone.
    _seats: Vec<Seat>,
    // Keeps the node alive; dropped last.
    instance: Instance,
}

/// Waits for at most `wait_ns` until the run `instance` is at work, and has invited what `roles` send.
fn wait_for_run(instance: &str, roles: u32, wait_ns: u64) -> Result<(), Failure> {
    let until = now().saturating_add(wait_ns);
    let invited = loop {
        match invited(instance)? {
            Some(channels) => break channels,
            None if now() >= until => {
                let start = format!("start it with: vitreo run --instance {instance} --external …");
                return Err(failure(
                    Code::NoRun,
                    format!("no simulator named '{instance}' is running; {start}"),
                ));
            }
            None => sleep_until((now() + LOOK_NS).min(until)),
        }
    };
    let wanted = roles::processes(roles).filter_map(Process::drives);
    let refused: Vec<&str> = wanted.filter(|channel| !invited.iter().any(|c| c == channel)).collect();
    if refused.is_empty() {
        return Ok(());
    }
    let refused = refused.join(",");
    let text =
        format!("the run '{instance}' accepts no external {refused}: start it with --external {refused}");
    Err(failure(Code::NotInvited, text))
}

impl Driver {
    /// Joins the run `instance` as the driver `name`, which sends and reads what `roles` say. Where no such run is at
    /// work, waits for it for at most `wait_ns`.
    ///
    /// # Errors
    /// Where a name or `roles` make no sense, there is no such run or it does not take that from outside, another driver
    /// sends that, it was built with other blocks, or the transport fails.
    pub fn open(instance: &str, name: &str, roles: u32, wait_ns: u64) -> Result<Self, Failure> {
        roles::check(roles)?;
        if name.is_empty() || name.len() > MAX_NAME || name.contains(char::is_control) {
            let text = format!("expected a driver's name of 1 to {MAX_NAME} bytes, found {name:?}");
            return Err(failure(Code::Argument, text));
        }
        wait_for_run(instance, roles, wait_ns)?;
        let joined = Instance::join(instance)?;
        let processes: Vec<Process> = roles::processes(roles).collect();
        let channels = processes.iter().copied().filter_map(Process::drives);
        let seats = channels.map(|channel| Seat::take(&joined, channel, name)).collect::<Result<_, _>>()?;
        let sends = |process| processes.contains(&process);
        let (blobs, handles) = (sends(Process::BlobsDriver), sends(Process::HandlesDriver));
        let (pedal, poses) = (sends(Process::PedalDriver), sends(Process::PosesDriver));
        let reads = |bit| roles & bit != 0;
        Ok(Driver {
            blobs: blobs.then(|| joined.sender()).transpose()?,
            handles: handles.then(|| joined.sender()).transpose()?,
            pedal: pedal.then(|| joined.sender()).transpose()?,
            poses: poses.then(|| joined.sender()).transpose()?,
            fields: None,
            lent: None,
            read_poses: reads(READS_POSES).then(|| joined.receiver(Queue::InOrder)).transpose()?,
            read_events: reads(READS_EVENTS).then(|| joined.receiver(Queue::InOrder)).transpose()?,
            read_health: reads(READS_HEALTH).then(|| joined.receiver(Queue::InOrder)).transpose()?,
            roles,
            heart: Heart::start(instance, &processes, name.to_owned())?,
            name: name.to_owned(),
            processes,
            _seats: seats,
            instance: joined,
        })
    }

    /// The run that it joined.
    pub fn instance(&self) -> &str {
        self.instance.name()
    }

    /// Refuses to go on once the run has ended or asks for it.
    ///
    /// # Errors
    /// Where it is so.
    pub fn check(&self) -> Result<(), Failure> {
        self.heart.stop().map_or(Ok(()), |why| Err(failure(Code::Stop, why)))
    }

    /// Sends the blobs of a camera-field. Where `blobs_out_ns` is 0 it becomes the present instant.
    ///
    /// # Errors
    /// Where the block makes no sense, the driver was not opened for it, the run has ended, or the transport fails.
    pub fn send_blobs(&mut self, field: &BlobField) -> Result<(), Failure> {
        let mut field = *field;
        field.blobs_out_ns = if field.blobs_out_ns == 0 { now() } else { field.blobs_out_ns };
        self.check()?;
        let sent = send(self.blobs.as_mut(), &field, Stamp::taken("BlobField.exposed_ns", field.exposed_ns));
        self.note(Process::BlobsDriver, sent)
    }

    /// Sends the state of a handle. The library counts `seq`; where `instant_ns` is 0 it becomes the present one.
    ///
    /// # Errors
    /// As [`Driver::send_blobs`].
    pub fn send_handle(&mut self, handle: &HandleState) -> Result<(), Failure> {
        let seq = self.handles.as_ref().map_or(0, Sender::sent);
        let instant_ns = if handle.instant_ns == 0 { now() } else { handle.instant_ns };
        self.check()?;
        let stamp = Stamp::predicted("HandleState.instant_ns", instant_ns);
        let sent = send(self.handles.as_mut(), &HandleState { seq, instant_ns, ..*handle }, stamp);
        self.note(Process::HandlesDriver, sent)
    }

    /// Sends the state of the pedal. The library counts `seq`; where `instant_ns` is 0 it becomes the present one.
    ///
    /// # Errors
    /// As [`Driver::send_blobs`].
    pub fn send_pedal(&mut self, pedal: &PedalState) -> Result<(), Failure> {
        let seq = self.pedal.as_ref().map_or(0, Sender::sent);
        let instant_ns = if pedal.instant_ns == 0 { now() } else { pedal.instant_ns };
        self.check()?;
        let stamp = Stamp::predicted("PedalState.instant_ns", instant_ns);
        let sent = send(self.pedal.as_mut(), &PedalState { seq, instant_ns, ..*pedal }, stamp);
        self.note(Process::PedalDriver, sent)
    }

    /// Sends poses. The library counts `frame`; where `instants.tracked` is 0 it becomes the present instant.
    ///
    /// # Errors
    /// As [`Driver::send_blobs`].
    pub fn send_poses(&mut self, frame: &TrackerFrame) -> Result<(), Failure> {
        let mut poses = *frame;
        poses.frame = self.poses.as_ref().map_or(0, Sender::sent);
        if poses.instants.tracked == 0 {
            poses.instants.tracked = now();
        }
        self.check()?;
        let stamp = Stamp::predicted("TrackerFrame.instants.exposed", poses.instants.exposed);
        let sent = send(self.poses.as_mut(), &poses, stamp);
        self.note(Process::PosesDriver, sent)
    }

    /// Lends shared memory for the pixels of a field, as many bytes as its header says. It is sent by
    /// [`Driver::send_field`]; the first field's size is the largest there may be.
    ///
    /// # Errors
    /// As [`Driver::send_blobs`], and where a field is lent already or is larger than the first.
    pub fn lend_field(&mut self, header: &FieldHeader) -> Result<&mut [u8], Failure> {
        self.check()?;
        if !self.processes.contains(&Process::FieldsDriver) {
            return Err(no_role("send fields"));
        }
        header.validate()?;
        if self.lent.is_some() {
            return Err(failure(Code::Loan, "a field is on loan already: send it first"));
        }
        let fields = match &mut self.fields {
            Some(fields) => fields,
            none => {
                let whole = FieldHeader { lines: header.height, ..*header };
                none.insert(self.instance.block_sender(whole.bytes())?)
            }
        };
        let loan = fields.lend(header.bytes())?;
        Ok(self.lent.insert(Lent { header: *header, loan }).loan.payload())
    }

    /// Sends the field that was lent.
    ///
    /// # Errors
    /// Where none is lent, it was not exposed of late, the run has ended, or the transport fails.
    pub fn send_field(&mut self) -> Result<(), Failure> {
        self.check()?;
        let lent = self
            .lent
            .take()
            .ok_or_else(|| failure(Code::Loan, "no field is on loan: call vitreo_lend_field first"))?;
        let stamp = Stamp::taken("FieldHeader.exposed_ns", lent.header.exposed_ns);
        let sent = stamp.check(now()).and_then(|()| match &mut self.fields {
            Some(fields) => Ok(fields.send_loan(lent.loan, &lent.header)?),
            None => Ok(()),
        });
        self.note(Process::FieldsDriver, sent)
    }

    /// The next poses, waited for at most `wait_ns`; `None` where none came.
    ///
    /// # Errors
    /// Where the driver was not opened for it, the run has ended and nothing is left, or the transport fails.
    pub fn next_poses(&mut self, wait_ns: u64) -> Result<Option<TrackerFrame>, Failure> {
        next(self.read_poses.as_mut(), &self.heart, wait_ns)
    }

    /// The next event; as [`Driver::next_poses`].
    ///
    /// # Errors
    /// As [`Driver::next_poses`].
    pub fn next_event(&mut self, wait_ns: u64) -> Result<Option<Event>, Failure> {
        next(self.read_events.as_mut(), &self.heart, wait_ns)
    }

    /// The next heartbeat of any process; as [`Driver::next_poses`].
    ///
    /// # Errors
    /// As [`Driver::next_poses`].
    pub fn next_health(&mut self, wait_ns: u64) -> Result<Option<Health>, Failure> {
        next(self.read_health.as_mut(), &self.heart, wait_ns)
    }

    /// Says how it is: at work, or at work with a limitation that `text` names, which is shown to people.
    pub fn tell(&mut self, degraded: bool, text: &str) {
        let text = if text.is_empty() { self.name.clone() } else { format!("{}: {text}", self.name) };
        let state = if degraded { STATE_DEGRADED } else { STATE_RUNNING };
        self.heart.tell(|pulse| (pulse.state, pulse.text) = (state, text));
    }

    /// Says that nothing more will come: a run whose source this is ends in order.
    pub fn finish(&mut self) {
        self.heart.tell(|pulse| pulse.state = STATE_FINISHED);
    }

    /// What it sends and reads.
    pub fn roles(&self) -> u32 {
        self.roles
    }

    /// Counts what was sent, or refused for what it says; that is shown until the next block is sent.
    fn note(&mut self, process: Process, sent: Result<(), Failure>) -> Result<(), Failure> {
        let place = self.processes.iter().position(|p| *p == process);
        let place = place.unwrap_or(SENDERS.len() - 1);
        match &sent {
            Ok(()) => self.heart.tell(|pulse| {
                pulse.sent[place] += 1;
                pulse.refusal[place] = None;
            }),
            Err(failure) if failure.code == Code::Invalid => self.heart.tell(|pulse| {
                pulse.refused[place] += 1;
                pulse.refusal[place] = Some(failure.text.clone());
            }),
            Err(_) => {}
        }
        sent
    }
}

/// When something was measured, by the clock of the driver.
struct Stamp {
    field: &'static str,
    instant_ns: Nanos,
    ahead_ns: u64,
}

impl Stamp {
    /// Of what was measured before it is sent.
    fn taken(field: &'static str, instant_ns: Nanos) -> Self {
        Stamp { field, instant_ns, ahead_ns: 0 }
    }

    /// Of what may be predicted.
    fn predicted(field: &'static str, instant_ns: Nanos) -> Self {
        Stamp { field, instant_ns, ahead_ns: PREDICTED_NS }
    }

    /// Refuses an instant of another clock, or of one that jumped.
    fn check(&self, now: Nanos) -> Result<(), Failure> {
        let Stamp { field, instant_ns, ahead_ns } = *self;
        let (ahead, old) = (instant_ns.saturating_sub(now), now.saturating_sub(instant_ns));
        if ahead <= ahead_ns && old <= OLDEST_NS {
            return Ok(());
        }
        let (off_ns, side) = if ahead > 0 { (ahead, "ahead") } else { (old, "ago") };
        let (past_s, off_s) = (OLDEST_NS / 1_000_000_000, off_ns as f64 * 1e-9);
        let text = format!("{field}: expected the last {past_s} s of vitreo_now, found {off_s:.3} s {side}");
        Err(failure(Code::Invalid, text))
    }
}

fn no_role(what: &str) -> Failure {
    failure(Code::Role, format!("the driver was not opened to {what}: see the roles of vitreo_open"))
}

/// Sends a block that makes sense.
fn send<M: Message>(sender: Option<&mut Sender<M>>, message: &M, stamp: Stamp) -> Result<(), Failure> {
    let sender = sender.ok_or_else(|| no_role(&format!("send {}", M::CHANNEL)))?;
    message.validate()?;
    stamp.check(now())?;
    Ok(sender.send(message)?)
}

/// The next block, as long as it takes but at most `wait_ns`, or until the driver has to stop.
fn next<M: Message>(
    receiver: Option<&mut Receiver<M>>,
    heart: &Heart,
    wait_ns: u64,
) -> Result<Option<M>, Failure> {
    let receiver = receiver.ok_or_else(|| no_role(&format!("read {}", M::CHANNEL)))?;
    let until: Nanos = now().saturating_add(wait_ns);
    loop {
        if let Some(message) = receiver.next_valid()? {
            let counts = receiver.counts();
            heart.tell(|pulse: &mut Pulse| pulse.read = [counts.received, counts.lost, counts.refused]);
            return Ok(Some(message));
        }
        if let Some(why) = heart.stop() {
            return Err(failure(Code::Stop, why));
        }
        let left = until.saturating_sub(now());
        if left == 0 {
            return Ok(None);
        }
        wait(&[&*receiver], left.min(SLICE_NS));
    }
}
