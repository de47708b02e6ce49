//! The seam to what the handle feels: see `_core.pyi`.

use crate::arrays::row_major;
use crate::threads::detached;
use crate::{PyMechanism, to_python};
use haptid_core::{ApparentMassQuery, BodyParameters, EndEffector, Poses};
use numpy::{IntoPyArray, PyArray2, PyArrayMethods, PyReadonlyArray1, PyReadonlyArray2, PyUntypedArrayMethods};
use pyo3::prelude::*;

/// Arguments that both kernels share.
struct Borrowed<'py> {
    position: PyReadonlyArray2<'py, f64>,
    rates: PyReadonlyArray2<'py, f64>,
    chi: PyReadonlyArray1<'py, f64>,
    rotors: PyReadonlyArray2<'py, f64>,
    inertia: PyReadonlyArray1<'py, f64>,
}

impl Borrowed<'_> {
    fn poses(&self) -> PyResult<Poses<'_>> {
        let (position, rates) = (row_major(&self.position)?, row_major(&self.rates)?);
        Ok(Poses { samples: self.position.shape()[1], position, rates })
    }

    fn bodies(&self) -> PyResult<BodyParameters<'_>> {
        let (chi, inertia) = (self.chi.as_slice()?, self.inertia.as_slice()?);
        Ok(BodyParameters { chi, rotors: row_major(&self.rotors)?, inertia })
    }
}

#[pyfunction]
#[allow(clippy::too_many_arguments)]
pub fn handle_dynamics<'py>(
    py: Python<'py>,
    mechanism: &PyMechanism,
    position: PyReadonlyArray2<'py, f64>,
    rates: PyReadonlyArray2<'py, f64>,
    link: usize,
    point: [f64; 3],
    chi: PyReadonlyArray1<'py, f64>,
    rotors: PyReadonlyArray2<'py, f64>,
    inertia: PyReadonlyArray1<'py, f64>,
    rows: Vec<usize>,
) -> PyResult<Bound<'py, PyArray2<f64>>> {
    let borrowed = Borrowed { position, rates, chi, rotors, inertia };
    let (poses, bodies, end_effector) = (borrowed.poses()?, borrowed.bodies()?, EndEffector { link, point });
    let na = mechanism.0.coordinates();
    let shape = [poses.samples, (rows.len() + na) * na];
    let mut out = vec![0.0; shape.iter().product()];
    detached(py, || haptid_core::end_effector_dynamics(&mechanism.0, &poses, &end_effector, &bodies, &rows, &mut out))
        .map_err(to_python)?;
    out.into_pyarray(py).reshape(shape)
}

#[pyfunction]
#[allow(clippy::too_many_arguments)]
pub fn felt_mass<'py>(
    py: Python<'py>,
    mechanism: &PyMechanism,
    position: PyReadonlyArray2<'py, f64>,
    rates: PyReadonlyArray2<'py, f64>,
    link: usize,
    point: [f64; 3],
    chi: PyReadonlyArray1<'py, f64>,
    rotors: PyReadonlyArray2<'py, f64>,
    inertia: PyReadonlyArray1<'py, f64>,
    rows: Vec<usize>,
    moving: Vec<usize>,
    worst: f64,
    spread: PyReadonlyArray2<'py, f64>,
) -> PyResult<Bound<'py, PyArray2<f64>>> {
    let borrowed = Borrowed { position, rates, chi, rotors, inertia };
    let (poses, bodies, end_effector) = (borrowed.poses()?, borrowed.bodies()?, EndEffector { link, point });
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
