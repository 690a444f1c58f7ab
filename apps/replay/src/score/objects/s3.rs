//! Objects over the protocol of Amazon S3, which other stores speak as well.
//!
//! Endpoint, region and credentials come from the usual variables (`AWS_ENDPOINT_URL`,
//! `AWS_ACCESS_KEY_ID`, …), as every tool for such stores takes them. Whoever calls may be on any
//! thread: requests are done on threads of this module.

use super::{Address, ObjectError};
use futures_util::TryStreamExt;
use object_store::aws::{AmazonS3Builder, AmazonS3ConfigKey};
use object_store::path::Path as Key;
use object_store::{
    ClientOptions, Error, GetOptions, ObjectStore, ObjectStoreExt, PutMode, PutOptions, RetryConfig,
};
use std::collections::HashMap;
use std::error::Error as _;
use std::fs::File;
use std::future::Future;
use std::io::{Read, Seek, Write};
use std::sync::{Arc, Mutex, MutexGuard, OnceLock, PoisonError, mpsc};
use std::time::Duration;
use tokio::runtime::{Builder, Runtime};

/// Threads that do requests; the work of a request is waiting.
const THREADS: usize = 2;
/// Tries of a request after the first, and time for all of them: enough for a store that restarts,
/// short enough for a person who mistyped its address.
const RETRIES: usize = 6;
const RETRY_TIME: Duration = Duration::from_secs(60);
/// Time to connect, and without a single byte of an answer.
const CONNECT_TIME: Duration = Duration::from_secs(10);
const READ_TIME: Duration = Duration::from_secs(60);
/// Most letters of a store's own words in a message.
const WORDS: usize = 300;

/// Object stores by bucket, connected to when first asked.
#[derive(Debug, Default)]
pub struct Store {
    runtime: OnceLock<Runtime>,
    buckets: Mutex<HashMap<String, Arc<dyn ObjectStore>>>,
    /// Tags of the objects that were listed: what is read must be what was listed.
    listed: Mutex<HashMap<Address, Option<String>>>,
}

impl Store {
    /// Nothing is connected to yet.
    pub fn new() -> Self {
        Store::default()
    }

    /// Objects below an address, by key.
    ///
    /// # Errors
    /// Where the store or bucket is not there, or refuses.
    pub fn list(&self, below: &Address) -> Result<Vec<Address>, ObjectError> {
        let (store, prefix) = (self.bucket(below)?, key_of(below)?);
        let all: Result<Vec<_>, _> =
            self.wait(below, async move { store.list(Some(&prefix)).try_collect().await })?;
        let mut all = all.map_err(|problem| self.object_error(below, problem))?;
        all.sort_by(|a, b| a.location.cmp(&b.location));
        let mut listed = lock(&self.listed);
        let named = all.into_iter().map(|object| {
            let address = Address { bucket: below.bucket.clone(), key: object.location.into() };
            listed.insert(address.clone(), object.e_tag);
            address
        });
        Ok(named.collect())
    }

    /// Copies an object into a file without a name.
    ///
    /// # Errors
    /// Where it is not there, not the one that was listed, refused, or the copy cannot be written.
    pub fn fetch(&self, address: &Address) -> Result<File, ObjectError> {
        let copy = |problem| ObjectError::Copy { address: address.to_string(), problem };
        let (store, key) = (self.bucket(address)?, key_of(address)?);
        let options = GetOptions {
            if_match: lock(&self.listed).get(address).cloned().flatten(),
            ..GetOptions::default()
        };
        let mut file = tempfile::tempfile().map_err(copy)?;
        let mut to = file.try_clone().map_err(copy)?;
        let copied = self.wait(address, async move {
            let found = store.get_opts(&key, options).await.map_err(Copying::Store)?;
            let (expected, mut stream) = (found.meta.size, found.into_stream());
            let mut bytes = 0;
            while let Some(piece) = stream.try_next().await.map_err(Copying::Store)? {
                bytes += piece.len() as u64;
                to.write_all(&piece).map_err(Copying::File)?;
            }
            Ok((bytes, expected))
        })?;
        let (bytes, expected) = copied.map_err(|problem| match problem {
            Copying::Store(problem) => self.object_error(address, problem),
            Copying::File(problem) => copy(problem),
        })?;
        if bytes != expected {
            let problem = format!("its answer ended after {bytes} of {expected} bytes");
            return Err(ObjectError::Unreachable { address: address.to_string(), problem });
        }
        file.rewind().map_err(copy)?;
        Ok(file)
    }

