//! Sizes of the policy network: one architecture, two named configurations, two ablations.

use serde::{Deserialize, Serialize};

/// Version of the model files this build reads and writes.
pub const FORMAT: u32 = 2;

/// Fewest pictures that normals can be solved from.
const FEWEST: usize = 3;

/// Every size of the network (COIL-PS; `docs/policy.md`).
#[derive(Clone, Debug, PartialEq, Eq, Serialize, Deserialize)]
pub struct Config {
    /// Name of the size: `paper`, `compact` or a test's own.
    pub size: String,
    /// Side of the square input frame, pixels.
    pub input: usize,
    /// Channels of the encoder's four scales; the last is the width of a feature map.
    pub channels: [usize; 4],
    /// How many of the encoder's four 2×2 max-pools are used (the first ones).
    pub pools: usize,
    /// Width of the transformer.
    pub width: usize,
    /// Layers of the transformer.
    pub layers: usize,
    /// Attention heads.
    pub heads: usize,
    /// Hidden width of the transformer's feed-forward part.
    pub feed_forward: usize,
    /// Hidden width of the light embedding, whose output has `channels[3] / 4` values.
    pub light_hidden: usize,
    /// Hidden width of the direction decoder.
    pub head_hidden: usize,
    /// Most frames a sequence may have.
    pub max_frames: usize,
    /// Outlier-aware gating; without it F̃ = F_img (an ablation of the paper).
    pub gating: bool,
    /// A learned direction for each step, to which the decoder adds what it sees. Not in the paper, whose network must learn to
    /// tell its steps apart from the positional encoding alone.
    pub base: bool,
    /// Largest number of pictures T that the policy was trained to plan for and is told; 0: it isn't told how many there will be. Not in
    /// the paper, whose policy places its third light alike whether it is the last or the third of ten.
    #[serde(default)]
    pub horizon: usize,
    /// Causal transformer and positional encoding; without them each frame stands alone (the other ablation).
    pub transformer: bool,
}

/// Why a network can't be built: the size that is wrong, and what would be right.
#[derive(Debug, thiserror::Error, PartialEq)]
#[error("{0}")]
pub struct ConfigError(String);

impl Config {
    /// The network as the paper specifies it.
    #[must_use]
    pub fn paper() -> Self {
        Self {
            size: "paper".into(),
            input: 128,
            channels: [32, 64, 128, 256],
            pools: 4,
            width: 1024,
            layers: 2,
            heads: 8,
            feed_forward: 2048,
            light_hidden: 32,
            head_hidden: 32,
            max_frames: 32,
            gating: true,
            base: false,
            horizon: 0,
            transformer: true,
        }
    }

    /// A quarter of the channels, an eighth of the transformer's width, 32×32 frames: what two CPU cores
    /// train in an hour and a browser runs in milliseconds. The shipped networks were then trained on with frames of 64×64
    /// ([`seeing`](Self::seeing)).
    #[must_use]
    pub fn compact() -> Self {
        Self {
            size: "compact".into(),
            input: 32,
            channels: [8, 16, 32, 64],
            pools: 3,
            width: 128,
            layers: 2,
            heads: 4,
            feed_forward: 256,
            light_hidden: 8,
            base: true,
            ..Self::paper()
        }
    }

    /// The configuration of a named size.
    ///
    /// # Errors
    /// [`UnknownSize`] with the names there are.
    pub fn by_name(size: &str) -> Result<Self, UnknownSize> {
        match size {
            "paper" => Ok(Self::paper()),
            "compact" => Ok(Self::compact()),
            _ => Err(UnknownSize(size.into())),
        }
    }

    /// The same network on frames of another side: more or fewer of its max-pools, so that the feature map and with it every
    /// weight keeps its shape.
    ///
    /// # Errors
    /// [`ConfigError`] with the sides that are possible.
    pub fn seeing(&self, input: usize) -> Result<Self, ConfigError> {
        let sides: Vec<usize> = (0..=4).map(|pools| self.grid() << pools).collect();
        match sides.iter().position(|&side| side == input) {
            Some(pools) => Ok(Self { input, pools, ..self.clone() }),
            None => {
                Err(ConfigError(format!("frames of {input}×{input}: this network takes a side of {sides:?}")))
            }
        }
    }

    /// Side of the feature map, in cells.
    #[must_use]
    pub fn grid(&self) -> usize {
        self.input >> self.pools
    }

    /// Locations of the feature map; each is a sequence of its own for the transformer.
    #[must_use]
    pub fn locations(&self) -> usize {
        self.grid() * self.grid()
    }

    /// Values of a light embedding, and channels of the appearance features it is fused with.
    #[must_use]
    pub fn embedding(&self) -> usize {
        self.channels[3] / 4
    }

    /// Shape of a sequence's cache of attention keys (and of that of values): layer, location and head, frame, feature.
    #[must_use]
    pub fn cache_shape(&self) -> [usize; 4] {
        [self.layers, self.locations() * self.heads, self.max_frames, self.width / self.heads]
    }

