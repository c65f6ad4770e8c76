//! Triangle meshes from bytes: OBJ, PLY (ascii and binary) and STL (ascii and binary).
//!
//! Any triangle soup is accepted: open, non-manifold, mixed winding. Faces with more corners are cut into triangles in
//! their plane. Vertices that no face uses are left out. Normals are those of the file where it has
//! them, else each corner averages the faces around its vertex that meet at less than [`CREASE`], so that
//! smooth areas are smooth and edges stay sharp.

use earcut::Earcut;
use earcut::utils3d::project3d_to_2d;
use glam::{DVec3, Vec3};
use std::collections::HashMap;

/// Faces meeting at a larger angle than this keep an edge between them (cosine of 40°).
pub const CREASE: f32 = 0.766_044_4;

/// Meshes with more triangles are refused.
pub const MAX_TRIANGLES: usize = 20_000_000;

/// A mesh whose centre is farther from the origin than so many times its extent is moved there: as f32 its coordinates
/// (of a survey, say) would be steps.
const FAR: f64 = 16.0;

/// Why a mesh can't be read.
#[derive(Debug, thiserror::Error, PartialEq)]
pub enum MeshError {
    /// The file name ends in something else.
    #[error("'{0}': meshes end in .obj, .ply or .stl")]
    Format(String),
    /// No triangle with an area.
    #[error("the mesh is empty: {vertices} vertices, {faces} faces, none of them with an area")]
    Empty {
        /// Vertices read.
        vertices: usize,
        /// Faces read.
        faces: usize,
    },
    /// Too large.
    #[error("the mesh has {0} triangles or vertices; the limit is {MAX_TRIANGLES}")]
    Huge(usize),
    /// A coordinate is NaN, infinite or too large to square.
    #[error("vertex {index}: coordinate {value} is not a number below 1e15")]
    NotFinite {
        /// Which vertex, from 1.
        index: usize,
        /// Its coordinate.
        value: f64,
    },
    /// A face names a vertex that is not there.
    #[error("face {face}: vertex {index} does not exist, the mesh has {vertices}")]
    Index {
        /// Which face, from 1.
        face: usize,
        /// The vertex it names (as written).
        index: i64,
        /// Vertices there are.
        vertices: usize,
    },
    /// A line of a text file can't be read.
    #[error("line {line}: '{text}': {expected}")]
    Line {
        /// Line number from 1.
        line: usize,
        /// The line.
        text: String,
        /// What would be right.
        expected: &'static str,
    },
    /// The file is shorter than its header says.
    #[error("the file ends early: {0}")]
    Short(String),
    /// The header can't be understood.
    #[error("PLY header: {0}")]
    Header(String),
}

/// Triangles with a normal at each corner.
#[derive(Clone, Debug)]
pub struct Mesh {
    /// Vertices.
    pub positions: Vec<Vec3>,
    /// Vertices of each triangle; no triangle is degenerate.
    pub triangles: Vec<[u32; 3]>,
    /// Unit normals of the corners of each triangle.
    pub normals: Vec<[Vec3; 3]>,
    /// Where the origin of `positions` lies in the coordinates that were read: zero, but for a mesh far from theirs.
    pub origin: DVec3,
}

/// What a parser has read.
#[derive(Default)]
struct Soup {
    positions: Vec<DVec3>,
    normals: Vec<Vec3>,
    /// Vertex and normal (`u32::MAX`: none) of each corner, face after face.
    corners: Vec<(u32, u32)>,
    /// Corners of each face, 3 or more.
    faces: Vec<usize>,
}

impl Soup {
    fn face(&mut self, corners: impl IntoIterator<Item = (u32, u32)>) {
        let before = self.corners.len();
        self.corners.extend(corners);
        self.faces.push(self.corners.len() - before);
    }

    /// Refuses more than [`MAX_TRIANGLES`] vertices or triangles.
    fn check_size(&self) -> Result<(), MeshError> {
        let largest = (self.corners.len() - 2 * self.faces.len()).max(self.positions.len());
        if largest > MAX_TRIANGLES { Err(MeshError::Huge(largest)) } else { Ok(()) }
    }
}

const NONE: u32 = u32::MAX;

impl Mesh {
    /// Reads a mesh; the end of `name` says the format.
    ///
    /// # Errors
    /// [`MeshError`].
    pub fn from_bytes(name: &str, data: &[u8]) -> Result<Self, MeshError> {
        let ending = name.rsplit('.').next().unwrap_or_default().to_ascii_lowercase();
        let soup = match ending.as_str() {
            "obj" => obj(data)?,
            "ply" => ply(data)?,
            "stl" => stl(data)?,
            _ => return Err(MeshError::Format(name.into())),
        };
        Self::from_soup(soup)
    }

