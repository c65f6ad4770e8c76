//! The fuzz targets' bodies as bounded property tests: on the committed corpus, on random bytes, and on valid
//! files with a few bytes flipped, cut, moved or put in.

#[path = "support/parsers.rs"]
mod parsers;

use coil_ps::dataset::{archive, lp, mat, write_object};
use coil_ps::image::{encode_grey, encode_rgb};
use coil_ps::stack::BitDepth;
use parsers::{BODIES, sphere};
use proptest::prelude::*;
use std::path::PathBuf;

fn corpus(target: &str) -> PathBuf {
    PathBuf::from(env!("CARGO_MANIFEST_DIR")).join("fuzz/regressions").join(target)
}

/// Small valid files for a target.
fn valid(target: &str) -> Vec<Vec<u8>> {
    let stack = sphere(9, 7, 4, BitDepth::Sixteen);
    let object = write_object(&stack).unwrap();
    let truth = |object: &[(String, Vec<u8>)]| {
        object.iter().find(|(name, _)| name == "Normal_gt.mat").unwrap().1.clone()
    };
    match target {
        "png" => {
            let rgb: Vec<[u16; 3]> = (0..63).map(|i| [i * 4, 200, 255 - i]).collect();
            vec![
                object[0].1.clone(),
                encode_rgb(9, 7, BitDepth::Eight, &rgb).unwrap(),
                encode_grey(9, 7, &[1; 63]).unwrap(),
            ]
        }
        "tiff" => vec![tiff(true, 8, 3), tiff(true, 16, 1), tiff(false, 16, 1)],
        "mat" => {
            let array = mat::Array { dims: vec![1, 2], values: vec![0.5, -1.0] };
            vec![truth(&object), mat::write_array("Normal_gt", &array), uncompressed_mat()]
        }
        "zip" => {
            let folder = |(name, bytes)| (format!("spherePNG/{name}"), bytes);
            let object: Vec<_> = object.into_iter().map(folder).collect();
            let plain = [("a.txt".into(), b"some text".to_vec()), ("b/c.bin".into(), vec![7; 300])];
            vec![archive::write_zip(&plain).unwrap(), archive::write_zip(&object).unwrap()]
        }
        "lp" => {
            let lights = stack.names.iter().map(String::as_str).zip(stack.lights.iter().copied());
            vec![lp::write_lp(lights).into_bytes(), b"1\r\na b\t0 0.6 0.8\r\n".to_vec()]
        }
        "object" => {
            let object = write_object(&sphere(9, 7, 4, BitDepth::Eight)).unwrap();
            let normals = (0..63).map(|_| "0 0.6 0.8\n").collect::<String>();
            let files = object.into_iter().map(|(_, bytes)| bytes).chain([normals.into_bytes()]);
            (0u8..).zip(files).map(|(which, bytes)| [vec![which], bytes].concat()).collect()
        }
        "model" => vec![std::fs::read(concat!(env!("CARGO_MANIFEST_DIR"), "/models/pixel.onnx")).unwrap()],
        "mesh" => {
            MESHES.iter().map(|(format, text)| [&[*format][..], text].concat()).chain([stl()]).collect()
        }
        "grbl" => vec![
            b"<Idle|MPos:-185.000,-100.000,0.000|FS:0,800|WCO:-185.000,-100.000,0.000>".to_vec(),
            b"<Hold:0|WPos:1.000,2.000,0.000|Bf:15,128|FS:500,0|Pn:XZ|Ov:100,100,100|A:SF>".to_vec(),
        ],
        _ => panic!("no valid files for {target}"),
    }
}

