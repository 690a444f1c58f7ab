//! Sources of `--blobs`: a file, a pipe, standard input, or a TCP port that waits for a writer.

use protocol::file::STDIN;
use std::fs::{File, metadata};
use std::io::IsTerminal;
use std::net::{SocketAddr, ToSocketAddrs};
use std::os::unix::fs::FileTypeExt;
use std::path::{Path, PathBuf};

/// Prefix of a port. A file whose name begins like this is written `./tcp:…`.
const TCP: &str = "tcp:";
/// Address of a port without a host: only programs on this machine can connect.
const HERE: &str = "127.0.0.1";

/// Source of a stream of blobs.
#[derive(Debug, Clone, PartialEq, Eq)]
pub enum BlobSource {
    /// A file, a pipe or a terminal.
    Path(PathBuf),
    /// A listening socket at this `HOST:PORT`, for the program that connects to it.
    Tcp(String),
}

impl BlobSource {
    /// Parses the value of `--blobs`.
    ///
    /// # Errors
    /// If the text after `tcp:` is not a port or a host with a port.
    pub fn of(given: &Path) -> Result<Self, String> {
        let Some(address) = given.to_str().and_then(|text| text.strip_prefix(TCP)) else {
            return Ok(BlobSource::Path(given.to_owned()));
        };
        let (host, port) = address.rsplit_once(':').unwrap_or((HERE, address));
        let expected = "expected tcp:PORT or tcp:HOST:PORT, PORT 0 to 65535";
        match (host.is_empty(), port.parse::<u16>()) {
            (false, Ok(port)) => Ok(BlobSource::Tcp(format!("{host}:{port}"))),
            _ => Err(format!("{expected}, found '{TCP}{address}'")),
        }
    }

    /// True if a stream is read while it is written, false for a file that is played.
    pub fn is_live(&self) -> bool {
        let path = match self {
            BlobSource::Tcp(_) => return true,
            BlobSource::Path(path) if path.as_os_str() == STDIN => Path::new("/dev/stdin"),
            BlobSource::Path(path) => path,
        };
        let Ok(kind) = metadata(path).map(|about| about.file_type()) else { return false };
        kind.is_fifo() || kind.is_char_device() && File::open(path).is_ok_and(|file| file.is_terminal())
    }
}

/// Resolves `HOST:PORT`.
///
/// # Errors
/// If it does not resolve.
pub fn addresses(host_and_port: &str) -> std::io::Result<Vec<SocketAddr>> {
    Ok(host_and_port.to_socket_addrs()?.collect())
}

/// Checks the value of `--blobs` and returns it unchanged.
///
/// # Errors
/// If it is an invalid port.
pub fn blob_source(given: &str) -> Result<PathBuf, String> {
    BlobSource::of(Path::new(given)).map(|_| given.into())
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn ports_are_told_from_files_and_wrong_ones_refused() {
        let of = |given: &str| BlobSource::of(Path::new(given));
        let tcp = |address: &str| Ok(BlobSource::Tcp(address.into()));
        assert_eq!(of("tcp:4100"), tcp("127.0.0.1:4100"));
        assert_eq!(of("tcp:0.0.0.0:0"), tcp("0.0.0.0:0"));
        assert_eq!(of("tcp:[::1]:7"), tcp("[::1]:7"));
        assert_eq!(of("./tcp:7"), Ok(BlobSource::Path("./tcp:7".into())));
        for wrong in ["tcp:", "tcp:x", "tcp:65536", "tcp::7", "tcp:host:", "tcp:-1"] {
            let refused = blob_source(wrong).unwrap_err();
            assert!(refused.contains("tcp:HOST:PORT") && refused.contains(wrong), "{refused}");
        }
        assert_eq!(addresses("127.0.0.1:9").unwrap(), [SocketAddr::from(([127, 0, 0, 1], 9))]);
    }

    #[test]
    fn pipes_and_ports_are_live_and_files_are_not() {
        let folder = tempfile::tempdir().unwrap();
        let (file, fifo) = (folder.path().join("b.jsonl"), folder.path().join("fifo"));
        std::fs::write(&file, "").unwrap();
        assert!(std::process::Command::new("mkfifo").arg(&fifo).status().unwrap().success());
        let live = |path: &Path| BlobSource::of(path).unwrap().is_live();
        assert!(!live(&file) && live(&fifo) && live(Path::new("tcp:1")) && !live(Path::new("/nonexistent")));
    }
}
