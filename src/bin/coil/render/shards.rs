//! What `coil render` writes beside its objects, and joining the folders of several jobs by it.

use crate::output;
use anyhow::{Context, bail};
use coil_ps::render::Sensor;
use serde::{Deserialize, Serialize};
use std::path::{Path, PathBuf};
use std::process::ExitCode;

/// What a run wrote, kept beside the objects (`render.json`, of a shard `render-I-of-N.json`).
#[derive(Debug, Serialize, Deserialize)]
pub struct Manifest {
    pub version: String,
    pub objects: Vec<String>,
    pub lights: Vec<[f32; 3]>,
    pub size: u32,
    pub bounces: u32,
    pub seed: u64,
    pub sensor: Sensor,
    #[serde(default, skip_serializing_if = "Option::is_none")]
    pub shard: Option<[usize; 2]>,
    /// All that the command was asked for: equal in the shards of one set.
    pub request: Vec<String>,
    pub rendered: Vec<Rendered>,
}

#[derive(Debug, Serialize, Deserialize)]
pub struct Rendered {
    pub name: String,
    pub images: usize,
    pub pixels: usize,
    /// Fingerprint of all files.
    pub checksum: String,
}

pub fn report(manifest: &Manifest, out: &Path, total: usize, json: bool) -> anyhow::Result<ExitCode> {
    if json {
        output::write_json(Path::new("-"), manifest)?;
    } else {
        let images: usize = manifest.rendered.iter().map(|r| r.images).sum();
        println!("{} of {total} objects, {images} images: {}", manifest.rendered.len(), out.display());
    }
    Ok(ExitCode::SUCCESS)
}

pub fn shard(text: &str) -> anyhow::Result<[usize; 2]> {
    let parsed = text.split_once('/').and_then(|(i, n)| Some([i.parse().ok()?, n.parse().ok()?]));
    match parsed {
        Some([i, n]) if i >= 1 && i <= n => Ok([i, n]),
        _ => bail!("--shard {text}: write I/N with 1 ≤ I ≤ N, as 3/8"),
    }
}

/// Joins the folders of all shards of one set.
pub fn merge(folders: &[String], out: &Path, json: bool) -> anyhow::Result<ExitCode> {
    let mut shards: Vec<(PathBuf, Manifest)> = Vec::new();
    for folder in folders {
        for entry in std::fs::read_dir(folder).with_context(|| folder.clone())? {
            let path = entry?.path();
            let name = path.file_name().unwrap_or_default().to_string_lossy().into_owned();
            if name.starts_with("render-") && name.ends_with(".json") {
                let text = std::fs::read_to_string(&path)?;
                let manifest = serde_json::from_str(&text).with_context(|| path.display().to_string())?;
                shards.push((PathBuf::from(folder), manifest));
            }
        }
    }
    shards.sort_by_key(|s| s.1.shard);
    let Some((_, first)) = shards.first() else {
        bail!("no render-I-of-N.json in {}: are these folders of --shard runs?", folders.join(", "))
    };
    let of = first.shard.map_or(1, |s| s[1]);
    let same = |m: &Manifest| {
        (m.request == first.request, m.size, m.bounces, m.seed, m.sensor, &m.lights, m.shard.map(|s| s[1]))
            == (true, first.size, first.bounces, first.seed, first.sensor, &first.lights, Some(of))
    };
    if let Some((folder, _)) = shards.iter().find(|s| !same(&s.1)) {
        bail!("{}: rendered with other settings than {}", folder.display(), shards[0].0.display());
    }
    let parts: Vec<usize> = shards.iter().filter_map(|s| Some(s.1.shard?[0])).collect();
    if let Some(missing) = (1..=of).find(|part| !parts.contains(part)) {
        bail!("shard {missing}/{of} is missing");
    }
    if let Some(twice) = (1..=of).find(|part| parts.iter().filter(|p| *p == part).count() > 1) {
        bail!("shard {twice}/{of} is there twice");
    }
    let mut rendered = Vec::new();
    for (folder, manifest) in &mut shards {
        for object in std::mem::take(&mut manifest.rendered) {
            let (from, to) = (folder.join(&object.name), out.join(&object.name));
            if from != to {
                std::fs::create_dir_all(&to).with_context(|| to.display().to_string())?;
                for file in std::fs::read_dir(&from).with_context(|| from.display().to_string())? {
                    let file = file?;
                    std::fs::copy(file.path(), to.join(file.file_name()))?;
                }
            }
            rendered.push(object);
        }
    }
    rendered.sort_by(|a, b| a.name.cmp(&b.name));
    let total = rendered.len();
    let manifest = Manifest { shard: None, rendered, ..shards.swap_remove(0).1 };
    output::write_json(&out.join("render.json"), &manifest)?;
    report(&manifest, out, total, json)
}
