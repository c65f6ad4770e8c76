//! One linear image of high dynamic range from a bracket of exposures.
//!
//! `E = Σ w(z)·z/t / Σ w(z)` with a hat w that is 0 at black and at saturation; where all exposures are saturated
//! the shortest is taken, where all are black the longest. Values are in units of full scale at the shortest
//! exposure, so they lie in 0..=1.

use crate::image::Image;
use crate::stack::{Mask, StackError};

/// One exposure of a linear camera.
#[derive(Clone, Debug, PartialEq)]
pub struct Exposure {
    /// Code values.
    pub image: Image,
    /// Exposure time, seconds.
    pub seconds: f64,
    /// Code value of black (sensor offset).
    pub black: u16,
    /// Code value at and above which a pixel is saturated: 4095 for 12 bits in a 16-bit file, 65535 for shifted ones.
    pub white: u16,
}

/// Part of the sensor that is kept.
#[derive(Clone, Copy, Debug, PartialEq, Eq, serde::Serialize, serde::Deserialize)]
pub struct Crop {
    /// First column.
    pub left: u32,
    /// First row.
    pub top: u32,
    /// Width in pixels.
    pub width: u32,
    /// Height in pixels.
    pub height: u32,
}

/// A merged image.
#[derive(Clone, Debug, PartialEq)]
pub struct Merged {
    /// Width in pixels.
    pub width: u32,
    /// Height in pixels.
    pub height: u32,
    /// Linear RGB, row-major; 1 is full scale at the shortest exposure.
    pub rgb: Vec<[f32; 3]>,
    /// Pixels of which a channel is saturated in every exposure.
    pub saturated: Vec<bool>,
    /// Pixels that are black in every exposure.
    pub dark: Vec<bool>,
}

/// Why exposures can't be merged.
#[derive(Clone, Debug, thiserror::Error, PartialEq)]
pub enum HdrError {
    /// There is none.
    #[error("no exposure to merge")]
    None,
    /// Different sizes.
    #[error("exposure {index} has {found:?} pixels, the first {expected:?}")]
    Size {
        /// Which exposure, from 0.
        index: usize,
        /// Its width and height.
        found: (u32, u32),
        /// Those of the first.
        expected: (u32, u32),
    },
    /// Time or range is not usable.
    #[error(
        "exposure {index}: time {seconds} s, black {black}, white {white}; the time must be positive and white above black"
    )]
    Exposure {
        /// Which exposure, from 0.
        index: usize,
        /// Its time.
        seconds: f64,
        /// Its black level.
        black: u16,
        /// Its white level.
        white: u16,
    },
    /// Dark frames don't belong to the exposures.
    #[error("{found} dark frames for {expected} exposures: take one with the LED off for each exposure time")]
    Dark {
        /// Number of dark frames.
        found: usize,
        /// Number of exposures.
        expected: usize,
    },
    /// The crop leaves the image.
    #[error("the crop {crop:?} leaves the {width}×{height} image")]
    Crop {
        /// The crop.
        crop: Crop,
        /// Width of the image.
        width: u32,
        /// Height of the image.
        height: u32,
    },
}

/// The hat: 0 at black and at saturation, 1 in the middle.
fn hat(z: f32) -> f32 {
    (1.0 - (2.0 * z - 1.0).abs()).max(0.0)
}

