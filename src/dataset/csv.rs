//! Lights and normals as comma-separated values, for spreadsheets and scripts.

use crate::light;
use crate::stack::Mask;
use glam::Vec3;

/// A line an image: name, unit direction towards the light, azimuth and slant in degrees, RGB intensity.
#[must_use]
pub fn lights_csv(names: &[String], lights: &[Vec3], intensities: &[[f32; 3]]) -> String {
    let mut out = String::from("image,x,y,z,azimuth_deg,slant_deg,intensity_r,intensity_g,intensity_b\n");
    for ((name, l), [r, g, b]) in names.iter().zip(lights).zip(intensities) {
        let (azimuth, slant) = (light::azimuth(*l).to_degrees(), light::slant(*l).to_degrees());
        let name = field(name);
        out += &format!("{name},{},{},{},{azimuth:.3},{slant:.3},{r},{g},{b}\n", l.x, l.y, l.z);
    }
    out
}

/// A line a mask pixel: column, row (from the top), normal.
#[must_use]
pub fn normals_csv(mask: &Mask, normals: &[Vec3]) -> String {
    let mut out = String::from("column,row,nx,ny,nz\n");
    for (p, n) in normals.iter().enumerate().take(mask.len()) {
        let (x, y) = mask.position(p);
        out += &format!("{x},{y},{},{},{}\n", n.x, n.y, n.z);
    }
    out
}

/// Quoted where the text has a comma, a quote or a line end (RFC 4180).
fn field(text: &str) -> String {
    if text.contains([',', '"', '\n', '\r']) {
        format!("\"{}\"", text.replace('"', "\"\""))
    } else {
        text.into()
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn columns_are_as_named() {
        let csv = lights_csv(&["a,b.png".into()], &[Vec3::new(0.0, 0.6, 0.8)], &[[1.0, 2.0, 0.5]]);
        assert_eq!(csv.lines().nth(1), Some("\"a,b.png\",0,0.6,0.8,90.000,36.870,1,2,0.5"));
        let mask = Mask::new(2, 2, &[false, true, false, false]).unwrap();
        assert_eq!(normals_csv(&mask, &[Vec3::Z]).lines().nth(1), Some("1,0,0,0,1"));
    }
}
