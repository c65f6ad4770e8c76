//! What the camera sees of a shape: for each pixel the position and the exact normal.
//!
//! The frame spans −1..1 in x and y at the pixels' outer borders; z has the same unit, towards the camera.

use super::mesh::Mesh;
use super::real::V3;
use super::sculpture::{Sculpture, Upright, any_rotation};
use super::{MAX_SIZE, RenderError};
use crate::rng::Rng;
use crate::stack::Mask;
use glam::{DVec3, Mat3, Vec2, Vec3};

/// Share of the frame that a fitted object fills along its longer side.
pub const FILL: f32 = 0.94;

/// A shape to be rendered.
#[derive(Clone, Debug)]
pub enum Shape {
    /// A triangle mesh.
    Mesh(Mesh),
    /// A procedural sculpture.
    Sculpture(Sculpture),
}

/// Where a shape stands: `frame = scale · rotation · object + translation`.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Pose {
    /// A proper rotation.
    pub rotation: Mat3,
    /// Frame units (half the image) an object unit; positive.
    pub scale: f32,
    /// Where the object's origin stands in the frame.
    pub translation: Vec3,
}

/// A pose as written in a file: `rotation` as three rows; without `scale` and `translation` the object is fitted
/// to the frame. `frame = scale · rotation · (object − origin) + translation`.
#[derive(Clone, Debug, serde::Serialize, serde::Deserialize)]
#[serde(deny_unknown_fields)]
pub struct PoseFile {
    /// Rows of the rotation matrix.
    pub rotation: [[f32; 3]; 3],
    /// Frame units (half the image) an object unit.
    #[serde(default, skip_serializing_if = "Option::is_none")]
    pub scale: Option<f32>,
    /// Where the object's origin stands in the frame.
    #[serde(default, skip_serializing_if = "Option::is_none")]
    pub translation: Option<[f32; 3]>,
    /// The point that counts as the object's origin, in the mesh file's coordinates; without it their own. Written for a
    /// mesh far from that, see [`Mesh::origin`].
    #[serde(default, skip_serializing_if = "Option::is_none")]
    pub origin: Option<[f64; 3]>,
}

impl Pose {
    /// The rotated object centred in the frame and scaled to [`FILL`] it.
    ///
    /// # Errors
    /// [`RenderError::Pose`] if `rotation` is not a rotation; [`RenderError::Invisible`] if nothing is seen.
    pub fn fit(shape: &Shape, rotation: Mat3) -> Result<Self, RenderError> {
        let loose = Self { rotation, scale: 1.0, translation: Vec3::ZERO }.checked()?;
        let (low, high) = match shape {
            Shape::Mesh(mesh) => mesh
                .positions
                .iter()
                .map(|&p| rotation * p)
                .fold((Vec3::MAX, Vec3::MIN), |(low, high), p| (low.min(p), high.max(p))),
            Shape::Sculpture(sculpture) => {
                // Seen once, small, to learn its extent to a pixel.
                let coarse = Self { scale: 1.0 / REACH, ..loose };
                let seen = trace(sculpture, &coarse, 96)?;
                let pixel = 1.0 / 96.0;
                let (low, high) = seen
                    .positions
                    .iter()
                    .fold((Vec3::MAX, Vec3::MIN), |(low, high), &p| (low.min(p), high.max(p)));
                let border = Vec3::new(pixel, pixel, 0.0);
                ((low - border) * REACH, (high + border) * REACH)
            }
        };
        let side = (high - low).truncate().max_element().max(1e-30);
        let scale = 2.0 * FILL / side;
        Self { rotation, scale, translation: -0.5 * scale * (low + high) }.checked()
    }

    /// The pose itself, if it is one.
    ///
    /// # Errors
    /// [`RenderError::Pose`].
    pub fn checked(self) -> Result<Self, RenderError> {
        let r = self.rotation;
        let off = r * r.transpose() - Mat3::IDENTITY;
        let orthonormal = off.to_cols_array().iter().all(|v| v.abs() < 1e-3) && r.determinant() > 0.0;
        let placed = self.scale.is_finite() && self.scale > 0.0 && self.translation.is_finite();
        if orthonormal && placed { Ok(self) } else { Err(RenderError::Pose) }
    }