/// Merges a bracket, taken in any order. `dark` are the same exposures with the light off; they are subtracted.
///
/// # Errors
/// [`HdrError`].
pub fn merge(bracket: &[Exposure], dark: Option<&[Exposure]>) -> Result<Merged, HdrError> {
    let first = bracket.first().ok_or(HdrError::None)?;
    let (width, height) = (first.image.width, first.image.height);
    for (index, e) in bracket.iter().chain(dark.unwrap_or_default()).enumerate() {
        let found = (e.image.width, e.image.height);
        if found != (width, height) {
            return Err(HdrError::Size { index, found, expected: (width, height) });
        }
        if !(e.seconds > 0.0 && e.seconds.is_finite() && e.white > e.black) {
            return Err(HdrError::Exposure { index, seconds: e.seconds, black: e.black, white: e.white });
        }
    }
    let paired = |dark: &[Exposure]| {
        dark.len() == bracket.len()
            && bracket.iter().zip(dark).all(|(e, d)| (e.seconds - d.seconds).abs() <= 1e-3 * e.seconds)
    };
    if let Some(frames) = dark.filter(|d| !paired(d)) {
        return Err(HdrError::Dark { found: frames.len(), expected: bracket.len() });
    }
    let shortest = bracket.iter().map(|e| e.seconds).fold(f64::INFINITY, f64::min);
    let by_time = |longest: bool| {
        let order = |a: &&Exposure, b: &&Exposure| a.seconds.total_cmp(&b.seconds);
        let all = bracket.iter().enumerate();
        let key = |x: &(usize, &Exposure), y: &(usize, &Exposure)| order(&x.1, &y.1);
        if longest { all.max_by(key) } else { all.min_by(key) }.map_or(0, |(i, _)| i)
    };
    let (short, long) = (by_time(false), by_time(true));
    let pixels = first.image.rgb.len();
    let mut out = Merged {
        width,
        height,
        rgb: Vec::with_capacity(pixels),
        saturated: Vec::with_capacity(pixels),
        dark: Vec::with_capacity(pixels),
    };
    for p in 0..pixels {
        let mut rgb = [0.0f32; 3];
        let (mut burnt, mut black) = (false, true);
        for (c, value) in rgb.iter_mut().enumerate() {
            let (mut sum, mut weights) = (0.0f32, 0.0f32);
            let (mut all_white, mut all_black) = (true, true);
            // Value in full scales at the shortest exposure, ambient taken off.
            let radiance = |i: usize| {
                let e = &bracket[i];
                let full = f32::from(e.white - e.black);
                let z = f32::from(e.image.rgb[p][c]) - f32::from(e.black);
                let z = z.min(full) / full;
                let ambient =
                    dark.map_or(0.0, |d| (f32::from(d[i].image.rgb[p][c]) - f32::from(d[i].black)) / full);
                (z, (z - ambient) * (shortest / e.seconds) as f32)
            };
            for (i, e) in bracket.iter().enumerate() {
                let (z, r) = radiance(i);
                all_white &= e.image.rgb[p][c] >= e.white;
                all_black &= e.image.rgb[p][c] <= e.black;
                let w = hat(z);
                sum += w * r;
                weights += w;
            }
            *value = if all_white {
                radiance(short).1
            } else if weights > 0.0 {
                sum / weights
            } else {
                radiance(if all_black { long } else { short }).1
            };
            *value = value.clamp(0.0, 1.0);
            burnt |= all_white;
            black &= all_black;
        }
        out.rgb.push(rgb);
        out.saturated.push(burnt);
        out.dark.push(black);
    }
    Ok(out)
}

/// Exposure times that measure a range of `range` : 1 with at least `codes` code values of a `bits`-bit camera at the
/// dark end, from the shortest time on; the longest is at most `longest`.
#[must_use]
pub fn bracket(shortest: f64, longest: f64, range: f64, bits: u32, codes: f64) -> Vec<f64> {
    let full = f64::from((1u32 << bits.min(16)) - 1);
    // The darkest must reach `codes` in the longest exposure; steps of 8 keep every value well inside one of them.
    let needed = (codes * range / full).max(1.0);
    let end = (shortest * needed).min(longest.max(shortest));
    let steps = libm::ceil(libm::log(end / shortest) / libm::log(8.0) - 1e-9).max(0.0) as u32;
    (0..=steps)
        .map(|k| shortest * libm::pow(end / shortest, f64::from(k) / f64::from(steps.max(1))))
        .collect()
}

impl Crop {
    /// Whether a point (the first pixel's centre is (0.5, 0.5)) lies in it.
    #[must_use]
    pub fn contains(&self, x: f64, y: f64) -> bool {
        let within =
            |v: f64, start: u32, size: u32| v >= f64::from(start) && v < f64::from(start) + f64::from(size);
        within(x, self.left, self.width) && within(y, self.top, self.height)
    }