    /// A mesh of these vertices and triangles, with normals by [`CREASE`].
    ///
    /// # Errors
    /// [`MeshError`] for an empty or huge mesh, a coordinate that is not finite, a vertex that is not there.
    pub fn new(positions: Vec<Vec3>, triangles: &[[u32; 3]]) -> Result<Self, MeshError> {
        let mut soup =
            Soup { positions: positions.iter().map(|p| p.as_dvec3()).collect(), ..Soup::default() };
        for triangle in triangles {
            soup.face(triangle.map(|v| (v, NONE)));
        }
        Self::from_soup(soup)
    }

    fn from_soup(soup: Soup) -> Result<Self, MeshError> {
        soup.check_size()?;
        let Soup { positions: read, normals: given, corners, faces } = soup;
        let vertices = read.len();
        let mut start = 0;
        for (i, &count) in faces.iter().enumerate() {
            for &(v, _) in &corners[start..start + count] {
                let missing = MeshError::Index { face: i + 1, index: i64::from(v), vertices };
                let p = read.get(v as usize).ok_or(missing)?;
                if let Some(value) = p.to_array().into_iter().find(|v| v.is_nan() || v.abs() > 1e15) {
                    return Err(MeshError::NotFinite { index: v as usize + 1, value });
                }
            }
            start += count;
        }
        let origin = origin(corners.iter().map(|c| read[c.0 as usize]));
        let mut positions: Vec<Vec3> = read.iter().map(|p| (p - origin).as_vec3()).collect();
        let mut triangles = Vec::with_capacity(corners.len() - 2 * faces.len());
        let mut flat = Vec::with_capacity(triangles.capacity());
        let mut normals = Vec::with_capacity(triangles.capacity());
        let mut cutter = Cutter::default();
        let mut rest = &corners[..];
        for &count in &faces {
            let (face, others) = rest.split_at(count);
            rest = others;
            for &cut in cutter.triangles(face.iter().map(|c| positions[c.0 as usize].as_dvec3())) {
                let corners = cut.map(|k| face[k]);
                let [a, b, c] = corners.map(|c| positions[c.0 as usize].as_dvec3());
                let cross = (b - a).cross(c - a);
                if cross.length_squared() > 0.0 {
                    triangles.push(corners.map(|c| c.0));
                    flat.push(cross.normalize().as_vec3());
                    normals.push(corners.map(|c| given.get(c.1 as usize).copied().unwrap_or(Vec3::ZERO)));
                }
            }
        }
        if triangles.is_empty() {
            return Err(MeshError::Empty { vertices, faces: faces.len() });
        }
        drop_unused(&mut positions, &mut triangles);
        let smooth = smooth_normals(&positions, &triangles, &flat);
        for (corner, smooth) in normals.iter_mut().flatten().zip(smooth.iter().flatten()) {
            *corner = corner.normalize_or(*smooth);
        }
        Ok(Self { positions, triangles, normals, origin })
    }
}

/// Where to move the origin for points whose distance from it is [`FAR`] above their extent: to their middle.
fn origin(points: impl Iterator<Item = DVec3>) -> DVec3 {
    let (low, high) = points.fold((DVec3::MAX, DVec3::MIN), |(low, high), p| (low.min(p), high.max(p)));
    let middle = 0.5 * (low + high);
    if middle.abs().max_element() > FAR * (high - low).max_element() { middle } else { DVec3::ZERO }
}

/// Leaves out the vertices of no triangle: they are not seen, and must not count for the object's extent.
fn drop_unused(positions: &mut Vec<Vec3>, triangles: &mut [[u32; 3]]) {
    let mut place = vec![NONE; positions.len()];
    for &v in triangles.iter().flatten() {
        place[v as usize] = 0;
    }
    for (at, new) in place.iter_mut().filter(|at| **at != NONE).zip(0..) {
        *at = new;
    }
    let mut used = place.iter().map(|&at| at != NONE);
    positions.retain(|_| used.next().unwrap_or(false));
    for v in triangles.iter_mut().flatten() {
        *v = place[*v as usize];
    }
}

/// Cuts polygons into triangles; keeps its memory between them.
#[derive(Default)]
struct Cutter {
    ears: Earcut<f64>,
    points: Vec<[f64; 3]>,
    flat: Vec<[f64; 2]>,
    ends: Vec<usize>,
    triangles: Vec<[usize; 3]>,
}

