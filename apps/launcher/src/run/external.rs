//! External drivers in a run: what they replace, their presence, and warnings if they are missing. The
//! launcher neither starts nor ends nor restarts them. Pure.

use super::options::RunArgs;
use super::supervisor::{Slot, Supervisor};
use crate::exit::WrongUse;
use diagnosis::Finding;
use protocol::health::{Health, Process, STATE_DEGRADED, STATE_FINISHED};
use protocol::time::Nanos;

/// A driver without a heartbeat for this long is considered disconnected, ns: ten heartbeats.
const GONE_NS: u64 = 1_000_000_000;
/// A driver that sends no block for this long is considered silent, ns.
const SILENT_NS: u64 = 1_000_000_000;

/// Checks `--external` against the other options.
///
/// # Errors
/// If `--external` conflicts with `--poses` or an option of the cameras, or replaces the cameras without
/// `--rig`.
pub fn check(args: &RunArgs) -> anyhow::Result<()> {
    let Some(external) = &args.real.external else { return Ok(()) };
    if let (Some(other), Some(source)) = (&args.real.poses, external.source().and_then(Process::drives)) {
        let problem =
            format!("--poses {other}, --external {source}: only one of them can be the source of poses");
        return Err(WrongUse(problem).into());
    }
    let wrong = |problem: &str| Err(WrongUse(format!("--external {external}: {problem}")).into());
    let cameras = &args.virtual_rig;
    if external.source().is_none() {
        return if args.real.program().is_some() {
            wrong("the program of --cameras sends handles and pedal itself")
        } else {
            Ok(())
        };
    }
    let others = [
        ("--cameras", args.real.given().is_some()),
        ("--blobs", cameras.blobs.is_some()),
        ("--motion", cameras.motion.is_some()),
        ("--faults", cameras.faults.is_some()),
        ("--direct", cameras.direct),
    ];
    match others.into_iter().find(|(_, given)| *given) {
        Some((option, _)) => wrong(&format!("it replaces the cameras; omit {option}")),
        None if args.rig.rig.is_none() => wrong("it needs the rig of its cameras: --rig RIG.json"),
        None => Ok(()),
    }
}

/// Connection state of a driver.
#[derive(Debug, Default)]
pub struct Presence {
    /// Process id of the driver; 0 if disconnected.
    pid: u32,
    was_there: bool,
    /// Number of blocks that the driver has sent.
    sent: u64,
    /// Time of the newest block, or of the connection, ns.
    sent_ns: Nanos,
}

impl Presence {
    /// Adds a heartbeat; true for the first one of a process.
    pub fn note(&mut self, beat: &Health, now: Nanos) -> bool {
        let came = beat.pid != self.pid;
        if came || beat.sent != self.sent || beat.state == STATE_FINISHED {
            (self.sent, self.sent_ns) = (beat.sent, now);
        }
        (self.pid, self.was_there) = (beat.pid, true);
        came
    }

    /// True once after each disconnection: when no heartbeat has arrived since `last_sign_ns` for
    /// [`GONE_NS`].
    pub fn has_gone(&mut self, last_sign_ns: Nanos, now: Nanos) -> bool {
        let gone = self.pid != 0 && now.saturating_sub(last_sign_ns) > GONE_NS;
        if gone {
            self.pid = 0;
        }
        gone
    }

    /// True if the driver is disconnected.
    pub fn is_away(&self) -> bool {
        self.pid == 0
    }

    /// True if the driver is disconnected or sends nothing.
    pub fn is_silent(&self, now: Nanos) -> bool {
        self.pid == 0 || now.saturating_sub(self.sent_ns) > SILENT_NS
    }

    /// The driver's problem, if it has one.
    pub fn trouble(&self, driver: Process, health: Option<&Health>, now: Nanos) -> Option<Finding> {
        let channel = driver.drives().unwrap_or_default();
        let finding = |what: String, cause: &str, remedy: &str| {
            let subject = driver.name().into();
            Some(Finding { what, cause: cause.into(), remedy: remedy.into(), subject })
        };
        let words = health.map(Health::text).unwrap_or_default();
        if self.pid == 0 {
            let what = match self.was_there {
                true => format!("the program that sends {channel} has disconnected"),
                false => format!("no program that sends {channel} has connected"),
            };
            return finding(
                what,
                "--external expects it from another program, which the launcher does not start",
                "start it (docs/drivers.md); the run continues and reconnects",
            );
        }
        if self.is_silent(now) {
            let what = format!("{words} sends nothing on {channel}");
            return finding(what, "it runs, but hangs or has nothing to send", "check it; the run continues");
        }
        let degraded = health.is_some_and(|health| health.state == STATE_DEGRADED);
        let what = format!("{channel}: {words}");
        degraded.then(|| finding(what, "reported by its driver", "check it; the run continues")).flatten()
    }
}

impl Supervisor {
    /// Problems of all external drivers.
    pub fn trouble_of_drivers(&self, now: Nanos) -> Vec<Finding> {
        let trouble = |s: &Slot| s.presence.as_ref()?.trouble(s.process, s.health.as_ref(), now);
        self.slots.iter().filter_map(trouble).collect()
    }

