//! Do two triangles in space have a point in common? Decided exactly, in integers.
//!
//! Corners are whole numbers below 2¹⁹ in size. Differences of two stay within 2²⁰, a component of
//! a normal (two products) within 2⁴¹, its product with a difference, three terms, within 3 · 2⁶¹ <
//! 2⁶³: an `i64` holds every sign exactly. The side of a plane is a difference of two heights along
//! its normal, each within 3 · 2⁶⁰: within 6 · 2⁶⁰ < 2⁶³.
//!
//! Method: if all corners of one triangle lie strictly on one side of the other's plane, no.
//! Otherwise each triangle meets the line that the two planes share in an interval, whose ends lie
//! on the two edges from the corner that is alone on its side; which of two ends comes first is the
//! sign of the tetrahedron of their two edges (Guigue and Devillers, "Fast and robust
//! triangle-triangle overlap test using orientation predicates", 2003). Two triangles in one plane
//! are compared in the projection in which they are largest. Touching counts.

/// Corner in whole units, each below [`LIMIT`] in size.
pub type Corner = [i32; 3];

/// Limit of a coordinate, exclusive.
pub const LIMIT: i32 = 1 << 19;

const _: () = {
    let difference = LIMIT.trailing_zeros() + 1;
    let normal = 2 * difference + 1;
    // Three terms are less than four.
    assert!(normal + difference + 2 <= 63, "an orientation fits an i64");
    // Two heights of three terms each are less than eight terms.
    assert!(normal + LIMIT.trailing_zeros() + 3 <= 63, "so does the side of a plane");
};

/// A triangle with its normal.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub struct Triangle {
    /// Corners.
    pub corners: [Corner; 3],
    /// (b − a) × (c − a).
    pub normal: [i64; 3],
    /// Of the corners along the normal: a point is above the plane if it lies farther along.
    pub height: i64,
}

#[inline(always)]
fn minus(a: Corner, b: Corner) -> [i64; 3] {
    [i64::from(a[0]) - i64::from(b[0]), i64::from(a[1]) - i64::from(b[1]), i64::from(a[2]) - i64::from(b[2])]
}

#[inline(always)]
fn cross(a: [i64; 3], b: [i64; 3]) -> [i64; 3] {
    [a[1] * b[2] - a[2] * b[1], a[2] * b[0] - a[0] * b[2], a[0] * b[1] - a[1] * b[0]]
}

#[inline(always)]
fn dot(a: [i64; 3], b: [i64; 3]) -> i64 {
    a[0] * b[0] + a[1] * b[1] + a[2] * b[2]
}

impl Triangle {
    /// The triangle of three corners; `None` without area.
    #[inline(always)]
    pub fn new(corners: [Corner; 3]) -> Option<Self> {
        debug_assert!(corners.iter().flatten().all(|c| c.abs() < LIMIT));
        let normal = cross(minus(corners[1], corners[0]), minus(corners[2], corners[0]));
        let height = dot(normal, corners[0].map(i64::from));
        (normal != [0; 3]).then_some(Triangle { corners, normal, height })
    }

    /// Lower and upper corner of the box around it.
    #[inline(always)]
    pub fn bounds(&self) -> [Corner; 2] {
        let [a, b, c] = self.corners;
        let of = |pick: fn(i32, i32) -> i32| std::array::from_fn(|k| pick(pick(a[k], b[k]), c[k]));
        [of(Ord::min), of(Ord::max)]
    }

    /// Six times the volume between this triangle and a point: its sign is the side of the plane.
    #[inline(always)]
    fn side(&self, point: Corner) -> i64 {
        dot(self.normal, point.map(i64::from)) - self.height
    }

