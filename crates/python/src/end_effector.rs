//! Kernels at the end effector: see `_core.pyi`.

use crate::arguments::{Matrix, PoseArguments, Vector};
use crate::arrays::row_major;
use crate::mechanism::PyMechanism;
use crate::threads::detached;
use crate::to_python;
use haptid_core::{ApparentMassQuery, EndEffector};
use numpy::{IntoPyArray, PyArray2, PyArrayMethods, PyUntypedArrayMethods};
use pyo3::prelude::*;

#[pyfunction]
#[allow(clippy::too_many_arguments)]
pub fn end_effector_dynamics<'py>(
    py: Python<'py>,
    mechanism: &PyMechanism,
    position: Matrix<'py>,
    rates: Matrix<'py>,
    link: usize,
    point: [f64; 3],
    chi: Vector<'py>,
    rotors: Matrix<'py>,
    inertia: Vector<'py>,
    rows: Vec<usize>,
) -> PyResult<Bound<'py, PyArray2<f64>>> {
    let arguments = PoseArguments { position, rates, chi, rotors, inertia };
    let (poses, bodies, end_effector) = (arguments.poses()?, arguments.bodies()?, EndEffector { link, point });
    let na = mechanism.0.coordinates();
    let shape = [poses.samples, (rows.len() + na) * na];
    let mut out = vec![0.0; shape.iter().product()];
    detached(py, || haptid_core::end_effector_dynamics(&mechanism.0, &poses, &end_effector, &bodies, &rows, &mut out))
        .map_err(to_python)?;
    out.into_pyarray(py).reshape(shape)
}

#[pyfunction]
#[allow(clippy::too_many_arguments)]
pub fn apparent_mass<'py>(
    py: Python<'py>,
    mechanism: &PyMechanism,
    position: Matrix<'py>,
    rates: Matrix<'py>,
    link: usize,
    point: [f64; 3],
    chi: Vector<'py>,
    rotors: Matrix<'py>,
    inertia: Vector<'py>,
    rows: Vec<usize>,
    moving: Vec<usize>,
    worst: f64,
    spread: Matrix<'py>,
) -> PyResult<Bound<'py, PyArray2<f64>>> {
    let arguments = PoseArguments { position, rates, chi, rotors, inertia };
    let (poses, bodies, end_effector) = (arguments.poses()?, arguments.bodies()?, EndEffector { link, point });
    let query = ApparentMassQuery {
        rows: &rows,
        free: &moving,
        max_condition: worst,
        covariance_factor: row_major(&spread)?,
        factor_columns: spread.shape()[1],
    };
    let shape = [poses.samples, query.width()];
    let mut out = vec![0.0; shape.iter().product()];
    detached(py, || haptid_core::apparent_mass(&mechanism.0, &poses, &end_effector, &bodies, &query, &mut out))
        .map_err(to_python)?;
    out.into_pyarray(py).reshape(shape)
}
