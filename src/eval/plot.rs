//! Results as files: line plots and light plots (SVG), normal maps and error maps (PNG).
//!
//! The same input always gives the same bytes.

use crate::error::ErrorMap;
use crate::image::{ImageError, encode_rgb};
use crate::light;
use crate::stack::{BitDepth, Mask};
use crate::view::{Frame, colour};
use glam::Vec3;
use std::fmt::Write;

/// One point of a [`Series`].
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Point {
    /// Position along x.
    pub x: f64,
    /// Value.
    pub y: f64,
    /// Interval around the value, for example of 95 % confidence.
    pub interval: Option<[f64; 2]>,
}

/// One line of a [`LinePlot`].
#[derive(Clone, Debug, PartialEq)]
pub struct Series {
    /// Its name in the legend.
    pub name: String,
    /// Its points, by ascending x. Those that are not finite are left out.
    pub points: Vec<Point>,
}

/// Values against a common axis, as MAE against the number of lights.
#[derive(Clone, Debug, Default, PartialEq)]
pub struct LinePlot {
    /// Above the plot.
    pub title: String,
    /// Under the x axis.
    pub x_label: String,
    /// Beside the y axis.
    pub y_label: String,
    /// The lines, in the order of the legend.
    pub series: Vec<Series>,
}

/// Okabe and Ito's colours, which colour-blind people tell apart. Beyond the seventh line the dashes differ.
const COLOURS: [&str; 7] = ["#0072b2", "#d55e00", "#009e73", "#cc79a7", "#e69f00", "#56b4e9", "#7f7f7f"];
const DASHES: [&str; 3] = ["none", "6 3", "2 3"];

/// Readable on white and on black paper.
const STYLE: &str = "<style>text{font:13px system-ui,sans-serif;fill:#222}.t{font-size:15px;font-weight:600}\
.g{stroke:#888;stroke-opacity:.3}.f{stroke:#888;fill:none}.c{fill:#888}.n{font-size:11px;text-anchor:middle;fill:#fff}\
@media(prefers-color-scheme:dark){text{fill:#ddd}}</style>";

fn escape(text: &str) -> String {
    text.replace('&', "&amp;").replace('<', "&lt;").replace('>', "&gt;").replace('"', "&quot;")
}

/// Multiples of 1, 2 or 5 · 10ⁿ within lo..=hi, about `count` of them, and their decimals.
fn ticks(lo: f64, hi: f64, count: f64) -> (Vec<f64>, usize) {
    let rough = (hi - lo) / count;
    let power = libm::floor(libm::log10(rough));
    let unit = libm::pow(10.0, power);
    let step = unit * [1.0, 2.0, 5.0, 10.0].into_iter().find(|m| m * unit >= rough * 0.999).unwrap_or(10.0);
    let first = libm::ceil(lo / step - 1e-9);
    let last = libm::floor(hi / step + 1e-9);
    let values = (0..=((last - first) as usize).min(100)).map(|i| (first + i as f64) * step).collect();
    (values, if step >= 1.0 { 0 } else { (-libm::floor(libm::log10(step))) as usize })
}

/// Smallest and largest of the values; widened where they coincide, 0..1 where there is none.
fn range(values: impl Iterator<Item = f64>) -> (f64, f64) {
    let (lo, hi) = values.fold((f64::INFINITY, f64::NEG_INFINITY), |(lo, hi), v| (lo.min(v), hi.max(v)));
    if lo > hi {
        (0.0, 1.0)
    } else if hi - lo < 1e-9 * hi.abs().max(1e-6) {
        (lo - 0.5, hi + 0.5)
    } else {
        (lo, hi)
    }
}