impl Cutter {
    /// The triangles of a polygon, as numbers of its corners: a fan where it is convex (or no polygon of a plane at all),
    /// else what ear clipping gives in its plane.
    fn triangles(&mut self, corners: impl Iterator<Item = DVec3>) -> &[[usize; 3]] {
        self.points.clear();
        self.points.extend(corners.map(|p| p.to_array()));
        self.triangles.clear();
        if !self.is_convex() && project3d_to_2d(&self.points, self.points.len(), &mut self.flat) {
            let none: &[usize] = &[];
            self.ears.earcut(self.flat.iter().copied(), none, &mut self.ends);
            self.triangles.extend(self.ends.chunks_exact(3).map(|t| [t[0], t[1], t[2]]));
        }
        if self.triangles.is_empty() {
            self.triangles.extend((1..self.points.len() - 1).map(|k| [0, k, k + 1]));
        }
        &self.triangles
    }

    /// Whether no corner turns the other way round than the whole polygon, by more than rounding does.
    fn is_convex(&self) -> bool {
        if self.points.len() == 3 {
            return true;
        }
        let corners = || self.points.iter().copied().map(DVec3::from);
        let edges: Vec<DVec3> =
            corners().zip(corners().cycle().skip(1)).filter_map(|(a, b)| (b - a).try_normalize()).collect();
        let first = DVec3::from(self.points[0]);
        // Newell: twice the area that the polygon encloses, along its normal.
        let area: DVec3 =
            corners().zip(corners().cycle().skip(1)).map(|(a, b)| (a - first).cross(b - first)).sum();
        let normal = area.normalize_or_zero();
        edges.iter().zip(edges.iter().cycle().skip(1)).all(|(a, b)| a.cross(*b).dot(normal) > -1e-5)
    }
}

/// Corner normals: the mean of the faces around the vertex that meet this one at less than [`CREASE`], weighted by
/// their angle at the vertex. Faces wound the other way round count with their sign turned.
fn smooth_normals(positions: &[Vec3], triangles: &[[u32; 3]], flat: &[Vec3]) -> Vec<[Vec3; 3]> {
    // A fan of so many faces is not a smooth surface, and averaging it would cost the square of its size.
    const FAN: usize = 64;
    let mut start = vec![0u32; positions.len() + 1];
    for &v in triangles.iter().flatten() {
        start[v as usize + 1] += 1;
    }
    for i in 1..start.len() {
        start[i] += start[i - 1];
    }
    let mut fill = start.clone();
    let mut around = vec![0u32; triangles.len() * 3];
    for (t, triangle) in triangles.iter().enumerate() {
        for &v in triangle {
            around[fill[v as usize] as usize] = t as u32;
            fill[v as usize] += 1;
        }
    }
    let angle = |t: usize, v: u32| {
        let triangle = triangles[t];
        let k = triangle.iter().position(|&c| c == v).unwrap_or(0);
        let at = |j: usize| positions[triangle[(k + j) % 3] as usize];
        crate::light::angle((at(1) - at(0)).normalize_or(Vec3::X), (at(2) - at(0)).normalize_or(Vec3::X))
    };
    triangles
        .iter()
        .enumerate()
        .map(|(t, triangle)| {
            triangle.map(|v| {
                let faces = &around[start[v as usize] as usize..start[v as usize + 1] as usize];
                if faces.len() > FAN {
                    return flat[t];
                }
                let mut sum = Vec3::ZERO;
                for &f in faces {
                    let cos = flat[f as usize].dot(flat[t]);
                    if cos.abs() > CREASE {
                        sum += flat[f as usize] * (angle(f as usize, v) * cos.signum());
                    }
                }
                sum.normalize_or(flat[t])
            })
        })
        .collect()
}

fn text(data: &[u8]) -> impl Iterator<Item = (usize, std::borrow::Cow<'_, str>)> {
    data.split(|&b| b == b'\n').enumerate().map(|(i, line)| (i + 1, String::from_utf8_lossy(line)))
}

fn three(words: &mut dyn Iterator<Item = &str>) -> Option<DVec3> {
    let mut next = || words.next()?.parse::<f64>().ok();
    Some(DVec3::new(next()?, next()?, next()?))
}

