//! Sources outside of the run that deliver no poses: their report, and the time after which a run gives up.
//! Pure.

use super::options::RunArgs;
use super::report::Report;
use diagnosis::Finding;
use protocol::time::Nanos;

/// Time without any pose after which a source is reported, ns.
pub const UNHEARD_NS: u64 = 3_000_000_000;
/// Minimum time for which a run with a duration waits for its source, ns, because programs take time to
/// start.
const PATIENCE_NS: u64 = 30_000_000_000;

impl RunArgs {
    /// Source outside of the run from which the poses come, as given on the command line; `None` if the run
    /// simulates its cameras or gets its poses from a desk.
    pub fn outside_source(&self) -> Option<String> {
        if self.desk.is_some() {
            return None;
        }
        let poses = self.real.poses.as_ref().map(ToString::to_string);
        let blobs = self.virtual_rig.blobs.as_ref().map(|blobs| format!("--blobs {}", blobs.display()));
        let external = self.real.external.as_ref().filter(|external| external.source().is_some());
        let cameras = self.real.given().map(|cameras| format!("--cameras {cameras}"));
        poses.or(blobs).or(external.map(|external| format!("--external {external}"))).or(cameras)
    }

    /// Maximum wait for the source, ns; `None` for a run without a duration, which waits without limit.
    pub fn patience_ns(&self) -> Option<u64> {
        self.outside_source()?;
        self.duration.map(|s| ((s * 1e9) as u64).max(PATIENCE_NS))
    }
}

/// Finding for a source from which no pose has come in the `since_ns` since the run began, ns.
pub fn unheard(args: &RunArgs, poses: u64, since_ns: Nanos) -> Option<Finding> {
    let source = args.outside_source().filter(|_| poses == 0 && since_ns >= UNHEARD_NS)?;
    let sends = if args.real.poses.is_some() { "is the tracker sending?" } else { "is it sending?" };
    Some(Finding {
        what: format!("no poses from {source} for {:.0} s", since_ns as f64 * 1e-9),
        cause: format!("{sends} nothing of use has come since the start"),
        remedy: "check its writer, address and network; the run continues and uses poses when they arrive"
            .into(),
        subject: "first poses".into(),
    })
}

/// Message about a source that has been awaited for `since_ns`, ns; `says` is the status text of its process.
pub fn awaited(source: &str, says: &str, since_ns: Nanos) -> String {
    let says = if says.is_empty() { "is it sending?" } else { says };
    format!(
        "nothing from {source} for {:.0} s: {says}; the run starts when data arrive",
        since_ns as f64 * 1e-9
    )
}

/// Error of a finished run that received no pose from its source. `None` for a run that waits for a user by
/// design (`--unscripted`).
pub fn never_came(args: &RunArgs, report: &Report) -> Option<String> {
    let count = |channel| report.received.get(channel).copied().unwrap_or(0);
    let source = args.outside_source().filter(|_| count("poses") == 0 && !args.real.unscripted)?;
    let says = report.processes.iter().find(|p| p.process == args.source().name()).map(|p| p.text.clone());
    let says = says.unwrap_or_default();
    let says = if says.is_empty() { String::new() } else { format!(" ({says})") };
    let what = match count("blobs") {
        0 => "nothing of use".to_owned(),
        fields => format!("{fields} camera-fields, and no frame of them,"),
    };
    Some(format!("no pose was computed in this run: {what} came from {source}{says}"))
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::run::report::tests::report;

    const S: u64 = 1_000_000_000;

    fn other_tracker() -> RunArgs {
        let mut args = RunArgs::default();
        args.real.poses = Some("igtl:h:7".parse().unwrap());
        args
    }

    #[test]
    fn every_source_from_outside_is_named_as_it_was_given() {
        let named = |set: fn(&mut RunArgs)| {
            let mut args = RunArgs::default();
            set(&mut args);
            args.outside_source().unwrap_or_default()
        };
        assert_eq!(named(|_| {}), "");
        assert_eq!(named(|a| a.real.poses = Some("igtl:h:7".parse().unwrap())), "igtl:h:7");
        assert_eq!(named(|a| a.virtual_rig.blobs = Some("tcp:9".into())), "--blobs tcp:9");
        assert_eq!(named(|a| a.real.cameras = Some("y4m:a,y4m:b".parse().unwrap())), "--cameras y4m:a,y4m:b");
        assert_eq!(named(|a| a.real.cameras = Some("virtual".parse().unwrap())), "");
        assert_eq!(named(|a| a.real.external = Some("blobs".parse().unwrap())), "--external blobs");
        // Only the pedal is external; the cameras are simulated.
        assert_eq!(named(|a| a.real.external = Some("pedal".parse().unwrap())), "");
    }

    #[test]
    fn a_tracker_that_sends_nothing_is_reported_after_three_seconds() {
        let args = other_tracker();
        assert!(unheard(&args, 0, UNHEARD_NS - 1).is_none() && unheard(&args, 1, UNHEARD_NS).is_none());
        let found = unheard(&args, 0, UNHEARD_NS).unwrap();
        assert_eq!(found.what, "no poses from igtl:h:7 for 3 s");
        assert!(found.cause.starts_with("is the tracker sending?"), "{}", found.cause);
        assert!(unheard(&RunArgs::default(), 0, UNHEARD_NS).is_none());
        assert!(awaited("--cameras y4m:a", "camera 0 is shut", 3 * S).contains("for 3 s: camera 0 is shut;"));
    }

    #[test]
    fn a_run_without_one_pose_has_failed() {
        let (mut args, mut report) = (other_tracker(), report());
        let text = never_came(&args, &report).unwrap();
        assert_eq!(text, "no pose was computed in this run: nothing of use came from igtl:h:7");
        report.received.insert("blobs", 9);
        assert!(never_came(&args, &report).unwrap().contains("9 camera-fields, and no frame of them"));
        report.received.insert("poses", 1);
        assert_eq!(never_came(&args, &report), None);
        report.received.clear();
        args.real.unscripted = true;
        assert_eq!(never_came(&args, &report), None);
        assert_eq!(never_came(&RunArgs::default(), &report), None, "its own cameras");
    }

    #[test]
    fn a_run_with_an_end_does_not_wait_for_ever() {
        let mut args = other_tracker();
        assert_eq!(args.patience_ns(), None);
        args.duration = Some(5.0);
        assert_eq!(args.patience_ns(), Some(30 * S));
        args.duration = Some(60.0);
        assert_eq!(args.patience_ns(), Some(60 * S));
        assert_eq!(RunArgs { duration: Some(5.0), ..RunArgs::default() }.patience_ns(), None);
    }
}
