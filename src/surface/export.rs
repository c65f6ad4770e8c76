//! The surface as a mesh file: PLY, Wavefront OBJ, binary glTF.

use crate::stack::Mask;
use glam::Vec3;
use std::fmt::Write as _;

/// A triangle mesh over the mask: one vertex a pixel, x right, y up, z towards the camera, in pixels.
#[derive(Clone, Debug, PartialEq)]
pub struct Surface {
    /// Where the vertices are.
    pub positions: Vec<Vec3>,
    /// Unit normals of the vertices.
    pub normals: Vec<Vec3>,
    /// Grey of the vertices in 0..=1; empty where unknown.
    pub grey: Vec<f32>,
    /// Vertices of each triangle, counterclockwise seen from the camera.
    pub triangles: Vec<[u32; 3]>,
}

/// A file format.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum Format {
    /// Stanford PLY, binary little-endian.
    Ply,
    /// Wavefront OBJ.
    Obj,
    /// glTF 2.0, binary.
    Glb,
}

/// Why a format can't be read.
#[derive(Debug, thiserror::Error, PartialEq)]
#[error("mesh format '{0}': choose ply, obj or glb")]
pub struct FormatError(String);

impl std::str::FromStr for Format {
    type Err = FormatError;

    fn from_str(s: &str) -> Result<Self, FormatError> {
        match s {
            "ply" => Ok(Self::Ply),
            "obj" => Ok(Self::Obj),
            "glb" => Ok(Self::Glb),
            _ => Err(FormatError(s.into())),
        }
    }
}

impl Format {
    /// Ending of the file's name.
    #[must_use]
    pub fn extension(self) -> &'static str {
        match self {
            Self::Ply => "ply",
            Self::Obj => "obj",
            Self::Glb => "glb",
        }
    }
}

impl Surface {
    /// The surface over `mask`, centred on its bounds. Squares of four pixels whose heights differ by more than
    /// `cliff` (pixels) are left open: the surface breaks there. All lists have one entry a mask pixel; `grey` may be empty.
    ///
    /// # Panics
    /// Where `heights` or `normals` have another length than the mask.
    #[must_use]
    pub fn new(mask: &Mask, heights: &[f32], normals: &[Vec3], grey: &[f32], cliff: f32) -> Self {
        assert!(heights.len() == mask.len() && normals.len() == mask.len(), "one entry a mask pixel");
        let (left, top, width, height) = mask.bounds();
        let (cx, cy) = (left as f32 + (width - 1) as f32 / 2.0, top as f32 + (height - 1) as f32 / 2.0);
        let positions = (0..mask.len())
            .map(|p| {
                let (x, y) = mask.position(p);
                Vec3::new(x as f32 - cx, cy - y as f32, heights[p])
            })
            .collect();
        let numbers: Vec<u32> = (0..mask.len() as u32).collect();
        let number = mask.scatter(&numbers, u32::MAX);
        let columns = mask.width() as usize;
        let mut triangles = Vec::with_capacity(2 * mask.len());
        for (&i, &a) in mask.indices().iter().zip(&numbers) {
            let i = i as usize;
            if (i + 1).is_multiple_of(columns) || i + columns >= number.len() {
                continue;
            }
            // a b      Corners outside the mask leave a triangle or nothing.
            // c d
            let (b, c, d) = (number[i + 1], number[i + columns], number[i + columns + 1]);
            for triangle in [[a, c, b], [b, c, d]] {
                let inside = triangle.iter().all(|&v| v != u32::MAX);
                if inside && !is_cliff(triangle, heights, cliff) {
                    triangles.push(triangle);
                }
            }
        }
        let top = grey.iter().copied().fold(1e-20, f32::max);
        let grey = if grey.len() == mask.len() { grey.iter().map(|g| g / top).collect() } else { Vec::new() };
        Self { positions, normals: normals.to_vec(), grey, triangles }
    }

    /// The file in a format.
    #[must_use]
    pub fn write(&self, format: Format) -> Vec<u8> {
        match format {
            Format::Ply => self.ply(),
            Format::Obj => self.obj().into_bytes(),
            Format::Glb => self.glb(),
        }
    }

