//! Why bodies leave residuals or are not tracked: the catalogue of causes ([`catalogue`]), and their judge.
//!
//! A cause is judged by its remedy. Of each cause the judge undoes what it would have done, to the rig or
//! to the blobs, tracks a stretch of the recorded blobs again, and measures what is left in the pictures.
//! Continuous parameters (a shift of stamps, a scale, where a camera or marker stands) are estimated first.
//! A cause explains the residuals where its remedy brings them down to what the best remedy does; where
//! several do, all are named, those with the fewest parameters first: none is favoured without evidence.
//! Progressive pictures are recognised by how blobs move.
//! What no remedy explains has an unknown cause. Pure: the tracker is run on the recorded blobs without its
//! estimation of drift, which would hide a part of it.

mod beside;
pub mod catalogue;
mod colours;
mod jitter;
mod judge;
mod judgement;
mod later;
mod lenses;
mod measure;
mod places;
mod progressive;
mod refit;
mod remedy;
mod rest;
mod search;
pub mod together;
mod trial;
mod verified;
mod work;

pub use catalogue::Cause;
pub use judge::{judge, judge_within};
pub use judgement::{Explanation, Judgement, Verdict};
pub use measure::{Left, Squares, measure};
pub use work::Work;
