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
    let parts: Vec<&str> = text.split(':').collect();
    match parts[..] {
        ["fibonacci", k] => {
            let k: usize =
                k.parse().with_context(|| format!("--lights {text}: fibonacci:K, K the number of lights"))?;
            return Ok(fibonacci_hemisphere(k));
        }
        ["ring", k, slant] => {
            let wrong = || {
                format!("--lights {text}: ring:K:SLANT, K the number of lights, the slant in (0, 90] degrees")
            };
            let (k, slant): (usize, f32) =
                (k.parse().with_context(wrong)?, slant.parse().with_context(wrong)?);
            if !(slant > 0.0 && slant <= 90.0) {
                bail!(wrong());
            }
            return Ok(ring(k, slant.to_radians(), 0.0));
        }
        _ => {}
    }
    if text.matches(',').count() == 2 && !Path::new(text).exists() {
        return Ok(lp::read_directions(text.as_bytes(), "--lights")?);
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
    Ok(lp::read_directions(&bytes, &name)?)
}
