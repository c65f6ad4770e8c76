//! Datasets: the shared DiLiGenT objects as published, what is written is read back, and every
//! inconsistency is named with its file and line.

mod support;

use coil_ps::dataset::{
    DatasetError, Files, Header, Limits, Memory, Warning, Zip, archive, decode_pixels, diligent102,
    find_objects, mat, read_object, write_object,
};
use coil_ps::image::{decode_png, encode_grey, encode_rgb};
use coil_ps::stack::{BitDepth, RawStack};
use glam::Vec3;
use support::object_files;
use support::parsers::{assert_valid, sphere};

#[test]
fn shared_objects_are_read_as_published() {
    for (name, bits, pixels) in [
        ("ball", BitDepth::Sixteen, 15_791),
        ("bear", BitDepth::Sixteen, 41_512),
        ("cat", BitDepth::Sixteen, 45_200),
        ("reading", BitDepth::Sixteen, 27_654),
        ("cow", BitDepth::Eight, 26_421),
        ("pot1", BitDepth::Eight, 57_721),
    ] {
        let Some(stack) = support::diligent(name) else { return };
        assert_eq!((stack.name.as_str(), stack.bits), (name, bits));
        assert_eq!(stack.mask.len(), pixels, "{name}");
        assert_eq!((stack.images.len(), stack.lights.len(), stack.intensities.len()), (96, 96, 96));
        assert!(stack.lights.iter().all(|l| (l.length() - 1.0).abs() < 1e-6 && l.z > 0.7));
        let truth = stack.truth.unwrap();
        assert!(truth.iter().all(|n| (n.length() - 1.0).abs() < 1e-5));
    }
}

#[test]
fn the_frame_is_x_right_y_up_z_to_the_camera() {
    let Some(ball) = support::diligent("ball") else { return };
    let truth = ball.truth.unwrap();
    // On a sphere the normal follows the position: n = ((x − cx)/r, (cy − y)/r, z).
    let (x0, y0, w, h) = ball.mask.bounds();
    let (cx, cy) = (x0 as f32 + 0.5 * (w as f32 - 1.0), y0 as f32 + 0.5 * (h as f32 - 1.0));
    let r = 0.25 * (w + h) as f32;
    for (p, n) in truth.iter().enumerate() {
        let (x, y) = ball.mask.position(p);
        let (u, v) = ((x as f32 - cx) / r, (cy - y as f32) / r);
        assert!((n.x - u).abs() < 0.05 && (n.y - v).abs() < 0.05 && n.z >= 0.0, "{n} at {x}, {y}");
    }
    // The picture of the normals that comes with it says the same: rgb = (n + 1)/2.
    let data = support::shared_data().unwrap();
    let png = std::fs::read(support::diligent_folder(&data, "ball").join("Normal_gt.png")).unwrap();
    let picture = ball.mask.gather(&decode_png(&png, 1 << 20).unwrap().rgb);
    let worst = picture
        .iter()
        .zip(&truth)
        .map(|(rgb, n)| (Vec3::from(rgb.map(|v| f32::from(v) / 127.5 - 1.0)) - *n).abs().max_element());
    assert!(worst.fold(0.0, f32::max) < 0.02);
}

fn fixture() -> RawStack {
    sphere(9, 7, 4, BitDepth::Sixteen)
}

fn read(files: &dyn Files) -> Result<(RawStack, Vec<Warning>), DatasetError> {
    read_object(files, "spherePNG", &Limits::default())
}

/// The message about the fixture with one file replaced (`None`: left out).
fn message_with(name: &str, content: Option<Vec<u8>>) -> String {
    read(&changed(name, content)).expect_err(name).to_string()
}

fn changed(name: &str, content: Option<Vec<u8>>) -> Memory {
    let mut files = Memory::new();
    let replaced = content.map(|bytes| (name.to_string(), bytes));
    for (file, bytes) in
        write_object(&fixture()).unwrap().into_iter().filter(|(n, _)| n != name).chain(replaced)
    {
        files.insert(&format!("spherePNG/{file}"), bytes).unwrap();
    }
    files
}