    /// An object's text.
    ///
    /// # Errors
    /// As [`Store::fetch`], and for what is no text or longer than `limit` bytes.
    pub fn text(&self, address: &Address, limit: u64) -> Result<String, ObjectError> {
        let wrong = |found: String| ObjectError::Text { address: address.to_string(), limit, found };
        let mut file = self.fetch(address)?;
        let copy = |problem| ObjectError::Copy { address: address.to_string(), problem };
        let length = file.metadata().map_err(copy)?.len();
        if length > limit {
            return Err(wrong(format!("{length}")));
        }
        let mut bytes = Vec::new();
        file.read_to_end(&mut bytes).map_err(copy)?;
        String::from_utf8(bytes).map_err(|e| wrong(protocol::file::looks_like(e.as_bytes()).into()))
    }

    /// Whether there is such an object.
    ///
    /// # Errors
    /// Where the store or bucket is not there, or refuses.
    pub fn exists(&self, address: &Address) -> Result<bool, ObjectError> {
        let (store, key) = (self.bucket(address)?, key_of(address)?);
        let found = self.wait(address, async move { store.head(&key).await })?;
        match found.map_err(|problem| self.object_error(address, problem)) {
            Ok(_) => Ok(true),
            Err(ObjectError::Absent(_) | ObjectError::Gone(_)) => Ok(false),
            Err(problem) => Err(problem),
        }
    }

    /// Puts an object, whole or not at all; in the place of another only with `replace`.
    ///
    /// # Errors
    /// Where one exists, or the store or bucket is not there or refuses.
    pub fn put(&self, address: &Address, bytes: Vec<u8>, replace: bool) -> Result<(), ObjectError> {
        let (store, key) = (self.bucket(address)?, key_of(address)?);
        let mode = if replace { PutMode::Overwrite } else { PutMode::Create };
        let options = PutOptions { mode, ..PutOptions::default() };
        let put = self.wait(address, async move { store.put_opts(&key, bytes.into(), options).await })?;
        put.map(drop).map_err(|problem| self.object_error(address, problem))
    }

    fn bucket(&self, address: &Address) -> Result<Arc<dyn ObjectStore>, ObjectError> {
        let mut buckets = lock(&self.buckets);
        if let Some(store) = buckets.get(&address.bucket) {
            return Ok(Arc::clone(store));
        }
        let store: Arc<dyn ObjectStore> = Arc::new(connect(address)?);
        buckets.insert(address.bucket.clone(), Arc::clone(&store));
        Ok(store)
    }

    /// Does a request on threads of its own and waits for it.
    fn wait<T: Send + 'static>(
        &self,
        address: &Address,
        request: impl Future<Output = T> + Send + 'static,
    ) -> Result<T, ObjectError> {
        let failed = |problem: String| ObjectError::Unreachable { address: address.to_string(), problem };
        let runtime = match self.runtime.get() {
            Some(runtime) => runtime,
            None => {
                let new = Builder::new_multi_thread().worker_threads(THREADS).enable_all().build();
                let new = new.map_err(|e| failed(format!("start the runtime: {e}")))?;
                // Where another thread was faster its runtime is taken.
                if let Err(late) = self.runtime.set(new) {
                    late.shutdown_background();
                }
                self.runtime.get().ok_or_else(|| failed("start the runtime".into()))?
            }
        };
        let (send, receive) = mpsc::sync_channel(1);
        runtime.spawn(async move {
            let _ = send.send(request.await);
        });
        receive.recv().map_err(|_| failed("the request ended without an answer".into()))
    }

    fn object_error(&self, address: &Address, problem: Error) -> ObjectError {
        let (shown, words) = (address.to_string(), words(&problem));
        match problem {
            // The library does not distinguish this.
            _ if words.contains("NoSuchBucket") => {
                ObjectError::NoBucket { address: shown, bucket: address.bucket.clone() }
            }
            Error::NotFound { .. } if lock(&self.listed).contains_key(address) => ObjectError::Gone(shown),
            Error::NotFound { .. } => ObjectError::Absent(shown),
            Error::Precondition { .. } => ObjectError::Changed(shown),
            Error::AlreadyExists { .. } => ObjectError::Exists(shown),
            Error::PermissionDenied { .. } | Error::Unauthenticated { .. } => refused(shown, &words),
            // Of a listing.
            _ if ["status code: 403", "status code: 401"].iter().any(|no| words.contains(no)) => {
                refused(shown, &words)
            }
            _ => ObjectError::Unreachable { address: shown, problem: words },
        }
    }
}

