//! The renderer's worlds as training and validation objects, as a rig sees them.

use super::fit::Pool;
use super::formation::Scene;
use super::formation::Shading;
use crate::render::{
    self, Errors, Mesh, Options, Pose, RenderError, Shape, Tolerances, View,
    horizon::{Exchange, Horizon},
    worlds::{self, Object},
};
use crate::rng::Rng;
use crate::stack::Mask;
use glam::{Mat3, Vec3};
use std::collections::HashMap;
use std::sync::{Arc, Mutex};

/// Seed of the training and validation objects.
const SEED: u64 = 1;

/// A scene as a real rig sees it.
struct Real {
    scene: render::Scene,
    errors: Errors,
}

impl Real {
    fn new(scene: render::Scene, rig: Tolerances, seed: u64) -> Self {
        let errors = Errors::new(&scene, rig, seed);
        Self { scene, errors }
    }
}

impl Scene for Real {
    fn mask(&self) -> &Mask {
        &self.scene.view.mask
    }
    fn truth(&self) -> &[Vec3] {
        self.scene.truth()
    }
    fn image(&self, light: Vec3) -> Vec<[f32; 3]> {
        let mut rgb = self.scene.render(self.errors.light(light));
        self.errors.expose(&self.scene, light, &mut rgb);
        rgb
    }
    /// Errors move with the light: the gradient is that of the picture without them.
    fn image_with_gradient(&self, light: Vec3) -> Shading {
        let there = self.errors.light(light);
        let (mut rgb, mut gradient) = Scene::image_with_gradient(&self.scene, there);
        for (gradient, factor) in gradient.iter_mut().zip(self.errors.nearness(&self.scene, there)) {
            *gradient = gradient.map(|g| g * factor);
        }
        self.errors.expose(&self.scene, light, &mut rgb);
        (rgb, gradient)
    }
}

/// What of an object doesn't depend on its finish.
struct Bare {
    pose: Pose,
    view: View,
    horizon: Horizon,
    exchange: Exchange,
}

/// The policy's training objects, made when first drawn and kept; each draw gets a finish of its own.
pub struct Training {
    size: u32,
    softness: f32,
    meshes: Vec<(String, Mesh)>,
    any_material: bool,
    made: Mutex<HashMap<(usize, bool), Arc<Bare>>>,
}

/// Share of the rigs of varied objects whose light is collimated, and half width of the object in units of the nearest light's
/// distance.
const COLLIMATED: f32 = 0.3;
const NEAREST: f32 = 0.15;
/// Seed of the angles by which varied objects are turned.
const ROLL: u64 = 0x726f_6c6c;
/// Seed of the rigs that see varied validation objects.
const RIGS: u64 = 0x7269_6773;
/// One in so many training objects is a mesh, if there are any.
const MESH_EVERY: usize = 4;
/// Azimuths of the training objects' horizon maps: what soft shadows need, in half the memory of the test's.
const AZIMUTHS: usize = 32;
/// Azimuths and levels of their form factors, as coarse.
const EXCHANGE: (usize, usize) = (12, 1);

impl Training {
    /// Objects in pictures of `size × size` pixels with shadow boundaries of this softness: sculptures, and where there are
    /// meshes every [`MESH_EVERY`]th one of these, in another pose each time.
    ///
    /// # Errors
    /// A mesh that can't be rendered.
    pub fn new(size: u32, softness: f32, meshes: Vec<(String, Mesh)>) -> Result<Self, RenderError> {
        for (_, mesh) in &meshes {
            Pose::fit(&Shape::Mesh(mesh.clone()), Mat3::IDENTITY)?;
        }
        Ok(Self { size, softness, meshes, any_material: false, made: Mutex::new(HashMap::new()) })
    }

    /// The same, with varied objects of any material, see [`super::fit::Recipe::any_material`].
    #[must_use]
    pub fn of_any_material(self, any_material: bool) -> Self {
        Self { any_material, ..self }
    }