const MESHES: [(u8, &[u8]); 3] = [
    (0, b"# two faces\nv 0 0 0\nv 1 0 0\nv 1 1 0\nv 0 1 0\nvn 0 0 1\nf 1//1 2//1 3//1\nf -4 -2 -1\n"),
    (
        1,
        b"ply\nformat ascii 1.0\nelement vertex 3\nproperty float x\nproperty float y\nproperty float z\nelement face 1\n\
          property list uchar int vertex_indices\nend_header\n0 0 0\n1 0 0\n0 1 0\n3 0 1 2\n",
    ),
    (2, b"solid a\nfacet normal 0 0 1\nouter loop\nvertex 0 0 0\nvertex 1 0 0\nvertex 0 1 0\nendloop\nendfacet\nendsolid\n"),
];

/// One triangle, binary.
fn stl() -> Vec<u8> {
    let mut bytes = vec![0; 81];
    bytes[0] = 2; // the format
    bytes.extend(1u32.to_le_bytes());
    for v in [0.0f32, 0.0, 1.0, 0.0, 0.0, 0.0, 1.0, 0.0, 0.0, 0.0, 1.0, 0.0] {
        bytes.extend(v.to_le_bytes());
    }
    bytes.extend([0; 2]);
    bytes
}

/// A picture of 3×2 pixels in two strips, `samples` of `bits` bits a pixel.
fn tiff(little: bool, bits: u16, samples: u16) -> Vec<u8> {
    let short = |v: u16| if little { v.to_le_bytes() } else { v.to_be_bytes() };
    let long = |v: u32| if little { v.to_le_bytes() } else { v.to_be_bytes() };
    let strip = 3 * u32::from(bits / 8 * samples);
    let lists = 8 + 2 * strip;
    let mut bytes = if little { b"II*\0".to_vec() } else { b"MM\0*".to_vec() };
    bytes.extend(long(lists + 16)); // the directory, after the pixels and the strip lists
    bytes.extend((0..2 * strip).map(|v| (v * 7) as u8));
    for v in [8, 8 + strip, strip, strip] {
        bytes.extend(long(v));
    }
    bytes.extend(short(8));
    for (tag, value) in [(256, 3), (257, 2), (258, bits), (259, 1), (262, 1), (277, samples)] {
        bytes.extend([short(tag), short(3)].concat());
        bytes.extend(long(1));
        bytes.extend([short(value), short(0)].concat());
    }
    for (tag, at) in [(273, lists), (279, lists + 8)] {
        bytes.extend([short(tag), short(4)].concat());
        bytes.extend(long(2));
        bytes.extend(long(at));
    }
    bytes
}

/// A 1×2 array as `save -v6` writes it: not compressed, small elements.
fn uncompressed_mat() -> Vec<u8> {
    let mut bytes = vec![b' '; 124];
    bytes.extend(*b"\0\x01IM");
    for word in [14u32, 64, 6, 8, 6, 0, 5, 8, 1, 2, 1, 9] {
        bytes.extend(word.to_le_bytes());
    }
    bytes.extend(*b"Normal_gt\0\0\0\0\0\0\0");
    bytes.extend([2, 0, 2, 0, 5, 9, 0, 0]); // two u8 in a small element
    bytes
}

/// The valid files that the corpus holds: a model stands in `models/` already.
fn small(target: &str) -> Vec<Vec<u8>> {
    valid(target).into_iter().filter(|bytes| bytes.len() < 1 << 15).collect()
}

#[derive(Clone, Debug)]
enum Change {
    Flip(u16, u8),
    Set(u16, u8),
    Insert(u16, Vec<u8>),
    Delete(u16, u8),
    Truncate(u16),
    Copy(u16, u16, u8),
}

fn change() -> impl Strategy<Value = Change> {
    let at = any::<u16>;
    prop_oneof![
        (at(), 0..8u8).prop_map(|(i, bit)| Change::Flip(i, 1 << bit)),
        (at(), prop_oneof![Just(0u8), Just(255), Just(127), Just(128), any::<u8>()])
            .prop_map(|(i, v)| Change::Set(i, v)),
        (at(), prop::collection::vec(any::<u8>(), 1..9)).prop_map(|(i, v)| Change::Insert(i, v)),
        (at(), 1..16u8).prop_map(|(i, n)| Change::Delete(i, n)),
        at().prop_map(Change::Truncate),
        (at(), at(), 1..32u8).prop_map(|(i, j, n)| Change::Copy(i, j, n)),
    ]
}