    /// True if the triangles have a point in common.
    #[inline(always)]
    pub fn intersects(&self, other: &Triangle) -> bool {
        let theirs = other.corners.map(|p| self.side(p));
        if apart(theirs) {
            return false;
        }
        let mine = self.corners.map(|p| other.side(p));
        if apart(mine) {
            return false;
        }
        if theirs == [0; 3] {
            self.intersects_coplanar(other)
        } else {
            self.intersects_across(other, mine, theirs)
        }
    }

    fn intersects_across(&self, other: &Triangle, mine: [i64; 3], theirs: [i64; 3]) -> bool {
        let (first, first_below) = alone(mine);
        let (second, second_below) = alone(theirs);
        // A corner that is alone below is above once the other triangle is turned over.
        let [p1, q1, r1] = turned(self.corners, first, second_below);
        let [p2, q2, r2] = turned(other.corners, second, first_below);
        orient(p1, q1, p2, q2) <= 0 && orient(p1, r1, r2, p2) <= 0
    }

    fn intersects_coplanar(&self, other: &Triangle) -> bool {
        let size = self.normal.map(i64::abs);
        let across = (0..3).max_by_key(|&k| size[k]).unwrap_or(2);
        let [u, v] = [[1, 2], [2, 0], [0, 1]][across];
        let flat = |t: &Triangle| t.corners.map(|c| [i64::from(c[u]), i64::from(c[v])]);
        let (a, b) = (flat(self), flat(other));
        let edges = |t: [[i64; 2]; 3]| [[t[0], t[1]], [t[1], t[2]], [t[2], t[0]]];
        edges(a).iter().any(|e| edges(b).iter().any(|f| segments_meet(*e, *f)))
            || contains(a, b[0])
            || contains(b, a[0])
    }
}

/// All strictly on one side.
#[inline(always)]
fn apart(side: [i64; 3]) -> bool {
    (side[0] > 0 && side[1] > 0 && side[2] > 0) || (side[0] < 0 && side[1] < 0 && side[2] < 0)
}

/// The corner that no other shares its side with, and whether that is the lower side.
#[inline(always)]
fn alone(side: [i64; 3]) -> (usize, bool) {
    let above = side.map(|s| s > 0);
    let below = side.map(|s| s < 0);
    let count = |of: [bool; 3]| of.iter().filter(|b| **b).count();
    let only = |of: [bool; 3]| {
        if of[0] {
            0
        } else if of[1] {
            1
        } else {
            2
        }
    };
    match (count(above), count(below)) {
        (1, _) => (only(above), false),
        (_, 1) => (only(below), true),
        // Two on one side and one on the plane: that one, as if from the other side.
        (2, _) => (only(above.map(|b| !b)), true),
        _ => (only(below.map(|b| !b)), false),
    }
}

/// Corners from `first` on, in their order or, turned over, against it.
#[inline(always)]
fn turned(corners: [Corner; 3], first: usize, over: bool) -> [Corner; 3] {
    let [p, q, r] = [corners[first], corners[(first + 1) % 3], corners[(first + 2) % 3]];
    if over { [p, r, q] } else { [p, q, r] }
}

/// Sign of (b − a) × (c − a) · (d − a).
#[inline(always)]
fn orient(a: Corner, b: Corner, c: Corner, d: Corner) -> i64 {
    dot(cross(minus(b, a), minus(c, a)), minus(d, a))
}

fn orient_flat(a: [i64; 2], b: [i64; 2], c: [i64; 2]) -> i64 {
    ((b[0] - a[0]) * (c[1] - a[1]) - (b[1] - a[1]) * (c[0] - a[0])).signum()
}

fn segments_meet([a, b]: [[i64; 2]; 2], [c, d]: [[i64; 2]; 2]) -> bool {
    let (abc, abd) = (orient_flat(a, b, c), orient_flat(a, b, d));
    let (cda, cdb) = (orient_flat(c, d, a), orient_flat(c, d, b));
    if abc * abd < 0 && cda * cdb < 0 {
        return true;
    }
    let within = |p: [i64; 2], q: [i64; 2], x: [i64; 2]| {
        (0..2).all(|k| p[k].min(q[k]) <= x[k] && x[k] <= p[k].max(q[k]))
    };
    (abc == 0 && within(a, b, c))
        || (abd == 0 && within(a, b, d))
        || (cda == 0 && within(c, d, a))
        || (cdb == 0 && within(c, d, b))
}

