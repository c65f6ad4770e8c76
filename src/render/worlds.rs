//! `worlds-v1`: 100 test objects, and training and validation objects that share neither material nor shape with them.
//!
//! Every object is drawn from a seed: a sculpture, a pose, a finish. What sets the splits apart:
//! - materials: [`TEST_MATERIALS`] and [`VALIDATION_MATERIALS`] are held out by name, the other 70 are for training;
//! - shapes: sculpture seeds are 0, 1, 2 modulo 3 for training, validation, test;
//! - families: [`TEST_FAMILIES`] are never seen in training; half of the test objects are of these.

use super::finish::Finish;
use super::material::{Abc, Material};
use super::scene::{Options, Scene};
use super::view::{Pose, Shape};
use super::{RenderError, Sculpture};
use crate::fingerprint::Fingerprint;
use crate::rng::Rng;
use glam::Mat3;

/// Name of the benchmark.
pub const NAME: &str = "worlds-v1";

/// Number of test objects.
pub const TEST_OBJECTS: usize = 100;

/// Seed of the test objects.
const TEST_SEED: u64 = 0x0077_6f72_6c64_7331;

/// Materials of the test objects, held out from training and validation.
pub const TEST_MATERIALS: [&str; 20] = [
    "alum-bronze",
    "black-oxidized-steel",
    "blue-metallic-paint",
    "brass",
    "cherry-235",
    "color-changing-paint2",
    "dark-specular-fabric",
    "gold-metallic-paint",
    "green-acrylic",
    "light-red-paint",
    "nickel",
    "pink-felt",
    "polyethylene",
    "pvc",
    "red-fabric2",
    "silver-metallic-paint2",
    "specular-maroon-phenolic",
    "teflon",
    "violet-rubber",
    "white-marble",
];

/// Materials of the validation objects.
pub const VALIDATION_MATERIALS: [&str; 10] = [
    "black-soft-plastic",
    "chrome-steel",
    "fruitwood-241",
    "gold-paint",
    "green-metallic-paint",
    "grease-covered-steel",
    "nylon",
    "pink-fabric",
    "red-plastic",
    "specular-white-phenolic",
];

/// Families of training and validation.
pub const TRAIN_FAMILIES: [&str; 6] = ["blob", "relief", "drape", "vase", "coral", "totem"];

/// Families that only the test has.
pub const TEST_FAMILIES: [&str; 4] = ["figure", "knot", "lattice", "stone"];

/// Which objects.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum Split {
    /// To learn from.
    Train,
    /// To choose a checkpoint by.
    Validation,
    /// To report on.
    Test,
}

impl Split {
    /// Names of the split's materials, in the order of the file.
    #[must_use]
    pub fn materials(self) -> Vec<&'static str> {
        let held_out = |name: &str| match () {
            () if TEST_MATERIALS.contains(&name) => Self::Test,
            () if VALIDATION_MATERIALS.contains(&name) => Self::Validation,
            () => Self::Train,
        };
        Abc::all().iter().map(|m| m.name.as_str()).filter(|name| held_out(name) == self).collect()
    }

    /// The split's materials.
    #[must_use]
    pub fn measured(self) -> Vec<Material> {
        let names = self.materials();
        let of_split = Abc::all().iter().filter(|m| names.contains(&m.name.as_str()));
        of_split.cloned().map(Material::Abc).collect()
    }

    /// A sculpture seed of this split.
    fn shape_seed(self, rng: &mut Rng) -> u64 {
        3 * rng.below_u64(1 << 40) + self as u64
    }
}

/// An object of the benchmark: everything but the resolution.
#[derive(Clone, Debug)]
pub struct Object {
    /// Number and shape, as "017-knot".
    pub name: String,
    /// Its shape.
    pub shape: Shape,
    /// How it stands.
    pub rotation: Mat3,
    /// What it is made of.
    pub finish: Finish,
}

impl Object {
    /// A shape with a pose and finish drawn for a split: what `test`, `training` and `validation` do with a sculpture,
    /// for a mesh of one's own.
    #[must_use]
    pub fn dressed(name: &str, shape: Shape, split: Split, rng: &mut Rng) -> Self {
        let rotation = shape.random_rotation(rng);
        Self { name: name.into(), shape, rotation, finish: finish(split, rng) }
    }

    fn grown(number: usize, family: &str, split: Split, rng: &mut Rng) -> Self {
        let seed = split.shape_seed(rng);
        let sculpture = Sculpture::grown(family, seed).expect("the families listed here have seeds");
        Self::dressed(&format!("{number:03}-{family}"), Shape::Sculpture(sculpture), split, rng)
    }

