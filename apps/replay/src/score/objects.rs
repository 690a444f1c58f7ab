//! Recordings and tables that lie in an object store, under addresses like `s3://bucket/key`.
//!
//! The store itself ([`Store`]) is only in builds with the feature `object-store`, which brings an
//! HTTP client and TLS along; in others every address is refused and the message says what to build.
//! A recording is copied into a file without a name before it is read, so that one that is killed
//! leaves nothing behind.

#[cfg(not(feature = "object-store"))]
mod absent;
#[cfg(feature = "object-store")]
mod s3;

#[cfg(not(feature = "object-store"))]
pub use absent::Store;
#[cfg(feature = "object-store")]
pub use s3::Store;

use results::listing::{RECORDING, is_address};
use std::fmt;
use std::fs::File;
use std::os::fd::AsRawFd;
use std::path::{Path, PathBuf};

/// The only kind of address that is read.
const SCHEME: &str = "s3://";

/// Why an object cannot be had or put.
#[derive(Debug, thiserror::Error)]
pub enum ObjectError {
    /// This build has no object store.
    #[error(
        "{0}: this vitreo was built without object stores; \
         cargo build --release -p replay --features object-store builds one that has them"
    )]
    NotBuilt(String),
    /// Not an address of an object.
    #[error("{name}: expected s3://BUCKET/KEY, {problem}")]
    Address {
        /// As it was given.
        name: String,
        /// What is wrong with it.
        problem: String,
    },
    /// The settings of the store (`AWS_…`) make no sense.
    #[error("{address}: the object store's settings (AWS_…): {problem}")]
    Settings {
        /// What was asked for.
        address: String,
        /// What is wrong.
        problem: String,
    },
    /// There is no such object.
    #[error("{0}: no such object")]
    Absent(String),
    /// It was listed but no longer exists.
    #[error("{0}: was listed but no longer exists")]
    Gone(String),
    /// It was listed, and had changed before it was read.
    #[error("{0}: has changed since it was listed")]
    Changed(String),
    /// The store accepts the credentials but refuses this request.
    #[error("{address}: the object store refuses it: {problem}")]
    Refused {
        /// What was asked for.
        address: String,
        /// Its answer.
        problem: String,
    },
    /// The store rejects the credentials, or they have expired.
    #[error("{address}: the object store rejects the credentials (AWS_…): {problem}")]
    Credentials {
        /// What was asked for.
        address: String,
        /// Its answer.
        problem: String,
    },
    /// There is no such bucket.
    #[error("{address}: no such bucket: '{bucket}'")]
    NoBucket {
        /// What was asked for.
        address: String,
        /// The bucket.
        bucket: String,
    },
    /// An object of that name exists.
    #[error("{0}: already exists; use --force to overwrite it")]
    Exists(String),
    /// The store did not answer, or not to the end, after several tries.
    #[error("{address}: the object store cannot be reached: {problem}")]
    Unreachable {
        /// What was asked for.
        address: String,
        /// Why.
        problem: String,
    },
    /// A text is longer than any should be.
    #[error("{address}: expected text of at most {limit} bytes, found {found}")]
    Text {
        /// The object.
        address: String,
        /// Most bytes.
        limit: u64,
        /// What was found.
        found: String,
    },
    /// The copy on this machine cannot be written.
    #[error("{address}: its copy in {}: {problem}", std::env::temp_dir().display())]
    Copy {
        /// The object.
        address: String,
        /// Why.
        problem: std::io::Error,
    },
}

impl ObjectError {
    /// Whether it is this one object that cannot be had. Anything else would be wrong of others as
    /// well, and is no finding about a recording.
    pub fn is_of_object(&self) -> bool {
        use ObjectError::{Absent, Address, Changed, Gone, Refused};
        matches!(self, Absent(_) | Gone(_) | Changed(_) | Refused { .. } | Address { .. })
    }

    /// Whether something was asked for that there cannot be.
    pub fn is_wrong_use(&self) -> bool {
        matches!(self, ObjectError::NotBuilt(_) | ObjectError::Address { .. } | ObjectError::Settings { .. })
    }
}

/// Where an object lies, or with a key that is empty or ends with `/` all below.
#[derive(Debug, Clone, PartialEq, Eq, PartialOrd, Ord, Hash)]
pub struct Address {
    /// The bucket.
    pub bucket: String,
    /// The key, without a slash at its begin.
    pub key: String,
}

impl Address {
    /// Reads `s3://BUCKET/KEY`.
    ///
    /// # Errors
    /// For other schemes, without a bucket, and for keys with empty parts, `.` or `..`, which the
    /// library would take for other keys.
    pub fn parse(name: &Path) -> Result<Self, ObjectError> {
        let shown = name.display().to_string();
        let wrong = |problem: String| ObjectError::Address { name: shown.clone(), problem };
        let text = name.to_str().ok_or_else(|| wrong("found letters that are no UTF-8".into()))?;
        let rest = text.strip_prefix(SCHEME).ok_or_else(|| wrong("found another scheme".into()))?;
        let (bucket, key) = rest.split_once('/').unwrap_or((rest, ""));
        if bucket.is_empty() {
            return Err(wrong("found no bucket".into()));
        }
        let parts = key.strip_suffix('/').unwrap_or(key);
        let odd = |part: &&str| matches!(*part, "" | "." | "..") || part.chars().any(char::is_control);
        match parts.split('/').find(odd) {
            Some(part) if !key.is_empty() => {
                Err(wrong(format!("found the part '{}' in its key", part.escape_debug())))
            }
            _ => Ok(Address { bucket: bucket.into(), key: key.into() }),
        }
    }

