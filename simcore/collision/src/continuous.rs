//! Do two things meet **on their way**? A point and a triangle, or two edges, whose corners move
//! straight from a first to a second position.
//!
//! The difference of the two features is linear in time and in each of the two coordinates on them.
//! Over a box of the three it therefore stays within the hull of its values at the eight corners:
//! if these lie on one side of zero along any axis, by more than their rounding can be, there is no
//! contact in the box (Snyder 1992; Wang, Ferguson, Schneider, Jiang, Attene and Panozzo, "A
//! large-scale benchmark and an inclusion-based algorithm for continuous collision detection",
//! 2021). Boxes are halved until the features are nearer than a tolerance, which counts as contact.
//! So **no contact is ever missed**; what is reported may be a near miss of less than the
//! tolerance.

/// A position, mm.
pub type Point = [f64; 3];

/// A feature's corner at the begin and at the end of its way.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct MovingPoint {
    /// At time 0.
    pub from: Point,
    /// At time 1.
    pub to: Point,
}

impl MovingPoint {
    /// A corner that rests.
    pub fn still(at: Point) -> Self {
        MovingPoint { from: at, to: at }
    }

    fn at(&self, t: f64) -> Point {
        std::array::from_fn(|k| self.from[k] * (1.0 - t) + self.to[k] * t)
    }
}

/// Rounding of a difference, as a share of the largest coordinate: fewer than 40 operations of 2⁻⁵³
/// on values up to three times as large.
const ROUNDING: f64 = 1.0 / (1u64 << 45) as f64;
/// More boxes than this are not looked at: the features stay near for long enough that it counts as
/// contact.
const MAX_BOXES: usize = 200_000;

/// Boxes that wait: one more for each halving, of which a coordinate of an `f64` bears about 60 at
/// most.
const MAX_WAITING: usize = 192;

/// The two features whose difference is followed.
#[derive(Debug, Clone, Copy, PartialEq)]
pub enum Features {
    /// A point and the corners of a triangle.
    PointTriangle(MovingPoint, [MovingPoint; 3]),
    /// The ends of two edges.
    Edges([MovingPoint; 2], [MovingPoint; 2]),
}

/// Part of time and of the two coordinates, each as numerator over a power of two: halving is
/// exact.
#[derive(Debug, Clone, Copy)]
struct Part {
    low: [f64; 3],
    size: [f64; 3],
}

impl Features {
    fn corners(&self) -> impl Iterator<Item = &MovingPoint> {
        let (a, b): (&[MovingPoint], &[MovingPoint]) = match self {
            Features::PointTriangle(point, triangle) => (std::slice::from_ref(point), triangle),
            Features::Edges(first, second) => (first, second),
        };
        a.iter().chain(b)
    }

    /// Difference of the two features at a time and at coordinates on them.
    fn difference(&self, [t, u, v]: [f64; 3]) -> Point {
        match self {
            Features::PointTriangle(point, triangle) => {
                let (p, [a, b, c]) = (point.at(t), triangle.map(|m| m.at(t)));
                std::array::from_fn(|k| p[k] - a[k] * (1.0 - u - v) - b[k] * u - c[k] * v)
            }
            Features::Edges(first, second) => {
                let ([a, b], [c, d]) = (first.map(|m| m.at(t)), second.map(|m| m.at(t)));
                std::array::from_fn(|k| a[k] * (1.0 - u) + b[k] * u - c[k] * (1.0 - v) - d[k] * v)
            }
        }
    }

    /// A coordinate pair beyond the third edge of a triangle.
    fn is_beyond(&self, part: &Part) -> bool {
        matches!(self, Features::PointTriangle(..)) && part.low[1] + part.low[2] > 1.0
    }

