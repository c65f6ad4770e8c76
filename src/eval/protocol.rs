//! From code values to the linear stack that planners and solvers see: the two protocols of published tables.
//!
//! *Official* is DiLiGenT's own (Shi et al. 2016): full resolution, whole mask. *128* is the one on which the papers
//! on illumination planning report: a square crop at 128×128, scaled to the 99 % quantile, through 8-bit gamma code.

use crate::image::luma;
use crate::stack::{BitDepth, Mask, RawStack, Stack, StackError, flags};
use glam::Vec3;

/// How code values become linear values.
#[derive(Clone, Copy, Debug, PartialEq, Eq, serde::Serialize, serde::Deserialize)]
pub enum Protocol {
    /// DiLiGenT's: full resolution, error over the whole mask.
    #[serde(rename = "official")]
    Official,
    /// The planning papers': 128×128, bear without its first 20 images.
    #[serde(rename = "128")]
    P128,
}

impl std::str::FromStr for Protocol {
    type Err = UnknownProtocol;
    fn from_str(s: &str) -> Result<Self, UnknownProtocol> {
        match s {
            "official" => Ok(Self::Official),
            "128" => Ok(Self::P128),
            _ => Err(UnknownProtocol(s.into())),
        }
    }
}

impl std::fmt::Display for Protocol {
    fn fmt(&self, f: &mut std::fmt::Formatter<'_>) -> std::fmt::Result {
        f.write_str(match self {
            Self::Official => "official",
            Self::P128 => "128",
        })
    }
}

/// Why a protocol can't be read.
#[derive(Debug, thiserror::Error, PartialEq)]
#[error("no protocol '{0}': choose official or 128")]
pub struct UnknownProtocol(String);

impl Protocol {
    /// Applies the protocol.
    ///
    /// # Errors
    /// [`StackError`] where no pixel is left, or lists of the stack disagree.
    pub fn apply(self, raw: &RawStack) -> Result<Stack, StackError> {
        let (images, pixels) = (raw.images.len(), raw.mask.len());
        let lengths = [
            ("light directions", raw.lights.len(), images),
            ("light intensities", raw.intensities.len(), images),
            ("image names", raw.names.len(), images),
            ("true normals", raw.truth.as_ref().map_or(pixels, Vec::len), pixels),
        ];
        let wrong_image = raw.images.iter().zip(&raw.names).find(|(i, _)| i.len() != pixels);
        if let Some((what, found, expected)) =
            lengths.into_iter().find(|(_, found, expected)| found != expected)
        {
            return Err(StackError::Length { what: what.into(), found, expected });
        }
        if let Some((image, name)) = wrong_image {
            return Err(StackError::Length {
                what: format!("image {name}"),
                found: image.len(),
                expected: pixels,
            });
        }
        match self {
            Self::Official => Ok(official(raw)),
            Self::P128 if is_bear(raw) => p128(&bear76(raw)),
            Self::P128 => p128(raw),
        }
    }
}

/// Whether this is DiLiGenT's bear with all of its 96 images.
#[must_use]
pub fn is_bear(raw: &RawStack) -> bool {
    raw.name == "bear" && raw.images.len() == 96
}

/// Name of [`bear76`] where it is chosen as an object of its own.
pub const BEAR76: &str = "bear76";

/// The variant of DiLiGenT's bear without its first 20 images, which are known to be bad: what protocol 128 is on.
#[must_use]
pub fn bear76(raw: &RawStack) -> RawStack {
    raw.subset(|k| k >= 20)
}

/// Image `k` as linear values: `code/65535` over the light's gain per channel. 8-bit codes are the high bytes of 16-bit ones
/// and stand for the middle of their step, `(v·256 + 127.5)/65535`: the lower end would darken shadows to nothing.
fn linear(raw: &RawStack, k: usize) -> impl Iterator<Item = [f32; 3]> {
    let (scale, offset) = match raw.bits {
        BitDepth::Sixteen => (1.0, 0.0),
        BitDepth::Eight => (256.0, 127.5),
    };
    let gain = raw.intensities[k];
    let value = move |code: u16, c: usize| (f32::from(code) * scale + offset) / 65535.0 / gain[c];
    raw.images[k].iter().map(move |px| [0, 1, 2].map(|c| value(px[c], c)))
}