impl Drop for Store {
    fn drop(&mut self) {
        // The usual end of a runtime waits, which is refused where another one runs on this thread.
        if let Some(runtime) = self.runtime.take() {
            runtime.shutdown_background();
        }
    }
}

/// Which side of a copy failed.
enum Copying {
    Store(Error),
    File(std::io::Error),
}

fn lock<T>(shared: &Mutex<T>) -> MutexGuard<'_, T> {
    shared.lock().unwrap_or_else(PoisonError::into_inner)
}

fn key_of(address: &Address) -> Result<Key, ObjectError> {
    let wrong = |e| ObjectError::Address { name: address.to_string(), problem: format!("{e}") };
    Key::parse(&address.key).map_err(wrong)
}

fn connect(address: &Address) -> Result<object_store::aws::AmazonS3, ObjectError> {
    let settings = |e: Error| ObjectError::Settings { address: address.to_string(), problem: words(&e) };
    let retry = RetryConfig { max_retries: RETRIES, retry_timeout: RETRY_TIME, ..RetryConfig::default() };
    let builder = AmazonS3Builder::from_env().with_bucket_name(&address.bucket).with_retry(retry);
    // Whoever writes http:// into the endpoint wants it.
    let endpoints = [AmazonS3ConfigKey::Endpoint, AmazonS3ConfigKey::S3Endpoint];
    let plain = endpoints
        .iter()
        .any(|key| builder.get_config_value(key).is_some_and(|endpoint| endpoint.starts_with("http://")));
    let options = ClientOptions::new()
        .with_allow_http(plain)
        .with_connect_timeout(CONNECT_TIME)
        .with_read_timeout(READ_TIME)
        .with_timeout_disabled();
    builder.with_client_options(options).build().map_err(settings)
}

/// Maps the store's errors. Its answer is reported without its duration and the like, so that
/// rows do not differ from run to run.
fn refused(address: String, words: &str) -> ObjectError {
    let after = |mark: &str| words.split_once(mark).map(|(_, rest)| rest);
    let code = after("<Code>").and_then(|rest| rest.split_once("</Code>")).map(|(code, _)| code);
    let status = after("status code: ").and_then(|rest| rest.split(':').next()).unwrap_or("403 Forbidden");
    let problem = code.map_or(status.into(), |code| format!("{status}, {code}"));
    match code {
        None | Some("AccessDenied") => ObjectError::Refused { address, problem },
        // ExpiredToken, InvalidAccessKeyId, SignatureDoesNotMatch and others.
        Some(_) => ObjectError::Credentials { address, problem },
    }
}

/// A store's answer in its own words, causes and all, on one line and not too long.
fn words(problem: &Error) -> String {
    let (mut last, mut next) = (problem.to_string(), problem.source());
    while let Some(cause) = next {
        // What an error says of its cause mostly holds that of the next.
        if !last.contains(&cause.to_string()) {
            last = format!("{last}: {cause}");
        }
        next = cause.source();
    }
    let line: String = last.split_whitespace().collect::<Vec<_>>().join(" ");
    line.chars().take(WORDS).collect()
}

#[cfg(test)]
mod tests;
