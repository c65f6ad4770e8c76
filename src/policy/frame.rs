//! From mask pixels of any resolution to the network's square input frame.

use crate::stack::Mask;

/// Largest value of an input frame, in units of the first frame's 99 % quantile: highlights beyond it tell nothing more.
pub const CEILING: f32 = 2.0;

/// Cuts the square around a mask and averages its pixels over the cells of the input frame (by area; background
/// is 0). Made once an object.
#[derive(Clone, Debug)]
pub struct Crop {
    side: usize,
    /// (mask pixel, cell, share of the cell that the pixel covers).
    shares: Vec<(u32, u32, f32)>,
}

impl Crop {
    /// The crop of `mask` to frames of `side × side` cells.
    #[must_use]
    pub fn new(mask: &Mask, side: usize) -> Self {
        let (left, top, width, height) = mask.bounds();
        let extent = f64::from(width.max(height));
        let scale = side as f64 / extent;
        // Corner of the square, in pixels; the mask's bounds are in its middle.
        let x0 = f64::from(left) + 0.5 * (f64::from(width) - extent);
        let y0 = f64::from(top) + 0.5 * (f64::from(height) - extent);
        let mut shares = Vec::with_capacity(mask.len());
        for p in 0..mask.len() {
            let (x, y) = mask.position(p);
            let columns = overlaps((f64::from(x) - x0) * scale, scale, side);
            let rows = overlaps((f64::from(y) - y0) * scale, scale, side);
            for (row, tall) in rows {
                for &(column, wide) in &columns {
                    shares.push((p as u32, (row * side + column) as u32, (tall * wide) as f32));
                }
            }
        }
        Self { side, shares }
    }

    /// Side of the frame, cells.
    #[must_use]
    pub fn side(&self) -> usize {
        self.side
    }

    /// One value a mask pixel, averaged over each cell.
    #[must_use]
    pub fn average(&self, mut value: impl FnMut(usize) -> f32) -> Vec<f32> {
        let mut cells = vec![0.0; self.side * self.side];
        for &(pixel, cell, share) in &self.shares {
            cells[cell as usize] += share * value(pixel as usize);
        }
        cells
    }

    /// Values of the cells laid back on the mask pixels: the opposite of [`Crop::average`].
    #[must_use]
    pub fn spread(&self, cells: &[f32], pixels: usize) -> Vec<f32> {
        let (mut values, mut covered) = (vec![0.0; pixels], vec![0.0; pixels]);
        for &(pixel, cell, share) in &self.shares {
            values[pixel as usize] += share * cells[cell as usize];
            covered[pixel as usize] += share;
        }
        values.iter().zip(&covered).map(|(v, c)| if *c > 0.0 { v / c } else { 0.0 }).collect()
    }

    /// The input frame `[3, side, side]` of linear RGB mask pixels divided by `white`, limited to [`CEILING`].
    #[must_use]
    pub fn frame(&self, rgb: &[[f32; 3]], white: f32) -> Vec<f32> {
        let mut frame = Vec::with_capacity(3 * self.side * self.side);
        for channel in 0..3 {
            frame.extend(self.average(|p| rgb[p][channel] / white));
        }
        frame.iter_mut().for_each(|v| *v = v.clamp(0.0, CEILING));
        frame
    }
}

/// The input frames of one sequence.
#[derive(Clone, Debug)]
pub struct Frames {
    /// The square cut around the object.
    pub crop: Crop,
    white: Option<f32>,
}

impl Frames {
    /// The frames of `side × side` cells of the object in `mask`.
    #[must_use]
    pub fn new(mask: &Mask, side: usize) -> Self {
        Self { crop: Crop::new(mask, side), white: None }
    }

    /// What the frames are divided by, once there is one ([`white`]).
    #[must_use]
    pub fn white(&self) -> Option<f32> {
        self.white
    }

    /// The frame `[3, side, side]` of the newest picture, linear RGB of the mask pixels.
    pub fn next(&mut self, rgb: &[[f32; 3]]) -> Vec<f32> {
        let white = *self.white.get_or_insert_with(|| white(rgb));
        self.crop.frame(rgb, white)
    }
}

/// Cells of 0..`count` that the interval from `start` of length `length` (in cells) covers, and how much of each.
fn overlaps(start: f64, length: f64, count: usize) -> Vec<(usize, f64)> {
    let end = start + length;
    (start.max(0.0) as usize..count)
        .take_while(|&c| (c as f64) < end - 1e-9)
        .map(|c| (c, end.min(c as f64 + 1.0) - start.max(c as f64)))
        .filter(|&(_, share)| share > 1e-9)
        .collect()
}

/// The 99 % quantile of the mean over channels, by which a sequence's frames are divided; 1 for a black frame.
/// Taken from the first frame and kept, so that what is cached of earlier frames stays right.
#[must_use]
pub fn white(rgb: &[[f32; 3]]) -> f32 {
    let mut values: Vec<f32> = rgb.iter().map(|c| (c[0] + c[1] + c[2]) / 3.0).collect();
    if values.is_empty() {
        return 1.0;
    }
    let rank = (values.len() - 1) * 99 / 100;
    let (_, quantile, _) = values.select_nth_unstable_by(rank, f32::total_cmp);
    if *quantile > 1e-12 { *quantile } else { 1.0 }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn averages_keep_the_mean_at_any_scale() {
        for (width, height) in [(64, 64), (70, 40), (17, 23), (8, 5), (1, 1)] {
            let mask = Mask::full(width, height).unwrap();
            let crop = Crop::new(&mask, 16);
            let cells = crop.average(|_| 1.0);
            let area = f64::from(width * height) / f64::from(width.max(height)).powi(2);
            let mean = cells.iter().map(|&v| f64::from(v)).sum::<f64>() / 256.0;
            assert!((mean - area).abs() < 1e-4, "{width}×{height}: {mean} {area}");
            assert!(cells.iter().all(|&v| v <= 1.0 + 1e-5));
        }
    }

    #[test]
    fn the_object_fills_the_frame_and_keeps_its_place() {
        // A 4×4 object in the corner of a 20×20 image, one pixel lit.
        let inside: Vec<bool> = (0..400).map(|i| i % 20 < 4 && i / 20 < 4).collect();
        let mask = Mask::new(20, 20, &inside).unwrap();
        let crop = Crop::new(&mask, 8);
        let cells = crop.average(|p| f32::from(u8::from(mask.position(p) == (3, 1))));
        let lit: Vec<usize> = (0..64).filter(|&c| cells[c] > 0.5).collect();
        assert_eq!(lit, [2 * 8 + 6, 2 * 8 + 7, 3 * 8 + 6, 3 * 8 + 7]);
    }

    #[test]
    fn white_is_the_quantile_and_never_zero() {
        let rgb: Vec<[f32; 3]> = (0..=100).map(|i| [i as f32; 3]).collect();
        assert_eq!(white(&rgb), 99.0);
        assert_eq!(white(&[[0.0; 3]; 9]), 1.0);
        assert_eq!(white(&[]), 1.0);
    }
}
