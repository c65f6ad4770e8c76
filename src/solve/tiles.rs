//! Solving in pieces: a coarse preview of the whole object first, then the rest, each piece a call of its own.
//!
//! Every solver treats pixels apart, so the pieces together give what one call gives. Between two calls the
//! caller may show what is there, hand the next piece to another worker, or stop.

use super::{Measurements, Solution, Validity};
use crate::stack::Mask;
use glam::Vec3;

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

/// A solution in the making: which pixels are to be solved next, and what was made of those before.
#[derive(Clone, Debug)]
pub struct Assembly {
    /// Mask pixels, coarse to fine.
    order: Vec<u32>,
    /// Where the levels end in `order`.
    ends: [usize; 4],
    /// How many pixels of each level are not solved yet.
    left: [usize; 4],
    given: usize,
    solved: Solution,
}

/// Why a solved piece can't be put into its place.
#[derive(Debug, thiserror::Error, PartialEq)]
#[error(
    "{count} pixels from number {first} on: no piece is like that of {total} pixels in levels that end at {ends:?}"
)]
pub struct PieceError {
    /// Where it is said to begin.
    pub first: usize,
    /// Its pixels.
    pub count: usize,
    /// All pixels there are.
    pub total: usize,
    /// Where the levels end.
    pub ends: [usize; 4],
}

impl Assembly {
    /// Of the pixels of `mask`, of which none is solved yet.
    #[must_use]
    pub fn new(mask: &Mask) -> Self {
        let levels = coarse_to_fine(mask);
        let left = levels.each_ref().map(Vec::len);
        let mut end = 0;
        let ends = left.map(|count| {
            end += count;
            end
        });
        let solved = Solution {
            normals: vec![Vec3::Z; end],
            albedo: vec![0.0; end],
            validity: vec![Validity::Shadowed; end],
            uncertainty: Some(vec![90.0; end]),
            own: Vec::new(),
        };
        Self { order: levels.concat(), ends, left, given: 0, solved }
    }

    /// Number of pixels.
    #[must_use]
    pub fn total(&self) -> usize {
        self.order.len()
    }

    /// Number of pixels that are solved.
    #[must_use]
    pub fn done(&self) -> usize {
        self.order.len() - self.left.iter().sum::<usize>()
    }

    /// How many of the four levels (of [`coarse_to_fine`]) are solved.
    #[must_use]
    pub fn levels(&self) -> usize {
        self.left.iter().take_while(|&&left| left == 0).count()
    }

    /// The next pixels of a level, at most `most`, and their place in the order; `None` when all were given.
    pub fn next(&mut self, most: usize) -> Option<(usize, &[u32])> {
        let first = self.given;
        let level_end = *self.ends.iter().find(|&&end| end > first)?;
        self.given = level_end.min(first + most.max(1));
        Some((first, &self.order[first..self.given]))
    }

    /// Takes in what was made of the pixels that began at `first`.
    ///
    /// # Errors
    /// [`PieceError`] where there are no such pixels in one level.
    pub fn put(&mut self, first: usize, part: &Solution) -> Result<(), PieceError> {
        let count = part.normals.len();
        let level = self.ends.iter().position(|&end| end > first);
        let level = level.filter(|&level| count <= self.ends[level] - first);
        let Some((level, pixels)) = level.map(|level| (level, &self.order[first..first + count])) else {
            return Err(PieceError { first, count, total: self.total(), ends: self.ends });
        };
        for (i, &p) in pixels.iter().enumerate() {
            let p = p as usize;
            self.solved.normals[p] = part.normals[i];
            self.solved.albedo[p] = part.albedo[i];
            self.solved.validity[p] = part.validity[i];
            if let (Some(to), Some(from)) = (&mut self.solved.uncertainty, &part.uncertainty) {
                to[p] = from[i];
            }
        }
        self.left[level] = self.left[level].saturating_sub(count);
        Ok(())
    }

    /// For every pixel the one whose solution it shows: its own where all levels are solved, before that the next solved one's above and
    /// left.
    #[must_use]
    pub fn shown(&self, mask: &Mask) -> Vec<usize> {
        let mut last = self.order.first().map_or(0, |&p| p as usize);
        let by = shown_by(mask, self.levels().max(1) - 1);
        by.into_iter()
            .map(|by| {
                last = by.map_or(last, |p| p as usize);
                last
            })
            .collect()
    }

    /// What was put in so far, each pixel in its place; those that are not solved yet hold (0,0,1) and 90°.
    #[must_use]
    pub fn solved(&self) -> &Solution {
        &self.solved
    }

    /// The solution as far as it is there, for pixels that show what [`Assembly::shown`] says.
    #[must_use]
    pub fn solution(&self, shown: &[usize]) -> Solution {
        fn of<T: Copy>(values: &[T], shown: &[usize]) -> Vec<T> {
            shown.iter().map(|&p| values[p]).collect()
        }
        let all = &self.solved;
        Solution {
            normals: of(&all.normals, shown),
            albedo: of(&all.albedo, shown),
            validity: of(&all.validity, shown),
            uncertainty: all.uncertainty.as_ref().map(|u| of(u, shown)),
            own: Vec::new(),
        }
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::light::fibonacci_cap;
    use crate::rng::Rng;
    use crate::solve::{SOLVERS, by_name};

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
            let mut assembly = Assembly::new(&mask);
            let mut levels = Vec::new();
            while let Some((first, pixels)) = assembly.next(40) {
                let piece = Piece::of(&measurements, pixels);
                let part = solver.solve(&piece.measurements(&measurements)).unwrap();
                assembly.put(first, &part).unwrap();
                levels.push(assembly.levels());
            }
            assert_eq!((assembly.done(), assembly.levels()), (mask.len(), 4));
            assert!(levels.is_sorted() && [1, 2, 3].iter().all(|level| levels.contains(level)));
            let solution = assembly.solution(&assembly.shown(&mask));
            assert_eq!(solution.normals, whole.normals, "{name}");
            assert_eq!(solution.validity, whole.validity, "{name}");
        }
    }

    #[test]
    fn a_piece_that_was_never_given_is_refused() {
        let mask = Mask::full(20, 20).unwrap();
        let mut assembly = Assembly::new(&mask);
        let (first, pixels) = assembly.next(1000).unwrap();
        assert_eq!((first, pixels.len()), (0, 9));
        let flat = |count: usize| Solution {
            normals: vec![Vec3::X; count],
            albedo: vec![1.0; count],
            validity: vec![Validity::Valid; count],
            uncertainty: None,
            own: Vec::new(),
        };
        for (first, count) in [(0, 10), (5, 5), (400, 1), (usize::MAX, 1)] {
            assert!(assembly.put(first, &flat(count)).is_err(), "{first} {count}");
        }
        assembly.put(0, &flat(9)).unwrap();
        assert_eq!((assembly.levels(), assembly.done()), (1, 9));
        // Before the rest is solved, all pixels show the nine.
        let shown = assembly.solution(&assembly.shown(&mask));
        assert!(shown.normals.iter().all(|&n| n == Vec3::X));
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
