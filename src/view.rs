//! Results as pictures for people: 8-bit RGBA, cropped to the object, transparent around it.

use crate::stack::{Mask, Stack};
use crate::surface::Surface;
use glam::{Mat3, Vec3};

/// 8-bit RGBA in sRGB, row by row from the top.
#[derive(Clone, Debug, PartialEq, Eq)]
pub struct Picture {
    /// Width in pixels.
    pub width: u32,
    /// Height in pixels.
    pub height: u32,
    /// Four bytes a pixel; alpha is 0 outside the object.
    pub rgba: Vec<u8>,
}

/// The part of an image that is shown: the mask's bounding box with a small margin.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub struct Frame {
    /// First column.
    pub left: u32,
    /// First row.
    pub top: u32,
    /// Width in pixels.
    pub width: u32,
    /// Height in pixels.
    pub height: u32,
}

impl Frame {
    /// Around the object, with a margin of 3 % of its larger side.
    #[must_use]
    pub fn around(mask: &Mask) -> Self {
        let (x, y, w, h) = mask.bounds();
        let margin = w.max(h) * 3 / 100 + 1;
        let (left, top) = (x.saturating_sub(margin), y.saturating_sub(margin));
        Self {
            left,
            top,
            width: (x + w + margin).min(mask.width()) - left,
            height: (y + h + margin).min(mask.height()) - top,
        }
    }

    /// A picture with `colour(p)` for every mask pixel `p`.
    fn paint(&self, mask: &Mask, mut colour: impl FnMut(usize) -> [u8; 3]) -> Picture {
        let mut rgba = vec![0; 4 * self.width as usize * self.height as usize];
        for p in 0..mask.len() {
            let (x, y) = mask.position(p);
            let at = 4 * ((y - self.top) as usize * self.width as usize + (x - self.left) as usize);
            let [r, g, b] = colour(p);
            rgba[at..at + 4].copy_from_slice(&[r, g, b, 255]);
        }
        Picture { width: self.width, height: self.height, rgba }
    }
}

impl Picture {
    /// The picture made smaller, so that neither side is above `size`: means of blocks, weighted by alpha.
    #[must_use]
    pub fn within(&self, size: u32) -> Self {
        let longest = self.width.max(self.height);
        if longest <= size || size == 0 {
            return self.clone();
        }
        let scaled = |side: u32| (u64::from(side) * u64::from(size) / u64::from(longest)).max(1) as u32;
        let (width, height) = (scaled(self.width), scaled(self.height));
        let edge = |i: u32, from: u32, to: u32| (u64::from(i) * u64::from(from) / u64::from(to)) as usize;
        let mut rgba = Vec::with_capacity(4 * width as usize * height as usize);
        for y in 0..height {
            for x in 0..width {
                let (mut sum, mut alpha, mut count) = ([0u32; 3], 0u32, 0u32);
                for row in edge(y, self.height, height)..edge(y + 1, self.height, height) {
                    for column in edge(x, self.width, width)..edge(x + 1, self.width, width) {
                        let at = 4 * (row * self.width as usize + column);
                        let a = u32::from(self.rgba[at + 3]);
                        for (s, &v) in sum.iter_mut().zip(&self.rgba[at..at + 3]) {
                            *s += u32::from(v) * a;
                        }
                        alpha += a;
                        count += 1;
                    }
                }
                rgba.extend(sum.map(|s| s.checked_div(alpha).unwrap_or(0) as u8));
                rgba.push((alpha / count.max(1)) as u8);
            }
        }
        Self { width, height, rgba }
    }
}

/// From linear values to sRGB bytes, by table.
#[derive(Clone, Debug)]
pub struct Tone {
    gain: f32,
    table: Vec<u8>,
}

impl Tone {
    const STEPS: usize = 4096;

    /// The linear value `white` becomes white; it must be positive.
    #[must_use]
    pub fn new(white: f32) -> Self {
        let table = (0..=Self::STEPS)
            .map(|i| {
                let v = i as f32 / Self::STEPS as f32;
                let code =
                    if v <= 0.003_130_8 { 12.92 * v } else { 1.055 * libm::powf(v, 1.0 / 2.4) - 0.055 };
                (255.0 * code + 0.5) as u8
            })
            .collect();
        Self { gain: Self::STEPS as f32 / white.max(1e-12), table }
    }

    /// White at the 99 % quantile of the stack's values, so that a highlight does not darken the rest.
    #[must_use]
    pub fn of(stack: &Stack) -> Self {
        // A few thousand values are enough for a quantile that is only looked at.
        let every = (stack.mask.len() * stack.len() / 20_000).max(1);
        let mut values: Vec<f32> = stack.grey.iter().flatten().copied().step_by(every).collect();
        if values.is_empty() {
            return Self::new(1.0);
        }
        let at = (values.len() - 1) - (values.len() - 1) / 100;
        let white = *values.select_nth_unstable_by(at, f32::total_cmp).1;
        Self::new(if white > 0.0 { white } else { 1.0 })
    }

