//! Runs a trained policy: each new picture is encoded once, attention's keys and values of the earlier ones are kept.

use super::config::Config;
use super::file::{self, Header, ModelError, ModelFiles, chain};
use super::frame::Frames;
use crate::stack::Mask;
use glam::Vec3;
use std::f32::consts::FRAC_PI_2;
use tract_onnx::prelude::*;

/// As a fraction of 90°.
const SMALLEST_REACH: f32 = 1e-3;

type Plan = Arc<TypedRunnableModel>;

/// Lights that reach farther than this (radians, 86°) are taken for the whole hemisphere.
pub const WHOLE: f32 = 86.0 / 180.0 * std::f32::consts::PI;

/// A loaded policy: one network, or one for the whole hemisphere and another for a limited reach.
#[derive(Clone)]
pub struct Policy {
    header: Header,
    encoder: Plan,
    step: Plan,
    limited: Option<Arc<Policy>>,
}

impl std::fmt::Debug for Policy {
    fn fmt(&self, f: &mut std::fmt::Formatter<'_>) -> std::fmt::Result {
        f.debug_struct("Policy").field("header", &self.header).finish_non_exhaustive()
    }
}

impl Policy {
    /// Loads and checks the two files of a policy and prepares them for running.
    ///
    /// # Errors
    /// [`ModelError`] for files that are damaged, of another version or don't belong together.
    pub fn load(files: &ModelFiles) -> Result<Self, ModelError> {
        let (encoder, header) = file::read("encoder", &files.encoder)?;
        let (step, step_header) = file::read("step", &files.step)?;
        file::pair(&header, &step_header)?;
        let plan = |proto| -> TractResult<Plan> {
            tract_onnx::onnx().model_for_proto_model(proto)?.into_optimized()?.into_runnable()
        };
        let run = |e: TractError| ModelError::Run(chain(&e));
        Ok(Self {
            header,
            encoder: plan(&encoder).map_err(run)?,
            step: plan(&step).map_err(run)?,
            limited: None,
        })
    }

    /// The same with another network that plans where lights reach no farther than [`WHOLE`].
    #[must_use]
    pub fn with_limited(self, limited: Self) -> Self {
        Self { limited: Some(Arc::new(limited)), ..self }
    }

    /// What plans within `reach` (radians).
    #[must_use]
    pub fn within(&self, reach: f32) -> &Self {
        match &self.limited {
            Some(limited) if reach <= WHOLE => limited,
            _ => self,
        }
    }

    /// Sizes of its network.
    #[must_use]
    pub fn config(&self) -> &Config {
        &self.header.config
    }

    /// What the files say of themselves.
    #[must_use]
    pub fn header(&self) -> &Header {
        &self.header
    }

    /// A new sequence: an object's mask, the largest slant of a light (radians), and how many pictures there will be.
    #[must_use]
    pub fn start(&self, mask: &Mask, reach: f32, lights: usize) -> Sequence {
        let network = self.within(reach);
        let config = network.header.config.clone();
        let cache = if config.transformer { config.cache_shape().iter().product() } else { 0 };
        Sequence {
            policy: network.clone(),
            frames: Frames::new(mask, config.input),
            pixels: mask.len(),
            reach: (reach / FRAC_PI_2).clamp(SMALLEST_REACH, 1.0),
            told: config.told(lights),
            position: 0,
            keys: vec![0.0; cache],
            values: vec![0.0; cache],
            frame: Vec::new(),
            gate: None,
        }
    }
}

/// One object's capture in progress, as the policy sees it.
#[derive(Clone, Debug)]
pub struct Sequence {
    policy: Policy,
    frames: Frames,
    pixels: usize,
    reach: f32,
    /// Number of pictures that the policy is told.
    told: usize,
    position: usize,
    keys: Vec<f32>,
    values: Vec<f32>,
    /// The newest frame, as the network takes it.
    frame: Vec<f32>,
    gate: Option<Vec<f32>>,
}

