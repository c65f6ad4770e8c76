//! Solving in pieces: a coarse preview of the whole object first, then the rest, each piece a call of its own.
//!
//! Every solver treats pixels apart, so the pieces together give what one call gives. Between two calls the
//! caller may show what is there, hand the next piece to another worker, or stop.

use super::Measurements;
use crate::stack::Mask;

/// Mask pixels in the order in which a picture is best filled: every 8th of every 8th row, then every 4th, every 2nd,
/// and the rest. Each entry is one level; together they hold every pixel once.
#[must_use]
pub fn coarse_to_fine(mask: &Mask) -> [Vec<u32>; 4] {
    let mut levels: [Vec<u32>; 4] = Default::default();
    for p in 0..mask.len() {
        let (x, y) = mask.position(p);
        let level = [8, 4, 2].iter().position(|step| x % step == 0 && y % step == 0).unwrap_or(3);
        levels[level].push(p as u32);
    }
    levels
}

/// For each mask pixel the nearest pixel above and left of it that a level up to `level` (of [`coarse_to_fine`]) has
/// solved, or itself: what a preview shows there. `None` where that place is outside the mask.
#[must_use]
pub fn shown_by(mask: &Mask, level: usize) -> Vec<Option<u32>> {
    let step = [8, 4, 2, 1][level.min(3)];
    let numbers: Vec<u32> = (0..mask.len() as u32).collect();
    let number = mask.scatter(&numbers, u32::MAX);
    (0..mask.len())
        .map(|p| {
            let (x, y) = mask.position(p);
            let n = number[((y - y % step) * mask.width() + (x - x % step)) as usize];
            (n != u32::MAX).then_some(n)
        })
        .collect()
}

/// The values of some pixels, owned: what is handed to a worker.
#[derive(Clone, Debug, PartialEq)]
pub struct Piece {
    /// For each image the values of the chosen pixels.
    pub images: Vec<Vec<f32>>,
    /// For each image which of them are saturated; empty where none is.
    pub saturated: Vec<Vec<bool>>,
}

impl Piece {
    /// The values of `pixels` (numbers of mask pixels).
    ///
    /// # Panics
    /// Where a number is beyond the images.
    #[must_use]
    pub fn of(measurements: &Measurements, pixels: &[u32]) -> Self {
        let pick = |image: &&[f32]| pixels.iter().map(|&p| image[p as usize]).collect();
        let flagged = |flags: &&[bool]| match flags {
            [] => Vec::new(),
            _ => pixels.iter().map(|&p| flags[p as usize]).collect(),
        };
        Self {
            images: measurements.images.iter().map(pick).collect(),
            saturated: measurements.saturated.iter().map(flagged).collect(),
        }
    }

    /// As a solver takes it, with the lights of `whole`.
    #[must_use]
    pub fn measurements<'a>(&'a self, whole: &Measurements) -> Measurements<'a> {
        Measurements {
            lights: whole.lights.clone(),
            images: self.images.iter().map(Vec::as_slice).collect(),
            saturated: self.saturated.iter().map(Vec::as_slice).collect(),
        }
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::light::fibonacci_cap;
    use crate::rng::Rng;
    use crate::solve::{SOLVERS, by_name};
    use glam::Vec3;

    #[test]
    fn pieces_together_are_the_whole() {
        let mut rng = Rng::new(6);
        let inside: Vec<bool> = (0..23 * 17).map(|_| rng.uniform() < 0.8).collect();
        let mask = Mask::new(23, 17, &inside).unwrap();
        let images: Vec<Vec<f32>> =
            (0..6).map(|_| (0..mask.len()).map(|_| rng.uniform()).collect()).collect();
        let measurements = Measurements {
            lights: fibonacci_cap(6, 0.8),
            images: images.iter().map(Vec::as_slice).collect(),
            saturated: Vec::new(),
        };
        for name in SOLVERS.iter().map(|s| s.name) {
            let solver = by_name(name).unwrap();
            let whole = solver.solve(&measurements).unwrap();
            let mut normals = vec![Vec3::ZERO; mask.len()];
            for level in coarse_to_fine(&mask) {
                let piece = Piece::of(&measurements, &level);
                let part = solver.solve(&piece.measurements(&measurements)).unwrap();
                for (&p, n) in level.iter().zip(part.normals) {
                    normals[p as usize] = n;
                }
            }
            assert_eq!(normals, whole.normals, "{name}");
        }
    }

    #[test]
    fn a_preview_shows_pixels_of_its_level() {
        let mask = Mask::full(20, 20).unwrap();
        let first = &coarse_to_fine(&mask)[0];
        assert_eq!(first.len(), 9);
        assert!(shown_by(&mask, 0).iter().all(|p| first.contains(&p.unwrap())));
        assert!(shown_by(&mask, 3).iter().enumerate().all(|(p, s)| *s == Some(p as u32)));
    }
}