    /// A pose from its JSON text, for this shape.
    ///
    /// # Errors
    /// [`RenderError::PoseFile`] for text that can't be read, [`RenderError::Pose`] for a matrix that is no rotation.
    pub fn from_json(shape: &Shape, json: &str) -> Result<Self, RenderError> {
        let file: PoseFile = serde_json::from_str(json).map_err(|e| RenderError::PoseFile(e.to_string()))?;
        let rotation = Mat3::from_cols_array_2d(&file.rotation).transpose();
        let posed = match (file.scale, file.translation) {
            (Some(scale), t) => Self { rotation, scale, translation: t.map_or(Vec3::ZERO, Vec3::from) },
            (None, None) => return Self::fit(shape, rotation),
            (None, Some(t)) => Self { translation: t.into(), ..Self::fit(shape, rotation)? },
        };
        // From the file's origin to the mesh's, which is the same in nearly every case.
        let moved = (shape.origin() - file.origin.map_or(DVec3::ZERO, DVec3::from)).as_vec3();
        let translation = match moved {
            Vec3::ZERO => posed.translation,
            moved => posed.to_frame(moved),
        };
        Self { translation, ..posed }.checked()
    }

    /// The JSON text of this pose of `shape`.
    #[must_use]
    pub fn to_json(&self, shape: &Shape) -> String {
        let file = PoseFile {
            rotation: self.rotation.transpose().to_cols_array_2d(),
            scale: Some(self.scale),
            translation: Some(self.translation.to_array()),
            origin: Some(shape.origin().to_array()).filter(|o| *o != [0.0; 3]),
        };
        serde_json::to_string_pretty(&file).unwrap_or_default()
    }

    /// The object point at a point of the frame.
    #[must_use]
    pub fn to_object(&self, p: Vec3) -> Vec3 {
        self.rotation.transpose() * (p - self.translation) / self.scale
    }

    /// The frame point of an object point.
    #[must_use]
    pub fn to_frame(&self, p: Vec3) -> Vec3 {
        self.scale * (self.rotation * p) + self.translation
    }
}

fn tilt(x: f32, y: f32, z: f32) -> Mat3 {
    Mat3::from_rotation_z_libm(z) * Mat3::from_rotation_x_libm(x) * Mat3::from_rotation_y_libm(y)
}

/// Rotations by `libm`, because glam's use the platform's sine.
trait Libm {
    fn from_rotation_x_libm(angle: f32) -> Self;
    fn from_rotation_y_libm(angle: f32) -> Self;
    fn from_rotation_z_libm(angle: f32) -> Self;
}

impl Libm for Mat3 {
    fn from_rotation_x_libm(angle: f32) -> Self {
        let (s, c) = libm::sincosf(angle);
        Self::from_cols(Vec3::X, Vec3::new(0.0, c, s), Vec3::new(0.0, -s, c))
    }
    fn from_rotation_y_libm(angle: f32) -> Self {
        let (s, c) = libm::sincosf(angle);
        Self::from_cols(Vec3::new(c, 0.0, -s), Vec3::Y, Vec3::new(s, 0.0, c))
    }
    fn from_rotation_z_libm(angle: f32) -> Self {
        let (s, c) = libm::sincosf(angle);
        Self::from_cols(Vec3::new(c, s, 0.0), Vec3::new(-s, c, 0.0), Vec3::Z)
    }
}

impl Shape {
    /// Where its origin lies in the coordinates of its file.
    fn origin(&self) -> DVec3 {
        match self {
            Self::Mesh(mesh) => mesh.origin,
            Self::Sculpture(_) => DVec3::ZERO,
        }
    }

