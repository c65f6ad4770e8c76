//! From images and light directions to normals.

pub mod context;
pub mod expectation;
pub mod irls;
mod lanes;
pub mod least_squares;
pub mod near;
pub mod neighbourhood;
pub mod perceptron;
pub mod pixel;
mod robust;
mod smooth;
pub mod sparse_bayes;
pub mod tiles;
pub mod trimmed;
pub mod uncertainty;

use crate::camera::Observation;
use crate::stack::{Mask, Stack};
use glam::{Vec2, Vec3};

pub use context::InContext;
pub use irls::{Irls, Loss};
pub use least_squares::LeastSquares;
pub use pixel::PixelNetwork;
pub use robust::Thresholds;
pub use sparse_bayes::SparseBayes;
pub use trimmed::Trimmed;

/// Pictures of the same pixels under known lights, as a solver takes them.
#[derive(Clone, Debug, Default)]
pub struct Measurements<'a> {
    /// Light direction of each image; unit length, or the blend of soft interpolation.
    pub lights: Vec<Vec3>,
    /// Linear grey value of every mask pixel, for each image.
    pub images: Vec<&'a [f32]>,
    /// Which pixels are saturated, for each image. Where none is, an image's list may be empty, and so may the whole.
    pub saturated: Vec<&'a [bool]>,
}

impl<'a> Measurements<'a> {
    /// The measurements of a run.
    #[must_use]
    pub fn of(seen: &'a [Observation]) -> Self {
        Self {
            lights: seen.iter().map(|o| o.light).collect(),
            images: seen.iter().map(|o| o.grey.as_slice()).collect(),
            saturated: seen.iter().map(|o| o.saturated.as_slice()).collect(),
        }
    }

    /// All images of a stack.
    #[must_use]
    pub fn of_stack(stack: &'a Stack) -> Self {
        Self {
            lights: stack.lights.clone(),
            images: stack.grey.iter().map(Vec::as_slice).collect(),
            saturated: stack.saturated.iter().map(Vec::as_slice).collect(),
        }
    }

    /// The measurements of pixels `first..end` alone: a tile.
    ///
    /// # Panics
    /// Where an image has less than `end` pixels.
    #[must_use]
    pub fn range(&self, first: usize, end: usize) -> Self {
        let images = self.images.iter().map(|i| &i[first..end]).collect();
        let saturated = self.saturated.iter().map(|s| s.get(first..end).unwrap_or_default()).collect();
        Self { lights: self.lights.clone(), images, saturated }
    }

    /// Which pixels are saturated in image `k`; empty where none is.
    #[must_use]
    pub fn saturated_in(&self, k: usize) -> &'a [bool] {
        self.saturated.get(k).copied().unwrap_or_default()
    }

    /// Number of pixels.
    ///
    /// # Errors
    /// [`SolveError`] where counts disagree or there is nothing to solve.
    pub fn check(&self) -> Result<usize, SolveError> {
        if self.lights.len() != self.images.len() {
            return Err(SolveError::Count { lights: self.lights.len(), images: self.images.len() });
        }
        if self.lights.len() < 3 {
            return Err(SolveError::TooFew(self.lights.len()));
        }
        let pixels = self.images[0].len();
        if let Some(k) = self.images.iter().position(|i| i.len() != pixels) {
            return Err(SolveError::Pixels { image: k, found: self.images[k].len(), expected: pixels });
        }
        if let Some(k) = self.saturated.iter().position(|s| !s.is_empty() && s.len() != pixels) {
            return Err(SolveError::Pixels { image: k, found: self.saturated[k].len(), expected: pixels });
        }
        Ok(pixels)
    }
}

/// Whether the normal of a pixel can be trusted at all.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum Validity {
    /// Solved from lit, unsaturated values.
    Valid,
    /// Dark under every light (or all but too few): nothing to solve from.
    Shadowed,
    /// Saturated under every light (or all but too few).
    Saturated,
}

/// Normals of the mask pixels.
#[derive(Clone, Debug)]
pub struct Solution {
    /// Unit normal of every mask pixel. Never NaN: where it is not valid it is the best that the values
    /// allow, and (0,0,1) for a black pixel.
    pub normals: Vec<Vec3>,
    /// Albedo of every mask pixel in the images' units (grey value of a face-on patch).
    pub albedo: Vec<f32>,
    /// Which normals rest on enough measurements.
    pub validity: Vec<Validity>,
    /// Expected angular error of every mask pixel, degrees, once [`uncertainty::complete`] has been called.
    pub uncertainty: Option<Vec<f32>>,
    /// What the solver itself says of every pixel's error, for that; empty where it says nothing.
    pub own: Vec<expectation::Own>,
}

