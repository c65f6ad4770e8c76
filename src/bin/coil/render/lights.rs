//! `--lights` of `coil render`.

use anyhow::{Context, bail};
use coil_ps::dataset::lp;
use coil_ps::light::{fibonacci_hemisphere, ring};
use glam::Vec3;
use std::path::{Path, PathBuf};

/// Light directions of all `--lights` together.
pub fn lights(texts: &[String]) -> anyhow::Result<Vec<Vec3>> {
    let mut all = Vec::new();
    for text in texts {
        all.extend(light_set(text)?);
    }
    if all.is_empty() {
        bail!("--lights names no light");
    }
    Ok(all)
}

fn light_set(text: &str) -> anyhow::Result<Vec<Vec3>> {
    let vector = |line: &str, split: fn(char) -> bool, place: &str| -> anyhow::Result<Vec3> {
        let numbers: Vec<f32> = line
            .split(split)
            .filter(|w| !w.is_empty())
            .map(|w| w.trim().parse())
            .collect::<Result<_, _>>()
            .with_context(|| format!("{place}: '{line}'"))?;
        let [x, y, z] = numbers[..] else { bail!("{place}: '{line}': a direction is three numbers") };
        let v = Vec3::new(x, y, z);
        if !(v.is_finite() && v.length() > 1e-6 && z >= 0.0) {
            bail!("{place}: '{line}': a direction towards a light has z ≥ 0 and is not zero");
        }
        Ok(v.normalize())
    };
    let parts: Vec<&str> = text.split(':').collect();
    match parts[..] {
        ["fibonacci", k] => {
            let k: usize = k.parse().with_context(|| format!("--lights {text}"))?;
            return Ok(fibonacci_hemisphere(k));
        }
        ["ring", k, slant] => {
            let (k, slant): (usize, f32) = (k.parse()?, slant.parse()?);
            if !(slant > 0.0 && slant <= 90.0) {
                bail!("--lights {text}: the slant lies in (0, 90] degrees");
            }
            return Ok(ring(k, slant.to_radians(), 0.0));
        }
        _ => {}
    }
    if text.matches(',').count() == 2 && !Path::new(text).exists() {
        return Ok(vec![vector(text, |c| c == ',', "--lights")?]);
    }
    let mut file = PathBuf::from(text);
    if file.is_dir() {
        file.push("light_directions.txt");
    }
    let bytes = std::fs::read(&file).with_context(|| {
        format!("--lights {text}: write fibonacci:K, ring:K:SLANT, x,y,z or the name of a .lp or text file or an object's folder")
    })?;
    let name = file.to_string_lossy();
    if name.to_ascii_lowercase().ends_with(".lp") {
        return Ok(lp::read_lp(&bytes, &name)?.into_iter().map(|l| l.1).collect());
    }
    let content = String::from_utf8_lossy(&bytes);
    let lines = content.lines().enumerate().filter(|(_, l)| !l.trim().is_empty());
    lines.map(|(i, l)| vector(l, char::is_whitespace, &format!("{name}:{}", i + 1))).collect()
}
