//! Mean and 95 % interval of repeated runs, median of objects.

/// Mean of `values`; 0 for none.
#[must_use]
pub fn mean(values: &[f64]) -> f64 {
    values.iter().sum::<f64>() / values.len().max(1) as f64
}

/// Median of `values`, of an even number the mean of the two in the middle; 0 for none.
#[must_use]
pub fn median(values: &[f64]) -> f64 {
    let mut sorted = values.to_vec();
    sorted.sort_by(f64::total_cmp);
    let upper = sorted.len() / 2;
    mean(&sorted[sorted.len().saturating_sub(1) / 2..sorted.len().min(upper + 1)])
}

/// 95 % confidence interval of the mean (Student's t); `None` for less than two values.
#[must_use]
pub fn interval95(values: &[f64]) -> Option<[f64; 2]> {
    let n = values.len();
    if n < 2 {
        return None;
    }
    let m = mean(values);
    let variance = values.iter().map(|v| (v - m) * (v - m)).sum::<f64>() / (n - 1) as f64;
    let half = student_t975(n - 1) * libm::sqrt(variance / n as f64);
    Some([m - half, m + half])
}

/// 97.5 % quantile of Student's t with `freedom` degrees of freedom.
fn student_t975(freedom: usize) -> f64 {
    const SMALL: [f64; 4] = [12.7062, 4.3027, 3.1824, 2.7764];
    if let Some(&t) = SMALL.get(freedom.wrapping_sub(1)) {
        return t;
    }
    // Expansion around the normal quantile (Abramowitz & Stegun 26.7.5).
    let (z, v) = (1.959_964f64, freedom as f64);
    let (z3, z5, z7) = (z.powi(3), z.powi(5), z.powi(7));
    z + (z3 + z) / (4.0 * v)
        + (5.0 * z5 + 16.0 * z3 + 3.0 * z) / (96.0 * v * v)
        + (3.0 * z7 + 19.0 * z5 + 17.0 * z3 - 15.0 * z) / (384.0 * v * v * v)
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn median_is_in_the_middle() {
        assert_eq!(median(&[]), 0.0);
        assert_eq!(median(&[3.0]), 3.0);
        assert_eq!(median(&[9.0, 1.0, 2.0]), 2.0);
        assert_eq!(median(&[9.0, 1.0, 4.0, 2.0]), 3.0);
    }

    #[test]
    fn interval_matches_tables() {
        assert!((student_t975(5) - 2.5706).abs() < 5e-3);
        assert!((student_t975(29) - 2.0452).abs() < 1e-4);
        let [lo, hi] = interval95(&[1.0, 2.0, 3.0, 4.0, 5.0]).unwrap();
        assert!((lo - 1.0368).abs() < 1e-3 && (hi - 4.9632).abs() < 1e-3);
        assert_eq!(interval95(&[1.0]), None);
    }
}