    /// The part of `image`.
    ///
    /// # Errors
    /// [`HdrError::Crop`] where it leaves the image or is empty.
    pub fn apply(&self, image: &Image) -> Result<Image, HdrError> {
        let fits = |start: u32, size: u32, whole: u32| {
            size > 0 && u64::from(start) + u64::from(size) <= u64::from(whole)
        };
        if !fits(self.left, self.width, image.width) || !fits(self.top, self.height, image.height) {
            return Err(HdrError::Crop { crop: *self, width: image.width, height: image.height });
        }
        let mut rgb = Vec::with_capacity(self.width as usize * self.height as usize);
        for y in self.top..self.top + self.height {
            let start = (y * image.width + self.left) as usize;
            rgb.extend_from_slice(&image.rgb[start..start + self.width as usize]);
        }
        Ok(Image { width: self.width, height: self.height, bits: image.bits, rgb })
    }
}

fn brightness(c: &[f32; 3]) -> f32 {
    c[0].max(c[1]).max(c[2]).max(1e-5)
}

/// The brightness that parts the object from what is dark around it: Otsu's threshold of the logarithm.
#[must_use]
pub fn threshold_level(merged: &Merged) -> f32 {
    let level: Vec<f32> = merged.rgb.iter().map(|c| libm::log2f(brightness(c))).collect();
    libm::exp2f(otsu(&level))
}

/// The object's mask from a merged image under light: brighter than `level`, the largest connected piece, its holes
/// filled.
///
/// # Errors
/// [`StackError::EmptyMask`] where nothing is brighter.
pub fn threshold_mask(merged: &Merged, level: f32) -> Result<Mask, StackError> {
    let (w, h) = (merged.width as usize, merged.height as usize);
    let inside: Vec<bool> = merged.rgb.iter().map(|c| brightness(c) > level).collect();
    let kept = largest_piece(&inside, w, h, true);
    // What the outside can't reach is a hole.
    let outside = largest_border_piece(&kept, w, h);
    Mask::new(merged.width, merged.height, &outside.iter().map(|&o| !o).collect::<Vec<_>>())
}

/// The threshold that parts the values into the two classes furthest apart (Otsu 1979), over 256 bins.
fn otsu(values: &[f32]) -> f32 {
    let (low, high) = values.iter().fold((f32::MAX, f32::MIN), |(a, b), &v| (a.min(v), b.max(v)));
    if high <= low {
        return high;
    }
    let mut bins = [0.0f64; 256];
    for &v in values {
        bins[((v - low) / (high - low) * 255.0) as usize] += 1.0;
    }
    let total: f64 = values.len() as f64;
    let mean: f64 = bins.iter().enumerate().map(|(i, n)| i as f64 * n).sum::<f64>() / total;
    let (mut weight, mut sum, mut best, mut at) = (0.0, 0.0, -1.0, 0);
    for (i, n) in bins.iter().enumerate() {
        weight += n / total;
        sum += i as f64 * n / total;
        let between = weight * (1.0 - weight);
        if between > 0.0 {
            let d = mean * weight - sum;
            if d * d / between > best {
                (best, at) = (d * d / between, i);
            }
        }
    }
    low + (high - low) * (at as f32 + 1.0) / 256.0
}

/// The largest 4-connected piece of the pixels that are `inside`.
pub(crate) fn largest_piece(inside: &[bool], w: usize, h: usize, value: bool) -> Vec<bool> {
    let mut label = vec![0u32; inside.len()];
    let (mut best, mut most, mut next) = (0, 0, 0);
    for start in 0..inside.len() {
        if inside[start] == value && label[start] == 0 {
            next += 1;
            let size = flood(start, next, &mut label, |p| inside[p] == value, w, h);
            if size > most {
                (best, most) = (next, size);
            }
        }
    }
    label.iter().map(|&l| l == best && best > 0).collect()
}

/// All pixels outside `kept` that are connected to the border.
fn largest_border_piece(kept: &[bool], w: usize, h: usize) -> Vec<bool> {
    let mut label = vec![0u32; kept.len()];
    let border = (0..w).flat_map(|x| [x, (h - 1) * w + x]).chain((0..h).flat_map(|y| [y * w, y * w + w - 1]));
    for start in border {
        if !kept[start] && label[start] == 0 {
            flood(start, 1, &mut label, |p| !kept[p], w, h);
        }
    }
    label.iter().map(|&l| l == 1).collect()
}

