//! The posterior Cramér–Rao bound of the tips of a stream: how near the truth an unbiased tracker can be that
//! knows the spectrum of the motion and the noise of the blobs, from all blobs up to each instant.
//!
//! A motion of an even spectrum in a band is a sum of cosines and sines of a grid of frequencies, each with a
//! normal weight of the band's variance over their number (spectral representation; the grid is fine enough
//! that nothing repeats within the stream). So the state is the vector of weights w of tip, point in the trocar
//! and roll of an instrument, with a known prior; each marker that a field shows adds the information of its
//! image, HᵀJᵀR⁻¹JH, J the derivative of the pixel by tip, trocar and roll at the truth (Tichavský, Muravchik
//! and Nehorai 1998). The bound of the tip at t is trace(DB(t) Λ⁻¹ (DB(t))ᵀ), B the cosines and sines of all, D the
//! derivative of the tip by them: one where an instrument is in the eye. While it is taken out, its tip is moved along
//! the shaft by a known share of its depth, and follows the hand the less the farther it is out.
//!
//! What does not move is a constant of which nothing is known beforehand, so that the bound falls as the root of time.
//!
//! Markers that touch are one blob: it shows the mean of their centres, weighted by area, and nothing of each alone.
//!
//! The eye is taken as known, and so is the other instrument where its marker touches one of this; a marker that is
//! partly hidden is taken as if it were seen whole. All leave the bound lower than it is.

use super::Stream;
use super::imaging::Part;
use super::motion::{Held, Spectrum};
use super::score::Tracked;
use nalgebra::{DMatrix, DVector, Dyn, Matrix2, OMatrix, Point3, SMatrix, SVector, U3, Vector3};
use protocol::limits::INSTRUMENTS;
use protocol::poses::BODY_NAMES;
use rig::RigMarker;
use rig::camera::Camera;
use std::f64::consts::{PI, TAU};

/// Unknowns of an instrument at an instant: tip, point in the trocar, roll.
const UNKNOWNS: usize = 7;
/// Step of a derivative, mm and rad.
const STEP: f64 = 1e-4;
/// How often longer than the stream the period of the grid of frequencies is.
const LONGER: f64 = 2.0;
/// Instants of a stream and instrument at which [`of_measured_um`] computes the bound, evenly spread.
const INSTANTS: usize = 40;
/// Rows and columns that are eliminated at once.
const BLOCK: usize = 64;
/// Standard deviation of what does not move, mm and rad: much more than any blob leaves of it.
const ANYWHERE: f64 = 10.0;

type Jacobian = SMatrix<f64, 2, UNKNOWNS>;
type Information = SMatrix<f64, UNKNOWNS, UNKNOWNS>;

/// Cosines and sines of one unknown.
struct Waves {
    /// Angular frequency of each pair, rad/s, and standard deviation of its weights.
    pairs: Vec<[f64; 2]>,
    /// First weight.
    begin: usize,
}

/// The bound of one instrument, taking in fields one after the other.
pub struct TipBound<'a> {
    stream: &'a Stream,
    instrument: usize,
    markers: Vec<RigMarker>,
    cameras: Vec<Camera>,
    unknowns: Vec<Waves>,
    information: DMatrix<f64>,
    /// Sightings taken in.
    taken: usize,
}

impl<'a> TipBound<'a> {
    /// Of an instrument of a stream; nothing is seen yet.
    pub fn new(stream: &'a Stream, instrument: usize) -> Self {
        let spectra = stream.motion.spectra(instrument);
        let duration_s = stream.sightings.last().map_or(1.0, |s| s.exposed_s).max(1.0);
        let mut begin = 0;
        let unknowns: Vec<Waves> = (0..UNKNOWNS)
            .map(|unknown| {
                let of = match unknown {
                    0..3 => &spectra.tip,
                    3..6 => &spectra.play,
                    _ => &spectra.roll,
                };
                let mut pairs: Vec<_> = of.iter().flat_map(|s| grid(s, duration_s)).collect();
                if pairs.is_empty() {
                    pairs.push([0.0, ANYWHERE]);
                }
                begin += 2 * pairs.len();
                Waves { begin: begin - 2 * pairs.len(), pairs }
            })
            .collect();
        let prior = unknowns.iter().flat_map(|u| u.pairs.iter().flat_map(|[_, sigma]| [sigma.powi(-2); 2]));
        let information = DMatrix::from_diagonal(&DVector::from_iterator(begin, prior));
        let markers = stream.rig.body(BODY_NAMES[instrument]).map_or(vec![], |body| body.markers.clone());
        TipBound {
            stream,
            instrument,
            markers,
            cameras: stream.rig.cameras(),
            unknowns,
            information,
            taken: 0,
        }
    }

