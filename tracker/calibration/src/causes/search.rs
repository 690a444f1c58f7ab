//! Estimation of a parameter by the residuals that it leaves: a coarse search, then parabolas, and halves at its
//! ends.

/// Refinements by a parabola or a half.
const REFINEMENTS: usize = 5;

/// The argument with the least cost, and that cost.
pub fn best_of(tried: impl Iterator<Item = f64>, cost: impl Fn(f64) -> Option<f64>) -> Option<(f64, f64)> {
    tried.filter_map(|x| Some((x, cost(x)?))).min_by(|a, b| a.1.total_cmp(&b.1))
}

/// The argument with the least cost near the best of `coarse`, which rise, and that cost. `None` where no
/// argument has a cost.
pub fn least(coarse: &[f64], mut cost: impl FnMut(f64) -> Option<f64>) -> Option<(f64, f64)> {
    let mut known: Vec<(f64, f64)> = coarse.iter().filter_map(|&x| Some((x, cost(x)?))).collect();
    for _ in 0..REFINEMENTS {
        let best = (0..known.len()).min_by(|&a, &b| known[a].1.total_cmp(&known[b].1))?;
        let next = match best {
            0 => known.get(1).map(|second| 0.5 * (known[0].0 + second.0)),
            _ if best + 1 == known.len() => Some(0.5 * (known[best - 1].0 + known[best].0)),
            _ => vertex([known[best - 1], known[best], known[best + 1]]),
        };
        let Some(x) = next else { break };
        let Some(y) = cost(x) else { break };
        let place = known.partition_point(|(at, _)| *at < x);
        known.insert(place, (x, y));
    }
    known.into_iter().min_by(|a, b| a.1.total_cmp(&b.1))
}

/// The lowest place of the parabola through three points; between them, and away from all of them.
fn vertex([a, b, c]: [(f64, f64); 3]) -> Option<f64> {
    let (left, right) = (b.0 - a.0, c.0 - b.0);
    let (down, up) = ((b.1 - a.1) / left, (c.1 - b.1) / right);
    let x = b.0 - 0.5 * (down * right + up * left) / (up - down);
    let apart = 0.02 * (c.0 - a.0);
    let usable = x.is_finite() && x > a.0 + apart && x < c.0 - apart && (x - b.0).abs() > apart / 4.0;
    usable.then_some(x)
}

#[cfg(test)]
mod tests {
    use super::*;
    use proptest::prelude::*;

    proptest! {
        #[test]
        fn the_least_of_a_smooth_cost_is_found(at in -7.0..7.0f64, steep in 0.1..0.9f64) {
            let mut evaluated = 0;
            let cost = |x: f64| {
                evaluated += 1;
                Some(((steep * (x - at)).powi(2) + 0.01).sqrt().min(4.0))
            };
            let (x, _) = least(&[-8.0, -4.0, -2.0, 0.0, 2.0, 4.0, 8.0], cost).unwrap();
            prop_assert!((x - at).abs() < 0.6, "{} for {}", x, at);
            prop_assert!(evaluated <= 12);
        }
    }

    #[test]
    fn without_a_cost_there_is_nothing() {
        assert_eq!(least(&[1.0, 2.0], |_| None), None);
        let (x, _) = least(&[-1.0, 1.0], |x| Some(x * x)).unwrap();
        assert!(x.abs() < 0.3, "{x}");
    }
}