impl LinePlot {
    /// The plot as an SVG document.
    #[must_use]
    pub fn svg(&self) -> String {
        let finite = |p: &&Point| p.x.is_finite() && p.y.is_finite();
        let points = || self.series.iter().flat_map(|s| s.points.iter().filter(finite));
        let band = |p: &Point| p.interval.filter(|i| i[0].is_finite() && i[1].is_finite());
        let (x0, x1) = range(points().map(|p| p.x));
        let (y0, y1) = range(points().flat_map(|p| {
            let [lo, hi] = band(p).unwrap_or([p.y, p.y]);
            [lo, p.y, hi]
        }));
        let (y0, y1) = (y0 - 0.04 * (y1 - y0), y1 + 0.04 * (y1 - y0));

        let (left, top, width, height) = (64.0f64, 40.0f64, 460.0f64, 300.0f64);
        let longest = self.series.iter().map(|s| s.name.chars().count()).max().unwrap_or(0);
        let (total, tall) = (left + width + 56.0 + 7.5 * longest as f64, top + height + 52.0);
        let tall = tall.max(top + 20.0 * self.series.len() as f64 + 20.0);
        let px = |x: f64| left + width * (x - x0) / (x1 - x0);
        let py = |y: f64| top + height * (y1 - y) / (y1 - y0);

        let mut s = format!(
            "<svg xmlns=\"http://www.w3.org/2000/svg\" viewBox=\"0 0 {total:.0} {tall:.0}\" role=\"img\">\
             <title>{}</title>{STYLE}\n",
            escape(&self.title)
        );
        let _ = writeln!(s, "<text class=\"t\" x=\"{left}\" y=\"24\">{}</text>", escape(&self.title));
        let (xs, decimals) = ticks(x0, x1, 8.0);
        for x in xs {
            let at = px(x);
            let _ = writeln!(
                s,
                "<path class=\"g\" d=\"M{at:.1} {top}v{height}\"/><text x=\"{at:.1}\" y=\"{:.0}\" text-anchor=\"middle\">{x:.decimals$}</text>",
                top + height + 18.0
            );
        }
        let (ys, decimals) = ticks(y0, y1, 6.0);
        for y in ys {
            let at = py(y);
            let _ = writeln!(
                s,
                "<path class=\"g\" d=\"M{left} {at:.1}h{width}\"/><text x=\"{:.0}\" y=\"{:.1}\" text-anchor=\"end\">{y:.decimals$}</text>",
                left - 8.0,
                at + 4.5
            );
        }
        let _ = writeln!(
            s,
            "<rect class=\"f\" x=\"{left}\" y=\"{top}\" width=\"{width}\" height=\"{height}\"/>\
             <text x=\"{:.0}\" y=\"{:.0}\" text-anchor=\"middle\">{}</text>\
             <text transform=\"translate(18 {:.0}) rotate(-90)\" text-anchor=\"middle\">{}</text>",
            left + width / 2.0,
            top + height + 42.0,
            escape(&self.x_label),
            top + height / 2.0,
            escape(&self.y_label)
        );
        for (i, series) in self.series.iter().enumerate() {
            let (ink, dash) = (COLOURS[i % 7], DASHES[(i / 7) % 3]);
            let points: Vec<&Point> = series.points.iter().filter(finite).collect();
            let bands: Vec<(f64, [f64; 2])> =
                points.iter().filter_map(|p| Some((px(p.x), band(p)?.map(py)))).collect();
            if bands.len() > 1 {
                let upper = bands.iter().map(|(x, b)| format!("{x:.1},{:.1}", b[1]));
                let lower = bands.iter().rev().map(|(x, b)| format!("{x:.1},{:.1}", b[0]));
                let outline = upper.chain(lower).collect::<Vec<_>>().join(" ");
                let _ = writeln!(s, "<polygon fill=\"{ink}\" fill-opacity=\".18\" points=\"{outline}\"/>");
            }
            let path: Vec<String> = points.iter().map(|p| format!("{:.1},{:.1}", px(p.x), py(p.y))).collect();
            let _ = writeln!(
                s,
                "<polyline fill=\"none\" stroke=\"{ink}\" stroke-width=\"2\" stroke-dasharray=\"{dash}\" points=\"{}\"/>",
                path.join(" ")
            );
            for p in &points {
                let (x, y) = (px(p.x), py(p.y));
                if let (Some([lo, hi]), true) = (band(p), bands.len() == 1) {
                    let _ = writeln!(s, "<path stroke=\"{ink}\" d=\"M{x:.1} {:.1}V{:.1}\"/>", py(lo), py(hi));
                }
                let _ = writeln!(
                    s,
                    "<circle cx=\"{x:.1}\" cy=\"{y:.1}\" r=\"3\" fill=\"{ink}\"><title>{}: {} at {}</title></circle>",
                    escape(&series.name),
                    (p.y * 1e4).round() / 1e4,
                    p.x
                );
            }
            let (x, y) = (left + width + 14.0, top + 14.0 + 20.0 * i as f64);
            let _ = writeln!(
                s,
                "<path fill=\"none\" stroke=\"{ink}\" stroke-width=\"2\" stroke-dasharray=\"{dash}\" d=\"M{x} {y}h24\"/>\
                 <circle cx=\"{}\" cy=\"{y}\" r=\"3\" fill=\"{ink}\"/><text x=\"{}\" y=\"{}\">{}</text>",
                x + 12.0,
                x + 32.0,
                y + 4.5,
                escape(&series.name)
            );
        }
        s + "</svg>\n"
    }
}