    /// Problem that the bridge to another tracker reports.
    pub fn trouble_of_other_tracker(&self) -> Option<Finding> {
        self.args.real.poses.as_ref()?;
        let bridge = self.slots.iter().find(|s| s.process == Process::PosesDriver)?;
        let health = bridge.health.filter(|h| h.state == STATE_DEGRADED)?;
        Some(Finding {
            what: health.text(),
            cause: "its server, the network, or the address in --poses; missing poses are lost".into(),
            remedy: "check it; the run continues and reconnects by itself".into(),
            // With another subject, a different problem is reported again.
            subject: format!("other tracker: {}", health.text()),
        })
    }

    /// True if the driver is disconnected or sends nothing.
    pub fn lacks(&self, driver: Process, now: Nanos) -> bool {
        let presence = self.slots.iter().find(|s| s.process == driver).and_then(|s| s.presence.as_ref());
        presence.is_some_and(|presence| presence.is_silent(now))
    }

    /// Status text of a driver's newest heartbeat.
    pub fn status_text_of(&self, driver: Process) -> String {
        let slot = self.slots.iter().find(|s| s.process == driver);
        slot.and_then(|s| s.health).map(|h| h.text()).unwrap_or_default()
    }
}

/// Message while an external driver has not connected.
pub fn waiting_for(instance: &str, channels: &[&str]) -> String {
    let channels = channels.join(", ");
    format!(
        "waiting for a program that sends {channels}: it opens the instance '{instance}' (docs/drivers.md)"
    )
}

#[cfg(test)]
mod tests {
    use super::*;
    use bytemuck::Zeroable;
    use protocol::health::STATE_RUNNING;
    use protocol::message::text_bytes;

    const MS: u64 = 1_000_000;

    #[test]
    fn a_driver_comes_falls_silent_goes_and_comes_back() {
        let mut presence = Presence::default();
        let trouble = |p: &Presence, beat: Option<&Health>, ms: u64| {
            p.trouble(Process::PedalDriver, beat, ms * MS).map(|f| f.what).unwrap_or_default()
        };
        assert_eq!(trouble(&presence, None, 0), "no program that sends pedal has connected");
        assert!(!presence.has_gone(0, 9_000 * MS), "what never came does not go");
        let mut beat = Health { pid: 7, sent: 1, state: STATE_RUNNING, ..Health::zeroed() };
        beat.text = text_bytes("switch");
        assert!(presence.note(&beat, 10 * MS) && !presence.note(&beat, 110 * MS));
        assert_eq!(trouble(&presence, Some(&beat), 500), "");
        assert!(presence.is_silent(1_200 * MS));
        assert_eq!(trouble(&presence, Some(&beat), 1_200), "switch sends nothing on pedal");
        let degraded = Health { sent: 2, state: STATE_DEGRADED, ..beat };
        presence.note(&degraded, 1_300 * MS);
        assert_eq!(trouble(&presence, Some(&degraded), 1_400), "pedal: switch");
        assert!(presence.has_gone(1_300 * MS, 2_400 * MS) && !presence.has_gone(1_300 * MS, 2_500 * MS));
        assert_eq!(
            trouble(&presence, Some(&degraded), 2_500),
            "the program that sends pedal has disconnected"
        );
        let next = Health { pid: 8, sent: 0, ..beat };
        assert!(presence.note(&next, 3_000 * MS), "another process");
        assert_eq!(trouble(&presence, Some(&next), 3_100), "");
    }

    #[test]
    fn what_stands_in_the_place_of_cameras_excludes_them() {
        let args = |words: &[&str]| {
            let mut args = RunArgs::default();
            args.real.external = Some(words[0].parse().unwrap());
            args.real.cameras = words.get(1).map(|w| w.parse().unwrap());
            args.rig.rig = words.get(2).map(Into::into);
            check(&args).err().map(|e| e.to_string()).unwrap_or_default()
        };
        assert_eq!(args(&["pedal"]), "");
        assert_eq!(args(&["handles", "y4m:a"]), "");
        assert!(args(&["handles", "driver"]).contains("sends handles and pedal itself"));
        assert!(args(&["blobs"]).contains("--rig"));
        assert!(args(&["blobs,pedal", "y4m:a", "r.json"]).contains("omit --cameras"));
        assert_eq!(args(&["poses", "virtual", "r.json"]), "");
        let beside = |external: &str| {
            let mut args = RunArgs::default();
            args.real.external = Some(external.parse().unwrap());
            args.real.poses = Some("igtl:h:7".parse().unwrap());
            check(&args).err().map(|e| e.to_string()).unwrap_or_default()
        };
        assert_eq!(beside("handles,pedal"), "");
        assert!(beside("blobs").contains("--poses igtl:h:7, --external blobs: only one"));
        assert!(beside("pedal,poses").contains("--external poses: only one"));
    }

    #[test]
    fn what_is_awaited_is_named_with_the_instance() {
        let text = waiting_for("main", &["blobs", "pedal"]);
        assert!(text.starts_with("waiting for a program that sends blobs, pedal") && text.contains("'main'"));
    }
}
