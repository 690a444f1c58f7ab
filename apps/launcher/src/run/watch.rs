//! Problems of a run besides those of tracking: missing inputs, a slow picture. Pure.

use super::delivery::unheard;
use super::monitor::Monitor;
use super::options::RunArgs;
use diagnosis::{Finding, Tracking};
use protocol::frames::FrameRecord;
use protocol::handles::{HandleState, PedalState};
use protocol::message::Message;
use protocol::poses::TrackerFrame;
use protocol::time::Nanos;

/// Time after the start by which messages of handles and pedal must have arrived, ns.
const INPUT_NS: u64 = 3_000_000_000;
/// Requested rate of stereo frames, Hz: the paper's display shows 85 pictures per second, alternating the
/// channels.
const ASKED_HZ: f64 = 42.5;
/// Share of the requested rate below which the picture is reported as slow.
const SLOW_SHARE: f64 = 0.8;

/// Problems of a run in the last period, `since_ns` after its start, ns.
pub fn findings(args: &RunArgs, tracking: &Tracking, monitor: &Monitor, since_ns: Nanos) -> Vec<Finding> {
    // Nothing is tracked at a desk, or if another tracker delivers the poses.
    let mut found = if args.is_tracked() { tracking.findings().to_vec() } else { Vec::new() };
    found.extend(unheard(args, monitor.traffic_of(TrackerFrame::CHANNEL).count, since_ns));
    if since_ns >= INPUT_NS {
        // A recorded stream contains only blobs and another tracker sends only poses, so neither handles nor
        // pedal is expected; an external driver reports its own problems.
        let outside = args.real.external.is_some() || args.real.poses.is_some();
        let alone = args.virtual_rig.blobs.is_some() || outside;
        found.extend(missing_inputs(monitor).filter(|_| !alone));
        found.extend(slow_picture(monitor));
    }
    found
}

/// Replaces findings about cameras without a picture by the problem that the cameras report themselves.
pub fn replace_by_own_report(trouble: Finding, found: &mut Vec<Finding>) {
    let is_reported = |camera: &str| trouble.what.contains(&format!("{camera} "));
    found.retain(|f| !f.camera_without_picture().is_some_and(is_reported));
    found.push(trouble);
}

fn missing_inputs(monitor: &Monitor) -> impl Iterator<Item = Finding> {
    let expected = [
        (HandleState::CHANNEL, "jaws, cutter and light keep their state"),
        (PedalState::CHANNEL, "suction, cutting and the microscope keep their state"),
    ];
    expected.into_iter().filter(|(channel, _)| monitor.traffic_of(channel).count == 0).map(
        |(name, effect)| Finding {
            what: format!("no message on channel {name}"),
            cause: format!("its driver does not run, so {effect}"),
            remedy: "start the driver, or run vitreo doctor".into(),
            subject: name.into(),
        },
    )
}

fn slow_picture(monitor: &Monitor) -> Option<Finding> {
    let (frame, rate) = (monitor.frame?, monitor.traffic_of(FrameRecord::CHANNEL).rate_hz);
    (rate < SLOW_SHARE * ASKED_HZ).then(|| Finding {
        what: format!("the picture runs at {rate:.0} Hz instead of {ASKED_HZ} Hz"),
        cause: format!(
            "this machine cannot draw 2 × {} × {} px faster while the other processes run",
            frame.width_px, frame.height_px
        ),
        remedy: "end other programs, or use a graphics card; vitreo doctor shows the graphics adapter".into(),
        subject: "picture".into(),
    })
}

#[cfg(test)]
mod tests {
    use super::*;
    use bytemuck::Zeroable;
    use recording::Item;
    use rig::Rig;

    #[test]
    fn a_camera_that_says_what_is_wrong_is_reported_of_once() {
        let finding = |what: &str, subject: &str| {
            let [what, subject] = [what, subject].map(String::from);
            Finding { what, cause: String::new(), remedy: String::new(), subject }
        };
        let mut found = vec![
            finding("no fields come from camera 1", "fields of camera 1"),
            finding("no fields come from camera 11", "fields of camera 11"),
            finding("camera 2 sees no markers", "picture of camera 2"),
            finding("camera 1 is used with a pose estimated from the others", "place of camera 1"),
        ];
        let trouble =
            finding("camera 1 was closed by its writer; camera 2 delivers only black pictures", "cameras");
        replace_by_own_report(trouble, &mut found);
        let subjects: Vec<&str> = found.iter().map(|f| &*f.subject).collect();
        assert_eq!(subjects, ["fields of camera 11", "place of camera 1", "cameras"]);
    }

    #[test]
    fn pedal_handles_and_a_slow_picture_are_missed() {
        let tracking = Tracking::new(&Rig::load_or_shipped(None).unwrap());
        let mut monitor = Monitor::default();
        let subjects = |monitor: &Monitor, since| {
            findings(&RunArgs::default(), &tracking, monitor, since)
                .into_iter()
                .map(|f| f.subject)
                .collect::<Vec<_>>()
        };
        assert!(subjects(&monitor, INPUT_NS - 1).is_empty());
        assert_eq!(subjects(&monitor, INPUT_NS), ["handles", "pedal"]);
        let mut other = RunArgs::default();
        other.real.poses = Some("igtl:h:7".parse().unwrap());
        assert_eq!(findings(&other, &tracking, &monitor, INPUT_NS)[0].subject, "first poses");
        monitor.note(&Item::Poses(Box::new(Zeroable::zeroed())));
        assert!(findings(&other, &tracking, &monitor, INPUT_NS).is_empty());
        monitor.note(&Item::Pedal(Zeroable::zeroed()));
        monitor.note(&Item::Handle(Zeroable::zeroed()));
        monitor.note(&Item::Frame(FrameRecord { displayed: 1, ..FrameRecord::zeroed() }));
        monitor.measure(1_000_000_000);
        assert_eq!(subjects(&monitor, INPUT_NS), ["picture"]);
        (0..50).for_each(|i| {
            monitor.note(&Item::Frame(FrameRecord { displayed: 2 + i, ..FrameRecord::zeroed() }))
        });
        monitor.measure(2_000_000_000);
        assert!(subjects(&monitor, INPUT_NS).is_empty());
    }
}
