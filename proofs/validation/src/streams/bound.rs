//! The posterior Cramér–Rao bound of the tips of a stream: how near the truth an unbiased tracker can be that
//! knows the spectrum of the motion and the noise of the blobs, from all blobs up to each instant.
//!
//! A motion of an even spectrum in a band is a sum of cosines and sines of a grid of frequencies, each with a
//! normal weight of the band's variance over their number (spectral representation; the grid is fine enough
//! that nothing repeats within the stream). So the state is the vector of weights w of tip, point in the trocar
//! and roll of an instrument, with a known prior; each marker that a field shows adds the information of its
//! image, HᵀJᵀR⁻¹JH, J the derivative of the pixel by tip, trocar and roll at the truth (Tichavský, Muravchik
//! and Nehorai 1998). The bound of the tip at t is trace(B(t) Λ⁻¹ B(t)ᵀ), B the cosines and sines of the tip.
//!
//! Markers that touch are one blob: it shows the mean of their centres, weighted by area, and nothing of each alone.
//!
//! The eye is taken as known, and so is the other instrument where its marker touches one of this; a marker that is
//! partly hidden is taken as if it were seen whole. All leave the bound lower than it is.

use super::Stream;
use super::imaging::{NOISE_PX, Part};
use super::motion::{Held, Spectrum};
use nalgebra::{DMatrix, DVector, Matrix2, Point3, SMatrix, Vector2, Vector3};
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
                let of: &[Spectrum] = match unknown {
                    0..3 => &spectra.tip,
                    3..6 => std::slice::from_ref(&spectra.play),
                    _ => std::slice::from_ref(&spectra.roll),
                };
                let pairs: Vec<_> = of.iter().flat_map(|s| grid(s, duration_s)).collect();
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
    /// from call to call. `None` if nothing was seen yet, or nothing moves.
    pub fn at_um(&mut self, t_s: f64) -> Option<f64> {
        // Where nothing moves, nothing is unknown.
        if self.information.is_empty() {
            return None;
        }
        self.take_in(t_s);
        let known = self.information.clone().cholesky()?;
        let tip = self.basis(t_s).rows(0, 3).transpose();
        let variance = tip.dot(&known.solve(&tip));
        (self.taken > 0).then(|| libm::sqrt(variance) * 1e3)
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
            information += seen.map(|(_, marker)| of_whole(camera, &held, marker)).sum::<Information>();
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
        information(&own.map(of_part).sum(), area_px)
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

/// Frequencies of a band, and the standard deviation of their weights.
fn grid(spectrum: &Spectrum, duration_s: f64) -> impl Iterator<Item = [f64; 2]> {
    let Spectrum { band_hz: [low, high], rms } = *spectrum;
    let count = if rms > 0.0 { ((high - low) * LONGER * duration_s).ceil().max(1.0) } else { 0.0 };
    let sigma = rms / libm::sqrt(count.max(1.0));
    (0..count as usize).map(move |n| [TAU * (low + (high - low) * (n as f64 + 0.5) / count), sigma])
}

/// What the image of a marker that is seen whole says of the unknowns.
fn of_whole(camera: &Camera, held: &Held, marker: &RigMarker) -> Information {
    let at = held.pose().0 * Point3::from(Vector3::from(marker.p));
    let radii = camera.focal_px * (marker.r / camera.in_camera(&at).z);
    information(&jacobian(camera, held, marker), 0.5 * PI * radii.x * radii.y)
}

/// What a blob says of which that is the derivative.
fn information(jacobian: &Jacobian, area_px: f64) -> Information {
    let weights = Vector2::from(NOISE_PX.map(|n| area_px.max(1.0) / (n * n)));
    jacobian.transpose() * Matrix2::from_diagonal(&weights) * jacobian
}

/// Derivative of the image of a marker by the unknowns.
fn jacobian(camera: &Camera, held: &Held, marker: &RigMarker) -> Jacobian {
    let at = |held: &Held| held.pose().0 * Point3::from(Vector3::from(marker.p));
    let pixel = |held: &Held| camera.project(&at(held)).unwrap_or_default();
    let mut jacobian = Jacobian::zeros();
    for unknown in 0..UNKNOWNS {
        let moved = |by: f64| {
            let mut held = *held;
            match unknown {
                0..3 => held.tip[unknown] += by,
                3..6 => held.pivot[unknown - 3] += by,
                _ => held.roll += by,
            }
            pixel(&held)
        };
        jacobian.set_column(unknown, &((moved(STEP) - moved(-STEP)) / (2.0 * STEP)));
    }
    jacobian
}
