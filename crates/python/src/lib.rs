//! The compiled module `haptid._core`: arrays are borrowed, the interpreter's lock is released, errors become ValueError.
//! No arithmetic. Signatures and shapes are in `_core.pyi`.

#![deny(clippy::undocumented_unsafe_blocks)]

mod arguments;
mod arrays;
mod end_effector;
mod exact;
mod loops;
mod mechanism;
mod threads;

use arrays::stack;
use haptid_core::{Backend, Error};
use loops::{PyBranch, PyLoops};
use mechanism::PyMechanism;
use numpy::{IntoPyArray, PyArray3, PyArrayMethods, PyReadonlyArray3};
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
    module.add_function(wrap_pyfunction!(exact::echelon, module)?)?;
    module.add_function(wrap_pyfunction!(exact::exact_rows, module)?)?;
    module.add_function(wrap_pyfunction!(exact::real_rows, module)?)?;
    module.add_function(wrap_pyfunction!(end_effector::end_effector_dynamics, module)?)?;
    module.add_function(wrap_pyfunction!(end_effector::apparent_mass, module)?)?;
    module.add("__version__", env!("CARGO_PKG_VERSION"))
}