fn text_of(name: &str) -> String {
    let files = object_files(&fixture());
    String::from_utf8(files.read(&format!("spherePNG/{name}")).unwrap()).unwrap()
}

/// The fixture's text file with line `line` (from 1) replaced.
fn with_line(name: &str, line: usize, new: &str) -> Option<Vec<u8>> {
    let text = text_of(name);
    let lines: Vec<&str> = (1..).zip(text.lines()).map(|(i, l)| if i == line { new } else { l }).collect();
    Some(lines.join("\n").into_bytes())
}

fn assert_same(a: &RawStack, b: &RawStack) {
    assert_eq!((&a.name, &a.mask, a.bits, &a.names), (&b.name, &b.mask, b.bits, &b.names));
    assert_eq!(a.images, b.images);
    assert_eq!((&a.lights, &a.intensities, &a.truth), (&b.lights, &b.intensities, &b.truth));
}

#[test]
fn what_is_written_is_read_back_to_the_bit() {
    for bits in [BitDepth::Eight, BitDepth::Sixteen] {
        for (size, truth) in [((9, 7), true), ((64, 48), false)] {
            let mut stack = sphere(size.0, size.1, 5, bits);
            stack.truth = stack.truth.filter(|_| truth);
            let (again, warnings) = read(&object_files(&stack)).unwrap();
            assert_same(&stack, &again);
            assert_eq!(warnings, if truth { vec![] } else { vec![Warning::NoTruth] });
        }
    }
}

#[test]
fn objects_are_found_under_any_root_and_in_archives() {
    let object = write_object(&fixture()).unwrap();
    let mut files = Memory::new();
    for folder in ["DiLiGenT/pmsData/ballPNG", "DiLiGenT/pmsData/catPNG", "__MACOSX/ballPNG", "a/.hidden"] {
        for (name, bytes) in &object {
            files.insert(&format!("{folder}/{name}"), bytes.clone()).unwrap();
        }
    }
    files.insert("DiLiGenT/pmsData/objects.txt", b"ball".to_vec()).unwrap();
    assert_eq!(find_objects(&files), ["DiLiGenT/pmsData/ballPNG", "DiLiGenT/pmsData/catPNG"]);
    let (ball, _) = read_object(&files, "DiLiGenT/pmsData/ballPNG", &Limits::default()).unwrap();
    assert_eq!(ball.name, "ball");

    let zip = archive::write_zip(&object).unwrap(); // the files at its root
    let zip = Zip::new(zip, "a.zip", &Limits::default()).unwrap();
    assert_eq!(find_objects(&zip), [""]);
    let (stack, _) = read_object(&zip, "", &Limits::default()).unwrap();
    assert_eq!((stack.images, stack.name.as_str()), (fixture().images, "a"));
    // Bear must be known as bear: protocol 128 leaves its bad images out.
    for name in ["bear.zip", "bearPNG.ZIP"] {
        let zip = Zip::new(archive::write_zip(&object).unwrap(), name, &Limits::default()).unwrap();
        assert_eq!(read_object(&zip, "", &Limits::default()).unwrap().0.name, "bear");
    }
    assert!(find_objects(&Memory::new()).is_empty());
}

#[test]
fn diligent102_is_read_and_its_submission_has_its_shape() {
    let mut files = Memory::new();
    let mut stack = fixture();
    stack.truth = None;
    for (name, bytes) in write_object(&stack).unwrap() {
        files.insert(&format!("DiLiGenT102/BALL_Al/{name}"), bytes).unwrap();
    }
    let dirs = find_objects(&files);
    let (stack, warnings) = read_object(&files, &dirs[0], &Limits::default()).unwrap();
    assert_eq!(diligent102::shape_and_material(&stack.name), Some(("BALL", "Al")));
    assert_eq!(warnings, [Warning::NoTruth]);
    let upload = diligent102::submission(&stack.mask, &vec![Vec3::Z; stack.mask.len()]);
    assert_eq!(mat::read_array(&upload, "Normal_est", 1000).unwrap().dims, [7, 9, 3]);
}

