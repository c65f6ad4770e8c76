//! The training loop as a value: make a step, save everything, go on from what was saved as if nothing had happened.

use super::adamw::{AdamW, clip};
use super::compute::Compute;
use super::formation::{Lookup, Scene, light_set};
use super::loss::{LeastSquares, Measure, TrainingSolver};
use super::rollout::{Conditions, Episode, Pass, differentiate};
use super::weights::Weights;
use crate::light::fibonacci_cap;
use crate::policy::config::{Config, ConfigError};
use crate::render::{MAX_SIZE, RenderError};
use crate::rng::Rng;
use serde::{Deserialize, Serialize};
use std::f32::consts::{FRAC_PI_2, PI};

/// Smallest side of training pictures, pixels.
const SMALLEST: u32 = 16;

/// Everything that decides what a run does: the same recipe gives the same weights, bit for bit.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize)]
pub struct Recipe {
    /// The network.
    pub config: Config,
    /// Seed of the weights and of every draw.
    pub seed: u64,
    /// Name of the run whose best weights this one began with, if it did not begin with fresh ones.
    #[serde(default)]
    pub from: Option<String>,
    /// Folder of meshes that some of the training objects are; without it all are sculptures.
    #[serde(default)]
    pub meshes: Option<String>,
    /// Whether sequences of limited reach, as all real rigs have it, show real life's variety: objects turned about the
    /// optical axis at random, rigs good and bad, lights near and far. Over the whole hemisphere objects stand upright before
    /// the careful rig all the same.
    #[serde(default)]
    pub varied: bool,
    /// Whether objects of varied sequences are of any material ([`crate::render::Material::any`]): measured ones alone are metals and
    /// plastics for the most part.
    #[serde(default)]
    pub any_material: bool,
    /// Objects in the training pool.
    pub objects: usize,
    /// Side of the training pictures, pixels.
    pub resolution: u32,
    /// Updates.
    pub steps: u64,
    /// Sequences an update.
    pub batch: usize,
    /// Sequences differentiated together; the batch's gradient is the sum over these, in order, however many threads work.
    pub micro_batch: usize,
    /// Pictures a sequence, T.
    pub lights: usize,
    /// Learning rate.
    pub rate: f32,
    /// Whether the rate falls to zero along a cosine.
    pub cosine: bool,
    /// Share of the old in the running average of the weights that is validated and shipped, each update; 0: the weights themselves.
    /// One update's gradient is mostly noise: at a rate of 3e-4 the weights' own validation error goes up and down by half a degree.
    #[serde(default)]
    pub averaging: f32,
    /// Updates over which the rate rises at the start.
    pub warm_up: u64,
    /// Weight decay.
    pub decay: f32,
    /// Largest length of a gradient.
    pub clip: f32,
    /// Softness of shadow boundaries.
    pub softness: f32,
    /// Temperature of soft interpolation, radians; `None`: pictures at exactly the direction asked for.
    pub tau: Option<f32>,
    /// Share of sequences over the whole hemisphere.
    pub whole_dome: f32,
    /// Share of sequences with the nearest of a finite light set; the rest has a random reach.
    pub finite: f32,
    /// Black frames: what is learned is one fixed light set.
    pub blank: bool,
    /// Share of the gradient that flows back through the pictures as the policy saw them, 1 for all of it. A highlight moves
    /// fast and ten steps multiply: with features of unit scale the gradient's length reached 20 000 at 1, and 30 000 at
    /// 0.1, where the loss's own is about 1. The gradient through pictures, solver and loss is always whole.
    pub feedback: f32,
    /// Largest length of dLoss/d(direction) of one picture. For the cosine their median is 0.02 (the last light) to 0.2 (the
    /// first), for the angle some five times that; a highlight
    /// that sweeps over a pixel gives a hundred times that, and says nothing of where the light should go.
    pub steepest: f32,
    /// What the loss measures.
    pub measure: Measure,
    /// The picture after which the loss is measured first; 4 in the paper. Three lights are then placed for what comes after
    /// alone, and normals from three pictures are bad. A policy that is told how many there will be has it at the last.
    #[serde(default = "fourth")]
    pub first_loss: usize,
    /// Name of the solver.
    pub solver: String,
}

