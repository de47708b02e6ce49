//! Batched dynamics of trees and closed chains, in lanes of samples.
//!
//! The observation matrix W is never stored: its rows are made chunk by chunk ([`rows`]), passed through one
//! finite filter and decimator ([`filter`]), and folded into one small triangle per motor and time block
//! ([`triangle`], [`reduce`]). Everything works on plain slices; nothing here knows Python, files or clocks.
//! Without accelerations the rows are those of momentum and of the rest of the torque ([`momentum`]), and the filter
//! differentiates the former. Torques of given parameters are made by recursion, without rows ([`newton_euler`]), and so are
//! accelerations from torques ([`direct`]). What a hand feels at many poses has kernels of its own ([`handle`], [`felt`]). Loops whose
//! rates vary with the pose are closed along whole motions ([`branch`]).
//!
//! Arrays of samples are "channel major": the samples of one coordinate are contiguous.

mod aligned;
mod back;
mod batch;
mod branch;
mod composite;
mod course;
mod cuts;
mod dense;
mod direct;
mod dispatch;
mod dual;
mod elementary;
mod error;
mod factor;
mod felt;
mod filter;
mod forms;
mod handle;
mod inverse;
mod inward;
mod joint;
mod lane;
mod link;
mod march;
mod mechanism;
mod momentum;
mod momentum_rows;
mod momentum_sweep;
mod newton_euler;
mod number;
mod parameters;
mod part;
mod places;
mod plan;
mod principal;
mod products;
mod reduce;
mod regressor;
mod rows;
mod slopes;
mod stream;
mod sweep;
mod terms;
mod triangle;
mod tried;
mod vector;
#[cfg(target_arch = "x86_64")]
mod wide;

pub use branch::{Branch, Followed, Limits, Linear, Path, Stop};
pub use cuts::{Cut, Frame, Loops};
pub use dense::triangle;
pub use direct::{acceleration, mass_matrix};
pub use dispatch::Backend;
pub use error::Error;
pub use felt::{View, felt_mass};
pub use handle::{Bodies, Grip, Poses, handle_dynamics};
pub use inverse::torque;
pub use mechanism::{Closure, Joint, Mechanism};
pub use products::inner_products;
pub use reduce::{Reduction, Triangles, reduce};
pub use regressor::{Motion, reach, regressor};
pub use slopes::{form_slopes, torque_slopes};
pub use terms::{Law, Term};