    /// A time not after the first contact, if there is one; features nearer than `tolerance_mm`
    /// (above 0) along every axis touch. Values that are not numbers touch at once: a contact cannot be
    /// excluded.
    pub fn time_of_impact(&self, tolerance_mm: f64) -> Option<f64> {
        let sizes = || self.corners().flat_map(|c| c.from.into_iter().chain(c.to)).map(f64::abs);
        let largest = sizes().fold(0.0, |a, b| if b > a { b } else { a });
        if !sizes().all(f64::is_finite) {
            return Some(0.0);
        }
        let slack = largest * ROUNDING;
        // Earlier halves lie above later ones: the first contact that is found is the earliest.
        let mut waiting = [Part { low: [0.0; 3], size: [1.0; 3] }; MAX_WAITING];
        let mut count = 1;
        for _ in 0..MAX_BOXES {
            if count == 0 {
                return None;
            }
            count -= 1;
            let part = waiting[count];
            if self.is_beyond(&part) {
                continue;
            }
            match self.test_box(&part, slack, tolerance_mm) {
                BoxTest::Apart => (),
                BoxTest::Near => return Some(part.low[0]),
                BoxTest::Halve(_) if count + 2 > MAX_WAITING => return Some(part.low[0]),
                BoxTest::Halve(axis) => {
                    let mut half = part;
                    half.size[axis] *= 0.5;
                    let mut upper = half;
                    upper.low[axis] += half.size[axis];
                    (waiting[count], waiting[count + 1]) = (upper, half);
                    count += 2;
                }
            }
        }
        waiting[..count].iter().map(|p| p.low[0]).reduce(|a, b| if b < a { b } else { a })
    }

    fn test_box(&self, part: &Part, slack: f64, tolerance_mm: f64) -> BoxTest {
        let values: [Point; 8] = std::array::from_fn(|corner| {
            self.difference(std::array::from_fn(|k| {
                part.low[k] + if corner >> k & 1 == 1 { part.size[k] } else { 0.0 }
            }))
        });
        let mut near = true;
        for k in 0..3 {
            let low = values.iter().fold(f64::INFINITY, |m, v| if v[k] < m { v[k] } else { m });
            let high = values.iter().fold(f64::NEG_INFINITY, |m, v| if v[k] > m { v[k] } else { m });
            if low > slack || high < -slack {
                return BoxTest::Apart;
            }
            near &= high - low < tolerance_mm;
        }
        // The coordinate along which the difference changes most.
        let change = |axis: usize| {
            let pairs = (0..8).filter(|c| c >> axis & 1 == 0).map(|c| (values[c], values[c | 1 << axis]));
            pairs
                .flat_map(|(a, b)| (0..3).map(move |k| (a[k] - b[k]).abs()))
                .fold(0.0, |m, d| if d > m { d } else { m })
        };
        let changes = [change(0), change(1), change(2)];
        let axis = (0..3).fold(0, |best, k| if changes[k] > changes[best] { k } else { best });
        if near || changes[axis] <= slack { BoxTest::Near } else { BoxTest::Halve(axis) }
    }
}

enum BoxTest {
    Apart,
    Near,
    Halve(usize),
}

/// Whether a point that moves straight from `from` to `to` meets one of the living triangles, which
/// rest. The tolerance is 10 nm.
pub fn path_hits(from: Point, to: Point, surface: &super::surface::Surface) -> bool {
    const TOLERANCE_MM: f64 = 1e-5;
    let tip = MovingPoint { from, to };
    let low: Point = std::array::from_fn(|k| if from[k] < to[k] { from[k] } else { to[k] } - TOLERANCE_MM);
    let high: Point = std::array::from_fn(|k| if from[k] < to[k] { to[k] } else { from[k] } + TOLERANCE_MM);
    let living = surface.triangles.iter().zip(surface.alive).filter(|(_, alive)| **alive != 0);
    living.map(|(t, _)| t.map(|n| surface.position_mm.map(|axis| f64::from(axis[n as usize])))).any(
        |corners| {
            let apart = (0..3)
                .any(|k| corners.iter().all(|c| c[k] < low[k]) || corners.iter().all(|c| c[k] > high[k]));
            !apart
                && Features::PointTriangle(tip, corners.map(MovingPoint::still))
                    .time_of_impact(TOLERANCE_MM)
                    .is_some()
        },
    )
}

#[cfg(test)]
mod tests {
    use super::*;
    use proptest::prelude::*;
    use std::path::PathBuf;

    const TRIANGLE: [Point; 3] = [[0.0, 0.0, 0.0], [1.0, 0.0, 0.0], [0.0, 1.0, 0.0]];

    #[test]
    fn a_point_meets_a_resting_triangle_halfway() {
        let falling = |x: f64| MovingPoint { from: [x, 0.25, 1.0], to: [x, 0.25, -1.0] };
        let met = |x: f64| {
            Features::PointTriangle(falling(x), TRIANGLE.map(MovingPoint::still)).time_of_impact(1e-6)
        };
        assert!((met(0.25).unwrap() - 0.5).abs() < 1e-5);
        assert_eq!((met(-0.01), met(0.76)), (None, None));
        assert!(met(0.75).is_some(), "the edge belongs to it");
    }

