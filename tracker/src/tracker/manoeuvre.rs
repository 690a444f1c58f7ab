//! An instrument that moves otherwise than its filter expects.
//!
//! A filter that is too sure of its prediction keeps a fit there, and the fit rejects the blobs that say otherwise as
//! outliers, one by one, until the rest agrees with the prediction. From then on it would be further off in every field. So a
//! fit that leaves blobs unexplained is tried again about a prediction that is less sure, and that one is taken where it
//! explains them.

use super::update::Estimate;
use super::{Group, Tracker};
use crate::body_filter::BodyFilter;
use crate::constants as k;
use protocol::limits::BODIES;
use protocol::poses::EYE;

impl Estimate {
    /// Number of blobs of a body that its fit has rejected, or that lie beside its markers.
    fn unexplained(&self, body: usize) -> usize {
        let outliers = self.fits[body].map_or(0, |fit| fit.outliers);
        outliers + self.association.beside(body) as usize
    }

    /// Number of blobs that the fit of a body explains.
    fn explained(&self, body: usize) -> usize {
        self.fits[body].map_or(0, |fit| fit.blobs)
    }

    /// True if so many blobs of a body are unexplained that it may have moved otherwise than predicted.
    fn may_manoeuvre(&self, body: usize) -> bool {
        let (unexplained, explained) = (self.unexplained(body), self.explained(body));
        unexplained >= k::MIN_UNEXPLAINED
            && unexplained as f64 >= k::UNEXPLAINED_SHARE * explained as f64
            && explained > 0
    }

    /// True if it explains more blobs of a body than `other`, and leaves fewer than half as many.
    fn explains_more(&self, other: &Self, body: usize) -> bool {
        self.explained(body) > other.explained(body) && 2 * self.unexplained(body) < other.unexplained(body)
    }
}

impl Tracker {
    /// Fits instruments that leave blobs unexplained again about a wider prediction, and takes the fits that explain them.
    /// Where the eye has such blobs too, a camera may have moved.
    pub(super) fn follow_manoeuvres(&mut self, group: Group, mut estimate: Estimate) -> Estimate {
        for body in (0..BODIES).filter(|b| *b != EYE) {
            if !estimate.may_manoeuvre(body) || estimate.unexplained(EYE) > 0 {
                continue;
            }
            let Some(BodyFilter::Instrument(filter)) = &mut self.tracks[body].filter else { continue };
            let before = filter.clone();
            filter.inflate_covariance();
            let mut fits = estimate.fits;
            fits[body] = None;
            let again = std::array::from_fn(|b| b == body);
            let (association, taken) = self.refit(group, &mut estimate.association, &mut fits, again);
            let mut other = Estimate { association, fits };
            if other.explains_more(&estimate, body) {
                std::mem::swap(&mut other, &mut estimate);
            } else {
                for b in (0..BODIES).filter(|b| taken[*b]) {
                    let (own, back) = (&mut estimate.association, &mut other.association);
                    std::mem::swap(&mut own.matches[b], &mut back.matches[b]);
                }
                self.tracks[body].filter = Some(BodyFilter::Instrument(before));
            }
            self.associator.recycle(other.association);
        }
        estimate
    }
}

#[cfg(test)]
mod tests;
