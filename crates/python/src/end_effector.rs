//! Kernels at the end effector: see `_core.pyi`.

use crate::arguments::{Matrix, Vector};
use crate::arrays::{of_samples, room, row_major};
use crate::mechanism::PyMechanism;
use crate::threads::detached;
use crate::to_python;
use haptid_core::{ApparentMassQuery, EndEffector, Motion};
use numpy::{IntoPyArray, PyArray1, PyArray2, PyArray3, PyArrayMethods, PyUntypedArrayMethods};
use pyo3::prelude::*;

/// The poses of row-major arrays.
fn poses<'a>(position: &'a Matrix<'_>, loops: Option<&'a Matrix<'_>>) -> PyResult<Motion<'a>> {
    let samples = position.shape()[1];
    let loops = loops.map_or(Ok(&[][..]), |loops| of_samples("loops", loops, samples))?;
    Ok(Motion { samples, position: row_major(position)?, velocity: &[], acceleration: None, external: &[], loops })
}

#[pyfunction]
#[pyo3(signature = (mechanism, position, loops, link, point, chi, rows))]
#[allow(clippy::too_many_arguments)]
pub fn end_effector_dynamics<'py>(
    py: Python<'py>,
    mechanism: &PyMechanism,
    position: Matrix<'py>,
    loops: Option<Matrix<'py>>,
    link: usize,
    point: [f64; 3],
    chi: Vector<'py>,
    rows: Vec<usize>,
) -> PyResult<Bound<'py, PyArray2<f64>>> {
    let (poses, end_effector) = (poses(&position, loops.as_ref())?, EndEffector { link, point });
    let (na, chi) = (mechanism.0.coordinates(), chi.as_slice()?);
    let shape = [poses.samples, (rows.len() + na) * na];
    let mut out = room(shape.iter().product())?;
    detached(py, || haptid_core::end_effector_dynamics(&mechanism.0, &poses, &end_effector, chi, &rows, &mut out))
        .map_err(to_python)?;
    out.into_pyarray(py).reshape(shape)
}

/// Condition number, masses, directions and covariance of the masses.
type Masses<'py> =
    (Bound<'py, PyArray1<f64>>, Bound<'py, PyArray2<f64>>, Bound<'py, PyArray3<f64>>, Bound<'py, PyArray2<f64>>);

#[pyfunction]
#[pyo3(signature = (mechanism, position, loops, link, point, chi, rows, moving, worst, spread))]
#[allow(clippy::too_many_arguments)]
pub fn apparent_mass<'py>(
    py: Python<'py>,
    mechanism: &PyMechanism,
    position: Matrix<'py>,
    loops: Option<Matrix<'py>>,
    link: usize,
    point: [f64; 3],
    chi: Vector<'py>,
    rows: Vec<usize>,
    moving: Vec<usize>,
    worst: f64,
    spread: Matrix<'py>,
) -> PyResult<Masses<'py>> {
    let (poses, end_effector) = (poses(&position, loops.as_ref())?, EndEffector { link, point });
    let query = ApparentMassQuery {
        rows: &rows,
        free: &moving,
        max_condition: worst,
        covariance_factor: row_major(&spread)?,
        factor_columns: spread.shape()[1],
    };
    let chi = chi.as_slice()?;
    let found = detached(py, || haptid_core::apparent_mass(&mechanism.0, &poses, &end_effector, chi, &query))
        .map_err(to_python)?;
    let (n, r) = (poses.samples, query.masses());
    Ok((
        found.condition.into_pyarray(py),
        found.masses.into_pyarray(py).reshape([n, r])?,
        found.directions.into_pyarray(py).reshape([n, r, rows.len()])?,
        found.covariance.into_pyarray(py).reshape([n, query.pairs()])?,
    ))
}