fn fourth() -> usize {
    4
}

/// Smallest reach trained for, radians (25°).
const SHORTEST_REACH: f32 = 25.0 * PI / 180.0;
/// Largest reach of the finite light sets, radians (65°).
const LONGEST_STAGE: f32 = 65.0 * PI / 180.0;
/// Reach in the validation of policies for limited reach, radians (45°): the middle of what they are trained for.
const LIMITED_VALIDATION: f32 = 45.0 * PI / 180.0;
/// Makes the numbers of pictures of the updates independent of what else is drawn.
const LENGTHS: u64 = 0x6c65_6e67;
/// Makes what is drawn of reach and look-up independent of the object, which may depend on it.
const STAGES: u64 = 0x706c_6163;
/// Stored lights of soft interpolation (the paper's K).
const STORED: usize = 1000;

/// Why a recipe can't be followed.
#[derive(Debug, thiserror::Error, PartialEq)]
pub enum RecipeError {
    /// The network can't be built.
    #[error(transparent)]
    Network(#[from] ConfigError),
    /// There is no such solver to train through.
    #[error("no training solver '{0}': choose from ls")]
    Solver(String),
    /// A number that can't be meant, and what would be right.
    #[error("{0}")]
    Value(String),
}

/// Why an update was not made.
#[derive(Debug, thiserror::Error)]
pub enum UpdateError {
    /// The recipe is not one.
    #[error(transparent)]
    Recipe(#[from] RecipeError),
    /// An object of the update can't be seen.
    #[error("update {update}: an object can't be rendered: {error}")]
    Object {
        /// Which update, from 1.
        update: u64,
        /// Why not.
        error: RenderError,
    },
    /// The loss or its gradient is not finite.
    #[error("update {update}: loss {loss}, gradient {gradient}: not finite")]
    NotFinite {
        /// Which update, from 1.
        update: u64,
        /// The loss.
        loss: f64,
        /// Length of the gradient.
        gradient: f32,
    },
}

impl Recipe {
    /// For two CPU cores: the learning rate of a small network, random reaches and light sets.
    #[must_use]
    pub fn compact() -> Self {
        Self {
            config: Config::compact(),
            seed: 1,
            from: None,
            meshes: None,
            varied: false,
            any_material: false,
            objects: 2000,
            resolution: 40,
            steps: 3000,
            batch: 8,
            micro_batch: 8,
            lights: 10,
            rate: 5e-4,
            cosine: true,
            averaging: 0.0,
            warm_up: 50,
            decay: 1e-4,
            clip: 4.0,
            softness: 0.05,
            tau: None,
            whole_dome: 0.6,
            finite: 0.2,
            blank: false,
            feedback: 0.0,
            steepest: 0.5,
            measure: Measure::Angle,
            first_loss: 3,
            solver: "ls".into(),
        }
    }

    /// The paper's: AdamW 1e-5, decay 1e-8, constant rate, batch 8, 500 epochs of 1000 objects, soft interpolation over
    /// 1000 stored lights. τ is not given there; 0.02 blends about three pictures.
    #[must_use]
    pub fn paper() -> Self {
        Self {
            config: Config::paper(),
            objects: 1000,
            resolution: 128,
            steps: 62_500,
            batch: 8,
            micro_batch: 1,
            rate: 1e-5,
            cosine: false,
            warm_up: 0,
            decay: 1e-8,
            tau: Some(0.02),
            whole_dome: 1.0,
            finite: 0.0,
            feedback: 1.0,
            steepest: 1e6,
            measure: Measure::Cosine,
            first_loss: fourth(),
            clip: 1.0,
            ..Self::compact()
        }
    }