/// The lights of one run on the hemisphere, seen from the camera: x right, y up, the distance from the
/// centre proportional to the slant, 90° at the rim.
#[derive(Clone, Debug, Default, PartialEq)]
pub struct LightPlot<'a> {
    /// Above the plot.
    pub title: String,
    /// Every light that could be asked for; empty on a continuous domain.
    pub candidates: &'a [Vec3],
    /// Requested and used direction of each light, in order. The used one need not be of unit length.
    pub chosen: Vec<(Vec3, Vec3)>,
}

impl LightPlot<'_> {
    /// The plot as an SVG document: candidates as dots, used lights with their numbers, a hollow
    /// circle and a line where another direction had been requested.
    #[must_use]
    pub fn svg(&self) -> String {
        let (cx, cy, radius) = (210.0f32, 236.0f32, 190.0f32);
        let place = |d: Vec3| {
            let r = radius * light::slant(d) / std::f32::consts::FRAC_PI_2;
            let azimuth = light::azimuth(d);
            (cx + r * libm::cosf(azimuth), cy - r * libm::sinf(azimuth))
        };
        let mut s = format!(
            "<svg xmlns=\"http://www.w3.org/2000/svg\" viewBox=\"0 0 420 450\" role=\"img\"><title>{0}</title>{STYLE}\n\
             <text class=\"t\" x=\"210\" y=\"24\" text-anchor=\"middle\">{0}</text>\n",
            escape(&self.title)
        );
        for degrees in [30.0, 60.0, 90.0] {
            let r = radius * degrees / 90.0;
            let _ = writeln!(
                s,
                "<circle class=\"f\" cx=\"{cx}\" cy=\"{cy}\" r=\"{r:.1}\" stroke-opacity=\".5\"/>\
                 <text x=\"{:.1}\" y=\"{:.1}\" fill-opacity=\".7\">{degrees}°</text>",
                cx + 3.0,
                cy - r + 14.0
            );
        }
        let _ = writeln!(
            s,
            "<path class=\"g\" d=\"M{:.0} {cy}h{:.0}M{cx} {:.0}v{:.0}\"/>\
             <text x=\"{:.0}\" y=\"{:.1}\">x</text><text x=\"{:.1}\" y=\"{:.0}\">y</text>",
            cx - radius,
            2.0 * radius,
            cy - radius,
            2.0 * radius,
            cx + radius + 5.0,
            cy + 4.5,
            cx - 12.0,
            cy - radius + 14.0
        );
        for &c in self.candidates {
            let (x, y) = place(c);
            let _ = writeln!(s, "<circle class=\"c\" cx=\"{x:.1}\" cy=\"{y:.1}\" r=\"2\"/>");
        }
        for &(requested, used) in &self.chosen {
            let ((x, y), (u, v)) = (place(requested), place(used));
            if light::angle(requested, used) > 1e-3 {
                let _ = writeln!(
                    s,
                    "<path stroke=\"{0}\" d=\"M{x:.1} {y:.1}L{u:.1} {v:.1}\"/>\
                     <circle cx=\"{x:.1}\" cy=\"{y:.1}\" r=\"6\" fill=\"none\" stroke=\"{0}\" stroke-width=\"1.5\"/>",
                    COLOURS[1]
                );
            }
        }
        for (k, &(requested, used)) in self.chosen.iter().enumerate() {
            let (u, v) = place(used);
            let _ = writeln!(
                s,
                "<circle cx=\"{u:.1}\" cy=\"{v:.1}\" r=\"9\" fill=\"{}\"><title>light {}: azimuth {:.1}°, slant {:.1}°, {:.1}° from the requested one</title></circle>\
                 <text class=\"n\" x=\"{u:.1}\" y=\"{:.1}\">{}</text>",
                COLOURS[0],
                k + 1,
                light::azimuth(used).to_degrees(),
                light::slant(used).to_degrees(),
                light::angle(requested, used).to_degrees(),
                v + 4.0,
                k + 1
            );
        }
        s + "</svg>\n"
    }
}