    /// The rotation in which a shape shows itself best: vessels are tilted towards the viewer.
    #[must_use]
    pub fn front(&self) -> Mat3 {
        match self {
            Self::Sculpture(s) if s.upright() == Upright::Open => tilt(0.75, 0.0, 0.0),
            Self::Sculpture(s) if s.upright() == Upright::Standing => tilt(0.15, 0.4, 0.0),
            _ => Mat3::IDENTITY,
        }
    }

    /// A random rotation: any for meshes and free forms; sculptures with a front or an up keep it in view.
    #[must_use]
    pub fn random_rotation(&self, rng: &mut Rng) -> Mat3 {
        let upright = match self {
            Self::Mesh(_) => Upright::Any,
            Self::Sculpture(s) => s.upright(),
        };
        let turn = rng.range(-std::f32::consts::PI, std::f32::consts::PI);
        match upright {
            Upright::Any => any_rotation(rng),
            Upright::Standing => tilt(rng.range(-0.4, 0.6), turn, rng.range(-0.4, 0.4)),
            Upright::Open => tilt(rng.range(0.4, 1.2), turn, rng.range(-0.5, 0.5)),
            Upright::Front => tilt(rng.range(-0.5, 0.5), rng.range(-0.5, 0.5), turn),
        }
    }
}

/// The visible surface, one entry a mask pixel.
#[derive(Clone, Debug)]
pub struct View {
    /// Pixels that show the object.
    pub mask: Mask,
    /// Point of the surface at the pixel's centre, in frame units.
    pub positions: Vec<Vec3>,
    /// Unit normal there; its z is positive.
    pub normals: Vec<Vec3>,
}

/// Centre of a pixel in frame units.
#[must_use]
pub fn pixel_center(x: u32, y: u32, size: u32) -> Vec2 {
    let s = 2.0 / size as f32;
    Vec2::new((x as f32 + 0.5) * s - 1.0, 1.0 - (y as f32 + 0.5) * s)
}

impl View {
    /// The view of `shape` at `pose` in an image of `size × size` pixels.
    ///
    /// Normals: of a sculpture the exact gradient; of a mesh the corner normals interpolated, on the visible side. Where
    /// an interpolated normal turns away from the camera it is bent back to a right angle (z = 0.01).
    ///
    /// # Errors
    /// [`RenderError::Size`] for 0 or more than [`MAX_SIZE`] pixels, [`RenderError::Invisible`] if no pixel is covered.
    pub fn new(shape: &Shape, pose: &Pose, size: u32) -> Result<Self, RenderError> {
        if size == 0 || size > MAX_SIZE {
            return Err(RenderError::Size(size));
        }
        match shape {
            Shape::Mesh(mesh) => rasterise(mesh, pose, size),
            Shape::Sculpture(sculpture) => trace(sculpture, pose, size),
        }
    }

    fn from_pixels(size: u32, pixels: &[Option<(f32, Vec3)>]) -> Result<Self, RenderError> {
        let inside: Vec<bool> = pixels.iter().map(Option::is_some).collect();
        let mask = Mask::new(size, size, &inside).map_err(|_| RenderError::Invisible)?;
        let (positions, normals) = mask
            .indices()
            .iter()
            .filter_map(|&i| {
                let (z, normal) = pixels[i as usize]?;
                Some((pixel_center(i % size, i / size, size).extend(z), normal))
            })
            .unzip();
        Ok(Self { mask, positions, normals })
    }
}

/// A normal that faces the camera.
fn facing(normal: Vec3) -> Vec3 {
    if normal.z >= 0.01 { normal } else { normal.with_z(0.01).normalize_or(Vec3::Z) }
}

/// Sculptures lie within this distance of their origin.
const REACH: f32 = 1.4;

