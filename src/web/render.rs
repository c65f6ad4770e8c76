//! Objects that need no file: sculptures and meshes, rendered light by light.

use super::fail;
use super::object::CapturedObject;
use crate::render::{self, Abc, Material, Mesh, Options, Pose, Scene, Shape, sculpture::FAMILIES};
use wasm_bindgen::prelude::*;

/// Photos of a rendered object under a stage of lights, taken one by one.
#[wasm_bindgen]
pub struct Capture(render::Capture);

#[wasm_bindgen]
impl Capture {
    /// Of a sculpture (`sphere`, `blob:7`, … see `families`) made of `material` (see `materials`), `size` pixels wide.
    pub fn sculpture(name: &str, material: &str, size: u32) -> Result<Capture, JsError> {
        let shape = render::named(name).map_err(fail)?;
        capture(name, &shape, material, size)
    }

    /// Of a mesh (the bytes of an OBJ, PLY or STL file; `file` is its name).
    pub fn mesh(file: &str, bytes: &[u8], material: &str, size: u32) -> Result<Capture, JsError> {
        let shape = Shape::Mesh(Mesh::from_bytes(file, bytes).map_err(fail)?);
        capture(file, &shape, material, size)
    }

    /// Number of lights.
    #[wasm_bindgen(getter)]
    #[must_use]
    pub fn total(&self) -> usize {
        self.0.total()
    }

    /// Number of photos taken.
    #[wasm_bindgen(getter)]
    #[must_use]
    pub fn done(&self) -> usize {
        self.0.done()
    }

    /// Takes the next photo; nothing when all are taken.
    #[wasm_bindgen(js_name = takeNext)]
    pub fn take_next(&mut self) {
        self.0.take_next();
    }

    /// The object, as 16-bit photos; those still missing are taken first.
    #[must_use]
    pub fn finish(self) -> CapturedObject {
        CapturedObject(self.0.finish())
    }
}

fn capture(name: &str, shape: &Shape, material: &str, size: u32) -> Result<Capture, JsError> {
    let material: Material = material.parse().map_err(fail)?;
    let pose = Pose::fit(shape, shape.front()).map_err(fail)?;
    let options = Options { size, ..Options::default() };
    let scene = Scene::new(name, shape, &pose, &material.into(), &options).map_err(fail)?;
    Ok(Capture(render::Capture::stage(scene)))
}

/// Families of sculptures, each with a line for people, as `NAME: LINE`.
#[wasm_bindgen]
#[must_use]
pub fn families() -> Vec<String> {
    FAMILIES.iter().map(|(name, line)| format!("{name}: {line}")).collect()
}

/// Names of the measured materials.
#[wasm_bindgen]
#[must_use]
pub fn materials() -> Vec<String> {
    Abc::all().iter().map(|m| m.name.to_string()).collect()
}