/// Normals as colours in the whole frame, rgb = (n + 1)/2, black around the mask; 8 or 16 bits a channel.
///
/// # Errors
/// [`ImageError::Length`] where there is not one normal a mask pixel.
pub fn normal_map(mask: &Mask, normals: &[Vec3], bits: BitDepth) -> Result<Vec<u8>, ImageError> {
    check(mask, normals.len())?;
    let half = 0.5 * f32::from(bits.max());
    let code = |n: &Vec3| n.to_array().map(|v| ((v + 1.0) * half + 0.5) as u16);
    let rgb = mask.scatter(&normals.iter().map(code).collect::<Vec<_>>(), [0; 3]);
    encode_rgb(mask.width(), mask.height(), bits, &rgb)
}

/// Angular errors as colours, around the object, with a colour bar from 0 to `scale` degrees (larger errors
/// have the last colour) and the mean in figures. Small maps are enlarged by a whole factor.
///
/// # Errors
/// [`ImageError::Length`] where there is not one error a mask pixel.
pub fn error_map(mask: &Mask, errors: &ErrorMap, scale: f32) -> Result<Vec<u8>, ImageError> {
    check(mask, errors.degrees.len())?;
    let frame = Frame::around(mask);
    let zoom = (240 / frame.height.min(frame.width).max(1)).clamp(1, 8);
    let (map_width, map_height) = (frame.width * zoom, (frame.height * zoom).max(160));
    // Right of the map: space, bar, figures. Below it: the mean.
    let (bar, label) = (map_width + 12, map_width + 12 + 16 + 12);
    let mut canvas = Canvas::new(label + 4 * Canvas::CHARACTER + 4, map_height + 24);
    for (p, &e) in errors.degrees.iter().enumerate() {
        let (x, y) = mask.position(p);
        canvas.fill((x - frame.left) * zoom, (y - frame.top) * zoom, zoom, zoom, colour(e / scale));
    }
    let (bar_top, bar_height) = (8, map_height - 16);
    for y in 0..bar_height {
        let part = 1.0 - y as f32 / (bar_height - 1) as f32;
        canvas.fill(bar, bar_top + y, 16, 1, colour(part));
    }
    let (values, decimals) = ticks(0.0, f64::from(scale), 5.0);
    for v in values {
        let y = bar_top + ((1.0 - v as f32 / scale) * (bar_height - 1) as f32 + 0.5) as u32;
        canvas.fill(bar + 16, y, 3, 1, INK);
        canvas.text(label, y.saturating_sub(Canvas::LINE / 2), &format!("{v:.decimals$}°"));
    }
    canvas.text(4, map_height + 6, &format!("MAE {:.2}°", errors.mae));
    encode_rgb(canvas.width, canvas.height, BitDepth::Eight, &canvas.rgb)
}