fn obj(data: &[u8]) -> Result<Soup, MeshError> {
    let mut soup = Soup::default();
    let mut corners: Vec<(u32, u32)> = Vec::new();
    for (line, content) in text(data) {
        let content = content.trim();
        let wrong = |expected| {
            let text = content.chars().take(60).collect();
            MeshError::Line { line, text, expected }
        };
        let mut words = content.split_ascii_whitespace();
        match words.next() {
            Some("v") => {
                soup.positions.push(three(&mut words).ok_or_else(|| wrong("v needs three numbers"))?);
            }
            Some("vn") => {
                let normal = three(&mut words).ok_or_else(|| wrong("vn needs three numbers"))?;
                soup.normals.push(normal.as_vec3());
            }
            Some("f") => {
                corners.clear();
                for word in words {
                    let mut parts = word.split('/');
                    let index = |part: Option<&str>, count: usize| {
                        let i: i64 = part?.parse().ok()?;
                        let from_zero = if i < 0 { count as i64 + i } else { i - 1 };
                        Some((i, u32::try_from(from_zero).ok().filter(|&v| (v as usize) < count)))
                    };
                    let (written, vertex) = index(parts.next(), soup.positions.len())
                        .ok_or_else(|| wrong("f needs corners as 1, 1/2, 1//3 or 1/2/3"))?;
                    let Some(vertex) = vertex else {
                        let (face, vertices) = (soup.faces.len() + 1, soup.positions.len());
                        return Err(MeshError::Index { face, index: written, vertices });
                    };
                    let normal = index(parts.nth(1), soup.normals.len()).and_then(|n| n.1).unwrap_or(NONE);
                    corners.push((vertex, normal));
                }
                if corners.len() < 3 {
                    return Err(wrong("a face needs three corners"));
                }
                soup.face(corners.iter().copied());
            }
            _ => {}
        }
        soup.check_size()?;
    }
    Ok(soup)
}

fn stl(data: &[u8]) -> Result<Soup, MeshError> {
    let count = data.get(80..84).map(|b| u32::from_le_bytes([b[0], b[1], b[2], b[3]]) as usize);
    // Binary files may begin with "solid" too: their length decides.
    let binary = count.is_some_and(|n| data.len() == 84 + 50 * n);
    let mut corners = Vec::new();
    if binary || !data.starts_with(b"solid") {
        let count = count.ok_or_else(|| MeshError::Short("an STL file has at least 84 bytes".into()))?;
        if count > MAX_TRIANGLES {
            return Err(MeshError::Huge(count));
        }
        let body = data.get(84..84 + 50 * count).ok_or_else(|| {
            MeshError::Short(format!(
                "{count} triangles need {} bytes, it has {}",
                84 + 50 * count,
                data.len()
            ))
        })?;
        for triangle in body.chunks_exact(50) {
            let number = |i: usize| f32::from_le_bytes(std::array::from_fn(|k| triangle[12 + 4 * i + k]));
            let vertex = |v: usize| Vec3::new(number(3 * v), number(3 * v + 1), number(3 * v + 2)).as_dvec3();
            corners.extend((0..3).map(vertex));
        }
    } else {
        for (line, content) in text(data) {
            let mut words = content.split_ascii_whitespace();
            if words.next() == Some("vertex") {
                corners.push(three(&mut words).ok_or_else(|| MeshError::Line {
                    line,
                    text: content.trim().chars().take(60).collect(),
                    expected: "vertex needs three numbers",
                })?);
            }
        }
        if corners.len() / 3 > MAX_TRIANGLES {
            return Err(MeshError::Huge(corners.len() / 3));
        }
    }
    // STL repeats its vertices: join those that will be equal, so that smooth areas can be found.
    let origin = origin(corners.iter().copied());
    let mut soup = Soup::default();
    let mut known = HashMap::new();
    for triangle in corners.chunks_exact(3) {
        let mut index = |p: DVec3| {
            *known.entry((p - origin).as_vec3().to_array().map(|v| (v + 0.0).to_bits())).or_insert_with(
                || {
                    soup.positions.push(p);
                    (soup.positions.len() - 1) as u32
                },
            )
        };
        let corners = [triangle[0], triangle[1], triangle[2]].map(|p| (index(p), NONE));
        soup.face(corners);
    }
    Ok(soup)
}

#[derive(Clone, Copy, Debug, PartialEq, Eq)]
enum Number {
    I8,
    U8,
    I16,
    U16,
    I32,
    U32,
    F32,
    F64,
}

impl Number {
    fn named(name: &str) -> Option<Self> {
        Some(match name {
            "char" | "int8" => Self::I8,
            "uchar" | "uint8" => Self::U8,
            "short" | "int16" => Self::I16,
            "ushort" | "uint16" => Self::U16,
            "int" | "int32" => Self::I32,
            "uint" | "uint32" => Self::U32,
            "float" | "float32" => Self::F32,
            "double" | "float64" => Self::F64,
            _ => return None,
        })
    }

