//! The compiled module `haptid._core`: arrays are borrowed, the interpreter's lock is released, errors become ValueError.
//! No arithmetic. Signatures and shapes are in `_core.pyi`.

#![deny(clippy::undocumented_unsafe_blocks)]

mod arguments;
mod arrays;
mod end_effector;
mod exact;
mod loops;
mod mechanism;
mod play;
mod threads;

use arguments::{Matrix, Vector};
use arrays::{room, row_major, stack};
use haptid_core::{Backend, Error};
use loops::{PyBranch, PyLoops};
use mechanism::PyMechanism;
use numpy::{IntoPyArray, PyArray2, PyArray3, PyArrayMethods, PyReadonlyArray3, PyUntypedArrayMethods};
use pyo3::exceptions::PyValueError;
use pyo3::prelude::*;
use threads::detached;

fn to_python(error: Error) -> PyErr {
    PyValueError::new_err(error.to_string())
}

/// R factors of stacks of rows, (stacks, columns, columns).
#[pyfunction]
fn triangles<'py>(py: Python<'py>, rows: PyReadonlyArray3<'py, f64>) -> PyResult<Bound<'py, PyArray3<f64>>> {
    let shape = rows.as_array().raw_dim();
    let (stacks, columns) = (shape[0], shape[2]);
    let numbers = stack(&rows, [shape[0], shape[1], shape[2]])?;
    let backend = Backend::selected().map_err(to_python)?;
    let mut out = vec![0.0; stacks * columns * columns];
    detached(py, || {
        let (many, square) = ((shape[1] * columns).max(1), (columns * columns).max(1));
        let stacks = numbers.chunks_exact(many).zip(out.chunks_exact_mut(square));
        stacks.into_iter().try_for_each(|(rows, out)| haptid_core::r_factor(backend, rows, columns, out))
    })
    .map_err(to_python)?;
    out.into_pyarray(py).reshape([stacks, columns, columns])
}

/// Channels through their own second-order sections, both ways: see `_core.pyi`.
#[pyfunction]
fn filter_both_ways<'py>(
    py: Python<'py>,
    sections: PyReadonlyArray3<'py, f64>,
    channels: Matrix<'py>,
    padding: usize,
) -> PyResult<Bound<'py, PyArray2<f64>>> {
    let (many, samples) = (channels.shape()[0], channels.shape()[1]);
    let sections = stack(&sections, [many, sections.shape()[1], 6])?;
    let (numbers, mut out) = (row_major(&channels)?, room(many * samples)?);
    let backend = Backend::selected().map_err(to_python)?;
    detached(py, || haptid_core::filter_both_ways(backend, sections, numbers, samples, padding, &mut out))
        .map_err(to_python)?;
    out.into_pyarray(py).reshape([many, samples])
}

/// Channels filtered and decimated: see `_core.pyi`.
#[pyfunction]
fn decimate<'py>(
    py: Python<'py>,
    channels: Matrix<'py>,
    taps: Vector<'py>,
    decimation: usize,
) -> PyResult<Bound<'py, PyArray2<f64>>> {
    let (many, samples) = (channels.shape()[0], channels.shape()[1]);
    let (numbers, taps) = (row_major(&channels)?, taps.as_slice()?);
    let rows = samples.checked_sub(taps.len()).map_or(0, |room| 1 + room / decimation.max(1));
    let mut out = room(many * rows)?;
    let backend = Backend::selected().map_err(to_python)?;
    detached(py, || haptid_core::decimate(backend, numbers, samples, taps, decimation, &mut out)).map_err(to_python)?;
    out.into_pyarray(py).reshape([many, rows])
}

/// The numbers and the size of a square matrix.
fn square<'a>(matrix: &'a Matrix<'_>) -> PyResult<(&'a [f64], usize)> {
    match matrix.shape() {
        [rows, columns] if rows == columns => Ok((row_major(matrix)?, *rows)),
        shape => Err(PyValueError::new_err(format!("matrix has shape {shape:?}; it must be square"))),
    }
}

/// The smallest and the largest eigenvalue of a symmetric matrix.
#[pyfunction]
fn extreme_eigenvalues(py: Python<'_>, matrix: Matrix<'_>) -> PyResult<(f64, f64)> {
    let (numbers, n) = square(&matrix)?;
    let backend = Backend::selected().map_err(to_python)?;
    let [low, high] = detached(py, || haptid_core::extreme_eigenvalues(backend, numbers, n)).map_err(to_python)?;
    Ok((low, high))
}

/// A smooth condition number of W from C = W'W, and its derivative with respect to C.
#[pyfunction]
fn smooth_condition<'py>(
    py: Python<'py>,
    matrix: Matrix<'py>,
    power: usize,
) -> PyResult<Option<(f64, Bound<'py, PyArray2<f64>>)>> {
    let (numbers, n) = square(&matrix)?;
    let backend = Backend::selected().map_err(to_python)?;
    let mut slope = room(n * n)?;
    let cost =
        detached(py, || haptid_core::smooth_condition(backend, numbers, n, power, &mut slope)).map_err(to_python)?;
    cost.map(|cost| Ok((cost, slope.into_pyarray(py).reshape([n, n])?))).transpose()
}

/// Names of the instruction sets this machine can run, fastest first.
#[pyfunction]
fn backends() -> Vec<&'static str> {
    Backend::available().into_iter().map(Backend::name).collect()
}

#[pymodule]
fn _core(module: &Bound<'_, PyModule>) -> PyResult<()> {
    threads::remember_process();
    module.add_class::<PyMechanism>()?;
    module.add_class::<PyLoops>()?;
    module.add_class::<PyBranch>()?;
    module.add_function(wrap_pyfunction!(backends, module)?)?;
    module.add_function(wrap_pyfunction!(triangles, module)?)?;
    module.add_function(wrap_pyfunction!(filter_both_ways, module)?)?;
    module.add_function(wrap_pyfunction!(decimate, module)?)?;
    module.add_function(wrap_pyfunction!(extreme_eigenvalues, module)?)?;
    module.add_function(wrap_pyfunction!(smooth_condition, module)?)?;
    module.add_function(wrap_pyfunction!(exact::echelon, module)?)?;
    module.add_function(wrap_pyfunction!(exact::exact_rows, module)?)?;
    module.add_function(wrap_pyfunction!(exact::real_rows, module)?)?;
    module.add_function(wrap_pyfunction!(end_effector::end_effector_dynamics, module)?)?;
    module.add_function(wrap_pyfunction!(end_effector::apparent_mass, module)?)?;
    module.add_function(wrap_pyfunction!(play::torque_of_play, module)?)?;
    module.add("__version__", env!("CARGO_PKG_VERSION"))
}
