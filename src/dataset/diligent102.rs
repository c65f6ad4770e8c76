//! DiLiGenT10² (Ren et al., CVPR 2022): ten shapes in ten materials, 100 lights, in DiLiGenT's layout.
//!
//! The true normals are withheld: a server scores uploaded MAT files.

use super::diligent::normals_mat;
use crate::stack::Mask;
use glam::Vec3;

/// Shapes, as folders name them.
pub const SHAPES: [&str; 10] =
    ["BALL", "GOLF", "SPIKE", "NUT", "SQUARE", "PENTAGON", "HEXAGON", "PROPELLER", "TURBINE", "BUNNY"];

/// Materials, as folders name them.
pub const MATERIALS: [&str; 10] =
    ["POM", "PP", "NYLON", "PVC", "ABS", "BAKELITE", "Al", "Cu", "STEEL", "ACRYLIC"];

/// Shape and material of an object name such as "BALL_POM"; `None` for another name.
#[must_use]
pub fn shape_and_material(name: &str) -> Option<(&'static str, &'static str)> {
    let (shape, material) = name.split_once('_')?;
    let find =
        |list: &[&'static str], wanted: &str| list.iter().copied().find(|k| k.eq_ignore_ascii_case(wanted));
    Some((find(&SHAPES, shape)?, find(&MATERIALS, material)?))
}

/// The MAT file to upload for one object: `Normal_est`, H×W×3, zero outside the mask. `normals` are those
/// of the mask pixels, unit length.
#[must_use]
pub fn submission(mask: &Mask, normals: &[Vec3]) -> Vec<u8> {
    normals_mat("Normal_est", mask, normals)
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::dataset::mat::read_array;

    #[test]
    fn names_of_the_hundred_objects_are_known() {
        assert_eq!(shape_and_material("PROPELLER_Al"), Some(("PROPELLER", "Al")));
        assert_eq!(shape_and_material("bunny_acrylic"), Some(("BUNNY", "ACRYLIC")));
        for name in ["ball", "BALL_GOLD", "CUBE_POM", "BALL_POM_2", ""] {
            assert_eq!(shape_and_material(name), None);
        }
    }

    #[test]
    fn a_submission_holds_the_normals_where_the_mask_is() {
        let mask = Mask::new(3, 2, &[false, true, false, false, false, true]).unwrap();
        let bytes = submission(&mask, &[Vec3::X, Vec3::new(0.0, 0.6, 0.8)]);
        let array = read_array(&bytes, "Normal_est", 18).unwrap();
        assert_eq!(array.dims, [2, 3, 3]);
        let at = |y: usize, x: usize, c: usize| array.values[y + 2 * x + 6 * c];
        assert_eq!((at(0, 1, 0), at(1, 2, 1), at(1, 2, 2)), (1.0, f64::from(0.6f32), f64::from(0.8f32)));
        assert_eq!(array.values.iter().filter(|v| **v != 0.0).count(), 3);
    }
}