    /// Refuses what can't be trained.
    ///
    /// # Errors
    /// [`RecipeError`] with what is wrong.
    pub fn check(&self) -> Result<(), RecipeError> {
        self.config.check()?;
        if self.objects == 0 || self.steps == 0 || self.batch == 0 || self.micro_batch == 0 {
            return Err(RecipeError::Value(
                "objects, steps, batch and micro-batch must be at least 1".into(),
            ));
        }
        if !(SMALLEST..=MAX_SIZE).contains(&self.resolution) {
            // Smaller, a thin sculpture may cover no pixel.
            return Err(RecipeError::Value(format!(
                "pictures of {0}×{0} pixels: {SMALLEST} to {MAX_SIZE}",
                self.resolution
            )));
        }
        if !(4..=self.config.max_frames).contains(&self.lights) {
            return Err(RecipeError::Value(format!(
                "{} lights: 4 to {}",
                self.lights, self.config.max_frames
            )));
        }
        if self.config.horizon > 0 && self.config.horizon != self.lights {
            return Err(RecipeError::Value(format!(
                "a policy told of up to {} pictures in sequences of {}: the two must be equal",
                self.config.horizon, self.lights
            )));
        }
        if !(3..=self.lights).contains(&self.first_loss) {
            return Err(RecipeError::Value(format!(
                "loss from picture {} on: 3 to {}",
                self.first_loss, self.lights
            )));
        }
        if !(self.rate > 0.0 && self.rate < 1.0) {
            return Err(RecipeError::Value(format!("learning rate {}: between 0 and 1", self.rate)));
        }
        if !(self.whole_dome >= 0.0 && self.finite >= 0.0 && self.whole_dome + self.finite <= 1.0) {
            return Err(RecipeError::Value(format!(
                "shares of {} over the whole hemisphere and {} with a finite set: neither below 0, together at most 1",
                self.whole_dome, self.finite
            )));
        }
        if !(0.0..1.0).contains(&self.averaging) {
            return Err(RecipeError::Value(format!("averaging {}: 0 for none, or below 1", self.averaging)));
        }
        if self.tau.is_some_and(|t| !(t > 0.0 && t <= 10.0)) {
            return Err(RecipeError::Value("τ must lie in (0, 10] radians".into()));
        }
        self.training_solver().map(|_| ())
    }

    fn training_solver(&self) -> Result<Box<dyn TrainingSolver>, RecipeError> {
        match self.solver.as_str() {
            "ls" => Ok(Box::new(LeastSquares::default())),
            other => Err(RecipeError::Solver(other.into())),
        }
    }

    /// Whether the policy is trained for a limited reach alone. It is then validated so too.
    #[must_use]
    pub fn limited(&self) -> bool {
        self.whole_dome <= 0.0
    }

    /// Largest slant of the lights in validation, radians.
    #[must_use]
    pub fn validated_reach(&self) -> f32 {
        if self.limited() { LIMITED_VALIDATION } else { FRAC_PI_2 }
    }

    fn rate_at(&self, step: u64) -> f32 {
        let warm = ((step + 1) as f32 / self.warm_up.max(1) as f32).min(1.0);
        let done = step as f32 / self.steps as f32;
        let fall = if self.cosine { 0.5 * (1.0 + libm::cosf(PI * done.min(1.0))) } else { 1.0 };
        self.rate * warm * fall
    }

