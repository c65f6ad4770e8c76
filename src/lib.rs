//! Photometric stereo that decides for itself where to put the next light.
//!
//! A camera looks at an object; a light can stand anywhere on the hemisphere. A [`planner`] looks at
//! the pictures so far and names the next light direction, a [`camera`] (a stack of real photos, a
//! renderer, a rig) takes the picture, a [`solve`]r turns pictures and directions into normals.
//! The modules stand in the order in which data flows.
//!
//! Frame: x right, y up (image row 0 is +y), z towards the camera. Angles are radians inside the
//! crate and degrees where people read them.
//!
//! The whole loop, on a rendered object:
//! ```
//! # #[cfg(feature = "render")] {
//! use coil_ps::camera::{Camera, Domain};
//! use coil_ps::planner::{self, Setup};
//! use coil_ps::render::{self, Material, Options, Pose, Scene, SceneCamera};
//! use coil_ps::session::{Session, Step};
//! use coil_ps::{error, solve::LeastSquares};
//!
//! # fn main() -> Result<(), Box<dyn std::error::Error>> {
//! let shape = render::named("blob:7")?;
//! let pose = Pose::fit(&shape, shape.front())?;
//! let finish = "nylon".parse::<Material>()?.into();
//! let scene = Scene::new("blob", &shape, &pose, &finish, &Options { size: 48, ..Options::default() })?;
//! let camera = SceneCamera::new(&scene);
//!
//! let setup = Setup { lights: 10, seed: 1, draw: 0, camera: None, truth: None, learned: None };
//! let planner = planner::build("tk22", &setup)?;
//! let domain = Domain::Hemisphere { reach: 70f32.to_radians() };
//! let mut session = Session::new(camera.mask().clone(), domain, planner, 10);
//! while let Step::Capture(direction) = session.step()? {
//!     let picture = camera.capture(direction, session.seen())?;
//!     session.observe(picture)?;
//! }
//! let solution = session.solve(&LeastSquares, 10)?;
//! let mae = error::mae(&solution.normals, scene.truth());
//! assert!(mae < 30.0, "{mae}°");
//! # Ok(())
//! # }
//! # main().unwrap();
//! # }
//! ```
#![forbid(unsafe_code)]
#![warn(missing_docs)]

pub mod fingerprint;
pub mod rng;

pub mod light;

pub mod image;
pub mod stack;

pub mod dataset;

pub mod camera;
pub mod relight;
#[cfg(feature = "render")]
pub mod render;

pub mod error;
pub mod solve;
#[cfg(feature = "render")]
pub mod pixels;
pub mod surface;

pub mod planner;
#[cfg(feature = "policy")]
pub mod policy;
pub mod session;

pub mod arm;
pub mod rig;

pub mod view;

pub mod eval;

#[cfg(target_arch = "wasm32")]
pub mod web;

#[cfg(all(feature = "train", not(target_arch = "wasm32")))]
pub mod train;
