//! What stands in the place of the object store in a build without it: it refuses every address.

use super::{Address, ObjectError};
use std::fs::File;

/// No object store.
#[derive(Debug, Default)]
pub struct Store;

impl Store {
    /// None.
    pub fn new() -> Self {
        Store
    }

    /// Would list what lies below.
    ///
    /// # Errors
    /// Always: this build has no object store.
    pub fn list(&self, below: &Address) -> Result<Vec<Address>, ObjectError> {
        refused(below)
    }

    /// Would copy an object.
    ///
    /// # Errors
    /// Always: this build has no object store.
    pub fn fetch(&self, address: &Address) -> Result<File, ObjectError> {
        refused(address)
    }

    /// Would read a text.
    ///
    /// # Errors
    /// Always: this build has no object store.
    pub fn text(&self, address: &Address, _limit: u64) -> Result<String, ObjectError> {
        refused(address)
    }

    /// Would check whether there is such an object.
    ///
    /// # Errors
    /// Always: this build has no object store.
    pub fn exists(&self, address: &Address) -> Result<bool, ObjectError> {
        refused(address)
    }

    /// Would put an object.
    ///
    /// # Errors
    /// Always: this build has no object store.
    pub fn put(&self, address: &Address, _bytes: Vec<u8>, _replace: bool) -> Result<(), ObjectError> {
        refused(address)
    }
}

fn refused<T>(address: &Address) -> Result<T, ObjectError> {
    Err(ObjectError::NotBuilt(address.to_string()))
}