    fn bytes_of_grey(&self) -> impl Iterator<Item = u8> + '_ {
        // Viewers take vertex colours of files for sRGB; a plain 2.2 is near enough for a preview.
        self.grey.iter().map(|&g| (255.0 * libm::powf(g.clamp(0.0, 1.0), 1.0 / 2.2) + 0.5) as u8)
    }

    fn ply(&self) -> Vec<u8> {
        let mut header = format!(
            "ply\nformat binary_little_endian 1.0\ncomment coil-ps, units: pixels\nelement vertex {}\n",
            self.positions.len()
        );
        for name in ["x", "y", "z", "nx", "ny", "nz"] {
            let _ = writeln!(header, "property float {name}");
        }
        if !self.grey.is_empty() {
            header += "property uchar red\nproperty uchar green\nproperty uchar blue\n";
        }
        let _ = write!(
            header,
            "element face {}\nproperty list uchar int vertex_indices\nend_header\n",
            self.triangles.len()
        );
        let mut out = header.into_bytes();
        let mut grey = self.bytes_of_grey();
        for (p, n) in self.positions.iter().zip(&self.normals) {
            for v in [p.x, p.y, p.z, n.x, n.y, n.z] {
                out.extend(v.to_le_bytes());
            }
            if let Some(g) = grey.next() {
                out.extend([g; 3]);
            }
        }
        for t in &self.triangles {
            out.push(3);
            t.iter().for_each(|v| out.extend(v.to_le_bytes()));
        }
        out
    }

    fn obj(&self) -> String {
        let mut out = String::from("# coil-ps, units: pixels\n");
        for p in &self.positions {
            let _ = writeln!(out, "v {} {} {}", p.x, p.y, p.z);
        }
        for n in &self.normals {
            let _ = writeln!(out, "vn {} {} {}", n.x, n.y, n.z);
        }
        for t in &self.triangles {
            let [a, b, c] = t.map(|v| v + 1);
            let _ = writeln!(out, "f {a}//{a} {b}//{b} {c}//{c}");
        }
        out
    }

    /// One buffer: positions, normals, colours where there are any, indices. Without triangles its vertices are points.
    fn glb(&self) -> Vec<u8> {
        let mut binary: Vec<u8> = Vec::new();
        let mut views = Vec::new();
        let mut view = |binary: &mut Vec<u8>, bytes: &[u8], target: u32| {
            views.push(serde_json::json!({
                "buffer": 0, "byteOffset": binary.len(), "byteLength": bytes.len(), "target": target
            }));
            binary.extend(bytes);
            binary.resize(binary.len().next_multiple_of(4), 0);
        };
        const VERTICES: u32 = 34962;
        const INDICES: u32 = 34963;
        const POINTS: u32 = 0;
        let floats = |v: &[Vec3]| -> Vec<u8> {
            v.iter().flat_map(|p| p.to_array()).flat_map(f32::to_le_bytes).collect()
        };
        view(&mut binary, &floats(&self.positions), VERTICES);
        view(&mut binary, &floats(&self.normals), VERTICES);
        if !self.grey.is_empty() {
            let colours: Vec<u8> =
                self.grey.iter().flat_map(|g| [*g, *g, *g]).flat_map(f32::to_le_bytes).collect();
            view(&mut binary, &colours, VERTICES);
        }
        if !self.triangles.is_empty() {
            let indices: Vec<u8> = self.triangles.iter().flatten().flat_map(|v| v.to_le_bytes()).collect();
            view(&mut binary, &indices, INDICES);
        }
        let (low, high) = self
            .positions
            .iter()
            .fold((Vec3::splat(f32::MAX), Vec3::splat(f32::MIN)), |(l, h), &p| (l.min(p), h.max(p)));
        let vectors = |view: usize| {
            serde_json::json!({
                "bufferView": view, "componentType": 5126, "count": self.positions.len(), "type": "VEC3"
            })
        };
        let mut accessors = vec![vectors(0), vectors(1)];
        accessors[0]["min"] = serde_json::json!(low.to_array());
        accessors[0]["max"] = serde_json::json!(high.to_array());
        let mut attributes = serde_json::json!({"POSITION": 0, "NORMAL": 1});
        if !self.grey.is_empty() {
            attributes["COLOR_0"] = serde_json::json!(accessors.len());
            accessors.push(vectors(accessors.len()));
        }
        let mut primitive = serde_json::json!({"attributes": attributes, "material": 0});
        if self.triangles.is_empty() {
            primitive["mode"] = serde_json::json!(POINTS); // glTF has no empty views and accessors
        } else {
            let last = accessors.len();
            primitive["indices"] = serde_json::json!(last);
            accessors.push(serde_json::json!({
                "bufferView": last, "componentType": 5125, "count": 3 * self.triangles.len(), "type": "SCALAR"
            }));
        }
        let document = serde_json::json!({
            "asset": {"version": "2.0", "generator": "coil-ps"},
            "scene": 0,
            "scenes": [{"nodes": [0]}],
            "nodes": [{"mesh": 0}],
            "meshes": [{"primitives": [primitive]}],
            "materials": [{
                "doubleSided": true,
                "pbrMetallicRoughness": {"metallicFactor": 0.0, "roughnessFactor": 0.9}
            }],
            "buffers": [{"byteLength": binary.len()}],
            "bufferViews": views,
            "accessors": accessors,
        });
        let mut json = document.to_string().into_bytes();
        json.resize(json.len().next_multiple_of(4), b' ');
        let mut out = b"glTF".to_vec();
        out.extend(2u32.to_le_bytes());
        out.extend((12 + 8 + json.len() as u32 + 8 + binary.len() as u32).to_le_bytes());
        for (kind, chunk) in [(b"JSON", &json), (b"BIN\0", &binary)] {
            out.extend((chunk.len() as u32).to_le_bytes());
            out.extend(kind);
            out.extend(chunk);
        }
        out
    }
}

