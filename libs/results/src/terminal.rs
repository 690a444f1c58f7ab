//! Learning curves as text, for a terminal.

use crate::curve::{Curve, by_module, longest};

/// Columns of the field in which points stand, at most.
const COLUMNS: usize = 64;
/// Rows of that field, five points of score each.
const ROWS: usize = 21;
/// A sign for each curve, in turn.
const SIGNS: [char; 8] = ['o', 'x', '+', '*', '#', '@', '%', '&'];

/// The curves of each module under its name, with an axis of points at the left and one of attempts
/// below. Where two curves meet, the later one shows.
pub fn plot(curves: &[Curve]) -> String {
    if longest(curves) == 0 {
        return "no attempts\n".into();
    }
    let panels = by_module(curves).map(|own| format!("{}\n{}", own[0].module, panel(own)));
    panels.collect::<Vec<_>>().join("\n")
}

/// The curves of a module.
fn panel(curves: &[Curve]) -> String {
    let most = longest(curves).max(1);
    let width = COLUMNS.min(most * 4 + 1);
    let mut field = vec![vec![' '; width]; ROWS];
    for (curve, sign) in curves.iter().zip(SIGNS.iter().cycle()) {
        for (i, (score, _)) in curve.scores.iter().enumerate() {
            let height = (score.clamp(0.0, 100.0) / 100.0 * (ROWS - 1) as f64).round() as usize;
            field[ROWS - 1 - height][column(i, most, width)] = *sign;
        }
    }
    let mut text = String::new();
    for (r, row) in field.iter().enumerate() {
        let points = 100 - r * 100 / (ROWS - 1);
        let axis = if r % 5 == 0 { format!("{points:>4} ┤") } else { "     │".into() };
        text.push_str(format!("{axis}{}", row.iter().collect::<String>()).trim_end());
        text.push('\n');
    }
    let last = column(most - 1, most, width);
    text.push_str(&format!("     └{}\n", "─".repeat(width)));
    let below = if most == 1 { " 1".into() } else { format!(" 1{:>1$}", most, last) };
    text.push_str(&format!("     {below}  attempt\n"));
    for (curve, sign) in curves.iter().zip(SIGNS.iter().cycle()) {
        text.push_str(&format!("  {sign} {}\n", summary(curve)));
    }
    text
}

/// Column of an attempt.
fn column(attempt: usize, most: usize, width: usize) -> usize {
    if most < 2 { 0 } else { attempt * (width - 1) / (most - 1) }
}

/// Label, first and last score of a curve.
fn summary(curve: &Curve) -> String {
    let score = |(total, sigma): &(f64, f64)| format!("{total:.1} ± {sigma:.1}");
    match curve.scores.as_slice() {
        [] => curve.label.clone(),
        [only] => format!("{}: {}", curve.label, score(only)),
        [first, .., last] => format!("{}: {} to {}", curve.label, score(first), score(last)),
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn points_stand_where_their_scores_are() {
        let curve = |module: &str, label: &str, scores: &[f64]| Curve {
            module: module.into(),
            label: label.into(),
            scores: scores.iter().map(|s| (*s, 0.5)).collect(),
        };
        let two = [curve("shadow", "a", &[0.0, 50.0, 100.0]), curve("shadow", "b", &[-20.0])];
        let text = plot(&two);
        let lines: Vec<&str> = text.lines().skip(1).collect();
        assert_eq!(lines[0], format!(" 100 ┤{}o", " ".repeat(12)));
        assert_eq!(lines[10], "  50 ┤      o");
        assert_eq!(lines[20], "   0 ┤x", "below 0 is drawn at 0, and the later curve shows");
        assert_eq!(lines[22], "      1           3  attempt");
        assert!(text.ends_with("  o a: 0.0 ± 0.5 to 100.0 ± 0.5\n  x b: -20.0 ± 0.5\n"), "{text}");
        assert!(plot(&[]).contains("no attempts"));
        let other = [&[curve("forceps", "a", &[7.0])][..], &two].concat();
        assert_eq!(plot(&other), format!("{}\n{text}", plot(&other[..1])), "a field for each module");
        assert!(plot(&other).starts_with("forceps\n 100 ┤") && text.starts_with("shadow\n 100 ┤"));
    }

    #[test]
    fn many_attempts_keep_the_width() {
        let many = Curve {
            module: "shadow".into(),
            label: "m".into(),
            scores: (0..500).map(|i| (f64::from(i) / 5.0, 0.0)).collect(),
        };
        assert!(plot(&[many]).lines().take(23).all(|line| line.chars().count() <= 80));
    }
}
