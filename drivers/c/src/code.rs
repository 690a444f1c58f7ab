//! How a call ends: a code for the program, and words for a person.

use ipc::IpcError;
use protocol::message::Invalid;
use std::cell::RefCell;
use std::ffi::CString;

/// How a call ended. 0 and above: it did what it was asked; below 0: it did not.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
#[repr(i32)]
pub enum Code {
    /// Done.
    Ok = 0,
    /// Nothing new came within the time.
    Nothing = 1,
    /// The run has ended or asks this program to end: close the driver.
    Stop = 2,
    /// A pointer is NULL that must not be.
    Null = -1,
    /// No driver of this thread has this number: it was closed, or another thread opened it.
    Closed = -2,
    /// A size is not that of the block: the program was compiled with another header.
    Size = -3,
    /// A name or an option makes no sense.
    Argument = -4,
    /// The program was compiled with the header of another version than the library's.
    Header = -5,
    /// The running vitreo was built with other blocks than the library.
    Schema = -6,
    /// No run of this name came up within the time.
    NoRun = -7,
    /// The run does not take this from outside: see `vitreo run --external`.
    NotInvited = -8,
    /// The driver was not opened for this.
    Role = -9,
    /// A number of the block makes no sense.
    Invalid = -10,
    /// The transport or the system failed.
    System = -11,
    /// A field is lent already, or none is.
    Loan = -12,
    /// A defect of the library; please report it.
    Defect = -13,
    /// Another driver sends this already: two would be mixed.
    Taken = -14,
}

/// Why a call did not do what it was asked.
#[derive(Debug, Clone, PartialEq, Eq, thiserror::Error)]
#[error("{text}")]
pub struct Failure {
    /// For the program.
    pub code: Code,
    /// For a person.
    pub text: String,
}

/// A failure with its words.
pub(crate) fn failure(code: Code, text: impl Into<String>) -> Failure {
    Failure { code, text: text.into() }
}

impl From<IpcError> for Failure {
    fn from(error: IpcError) -> Self {
        let code = match &error {
            IpcError::InstanceName(_) => Code::Argument,
            IpcError::SchemaDiffers { .. } => Code::Schema,
            IpcError::TooLarge { .. } => Code::Size,
            _ => Code::System,
        };
        failure(code, error.to_string())
    }
}

impl From<Invalid> for Failure {
    fn from(invalid: Invalid) -> Self {
        failure(Code::Invalid, invalid.to_string())
    }
}

thread_local! {
    /// Words of the newest failure of this thread.
    static NEWEST: RefCell<CString> = RefCell::default();
}

/// Keeps the words of a failure for [`words`].
pub(crate) fn keep(text: &str) {
    // Words with a zero in them end before it.
    let text = text.split('\0').next().unwrap_or_default();
    NEWEST.with(|newest| *newest.borrow_mut() = CString::new(text).unwrap_or_default());
}

/// Shows the words of this thread's newest failure. They stay where they are until its next one.
pub(crate) fn words<T>(show: impl FnOnce(&CString) -> T) -> T {
    NEWEST.with(|newest| show(&newest.borrow()))
}