    /// One channel.
    #[inline]
    #[must_use]
    pub fn byte(&self, linear: f32) -> u8 {
        // `as` saturates, and turns NaN into 0.
        self.table[((linear * self.gain) as usize).min(Self::STEPS)]
    }

    fn rgb(&self, linear: [f32; 3]) -> [u8; 3] {
        linear.map(|v| self.byte(v))
    }
}

/// A picture as taken: linear RGB of the mask pixels, or grey where there is no colour.
#[must_use]
pub fn photo(mask: &Mask, grey: &[f32], rgb: &[[f32; 3]], tone: &Tone) -> Picture {
    let frame = Frame::around(mask);
    if rgb.is_empty() {
        frame.paint(mask, |p| [tone.byte(grey[p]); 3])
    } else {
        frame.paint(mask, |p| tone.rgb(rgb[p]))
    }
}

/// A picture with its untrusted pixels in magenta: `trust` is 1 where a pixel is believed, 0 where not.
#[must_use]
pub fn gated(mask: &Mask, grey: &[f32], trust: &[f32], tone: &Tone) -> Picture {
    const DOUBT: [f32; 3] = [214.0, 64.0, 170.0];
    Frame::around(mask).paint(mask, |p| {
        let (value, doubt) = (f32::from(tone.byte(grey[p])), (1.0 - trust[p]).clamp(0.0, 1.0));
        DOUBT.map(|d| (value + 0.8 * doubt * (d - value)) as u8)
    })
}

/// Normals as colours: (x, y, z) from −1…1 to 0…255, the convention of all papers.
#[must_use]
pub fn normals(mask: &Mask, normals: &[Vec3]) -> Picture {
    let byte = |v: f32| ((v + 1.0) * 127.5 + 0.5) as u8;
    Frame::around(mask).paint(mask, |p| normals[p].to_array().map(byte))
}

/// Degrees as colours, from 0 to `scale`.
#[must_use]
pub fn errors(mask: &Mask, degrees: &[f32], scale: f32) -> Picture {
    Frame::around(mask).paint(mask, |p| colour(degrees[p] / scale))
}

/// The colour scale of [`errors`], `width` by 1 pixels, from 0 to its end.
#[must_use]
pub fn colour_bar(width: u32) -> Picture {
    let last = width.saturating_sub(1).max(1) as f32;
    let rgba = (0..width)
        .flat_map(|x| {
            let [r, g, b] = colour(x as f32 / last);
            [r, g, b, 255]
        })
        .collect();
    Picture { width, height: 1, rgba }
}

/// Viridis at 0…1: even steps look evenly different, also to the colour-blind.
#[must_use]
pub fn colour(value: f32) -> [u8; 3] {
    // Every 16th row of matplotlib's table.
    const VIRIDIS: [[u8; 3]; 17] = [
        [68, 1, 84],
        [72, 24, 106],
        [71, 45, 123],
        [66, 64, 134],
        [59, 82, 139],
        [51, 99, 141],
        [44, 114, 142],
        [38, 130, 142],
        [33, 145, 140],
        [31, 160, 136],
        [40, 174, 128],
        [63, 188, 115],
        [94, 201, 98],
        [132, 212, 75],
        [173, 220, 48],
        [216, 226, 25],
        [253, 231, 37],
    ];
    let at = value.clamp(0.0, 1.0) * 16.0;
    let (low, part) = ((at as usize).min(15), at - (at as usize).min(15) as f32);
    [0, 1, 2].map(|c| {
        let (a, b) = (f32::from(VIRIDIS[low][c]), f32::from(VIRIDIS[low + 1][c]));
        (a + part * (b - a) + 0.5) as u8
    })
}

/// Colour of every mask pixel with its brightness divided out: the mean of the stack's images over their grey mean.
#[must_use]
pub fn tint(stack: &Stack) -> Vec<[f32; 3]> {
    let pixels = stack.mask.len();
    let (mut colour, mut grey) = (vec![[0.0f32; 3]; pixels], vec![0.0f32; pixels]);
    for (rgb, values) in stack.rgb.iter().zip(&stack.grey) {
        for ((c, g), (px, v)) in colour.iter_mut().zip(&mut grey).zip(rgb.iter().zip(values)) {
            *g += v;
            for (c, v) in c.iter_mut().zip(px) {
                *c += v;
            }
        }
    }
    colour.iter().zip(&grey).map(|(c, &g)| if g > 0.0 { c.map(|v| v / g) } else { [1.0; 3] }).collect()
}