/// Linear values; grey by luma, clipped to [0, 1].
fn official(raw: &RawStack) -> Stack {
    let rgb: Vec<Vec<[f32; 3]>> = (0..raw.images.len()).map(|k| linear(raw, k).collect()).collect();
    let grey = rgb.iter().map(|i| i.iter().map(|&px| luma(px).clamp(0.0, 1.0)).collect()).collect();
    let cut = |(image, linear): (&Vec<[u16; 3]>, &Vec<[f32; 3]>)| {
        let at_limit = |(px, &v): (&[u16; 3], &[f32; 3])| px.contains(&raw.bits.max()) || luma(v) > 1.0;
        flags(image.iter().zip(linear).map(at_limit))
    };
    Stack {
        name: raw.name.clone(),
        mask: raw.mask.clone(),
        bits: raw.bits,
        grey,
        saturated: raw.images.iter().zip(&rgb).map(cut).collect(),
        rgb,
        lights: raw.lights.iter().map(|l| l.normalize()).collect(),
        names: raw.names.clone(),
        truth: raw.truth.clone(),
    }
}

/// Side of the result of protocol 128, pixels.
const SIDE: usize = 128;

/// A square window on an image: `side` pixels from (left, top), which may lie outside of it.
#[derive(Clone, Copy)]
struct Square {
    left: i64,
    top: i64,
    side: usize,
}

impl Square {
    /// The square around the mask's bounding box, centred on it.
    fn around(mask: &Mask) -> Self {
        let (x, y, w, h) = mask.bounds();
        let side = w.max(h);
        Self {
            left: i64::from(x) - i64::from((side - w) / 2),
            top: i64::from(y) - i64::from((side - h) / 2),
            side: side as usize,
        }
    }

    /// Values of the mask pixels laid into the square, zero elsewhere.
    fn lay<const N: usize>(&self, mask: &Mask, values: impl Iterator<Item = [f32; N]>) -> Vec<[f32; N]> {
        let mut square = vec![[0.0; N]; self.side * self.side];
        for (p, v) in values.enumerate() {
            let (x, y) = mask.position(p);
            let (x, y) = ((i64::from(x) - self.left) as usize, (i64::from(y) - self.top) as usize);
            square[y * self.side + x] = v;
        }
        square
    }
}

fn p128(raw: &RawStack) -> Result<Stack, StackError> {
    let square = Square::around(&raw.mask);
    let scaled = |k: usize| linear(raw, k);
    let bright = quantile99(&mut (0..raw.images.len()).flat_map(scaled).flatten().collect::<Vec<f32>>());
    let bright = if bright > 0.0 { bright } else { 1.0 };
    // Half of the pixels of a solved normal map rest on this: the round trip through 8-bit gamma code.
    let decode: Vec<f32> = (0..=255u16).map(|code| libm::powf(f32::from(code) / 255.0, 2.2)).collect();
    let images: Vec<Vec<[f32; 3]>> = (0..raw.images.len())
        .map(|k| {
            let gamma = |v: f32| libm::powf((v / bright).clamp(0.0, 1.0), 1.0 / 2.2);
            let encoded = square.lay(&raw.mask, scaled(k).map(|px| px.map(gamma)));
            let resized = bilinear(&encoded, square.side, 2 * SIDE);
            let linear: Vec<[f32; 3]> = resized
                .iter()
                .map(|px| px.map(|v| decode[(v * 255.0 + 0.5).clamp(0.0, 255.0) as usize]))
                .collect();
            halve(&linear)
        })
        .collect();

    let mask_or_truth: Vec<[f32; 3]> = match &raw.truth {
        Some(truth) => square.lay(&raw.mask, truth.iter().map(|n| n.to_array())),
        None => square.lay(&raw.mask, (0..raw.mask.len()).map(|_| [0.0, 0.0, 1.0])),
    };
    let normals = halve(&bilinear(&mask_or_truth, square.side, 2 * SIDE));
    let mask = Mask::new(SIDE as u32, SIDE as u32, &eroded(&normals))?;
    let pick = |image: &Vec<[f32; 3]>| mask.gather(image);
    let rgb: Vec<Vec<[f32; 3]>> = images.iter().map(pick).collect();
    let grey = rgb.iter().map(|i| i.iter().map(|px| (px[0] + px[1] + px[2]) / 3.0).collect()).collect();
    // A cell is saturated where one of the pixels that it is made of is, or was cut off at the quantile.
    let limit = raw.bits.max();
    let saturated = (0..raw.images.len())
        .map(|k| {
            let cut = raw.images[k].iter().zip(scaled(k));
            let cut = cut.map(|(px, v)| px.contains(&limit) || v.iter().any(|&v| v > bright));
            let cut = flags(cut);
            if cut.is_empty() {
                return cut;
            }
            let square_of = square.lay(&raw.mask, cut.iter().map(|&c| [f32::from(c)]));
            let cells = halve(&bilinear(&square_of, square.side, 2 * SIDE));
            flags(mask.gather(&cells).into_iter().map(|[share]| share > 0.0))
        })
        .collect();
    let truth = raw
        .truth
        .as_ref()
        .map(|_| mask.gather(&normals).into_iter().map(|n| Vec3::from(n).normalize_or_zero()).collect());
    Ok(Stack {
        name: raw.name.clone(),
        bits: raw.bits,
        grey,
        rgb,
        saturated,
        lights: raw.lights.iter().map(|l| l.normalize()).collect(),
        names: raw.names.clone(),
        truth,
        mask,
    })
}

