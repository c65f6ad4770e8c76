//! How a direction becomes a picture in training, with the gradient of the picture with respect to the direction.

use crate::light;
use crate::relight::soft_weights;
use crate::render;
use crate::stack::Mask;
use glam::{Mat3, Vec3};

/// A picture's linear RGB values and their gradient by the light direction, one entry a mask pixel.
pub type Shading = (Vec<[f32; 3]>, Vec<[Vec3; 3]>);

/// An object that can be photographed under any direction.
pub trait Scene: Send + Sync {
    /// Its pixels.
    fn mask(&self) -> &Mask;
    /// True unit normals of the mask pixels.
    fn truth(&self) -> &[Vec3];
    /// Linear RGB of the mask pixels under a unit direction.
    fn image(&self, light: Vec3) -> Vec<[f32; 3]>;
    /// The same with the gradient of every value by the direction's three components.
    fn image_with_gradient(&self, light: Vec3) -> Shading;
}

impl Scene for render::Scene {
    fn mask(&self) -> &Mask {
        &self.view.mask
    }
    fn truth(&self) -> &[Vec3] {
        render::Scene::truth(self)
    }
    fn image(&self, light: Vec3) -> Vec<[f32; 3]> {
        self.render(light)
    }
    fn image_with_gradient(&self, light: Vec3) -> Shading {
        let image = self.render_with_gradient(light);
        image.iter().map(|rgb| (rgb.map(|v| v.value), rgb.map(|v| v.gradient))).unzip()
    }
}

/// What answers a requested direction.
#[derive(Clone, Debug, PartialEq)]
pub enum Lookup {
    /// A picture at exactly that direction.
    Exact,
    /// The nearest light of a finite set that was not used yet, as on a light stage or a published dataset. Its gradient is
    /// passed straight through, as if the request itself had been used.
    Nearest(Vec<Vec3>),
    /// The paper's soft interpolation (Eq. 7-8) over a finite set.
    Soft {
        /// Temperature, radians.
        tau: f32,
        /// The set.
        lights: Vec<Vec3>,
    },
}

/// A picture taken for training.
#[derive(Clone, Debug)]
pub struct Shot {
    /// Direction as the solver must use it.
    pub light: Vec3,
    /// Its gradient by the requested direction.
    pub light_gradient: Mat3,
    /// Number of the stored light, where one was used alone.
    pub index: Option<usize>,
    /// Linear RGB of the mask pixels.
    pub rgb: Vec<[f32; 3]>,
    /// Gradient of each value by the requested direction.
    pub gradient: Vec<[Vec3; 3]>,
}

impl Lookup {
    /// Takes the picture. `used` are the stored lights this sequence has had.
    #[must_use]
    pub fn take(&self, scene: &dyn Scene, direction: Vec3, used: &[usize]) -> Shot {
        match self {
            Self::Exact => exact(scene, direction, None),
            Self::Nearest(lights) => {
                let i = light::nearest(direction, lights, |i| !used.contains(&i))
                    .or_else(|| light::nearest(direction, lights, |_| true));
                exact(scene, i.map_or(direction, |i| lights[i]), i)
            }
            Self::Soft { tau, lights } => soft(scene, direction, lights, *tau),
        }
    }
}

fn exact(scene: &dyn Scene, light: Vec3, index: Option<usize>) -> Shot {
    let (rgb, gradient) = scene.image_with_gradient(light);
    Shot { light, light_gradient: Mat3::IDENTITY, index, rgb, gradient }
}

fn soft(scene: &dyn Scene, direction: Vec3, lights: &[Vec3], tau: f32) -> Shot {
    let weights = soft_weights(direction, lights, tau);
    // d(−θ_p/τ)/dl = l_p/(τ sin θ_p); the weights' own gradient subtracts the mean.
    let slope = |k: usize| lights[k] / (tau * light::angle(direction, lights[k]).sin().max(1e-3));
    let mean: Vec3 = weights.terms.iter().map(|&(k, w)| w * slope(k)).sum();
    let pixels = scene.mask().len();
    let mut shot = Shot {
        light: Vec3::ZERO,
        light_gradient: Mat3::ZERO,
        index: None,
        rgb: vec![[0.0; 3]; pixels],
        gradient: vec![[Vec3::ZERO; 3]; pixels],
    };
    for &(k, w) in &weights.terms {
        let by_light = w * (slope(k) - mean);
        let l = lights[k];
        shot.light += w * l;
        shot.light_gradient += Mat3::from_cols(l * by_light.x, l * by_light.y, l * by_light.z);
        for ((rgb, gradient), image) in shot.rgb.iter_mut().zip(&mut shot.gradient).zip(scene.image(l)) {
            for c in 0..3 {
                rgb[c] += w * image[c];
                gradient[c] += image[c] * by_light;
            }
        }
    }
    shot
}