#[test]
fn text_files_of_any_system_are_read() {
    let windows = |name| {
        Some(format!("\u{feff}{}\r\n\r\n", text_of(name).trim_end().replace('\n', "\r\n")).into_bytes())
    };
    let tabs = |name| Some(text_of(name).trim_end().replace(' ', "\t").into_bytes());
    let commas = |name| Some(text_of(name).replace(' ', ", ").replace('\n', "\n\n").into_bytes());
    for (name, content) in [
        ("filenames.txt", windows("filenames.txt")),
        ("light_directions.txt", windows("light_directions.txt")),
        ("light_directions.txt", tabs("light_directions.txt")),
        ("light_intensities.txt", commas("light_intensities.txt")),
    ] {
        assert_same(&read(&changed(name, content)).unwrap().0, &fixture());
    }
}

#[test]
fn what_can_be_done_without_is_a_warning() {
    let (stack, warnings) = read(&changed("filenames.txt", None)).unwrap();
    assert_same(&stack, &fixture());
    assert_eq!(warnings, [Warning::NoFileList { images: 4 }]);
    let mut files = changed("filenames.txt", None);
    files.insert("spherePNG/aöabc", vec![]).unwrap(); // found by fuzzing: four bytes from its end is inside a character
    assert_same(&read(&files).unwrap().0, &fixture());
    let (stack, warnings) = read(&changed("light_intensities.txt", None)).unwrap();
    assert_eq!((stack.intensities[3], warnings), ([1.0; 3], vec![Warning::NoIntensities]));

    let (stack, warnings) =
        read(&changed("light_directions.txt", with_line("light_directions.txt", 1, "0 0 1.008"))).unwrap();
    assert_eq!(stack.lights[0], Vec3::Z);
    assert_eq!(warnings, [Warning::LightsNormalised { lights: 1, worst: 1.008 }]);

    let mut zeros = fixture();
    zeros.truth.as_mut().unwrap()[2] = Vec3::ZERO;
    let (stack, warnings) = read(&object_files(&zeros)).unwrap();
    assert_eq!((stack.truth.unwrap()[2], warnings), (Vec3::ZERO, vec![Warning::ZeroTruth { pixels: 1 }]));

    let mut bear = sphere(9, 7, 96, BitDepth::Eight);
    bear.name = "bear".into();
    let (_, warnings) = read_object(&object_files(&bear), "bearPNG", &Limits::default()).unwrap();
    assert_eq!(warnings, [Warning::BadFirstImages { images: 20 }]);
}

#[test]
fn what_no_normal_can_be_told_from_is_a_warning() {
    let plane = b"0 0 1\n0.6 0 0.8\n-0.6 0 0.8\n0.8 0 0.6\n".to_vec();
    let flat = changed("light_directions.txt", Some(plane));
    assert_eq!(read(&flat).unwrap().1, [Warning::FlatLights { lights: 4 }]);

    let mut two = fixture();
    two.names.truncate(2);
    two.images.truncate(2);
    two.lights.truncate(2);
    two.intensities.truncate(2);
    assert_eq!(read(&object_files(&two)).unwrap().1, [Warning::FewLights { lights: 2 }]);

    let mut odd = fixture();
    let truth = odd.truth.as_mut().unwrap();
    let of = truth.len();
    truth[1..].fill(Vec3::ZERO);
    odd.images[1].fill([0; 3]);
    odd.images[3].fill([0; 3]);
    odd.images[2].fill([u16::MAX; 3]);
    let files = object_files(&odd);
    assert_eq!(read(&files).unwrap().1, [Warning::LittleTruth { pixels: of - 1, of }]);
    let header = Header::read(&files, "spherePNG", &Limits::default()).unwrap();
    let decode = |k| decode_pixels(&files.read(&header.path(k)).unwrap(), &header.mask, "").unwrap();
    let images: Vec<_> = (0..4).map(|k| (k, decode(k))).collect();
    let (black, white) = (header.images[1].clone(), header.images[2].clone());
    let expected = [
        Warning::BlackImages { images: 2, first: black },
        Warning::SaturatedImages { images: 1, first: white },
    ];
    assert_eq!(header.image_warnings(&images), expected);
}

