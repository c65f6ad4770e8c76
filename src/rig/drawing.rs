//! A mask drawn by hand: polygons and brush strokes that add to it or take away from it; and the picture to draw on.

use super::hdr::Exposure;
use crate::stack::{Mask, StackError};
use crate::view::{Picture, Tone};

/// A mask in the making, row by row.
#[derive(Clone, Debug, PartialEq, Eq)]
pub struct Drawing {
    width: u32,
    height: u32,
    inside: Vec<bool>,
}

impl Drawing {
    /// Nothing drawn yet.
    #[must_use]
    pub fn new(width: u32, height: u32) -> Self {
        Self { width, height, inside: vec![false; width as usize * height as usize] }
    }

    /// What `mask` holds, to go on from.
    #[must_use]
    pub fn of(mask: &Mask) -> Self {
        let inside = mask.scatter(&vec![true; mask.len()], false);
        Self { width: mask.width(), height: mask.height(), inside }
    }

    /// Width in pixels.
    #[must_use]
    pub fn width(&self) -> u32 {
        self.width
    }

    /// Height in pixels.
    #[must_use]
    pub fn height(&self) -> u32 {
        self.height
    }

    /// Whether each pixel is inside, row by row.
    #[must_use]
    pub fn inside(&self) -> &[bool] {
        &self.inside
    }

    /// The mask.
    ///
    /// # Errors
    /// [`StackError::EmptyMask`] where nothing is drawn.
    pub fn mask(&self) -> Result<Mask, StackError> {
        Mask::new(self.width, self.height, &self.inside)
    }

    /// Sets the pixels whose centres lie within a polygon (even-odd rule), corners in pixels: the first pixel's centre
    /// is (0.5, 0.5). It is closed by itself; fewer than three corners, or one that is no number, draw nothing.
    pub fn polygon(&mut self, corners: &[[f64; 2]], value: bool) {
        if corners.len() < 3 || corners.iter().flatten().any(|v| !v.is_finite()) {
            return;
        }
        for y in 0..self.height {
            let row = f64::from(y) + 0.5;
            let mut cuts: Vec<f64> = (0..corners.len())
                .filter_map(|i| {
                    let ([x0, y0], [x1, y1]) = (corners[i], corners[(i + 1) % corners.len()]);
                    ((y0 <= row) != (y1 <= row)).then(|| x0 + (row - y0) / (y1 - y0) * (x1 - x0))
                })
                .collect();
            cuts.sort_by(f64::total_cmp);
            for pair in cuts.chunks_exact(2) {
                // Centres from the first at or right of one cut to the last left of the next.
                let bound = |x: f64| (x - 0.5).ceil().clamp(0.0, f64::from(self.width)) as usize;
                let start = y as usize * self.width as usize;
                self.inside[start + bound(pair[0])..start + bound(pair[1])].fill(value);
            }
        }
    }

    /// Sets the pixels whose centres a round brush of `radius` pixels passes over on a straight way.
    pub fn stroke(&mut self, from: [f64; 2], to: [f64; 2], radius: f64, value: bool) {
        if from.iter().chain(&to).chain([&radius]).any(|v| !v.is_finite()) {
            return;
        }
        let range = |a: f64, b: f64, size: u32| {
            let low = (a.min(b) - radius - 1.0).clamp(0.0, f64::from(size)) as u32;
            low..(a.max(b) + radius + 1.0).clamp(0.0, f64::from(size)) as u32
        };
        let (dx, dy) = (to[0] - from[0], to[1] - from[1]);
        let length = dx * dx + dy * dy;
        for y in range(from[1], to[1], self.height) {
            for x in range(from[0], to[0], self.width) {
                let (px, py) = (f64::from(x) + 0.5 - from[0], f64::from(y) + 0.5 - from[1]);
                let t = if length > 0.0 { ((px * dx + py * dy) / length).clamp(0.0, 1.0) } else { 0.0 };
                let (ex, ey) = (px - t * dx, py - t * dy);
                if ex * ex + ey * ey <= radius * radius {
                    self.inside[(y * self.width + x) as usize] = value;
                }
            }
        }
    }
}