fn flood(
    start: usize,
    mark: u32,
    label: &mut [u32],
    member: impl Fn(usize) -> bool,
    w: usize,
    h: usize,
) -> usize {
    let mut stack = vec![start];
    label[start] = mark;
    let mut size = 0;
    while let Some(p) = stack.pop() {
        size += 1;
        let (x, y) = (p % w, p / w);
        let mut visit = |q: usize| {
            if label[q] == 0 && member(q) {
                label[q] = mark;
                stack.push(q);
            }
        };
        if x > 0 {
            visit(p - 1);
        }
        if x + 1 < w {
            visit(p + 1);
        }
        if y > 0 {
            visit(p - w);
        }
        if y + 1 < h {
            visit(p + w);
        }
    }
    size
}

/// What people want to know of a picture before they trust it.
#[derive(Clone, Copy, Debug, Default, PartialEq, serde::Serialize, serde::Deserialize)]
pub struct Quality {
    /// Share of the mask that is saturated in every exposure.
    pub saturated: f32,
    /// Share of the mask that is black in every exposure.
    pub dark: f32,
    /// Noise: standard deviation of a grey value over the mean value of the mask.
    pub noise: f32,
}

impl Merged {
    /// Saturation and noise within the mask. Noise from the Laplacian (Immerkær 1996), by its median, so that edges
    /// don't count.
    #[must_use]
    pub fn quality(&self, mask: &Mask) -> Quality {
        let share = |flags: &[bool]| {
            mask.indices().iter().filter(|&&i| flags[i as usize]).count() as f32 / mask.len() as f32
        };
        let grey = |p: usize| self.rgb[p].iter().sum::<f32>() / 3.0;
        let w = self.width as usize;
        let inside = mask.scatter(&vec![true; mask.len()], false);
        // The mean: under a low light half of the mask may be in shadow.
        let level = mask.indices().iter().map(|&i| grey(i as usize)).sum::<f32>() / mask.len() as f32;
        let mut residuals = Vec::new();
        for &i in mask.indices() {
            let p = i as usize;
            let (x, y) = (p % w, p / w);
            if x == 0 || y == 0 || x + 1 == w || y + 1 == self.height as usize {
                continue;
            }
            let around = [p - w - 1, p - w, p - w + 1, p - 1, p + 1, p + w - 1, p + w, p + w + 1];
            if around.iter().all(|&q| inside[q]) {
                let [nw, n, ne, west, east, sw, s, se] = around.map(grey);
                residuals.push(
                    (nw - 2.0 * n + ne - 2.0 * west + 4.0 * grey(p) - 2.0 * east + sw - 2.0 * s + se).abs(),
                );
            }
        }
        // The filter has norm 6; the median of |normal| is 0.6745 σ.
        let noise = median(&mut residuals) / 0.6745 / 6.0;
        Quality {
            saturated: share(&self.saturated),
            dark: share(&self.dark),
            noise: if level > 0.0 { noise / level } else { 0.0 },
        }
    }
}