#[test]
fn normals_in_a_text_file_are_read_also_upside_down() {
    let stack = sphere(9, 8, 4, BitDepth::Eight);
    // A lopsided mask, so that upside down is another thing.
    let mut lopsided = stack.clone();
    let keep: Vec<bool> = (0..stack.mask.len()).map(|p| stack.mask.position(p).1 < 5).collect();
    let inside = stack.mask.scatter(&keep, false);
    lopsided.mask = coil_ps::stack::Mask::new(9, 8, &inside).unwrap();
    let kept = |v: &[[u16; 3]]| v.iter().zip(&keep).filter(|k| *k.1).map(|k| *k.0).collect::<Vec<_>>();
    lopsided.images = stack.images.iter().map(|i| kept(i)).collect();
    let truth: Vec<Vec3> =
        stack.truth.unwrap().into_iter().zip(&keep).filter(|k| *k.1).map(|k| k.0).collect();
    lopsided.truth = None;
    let rows: Vec<String> = lopsided
        .mask
        .scatter(&truth, Vec3::ZERO)
        .chunks(9)
        .map(|row| row.iter().map(|n| format!("{} {} {}\n", n.x, n.y, n.z)).collect())
        .collect();
    let turned: Vec<String> = rows.iter().rev().cloned().collect();
    for (text, upside_down) in [(rows.concat(), false), (turned.concat(), true)] {
        let mut files = object_files(&lopsided);
        files.insert("spherePNG/normal.txt", text.into_bytes()).unwrap();
        let (read, warnings) = read(&files).unwrap();
        assert_eq!(read.truth.as_ref(), Some(&truth));
        assert_eq!(warnings.len(), usize::from(upside_down));
    }
    // Beside the object there may be no numbers at all.
    let nowhere = |text: String| text.replace("0 0 0\n", "NaN NaN NaN\n");
    for (text, upside_down) in [(rows.concat(), false), (turned.concat(), true)] {
        let mut files = object_files(&lopsided);
        files.insert("spherePNG/normal.txt", nowhere(text).into_bytes()).unwrap();
        let (read, warnings) = read(&files).unwrap();
        assert_eq!((read.truth.as_ref(), warnings.len()), (Some(&truth), usize::from(upside_down)));
    }
    let mut files = object_files(&lopsided);
    files.insert("spherePNG/normal.txt", "inf 0 1\n".repeat(72).into_bytes()).unwrap();
    let error = read(&files).unwrap_err().to_string();
    assert!(error.contains("normal (inf, 0, 1) is not finite"), "{error}");
    for (text, says) in [
        (format!("{}0 0 1\n", rows.concat()), "an array of more than 72 lines where the mask needs 72 (9×8)"),
        (rows[1..].concat(), "an array of 63 lines where the mask needs 72 (9×8)"),
    ] {
        let mut files = object_files(&lopsided);
        files.insert("spherePNG/normal.txt", text.into_bytes()).unwrap();
        let error = read(&files).unwrap_err().to_string();
        assert!(error.contains(says), "{error}");
    }
}

