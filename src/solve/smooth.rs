//! Gaussian means over the pixels of a mask.
//!
//! A Gaussian is three extended box filters in each direction (Gwosdek, Grewenig, Bruhn & Weickert, SSVM 2011), which have its variance
//! exactly and cost the same however wide it is; what is outside the mask does not count.

use crate::stack::Mask;

/// Boxes for one Gaussian.
const BOXES: usize = 3;

/// Means with one standard deviation over the pixels of one mask.
pub struct Smoother {
    width: usize,
    height: usize,
    /// Where the mask's pixels are in the bounding box.
    at: Vec<usize>,
    filter: ExtendedBox,
    /// For each pixel how much of the Gaussian is inside the mask.
    cover: Vec<f32>,
}

impl Smoother {
    /// For a standard deviation of `sigma` pixels.
    #[must_use]
    pub fn new(mask: &Mask, sigma: f32) -> Self {
        let (left, top, width, height) = mask.bounds();
        let place = |p| {
            let (x, y) = mask.position(p);
            ((y - top) * width + x - left) as usize
        };
        let at = (0..mask.len()).map(place).collect();
        let filter = ExtendedBox::new(sigma);
        let mut new = Self { width: width as usize, height: height as usize, at, filter, cover: Vec::new() };
        new.cover = new.sums(&vec![1.0; mask.len()]);
        new
    }

    /// For each pixel the mean of `values` (one for each pixel) around it.
    #[must_use]
    pub fn mean(&self, values: &[f32]) -> Vec<f32> {
        let mut sums = self.sums(values);
        sums.iter_mut().zip(&self.cover).for_each(|(s, c)| *s /= c.max(1e-6));
        sums
    }

    /// For each pixel how much of the Gaussian around it is inside the mask, 0 to 1.
    #[must_use]
    pub fn cover(&self) -> &[f32] {
        &self.cover
    }

    /// For each pixel half the difference of `values` between its right and left neighbour, and between its upper and lower one. A
    /// neighbour outside the mask counts as the pixel itself.
    #[must_use]
    pub fn slopes(&self, values: &[f32]) -> Vec<[f32; 2]> {
        let mut grid = vec![f32::NAN; self.width * self.height];
        self.at.iter().zip(values).for_each(|(&i, &v)| grid[i] = v);
        let slope = |(&i, &v): (&usize, &f32)| {
            let (x, y) = (i % self.width, i / self.width);
            let of = |inside: bool, i: usize| if inside && !grid[i].is_nan() { grid[i] } else { v };
            let right = of(x + 1 < self.width, i + 1);
            let left = of(x > 0, i.wrapping_sub(1));
            let below = of(y + 1 < self.height, i + self.width);
            let above = of(y > 0, i.wrapping_sub(self.width));
            [0.5 * (right - left), 0.5 * (above - below)]
        };
        self.at.iter().zip(values).map(slope).collect()
    }

    fn sums(&self, values: &[f32]) -> Vec<f32> {
        let mut grid = vec![0.0; self.width * self.height];
        self.at.iter().zip(values).for_each(|(&i, &v)| grid[i] = v);
        let rows = self.filter.along_rows(&grid, self.width);
        let both =
            transposed(&self.filter.along_rows(&transposed(&rows, self.width), self.height), self.height);
        self.at.iter().map(|&i| both[i]).collect()
    }
}

/// A box of `2 radius + 1` ones with `edge` at both ends.
#[derive(Clone, Copy, Debug)]
struct ExtendedBox {
    radius: usize,
    edge: f64,
}

impl ExtendedBox {
    fn new(sigma: f32) -> Self {
        let variance = f64::from(sigma * sigma) / BOXES as f64;
        let radius = (0.5 * libm::sqrt(12.0 * variance + 1.0) - 0.5).floor();
        let next = radius + 1.0;
        let edge = (2.0 * radius + 1.0) * (radius * next - 3.0 * variance) / (6.0 * (variance - next * next));
        Self { radius: radius as usize, edge }
    }

    fn along_rows(&self, grid: &[f32], width: usize) -> Vec<f32> {
        let mut out = grid.to_vec();
        let mut row = vec![0.0f32; width];
        let scale = 1.0 / (2.0 * self.radius as f64 + 1.0 + 2.0 * self.edge);
        for line in out.chunks_exact_mut(width) {
            for _ in 0..BOXES {
                row.copy_from_slice(line);
                let at = |i: usize| row.get(i).map_or(0.0, |&v| f64::from(v));
                let mut sum: f64 = (0..self.radius).map(at).sum();
                for (x, to) in line.iter_mut().enumerate() {
                    sum += at(x + self.radius);
                    // Before the first pixel there is nothing: an index below 0 wraps round to none.
                    let before = at(x.wrapping_sub(self.radius + 1));
                    *to = (scale * (sum + self.edge * (before + at(x + self.radius + 1)))) as f32;
                    sum -= at(x.wrapping_sub(self.radius));
                }
            }
        }
        out
    }
}

fn transposed(grid: &[f32], width: usize) -> Vec<f32> {
    let height = grid.len() / width;
    let mut out = vec![0.0; grid.len()];
    for (y, row) in grid.chunks_exact(width).enumerate() {
        for (x, &v) in row.iter().enumerate() {
            out[x * height + y] = v;
        }
    }
    out
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn a_point_becomes_a_gaussian() {
        let side = 61;
        let mask = Mask::full(side, side).unwrap();
        let mut point = vec![0.0; mask.len()];
        point[(30 * side + 30) as usize] = 1.0;
        for sigma in [0.6, 1.3, 4.0] {
            let smoother = Smoother::new(&mask, sigma);
            let spread = smoother.sums(&point);
            let total: f32 = spread.iter().sum();
            let variance: f32 =
                spread.iter().enumerate().map(|(i, v)| v * ((i % side as usize) as f32 - 30.0).powi(2)).sum();
            assert!((total - 1.0).abs() < 1e-4, "{total}");
            assert!((variance - sigma * sigma).abs() < 0.01 * sigma * sigma + 1e-3, "{sigma}: {variance}");
            let middle = spread[(30 * side + 30) as usize];
            let gauss = 1.0 / (std::f32::consts::TAU * sigma * sigma);
            assert!((middle / gauss - 1.0).abs() < 0.2, "{sigma}: {middle} {gauss}");
        }
    }

    #[test]
    fn what_is_outside_does_not_count() {
        let inside: Vec<bool> = (0..40 * 30).map(|i| i % 40 + i / 40 < 35).collect();
        let mask = Mask::new(40, 30, &inside).unwrap();
        for sigma in [0.6, 3.0, 12.0] {
            let smoother = Smoother::new(&mask, sigma);
            let mean = smoother.mean(&vec![2.5; mask.len()]);
            assert!(mean.iter().all(|m| (m - 2.5).abs() < 1e-4));
            assert!(smoother.cover().iter().all(|&c| c > 0.0 && c < 1.0 + 1e-5));
        }
    }

    #[test]
    fn slopes_are_those_of_a_plane() {
        let mask = Mask::full(9, 7).unwrap();
        let height = |p| {
            let (x, y) = mask.position(p);
            0.5 * x as f32 - 0.25 * y as f32
        };
        let values: Vec<f32> = (0..mask.len()).map(height).collect();
        let slopes = Smoother::new(&mask, 1.0).slopes(&values);
        assert_eq!(slopes[3 * 9 + 4], [0.5, 0.25]);
        assert_eq!(slopes[0], [0.25, 0.125]);
    }
}