    fn size(self) -> usize {
        match self {
            Self::I8 | Self::U8 => 1,
            Self::I16 | Self::U16 => 2,
            Self::I32 | Self::U32 | Self::F32 => 4,
            Self::F64 => 8,
        }
    }
}

struct Property {
    name: String,
    /// Type of a list's length, where it is a list.
    list: Option<Number>,
    number: Number,
}

struct Element {
    name: String,
    count: usize,
    properties: Vec<Property>,
}

#[derive(Clone, Copy, PartialEq, Eq)]
enum Encoding {
    Ascii,
    Little,
    Big,
}

/// The values behind a PLY header, one after the other.
struct Values<'a> {
    encoding: Encoding,
    rest: &'a [u8],
}

impl Values<'_> {
    fn next(&mut self, number: Number) -> Option<f64> {
        if self.encoding == Encoding::Ascii {
            let begin = self.rest.iter().position(|b| !b.is_ascii_whitespace())?;
            let word = &self.rest[begin..];
            let end = word.iter().position(u8::is_ascii_whitespace).unwrap_or(word.len());
            self.rest = &word[end..];
            return std::str::from_utf8(&word[..end]).ok()?.parse().ok();
        }
        let size = number.size();
        let mut bytes = [0u8; 8];
        bytes[..size].copy_from_slice(self.rest.get(..size)?);
        self.rest = &self.rest[size..];
        if self.encoding == Encoding::Big {
            bytes[..size].reverse();
        }
        let [a, b, c, d, ..] = bytes;
        Some(match number {
            Number::I8 => f64::from(a as i8),
            Number::U8 => f64::from(a),
            Number::I16 => f64::from(i16::from_le_bytes([a, b])),
            Number::U16 => f64::from(u16::from_le_bytes([a, b])),
            Number::I32 => f64::from(i32::from_le_bytes([a, b, c, d])),
            Number::U32 => f64::from(u32::from_le_bytes([a, b, c, d])),
            Number::F32 => f64::from(f32::from_le_bytes([a, b, c, d])),
            Number::F64 => f64::from_le_bytes(bytes),
        })
    }
}

fn ply_header(data: &[u8]) -> Result<(Encoding, Vec<Element>, usize), MeshError> {
    let wrong = |what: &str| MeshError::Header(what.into());
    let mut encoding = None;
    let mut elements: Vec<Element> = Vec::new();
    let mut offset = 0;
    for (i, line) in data.split_inclusive(|&b| b == b'\n').enumerate() {
        offset += line.len();
        let line = String::from_utf8_lossy(line);
        let words: Vec<&str> = line.split_ascii_whitespace().collect();
        match (i, &words[..]) {
            (0, ["ply"]) | (1.., ["comment" | "obj_info", ..] | []) => {}
            (1.., ["format", kind, "1.0"]) => {
                encoding = Some(match *kind {
                    "ascii" => Encoding::Ascii,
                    "binary_little_endian" => Encoding::Little,
                    "binary_big_endian" => Encoding::Big,
                    other => return Err(wrong(&format!("unknown format '{other}'"))),
                });
            }
            (1.., ["element", name, count]) => {
                let count = count.parse().map_err(|_| wrong(&format!("element {name} has no count")))?;
                if count > MAX_TRIANGLES {
                    return Err(MeshError::Huge(count));
                }
                elements.push(Element { name: (*name).into(), count, properties: Vec::new() });
            }
            (1.., ["property", kind @ .., name]) => {
                let number = |name: &str| Number::named(name).ok_or_else(|| wrong(&format!("type '{name}'")));
                let (list, number) = match kind {
                    ["list", length, item] => (Some(number(length)?), number(item)?),
                    [kind] => (None, number(kind)?),
                    _ => return Err(wrong(&format!("property '{name}' can't be read"))),
                };
                let element =
                    elements.last_mut().ok_or_else(|| wrong("a property before the first element"))?;
                element.properties.push(Property { name: (*name).into(), list, number });
            }
            (1.., ["end_header"]) => {
                return Ok((encoding.ok_or_else(|| wrong("no format line"))?, elements, offset));
            }
            _ => {
                return Err(wrong(&format!(
                    "line {}: '{}'",
                    i + 1,
                    line.trim().chars().take(60).collect::<String>()
                )));
            }
        }
    }
    Err(wrong("no end_header line"))
}