impl Sequence {
    /// Takes in the newest picture (linear RGB of the mask pixels) and the direction it was taken under; gives the next
    /// direction, a unit vector whose slant is within reach.
    ///
    /// # Errors
    /// [`ModelError::Run`] for a picture that doesn't fit the mask or isn't finite, or more pictures than the network takes.
    pub fn observe(&mut self, rgb: &[[f32; 3]], light: Vec3) -> Result<Vec3, ModelError> {
        let config = self.policy.header.config.clone();
        if rgb.len() != self.pixels {
            return Err(ModelError::Run(format!(
                "a picture of {} pixels, the mask has {}",
                rgb.len(),
                self.pixels
            )));
        }
        if !rgb.as_flattened().iter().all(|v| v.is_finite()) || !light.is_finite() || light == Vec3::ZERO {
            return Err(ModelError::Run("the picture or its light direction is not finite".into()));
        }
        if self.position >= config.max_frames {
            return Err(ModelError::Run(format!(
                "picture {}: this network plans at most {} lights",
                self.position + 1,
                config.max_frames
            )));
        }
        self.frame = self.frames.next(rgb);
        let direction = self.forward(&config, light.normalize()).map_err(|e| ModelError::Run(chain(&e)))?;
        direction.try_normalize().ok_or_else(|| ModelError::Run("the network gave no direction".into()))
    }

    /// The newest frame as the network took it, `[3, input, input]`; empty before the first picture.
    #[must_use]
    pub fn frame(&self) -> &[f32] {
        &self.frame
    }

    /// The gate of the newest picture, `input × input`, 1 where a pixel is trusted; `None` before the first picture and for
    /// a network without gate.
    #[must_use]
    pub fn gate(&self) -> Option<&[f32]> {
        self.gate.as_deref()
    }

    /// [`gate`](Self::gate) at every mask pixel.
    #[must_use]
    pub fn trust(&self) -> Option<Vec<f32>> {
        Some(self.frames.crop.spread(self.gate.as_ref()?, self.pixels))
    }

    /// Pictures taken in.
    #[must_use]
    pub fn seen(&self) -> usize {
        self.position
    }

    fn forward(&mut self, config: &Config, light: Vec3) -> TractResult<Vec3> {
        let s = config.input;
        let frame = Tensor::from_shape(&[1, 3, s, s], &self.frame)?;
        let encoded = self.policy.encoder.run(tvec!(frame.into()))?;
        let mut inputs = tvec!(
            encoded[0].clone(),
            Tensor::from_shape(&[1, 3], &light.to_array())?.into(),
            Tensor::from_shape(&[1, 1], &[self.reach])?.into(),
        );
        self.gate = match encoded.get(1) {
            Some(gate) => Some(floats(gate)?),
            None => None,
        };
        if config.horizon > 0 {
            inputs.push(Tensor::from_shape(&[1], &[self.told as i64])?.into());
        }
        if config.counts_steps() {
            inputs.push(Tensor::from_shape(&[1], &[self.position as i64])?.into());
        }
        if config.transformer {
            let shape = config.cache_shape();
            inputs.push(Tensor::from_shape(&shape, &self.keys)?.into());
            inputs.push(Tensor::from_shape(&shape, &self.values)?.into());
        }
        let outputs = self.policy.step.run(inputs)?;
        if config.transformer {
            let size = config.width / config.heads;
            for (cache, new) in [(&mut self.keys, &outputs[1]), (&mut self.values, &outputs[2])] {
                for (i, entry) in floats(new)?.chunks_exact(size).enumerate() {
                    let at = (i * config.max_frames + self.position) * size;
                    cache[at..at + size].copy_from_slice(entry);
                }
            }
        }
        self.position += 1;
        let d = floats(&outputs[0])?;
        Ok(Vec3::new(d[0], d[1], d[2].max(0.0)))
    }
}

fn floats(t: &TValue) -> TractResult<Vec<f32>> {
    Ok(t.to_plain_array_view::<f32>()?.iter().copied().collect())
}