/// What a camera sees, at most `side` pixels wide and high: means of blocks of pixels. Outside of the mask it is dim;
/// a block with a saturated pixel is magenta.
#[must_use]
pub fn preview(exposure: &Exposure, inside: Option<&[bool]>, side: u32) -> Picture {
    let image = &exposure.image;
    let step = image.width.max(image.height).div_ceil(side.max(1)).max(1);
    let (width, height) = (image.width.div_ceil(step), image.height.div_ceil(step));
    let tone = Tone::new(f32::from(exposure.white.saturating_sub(exposure.black)).max(1.0));
    let mut rgba = Vec::with_capacity(4 * (width * height) as usize);
    for y in 0..height {
        for x in 0..width {
            let (mut sum, mut count, mut kept, mut burnt) = ([0.0f32; 3], 0.0f32, 0.0f32, false);
            for v in y * step..((y + 1) * step).min(image.height) {
                for u in x * step..((x + 1) * step).min(image.width) {
                    let i = (v * image.width + u) as usize;
                    for (s, c) in sum.iter_mut().zip(image.rgb[i]) {
                        *s += f32::from(c.saturating_sub(exposure.black));
                        burnt |= c >= exposure.white;
                    }
                    kept += f32::from(u8::from(inside.is_none_or(|m| m.get(i).is_some_and(|k| *k))));
                    count += 1.0;
                }
            }
            let dim = if 2.0 * kept < count { 0.15 } else { 1.0 };
            let shown = sum.map(|s| tone.byte(dim * s / count));
            rgba.extend(if burnt && dim == 1.0 { [230, 40, 200] } else { shown });
            rgba.push(255);
        }
    }
    Picture { width, height, rgba }
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::image::Image;
    use crate::stack::BitDepth;

    fn area(d: &Drawing) -> usize {
        d.inside().iter().filter(|i| **i).count()
    }

    #[test]
    fn polygons_cover_their_area_and_holes_stay_open() {
        let mut d = Drawing::new(40, 30);
        d.polygon(&[[5.0, 5.0], [25.0, 5.0], [25.0, 20.0], [5.0, 20.0]], true);
        assert_eq!(area(&d), 20 * 15);
        d.polygon(&[[10.0, 10.0], [15.0, 10.0], [15.0, 15.0], [10.0, 15.0]], false);
        assert_eq!(area(&d), 20 * 15 - 25);
        assert_eq!(Drawing::of(&d.mask().unwrap()), d);
        // A triangle, partly outside the picture.
        let mut t = Drawing::new(40, 30);
        t.polygon(&[[-10.0, 0.0], [30.0, 0.0], [-10.0, 40.0]], true);
        let expected = (0..30).map(|y| 30 - y).sum::<usize>();
        assert!(area(&t).abs_diff(expected) <= 30, "{}", area(&t));
        let mut nothing = Drawing::new(4, 4);
        nothing.polygon(&[[0.0, 0.0], [f64::NAN, 3.0], [3.0, 3.0]], true);
        nothing.polygon(&[[0.0, 0.0], [3.0, 3.0]], true);
        assert!(nothing.mask().is_err());
    }

    #[test]
    fn the_preview_shows_mask_and_saturation() {
        let mut rgb = vec![[1000u16; 3]; 40 * 20];
        rgb[0] = [4095, 0, 0];
        let image = Image { width: 40, height: 20, bits: BitDepth::Sixteen, rgb };
        let e = Exposure { image, seconds: 0.01, black: 0, white: 4095 };
        let mut d = Drawing::new(40, 20);
        d.polygon(&[[0.0, 0.0], [20.0, 0.0], [20.0, 20.0], [0.0, 20.0]], true);
        let p = preview(&e, Some(d.inside()), 10);
        assert_eq!((p.width, p.height, p.rgba.len()), (10, 5, 200));
        assert_eq!(p.rgba[..3], [230, 40, 200]);
        assert!(p.rgba[4] > 100 && p.rgba[4 * 9] < 80, "{:?}", &p.rgba[..40]);
    }

    #[test]
    fn a_stroke_is_a_capsule() {
        let mut d = Drawing::new(100, 60);
        d.stroke([20.0, 30.0], [70.0, 30.0], 10.0, true);
        let expected = 50.0 * 20.0 + std::f64::consts::PI * 100.0;
        assert!((area(&d) as f64 - expected).abs() < 0.02 * expected, "{}", area(&d));
        d.stroke([0.0, 30.0], [500.0, 30.0], 10.0, false);
        assert_eq!(area(&d), 0);
        d.stroke([5.0, 5.0], [5.0, f64::INFINITY], 3.0, true);
        assert_eq!(area(&d), 0);
    }
}