/// 99 % quantile with linear interpolation between ranks (numpy's default).
fn quantile99(values: &mut [f32]) -> f32 {
    if values.is_empty() {
        return 0.0;
    }
    let position = 0.99 * (values.len() - 1) as f64;
    let (_, &mut low, above) = values.select_nth_unstable_by(position as usize, f32::total_cmp);
    let high = above.iter().copied().fold(f32::INFINITY, f32::min);
    if high.is_finite() { low + (high - low) * (position.fract() as f32) } else { low }
}

/// Bilinear resampling of a square image, samples at pixel centres, edges repeated (OpenCV's INTER_LINEAR).
fn bilinear<const N: usize>(image: &[[f32; N]], side: usize, to: usize) -> Vec<[f32; N]> {
    let ratio = side as f64 / to as f64;
    let taps: Vec<(usize, usize, f32)> = (0..to)
        .map(|i| {
            let s = ((i as f64 + 0.5) * ratio - 0.5).clamp(0.0, (side - 1) as f64);
            (s as usize, (s as usize + 1).min(side - 1), s.fract() as f32)
        })
        .collect();
    let mut out = Vec::with_capacity(to * to);
    for &(y0, y1, fy) in &taps {
        let (top, bottom) = (&image[y0 * side..][..side], &image[y1 * side..][..side]);
        for &(x0, x1, fx) in &taps {
            out.push(std::array::from_fn(|c| {
                let a = top[x0][c] + (top[x1][c] - top[x0][c]) * fx;
                let b = bottom[x0][c] + (bottom[x1][c] - bottom[x0][c]) * fx;
                a + (b - a) * fy
            }));
        }
    }
    out
}

/// Mean of each 2×2 block.
fn halve<const N: usize>(image: &[[f32; N]]) -> Vec<[f32; N]> {
    let side = image.len().isqrt();
    let half = side / 2;
    let mut out = Vec::with_capacity(half * half);
    for y in 0..half {
        for x in 0..half {
            let i = 2 * y * side + 2 * x;
            out.push(std::array::from_fn(|c| {
                (image[i][c] + image[i + 1][c] + image[i + side][c] + image[i + side + 1][c]) / 4.0
            }));
        }
    }
    out
}