    /// How the sequences of update `step` are run. A policy that is told how many pictures there will be learns to plan for any
    /// number, half of the time for the largest, and the error after the last one counts alone.
    fn conditions(&self, step: u64) -> Conditions {
        let mut rng = Rng::stream(self.seed ^ LENGTHS, step);
        let (lights, first_loss) = match self.config.horizon {
            0 => (self.lights, self.first_loss),
            _ if rng.uniform() < 0.5 => (self.lights, self.lights),
            _ => {
                let lights = 3 + rng.below(self.lights - 3);
                (lights, lights)
            }
        };
        Conditions {
            lights,
            blank: self.blank,
            feedback: self.feedback,
            steepest: self.steepest,
            measure: self.measure,
            first_loss,
        }
    }
}

/// Where training objects come from: any number of them, by index, the same for the same index.
pub trait Pool: Sync {
    /// The object of this index with a material, texture and turn drawn from `rng`; `varied`: see [`Recipe::varied`].
    ///
    /// # Errors
    /// A mesh that can't be seen from where it was turned.
    fn draw(&self, index: usize, varied: bool, rng: &mut Rng) -> Result<Box<dyn Scene>, RenderError>;
}

/// What a step reports.
#[derive(Clone, Copy, Debug, PartialEq, Serialize, Deserialize)]
pub struct Report {
    /// Updates made, this one included.
    pub step: u64,
    /// Weighted loss of the batch.
    pub loss: f64,
    /// Mean of the measure after the last picture.
    pub last: f64,
    /// Length of the gradient before it was clipped.
    pub gradient: f32,
    /// Learning rate.
    pub rate: f32,
}

/// A training run in progress.
#[derive(Clone, Debug, PartialEq)]
pub struct Trainer {
    /// Its recipe.
    pub recipe: Recipe,
    /// The parameters now.
    pub weights: Weights,
    /// Their running average, if the recipe has one.
    pub average: Option<Weights>,
    /// The optimiser's state.
    pub adam: AdamW,
    /// Updates made.
    pub step: u64,
    /// Best parameters so far by validation error, and that error in degrees.
    pub best: Option<(Weights, f64)>,
}

impl Trainer {
    /// A fresh run.
    ///
    /// # Errors
    /// [`Recipe::check`].
    pub fn new(recipe: Recipe) -> Result<Self, RecipeError> {
        recipe.check()?;
        let weights = Weights::new(&recipe.config, recipe.seed);
        Ok(Self::starting(weights, recipe))
    }

    /// A fresh run of another run's network, and with its weights: of the recipe's network only the horizon counts, and the side of
    /// the frames where it is larger.
    ///
    /// # Errors
    /// [`Recipe::check`].
    pub fn begin_with(weights: Weights, recipe: Recipe) -> Result<Self, RecipeError> {
        let horizon = recipe.config.horizon.max(weights.config.horizon);
        let mut weights = if weights.config.horizon == horizon { weights } else { weights.told(horizon) };
        if recipe.config.grid() == weights.config.grid() {
            weights.config = weights.config.seeing(recipe.config.input.max(weights.config.input))?;
        }
        let recipe = Recipe { config: weights.config.clone(), ..recipe };
        recipe.check()?;
        Ok(Self::starting(weights, recipe))
    }

    fn starting(weights: Weights, recipe: Recipe) -> Self {
        let average = (recipe.averaging > 0.0).then(|| weights.clone());
        Self { adam: AdamW::new(&weights), recipe, weights, average, step: 0, best: None }
    }

    /// The parameters that are validated and shipped.
    #[must_use]
    pub fn judged(&self) -> &Weights {
        self.average.as_ref().unwrap_or(&self.weights)
    }

    /// Whether all updates have been made.
    #[must_use]
    pub fn done(&self) -> bool {
        self.step >= self.recipe.steps
    }

