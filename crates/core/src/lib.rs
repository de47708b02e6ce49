//! Batched dynamics of trees and closed chains, in SIMD lanes of samples.
//!
//! The observation matrix W of an identification is never stored: its rows are computed in chunks, passed through one
//! FIR filter with decimation, and folded into one small R factor per motor and time block ([`reduce`]). Without
//! accelerations the rows are those of generalised momentum and of the remainder of the torque, and the filter
//! differentiates the former. Torques of given parameters are computed by recursion, without rows
//! ([`inverse_dynamics`]), and so are accelerations from torques ([`forward_dynamics`]). Jacobians, mass matrices and
//! apparent masses at many poses are computed together ([`end_effector_dynamics`], [`apparent_mass()`]). Loops with
//! varying rates are closed along whole motions by continuation ([`AssemblyMode`]).
//!
//! Arrays of samples are channel major: the samples of one coordinate are contiguous. Units are SI: rad or m, N m or N,
//! kg. Everything works on plain slices; nothing here depends on Python, files or clocks.
//!
//! Modules form layers, in this order: error, simd, memory, exact, linalg, mechanism, batch, regressor, dynamics, reduction,
//! loops, end_effector. Each uses only those before it.

#![deny(missing_docs, unreachable_pub, clippy::undocumented_unsafe_blocks)]

mod batch;
mod dynamics;
mod end_effector;
mod error;
mod exact;
mod linalg;
mod loops;
mod mechanism;
mod memory;
mod reduction;
mod regressor;
mod simd;

pub use dynamics::forward::{forward_dynamics, mass_matrix};
pub use dynamics::play::{Play, PlayMotion, torque_of_play};
pub use dynamics::rnea::inverse_dynamics;
pub use end_effector::apparent_mass::{ApparentMassQuery, ApparentMasses, apparent_mass};
pub use end_effector::jacobian::{EndEffector, end_effector_dynamics};
pub use error::Error;
pub use exact::echelon::echelon;
pub use exact::rows::{ExactStates, TreeStates, exact_rows, real_rows};
pub use linalg::condition::{extreme_eigenvalues, smooth_condition};
pub use linalg::sections::filter_both_ways;
pub use loops::assembly::{
    ActiveTrajectory, AssemblyMode, ClosureTolerances, ContinuationStop, JointTrajectory, LinearClosure,
};
pub use loops::cut::{CutJoint, CutKind, Frame, LoopClosure};
pub use mechanism::closure::Closure;
pub use mechanism::layout::structural_nonzeros;
pub use mechanism::motion::Motion;
pub use mechanism::terms::{Law, Term};
pub use mechanism::{Joint, Mechanism};
pub use reduction::dense::r_factor;
pub use reduction::fir::decimate;
pub use reduction::reduce::{RFactors, Reduction, reduce};
pub use regressor::gradients::{quadratic_form_gradients, torque_gradients};
pub use regressor::gram::gram_matrix;
pub use regressor::{new_regressor, regressor};
pub use simd::dispatch::Backend;
