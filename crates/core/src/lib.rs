//! Batched dynamics of trees and closed chains, in lanes of samples.
//!
//! The observation matrix W is never stored: its rows are made chunk by chunk ([`rows`]), passed through one
//! finite filter and decimator ([`filter`]), and folded into one small triangle per motor and time block
//! ([`triangle`], [`reduce`]). Everything works on plain slices; nothing here knows Python, files or clocks.
//! Without accelerations the rows are those of momentum and of the rest of the torque ([`momentum`]), and the filter
//! differentiates the former. Torques of given parameters are made by recursion, without rows ([`newton_euler`]), and so are
//! accelerations from torques ([`direct`]). What a hand feels at many poses has kernels of its own ([`handle`], [`state`]). LoopClosure whose
//! rates vary with the pose are closed along whole motions ([`mode`]).
//!
//! Arrays of samples are "channel major": the samples of one coordinate are contiguous.

mod batch;
mod dynamics;
mod end_effector;
mod error;
mod linalg;
mod loops;
mod mechanism;
mod memory;
mod reduction;
mod regressor;
mod simd;

pub use dynamics::forward::{forward_dynamics, mass_matrix};
pub use dynamics::rnea::inverse_dynamics;
pub use end_effector::apparent_mass::{ApparentMassQuery, apparent_mass};
pub use end_effector::jacobian::{BodyParameters, EndEffector, Poses, end_effector_dynamics};
pub use error::Error;
pub use loops::assembly::{
    ActiveTrajectory, AssemblyMode, ClosureTolerances, ContinuationStop, JointTrajectory, LinearClosure,
};
pub use loops::cut::{CutJoint, Frame, LoopClosure};
pub use mechanism::closure::Closure;
pub use mechanism::layout::structural_nonzeros;
pub use mechanism::motion::Motion;
pub use mechanism::terms::{Law, Term};
pub use mechanism::{Joint, Mechanism};
pub use reduction::dense::r_factor;
pub use reduction::reduce::{RFactors, Reduction, reduce};
pub use regressor::gradients::{quadratic_form_gradients, torque_gradients};
pub use regressor::gram::gram_matrices;
pub use regressor::regressor;
pub use simd::dispatch::Backend;