    fn object(&self, index: usize, turned: bool) -> Object {
        let object = self.upright(index);
        if turned { rolled(object, index) } else { object }
    }

    fn upright(&self, index: usize) -> Object {
        if self.meshes.is_empty() || !index.is_multiple_of(MESH_EVERY) {
            return worlds::training(SEED, index);
        }
        let (name, mesh) = &self.meshes[index / MESH_EVERY % self.meshes.len()];
        let rng = &mut Rng::stream(SEED, index as u64);
        Object::dressed(name, Shape::Mesh(mesh.clone()), worlds::Split::Train, rng)
    }

    fn bare(&self, index: usize, rolled: bool) -> Result<Arc<Bare>, RenderError> {
        let made = |map: &HashMap<(usize, bool), Arc<Bare>>| map.get(&(index, rolled)).cloned();
        if let Some(bare) = made(&self.made.lock().expect("no thread panicked")) {
            return Ok(bare);
        }
        let object = self.object(index, rolled);
        let pose = Pose::fit(&object.shape, object.rotation)?;
        let view = View::new(&object.shape, &pose, self.size)?;
        let horizon = Horizon::new(&view, AZIMUTHS);
        let (azimuths, levels) = EXCHANGE;
        let exchange = Exchange::new(&view, azimuths, levels);
        let bare = Arc::new(Bare { pose, view, horizon, exchange });
        self.made.lock().expect("no thread panicked").insert((index, rolled), bare.clone());
        Ok(bare)
    }
}

impl Pool for Training {
    fn draw(&self, index: usize, varied: bool, rng: &mut Rng) -> Result<Box<dyn Scene>, RenderError> {
        let bare = self.bare(index, varied)?;
        let finish = if varied && self.any_material { worlds::any_finish } else { worlds::finish };
        let finish = finish(worlds::Split::Train, rng);
        let skin = finish.skin(&bare.view, &bare.pose);
        let scene = render::Scene {
            name: index.to_string(),
            pose: bare.pose,
            view: bare.view.clone(),
            horizon: bare.horizon.clone(),
            exchange: Some(bare.exchange.clone()),
            skin,
            softness: self.softness,
            bounces: 1,
        };
        let seed = rng.next_u64();
        let rig = if varied { Tolerances::any(rng, COLLIMATED, NEAREST) } else { Tolerances::RIG };
        Ok(Box::new(Real::new(scene, rig, seed)))
    }
}

/// Turns object number `index` about the optical axis.
fn rolled(object: Object, index: usize) -> Object {
    let (sin, cos) = libm::sincosf(Rng::stream(ROLL, index as u64).range(0.0, std::f32::consts::TAU));
    let roll = Mat3::from_cols(Vec3::new(cos, sin, 0.0), Vec3::new(-sin, cos, 0.0), Vec3::Z);
    Object { rotation: roll * object.rotation, ..object }
}