fn check(mask: &Mask, found: usize) -> Result<(), ImageError> {
    if found == mask.len() {
        Ok(())
    } else {
        Err(ImageError::Length { found, width: mask.width(), height: mask.height() })
    }
}

const PAPER: [u16; 3] = [255; 3];
const INK: [u8; 3] = [34; 3];

/// A white page with filled rectangles and figures.
struct Canvas {
    width: u32,
    height: u32,
    rgb: Vec<[u16; 3]>,
}

impl Canvas {
    /// Advance of a character and height of a line, pixels: glyphs of 5×7, twice as large.
    const CHARACTER: u32 = 12;
    const LINE: u32 = 14;

    fn new(width: u32, height: u32) -> Self {
        Self { width, height, rgb: vec![PAPER; width as usize * height as usize] }
    }

    /// What lies outside the page is cut off.
    fn fill(&mut self, x: u32, y: u32, width: u32, height: u32, colour: [u8; 3]) {
        for row in y..(y + height).min(self.height) {
            let start = row as usize * self.width as usize;
            let span = x.min(self.width) as usize..(x + width).min(self.width) as usize;
            self.rgb[start..][span].fill(colour.map(u16::from));
        }
    }

    fn text(&mut self, x: u32, y: u32, text: &str) {
        for (i, c) in text.chars().enumerate() {
            for (row, bits) in glyph(c).into_iter().enumerate() {
                for column in (0..5).filter(|column| bits >> (4 - column) & 1 == 1) {
                    let at = x + i as u32 * Self::CHARACTER + 2 * column;
                    self.fill(at, y + 2 * row as u32, 2, 2, INK);
                }
            }
        }
    }
}

