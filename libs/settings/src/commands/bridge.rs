//! The command line of `vitreo bridge`.

use std::fmt::{self, Display, Formatter};
use std::str::FromStr;

/// Where a port without an address listens: programs of this machine alone can connect.
const HERE: &str = "127.0.0.1";

/// An address on which to listen: `PORT` or `HOST:PORT`.
#[derive(Debug, Clone, PartialEq, Eq)]
pub struct Listen {
    /// Name or number of an interface of this machine.
    pub host: String,
    /// 0 leaves the choice to the system.
    pub port: u16,
}

/// Arguments of `vitreo bridge`.
#[derive(Debug, Clone, clap::Args)]
pub struct BridgeArgs {
    /// Serve poses by OpenIGTLink (3D Slicer, PLUS) on this port; 0.0.0.0:PORT lets other machines in.
    #[arg(long, value_name = "[HOST:]PORT", required = true)]
    pub igtl: Option<Listen>,
    /// Version of OpenIGTLink: 3 sends the status of a body with each transform, 1 and 2 as messages beside
    /// them.
    #[arg(long, value_name = "N", default_value_t = 3, value_parser = clap::value_parser!(u8).range(1..=3))]
    pub igtl_version: u8,
    /// Name of the simulator; it may be started later, and anew.
    #[arg(long, value_name = "NAME", default_value = "main")]
    pub instance: String,
}

/// Bridges to other programs: `vitreo` declares them, `vitreo-bridge` carries them out.
#[derive(Debug, clap::Subcommand)]
pub enum BridgeCommand {
    /// Hand the poses of a running simulator on to other programs.
    Bridge(BridgeArgs),
}

impl FromStr for Listen {
    type Err = String;

    fn from_str(text: &str) -> Result<Self, String> {
        let (host, port) = text.rsplit_once(':').unwrap_or((HERE, text));
        match (host.is_empty(), port.parse()) {
            (false, Ok(port)) => Ok(Listen { host: host.into(), port }),
            _ => Err(format!("expected PORT or HOST:PORT, PORT 0 to 65535, found {text:?}")),
        }
    }
}

impl Display for Listen {
    fn fmt(&self, f: &mut Formatter<'_>) -> fmt::Result {
        write!(f, "{}:{}", self.host, self.port)
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn addresses_are_read_and_nonsense_is_refused() {
        for (text, shown) in
            [("18944", "127.0.0.1:18944"), ("0.0.0.0:0", "0.0.0.0:0"), ("[::1]:7", "[::1]:7")]
        {
            assert_eq!(text.parse::<Listen>().unwrap().to_string(), shown);
        }
        for text in ["", "x", "65536", ":7", "host:", "-1"] {
            let told = text.parse::<Listen>().unwrap_err();
            assert!(told.contains("PORT or HOST:PORT") && told.contains(text), "{told}");
        }
    }
}
