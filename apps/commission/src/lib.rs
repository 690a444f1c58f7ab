//! Takes a new rig into use, step by step: `vitreo commission`.
//!
//! A folder ([`folder`]) holds the rig and the colours as they become, what each step found, pictures, and a page
//! ([`page`]). The steps compute with what the commands of calibration and camera hardware compute with, and say in
//! words what is wrong with their input and what helps ([`Refused`]); what is there is replaced by what is better only.

pub mod boards;
pub mod check;
pub mod cli;
pub mod colours;
pub mod folder;
pub mod lenses;
pub mod live;
pub mod page;
pub mod pictures;
pub mod places;
pub mod poses;
pub mod stream;
pub mod trocars;

/// What is wrong with the input of a step, each with what to do.
#[derive(Debug, Clone, PartialEq, Eq, thiserror::Error)]
#[error("{}", self.0.join("; "))]
pub struct Refused(pub Vec<String>);

/// Why a step leaves everything as it is, although something is wrong: it cannot correct that.
#[derive(Debug, Clone, PartialEq, Eq, thiserror::Error)]
#[error("{found}; {why}")]
pub struct NotBetter {
    /// What is wrong.
    pub found: String,
    /// Why the step does not correct it.
    pub why: String,
}

/// Refuses where there is anything to say.
///
/// # Errors
/// Advice.
pub fn refuse(advice: Vec<String>) -> Result<(), Refused> {
    if advice.is_empty() { Ok(()) } else { Err(Refused(advice)) }
}