    #[test]
    fn what_is_not_a_number_is_not_ruled_out() {
        let bad = MovingPoint { from: [f64::NAN, 5.0, 5.0], to: [5.0; 3] };
        assert_eq!(
            Features::PointTriangle(bad, TRIANGLE.map(MovingPoint::still)).time_of_impact(1e-6),
            Some(0.0)
        );
    }

    /// One query of the collection: eight points, and the exact answer.
    fn queries(path: &std::path::Path) -> Vec<([Point; 8], bool)> {
        let text = std::fs::read_to_string(path).unwrap();
        let row = |line: &str| {
            let n: Vec<f64> = line.split(',').map(|c| c.trim().parse().unwrap()).collect();
            // The rows are f64s written as fractions whose denominators are powers of two: all of
            // this is exact.
            ([n[0] / n[1], n[2] / n[3], n[4] / n[5]], n[6] != 0.0)
        };
        let rows: Vec<_> = text.lines().filter(|l| !l.trim().is_empty()).map(row).collect();
        rows.chunks_exact(8).map(|q| (std::array::from_fn(|i| q[i].0), q[0].1)).collect()
    }

    fn files() -> Option<Vec<PathBuf>> {
        let root = skips::data("peer-tests/ccd_sample_queries")?;
        let list = |path: PathBuf| -> Vec<PathBuf> {
            std::fs::read_dir(path).into_iter().flatten().flatten().map(|e| e.path()).collect()
        };
        let folders = list(root).into_iter().flat_map(list).filter(|p| p.is_dir());
        let mut files: Vec<PathBuf> = folders.flat_map(list).collect();
        files.sort();
        (!files.is_empty()).then_some(files)
    }

    /// Truth: rational arithmetic of the collection's authors.
    #[test]
    fn no_collision_of_the_collection_is_missed() {
        let Some(files) = files() else { return };
        let (mut queried, mut colliding, mut alarms) = (0, 0, 0);
        for file in files {
            let edges = file.parent().unwrap().ends_with("edge-edge");
            for (number, (p, truth)) in queries(&file).into_iter().enumerate() {
                let m: [MovingPoint; 4] = std::array::from_fn(|i| MovingPoint { from: p[i], to: p[i + 4] });
                let features = if edges {
                    Features::Edges([m[0], m[1]], [m[2], m[3]])
                } else {
                    Features::PointTriangle(m[0], [m[1], m[2], m[3]])
                };
                let met = features.time_of_impact(1e-9).is_some();
                assert!(met || !truth, "{} query {number} is missed", file.display());
                queried += 1;
                colliding += usize::from(truth);
                alarms += usize::from(met && !truth);
            }
        }
        println!("{queried} queries, {colliding} collide, {alarms} near misses reported");
        assert!(colliding > 200 && alarms * 5 < queried, "{queried} {colliding} {alarms}");
    }

    proptest! {
        /// Against the time at which a plane is crossed, for a triangle that moves with constant
        /// velocity.
        #[test]
        fn crossing_times_of_moving_triangles(
            x in -0.5f64..1.5, y in -0.5f64..1.5, height in 0.1f64..2.0, fall in 0.2f64..4.0,
            drift in prop::array::uniform3(-1.0f64..1.0),
        ) {
            let shift = |p: Point| MovingPoint { from: p, to: std::array::from_fn(|k| p[k] + drift[k]) };
            let point = MovingPoint { from: [x, y, height], to: [x, y, height - fall] };
            let t = height / (fall + drift[2]);
            let (u, v) = (x - drift[0] * t, y - drift[1] * t);
            let margin = u.min(v).min(1.0 - u - v).min(1.0 - t);
            prop_assume!(margin.abs() > 1e-3 && t > 0.0);
            let met = Features::PointTriangle(point, TRIANGLE.map(shift)).time_of_impact(1e-6);
            prop_assert_eq!(met.is_some(), margin > 0.0);
            if let Some(met) = met {
                prop_assert!(met <= t && met > t - 1e-4, "{} {}", met, t);
            }
        }
    }
}