/// Sphere tracing along −z, then bisection.
fn trace(sculpture: &Sculpture, pose: &Pose, size: u32) -> Result<View, RenderError> {
    let to_object = pose.rotation.transpose();
    let down = -to_object.z_axis;
    // No feature thinner than a tenth of a pixel is looked for.
    let smallest = 0.2 / (size as f32 * pose.scale);
    let pixels: Vec<_> = (0..size * size)
        .map(|i| {
            let c = pixel_center(i % size, i / size, size) - pose.translation.truncate();
            let start = to_object * (c.extend(0.0) / pose.scale);
            let depth = (REACH * REACH - start.length_squared()).max(0.0).sqrt();
            let at = |t: f32| sculpture.at(V3::<f32>::of(start + down * t));
            let (mut before, mut t) = (-depth, -depth);
            while t < depth {
                let f = at(t);
                if f <= 0.0 {
                    let (mut out, mut inside) = (before, t);
                    for _ in 0..18 {
                        let middle = 0.5 * (out + inside);
                        if at(middle) > 0.0 { out = middle } else { inside = middle }
                    }
                    let normal = pose.rotation * sculpture.normal(start + down * inside);
                    return Some((pose.translation.z - inside * pose.scale, facing(normal)));
                }
                before = t;
                t += (f * sculpture.step()).max(smallest);
            }
            None
        })
        .collect();
    View::from_pixels(size, &pixels)
}

/// Z-buffer over all triangles, sampled at pixel centres.
fn rasterise(mesh: &Mesh, pose: &Pose, size: u32) -> Result<View, RenderError> {
    let s = f64::from(size);
    let points: Vec<glam::DVec3> = mesh
        .positions
        .iter()
        .map(|&p| {
            let q = pose.to_frame(p).as_dvec3();
            glam::DVec3::new((q.x + 1.0) * 0.5 * s - 0.5, (1.0 - q.y) * 0.5 * s - 0.5, q.z)
        })
        .collect();
    let mut nearest: Vec<Option<(f32, u32, [f32; 2])>> = vec![None; size as usize * size as usize];
    for (t, triangle) in mesh.triangles.iter().enumerate() {
        let [a, b, c] = triangle.map(|v| points[v as usize]);
        let area = (b - a).truncate().perp_dot((c - a).truncate());
        if area == 0.0 {
            continue;
        }
        let low = a.min(b).min(c).max(glam::DVec3::ZERO.with_z(f64::MIN));
        let high = a.max(b).max(c);
        let limit = |v: f64| v.floor().min(s - 1.0);
        for y in low.y.ceil() as i64..=limit(high.y) as i64 {
            for x in low.x.ceil() as i64..=limit(high.x) as i64 {
                let p = glam::DVec2::new(x as f64, y as f64);
                let v = (p - a.truncate()).perp_dot((c - a).truncate()) / area;
                let w = (b - a).truncate().perp_dot(p - a.truncate()) / area;
                if v >= -1e-9 && w >= -1e-9 && v + w <= 1.0 + 1e-9 {
                    let z = (a.z + v * (b.z - a.z) + w * (c.z - a.z)) as f32;
                    let slot = &mut nearest[y as usize * size as usize + x as usize];
                    if slot.is_none_or(|(front, ..)| z > front) {
                        *slot = Some((z, t as u32, [v as f32, w as f32]));
                    }
                }
            }
        }
    }
    let pixels: Vec<_> = nearest
        .iter()
        .map(|hit| {
            hit.map(|(z, t, [v, w])| {
                let corners = mesh.triangles[t as usize].map(|v| mesh.positions[v as usize]);
                let flat = pose.rotation * (corners[1] - corners[0]).cross(corners[2] - corners[0]);
                let [a, b, c] = mesh.normals[t as usize];
                let mixed = pose.rotation * (a * (1.0 - v - w) + b * v + c * w);
                // Which side the normal belongs to: corner normals follow the winding, which may be the wrong way round.
                let side = if flat.z < 0.0 { -1.0 } else { 1.0 };
                let agrees = if mixed.dot(flat) < 0.0 { -1.0 } else { 1.0 };
                (z, facing((mixed * (side * agrees)).normalize_or(flat.normalize_or(Vec3::Z) * side)))
            })
        })
        .collect();
    View::from_pixels(size, &pixels)
}

#[cfg(test)]
mod tests {
    use super::*;

    fn sphere() -> Shape {
        Shape::Sculpture(Sculpture::named("sphere").unwrap())
    }