fn apply(mut bytes: Vec<u8>, changes: &[Change]) -> Vec<u8> {
    for change in changes {
        let n = bytes.len();
        if n == 0 {
            break;
        }
        let at = |i: u16| usize::from(i) % n;
        match change {
            Change::Flip(i, bits) => bytes[at(*i)] ^= bits,
            Change::Set(i, v) => bytes[at(*i)] = *v,
            Change::Insert(i, v) => drop(bytes.splice(at(*i)..at(*i), v.iter().copied())),
            Change::Delete(i, count) => drop(bytes.drain(at(*i)..n.min(at(*i) + usize::from(*count)))),
            Change::Truncate(i) => bytes.truncate(at(*i)),
            Change::Copy(i, j, count) => {
                let part = bytes[at(*i)..n.min(at(*i) + usize::from(*count))].to_vec();
                drop(bytes.splice(at(*j)..at(*j), part));
            }
        }
    }
    bytes
}

/// Runs a body; a panic names the bytes, to be put into the corpus.
fn run(target: &str, body: fn(&[u8]) -> bool, bytes: &[u8]) -> bool {
    std::panic::catch_unwind(|| body(bytes))
        .unwrap_or_else(|_| panic!("{target} panics on {} bytes: {}", bytes.len(), bytes.escape_ascii()))
}

#[test]
fn corpus_is_parsed_or_refused() {
    for (target, body) in BODIES {
        let files = std::fs::read_dir(corpus(target)).unwrap_or_else(|e| panic!("{target}: {e}"));
        let mut accepted = 0;
        for file in files {
            accepted += usize::from(run(target, *body, &std::fs::read(file.unwrap().path()).unwrap()));
        }
        assert!(
            accepted >= small(target).len(),
            "{target}: only {accepted} files of the corpus are accepted"
        );
    }
}

#[test]
fn valid_files_are_accepted() {
    for (target, body) in BODIES {
        for (i, bytes) in valid(target).iter().enumerate() {
            assert!(run(target, *body, bytes), "{target}: valid file {i} is refused");
        }
    }
}

// 256 cases each; PROPTEST_CASES asks for more.
proptest! {
    #![proptest_config(ProptestConfig { failure_persistence: None, ..ProptestConfig::default() })]

    #[test]
    fn changed_files_are_parsed_or_refused(seed in any::<usize>(), changes in prop::collection::vec(change(), 1..6)) {
        for (target, body) in BODIES {
            let valid = valid(target);
            run(target, *body, &apply(valid[seed % valid.len()].clone(), &changes));
        }
    }

    #[test]
    fn random_bytes_are_parsed_or_refused(bytes in prop::collection::vec(any::<u8>(), 0..400)) {
        for (target, body) in BODIES {
            run(target, *body, &bytes);
        }
    }

    #[test]
    fn random_text_is_parsed_or_refused(which in any::<u8>(), text in "([0-9.eE+-]{0,6}[ ,\t\r\n]|nan|inf|[a-z.]{1,5}){0,40}") {
        parsers::lp(text.as_bytes());
        parsers::object(&[vec![which], text.into_bytes()].concat());
    }
}

/// Writes the valid files into the corpus: `cargo test --test fuzz -- --ignored`.
#[test]
#[ignore = "regenerates fuzz/regressions"]
fn write_corpus() {
    for (target, _) in BODIES {
        std::fs::create_dir_all(corpus(target)).unwrap();
        for (i, bytes) in small(target).iter().enumerate() {
            std::fs::write(corpus(target).join(format!("valid-{i}")), bytes).unwrap();
        }
    }
}