    /// Whether a step must know its number.
    #[must_use]
    pub fn counts_steps(&self) -> bool {
        self.transformer || self.base
    }

    /// What the policy is told where `lights` pictures are planned: a number of pictures that it was trained for.
    #[must_use]
    pub fn told(&self, lights: usize) -> usize {
        lights.clamp(FEWEST.min(self.horizon), self.horizon)
    }

    /// Refuses sizes the network can't be built with; a damaged model file must not ask for any memory it likes.
    ///
    /// # Errors
    /// [`ConfigError`] with the size that is wrong.
    pub fn check(&self) -> Result<(), ConfigError> {
        let sizes = [
            self.input,
            self.width,
            self.layers,
            self.heads,
            self.feed_forward,
            self.light_hidden,
            self.head_hidden,
        ];
        if sizes.iter().chain(&self.channels).any(|&n| n == 0 || n > 4096) {
            return Err(ConfigError("a size is 0 or above 4096".into()));
        }
        if self.pools > 4 || !self.input.is_multiple_of(1 << self.pools) || self.input > 512 {
            return Err(ConfigError(format!(
                "input {} can't be halved {} times (4 at most)",
                self.input, self.pools
            )));
        }
        if !self.grid().is_multiple_of(4) {
            return Err(ConfigError(format!(
                "the feature map is {0}×{0}: its side must be a multiple of 4",
                self.grid()
            )));
        }
        if !self.width.is_multiple_of(2 * self.heads) {
            return Err(ConfigError(format!(
                "width {} is no multiple of 2 × {} heads",
                self.width, self.heads
            )));
        }
        if !self.channels[3].is_multiple_of(4) {
            return Err(ConfigError(format!(
                "{} feature channels: must be a multiple of 4",
                self.channels[3]
            )));
        }
        if self.horizon > self.max_frames || (self.horizon > 0 && (!self.base || self.horizon < FEWEST)) {
            return Err(ConfigError(format!(
                "a horizon of {} pictures: 0, or {FEWEST} to {} with a learned base",
                self.horizon, self.max_frames
            )));
        }
        if self.layers > 16 || !(2..=256).contains(&self.max_frames) {
            return Err(ConfigError(format!(
                "{} layers, {} frames: at most 16 and 2 to 256",
                self.layers, self.max_frames
            )));
        }
        Ok(())
    }

    /// Sinusoidal encoding of frame `position` (0 the first): `width` values, sine and cosine alternating.
    #[must_use]
    pub fn position(&self, position: usize) -> Vec<f32> {
        (0..self.width)
            .map(|k| {
                let rate = libm::pow(10_000.0, -((k / 2 * 2) as f64) / self.width as f64);
                let phase = position as f64 * rate;
                (if k % 2 == 0 { libm::sin(phase) } else { libm::cos(phase) }) as f32
            })
            .collect()
    }
}

/// Why there is no such size.
#[derive(Debug, thiserror::Error, PartialEq)]
#[error("no network size '{0}': choose compact or paper")]
pub struct UnknownSize(String);

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn named_sizes_are_sound() {
        for size in ["paper", "compact"] {
            let c = Config::by_name(size).unwrap();
            c.check().unwrap();
            assert_eq!(c.size, size);
        }
        assert_eq!(Config::paper().grid(), 8);
        assert!(Config::by_name("huge").is_err());
        assert!(Config { input: 33, ..Config::compact() }.check().is_err());
        assert!(Config { heads: 7, ..Config::compact() }.check().is_err());
        assert!(Config { horizon: 33, ..Config::compact() }.check().is_err());
        assert!(Config { horizon: 10, base: false, ..Config::compact() }.check().is_err());
    }

    #[test]
    fn larger_frames_leave_the_feature_map_as_it_is() {
        let fine = Config::compact().seeing(64).unwrap();
        fine.check().unwrap();
        assert_eq!((fine.input, fine.pools, fine.grid()), (64, 4, Config::compact().grid()));
        assert!(Config::compact().seeing(48).unwrap_err().to_string().contains("[4, 8, 16, 32, 64]"));
    }

    #[test]
    fn the_policy_is_told_only_what_it_was_trained_for() {
        let told = |horizon, lights| Config { horizon, ..Config::compact() }.told(lights);
        assert_eq!([told(10, 5), told(10, 20), told(10, 1)], [5, 10, 3]);
        assert_eq!(told(0, 5), 0);
    }

    #[test]
    fn positions_differ_and_start_at_zero_phase() {
        let c = Config::compact();
        let p0 = c.position(0);
        assert!(p0.iter().enumerate().all(|(k, &v)| v == (k % 2) as f32));
        let all: Vec<_> = (0..c.max_frames).map(|i| c.position(i)).collect();
        for i in 1..all.len() {
            let d: f32 = all[i].iter().zip(&all[i - 1]).map(|(a, b)| (a - b).powi(2)).sum();
            assert!(d > 0.5);
        }
    }
}