fn ply(data: &[u8]) -> Result<Soup, MeshError> {
    let (encoding, elements, offset) = ply_header(data)?;
    let mut values = Values { encoding, rest: &data[offset..] };
    let mut soup = Soup::default();
    let mut corners: Vec<u32> = Vec::new();
    // Every row takes a byte at least, so that a short file can't claim millions of them.
    for element in elements.iter().filter(|e| !e.properties.is_empty()) {
        let has_normals = ["nx", "ny", "nz"].iter().all(|n| element.properties.iter().any(|p| p.name == *n));
        for i in 0..element.count {
            let short = || MeshError::Short(format!("{} {} of {}", element.name, i + 1, element.count));
            let (mut p, mut n) = (DVec3::ZERO, DVec3::ZERO);
            for property in &element.properties {
                let Some(length) = property.list else {
                    let value = values.next(property.number).ok_or_else(short)?;
                    match property.name.as_str() {
                        "x" => p.x = value,
                        "y" => p.y = value,
                        "z" => p.z = value,
                        "nx" => n.x = value,
                        "ny" => n.y = value,
                        "nz" => n.z = value,
                        _ => {}
                    }
                    continue;
                };
                let length = values.next(length).ok_or_else(short)?;
                let is_face = element.name == "face" && property.name.starts_with("vert");
                corners.clear();
                // Bounded by the file: every item takes a byte at least.
                for _ in 0..length.max(0.0) as usize {
                    let value = values.next(property.number).ok_or_else(short)?;
                    if is_face {
                        // Normals are stored with the vertices: the same index.
                        corners.push(if value >= 0.0 { value as u32 } else { NONE });
                    }
                }
                if corners.len() >= 3 {
                    soup.face(corners.iter().map(|&c| (c, c)));
                    soup.check_size()?;
                }
            }
            if element.name == "vertex" {
                soup.positions.push(p);
                if has_normals {
                    soup.normals.push(n.as_vec3());
                }
            }
        }
    }
    Ok(soup)
}

#[cfg(test)]
mod tests {
    use super::*;

    const TETRAHEDRON: &str = "# four faces\nv 0 0 0\nv 1 0 0\nv 0 1 0\nv 0 0 1\nf 1 3 2\nf 1 2 4\nf 1/1 4/2 3/3\nf -3//1 -2//1 -1//1\n";

    #[test]
    fn obj_in_all_its_spellings() {
        let m = Mesh::from_bytes("t.OBJ", TETRAHEDRON.as_bytes()).unwrap();
        assert_eq!((m.positions.len(), m.triangles.len()), (4, 4));
        assert_eq!(m.triangles[3], [1, 2, 3]);
        // 90° and more between faces: edges stay sharp.
        assert_eq!(m.normals[0], [-Vec3::Z; 3]);
        let quad =
            Mesh::from_bytes("q.obj", b"v 0 0 0\r\nv 1 0 0\r\nv 1 1 0\r\nv 0 1 0\r\nf 1 2 3 4\r\n").unwrap();
        assert_eq!(quad.triangles, [[0, 1, 2], [0, 2, 3]]);
        let with =
            Mesh::from_bytes("n.obj", b"v 0 0 0\nv 1 0 0\nv 0 1 0\nvn 0 1 1\nf 1//1 2//1 3//1\n").unwrap();
        assert!((with.normals[0][0] - Vec3::new(0.0, 0.5f32.sqrt(), 0.5f32.sqrt())).length() < 1e-6);
    }

