//! How long a straight move takes as Grbl plans it: a trapezoid of speed along the line.
//!
//! Grbl limits speed and acceleration *along the path* so that no axis exceeds its own (`planner.c`,
//! `limit_value_by_axis_maximum`): for unit vector u, `a = min_i a_i/|u_i|`, `v = min(F, min_i v_i/|u_i|)`.

/// What one axis may do.
#[derive(Clone, Copy, Debug, PartialEq, serde::Serialize, serde::Deserialize)]
#[serde(deny_unknown_fields)]
pub struct AxisLimits {
    /// Fastest, degrees a minute (`$110`, `$111`).
    pub rate: f64,
    /// Acceleration, degrees/s² (`$120`, `$121`).
    pub acceleration: f64,
}

/// A straight move from rest to rest.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Move {
    /// Length of the path, degrees.
    pub distance: f64,
    /// Speed it cruises at (or would, on a longer path), degrees/s.
    pub cruise: f64,
    /// Acceleration along the path, degrees/s².
    pub acceleration: f64,
}

impl Move {
    /// The move by `delta` degrees an axis at feed `feed` (degrees a minute along the path).
    #[must_use]
    pub fn new<const N: usize>(delta: [f64; N], limits: [AxisLimits; N], feed: f64) -> Self {
        let distance = libm::sqrt(delta.iter().map(|d| d * d).sum());
        let (mut rate, mut acceleration) = (feed, f64::INFINITY);
        for (d, limit) in delta.iter().zip(limits) {
            let share = (d / distance).abs();
            // NaN where the distance is 0: no axis limits a move that isn't one.
            if share > 0.0 {
                rate = rate.min(limit.rate / share);
                acceleration = acceleration.min(limit.acceleration / share);
            }
        }
        Self { distance, cruise: rate / 60.0, acceleration }
    }

    /// Seconds from rest to rest.
    #[must_use]
    pub fn seconds(&self) -> f64 {
        if self.distance <= 0.0 {
            return 0.0;
        }
        let ramp = self.cruise / self.acceleration;
        let ramps = self.cruise * ramp; // both ramps together
        if ramps >= self.distance {
            2.0 * libm::sqrt(self.distance / self.acceleration)
        } else {
            2.0 * ramp + (self.distance - ramps) / self.cruise
        }
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    const ARM: [AxisLimits; 2] =
        [AxisLimits { rate: 3600.0, acceleration: 120.0 }, AxisLimits { rate: 1800.0, acceleration: 60.0 }];

    #[test]
    fn long_moves_are_trapezoids_and_short_ones_triangles() {
        // 60 °/s reached in 0.5 s over 15° at each end.
        assert!((Move::new([90.0, 0.0], ARM, 1e6).seconds() - 2.0).abs() < 1e-12);
        assert!((Move::new([7.5, 0.0], ARM, 1e6).seconds() - 0.5).abs() < 1e-12);
        assert_eq!(Move::new([0.0, 0.0], ARM, 1e6).seconds(), 0.0);
    }

    #[test]
    fn no_axis_exceeds_its_own_limits() {
        let m = Move::new([30.0, 40.0], ARM, 1e6);
        assert!((m.cruise - 30.0 / 0.8).abs() < 1e-12 && (m.acceleration - 60.0 / 0.8).abs() < 1e-12);
        assert!((Move::new([30.0, 40.0], ARM, 600.0).cruise - 10.0).abs() < 1e-12);
    }
}
