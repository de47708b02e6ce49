//! Tests of the public interface, in one binary: every kernel on every back end of the machine.

mod backends;
mod dynamics;
mod end_effector;
mod gradients;
mod loops;
mod mechanisms;
mod reduction;
mod regressor;