    #[test]
    fn stl_and_ply_give_the_same_mesh() {
        let reference = Mesh::from_bytes("t.obj", TETRAHEDRON.as_bytes()).unwrap();
        let points: Vec<Vec3> =
            reference.triangles.iter().flatten().map(|&v| reference.positions[v as usize]).collect();
        let mut ascii = String::from("solid t\n");
        let mut binary = vec![0u8; 80];
        binary.extend(4u32.to_le_bytes());
        for t in points.chunks(3) {
            ascii += "facet normal 0 0 0\nouter loop\n";
            binary.extend([0u8; 12]);
            for p in t {
                ascii += &format!("vertex {} {} {}\n", p.x, p.y, p.z);
                binary.extend(p.to_array().iter().flat_map(|v| v.to_le_bytes()));
            }
            ascii += "endloop\nendfacet\n";
            binary.extend([0u8; 2]);
        }
        let header = |format: &str| {
            format!(
                "ply\nformat {format} 1.0\ncomment x\nelement vertex 4\nproperty float x\nproperty double y\n\
                 property float z\nproperty uchar red\nelement face 4\nproperty list uchar int vertex_indices\nend_header\n"
            )
        };
        let mut text = header("ascii");
        let mut little = header("binary_little_endian").into_bytes();
        let mut big = header("binary_big_endian").into_bytes();
        for p in &reference.positions {
            text += &format!("{} {} {} 7\n", p.x, p.y, p.z);
            little.extend(
                p.x.to_le_bytes().into_iter().chain(f64::from(p.y).to_le_bytes()).chain(p.z.to_le_bytes()),
            );
            big.extend(
                p.x.to_be_bytes().into_iter().chain(f64::from(p.y).to_be_bytes()).chain(p.z.to_be_bytes()),
            );
            little.push(7);
            big.push(7);
        }
        for t in &reference.triangles {
            text += &format!("3 {} {} {}\n", t[0], t[1], t[2]);
            little.push(3);
            big.push(3);
            little.extend(t.iter().flat_map(|v| v.to_le_bytes()));
            big.extend(t.iter().flat_map(|v| v.to_be_bytes()));
        }
        let corners = |m: &Mesh| -> Vec<Vec3> {
            m.triangles.iter().flatten().map(|&v| m.positions[v as usize]).collect()
        };
        for (name, data) in [
            ("a.stl", ascii.as_bytes()),
            ("b.stl", &binary),
            ("a.ply", text.as_bytes()),
            ("l.ply", &little),
            ("b.ply", &big),
        ] {
            let m = Mesh::from_bytes(name, data).unwrap();
            assert_eq!((m.positions.len(), corners(&m)), (4, points.clone()), "{name}");
            assert_eq!(m.normals, reference.normals, "{name}");
            // Cut off anywhere it is an error or a smaller mesh, never a panic.
            for end in 0..data.len() {
                let _ = Mesh::from_bytes(name, &data[..end]);
            }
        }
    }

    /// An L of six corners: 3 of 4 squares.
    const CORNERS: [[f64; 2]; 6] = [[1., 1.], [0., 1.], [0., 0.], [2., 0.], [2., 2.], [1., 2.]];

    fn area(m: &Mesh) -> Vec3 {
        let cross = |t: &[u32; 3]| {
            let [a, b, c] = t.map(|v| m.positions[v as usize]);
            0.5 * (b - a).cross(c - a)
        };
        m.triangles.iter().map(cross).sum()
    }

    #[test]
    fn faces_that_are_not_convex_keep_their_outline() {
        for turned in 0..6 {
            let corner = |k: usize| CORNERS[(k + turned) % 6];
            // In a plane that leans, and wound either way.
            let vertices: String = (0..6)
                .map(|k| format!("{} {} {}\n", corner(k)[0], corner(k)[1], 0.5 * corner(k)[0]))
                .collect();
            for (order, side) in [("1 2 3 4 5 6", 1.0), ("6 5 4 3 2 1", -1.0)] {
                let obj = format!("v {}\nf {order}\n", vertices.trim().replace('\n', "\nv "));
                let m = Mesh::from_bytes("l.obj", obj.as_bytes()).unwrap();
                let normal = side * Vec3::new(-0.5, 0.0, 1.0);
                assert!((area(&m) - 3.0 * normal).length() < 1e-5, "{turned} {order}: {}", area(&m));
                let absolute: f32 = m.normals.iter().map(|n| n[0].dot(normal.normalize())).sum();
                assert!(absolute > 0.999 * m.triangles.len() as f32, "one triangle is turned over");
            }
            let ply = format!(
                "ply\nformat ascii 1.0\nelement vertex 6\nproperty float x\nproperty float y\nproperty float z\n\
                 element face 1\nproperty list uchar int vertex_indices\nend_header\n{vertices}6 0 1 2 3 4 5\n"
            );
            let m = Mesh::from_bytes("l.ply", ply.as_bytes()).unwrap();
            assert!((area(&m) - 3.0 * Vec3::new(-0.5, 0.0, 1.0)).length() < 1e-5);
        }
        // No plane at all: still a mesh.
        let line = "v 0 0 0\nv 1 0 0\nv 0 0 0\nv 0 1 0\nf 1 2 3 4\n";
        assert!(Mesh::from_bytes("x.obj", line.as_bytes()).is_err());
        let bow = "v 0 0 0\nv 1 1 0\nv 1 0 0\nv 0 1 0\nf 1 2 3 4\n";
        assert!(Mesh::from_bytes("x.obj", bow.as_bytes()).is_ok());
    }