    #[test]
    fn a_sphere_is_a_sphere() {
        let shape = sphere();
        let pose = Pose::fit(&shape, Mat3::IDENTITY).unwrap();
        assert!((pose.scale - FILL).abs() < 0.02, "{pose:?}");
        let view = View::new(&shape, &pose, 64).unwrap();
        for (p, n) in view.positions.iter().zip(&view.normals) {
            let exact = pose.to_object(*p);
            assert!((exact.length() - 1.0).abs() < 1e-4 && (exact - *n).length() < 2e-2, "{exact} {n}");
        }
        let area = view.mask.len() as f32 * 4.0 / 4096.0;
        assert!((area - std::f32::consts::PI * pose.scale * pose.scale).abs() < 0.02);
    }

    #[test]
    fn a_mesh_is_seen_from_either_winding() {
        let corners = [[-1., -1.], [1., -1.], [1., 1.], [-1., 1.]].map(|[x, y]| Vec3::new(x, y, 0.2 * x));
        for winding in [[[0, 1, 2], [0, 2, 3]], [[2, 1, 0], [0, 2, 3]]] {
            let shape = Shape::Mesh(Mesh::new(corners.to_vec(), &winding).unwrap());
            let pose = Pose::fit(&shape, Mat3::IDENTITY).unwrap();
            let view = View::new(&shape, &pose, 32).unwrap();
            let normal = Vec3::new(-0.2, 0.0, 1.0).normalize();
            assert!(view.normals.iter().all(|n| (*n - normal).length() < 1e-5));
            // Watertight along the diagonal, and 94 % of 32 pixels wide.
            assert_eq!(view.mask.len(), 30 * 30);
        }
    }

    #[test]
    fn bad_views_are_named() {
        let shape = sphere();
        let pose = Pose::fit(&shape, Mat3::IDENTITY).unwrap();
        assert!(matches!(View::new(&shape, &pose, 0), Err(RenderError::Size(0))));
        let away = Pose { translation: Vec3::X * 9.0, ..pose };
        assert!(matches!(View::new(&shape, &away, 16), Err(RenderError::Invisible)));
        assert!(matches!(
            Pose::fit(&shape, Mat3::from_diagonal(Vec3::new(1.0, 1.0, 2.0))),
            Err(RenderError::Pose)
        ));
        assert!(Pose::from_json(&shape, "{}").is_err());
        assert_eq!(Pose::from_json(&shape, &pose.to_json(&shape)).unwrap(), pose);
        assert!(!pose.to_json(&shape).contains("origin"));
    }

    #[test]
    fn a_mesh_far_from_its_origin_has_a_pose_too() {
        let roof = |at: f64| {
            let corner = |x: f64, y: f64, z: f64| format!("v {} {} {z}\n", x + at, y + 2.0 * at);
            let corners =
                [corner(-1., -1., 0.), corner(1., -1., 0.), corner(1., 1., 1.), corner(-1., 1., 1.)];
            let text = corners.concat() + "v 9e9 0 nan\nf 1 2 3 4\n";
            Shape::Mesh(Mesh::from_bytes("roof.obj", text.as_bytes()).unwrap())
        };
        let (near, far) = (roof(0.0), roof(5e6));
        let pose = |shape: &Shape| Pose::fit(shape, tilt(0.3, 0.2, 0.1)).unwrap();
        let view = |shape: &Shape, pose: &Pose| View::new(shape, pose, 24).unwrap();
        assert_eq!(view(&near, &pose(&near)).mask, view(&far, &pose(&far)).mask);
        let json = pose(&far).to_json(&far);
        assert!(json.contains("origin"), "{json}");
        assert_eq!(Pose::from_json(&far, &json).unwrap(), pose(&far));
        // The same pose about another origin.
        let moved = json.replace("5000000.0,", "5000001.0,");
        let [a, b] = [&json, &moved].map(|json| Pose::from_json(&far, json).unwrap());
        assert_ne!(json, moved);
        assert!((a.translation - b.to_frame(Vec3::X)).length() < 1e-5, "{a:?} {b:?}");
    }
}