fn is_cliff(triangle: [u32; 3], heights: &[f32], cliff: f32) -> bool {
    let [a, b, c] = triangle.map(|v| heights[v as usize]);
    a.max(b).max(c) - a.min(b).min(c) > cliff
}

#[cfg(test)]
mod tests {
    use super::*;

    fn square() -> Surface {
        let mask = Mask::full(3, 2).unwrap();
        let heights = [0.0, 0.5, 40.0, 0.0, 0.0, 40.0];
        Surface::new(&mask, &heights, &[Vec3::Z; 6], &[0.2, 0.4, 0.4, 0.1, 0.1, 0.1], 10.0)
    }

    #[test]
    fn triangles_face_the_camera_and_stop_at_cliffs() {
        let s = square();
        assert_eq!(s.triangles.len(), 2); // the left square alone
        for t in &s.triangles {
            let [a, b, c] = t.map(|v| s.positions[v as usize]);
            assert!((b - a).cross(c - a).z > 0.0);
        }
        assert_eq!(s.positions[0], Vec3::new(-1.0, 0.5, 0.0));
    }

    #[test]
    fn obj_is_counted_from_one() {
        let text = String::from_utf8(square().write(Format::Obj)).unwrap();
        assert_eq!(text.lines().filter(|l| l.starts_with("v ")).count(), 6);
        assert!(text.contains("f 1//1 4//4 2//2"));
    }

    #[test]
    fn ply_has_the_bytes_its_header_claims() {
        let bytes = square().write(Format::Ply);
        let end = bytes.windows(11).position(|w| w == b"end_header\n").unwrap() + 11;
        assert_eq!(bytes.len() - end, 6 * (24 + 3) + 2 * 13);
    }

    /// The JSON of a .glb whose chunks fit together.
    fn document(bytes: &[u8]) -> serde_json::Value {
        let word = |at: usize| u32::from_le_bytes(bytes[at..at + 4].try_into().unwrap()) as usize;
        assert_eq!((&bytes[..4], word(4), word(8)), (&b"glTF"[..], 2, bytes.len()));
        let json = word(12);
        let document: serde_json::Value = serde_json::from_slice(&bytes[20..20 + json]).unwrap();
        let binary = word(20 + json);
        assert_eq!(document["buffers"][0]["byteLength"], binary);
        assert_eq!(20 + json + 8 + binary, bytes.len());
        document
    }

    #[test]
    fn glb_chunks_fit_together() {
        let document = document(&square().write(Format::Glb));
        assert_eq!(document["meshes"][0]["primitives"][0]["indices"], 3);
        assert_eq!(document["accessors"][3]["count"], 6);
        assert_eq!(document["accessors"][0]["max"][2], 40.0);
    }

    #[test]
    fn glb_without_triangles_is_points() {
        for (mask, grey) in [(Mask::full(1, 1), &[0.5][..]), (Mask::full(4, 1), &[])] {
            let mask = mask.unwrap();
            let (heights, normals) = (vec![0.0; mask.len()], vec![Vec3::Z; mask.len()]);
            let bytes = Surface::new(&mask, &heights, &normals, grey, 10.0).write(Format::Glb);
            let document = document(&bytes);
            let primitive = &document["meshes"][0]["primitives"][0];
            assert!(primitive["mode"] == 0 && primitive["indices"].is_null(), "{primitive}");
            let all = |list: &str, key: &str| document[list].as_array().unwrap().iter().all(|v| v[key] != 0);
            assert!(all("bufferViews", "byteLength") && all("accessors", "count"));
        }
    }
}