    /// One update. The number of threads doesn't change the result.
    ///
    /// # Errors
    /// [`UpdateError`]; the weights are then as they were.
    pub fn update(&mut self, pool: &dyn Pool, on: &Compute) -> Result<Report, UpdateError> {
        let update = self.step + 1;
        let solver = self.recipe.training_solver()?;
        let how = self.recipe.conditions(self.step);
        let drawn: Result<Vec<Drawn>, _> = (0..self.recipe.batch).map(|b| self.draw(pool, b)).collect();
        let drawn = drawn.map_err(|error| UpdateError::Object { update, error })?;
        let groups: Vec<&[Drawn]> = drawn.chunks(self.recipe.micro_batch).collect();
        let passes = in_parallel(groups.len(), on.threads, |g| {
            let episodes: Vec<Episode> = groups[g]
                .iter()
                .map(|d| Episode { scene: &*d.scene, lookup: d.lookup.clone(), reach: d.reach })
                .collect();
            differentiate(&self.weights, &episodes, how, &*solver, &on.device)
        });
        let mut gradients: Vec<Vec<f32>> =
            self.weights.params.iter().map(|p| vec![0.0; p.values.len()]).collect();
        let (mut loss, mut last) = (0.0, 0.0);
        for (pass, group) in passes.iter().zip(&groups) {
            let Pass { total, last: end, gradients: parts, .. } = pass;
            let share = group.len() as f64 / self.recipe.batch as f64;
            loss += share * total;
            last += share * end;
            for (sum, part) in gradients.iter_mut().flatten().zip(parts.iter().flatten()) {
                *sum += share as f32 * part;
            }
        }
        let length = clip(&mut gradients, self.recipe.clip);
        if !(loss.is_finite() && length.is_finite()) {
            return Err(UpdateError::NotFinite { update, loss, gradient: length });
        }
        let rate = self.recipe.rate_at(self.step);
        self.adam.update(&mut self.weights, &gradients, rate, self.recipe.decay);
        self.step += 1;
        if let Some(average) = &mut self.average {
            // At first over what there is, so that the beginning doesn't stay in it.
            let old = self.recipe.averaging.min(self.step as f32 / (self.step + 10) as f32);
            average.approach(&self.weights, 1.0 - old);
        }
        Ok(Report { step: self.step, loss, last, gradient: length, rate })
    }

    /// Keeps the parameters if this validation error is the lowest so far; says whether it is.
    pub fn validated(&mut self, degrees: f64) -> bool {
        let better = self.best.as_ref().is_none_or(|(_, best)| degrees < *best);
        if better {
            self.best = Some((self.judged().clone(), degrees));
        }
        better
    }

    /// Sequence `b` of the next update: its own random numbers, whatever came before.
    fn draw(&self, pool: &dyn Pool, b: usize) -> Result<Drawn, RenderError> {
        let r = &self.recipe;
        let number = self.step * r.batch as u64 + b as u64;
        let mut rng = Rng::stream(r.seed, number);
        let index = rng.below(r.objects);
        let (scene, (reach, lookup)) = if r.varied {
            let stage = self.stage(&mut Rng::stream(r.seed ^ STAGES, number));
            (pool.draw(index, stage.0 < FRAC_PI_2, &mut rng)?, stage)
        } else {
            (pool.draw(index, false, &mut rng)?, self.stage(&mut rng))
        };
        let lookup = match (r.tau, lookup) {
            (Some(tau), Lookup::Exact) => Lookup::Soft { tau, lights: fibonacci_cap(STORED, reach) },
            (_, lookup) => lookup,
        };
        Ok(Drawn { scene, lookup, reach })
    }

    /// Where a sequence's lights may be: the reach, and what answers a direction.
    fn stage(&self, rng: &mut Rng) -> (f32, Lookup) {
        let kind = rng.uniform();
        if kind < self.recipe.whole_dome {
            (FRAC_PI_2, Lookup::Exact)
        } else if kind < self.recipe.whole_dome + self.recipe.finite {
            let reach = rng.range(SHORTEST_REACH, LONGEST_STAGE);
            let set = light_set(rng, reach);
            (crate::light::reach(&set), Lookup::Nearest(set))
        } else {
            (rng.range(SHORTEST_REACH, FRAC_PI_2), Lookup::Exact)
        }
    }
}

struct Drawn {
    scene: Box<dyn Scene>,
    lookup: Lookup,
    reach: f32,
}

/// `work(0..count)` on at most `threads` threads; results in order.
pub fn in_parallel<T: Send>(count: usize, threads: usize, work: impl Fn(usize) -> T + Sync) -> Vec<T> {
    if threads <= 1 || count <= 1 {
        return (0..count).map(work).collect();
    }
    let next = std::sync::atomic::AtomicUsize::new(0);
    let (next, work) = (&next, &work);
    let mut results: Vec<(usize, T)> = std::thread::scope(|scope| {
        let handles: Vec<_> = (0..threads.min(count))
            .map(|_| {
                scope.spawn(move || {
                    let mut own = Vec::new();
                    loop {
                        let i = next.fetch_add(1, std::sync::atomic::Ordering::Relaxed);
                        if i >= count {
                            break own;
                        }
                        own.push((i, work(i)));
                    }
                })
            })
            .collect();
        handles.into_iter().flat_map(|h| h.join().expect("a worker panicked")).collect()
    });
    results.sort_by_key(|(i, _)| *i);
    results.into_iter().map(|(_, r)| r).collect()
}

#[cfg(test)]
mod tests {
    use super::super::formation::tests::Bump;
    use super::*;
    use crate::train::checkpoint;

