//! Kinds of problems of a camera. Pure.

use protocol::condition::{self, ProblemKind};

/// A camera's problem in words.
pub type Trouble = condition::Trouble<Kind>;
/// A camera's problems, present and former.
pub type Condition = condition::Condition<Kind>;

/// Kind of a camera's problem.
#[derive(Debug, Clone, Copy, PartialEq, Eq, PartialOrd, Ord)]
pub enum Kind {
    /// Nothing has come yet.
    Awaited,
    /// Its file is over.
    Over,
    /// What it brings cannot be used.
    Refused,
    /// Whoever wrote into its pipe has closed it.
    Closed,
    /// Its camera is not there any more.
    Unplugged,
    /// Its camera's stamps cannot be true.
    Stamps,
    /// It is open and brings nothing.
    Silent,
    /// It brings fields too late.
    Slow,
    /// It shows nothing but black.
    Black,
}

impl ProblemKind for Kind {
    fn name(self) -> &'static str {
        match self {
            Kind::Awaited => "awaited",
            Kind::Over => "over",
            Kind::Refused => "refused",
            Kind::Closed => "closed",
            Kind::Unplugged => "unplugged",
            Kind::Stamps => "stamps",
            Kind::Silent => "silent",
            Kind::Slow => "slow",
            Kind::Black => "black",
        }
    }

    fn over(self) -> &'static str {
        if self == Kind::Awaited { "is available" } else { "is available again" }
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn a_camera_that_was_awaited_is_available_and_one_that_was_there_is_available_again() {
        for (kind, expected) in [
            (Kind::Awaited, "camera 1 is available after 2.5 s"),
            (Kind::Closed, "camera 1 is available again after 2.5 s"),
        ] {
            let mut camera = Condition::new("camera 1");
            assert!(camera.note(Some(Trouble::new(kind, "delivers nothing")), 0).is_some());
            assert_eq!(camera.note(None, 2_500_000_000).unwrap().text, expected);
        }
    }
}