    /// The object ready to be rendered.
    ///
    /// # Errors
    /// [`RenderError::Size`] for an impossible size.
    pub fn scene(&self, options: &Options) -> Result<Scene, RenderError> {
        let pose = Pose::fit(&self.shape, self.rotation)?;
        Scene::new(&self.name, &self.shape, &pose, &self.finish, options)
    }
}

/// A finish of a split's measured materials: three quarters of the objects are of one material, the others have a second in patches;
/// four in ten have an albedo texture.
#[must_use]
pub fn finish(split: Split, rng: &mut Rng) -> Finish {
    let names = split.materials();
    finish_of(rng, |rng| {
        Material::Abc(Abc::named(names[rng.below(names.len())]).expect("names come from the file").clone())
    })
}

/// The same of any material.
#[must_use]
pub fn any_finish(split: Split, rng: &mut Rng) -> Finish {
    let measured = split.measured();
    finish_of(rng, |rng| Material::any(rng, &measured))
}

fn finish_of(rng: &mut Rng, draw: impl Fn(&mut Rng) -> Material) -> Finish {
    let material = draw(rng);
    let patches = (rng.uniform() < 0.25).then(|| (draw(rng), rng.next_u64()));
    let texture = (rng.uniform() < 0.4).then(|| rng.next_u64());
    Finish { material, patches, texture }
}

/// Test object 0..[`TEST_OBJECTS`] (numbers beyond go on drawing from the same distribution).
#[must_use]
pub fn test_object(number: usize) -> Object {
    let rng = &mut Rng::stream(TEST_SEED, number as u64);
    let family = if number.is_multiple_of(2) {
        TEST_FAMILIES[number / 2 % TEST_FAMILIES.len()]
    } else {
        TRAIN_FAMILIES[number / 2 % TRAIN_FAMILIES.len()]
    };
    Object::grown(number, family, Split::Test, rng)
}

/// Training object `number` of a seeded, endless sequence.
#[must_use]
pub fn training(seed: u64, number: usize) -> Object {
    let rng = &mut Rng::stream(seed, number as u64);
    let family = TRAIN_FAMILIES[rng.below(TRAIN_FAMILIES.len())];
    Object::grown(number, family, Split::Train, rng)
}

/// Validation object `number` of a seeded, endless sequence.
#[must_use]
pub fn validation(seed: u64, number: usize) -> Object {
    let rng = &mut Rng::stream(seed ^ 0x5a5a_5a5a, number as u64);
    let family = TRAIN_FAMILIES[rng.below(TRAIN_FAMILIES.len())];
    Object::grown(number, family, Split::Validation, rng)
}

/// The objects of a name:
/// - `worlds-v1`, or some of its hundred: `worlds-v1:17`, `worlds-v1:0..9` (both ends included);
/// - training and validation objects of seed 1: `worlds-train:0..999`, `worlds-validate:0..49`;
/// - a sculpture seen from the front, as `blob:7`, in [`MATERIAL`] or another material, as `blob:7+brass`.
///
/// # Errors
/// [`RenderError::Numbers`] for a range that can't be read; [`RenderError::Sculpture`] or [`RenderError::Material`] for
/// a name that is none of these.
pub fn objects(name: &str) -> Result<Vec<Object>, RenderError> {
    let (first, numbers) = name.split_once(':').unwrap_or((name, ""));
    let Some(&(_, make, all)) = SETS.iter().find(|set| set.0 == first) else {
        let (sculpture, material) = name.split_once('+').unwrap_or((name, MATERIAL));
        let material: Material = material.parse()?;
        let shape = Shape::Sculpture(Sculpture::named(sculpture)?);
        let rotation = shape.front();
        let name = name.replace([':', '+'], "-");
        return Ok(vec![Object { name, shape, rotation, finish: material.into() }]);
    };
    let wrong = || RenderError::Numbers { name: name.into(), last: all - 1 };
    let number = |text: &str| text.parse::<usize>().ok().filter(|&i| i < all).ok_or_else(wrong);
    let (first, last) = match numbers.split_once("..") {
        Some((first, last)) => (number(first)?, number(last)?),
        None if name == NAME => (0, all - 1),
        None => (number(numbers)?, number(numbers)?),
    };
    if first > last {
        return Err(wrong());
    }
    Ok((first..=last).map(make).collect())
}

