//! The encoders in the handles: how far the jaws are open at a count.

use super::{Defect, Rig};
use protocol::limits::INSTRUMENTS;
use serde::{Deserialize, Serialize};

/// Fewer counts between closed and open jaws are noise.
const LEAST_SPAN: u64 = 8;
/// Smallest and largest opening of open jaws, rad.
const OPENINGS_RAD: [f64; 2] = [0.02, 2.0];

/// The encoder of one handle. Between its two counts the opening goes in proportion.
#[derive(Debug, Clone, Copy, PartialEq, Serialize, Deserialize)]
#[serde(deny_unknown_fields)]
pub struct RigHandle {
    /// Whose handle: 0 or 1.
    pub instrument: u32,
    /// Count of the encoder with closed jaws.
    pub closed: i32,
    /// Count with open jaws; less than `closed` where the encoder counts the other way.
    pub open: i32,
    /// Opening of open jaws, rad.
    pub open_rad: f64,
}

impl RigHandle {
    /// Opening of the jaws at a count, rad: 0 to [`RigHandle::open_rad`].
    pub fn jaw_rad(&self, count: i32) -> f64 {
        let [closed, open, count] = [self.closed, self.open, count].map(f64::from);
        ((count - closed) / (open - closed)).clamp(0.0, 1.0) * self.open_rad
    }
}

impl Rig {
    /// The encoder of an instrument's handle.
    pub fn handle(&self, instrument: u32) -> Option<&RigHandle> {
        self.handles.iter().find(|h| h.instrument == instrument)
    }

    /// What is wrong with the encoders of the handles.
    pub(super) fn defect_of_handles(&self) -> Option<Defect> {
        self.handles.iter().enumerate().find_map(|(i, handle)| {
            let twice = self.handles[..i].iter().any(|h| h.instrument == handle.instrument);
            let known = (handle.instrument as usize) < INSTRUMENTS && !twice;
            let apart = u64::from(handle.open.abs_diff(handle.closed)) >= LEAST_SPAN;
            let counts = format!("{} and {}", handle.closed, handle.open);
            let opens = (OPENINGS_RAD[0]..=OPENINGS_RAD[1]).contains(&handle.open_rad);
            let checks = [
                (known, "instrument", "0 or 1, each once", handle.instrument.to_string()),
                (apart, "closed, open", "counts that are at least 8 apart", counts),
                (opens, "open_rad", "0.02 to 2 rad", handle.open_rad.to_string()),
            ];
            let (_, key, expected, found) = checks.into_iter().find(|(holds, ..)| !holds)?;
            Some((format!("handles[{i}].{key}"), expected, found))
        })
    }
}

#[cfg(test)]
mod tests {
    use crate::{Rig, SHIPPED};

    fn with(handles: &str) -> Result<Rig, String> {
        let text = SHIPPED.trim_end().strip_suffix('}').expect("an object");
        Rig::parse(&format!("{text}, \"handles\": {handles}}}"), "r.json").map_err(|e| e.to_string())
    }

    #[test]
    fn counts_become_openings_whichever_way_they_go() {
        let rig = with(
            r#"[{"instrument": 0, "closed": 100, "open": 1100, "open_rad": 0.8},
                {"instrument": 1, "closed": 7, "open": -2147483648, "open_rad": 0.5}]"#,
        )
        .unwrap();
        let jaw = |i, count| rig.handle(i).unwrap().jaw_rad(count);
        assert_eq!([jaw(0, 100), jaw(0, 600), jaw(0, 1100)], [0.0, 0.4, 0.8]);
        assert_eq!([jaw(0, i32::MIN), jaw(0, i32::MAX)], [0.0, 0.8]);
        assert_eq!([jaw(1, 8), jaw(1, i32::MIN)], [0.0, 0.5]);
        assert_eq!(Rig::parse(&rig.to_json(), "again").unwrap(), rig);
        assert!(Rig::parse(SHIPPED, "s").unwrap().handle(0).is_none());
        assert!(
            !Rig::parse(SHIPPED, "s").unwrap().to_json().contains("\"handles\""),
            "old rigs are as before"
        );
    }

    #[test]
    fn what_cannot_be_is_refused_by_name() {
        let one = |instrument: &str, closed: &str, open: &str, rad: &str| {
            let keys = format!("\"closed\": {closed}, \"open\": {open}, \"open_rad\": {rad}");
            format!("{{\"instrument\": {instrument}, {keys}}}")
        };
        let good = one("0", "0", "100", "0.9");
        for (handles, named) in [
            (one("2", "0", "100", "0.9"), "handles[0].instrument: expected 0 or 1, each once, found 2"),
            (format!("{good}, {good}"), "handles[1].instrument: expected 0 or 1, each once, found 0"),
            (
                one("0", "50", "43", "0.9"),
                "handles[0].closed, open: expected counts that are at least 8 apart",
            ),
            (one("0", "0", "100", "0"), "handles[0].open_rad: expected 0.02 to 2 rad, found 0"),
            (one("0", "0", "100", "45.0"), "open_rad: expected 0.02 to 2 rad, found 45"),
            (one("0", "0.5", "100", "0.9"), "expected a whole number, found 0.5"),
            (good.replace("open_rad", "open_deg"), "open_deg"),
        ] {
            let told = with(&format!("[{handles}]")).unwrap_err();
            assert!(told.contains("r.json") && told.contains(named), "{handles}: {told}");
        }
    }
}
