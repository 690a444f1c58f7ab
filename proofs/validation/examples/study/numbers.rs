//! Means, deviations, effects.

/// Draws of a bootstrap.
const DRAWS: usize = 10_000;

/// Mean; 0 of nothing.
pub fn mean(values: &[f64]) -> f64 {
    values.iter().sum::<f64>() / (values.len() as f64).max(1.0)
}

/// Deviation of a sample (n − 1).
pub fn deviation(values: &[f64]) -> f64 {
    let m = mean(values);
    let squares: f64 = values.iter().map(|v| (v - m) * (v - m)).sum();
    (squares / (values.len() as f64 - 1.0).max(1.0)).sqrt()
}

/// Cohen's d: difference of the means in pooled deviations (Cohen 1988); weighted by the sizes less
/// one.
pub fn effect(better: &[f64], worse: &[f64]) -> f64 {
    let [n, m] = [better, worse].map(|v| (v.len() as f64 - 1.0).max(0.0));
    let pooled = (n * deviation(better).powi(2) + m * deviation(worse).powi(2)) / (n + m).max(1.0);
    (mean(better) - mean(worse)) / pooled.sqrt().max(1e-9)
}

/// Smallest and largest.
pub fn range(values: &[f64]) -> [f64; 2] {
    values.iter().fold([f64::INFINITY, f64::NEG_INFINITY], |[low, high], v| [low.min(*v), high.max(*v)])
}

/// A statistic of two samples with the interval that holds 95 % of its bootstrap draws: each sample
/// resampled with replacement (Efron 1979), from a fixed seed.
pub fn bootstrap(a: &[f64], b: &[f64], statistic: fn(&[f64], &[f64]) -> f64) -> [f64; 3] {
    let mut random = protocol::random::Random::new(1, 99);
    let mut again = |of: &[f64]| -> Vec<f64> {
        of.iter().map(|_| of[((random.uniform() * of.len() as f64) as usize).min(of.len() - 1)]).collect()
    };
    let mut draws: Vec<f64> = (0..DRAWS).map(|_| statistic(&again(a), &again(b))).collect();
    draws.sort_by(f64::total_cmp);
    [statistic(a, b), draws[DRAWS / 40], draws[DRAWS - 1 - DRAWS / 40]]
}

/// Difference of two means.
pub fn difference(a: &[f64], b: &[f64]) -> f64 {
    mean(a) - mean(b)
}