fn contains(t: [[i64; 2]; 3], p: [i64; 2]) -> bool {
    let s = [orient_flat(t[0], t[1], p), orient_flat(t[1], t[2], p), orient_flat(t[2], t[0], p)];
    s.iter().all(|&s| s >= 0) || s.iter().all(|&s| s <= 0)
}

#[cfg(test)]
mod tests {
    use super::*;
    use proptest::prelude::*;

    /// The other truth: two convex bodies without a common point have a plane strictly between
    /// them, and for two triangles it is normal to one of these directions. Exact in 128 bits.
    fn separated(a: &Triangle, b: &Triangle) -> bool {
        let wide = |v: [i64; 3]| v.map(i128::from);
        let cross = |a: [i128; 3], b: [i128; 3]| {
            [a[1] * b[2] - a[2] * b[1], a[2] * b[0] - a[0] * b[2], a[0] * b[1] - a[1] * b[0]]
        };
        let edges = |t: &Triangle| [0, 1, 2].map(|i| wide(minus(t.corners[(i + 1) % 3], t.corners[i])));
        let (ea, eb) = (edges(a), edges(b));
        let (na, nb) = (wide(a.normal), wide(b.normal));
        let mut axes = vec![na, nb];
        for (e, f) in ea.iter().flat_map(|e| eb.iter().map(move |f| (*e, *f))) {
            axes.push(cross(e, f));
        }
        axes.extend(ea.iter().map(|e| cross(na, *e)));
        axes.extend(eb.iter().map(|e| cross(nb, *e)));
        axes.iter().any(|axis| {
            let along = |t: &Triangle| {
                let d = t.corners.map(|c| (0..3).map(|k| axis[k] * i128::from(c[k])).sum::<i128>());
                [*d.iter().min().unwrap(), *d.iter().max().unwrap()]
            };
            let ([a0, a1], [b0, b1]) = (along(a), along(b));
            a1 < b0 || b1 < a0
        })
    }

    fn triangles(size: i32) -> impl Strategy<Value = [[Corner; 3]; 2]> {
        let corner = move || prop::array::uniform3(-size..=size);
        prop::array::uniform2(prop::array::uniform3(corner()))
    }

    fn check(corners: [[Corner; 3]; 2]) -> Result<(), TestCaseError> {
        if let [Some(a), Some(b)] = corners.map(Triangle::new) {
            prop_assert_eq!(a.intersects(&b), !separated(&a, &b), "{:?}", corners);
            prop_assert_eq!(b.intersects(&a), a.intersects(&b));
        }
        Ok(())
    }

    proptest! {
        #![proptest_config(ProptestConfig::with_cases(20_000))]
        /// So few places that corners on planes, on edges and on corners, and common planes, are
        /// frequent.
        #[test]
        fn agrees_with_separating_planes_on_a_coarse_grid(corners in triangles(2)) { check(corners)?; }

        #[test]
        fn agrees_with_separating_planes_in_one_plane(corners in triangles(3), k in 0usize..3) {
            check(corners.map(|t| t.map(|mut c| { c[k] = 1; c })))?;
        }

        #[test]
        fn agrees_with_separating_planes_at_the_limits(corners in triangles(LIMIT - 1)) { check(corners)?; }
    }

    #[test]
    fn a_triangle_without_area_is_none() {
        assert_eq!(Triangle::new([[0, 0, 0], [1, 1, 1], [3, 3, 3]]), None);
        assert_eq!(Triangle::new([[5, 0, 0]; 3]), None);
    }
}
