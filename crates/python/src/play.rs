//! Links in the play of their transmissions: see `_core.pyi`.

use crate::arguments::{Matrix, Vector};
use crate::arrays::{room, rows_of};
use crate::threads::detached;
use crate::to_python;
use haptid_core::{Play, PlayMotion};
use numpy::{IntoPyArray, PyArray2, PyArrayMethods};
use pyo3::prelude::*;

#[pyfunction]
#[allow(clippy::too_many_arguments)]
pub fn torque_of_play<'py>(
    py: Python<'py>,
    dt: f64,
    position: Vector<'py>,
    velocity: Vector<'py>,
    acceleration: Vector<'py>,
    inertia: Vector<'py>,
    rest: Vector<'py>,
    dry: f64,
    viscous: f64,
    plays: Matrix<'py>,
) -> PyResult<Bound<'py, PyArray2<f64>>> {
    let (position, velocity, acceleration) = (position.as_slice()?, velocity.as_slice()?, acceleration.as_slice()?);
    let (inertia, rest) = (inertia.as_slice()?, rest.as_slice()?);
    let motion = PlayMotion { dt, position, velocity, acceleration, inertia, rest, dry, viscous };
    let plays: Vec<Play> =
        rows_of::<3>("plays", &plays)?.iter().map(|&[size, share, friction]| Play { size, share, friction }).collect();
    let mut out = room(plays.len() * position.len())?;
    let shape = [plays.len(), position.len()];
    detached(py, || haptid_core::torque_of_play(&motion, &plays, &mut out)).map_err(to_python)?;
    out.into_pyarray(py).reshape(shape)
}