fn median(values: &mut [f32]) -> f32 {
    if values.is_empty() {
        return 0.0;
    }
    let middle = values.len() / 2;
    *values.select_nth_unstable_by(middle, f32::total_cmp).1
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::rng::Rng;
    use crate::stack::BitDepth;

    /// A 12-bit camera with some read noise.
    fn expose(scene: &[f64], seconds: f64, noise: f32, rng: &mut Rng) -> Exposure {
        let rgb = scene
            .iter()
            .map(|v| {
                let code = v * seconds / 0.001 * 4095.0 + f64::from(noise * rng.normal());
                [libm::round(code).clamp(0.0, 4095.0) as u16; 3]
            })
            .collect();
        let image = Image { width: scene.len() as u32, height: 1, bits: BitDepth::Sixteen, rgb };
        Exposure { image, seconds, black: 0, white: 4095 }
    }

    #[test]
    fn ten_thousand_to_one_within_a_percent() {
        // From full scale at the shortest exposure down to a ten-thousandth.
        let scene: Vec<f64> = (0..2000).map(|i| 0.999 * 10f64.powf(-4.0 * f64::from(i) / 1999.0)).collect();
        let times = bracket(0.001, 1.0, 1e4, 12, 200.0);
        assert!(times.len() == 4 && times[0] == 0.001 && times[3] < 0.5, "{times:?}");
        let mut rng = Rng::new(1);
        let frames: Vec<Exposure> = times.iter().map(|t| expose(&scene, *t, 0.0, &mut rng)).collect();
        let merged = merge(&frames, None).unwrap();
        let worst =
            scene.iter().zip(&merged.rgb).map(|(t, m)| (f64::from(m[0]) / t - 1.0).abs()).fold(0.0, f64::max);
        assert!(worst < 0.01, "{worst}");
        assert!(!merged.saturated.iter().any(|s| *s));
    }

    #[test]
    fn saturated_takes_the_shortest_and_black_the_longest() {
        let mut rng = Rng::new(1);
        let scene = [3.0, 1e-6, 0.5];
        let frames: Vec<Exposure> =
            [0.010, 0.001, 0.003].iter().map(|t| expose(&scene, *t, 0.0, &mut rng)).collect();
        let merged = merge(&frames, None).unwrap();
        assert_eq!((merged.rgb[0][0], merged.rgb[1][0]), (1.0, 0.0));
        assert_eq!(
            (merged.saturated.clone(), merged.dark.clone()),
            (vec![true, false, false], vec![false, true, false])
        );
        assert!((merged.rgb[2][0] - 0.5).abs() < 1e-3);
        let mask = Mask::full(3, 1).unwrap();
        assert!((merged.quality(&mask).saturated - 1.0 / 3.0).abs() < 1e-6);
    }

    #[test]
    fn the_dark_frame_takes_ambient_light_off() {
        let mut rng = Rng::new(1);
        let times = [0.001, 0.008];
        let both: Vec<f64> = vec![0.30 + 0.05, 0.01 + 0.05];
        let lit: Vec<Exposure> = times.iter().map(|t| expose(&both, *t, 0.0, &mut rng)).collect();
        let dark: Vec<Exposure> = times.iter().map(|t| expose(&[0.05, 0.05], *t, 0.0, &mut rng)).collect();
        let merged = merge(&lit, Some(&dark)).unwrap();
        assert!((merged.rgb[0][0] - 0.30).abs() < 2e-3 && (merged.rgb[1][0] - 0.01).abs() < 2e-4);
        assert!(matches!(merge(&lit, Some(&dark[..1])), Err(HdrError::Dark { .. })));
    }

    #[test]
    fn noise_is_measured() {
        let mut rng = Rng::new(5);
        let scene = vec![0.5; 64 * 64];
        let mut frame = expose(&scene, 0.001, 40.0, &mut rng);
        (frame.image.width, frame.image.height) = (64, 64);
        let quality = merge(&[frame], None).unwrap().quality(&Mask::full(64, 64).unwrap());
        assert!((quality.noise - 40.0 / 2047.0).abs() < 0.1 * 40.0 / 2047.0, "{}", quality.noise);
    }

    #[test]
    fn bad_input_is_named() {
        let frame = expose(&[0.5], 0.001, 0.0, &mut Rng::new(1));
        assert_eq!(merge(&[], None), Err(HdrError::None));
        let bad = Exposure { seconds: f64::NAN, ..frame.clone() };
        assert!(matches!(merge(&[bad], None), Err(HdrError::Exposure { .. })));
        let crop = Crop { left: 1, top: 0, width: 1, height: 1 };
        assert!(matches!(crop.apply(&frame.image), Err(HdrError::Crop { .. })));
    }

    #[test]
    fn the_mask_is_the_object_without_its_dark_spots() {
        let (w, h) = (40u32, 30u32);
        let mut rgb = vec![[1e-4f32; 3]; (w * h) as usize];
        for y in 8..24 {
            for x in 10..30 {
                rgb[(y * w + x) as usize] = [0.3; 3];
            }
        }
        rgb[(15 * w + 20) as usize] = [0.0; 3]; // a shadow inside
        rgb[(2 * w + 2) as usize] = [0.5; 3]; // dust
        let n = rgb.len();
        let merged = Merged { width: w, height: h, rgb, saturated: vec![false; n], dark: vec![false; n] };
        assert_eq!(threshold_mask(&merged, threshold_level(&merged)).unwrap().len(), 16 * 20);
    }
}