    struct Bumps;
    impl Pool for Bumps {
        fn draw(&self, index: usize, _: bool, rng: &mut Rng) -> Result<Box<dyn Scene>, RenderError> {
            Ok(Box::new(Bump::new(14 + index as u32, rng.range(0.0, 4.0))))
        }
    }

    fn recipe() -> Recipe {
        let config = Config {
            size: "tiny".into(),
            input: 16,
            channels: [4, 4, 8, 8],
            pools: 2,
            width: 16,
            layers: 1,
            heads: 2,
            feed_forward: 16,
            light_hidden: 4,
            // So that there is much to learn.
            base: false,
            ..Config::compact()
        };
        Recipe {
            config,
            objects: 3,
            steps: 30,
            batch: 4,
            micro_batch: 2,
            lights: 5,
            rate: 2e-3,
            clip: 1.0,
            measure: Measure::Cosine,
            ..Recipe::compact()
        }
    }

    #[test]
    fn a_run_that_begins_with_another_may_see_larger_frames() {
        let old = Weights::new(&recipe().config, 3);
        let larger = Recipe { config: recipe().config.seeing(32).unwrap(), ..recipe() };
        let begun = Trainer::begin_with(old.clone(), larger).unwrap();
        assert_eq!((begun.weights.config.input, begun.recipe.config.pools), (32, 3));
        assert_eq!(begun.weights.params, old.params);
        let other = Recipe { config: Config::paper(), ..recipe() };
        assert_eq!(Trainer::begin_with(old.clone(), other).unwrap().weights, old);
    }

    #[test]
    fn a_short_training_lowers_the_loss() {
        let mut t = Trainer::new(Recipe { steps: 60, ..recipe() }).unwrap();
        let mut losses = Vec::new();
        while !t.done() {
            losses.push(t.update(&Bumps, &Compute::cpu(2)).unwrap().loss);
        }
        let mean = |l: &[f64]| l.iter().sum::<f64>() / l.len() as f64;
        let (before, after) = (mean(&losses[..10]), mean(&losses[50..]));
        assert!(after < 0.7 * before, "{before} → {after}");
    }

    #[test]
    fn a_policy_that_is_told_learns_every_number_of_pictures() {
        let base = recipe();
        let told = Recipe {
            config: Config { base: true, horizon: 10, ..base.config.clone() },
            lights: 10,
            ..base.clone()
        };
        told.check().unwrap();
        let lengths: Vec<usize> = (0..400).map(|step| told.conditions(step).lights).collect();
        assert!((3..=10).all(|t| lengths.contains(&t)));
        let long = lengths.iter().filter(|&&t| t == 10).count();
        assert!((150..250).contains(&long), "{long}");
        assert!((0..9).all(|step| told.conditions(step).first_loss == told.conditions(step).lights));
        assert_eq!(base.conditions(3).lights, base.lights);
        assert!(Recipe { lights: 9, ..told }.check().unwrap_err().to_string().contains("equal"));
    }