/// A plausible finite light set of up to `reach` radians: a rectangular grid of lamps on a plane parallel to the image,
/// or an evenly filled cone, each lamp displaced a little.
#[must_use]
pub fn light_set(rng: &mut crate::rng::Rng, reach: f32) -> Vec<Vec3> {
    let jitter = |rng: &mut crate::rng::Rng, d: Vec3| {
        (d + 0.02 * Vec3::new(rng.normal(), rng.normal(), 0.0)).normalize()
    };
    let set: Vec<Vec3> = if rng.uniform() < 0.5 {
        let (columns, rows) = (6 + rng.below(8), 5 + rng.below(6));
        let aspect = rng.range(0.5, 1.0);
        // The corners are the largest slants.
        let half = reach.min(1.2).tan() / (1.0 + aspect * aspect).sqrt();
        let (wide, tall) = if rng.uniform() < 0.5 { (half, half * aspect) } else { (half * aspect, half) };
        let at = |i: usize, n: usize| 2.0 * i as f32 / (n - 1) as f32 - 1.0;
        (0..rows * columns)
            .map(|i| {
                Vec3::new(wide * at(i % columns, columns), tall * at(i / columns, rows), 1.0).normalize()
            })
            .collect()
    } else {
        let count = 30 + rng.below(120);
        light::fibonacci_cap(count, reach)
    };
    set.into_iter().map(|d| jitter(rng, d)).collect()
}

#[cfg(test)]
pub(super) mod tests {
    use super::*;
    use crate::rng::Rng;

    /// A smooth Lambertian bump with a broad highlight: enough to test with, no renderer.
    pub struct Bump {
        mask: Mask,
        truth: Vec<Vec3>,
        gloss: f32,
    }

    impl Bump {
        pub fn new(side: u32, gloss: f32) -> Self {
            let at = |i: u32| 2.2 * (i as f32 + 0.5) / side as f32 - 1.1;
            let inside: Vec<bool> =
                (0..side * side).map(|i| at(i % side).hypot(at(i / side)) < 0.98).collect();
            let mask = Mask::new(side, side, &inside).unwrap();
            let truth = (0..mask.len())
                .map(|p| {
                    let (x, y) = mask.position(p);
                    let (x, y) = (at(x), -at(y));
                    Vec3::new(x, y, (1.0 - x * x - y * y).max(1e-4).sqrt()).normalize()
                })
                .collect();
            Self { mask, truth, gloss }
        }
    }

    impl Scene for Bump {
        fn mask(&self) -> &Mask {
            &self.mask
        }
        fn truth(&self) -> &[Vec3] {
            &self.truth
        }
        fn image(&self, light: Vec3) -> Vec<[f32; 3]> {
            self.image_with_gradient(light).0
        }
        fn image_with_gradient(&self, light: Vec3) -> Shading {
            self.truth
                .iter()
                .map(|n| {
                    let lambert = n.dot(light).max(0.0);
                    let by = if lambert > 0.0 { *n } else { Vec3::ZERO };
                    // A highlight that looks along (light + view)·n to the fourth.
                    let h = n.dot(light + Vec3::Z).max(0.0) * 0.5;
                    let value = lambert + self.gloss * h.powi(8) * lambert;
                    let g = by * (1.0 + self.gloss * h.powi(8)) + 4.0 * self.gloss * lambert * h.powi(7) * *n;
                    ([value, value, 0.5 * value], [g, g, 0.5 * g])
                })
                .unzip()
        }
    }

    #[test]
    fn gradients_of_every_lookup_agree_with_finite_differences() {
        let scene = Bump::new(12, 1.0);
        let set = light::fibonacci_hemisphere(60);
        for lookup in [Lookup::Exact, Lookup::Soft { tau: 0.2, lights: set }] {
            let l = light::from_azimuth_slant(0.7, 0.6);
            let shot = lookup.take(&scene, l, &[]);
            let h = 1e-3;
            // Along two tangents: the direction stays a unit vector.
            for t in [l.cross(Vec3::Z).normalize(), l.cross(l.cross(Vec3::Z)).normalize()] {
                let [a, b] = [h, -h].map(|s| lookup.take(&scene, (l + s * t).normalize(), &[]));
                let numeric = (a.light - b.light) / (2.0 * h);
                assert!((numeric - shot.light_gradient * t).length() < 5e-3);
                for p in (0..scene.mask().len()).step_by(7) {
                    let numeric = (a.rgb[p][0] - b.rgb[p][0]) / (2.0 * h);
                    let exact = shot.gradient[p][0].dot(t);
                    assert!((numeric - exact).abs() < 1e-2 + 0.02 * exact.abs(), "{numeric} {exact}");
                }
            }
        }
    }

    #[test]
    fn nearest_uses_no_light_twice() {
        let scene = Bump::new(6, 0.0);
        let set = light_set(&mut Rng::new(4), 0.7);
        assert!(light::reach(&set) < 0.8 && set.len() >= 30);
        let lookup = Lookup::Nearest(set);
        let mut used = Vec::new();
        for _ in 0..5 {
            used.push(lookup.take(&scene, Vec3::Z, &used).index.unwrap());
        }
        let mut distinct = used.clone();
        distinct.sort_unstable();
        distinct.dedup();
        assert_eq!(distinct.len(), 5);
    }
}
