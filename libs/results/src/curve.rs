//! Learning curves: the scores of a trainee at one level of a module, one attempt after the other.

use crate::attempt::Stored;

/// A curve.
#[derive(Debug, Clone, PartialEq)]
pub struct Curve {
    /// The module; scores of different ones are not to be compared.
    pub module: String,
    /// Trainee and level.
    pub label: String,
    /// Points of 100 and their deviation, in the order of the attempts.
    pub scores: Vec<(f64, f64)>,
}

/// The curves of some attempts, which must be in the order of time, and how many attempts are left
/// out: those broken off, and those of an older version of the score, which are not to be compared
/// with the newest.
pub fn curves(attempts: &[Stored]) -> (Vec<Curve>, usize) {
    let newest = attempts.iter().map(|s| s.attempt.score_version).max().unwrap_or(0);
    let mut curves: Vec<Curve> = Vec::new();
    let comparable = attempts.iter().filter(|s| s.attempt.score_version == newest && !s.attempt.broken_off);
    for Stored { trainee, attempt, .. } in comparable {
        let (module, label) = (attempt.module.clone(), format!("{trainee}, level {}", attempt.level));
        let place = curves.iter().position(|c| c.module == module && c.label == label).unwrap_or_else(|| {
            curves.push(Curve { module, label, scores: Vec::new() });
            curves.len() - 1
        });
        curves[place].scores.push((attempt.total, attempt.sigma));
    }
    curves.sort_by(|a, b| (&a.module, &a.label).cmp(&(&b.module, &b.label)));
    let shown: usize = curves.iter().map(|c| c.scores.len()).sum();
    (curves, attempts.len() - shown)
}

/// The curves of each module, which are drawn together; `curves` must be in the order of [`curves`].
pub fn by_module(curves: &[Curve]) -> impl Iterator<Item = &[Curve]> {
    curves.chunk_by(|a, b| a.module == b.module)
}

/// Attempts of the longest curve.
pub fn longest(curves: &[Curve]) -> usize {
    curves.iter().map(|c| c.scores.len()).max().unwrap_or(0)
}

#[cfg(test)]
pub(crate) mod tests {
    use super::*;
    use crate::attempt::Attempt;

    pub(crate) fn stored(trainee: &str, module: &str, score_version: u32, total: f64) -> Stored {
        let attempt = Attempt {
            module: module.into(),
            level: 1,
            score_version,
            total,
            sigma: 1.5,
            ..Attempt::default()
        };
        Stored { id: 0, trainee: trainee.into(), at: String::new(), attempt }
    }

    #[test]
    fn each_trainee_has_a_curve_for_each_module_of_the_newest_score() {
        let mut broken_off = stored("a", "shadow", 2, 10.0);
        broken_off.attempt.broken_off = true;
        let all = [
            stored("b", "shadow", 2, 40.0),
            stored("a", "shadow", 1, 99.0),
            stored("a", "shadow", 2, 30.0),
            stored("a", "forceps", 2, 20.0),
            stored("a", "shadow", 2, 50.0),
            broken_off,
        ];
        let (curves, left_out) = curves(&all);
        let of = |c: &Curve| (c.module.clone(), c.label.clone(), c.scores.len());
        let expected =
            [("forceps", "a, level 1", 1), ("shadow", "a, level 1", 2), ("shadow", "b, level 1", 1)];
        let expected = expected.map(|(module, label, count)| (module.into(), label.into(), count));
        assert_eq!(curves.iter().map(of).collect::<Vec<_>>(), expected);
        assert_eq!(by_module(&curves).map(<[Curve]>::len).collect::<Vec<_>>(), [1, 2]);
        assert_eq!((curves[1].scores.clone(), left_out), (vec![(30.0, 1.5), (50.0, 1.5)], 2));
        assert_eq!(longest(&curves), 2);
        assert_eq!(super::curves(&[]), (Vec::new(), 0));
    }
}