    #[test]
    fn a_mesh_of_a_survey_keeps_its_shape() {
        let away = DVec3::new(478_123.25, 5_429_876.5, 112.0);
        let points: Vec<DVec3> =
            TETRAHEDRON.lines().filter_map(|l| three(&mut l.strip_prefix("v ")?.split(' '))).collect();
        let faces = [[0u32, 2, 1], [0, 1, 3], [0, 3, 2], [1, 2, 3]];
        let obj: String = points
            .iter()
            .map(|p| 0.01 * p + away)
            .map(|p| format!("v {} {} {}\n", p.x, p.y, p.z))
            .chain(faces.map(|f| format!("f {} {} {}\n", f[0] + 1, f[1] + 1, f[2] + 1)))
            .collect();
        let stl: String = faces
            .iter()
            .flatten()
            .map(|&v| 0.01 * points[v as usize] + away)
            .map(|p| format!("vertex {} {} {}\n", p.x, p.y, p.z))
            .collect();
        for (name, text) in [("t.obj", obj), ("t.stl", format!("solid t\n{stl}"))] {
            let m = Mesh::from_bytes(name, text.as_bytes()).unwrap();
            assert!((m.origin - away - 0.005).length() < 1e-6, "{name}: {}", m.origin);
            assert_eq!(m.positions.len(), 4);
            for (t, f) in m.triangles.iter().zip(faces) {
                for (at, v) in t.iter().zip(f) {
                    let there = m.positions[*at as usize].as_dvec3() + m.origin - away;
                    assert!((there - 0.01 * points[v as usize]).length() < 1e-6, "{name}: {there}");
                }
            }
        }
        assert_eq!(Mesh::from_bytes("t.obj", TETRAHEDRON.as_bytes()).unwrap().origin, DVec3::ZERO);
    }

    #[test]
    fn vertices_of_no_face_are_left_out() {
        let m = Mesh::from_bytes("t.obj", TETRAHEDRON.as_bytes()).unwrap();
        let more =
            format!("v 900 0 0\nv nan 0 inf\n{}v 0 1e30 0\n", TETRAHEDRON.replace("f 1 3 2", "f 3 5 4"));
        let more = more.replace("f 1 2 4", "f 3 4 6").replace("f 1/1 4/2 3/3", "f 3/1 6/2 5/3");
        let same = Mesh::from_bytes("t.obj", more.as_bytes()).unwrap();
        assert_eq!(
            (&m.positions, &m.triangles, &m.normals),
            (&same.positions, &same.triangles, &same.normals)
        );
    }

    #[test]
    fn bad_meshes_are_named() {
        let read = |s: &str| Mesh::from_bytes("m.obj", s.as_bytes()).unwrap_err();
        assert_eq!(read(""), MeshError::Empty { vertices: 0, faces: 0 });
        assert_eq!(read("v 0 0 0\nv 1 1 1\nv 2 2 2\nf 1 2 3\n"), MeshError::Empty { vertices: 3, faces: 1 });
        assert!(matches!(read("v 0 0 nan\nf 1 1 1\n"), MeshError::NotFinite { index: 1, .. }));
        assert!(matches!(read("v 0 0 0\nv 0 0 inf\nf 1 1 2\n"), MeshError::NotFinite { index: 2, .. }));
        assert_eq!(read("v 0 0 0\nf 1 2 3\n"), MeshError::Index { face: 1, index: 2, vertices: 1 });
        assert_eq!(read("v 0 0 0\nf 1 -2 1\n"), MeshError::Index { face: 1, index: -2, vertices: 1 });
        assert!(matches!(read("v 0 0\n"), MeshError::Line { line: 1, .. }));
        assert!(matches!(read("v 0 0 0\nf 1 1\n"), MeshError::Line { line: 2, .. }));
        assert!(matches!(Mesh::from_bytes("m.fbx", b""), Err(MeshError::Format(_))));
        let mut huge = vec![0u8; 80];
        huge.extend(u32::MAX.to_le_bytes());
        assert_eq!(Mesh::from_bytes("h.stl", &huge).unwrap_err(), MeshError::Huge(u32::MAX as usize));
        assert!(matches!(
            Mesh::from_bytes("h.ply", b"ply\nformat ascii 1.0\nelement vertex 99999999999\n"),
            Err(MeshError::Huge(_))
        ));
        assert!(matches!(Mesh::from_bytes("h.ply", b"ply\nformat ascii 1.0\nelement face 1\nproperty list uint int vertex_indices\nend_header\n4000000000 1 2"), Err(MeshError::Short(_))));
    }
}
