//! The one source of randomness: a seeded generator, the same on every platform.

use glam::Vec3;
use rand::{Rng as _, RngExt as _, SeedableRng as _};
use rand_pcg::Pcg64Mcg;

/// A seeded generator (PCG 64, 128-bit state). Same seed, same numbers, native and WASM.
#[derive(Clone, Debug)]
pub struct Rng(Pcg64Mcg);

impl Rng {
    /// A generator for `seed`.
    #[must_use]
    pub fn new(seed: u64) -> Self {
        Self(Pcg64Mcg::seed_from_u64(seed))
    }

    /// An independent generator for item `stream` of a seeded family (object number, draw number).
    #[must_use]
    pub fn stream(seed: u64, stream: u64) -> Self {
        // SplitMix64 finaliser: neighbouring streams must not give correlated generators.
        let mut z = seed ^ stream.wrapping_add(1).wrapping_mul(0x9E37_79B9_7F4A_7C15);
        z = (z ^ (z >> 30)).wrapping_mul(0xBF58_476D_1CE4_E5B9);
        z = (z ^ (z >> 27)).wrapping_mul(0x94D0_49BB_1331_11EB);
        Self::new(z ^ (z >> 31))
    }

    /// Uniform 64 bits.
    pub fn next_u64(&mut self) -> u64 {
        self.0.next_u64()
    }

    /// Uniform in [0, 1).
    pub fn uniform(&mut self) -> f32 {
        (self.0.next_u64() >> 40) as f32 / (1u32 << 24) as f32
    }

    /// Uniform in [low, high).
    pub fn range(&mut self, low: f32, high: f32) -> f32 {
        low + (high - low) * self.uniform()
    }

    /// Uniform in 0..n; 0 when n is 0.
    pub fn below(&mut self, n: usize) -> usize {
        self.below_u64(n as u64) as usize
    }

    /// Uniform in 0..n, also where `usize` has 32 bits; 0 when n is 0.
    pub fn below_u64(&mut self, n: u64) -> u64 {
        if n == 0 { 0 } else { self.0.random_range(0..n) }
    }

    /// Standard normal (Box-Muller).
    pub fn normal(&mut self) -> f32 {
        let u = 1.0 - self.uniform();
        let v = self.uniform();
        libm::sqrtf(-2.0 * libm::logf(u)) * libm::cosf(core::f32::consts::TAU * v)
    }

    /// Uniform by area on the cap of the hemisphere whose slant is at most `reach` radians.
    pub fn direction(&mut self, reach: f32) -> Vec3 {
        let z = 1.0 - self.uniform() * (1.0 - libm::cosf(reach));
        let r = libm::sqrtf((1.0 - z * z).max(0.0));
        let phi = core::f32::consts::TAU * self.uniform();
        Vec3::new(r * libm::cosf(phi), r * libm::sinf(phi), z).normalize()
    }

    /// `count` distinct indices of 0..n in random order (all of them when `count` > n).
    pub fn sample(&mut self, n: usize, count: usize) -> Vec<usize> {
        let mut all: Vec<usize> = (0..n).collect();
        let count = count.min(n);
        for i in 0..count {
            let j = i + self.below(n - i);
            all.swap(i, j);
        }
        all.truncate(count);
        all
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn streams_differ_and_repeat() {
        let a: Vec<u64> = (0..4).map(|s| Rng::stream(1, s).next_u64()).collect();
        let b: Vec<u64> = (0..4).map(|s| Rng::stream(1, s).next_u64()).collect();
        assert_eq!(a, b);
        assert!(a.windows(2).all(|w| w[0] != w[1]));
    }

    #[test]
    fn directions_stay_within_reach_and_fill_it() {
        let mut rng = Rng::new(3);
        let reach = 0.7f32;
        let dirs: Vec<_> = (0..2000).map(|_| rng.direction(reach)).collect();
        assert!(dirs.iter().all(|d| (d.length() - 1.0).abs() < 1e-6 && d.z >= libm::cosf(reach) - 1e-6));
        let mean_z = dirs.iter().map(|d| d.z).sum::<f32>() / 2000.0;
        assert!((mean_z - (1.0 + libm::cosf(reach)) / 2.0).abs() < 0.01);
    }

    #[test]
    fn sample_is_a_permutation() {
        let mut s = Rng::new(9).sample(20, 50);
        s.sort_unstable();
        assert_eq!(s, (0..20).collect::<Vec<_>>());
    }
}