/// So many objects of the endless sequences can be named.
const DRAWN: usize = 1_000_000;

/// Name, objects, number of objects.
type Set = (&'static str, fn(usize) -> Object, usize);

const SETS: [Set; 3] = [
    (NAME, test_object, TEST_OBJECTS),
    ("worlds-train", |i| training(1, i), DRAWN),
    ("worlds-validate", |i| validation(1, i), DRAWN),
];

/// Whether [`objects`] takes this name for objects that have their own materials and poses, not for one sculpture.
#[must_use]
pub fn is_set(name: &str) -> bool {
    let first = name.split(':').next();
    SETS.iter().any(|set| Some(set.0) == first)
}

/// Material of a sculpture that is named without one.
pub const MATERIAL: &str = "specular-maroon-phenolic";

/// A number that stands for what the test objects look like: a [`Fingerprint`] of masks, normals and three pictures of each at
/// 32 × 32 pixels, in 8-bit steps. Whoever reports on `worlds-v1` checks it against [`CHECKSUM`].
///
/// # Errors
/// [`RenderError`], which would be a defect.
pub fn checksum() -> Result<u64, RenderError> {
    let mut print = Fingerprint::default();
    let step = |v: f32| (v * 64.0 + 0.5).floor().clamp(0.0, 255.0) as u8;
    for number in 0..TEST_OBJECTS {
        let scene = test_object(number).scene(&Options { size: 32, ..Options::default() })?;
        for (i, n) in scene.view.mask.indices().iter().zip(scene.truth()) {
            print.add(i.to_le_bytes());
            print.add([step(n.x + 1.0), step(n.y + 1.0), step(n.z + 1.0)]);
        }
        for light in crate::light::fibonacci_hemisphere(3) {
            for value in scene.render(light) {
                print.add(value.map(step));
            }
        }
    }
    Ok(print.value())
}

/// What [`checksum`] gives on every platform.
pub const CHECKSUM: u64 = 0x7717_44ba_7cc4_de0b;

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn the_test_objects_are_the_same_everywhere() {
        let sum = checksum().unwrap();
        assert_eq!(sum, CHECKSUM, "worlds-v1 now renders to {sum:#018x}: a change to it needs a new name");
    }

    #[test]
    fn splits_share_no_material_and_no_shape() {
        let [train, held, tested] = [Split::Train, Split::Validation, Split::Test].map(Split::materials);
        assert_eq!((train.len(), held.len(), tested.len()), (70, 10, 20));
        let name = |o: &Object| match &o.shape {
            Shape::Sculpture(s) => s.name().to_string(),
            Shape::Mesh(_) => unreachable!("only sculptures are drawn"),
        };
        let seed = |o: &Object| name(o).split_once(':').unwrap().1.parse::<u64>().unwrap() % 3;
        for i in 0..TEST_OBJECTS {
            for (o, materials, split) in [
                (training(1, i), &train, Split::Train),
                (validation(1, i), &held, Split::Validation),
                (test_object(i), &tested, Split::Test),
            ] {
                assert_eq!(seed(&o), split as u64);
                let of_split = |m: &Material| materials.contains(&m.name().as_str());
                assert!(of_split(&o.finish.material) && o.finish.patches.iter().all(|p| of_split(&p.0)));
                let new_family = TEST_FAMILIES.contains(&name(&o).split_once(':').unwrap().0);
                assert_eq!(new_family, split == Split::Test && i % 2 == 0);
            }
        }
    }

    #[test]
    fn objects_are_found_by_name() {
        assert_eq!(objects("worlds-v1").unwrap().len(), TEST_OBJECTS);
        assert_eq!(objects("worlds-v1:17").unwrap()[0].rotation, test_object(17).rotation);
        assert_eq!(objects("worlds-train:3..5").unwrap()[2].finish, training(1, 5).finish);
        assert_eq!(objects("blob:7+brass").unwrap()[0].finish.material.name(), "brass");
        for bad in [
            "worlds-v1:100",
            "worlds-v1:9..3",
            "worlds-v2",
            "worlds-train",
            "worlds-train:x",
            "blob:7+brick",
            "blob",
            "",
        ] {
            assert!(objects(bad).is_err(), "{bad}");
        }
    }

    #[test]
    fn a_seed_gives_the_same_object_again() {
        let (a, b, c) = (training(4, 9), training(4, 9), training(5, 9));
        assert_eq!((a.rotation, &a.finish), (b.rotation, &b.finish));
        assert_ne!(a.rotation, c.rotation);
    }
}