/// A solved object under any light, shaded as Lambert would.
#[derive(Clone, Debug)]
pub struct Relit {
    frame: Frame,
    /// Position in the picture, and normal times albedo times tint, of every mask pixel.
    pixels: Vec<(u32, Vec3, [f32; 3])>,
    tone: Tone,
}

impl Relit {
    /// Of solved normals and albedo (mask pixels of `mask`), coloured by `tint` (see [`tint`]).
    #[must_use]
    pub fn new(mask: &Mask, normals: &[Vec3], albedo: &[f32], tint: &[[f32; 3]], tone: Tone) -> Self {
        let frame = Frame::around(mask);
        let pixels = (0..mask.len())
            .map(|p| {
                let (x, y) = mask.position(p);
                let colour = tint.get(p).map_or([albedo[p]; 3], |t| t.map(|c| c * albedo[p]));
                ((y - frame.top) * frame.width + (x - frame.left), normals[p], colour)
            })
            .collect();
        Self { frame, pixels, tone }
    }

    /// The picture under `direction` (unit length).
    #[must_use]
    pub fn under(&self, direction: Vec3) -> Picture {
        let Frame { width, height, .. } = self.frame;
        let mut rgba = vec![0; 4 * width as usize * height as usize];
        for (at, normal, colour) in &self.pixels {
            let shade = normal.dot(direction).max(0.0);
            let [r, g, b] = self.tone.rgb(colour.map(|c| c * shade));
            let at = 4 * *at as usize;
            rgba[at..at + 4].copy_from_slice(&[r, g, b, 255]);
        }
        Picture { width, height, rgba }
    }
}

