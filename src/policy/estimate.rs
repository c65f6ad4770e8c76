//! What least squares makes of the frames so far, shown to the network beside the newest one: where the surface faces, and
//! how much of the pictures no matte surface explains.
//!
//! The policy is to lower least squares' error. From frames and lights alone it would have to redo least squares on a feature map
//! of a few cells; gloss and cast shadows are what is left over by the fit, on real objects as on rendered ones.

use glam::{DMat3, DVec3, Vec3};

/// Channels of the estimate: unit normal (3), residual of the newest frame, root mean square of all frames' residuals, both as
/// shares of the albedo.
pub const CUES: usize = 5;

/// Added to the normal equations' diagonal: two lights determine no normal. A ring of three lights at 15° has 0.1 there.
const RIDGE: f64 = 0.01;
/// Albedo (in units of the first frame's white) below which a cell counts as dark rather than as a normal.
const DARK: f64 = 0.02;
/// Largest residual shown, as a share of the albedo.
const LIMIT: f64 = 2.0;

/// Least squares of every cell of the frames, kept up to date.
#[derive(Clone, Debug)]
pub struct Estimate {
    cells: usize,
    frames: f64,
    /// Σ l lᵀ.
    lights: DMat3,
    /// Σ I l of each cell.
    moments: Vec<DVec3>,
    /// Σ I² of each cell.
    squares: Vec<f64>,
}

impl Estimate {
    /// Of frames of so many cells.
    #[must_use]
    pub fn new(cells: usize) -> Self {
        Self {
            cells,
            frames: 0.0,
            lights: DMat3::ZERO,
            moments: vec![DVec3::ZERO; cells],
            squares: vec![0.0; cells],
        }
    }

    /// Takes in a frame `[3, side, side]` and the unit direction it was taken under; gives `[CUES, side, side]`.
    pub fn add(&mut self, frame: &[f32], light: Vec3) -> Vec<f32> {
        let l = light.as_dvec3();
        self.frames += 1.0;
        self.lights += DMat3::from_cols(l * l.x, l * l.y, l * l.z);
        let inverse = (self.lights + DMat3::from_diagonal(DVec3::splat(RIDGE))).inverse();
        let n = self.cells;
        let mut cues = vec![0.0; CUES * n];
        for cell in 0..n {
            let grey = f64::from(frame[cell] + frame[n + cell] + frame[2 * n + cell]) / 3.0;
            self.moments[cell] += l * grey;
            self.squares[cell] += grey * grey;
            let moment = self.moments[cell];
            let scaled = inverse * moment;
            let albedo = scaled.length() + DARK;
            let left = self.squares[cell] - 2.0 * scaled.dot(moment) + scaled.dot(self.lights * scaled);
            let normal = scaled / albedo;
            let newest = ((grey - l.dot(scaled)) / albedo).clamp(-LIMIT, LIMIT);
            let all = ((left / self.frames).max(0.0).sqrt() / albedo).min(LIMIT);
            for (channel, value) in [normal.x, normal.y, normal.z, newest, all].into_iter().enumerate() {
                cues[channel * n + cell] = value as f32;
            }
        }
        cues
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::light::ring;

    /// Cues of one cell after pictures of these values.
    fn after(lights: &[Vec3], value: impl Fn(usize, Vec3) -> f32) -> [f32; CUES] {
        let mut estimate = Estimate::new(1);
        let mut cues = vec![];
        for (i, &l) in lights.iter().enumerate() {
            cues = estimate.add(&[value(i, l); 3], l);
        }
        cues.try_into().unwrap()
    }

    #[test]
    fn a_matte_surface_is_explained_and_a_highlight_is_not() {
        let normal = Vec3::new(0.3, -0.2, 0.9).normalize();
        let lights = ring(6, 0.5, 0.0);
        let [x, y, z, newest, all] = after(&lights, |_, l| 0.8 * normal.dot(l));
        assert!(Vec3::new(x, y, z).angle_between(normal) < 0.02);
        assert!(newest.abs() < 0.01 && all < 0.01, "{newest} {all}");
        let glossy = after(&lights, |i, l| 0.8 * normal.dot(l) + if i == 5 { 1.0 } else { 0.0 });
        assert!(glossy[3] > 0.3 && glossy[4] > 0.2, "{glossy:?}");
        let shadowed = after(&lights, |i, l| if i == 5 { 0.0 } else { 0.8 * normal.dot(l) });
        assert!(shadowed[3] < -0.2, "{shadowed:?}");
    }

    #[test]
    fn background_and_first_frames_are_defined() {
        assert_eq!(after(&[Vec3::Z; 3], |_, _| 0.0), [0.0; CUES]);
        let [x, y, z, newest, all] = after(&[Vec3::Z], |_, _| 1.0);
        assert!(x == 0.0 && y == 0.0 && z > 0.9);
        assert!(newest.abs() < 0.02 && all < 0.02);
    }
}
