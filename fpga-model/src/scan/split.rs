//! Separation of two touching markers of one colour by the moments of their common component.
//!
//! The camera sees spheres, so every marker is a disc once lines are as far apart as columns. Then
//! two discs with shares `p` and `q = 1 − p` of the area and a distance `d` along some axis have,
//! about the common centre,
//!
//! ```text
//! λ₁ − λ₂ = p·q·d²                     λ: second moments along and across the axis
//! μ₃      = p·q·(p − q)·(d³ − 6·λ₂·d)  third moment along the axis, positive towards the second disc
//! ```
//!
//! because each disc's own second moment is the same in all directions and grows with its area:
//! `2·λ₂` is that of a disc of the whole area. The blur of an edge adds the same to λ₁ and λ₂.
//! Where the nearer hides a part of the other, that lens is given back before: its area follows
//! from `d` and the radius, it lies in the middle, and three rounds settle it.

use super::moments::{Moments, ONE, over, root, times};

/// Second moment added by the blur of a usual edge: 1/2 px².
const BLUR: i128 = ONE / 2;
/// 16 π²: `area²/(λ₁·λ₂)` of an ellipse.
const ELLIPSE: i128 = (157.913_67 * ONE as f64) as i128;
/// An outline fills its ellipse of inertia at least to this share, or it is more than one marker. A
/// pair of discs that just touch has 4/5, half a disc 0.894, a rectangle 0.912.
const WHOLE: i128 = ONE * 58 / 64;
/// Below this share a pair is separated; between the two it overlaps too far.
const APART: i128 = ONE * 56 / 64;
/// Distance of a pair's centres in radii: less is too far an overlap, more is no pair.
const DISTANCE: [i128; 2] = [ONE * 27 / 16, ONE * 38 / 16];
/// 1/(2π): a disc's radius² from the area of two.
const RADIUS2: i128 = (0.159_154_943 * ONE as f64) as i128;
/// Coefficients of the lens's area, `3.771·e^1.5·(1 − 0.15·e)·r²` with `e = 1 − d/2r`, to 0.2 %
/// where e < 0.2.
const LENS: [i128; 2] = [(3.771 * ONE as f64) as i128, (0.15 * ONE as f64) as i128];
/// Largest difference of the shares of two discs.
const UNEQUAL: i128 = ONE * 3 / 10;
/// Iterations for the lens, and for the shares.
const ROUNDS: [u32; 2] = [3, 2];

/// Classification of a component's shape.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub enum Shape {
    /// One marker, or a part of one.
    Single,
    /// More than one marker, or a partly hidden one.
    Merged,
    /// Two markers that touch.
    Pair([Half; 2]),
}

/// One of two discs, in units of 2⁻¹⁶.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub struct Half {
    /// Its centre from the common centre: columns, lines.
    pub offset: [i128; 2],
    /// Its share of the area.
    pub share: i128,
}

/// The shape of a component of `area` px with a line as far apart as `aspect` columns (both in
/// units of 2⁻¹⁶).
pub fn shape(moments: &Moments, area: i128, aspect: i128) -> Shape {
    let [xx, xy, yy] = moments.second;
    let (xy, yy) = (times(xy, aspect), times(times(yy, aspect), aspect));
    let area = times(area, aspect);
    // Eigenvalues of the second moments; their difference is a hypotenuse.
    let between = root_of_square_sum(xx - yy, 2 * xy);
    let (along, across) = ((xx + yy + between) / 2, (xx + yy - between) / 2);
    let inertia = times((along - BLUR).max(0), (across - BLUR).max(1));
    let fill = over(over(times(area, area), ELLIPSE), inertia.max(1));
    if fill >= WHOLE || between == 0 {
        return Shape::Single;
    }
    // Half-angle formulas: the axis from the double angle, whose cosine is (xx − yy)/between.
    let cos2 = over(xx - yy, between);
    let [cos, sin] = [root((ONE + cos2) / 2), root((ONE - cos2) / 2) * xy.signum()];
    let pair = Pair::of(area, along, across);
    let in_radii = over(pair.distance, pair.radius);
    if fill >= APART || in_radii < DISTANCE[0] || in_radii > DISTANCE[1] {
        return Shape::Merged;
    }
    let (share, distance) = pair.shares(third_along(moments, aspect, cos, sin), area);
    let at = |length: i128| [times(cos, length), over(times(sin, length), aspect)];
    Shape::Pair([
        Half { offset: at(-times(ONE - share, distance)), share },
        Half { offset: at(times(share, distance)), share: ONE - share },
    ])
}

/// The third moment along an axis.
fn third_along(moments: &Moments, aspect: i128, cos: i128, sin: i128) -> i128 {
    let [xxx, xxy, xyy, yyy] = moments.third;
    let sin = times(sin, aspect);
    let terms =
        [(xxx, [cos, cos, cos]), (3 * xxy, [cos, cos, sin]), (3 * xyy, [cos, sin, sin]), (yyy, [sin; 3])];
    terms.iter().map(|(moment, factors)| factors.iter().fold(*moment, |m, &f| times(m, f))).sum()
}

/// Two equal discs with the second moments of a component.
struct Pair {
    radius: i128,
    distance: i128,
    /// Area of the lens, and second moments of both discs with it given back.
    lens: i128,
    along: i128,
    across: i128,
}

impl Pair {
    fn of(area: i128, along: i128, across: i128) -> Pair {
        let mut pair = Pair { radius: 0, distance: 2 * root(along - across), lens: 0, along, across };
        for _ in 0..ROUNDS[0] {
            let whole = area + pair.lens;
            let radius2 = times(whole, RADIUS2);
            pair.radius = root(radius2);
            let e = (ONE - over(pair.distance, 2 * pair.radius)).max(0);
            pair.lens = times(times(radius2, times(LENS[0], ONE - times(LENS[1], e))), times(e, root(e)));
            // The lens is 2·r·e wide along the axis; a segment of a parabola has a fifth of the
            // half width².
            let half = times(pair.radius, e);
            let high = (radius2 - times(pair.distance, pair.distance) / 4).max(0);
            let whole = area + pair.lens;
            let with_lens =
                |moment: i128, of_lens: i128| over(times(area, moment) + times(pair.lens, of_lens), whole);
            pair.along = with_lens(along, times(half, half) / 5);
            pair.across = with_lens(across, high / 5);
            pair.distance = 2 * root(pair.along - pair.across);
        }
        pair
    }

    /// Share of the first disc and the distance, from the third moment along the axis.
    fn shares(&self, third: i128, area: i128) -> (i128, i128) {
        let third = over(times(third, area), area + self.lens);
        let (mut difference, mut distance) = (0, self.distance);
        for _ in 0..ROUNDS[1] {
            // p·q = (1 − (p − q)²)/4.
            let product = (ONE - times(difference, difference)) / 4;
            distance = root(over(self.along - self.across, product));
            let per_difference = times(product, times(distance, times(distance, distance) - 6 * self.across));
            difference = over(third, per_difference).clamp(-UNEQUAL, UNEQUAL);
        }
        ((ONE + difference) / 2, distance)
    }
}

/// `√(a² + b²)`.
fn root_of_square_sum(a: i128, b: i128) -> i128 {
    ((a * a + b * b) as u128).isqrt() as i128
}