/// A surface seen from the side, as clay under a light from the upper left: `size × size` pixels, turned by `yaw`
/// about the vertical axis and by `tilt` about the horizontal one (radians).
#[must_use]
pub fn surface(surface: &Surface, yaw: f32, tilt: f32, size: u32) -> Picture {
    let turn = Mat3::from_rotation_x(tilt) * Mat3::from_rotation_y(yaw);
    let light = Vec3::new(-0.45, 0.55, 0.7).normalize();
    let radius = surface.positions.iter().map(|p| p.length()).fold(1e-6, f32::max);
    let (half, scale) = (size as f32 / 2.0, 0.48 * size as f32 / radius);
    let corners: Vec<Vec3> = surface
        .positions
        .iter()
        .map(|&p| {
            let q = turn * p * scale;
            Vec3::new(half + q.x, half - q.y, q.z)
        })
        .collect();
    let shades: Vec<f32> =
        surface.normals.iter().map(|&n| 0.18 + 0.82 * (turn * n).dot(light).max(0.0)).collect();
    let tone = Tone::new(1.0);
    let mut depth = vec![f32::NEG_INFINITY; (size * size) as usize];
    let mut rgba = vec![0; 4 * depth.len()];
    for triangle in &surface.triangles {
        let [a, b, c] = triangle.map(|v| corners[v as usize]);
        let area = (b - a).truncate().perp_dot((c - a).truncate());
        if area.abs() < 1e-6 {
            continue; // seen edge-on
        }
        // Seen from behind, the inside of the relief is shown darker.
        let front = if area < 0.0 { 1.0 } else { 0.45 };
        let column = |v: f32| (v.max(0.0) as u32).min(size - 1);
        let (low, high) = (a.min(b).min(c), a.max(b).max(c));
        for y in column(low.y)..=column(high.y) {
            for x in column(low.x)..=column(high.x) {
                let p = glam::Vec2::new(x as f32 + 0.5, y as f32 + 0.5) - a.truncate();
                let v = p.perp_dot((c - a).truncate()) / area;
                let w = (b - a).truncate().perp_dot(p) / area;
                // A little beyond the border, so that no gap shows between neighbours.
                if v < -0.02 || w < -0.02 || v + w > 1.02 {
                    continue;
                }
                let at = (y * size + x) as usize;
                let z = a.z + v * (b.z - a.z) + w * (c.z - a.z);
                if z <= depth[at] {
                    continue;
                }
                depth[at] = z;
                let [sa, sb, sc] = triangle.map(|i| shades[i as usize]);
                let shade = front * (sa + v * (sb - sa) + w * (sc - sa));
                let [r, g, b] = tone.rgb([0.86, 0.82, 0.76].map(|k| k * shade));
                rgba[4 * at..4 * at + 4].copy_from_slice(&[r, g, b, 255]);
            }
        }
    }
    Picture { width: size, height: size, rgba }
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::light;

    fn mask() -> Mask {
        let inside: Vec<bool> =
            (0..200).map(|i| (5..9).contains(&(i % 20)) && (2..5).contains(&(i / 20))).collect();
        Mask::new(20, 10, &inside).unwrap()
    }

    #[test]
    fn pictures_are_cropped_and_transparent_around() {
        let mask = mask();
        let picture = normals(&mask, &vec![Vec3::Z; mask.len()]);
        assert_eq!((picture.width, picture.height), (6, 5));
        assert_eq!(picture.rgba[..4], [0, 0, 0, 0]);
        let inside = 4 * (picture.width as usize + 1);
        assert_eq!(picture.rgba[inside..inside + 4], [128, 128, 255, 255]);
        assert_eq!(picture.rgba.chunks(4).filter(|px| px[3] == 255).count(), mask.len());
    }

    #[test]
    fn doubt_is_magenta() {
        let mask = Mask::full(2, 1).unwrap();
        let picture = gated(&mask, &[1.0, 1.0], &[1.0, 0.0], &Tone::new(1.0));
        assert_eq!(picture.rgba[..3], [255, 255, 255]);
        assert!(picture.rgba[5] < 110 && picture.rgba[4] > 200, "{:?}", &picture.rgba);
    }

    #[test]
    fn colours_run_along_viridis() {
        assert_eq!(colour(0.0), [68, 1, 84]);
        assert_eq!(colour(1.0), [253, 231, 37]);
        assert_eq!(colour(0.5), [33, 145, 140]);
        assert_eq!(colour(f32::INFINITY), colour(1.0));
        let luma =
            |c: [u8; 3]| 0.2126 * f32::from(c[0]) + 0.7152 * f32::from(c[1]) + 0.0722 * f32::from(c[2]);
        let bar = colour_bar(64);
        let steps: Vec<f32> = bar.rgba.chunks(4).map(|px| luma([px[0], px[1], px[2]])).collect();
        assert!(steps.windows(2).all(|w| w[1] >= w[0] - 0.5), "brightness rises along the scale");
    }

    #[test]
    fn relighting_a_lambertian_pixel_gives_its_photo() {
        let mask = mask();
        let n = light::from_azimuth_slant(0.3, 0.4);
        let l = light::from_azimuth_slant(1.0, 0.2);
        let value = 0.8 * n.dot(l);
        let tone = Tone::new(1.0);
        let grey = vec![value; mask.len()];
        let taken = photo(&mask, &grey, &[], &tone);
        let relit = Relit::new(&mask, &vec![n; mask.len()], &vec![0.8; mask.len()], &[], tone).under(l);
        assert_eq!(taken, relit);
        let dark =
            Relit::new(&mask, &vec![n; mask.len()], &vec![0.8; mask.len()], &[], Tone::new(1.0)).under(-n);
        assert!(dark.rgba.chunks(4).all(|px| px[..3] == [0, 0, 0]));
    }

    #[test]
    fn tone_is_srgb_and_never_fails() {
        let tone = Tone::new(2.0);
        assert_eq!((tone.byte(0.0), tone.byte(2.0), tone.byte(9.0)), (0, 255, 255));
        assert_eq!(tone.byte(2.0 * 0.214_04), 127);
        assert_eq!((tone.byte(f32::NAN), tone.byte(-1.0)), (0, 0));
    }

    #[test]
    fn a_surface_turns_and_its_back_is_dark() {
        let mask = Mask::full(21, 21).unwrap();
        let flat = Surface::new(&mask, &vec![0.0; 441], &vec![Vec3::Z; 441], &[], 9.0);
        let seen = |yaw: f32| surface(&flat, yaw, 0.0, 64);
        let area = |p: &Picture| p.rgba.chunks(4).filter(|px| px[3] == 255).count() as f32;
        let bright = |p: &Picture| p.rgba.chunks(4).map(|px| px[0]).max().unwrap();
        let (front, side, back) = (seen(0.0), seen(1.2), seen(std::f32::consts::PI));
        assert!((area(&side) / area(&front) - libm::cosf(1.2)).abs() < 0.06);
        assert_eq!(area(&back), area(&front));
        assert!(bright(&back) < bright(&front) / 2);
        assert_eq!(front.rgba[4 * (32 * 64 + 32) + 3], 255, "no gap in the middle");
    }

    #[test]
    fn smaller_pictures_keep_their_colour() {
        let picture = Picture { width: 8, height: 4, rgba: [[10, 20, 30, 255]; 32].concat() };
        let small = picture.within(4);
        assert_eq!((small.width, small.height), (4, 2));
        assert!(small.rgba.chunks(4).all(|px| px == [10, 20, 30, 255]));
        assert_eq!(picture.within(100), picture);
    }
}
