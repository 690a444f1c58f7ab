//! The command line of `vitreo bridge`, and the source of `vitreo run --poses`.

use clap::ArgGroup;
use std::fmt::{self, Display, Formatter};
use std::path::PathBuf;
use std::str::FromStr;

/// Default address of a port: only programs on this machine can connect.
const HERE: &str = "127.0.0.1";

/// A local address to listen on: `PORT` or `HOST:PORT`.
#[derive(Debug, Clone, PartialEq, Eq)]
pub struct Listen {
    /// Host name or address of a local interface.
    pub host: String,
    /// Port; 0 lets the system choose.
    pub port: u16,
}

/// Address of another tracker's server, typed as `igtl:HOST:PORT`.
#[derive(Debug, Clone, PartialEq, Eq)]
pub struct Server(String);

/// Another tracker that replaces the cameras and the built-in tracker: `igtl:HOST:PORT[,MAP.toml]`.
#[derive(Debug, Clone, PartialEq, Eq)]
pub struct OtherTracker {
    /// Address of its server.
    pub server: Server,
    /// File that maps its transforms to bodies; `None` for the names that `--igtl` sends.
    pub map: Option<PathBuf>,
}

/// Arguments of `vitreo bridge`.
#[derive(Debug, Clone, clap::Args)]
#[command(group = ArgGroup::new("service").required(true).multiple(true).args(["igtl", "foxglove", "from"]))]
pub struct BridgeArgs {
    /// Serve poses by OpenIGTLink (3D Slicer, PLUS) on this port; 0.0.0.0:PORT accepts other machines.
    #[arg(long, value_name = "[HOST:]PORT")]
    pub igtl: Option<Listen>,
    /// Serve poses, events and the health of the processes to Foxglove, Lichtblick and PlotJuggler (WebSocket)
    /// on this port; 0.0.0.0:PORT accepts other machines.
    #[arg(long, value_name = "[HOST:]PORT")]
    pub foxglove: Option<Listen>,
    /// Read another tracker's poses from its OpenIGTLink server, for a run with --external poses.
    #[arg(long, value_name = "igtl:HOST:PORT", conflicts_with_all = ["igtl", "foxglove"])]
    pub from: Option<Server>,
    /// File that maps the other tracker's transforms to bodies, with their uncertainty (docs/bridge.md)
    /// [default: the names that --igtl sends].
    #[arg(long, value_name = "MAP.toml", requires = "from", conflicts_with_all = ["igtl", "foxglove"])]
    pub map: Option<PathBuf>,
    /// OpenIGTLink version: 3 sends a body's status with each transform, 1 and 2 send it in separate
    /// messages.
    #[arg(long, value_name = "N", default_value_t = 3, value_parser = super::numbers::whole::<u8>(1, 3))]
    pub igtl_version: u8,
    /// Name of the simulator; it may start later than the bridge, and restart.
    #[arg(long, value_name = "NAME", default_value = "main")]
    pub instance: String,
}

/// Bridges to other programs: `vitreo` declares them, `vitreo-bridge` runs them.
#[derive(Debug, clap::Subcommand)]
pub enum BridgeCommand {
    /// Exchange poses between a running simulator and other programs.
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

impl FromStr for Server {
    type Err = String;

    fn from_str(text: &str) -> Result<Self, String> {
        let place = text.strip_prefix("igtl:").and_then(|place| Some((place, place.rsplit_once(':')?)));
        match place {
            Some((place, (host, port))) if !host.is_empty() && port.parse::<u16>().is_ok_and(|p| p > 0) => {
                Ok(Server(place.into()))
            }
            _ => Err(format!("expected igtl:HOST:PORT, PORT 1 to 65535, found {text:?}")),
        }
    }
}

impl FromStr for OtherTracker {
    type Err = String;

    fn from_str(text: &str) -> Result<Self, String> {
        let (server, map) = text.split_once(',').map_or((text, None), |(server, map)| (server, Some(map)));
        if map == Some("") {
            return Err(format!("expected igtl:HOST:PORT,MAP.toml, found {text:?} without a file"));
        }
        Ok(OtherTracker { server: server.parse()?, map: map.map(PathBuf::from) })
    }
}

impl Display for OtherTracker {
    /// Formats the tracker as it is typed.
    fn fmt(&self, f: &mut Formatter<'_>) -> fmt::Result {
        write!(f, "igtl:{}", self.server)?;
        self.map.as_ref().map_or(Ok(()), |map| write!(f, ",{}", map.display()))
    }
}

impl Display for Server {
    /// Formats the address as sockets accept it: `HOST:PORT`.
    fn fmt(&self, f: &mut Formatter<'_>) -> fmt::Result {
        f.write_str(&self.0)
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
    use std::path::Path;

    #[test]
    fn addresses_are_read_and_nonsense_is_refused() {
        for (text, shown) in
            [("18944", "127.0.0.1:18944"), ("0.0.0.0:0", "0.0.0.0:0"), ("[::1]:7", "[::1]:7")]
        {
            assert_eq!(text.parse::<Listen>().unwrap().to_string(), shown);
        }
        for (text, shown) in [("igtl:localhost:18944", "localhost:18944"), ("igtl:[::1]:7", "[::1]:7")] {
            assert_eq!(text.parse::<Server>().unwrap().to_string(), shown);
        }
        for text in ["", "localhost:18944", "igtl:18944", "igtl::7", "igtl:host:0", "igtl:host:x"] {
            assert!(text.parse::<Server>().unwrap_err().contains("expected igtl:HOST:PORT"), "{text}");
        }
        for (text, map) in [("igtl:h:7", None), ("igtl:[::1]:7,a,b.toml", Some("a,b.toml"))] {
            let other: OtherTracker = text.parse().unwrap();
            assert_eq!((other.map.as_deref(), other.to_string()), (map.map(Path::new), text.to_owned()));
        }
        assert!("igtl:h:7,".parse::<OtherTracker>().unwrap_err().contains("without a file"));
        assert!("h:7,a.toml".parse::<OtherTracker>().unwrap_err().contains("expected igtl:HOST:PORT"));
        for text in ["", "x", "65536", ":7", "host:", "-1"] {
            let told = text.parse::<Listen>().unwrap_err();
            assert!(told.contains("PORT or HOST:PORT") && told.contains(text), "{told}");
        }
    }
}