#[test]
fn every_inconsistency_is_named_with_file_and_line() {
    let text = |t: &str| Some(t.as_bytes().to_vec());
    let grey = |w, h, v| Some(encode_grey(w, h, &vec![v; (w * h) as usize]).unwrap());
    let png16 = || write_object(&fixture()).unwrap().remove(1).1;
    let mat_of = |dims: Vec<usize>, name: &str| {
        let values = vec![0.5; dims.iter().product()];
        Some(mat::write_array(name, &mat::Array { dims, values }))
    };
    let nan_truth = {
        let mut values = vec![0.6; 7 * 9 * 3];
        values[3 * 7 + 2] = f64::NAN; // column 3, row 2
        Some(mat::write_array("Normal_gt", &mat::Array { dims: vec![7, 9, 3], values }))
    };
    let (names, lights, gains) = ("filenames.txt", "light_directions.txt", "light_intensities.txt");
    for (file, content, message) in [
        ("003.png", None, "spherePNG/filenames.txt:3: image '003.png' is missing"),
        (
            names,
            with_line(names, 3, "001.png"),
            "spherePNG/filenames.txt:3: '001.png' stands already on line 1",
        ),
        (
            names,
            with_line(names, 2, "../../etc/passwd"),
            "spherePNG/filenames.txt:2: unsafe name '../../etc/passwd': it goes up a folder",
        ),
        (
            names,
            with_line(names, 2, "C:\\001.png"),
            "spherePNG/filenames.txt:2: unsafe name 'C:\\\\001.png': it is absolute",
        ),
        (names, text("\n \n"), "spherePNG/filenames.txt: missing (it names no image)"),
        (lights, None, "spherePNG/light_directions.txt: missing (a unit vector"),
        (lights, text("0 0 1\n\n0 0 1\n0 0 1\n"), "spherePNG/light_directions.txt: 3 lines for 4 images"),
        (
            lights,
            with_line(lights, 4, "0 0 1\n0 0 1"),
            "spherePNG/light_directions.txt: 5 lines for 4 images",
        ),
        (
            lights,
            with_line(lights, 2, "0 0.6 0.85"),
            "spherePNG/light_directions.txt:2: the light direction has length 1.04",
        ),
        (
            lights,
            with_line(lights, 2, "0 0 0"),
            "spherePNG/light_directions.txt:2: the light direction has length 0.0000, 100.0 % off",
        ),
        (
            lights,
            with_line(lights, 2, "0 0.6 -0.8"),
            "spherePNG/light_directions.txt:2: the light comes from behind the object (z = -0.8)",
        ),
        (lights, with_line(lights, 3, "0 NaN 1"), "spherePNG/light_directions.txt:3: NaN is not finite"),
        (lights, with_line(lights, 3, "0 1e999 1"), "spherePNG/light_directions.txt:3: 1e999 is not finite"),
        (lights, with_line(lights, 3, "0 one 1"), "spherePNG/light_directions.txt:3: 'one' is not a number"),
        (
            lights,
            with_line(lights, 1, "0 1"),
            "spherePNG/light_directions.txt:1: 2 numbers where 3 are needed",
        ),
        (gains, with_line(gains, 4, "1 0 1"), "spherePNG/light_intensities.txt:4: intensity 0 of channel 1"),
        (
            gains,
            with_line(gains, 4, "1 1 -2"),
            "spherePNG/light_intensities.txt:4: intensity -2 of channel 2",
        ),
        (gains, with_line(gains, 4, "1 1e39 1"), "spherePNG/light_intensities.txt:4: 1"),
        (
            gains,
            with_line(gains, 4, "1 1"),
            "spherePNG/light_intensities.txt:4: 2 numbers where 3 (or 1) are needed",
        ),
        (gains, text("1 1 1\n"), "spherePNG/light_intensities.txt: 1 lines for 4 images"),
        ("mask.png", None, "spherePNG/mask.png: missing"),
        ("mask.png", grey(9, 7, 0), "spherePNG/mask.png: the mask is empty: none of its 9×7 pixels"),
        (
            "mask.png",
            grey(9, 8, 255),
            "spherePNG/Normal_gt.mat: an array of 7×9×3 where the mask needs 8×9×3",
        ),
        ("mask.png", text("P5 9 7 255"), "spherePNG/mask.png: not a PNG file (it starts with \"P5 9 7 2\")"),
        ("002.png", grey(7, 9, 1), "spherePNG/002.png: 7×9 pixels where the mask has 9×7"),
        (
            "002.png",
            Some(encode_rgb(9, 7, BitDepth::Eight, &[[1; 3]; 63]).unwrap()),
            "spherePNG/002.png: 8 bits a channel where spherePNG/001.png has 16",
        ),
        (
            "002.png",
            Some(png16()[..100].to_vec()),
            "spherePNG/002.png: the PNG ends too early, after 100 bytes",
        ),
        ("002.png", text(""), "spherePNG/002.png: not a PNG file"),
        ("Normal_gt.mat", text("MATLAB 7.3 MAT-file"), "spherePNG/Normal_gt.mat: MAT version 7.3"),
        ("Normal_gt.mat", text("nothing"), "spherePNG/Normal_gt.mat: not a MAT file"),
        (
            "Normal_gt.mat",
            mat_of(vec![7, 9, 3], "N"),
            "spherePNG/Normal_gt.mat: no variable 'Normal_gt': the file holds N",
        ),
        (
            "Normal_gt.mat",
            mat_of(vec![9, 7, 3], "Normal_gt"),
            "spherePNG/Normal_gt.mat: an array of 9×7×3 where the mask needs 7×9×3",
        ),
        (
            "Normal_gt.mat",
            nan_truth,
            "spherePNG/Normal_gt.mat:column 3, row 2: normal (NaN, 0.6, 0.6) is not finite",
        ),
    ] {
        let found = message_with(file, content);
        assert!(found.starts_with(message), "{file}:\n  {found}\n  {message}");
    }
}