    /// Whether it names one recording; else it stands for all below.
    pub fn is_recording(&self) -> bool {
        Path::new(&self.key).extension().is_some_and(|e| e == RECORDING) && !self.key.ends_with('/')
    }

    /// The address of a name below this one.
    pub fn below(&self, name: &str) -> Address {
        let folder = self.key.trim_end_matches('/');
        let key = if folder.is_empty() { name.into() } else { format!("{folder}/{name}") };
        Address { bucket: self.bucket.clone(), key }
    }

    /// Where the names in a manifest at this address begin.
    pub fn folder(&self) -> PathBuf {
        let folder = self.key.rsplit_once('/').map_or("", |(folder, _)| folder);
        Address { bucket: self.bucket.clone(), key: folder.into() }.to_string().into()
    }
}

impl fmt::Display for Address {
    fn fmt(&self, to: &mut fmt::Formatter<'_>) -> fmt::Result {
        write!(to, "{SCHEME}{}", self.bucket)?;
        if self.key.is_empty() { Ok(()) } else { write!(to, "/{}", self.key) }
    }
}

/// A recording where it can be opened: a file as it is, an object as a copy without a name.
#[derive(Debug)]
pub struct Local {
    name: PathBuf,
    copy: Option<(File, PathBuf)>,
}

impl Local {
    /// Makes sure of a recording by its path or address.
    ///
    /// # Errors
    /// Where an object cannot be had or copied. A path is not looked at.
    pub fn of(name: &Path, store: &Store) -> Result<Self, ObjectError> {
        let copy = match is_address(name) {
            true => Some(store.fetch(&Address::parse(name)?)?),
            false => None,
        };
        // Named through this process, so that its children can open it as well.
        let named = |file: File| {
            let path = format!("/proc/{}/fd/{}", std::process::id(), file.as_raw_fd());
            (file, path.into())
        };
        Ok(Local { name: name.into(), copy: copy.map(named) })
    }

    /// What to open.
    pub fn path(&self) -> &Path {
        self.copy.as_ref().map_or(&self.name, |(_, path)| path)
    }

    /// The address, where it is a copy.
    pub fn address(&self) -> Option<String> {
        self.copy.as_ref().map(|_| self.name.display().to_string())
    }

    /// A message with the address in the place of the copy's path.
    pub fn named(&self, message: &str) -> String {
        match &self.copy {
            Some((_, path)) => message.replace(&path.display().to_string(), &self.name.display().to_string()),
            None => message.into(),
        }
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use proptest::prelude::*;

    proptest! {
        #[test]
        fn an_address_is_refused_or_keeps_its_letters(text in "(s3|gs)://[a-b/.]{0,8}") {
            match Address::parse(text.as_ref()) {
                Ok(address) => prop_assert_eq!(address.to_string(), text.strip_suffix('/').filter(|t| t.len() > 5 && address.key.is_empty()).unwrap_or(&text)),
                Err(problem) => prop_assert!(problem.is_wrong_use() && problem.to_string().starts_with(&text)),
            }
        }
    }

    #[test]
    fn an_address_names_a_recording_or_what_lies_below() {
        let of = |text: &str| Address::parse(text.as_ref()).unwrap();
        assert!(of("s3://b/day/a.mcap").is_recording());
        assert!(["s3://b", "s3://b/", "s3://b/day", "s3://b/a.mcap/"].iter().all(|t| !of(t).is_recording()));
        assert_eq!(of("s3://b/day/").below("x").to_string(), "s3://b/day/x");
        assert_eq!(of("s3://b").below("x").to_string(), "s3://b/x");
        assert_eq!(of("s3://b/day/list.txt").folder(), PathBuf::from("s3://b/day"));
        assert_eq!(of("s3://b/list.txt").folder().join("a.mcap"), PathBuf::from("s3://b/a.mcap"));
        for wrong in
            ["s3://", "s3:///a", "gs://b/a", "s3://b/a//b", "s3://b//a", "s3://b/../a", "s3://b/a\u{7}"]
        {
            assert!(
                Address::parse(wrong.as_ref()).unwrap_err().to_string().contains("s3://BUCKET/KEY"),
                "{wrong}"
            );
        }
    }

    #[cfg(not(feature = "object-store"))]
    #[test]
    fn a_build_without_object_stores_says_what_to_build() {
        let problem = Local::of("s3://b/a.mcap".as_ref(), &Store::new()).unwrap_err();
        assert!(
            problem.is_wrong_use() && problem.to_string().contains("--features object-store"),
            "{problem}"
        );
        assert_eq!(Local::of("/a.mcap".as_ref(), &Store::new()).unwrap().path(), Path::new("/a.mcap"));
    }
}
