//! Channels that external drivers feed: `--external`.

use protocol::handles::ControlChannels;
use protocol::health::Process;
use std::fmt::{self, Display, Formatter};
use std::str::FromStr;

/// Channels that external drivers feed, in the order of the data path.
#[derive(Debug, Clone, PartialEq, Eq)]
pub struct External(Vec<Process>);

impl External {
    /// The expected drivers, one per channel.
    pub fn drivers(&self) -> &[Process] {
        &self.0
    }

    /// Names of the channels.
    pub fn channels(&self) -> Vec<&'static str> {
        self.0.iter().filter_map(|driver| driver.drives()).collect()
    }

    /// True if this driver is expected.
    pub fn has(&self, driver: Process) -> bool {
        self.0.contains(&driver)
    }

    /// The driver that replaces the cameras and possibly the stages after them.
    pub fn source(&self) -> Option<Process> {
        let sources = [Process::BlobsDriver, Process::FieldsDriver, Process::PosesDriver];
        self.0.iter().copied().find(|driver| sources.contains(driver))
    }

    /// The channels of handles and pedal that external drivers write instead of the cameras; `None` if there
    /// are none.
    pub fn controls(&self) -> Option<ControlChannels> {
        let (handles, pedal) = (self.has(Process::HandlesDriver), self.has(Process::PedalDriver));
        (handles || pedal).then_some(ControlChannels { handles, pedal })
    }
}

impl FromStr for External {
    type Err = String;

    fn from_str(text: &str) -> Result<Self, String> {
        let mut drivers = Vec::new();
        for name in text.split(',') {
            let driver = Process::DRIVERS.into_iter().find(|d| d.drives() == Some(name));
            let expected = "expected blobs, fields, handles, pedal or poses, separated by commas";
            let driver = driver.ok_or_else(|| format!("{expected}, found {name:?}"))?;
            if drivers.contains(&driver) {
                return Err(format!("{name} is named twice in {text:?}"));
            }
            drivers.push(driver);
        }
        drivers.sort_by_key(|driver| *driver as u32);
        let external = External(drivers);
        let sources = [Process::BlobsDriver, Process::FieldsDriver, Process::PosesDriver];
        if sources.into_iter().filter(|driver| external.has(*driver)).count() > 1 {
            return Err(format!("expected only one of blobs, fields and poses, found {text:?}"));
        }
        Ok(external)
    }
}

impl Display for External {
    fn fmt(&self, f: &mut Formatter<'_>) -> fmt::Result {
        f.write_str(&self.channels().join(","))
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn what_comes_from_outside_is_read_and_nonsense_is_refused() {
        let external: External = "pedal,blobs,handles".parse().unwrap();
        assert_eq!(external.to_string(), "blobs,handles,pedal");
        assert_eq!(external.source(), Some(Process::BlobsDriver));
        assert_eq!(external.controls(), Some(ControlChannels { handles: true, pedal: true }));
        let pedal: External = "pedal".parse().unwrap();
        assert_eq!((pedal.source(), pedal.controls().map(|c| c.to_string())), (None, Some("pedal".into())));
        assert_eq!("poses".parse::<External>().unwrap().controls(), None);
        for (text, named) in [
            ("", "expected blobs"),
            ("blobs,", "expected blobs"),
            ("events", "found \"events\""),
            ("pedal,pedal", "twice"),
            ("blobs,poses", "only one of"),
            ("fields,blobs", "only one of"),
        ] {
            let told = text.parse::<External>().unwrap_err();
            assert!(told.contains(named), "{text}: {told}");
        }
    }
}