#[test]
fn limits_hold_before_anything_is_decoded() {
    let files = object_files(&fixture());
    let refused = |limits: Limits| Header::read(&files, "spherePNG", &limits).unwrap_err().to_string();
    let default = Limits::default();
    assert!(refused(Limits { images: 3, ..default }).contains("4 images, more than the limit of 3"));
    assert!(
        refused(Limits { pixels: 62, ..default }).contains("mask.png: 9×7 pixels, more than the limit of 62")
    );
    assert!(
        refused(Limits { object_bytes: 100, ..default })
            .contains("bytes of images, more than the limit of 100")
    );
    assert!(refused(Limits { file_bytes: 10, ..default }).contains("more than the limit of 10"));
    // What must fit by default: DiLiGenT10², and a rendered set.
    for (images, pixels) in [(100u64, 1001u64 * 1001), (1000, 128 * 128)] {
        assert!(images * pixels * 6 <= default.object_bytes && images <= default.images as u64);
        assert!(pixels <= default.pixels as u64);
    }
    assert_valid(&read(&files).unwrap().0);
}

#[cfg(feature = "cli")]
mod command_line {
    use super::*;
    use std::path::{Path, PathBuf};
    use std::process::{Command, Output};

    /// A folder of its own, removed at the end.
    struct Scratch(PathBuf);

    impl Scratch {
        fn new(name: &str) -> Self {
            let path = std::env::temp_dir().join(format!("coil-ps-{name}-{}", std::process::id()));
            std::fs::create_dir_all(&path).unwrap();
            Self(path)
        }

        fn put(&self, files: &Memory) {
            for name in files.names() {
                let path = self.0.join(name);
                std::fs::create_dir_all(path.parent().unwrap()).unwrap();
                std::fs::write(path, files.read(name).unwrap()).unwrap();
            }
        }
    }

    impl Drop for Scratch {
        fn drop(&mut self) {
            let _ = std::fs::remove_dir_all(&self.0);
        }
    }

    fn coil(folder: &Path, args: &[&str]) -> Output {
        Command::new(env!("CARGO_BIN_EXE_coil")).current_dir(folder).args(args).output().unwrap()
    }

