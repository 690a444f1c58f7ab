//! Problems of a run besides tracking: missing inputs, a slow picture. Pure.

use super::delivery::unheard;
use super::monitor::Monitor;
use super::options::RunArgs;
use diagnosis::{Finding, Tracking};
use protocol::time::Nanos;

/// Time after the start within which a handle or pedal must have come, ns.
const INPUT_NS: u64 = 3_000_000_000;
/// Index of the poses in [`CHANNELS`](super::monitor::CHANNELS).
const POSES: usize = 3;
/// Stereo frames a second that are asked for: the paper's display shows 85 pictures a second, one
/// channel after the other.
const ASKED_HZ: f64 = 42.5;
/// Share of the requested rate below which the picture is reported as slow.
const SLOW_SHARE: f64 = 0.8;

/// What is wrong with a run in the newest period, `since_ns` after its start.
pub fn findings(args: &RunArgs, tracking: &Tracking, monitor: &Monitor, since_ns: Nanos) -> Vec<Finding> {
    // At a desk, or where poses come from outside, nothing is tracked.
    let mut found = if args.is_tracked() { tracking.findings().to_vec() } else { Vec::new() };
    found.extend(unheard(args, monitor.traffic[POSES].count, since_ns));
    if since_ns >= INPUT_NS {
        // A recorded stream brings blobs alone, another tracker poses, and a driver what it says.
        let outside = args.real.external.is_some() || args.real.poses.is_some();
        let alone = args.virtual_rig.blobs.is_some() || outside;
        found.extend(missing_inputs(monitor).filter(|_| !alone));
        found.extend(slow_picture(monitor));
    }
    found
}

/// Adds what cameras say of themselves, in place of what was found out about the same cameras.
pub fn say_for_themselves(trouble: Finding, found: &mut Vec<Finding>) {
    let is_told = |camera: &str| trouble.what.contains(&format!("{camera} "));
    found.retain(|f| !f.camera_without_picture().is_some_and(is_told));
    found.push(trouble);
}

fn missing_inputs(monitor: &Monitor) -> impl Iterator<Item = Finding> {
    let expected = [
        (1, "handles", "jaws, cutter and light keep their state"),
        (2, "pedal", "suction, cutting and the microscope keep their state"),
    ];
    expected.into_iter().filter(|(channel, ..)| monitor.traffic[*channel].count == 0).map(
        |(_, name, effect)| Finding {
            what: format!("no message on channel {name}"),
            cause: format!("its driver does not run, so {effect}"),
            remedy: "start the driver, or run vitreo doctor".into(),
            subject: name.into(),
        },
    )
}

fn slow_picture(monitor: &Monitor) -> Option<Finding> {
    let (frame, rate) = (monitor.frame?, monitor.traffic[5].rate_hz);
    (rate < SLOW_SHARE * ASKED_HZ).then(|| Finding {
        what: format!("the picture runs at {rate:.0} Hz instead of {ASKED_HZ} Hz"),
        cause: format!(
            "this machine draws 2 × {} × {} px no faster beside the other processes",
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
    use protocol::frames::FrameRecord;
    use recording::Item;
    use rig::Rig;

    #[test]
    fn a_camera_that_says_what_is_wrong_is_told_of_once() {
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
        say_for_themselves(trouble, &mut found);
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