/// Why normals can't be solved.
#[derive(Debug, thiserror::Error, PartialEq)]
pub enum SolveError {
    /// Less than three lights.
    #[error("{0} light(s): a normal needs at least 3 that do not lie in one plane")]
    TooFew(usize),
    /// All lights lie in one plane through the object.
    #[error("the {0} lights lie (nearly) in one plane through the object: add one outside it")]
    Coplanar(usize),
    /// Light count and image count differ.
    #[error("{lights} lights for {images} images: there must be one for each")]
    Count {
        /// Number of lights.
        lights: usize,
        /// Number of images.
        images: usize,
    },
    /// An image has another number of pixels.
    #[error("image {image} has {found} pixels where the first has {expected}")]
    Pixels {
        /// Which image, from 0.
        image: usize,
        /// Its pixels.
        found: usize,
        /// Those of the first image.
        expected: usize,
    },
    /// There is not one place for each pixel.
    #[error("{found} places for {expected} pixels: there must be one for each")]
    Places {
        /// Number of places.
        found: usize,
        /// Number of pixels.
        expected: usize,
    },
    /// A solver's model could not be run.
    #[error("{0}")]
    Model(String),
}

/// A photometric-stereo solver.
pub trait Solver {
    /// Its name on the command line and in tables.
    fn name(&self) -> &'static str;

    /// Normals from at least three measurements.
    ///
    /// # Errors
    /// [`SolveError`]; a pixel that can't be solved is not an error but marked in the validity map.
    fn solve(&self, measurements: &Measurements) -> Result<Solution, SolveError>;
}

/// Pictures of a whole object, made ready for a solver.
#[derive(Clone, Debug)]
pub struct Prepared<'a> {
    given: Measurements<'a>,
    distant: Option<Vec<Vec<f32>>>,
    /// Nearness of the lamps that was taken out of them; 0 for none.
    pub nearness: f32,
}

impl Prepared<'_> {
    /// As the solver takes them.
    #[must_use]
    pub fn measurements(&self) -> Measurements<'_> {
        match &self.distant {
            Some(images) => {
                Measurements { images: images.iter().map(Vec::as_slice).collect(), ..self.given.clone() }
            }
            None => self.given.clone(),
        }
    }
}

/// Makes the pictures of an object ready for the solver of this name: what has to be seen of the whole, before pixels are
/// solved apart. `places` are those of the pixels ([`near::places`]).
///
/// # Errors
/// As [`near::nearness`].
pub fn prepare<'a>(
    solver: &str,
    given: Measurements<'a>,
    places: &[Vec2],
) -> Result<Prepared<'a>, SolveError> {
    let nearness = nearness(solver, &given, places)?;
    let distant = if nearness > 0.0 { Some(near::distant(&given, places, nearness)?) } else { None };
    Ok(Prepared { given, distant, nearness })
}

/// Adds what only the whole object shows to a solution of which [`uncertainty::complete`] has looked at each pixel by itself: expected errors are
/// compared with those of neighbours ([`uncertainty::compare`]), and by a solver that is [`Info::of_whole`] normals corrected ([`context::correct`]).
///
/// # Errors
/// As these two.
pub fn finish(solver: &str, mask: &Mask, solution: &mut Solution) -> Result<(), SolveError> {
    if of_whole(solver) {
        context::correct(mask, solution)
    } else {
        uncertainty::compare(solver, mask, solution)
    }
}

/// A whole object, solved.
#[derive(Clone, Debug)]
pub struct Whole {
    /// Its normals.
    pub solution: Solution,
    /// Nearness of the lamps that was taken out of the pictures; 0 for none.
    pub nearness: f32,
}

/// Normals of all pixels of `mask` from the pictures of them, from [`prepare`] to [`finish`]; with expected errors where they are wanted.
///
/// # Errors
/// As these, and [`Solver::solve`].
pub fn whole(
    solver: &dyn Solver,
    given: Measurements,
    mask: &Mask,
    expected: bool,
) -> Result<Whole, SolveError> {
    let name = solver.name();
    let ready = prepare(name, given, &near::places(mask))?;
    let pictures = ready.measurements();
    let mut solution = solver.solve(&pictures)?;
    if expected || of_whole(name) {
        uncertainty::complete(name, &pictures, &mut solution)?;
        finish(name, mask, &mut solution)?;
    }
    Ok(Whole { solution, nearness: ready.nearness })
}

/// Whether the solver of this name corrects pixels by what is around them, see [`Info::of_whole`].
#[must_use]
pub fn of_whole(solver: &str) -> bool {
    SOLVERS.iter().any(|s| s.name == solver && s.of_whole)
}