    /// Least root mean square error of the tip at `t_s`, µm, from all that was exposed up to then; instants rise
    /// from call to call. `None` if nothing was seen yet.
    pub fn at_um(&mut self, t_s: f64) -> Option<f64> {
        self.take_in(t_s);
        let of_tip = derivative(&self.stream.motion.held(self.instrument, t_s), |held| {
            held.pose().0.translation.vector
        });
        let tip = (of_tip * self.basis(t_s)).transpose();
        let whitened = whitened(self.information.clone(), tip)?;
        (self.taken > 0).then(|| whitened.norm() * 1e3)
    }

    /// Takes in what was exposed up to `t_s`.
    fn take_in(&mut self, t_s: f64) {
        let all = &self.stream.sightings;
        // Half a millisecond: cameras that expose together jitter.
        let until = all.partition_point(|s| s.exposed_s <= t_s + super::SEEN_WITHIN_S);
        let mut rows: Vec<f64> = Vec::new();
        let weights = self.information.ncols().max(1);
        while self.taken < until {
            let sighting = &all[self.taken];
            self.taken += 1;
            let set = sighting.markers[self.instrument];
            let Some(camera) = self.cameras.iter().find(|c| c.id == sighting.camera).filter(|_| set != 0)
            else {
                continue;
            };
            let held = self.stream.motion.held(self.instrument, sighting.exposed_s);
            let mut alone = set;
            let mut information = Information::zeros();
            for parts in &sighting.merged {
                let own = || parts.iter().filter(|part| part.body == self.instrument);
                own().for_each(|part| alone &= !(1 << part.marker));
                information += self.of_merged(camera, &held, parts.iter().map(|p| p.area_px).sum(), own());
            }
            let seen = self.markers.iter().enumerate().filter(|(n, _)| alone & (1 << n) != 0);
            information += seen.map(|(_, marker)| self.of_whole(camera, &held, marker)).sum::<Information>();
            // A square root of it, so that the whole is a product of one matrix with itself.
            let eigen = information.symmetric_eigen();
            let root = SMatrix::from_diagonal(&eigen.eigenvalues.map(|v| libm::sqrt(v.max(0.0))))
                * eigen.eigenvectors.transpose();
            rows.extend((root * self.basis(sighting.exposed_s)).transpose().iter());
        }
        let rows = DMatrix::from_vec(weights, rows.len() / weights, rows);
        self.information.gemm(1.0, &rows, &rows.transpose(), 1.0);
    }

    /// What a blob of so large an area says of the unknowns, of which these parts are markers of the instrument.
    fn of_merged<'p>(
        &self,
        camera: &Camera,
        held: &Held,
        area_px: f64,
        own: impl Iterator<Item = &'p Part>,
    ) -> Information {
        let of_part =
            |part: &Part| jacobian(camera, held, &self.markers[part.marker]) * (part.area_px / area_px);
        self.information_of(&own.map(of_part).sum(), area_px)
    }

    /// What the image of a marker that is seen whole says of the unknowns.
    fn of_whole(&self, camera: &Camera, held: &Held, marker: &RigMarker) -> Information {
        let at = held.pose().0 * Point3::from(Vector3::from(marker.p));
        let radii = camera.focal_px * (marker.r / camera.in_camera(&at).z);
        self.information_of(&jacobian(camera, held, marker), 0.5 * PI * radii.x * radii.y)
    }

    /// What a blob says of which that is the derivative.
    fn information_of(&self, jacobian: &Jacobian, area_px: f64) -> Information {
        let weights = self.stream.noise.sigma_px(area_px).map(|sigma| sigma.powi(-2));
        jacobian.transpose() * Matrix2::from_diagonal(&weights) * jacobian
    }

    /// The unknowns at an instant as a linear map of the weights.
    fn basis(&self, t_s: f64) -> DMatrix<f64> {
        let mut basis = DMatrix::zeros(UNKNOWNS, self.information.ncols());
        for (row, unknown) in self.unknowns.iter().enumerate() {
            for (n, [omega, _]) in unknown.pairs.iter().enumerate() {
                let (sin, cos) = libm::sincos(omega * t_s);
                basis[(row, unknown.begin + 2 * n)] = cos;
                basis[(row, unknown.begin + 2 * n + 1)] = sin;
            }
        }
        basis
    }
}

