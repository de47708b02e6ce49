//! Arguments that several methods share. Each method keeps its own Python signature, with positions and keywords; the
//! shared ones are collected here, checked once, and borrowed as what the core takes.

use crate::arrays::{of_samples, row_major};
use haptid_core::Motion;
use numpy::{PyReadonlyArray1, PyReadonlyArray2, PyReadonlyArray3, PyReadonlyArrayDyn};
use pyo3::exceptions::PyValueError;
use pyo3::prelude::*;

pub(crate) type Vector<'py> = PyReadonlyArray1<'py, f64>;
pub(crate) type Matrix<'py> = PyReadonlyArray2<'py, f64>;
pub(crate) type Stack<'py> = PyReadonlyArray3<'py, f64>;
/// Parameters, (columns,) or (sets, columns).
pub(crate) type Sets<'py> = PyReadonlyArrayDyn<'py, f64>;

/// A motion: position, velocity, acceleration (if there is one), external columns and loops (if there are some), each
/// (channels, samples).
pub(crate) struct MotionArguments<'py> {
    pub(crate) position: Matrix<'py>,
    pub(crate) velocity: Matrix<'py>,
    pub(crate) acceleration: Option<Matrix<'py>>,
    pub(crate) external: Matrix<'py>,
    pub(crate) loops: Option<Matrix<'py>>,
}

impl<'py> MotionArguments<'py> {
    /// The motion, of row-major arrays with as many samples as the positions; ValueError for others.
    pub(crate) fn motion(&self) -> PyResult<Motion<'_>> {
        let shape = self.position.as_array().raw_dim();
        let other = |array: &Matrix<'py>| array.as_array().raw_dim() != shape;
        if other(&self.velocity) || self.acceleration.as_ref().is_some_and(other) {
            return Err(PyValueError::new_err("position, velocity and acceleration must have the same shape"));
        }
        let samples = self.position.as_array().ncols();
        Ok(Motion {
            samples,
            position: row_major(&self.position)?,
            velocity: row_major(&self.velocity)?,
            acceleration: self.acceleration.as_ref().map(row_major).transpose()?,
            external: of_samples("external", &self.external, samples)?,
            loops: self.loops.as_ref().map_or(Ok(&[][..]), |loops| of_samples("loops", loops, samples))?,
        })
    }
}