    #[test]
    fn info_goes_on_after_a_broken_object_and_its_status_says_so() {
        let scratch = Scratch::new("info");
        scratch.put(&object_files(&fixture()));
        let good = coil(&scratch.0, &["info", ".", "--json"]);
        assert!(good.status.success());
        let mut broken = changed("003.png", Some(b"no image".to_vec()));
        let png = encode_rgb(3, 3, BitDepth::Sixteen, &[[1; 3]; 9]).unwrap();
        broken.insert("spherePNG/002.png", png).unwrap();
        scratch.put(&broken);
        let mut other = fixture();
        other.name = "z".into();
        scratch.put(&object_files(&other));

        let out = coil(&scratch.0, &["info", ".", "nowhere", "--json"]);
        assert_eq!(out.status.code(), Some(1));
        let report: serde_json::Value = serde_json::from_slice(&out.stdout).unwrap();
        assert_eq!(report["schema"], "coil-ps/info/1");
        let objects = report["objects"].as_array().unwrap();
        assert_eq!(objects.len(), 3);
        // Every broken image, not only the first.
        let errors: Vec<&str> =
            objects[0]["errors"].as_array().unwrap().iter().filter_map(|e| e.as_str()).collect();
        assert!(
            errors[0].contains("002.png: 3×3 pixels") && errors[1].contains("003.png: not a PNG"),
            "{errors:?}"
        );
        assert_eq!((&objects[1]["object"], &objects[1]["bits"]), (&"z".into(), &16.into()));
        assert_eq!(objects[1]["errors"].as_array().unwrap().len(), 0);
        assert!(objects[2]["errors"][0].as_str().unwrap().contains("nowhere: no such file or folder"));
        let image = coil(&scratch.0, &["info", "spherePNG/002.png"]);
        let said = String::from_utf8(image.stdout).unwrap();
        assert!(said.contains("spherePNG/002.png: neither a folder nor a zip archive"), "{said}");

        let text = String::from_utf8(coil(&scratch.0, &["info", "."]).stdout).unwrap();
        assert!(text.contains("ERROR: ") && text.contains("images    4 of 9×7 pixels, 16 bit"), "{text}");
    }

    #[test]
    fn every_export_is_read_back() {
        let scratch = Scratch::new("export");
        scratch.put(&object_files(&fixture()));
        let export = |to: &str| coil(&scratch.0, &["export", "spherePNG", "--to", to, "--out", "out"]);
        for to in ["lp", "csv", "diligent", "zip", "normals", "submission"] {
            let out = export(to);
            assert!(out.status.success(), "{to}: {}", String::from_utf8_lossy(&out.stderr));
        }
        assert_eq!(export("lp").status.code(), Some(1), "nothing is overwritten unasked");
        let bytes = |name: &str| std::fs::read(scratch.0.join("out").join(name)).unwrap();
        let lights = coil_ps::dataset::lp::read_lp(&bytes("sphere.lp"), "sphere.lp").unwrap();
        assert_eq!(lights.iter().map(|l| l.1).collect::<Vec<_>>(), fixture().lights);
        assert_eq!(String::from_utf8(bytes("sphere_lights.csv")).unwrap().lines().count(), 5);
        let zip = Zip::new(bytes("sphere.zip"), "sphere.zip", &Limits::default()).unwrap();
        assert_same(&read(&zip).unwrap().0, &fixture());
        assert_same(&read(&support::folder_files(&scratch.0.join("out/spherePNG"))).unwrap().0, &fixture());
        let truth = fixture().truth.unwrap();
        let picture = fixture().mask.gather(&decode_png(&bytes("sphere_normals.png"), 100).unwrap().rgb);
        for (rgb, n) in picture.iter().zip(&truth) {
            assert!((Vec3::from(rgb.map(|v| f32::from(v) / 32767.5 - 1.0)) - *n).length() < 1e-4);
        }
        // A matt sphere is solved to the rounding of 16-bit images, but where a light does not reach.
        let solved = mat::read_array(&bytes("sphere.mat"), "Normal_est", 1000).unwrap();
        let middle = |c: usize| solved.values[c * 63 + 4 * 7 + 3]; // column 4, row 3
        assert!(middle(0).abs() < 1e-3 && middle(1).abs() < 1e-3 && middle(2) > 0.999);
    }
}