/// L⁻¹b, with LLᵀ = a. Block by block, because products of matrices are several times faster than columns; `None` if a
/// is not positive definite.
fn whitened(mut a: DMatrix<f64>, mut b: OMatrix<f64, Dyn, U3>) -> Option<OMatrix<f64, Dyn, U3>> {
    let n = a.nrows();
    for begin in (0..n).step_by(BLOCK) {
        let size = BLOCK.min(n - begin);
        let (rest, behind) = (begin + size, n - begin - size);
        let diagonal = a.view((begin, begin), (size, size)).clone_owned().cholesky()?.unpack();
        let own = diagonal.solve_lower_triangular(&b.rows(begin, size))?;
        b.rows_mut(begin, size).copy_from(&own);
        // The panel below the block, transposed.
        let panel = diagonal.solve_lower_triangular(&a.view((begin, rest), (size, behind)))?;
        b.rows_mut(rest, behind).gemm(-1.0, &panel.transpose(), &own, 1.0);
        a.view_mut((rest, rest), (behind, behind)).gemm(-1.0, &panel.transpose(), &panel, 1.0);
    }
    Some(b)
}

/// Frequencies of a band, and the standard deviation of their weights.
fn grid(spectrum: &Spectrum, duration_s: f64) -> impl Iterator<Item = [f64; 2]> {
    let Spectrum { band_hz: [low, high], rms } = *spectrum;
    let count = if rms > 0.0 { ((high - low) * LONGER * duration_s).ceil().max(1.0) } else { 0.0 };
    let sigma = rms / libm::sqrt(count.max(1.0));
    (0..count as usize).map(move |n| [TAU * (low + (high - low) * (n as f64 + 0.5) / count), sigma])
}

/// Derivative of the image of a marker by the unknowns.
fn jacobian(camera: &Camera, held: &Held, marker: &RigMarker) -> Jacobian {
    let at = |held: &Held| held.pose().0 * Point3::from(Vector3::from(marker.p));
    derivative(held, |held| camera.project(&at(held)).unwrap_or_default())
}

/// Derivative of something by the unknowns.
fn derivative<const N: usize>(
    held: &Held,
    of: impl Fn(&Held) -> SVector<f64, N>,
) -> SMatrix<f64, N, UNKNOWNS> {
    let mut derivative = SMatrix::<f64, N, UNKNOWNS>::zeros();
    for unknown in 0..UNKNOWNS {
        let moved = |by: f64| {
            let mut held = *held;
            match unknown {
                0..3 => held.tip[unknown] += by,
                3..6 => held.pivot[unknown - 3] += by,
                _ => held.roll += by,
            }
            of(&held)
        };
        derivative.set_column(unknown, &((moved(STEP) - moved(-STEP)) / (2.0 * STEP)));
    }
    derivative
}

/// Bounds of the tips of both instruments, µm, at some of the instants in `from..to` (s) at which a tip in the eye was
/// measured.
pub fn of_measured_um(stream: &Stream, tracked: &Tracked, [from, to]: [f64; 2]) -> Vec<f64> {
    let mut bounds = Vec::new();
    for instrument in 0..INSTRUMENTS {
        let mut bound = TipBound::new(stream, instrument);
        let measured = tracked.measured_s(stream, instrument, from, to);
        let some = measured.iter().step_by((measured.len() / INSTANTS).max(1));
        bounds.extend(some.filter_map(|t_s| bound.at_um(*t_s)));
    }
    bounds
}

#[cfg(test)]
mod tests {
    use super::*;

    /// Of more than two blocks, one of them not full; the factor of nalgebra does the same column by column.
    #[test]
    fn blocks_factor_as_columns_do() {
        let entry = |r: usize, c: usize| libm::sin((r * 31 + c * 17) as f64);
        let root = DMatrix::from_fn(150, 150, entry);
        let a = &root * root.transpose() + DMatrix::identity(150, 150);
        let b = OMatrix::<f64, Dyn, U3>::from_fn(150, entry);
        let by_columns = a.clone().cholesky().unwrap().l().solve_lower_triangular(&b).unwrap();
        let by_blocks = whitened(a.clone(), b.clone()).unwrap();
        assert!((by_blocks - &by_columns).norm() < 1e-9 * by_columns.norm());
        assert!(whitened(-a, b).is_none());
    }
}