    #[test]
    fn the_average_of_the_weights_follows_them_slowly() {
        let mut t = Trainer::new(Recipe { averaging: 0.9, ..recipe() }).unwrap();
        let begun = t.weights.clone();
        for _ in 0..6 {
            t.update(&Bumps, &Compute::cpu(2)).unwrap();
        }
        let far = |a: &Weights, b: &Weights| {
            let pairs = a.params.iter().zip(&b.params).flat_map(|(a, b)| a.values.iter().zip(&b.values));
            pairs.map(|(a, b)| (a - b) * (a - b)).sum::<f32>().sqrt()
        };
        let whole = far(&begun, &t.weights);
        assert!(far(t.judged(), &t.weights) < whole && far(t.judged(), &begun) < whole);
        t.validated(3.0);
        assert_eq!(&t.best.as_ref().unwrap().0, t.judged());
        assert!(
            Recipe { whole_dome: 0.6, finite: 0.5, ..recipe() }
                .check()
                .unwrap_err()
                .to_string()
                .contains("0.5")
        );
        assert!(Recipe { averaging: 1.0, ..recipe() }.check().unwrap_err().to_string().contains("averaging"));
    }

    #[test]
    fn a_resumed_run_is_the_same_to_the_bit_on_any_number_of_threads() {
        let recipe = || Recipe { averaging: 0.99, ..recipe() };
        let mut whole = Trainer::new(recipe()).unwrap();
        for _ in 0..6 {
            whole.update(&Bumps, &Compute::cpu(1)).unwrap();
        }
        let mut first = Trainer::new(recipe()).unwrap();
        for _ in 0..3 {
            first.update(&Bumps, &Compute::cpu(2)).unwrap();
        }
        first.validated(12.0);
        let mut second = checkpoint::read(&checkpoint::write(&first)).unwrap();
        assert_eq!(second, first);
        for _ in 0..3 {
            second.update(&Bumps, &Compute::cpu(2)).unwrap();
        }
        assert_eq!(second.weights, whole.weights);
        assert_eq!(second.average, whole.average);
        assert_eq!(second.adam, whole.adam);
    }

    #[test]
    fn the_gradient_of_the_whole_pass_agrees_with_finite_differences() {
        // Through images, solver and all steps; the surrogate in the graph has the loss's gradient, not its value.
        let r = Recipe { lights: 5, feedback: 1.0, steepest: 1e6, ..recipe() };
        let mut weights = Weights::new(&r.config, 3);
        let scene = Bump::new(16, 2.0);
        let episode = || [Episode { scene: &scene, lookup: Lookup::Exact, reach: 1.2 }];
        let how = r.conditions(0);
        let (solver, on) = (LeastSquares::default(), Compute::cpu(1));
        let pass = differentiate(&weights, &episode(), how, &solver, &on.device);
        let index: Vec<usize> =
            ["head.1.w", "head.0.w", "view.2.v", "tokens.out.w", "encoder.7.g", "light.1.w"]
                .iter()
                .map(|n| weights.index()[n])
                .collect();
        for p in index {
            // The entry with the largest gradient.
            let g = &pass.gradients[p];
            let k = (0..g.len()).max_by(|&a, &b| g[a].abs().total_cmp(&g[b].abs())).unwrap();
            let exact = f64::from(g[k]);
            let mut at = |step: f32| {
                let old = weights.params[p].values[k];
                weights.params[p].values[k] = old + step;
                let total = differentiate(&weights, &episode(), how, &solver, &on.device).total;
                weights.params[p].values[k] = old;
                total
            };
            // A kink of a ReLU or a pool within ±h spoils a difference: one of three steps must agree.
            let numeric = [2e-3f32, 5e-4, 1e-4].map(|h| (at(h) - at(-h)) / f64::from(2.0 * h));
            assert!(
                numeric.iter().any(|n| (n - exact).abs() < 2e-4 + 0.05 * exact.abs()),
                "{}[{k}]: {numeric:?} {exact}",
                weights.params[p].name
            );
        }
    }
}