/// A 5×7 glyph, a row a byte, the leftmost pixel in bit 4; blank for what is not needed here.
#[rustfmt::skip]
fn glyph(c: char) -> [u8; 7] {
    match c {
        '0' => [0b01110, 0b10001, 0b10011, 0b10101, 0b11001, 0b10001, 0b01110],
        '1' => [0b00100, 0b01100, 0b00100, 0b00100, 0b00100, 0b00100, 0b01110],
        '2' => [0b01110, 0b10001, 0b00001, 0b00010, 0b00100, 0b01000, 0b11111],
        '3' => [0b11111, 0b00010, 0b00100, 0b00010, 0b00001, 0b10001, 0b01110],
        '4' => [0b00010, 0b00110, 0b01010, 0b10010, 0b11111, 0b00010, 0b00010],
        '5' => [0b11111, 0b10000, 0b11110, 0b00001, 0b00001, 0b10001, 0b01110],
        '6' => [0b00110, 0b01000, 0b10000, 0b11110, 0b10001, 0b10001, 0b01110],
        '7' => [0b11111, 0b00001, 0b00010, 0b00100, 0b01000, 0b01000, 0b01000],
        '8' => [0b01110, 0b10001, 0b10001, 0b01110, 0b10001, 0b10001, 0b01110],
        '9' => [0b01110, 0b10001, 0b10001, 0b01111, 0b00001, 0b00010, 0b01100],
        '.' => [0, 0, 0, 0, 0, 0b01100, 0b01100],
        '°' => [0b01100, 0b10010, 0b10010, 0b01100, 0, 0, 0],
        'M' => [0b10001, 0b11011, 0b10101, 0b10101, 0b10001, 0b10001, 0b10001],
        'A' => [0b01110, 0b10001, 0b10001, 0b11111, 0b10001, 0b10001, 0b10001],
        'E' => [0b11111, 0b10000, 0b10000, 0b11110, 0b10000, 0b10000, 0b11111],
        _ => [0; 7],
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::error::error_map as errors_of;
    use crate::image::decode_png;
    use crate::light::{fibonacci_hemisphere, from_azimuth_slant};

    fn plot() -> LinePlot {
        let point = |x: f64, y: f64| Point { x, y, interval: Some([y - 0.2, y + 0.3]) };
        LinePlot {
            title: "a < b & c".into(),
            x_label: "lights".into(),
            y_label: "MAE (°)".into(),
            series: vec![
                Series {
                    name: "random".into(),
                    points: (3..=10).map(|t| point(t.into(), 40.0 / f64::from(t))).collect(),
                },
                Series { name: "gap".into(), points: vec![point(3.0, f64::NAN), point(5.0, 7.0)] },
                Series { name: "none".into(), points: vec![] },
            ],
        }
    }

    #[test]
    fn ticks_are_round_and_inside() {
        assert_eq!(ticks(3.0, 10.0, 8.0), ((3..=10).map(f64::from).collect(), 0));
        assert_eq!(ticks(0.0, 45.0, 5.0), (vec![0.0, 10.0, 20.0, 30.0, 40.0], 0));
        assert_eq!(
            ticks(7.63, 8.12, 5.0),
            ([7.7, 7.8, 7.9, 8.0, 8.1].iter().map(|v: &f64| (v * 10.0).round() * 0.1).collect(), 1)
        );
    }

    #[test]
    fn line_plot_draws_what_is_finite_and_escapes_names() {
        let svg = plot().svg();
        assert_eq!(svg, plot().svg());
        assert_eq!(svg.matches("<circle cx").count(), 8 + 1 + 3); // points, and a marker each in the legend
        assert!(svg.contains("a &lt; b &amp; c") && !svg.contains("NaN") && !svg.contains("inf"));
        assert!(LinePlot::default().svg().ends_with("</svg>\n"));
    }

    #[test]
    fn light_plot_has_north_up_and_marks_what_was_requested() {
        let candidates = fibonacci_hemisphere(20);
        let up = from_azimuth_slant(std::f32::consts::FRAC_PI_2, std::f32::consts::FRAC_PI_3);
        let plot = LightPlot {
            title: "t".into(),
            candidates: &candidates,
            chosen: vec![(up, up), (Vec3::Z, candidates[3])],
        };
        let svg = plot.svg();
        assert_eq!(svg.matches("class=\"c\"").count(), 20);
        assert_eq!(svg.matches("r=\"9\"").count(), 2);
        assert_eq!(svg.matches("r=\"6\"").count(), 1); // only the second was given another light
        assert!(svg.contains("cx=\"210.0\" cy=\"109.3\" r=\"9\"")); // 60° of 90° above the centre
    }

    #[test]
    fn normal_map_is_the_convention() {
        let mask = Mask::new(3, 1, &[true, false, true]).unwrap();
        for (bits, top) in [(BitDepth::Eight, 255), (BitDepth::Sixteen, 65535)] {
            let png = normal_map(&mask, &[Vec3::X, -Vec3::Y], bits).unwrap();
            let half = top / 2 + 1;
            assert_eq!(decode_png(&png, 3).unwrap().rgb, [[top, half, half], [0; 3], [half, 0, half]]);
        }
        assert!(normal_map(&mask, &[Vec3::X], BitDepth::Eight).is_err());
    }

    #[test]
    fn error_map_has_the_bar_and_its_ends() {
        let mask = Mask::full(30, 20).unwrap();
        let errors = errors_of(&vec![Vec3::Z; 600], &vec![from_azimuth_slant(0.0, 0.2); 600]);
        let png = error_map(&mask, &errors, 20.0).unwrap();
        let image = decode_png(&png, 1 << 20).unwrap();
        let at = |x: u32, y: u32| image.rgb[(y * image.width + x) as usize];
        assert_eq!(at(5, 5), colour(0.2f32.to_degrees() / 20.0).map(u16::from));
        let bar = image.width - 4 - 4 * Canvas::CHARACTER - 12 - 16;
        assert_eq!(at(bar, 8), colour(1.0).map(u16::from));
        assert_eq!(at(bar, image.height - 24 - 9), colour(0.0).map(u16::from));
        assert!(error_map(&Mask::full(1, 1).unwrap(), &errors, 20.0).is_err());
    }
}