/// Whether the solver of this name takes pictures as distant lamps would give them, see [`Info::distant_lamps`].
#[must_use]
pub fn wants_distant_lamps(solver: &str) -> bool {
    SOLVERS.iter().any(|s| s.name == solver && s.distant_lamps)
}

/// The lamps' nearness that is taken out of pictures for the solver of this name.
///
/// # Errors
/// As [`near::nearness`].
pub fn nearness(solver: &str, given: &Measurements, places: &[Vec2]) -> Result<f32, SolveError> {
    if wants_distant_lamps(solver) { near::nearness(given, places) } else { Ok(0.0) }
}

/// What there is to know of a solver before it is built.
#[derive(Clone, Copy, Debug, PartialEq, serde::Serialize)]
pub struct Info {
    /// Name on the command line, in results and permalinks.
    pub name: &'static str,
    /// Name in tables and menus.
    pub label: &'static str,
    /// One line on how it works.
    pub about: &'static str,
    /// Whether [`prepare`] takes the effect of near lamps out of its pictures. Solvers that are compared with published
    /// numbers take pictures as they are.
    pub distant_lamps: bool,
    /// Whether [`finish`] corrects its normals by what is around them, so that a pixel's depends on the others.
    pub of_whole: bool,
}

impl Info {
    /// A solver that takes pictures as they are.
    const fn textbook(name: &'static str, label: &'static str, about: &'static str) -> Self {
        Self { name, label, about, distant_lamps: false, of_whole: false }
    }
}

/// Names that [`by_name`] knows, with a line for people.
pub const SOLVERS: &[Info] = &[
    Info::textbook("ls", "Least squares", "least squares over all images (Woodham 1980)"),
    Info::textbook("trimmed", "Trimmed", "least squares without each pixel's darkest and brightest values"),
    Info::textbook("l1", "L1", "least absolute residuals, iteratively reweighted"),
    Info::textbook("huber", "Huber", "Huber's loss, iteratively reweighted"),
    Info::textbook("cauchy", "Cauchy", "Cauchy's loss, iteratively reweighted"),
    Info::textbook("sbr", "Sparse Bayes", "sparse Bayesian regression (Ikehata et al. 2012)"),
    Info {
        name: pixel::NAME,
        label: "Learned",
        about: "learned: a set network over each pixel's observations, trained on synthetic pixels",
        distant_lamps: true,
        of_whole: false,
    },
    Info {
        name: context::NAME,
        label: "Learned, in context",
        about: "the learned solver's normals, corrected by what is around each pixel",
        distant_lamps: true,
        of_whole: true,
    },
];

/// Why there is no such solver.
#[derive(Debug, thiserror::Error, PartialEq)]
#[error("no solver '{name}': choose from {known}")]
pub struct UnknownSolver {
    /// What was asked for.
    pub name: String,
    /// The names there are.
    pub known: String,
}

/// Refuses names that are not in [`SOLVERS`].
///
/// # Errors
/// [`UnknownSolver`] with the names there are.
pub fn check_name(name: &str) -> Result<(), UnknownSolver> {
    let known = || SOLVERS.iter().map(|s| s.name);
    if known().any(|n| n == name) {
        return Ok(());
    }
    Err(UnknownSolver { name: name.into(), known: known().collect::<Vec<_>>().join(", ") })
}

/// The solver of a name in [`SOLVERS`]. In WebAssembly `pixel` and `context` are not among them: their network is not in the module.
///
/// # Errors
/// [`UnknownSolver`] with the names there are.
pub fn by_name(name: &str) -> Result<Box<dyn Solver>, UnknownSolver> {
    match name {
        "ls" => Ok(Box::new(LeastSquares)),
        "trimmed" => Ok(Box::new(Trimmed::default())),
        "l1" => Ok(Box::new(Irls::new(Loss::L1))),
        "huber" => Ok(Box::new(Irls::new(Loss::Huber))),
        "cauchy" => Ok(Box::new(Irls::new(Loss::Cauchy))),
        "sbr" => Ok(Box::new(SparseBayes::default())),
        #[cfg(not(target_arch = "wasm32"))]
        pixel::NAME => Ok(Box::new(PixelNetwork::shipped())),
        #[cfg(not(target_arch = "wasm32"))]
        context::NAME => Ok(Box::new(InContext(PixelNetwork::shipped()))),
        _ => {
            check_name(name)?;
            let known = SOLVERS.iter().map(|s| s.name).filter(|&n| n != pixel::NAME && n != context::NAME);
            Err(UnknownSolver { name: name.into(), known: known.collect::<Vec<_>>().join(", ") })
        }
    }
}