/// Validation objects, with one bounce of light and hard shadows: the first ones of `worlds`; with meshes these in turn, each
/// time in another pose and with another finish of the validation materials. Varied ones are turned, and seen by rigs of any
/// quality, as in training.
///
/// # Errors
/// A mesh that can't be rendered.
pub fn validation(
    meshes: &[(String, Mesh)],
    count: usize,
    size: u32,
    varied: bool,
) -> Result<Vec<Box<dyn Scene>>, RenderError> {
    let options = Options { size, softness: 0.0, ..Options::default() };
    (0..count)
        .map(|i| {
            let object = match meshes {
                [] => worlds::validation(SEED, i),
                _ => {
                    let (name, mesh) = &meshes[i % meshes.len()];
                    let rng = &mut Rng::stream(SEED, i as u64);
                    Object::dressed(name, Shape::Mesh(mesh.clone()), worlds::Split::Validation, rng)
                }
            };
            let (object, rig) = match varied {
                true => {
                    let rig = Tolerances::any(&mut Rng::stream(RIGS, i as u64), COLLIMATED, NEAREST);
                    (rolled(object, i), rig)
                }
                false => (object, Tolerances::RIG),
            };
            Ok(Box::new(Real::new(object.scene(&options)?, rig, i as u64)) as Box<dyn Scene>)
        })
        .collect()
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn meshes_are_validated_on_in_turn_each_time_otherwise() {
        let tent = "v -1 -1 0\nv 1 -1 0\nv 1 1 0\nv -1 1 0\nv 0 0 1\nf 1 2 5\nf 2 3 5\nf 3 4 5\nf 4 1 5\n";
        let mesh = |name: &str| (name.to_owned(), Mesh::from_bytes("tent.obj", tent.as_bytes()).unwrap());
        let scenes = validation(&[mesh("a"), mesh("b")], 3, 24, false).unwrap();
        let seen: Vec<_> = scenes.iter().map(|s| s.image(Vec3::Z)).collect();
        assert!(seen[0] != seen[2] && seen[0] != seen[1]);
        assert_eq!(
            validation(&[], 1, 24, false).unwrap()[0].image(Vec3::Z),
            validation(&[], 2, 24, false).unwrap()[0].image(Vec3::Z)
        );
    }

    #[test]
    fn some_training_objects_are_meshes_where_there_are_any() {
        let tent = "v -1 -1 0\nv 1 -1 0\nv 1 1 0\nv -1 1 0\nv 0 0 1\nf 1 2 5\nf 2 3 5\nf 3 4 5\nf 4 1 5\n";
        let mesh = Mesh::from_bytes("tent.obj", tent.as_bytes()).unwrap();
        let new = |meshes| Training::new(20, 0.05, meshes).unwrap();
        let (plain, mixed) = (new(Vec::new()), new(vec![("tent".to_owned(), mesh)]));
        let names = |pool: &Training| (0..8).map(|i| pool.object(i, false).name).collect::<Vec<_>>();
        let (plain, mixed) = (names(&plain), names(&mixed));
        assert_eq!(mixed.iter().filter(|n| *n == "tent").count(), 8 / MESH_EVERY);
        assert_eq!(plain[1..MESH_EVERY], mixed[1..MESH_EVERY]);
    }

    #[test]
    fn rolled_objects_lean_everywhere() {
        let pool = Training::new(20, 0.05, Vec::new()).unwrap();
        let mut sum = Vec3::ZERO;
        for i in 0..40 {
            let (a, b) = (pool.object(i, false).rotation, pool.object(i, true).rotation);
            assert_eq!(a.row(2), b.row(2), "the same side faces the camera");
            sum += (b * a.transpose()).x_axis;
        }
        // Forty random directions; upright it would be 40.
        assert!(sum.length() < 20.0, "{sum}");
    }

    #[test]
    fn the_pool_repeats_itself() {
        let new = || Training::new(20, 0.05, Vec::new()).unwrap();
        let pool = new();
        let draw =
            |pool: &Training| pool.draw(3, true, &mut Rng::new(8)).unwrap().image(Vec3::new(0.6, 0.0, 0.8));
        assert_eq!(draw(&pool), draw(&pool));
        assert_eq!(draw(&pool), draw(&new()));
    }

    #[test]
    fn varied_objects_alone_are_of_any_material() {
        let new = || Training::new(20, 0.05, Vec::new()).unwrap();
        let (measured, any) = (new(), new().of_any_material(true));
        let differ = |varied: bool| {
            let draw = |pool: &Training, i| {
                pool.draw(i, varied, &mut Rng::new(i as u64)).unwrap().image(Vec3::new(0.6, 0.0, 0.8))
            };
            (0..4).filter(|&i| draw(&measured, i) != draw(&any, i)).count()
        };
        assert!(differ(true) > 0);
        assert_eq!(differ(false), 0);
    }
}