/// Pixels whose whole 3×3 neighbourhood has z > 0; the border is out.
fn eroded(normals: &[[f32; 3]]) -> Vec<bool> {
    let inside = |x: usize, y: usize| normals[y * SIDE + x][2] > 0.0;
    (0..SIDE * SIDE)
        .map(|i| {
            let (x, y) = (i % SIDE, i / SIDE);
            (1..SIDE - 1).contains(&x)
                && (1..SIDE - 1).contains(&y)
                && (y - 1..=y + 1).all(|y| (x - 1..=x + 1).all(|x| inside(x, y)))
        })
        .collect()
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::eval::statistics::mean;

    fn raw(side: u32, code: u16) -> RawStack {
        let mask = Mask::full(side, side).unwrap();
        let pixels = mask.len();
        RawStack {
            name: "flat".into(),
            mask,
            bits: BitDepth::Sixteen,
            images: vec![vec![[code; 3]; pixels]; 2],
            names: vec!["001.png".into(), "002.png".into()],
            lights: vec![Vec3::Z, Vec3::new(0.6, 0.0, 0.8)],
            intensities: vec![[1.0; 3], [2.0; 3]],
            truth: Some(vec![Vec3::Z; pixels]),
        }
    }

    #[test]
    fn official_divides_by_the_gain_and_clips() {
        let stack = Protocol::Official.apply(&raw(4, 65535)).unwrap();
        assert!((stack.grey[0][0] - 0.9999).abs() < 1e-6); // luma weights sum to 0.9999
        assert!((stack.grey[1][0] - 0.49995).abs() < 1e-6);
        let mut eight = raw(4, 0);
        eight.bits = BitDepth::Eight;
        let stack = Protocol::Official.apply(&eight).unwrap();
        assert!((stack.rgb[0][0][0] - 127.5 / 65535.0).abs() < 1e-9);
    }

    #[test]
    fn p128_is_scaled_to_its_bright_end_and_loses_its_border() {
        let stack = Protocol::P128.apply(&raw(200, 1000)).unwrap();
        assert_eq!((stack.mask.width(), stack.mask.len()), (128, 126 * 126));
        assert!((stack.grey[0][0] - 1.0).abs() < 1e-6);
        assert!((stack.grey[1][0] - 0.5).abs() < 0.01); // within a step of the 8-bit gamma code
    }

    #[test]
    fn codes_of_8_bit_stand_for_the_middle_of_their_step() {
        // The right half is bright, and sets the scale of protocol 128.
        let value = |p: usize| if p % 128 < 64 { (p % 64) as u16 * 24 + 1 } else { 60_000 };
        let picture = |bits, shift: u16| RawStack {
            bits,
            images: vec![(0..128 * 128).map(|p| [value(p) >> shift; 3]).collect(); 2],
            ..raw(128, 0)
        };
        for protocol in [Protocol::Official, Protocol::P128] {
            let [whole, cut] = [(BitDepth::Sixteen, 0), (BitDepth::Eight, 8)].map(|(bits, shift)| {
                let grey = protocol.apply(&picture(bits, shift)).unwrap().grey.concat();
                let dark: Vec<f64> = grey.into_iter().filter(|&v| v < 0.1).map(f64::from).collect();
                mean(&dark)
            });
            assert!((whole / cut - 1.0).abs() < 0.05, "{protocol}: {whole} and {cut}");
        }
    }

    #[test]
    fn what_the_sensor_cut_off_is_flagged() {
        let mut some = raw(200, 1000);
        some.images[1][200 * 100 + 60] = [1000, 65535, 1000];
        let official = Protocol::Official.apply(&some).unwrap();
        assert!(official.saturated[0].is_empty());
        let at: Vec<usize> = (0..official.mask.len()).filter(|&p| official.saturated[1][p]).collect();
        assert_eq!(at, [200 * 100 + 60]);
        let p128 = Protocol::P128.apply(&some).unwrap();
        assert!(p128.saturated[0].is_empty());
        let cells: Vec<(u32, u32)> =
            (0..p128.mask.len()).filter(|&p| p128.saturated[1][p]).map(|p| p128.mask.position(p)).collect();
        assert!(cells.contains(&(38, 64)) && cells.len() <= 4, "{cells:?}");
    }

    #[test]
    fn lists_that_disagree_are_named() {
        let mut bad = raw(4, 1);
        bad.lights.pop();
        assert!(Protocol::Official.apply(&bad).unwrap_err().to_string().contains("light directions"));
    }

    #[test]
    fn quantile_interpolates_between_ranks() {
        let mut v: Vec<f32> = (0..=100).map(|i| i as f32).rev().collect();
        assert!((quantile99(&mut v) - 99.0).abs() < 1e-4);
        assert_eq!(quantile99(&mut [3.0]), 3.0);
    }
}
