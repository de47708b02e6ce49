//! Arrays in and out.

use haptid_core::Triangles;
use numpy::{IntoPyArray, PyArray3, PyArrayMethods, PyReadonlyArray2, PyReadonlyArray3, PyUntypedArrayMethods};
use pyo3::exceptions::PyValueError;
use pyo3::prelude::*;

/// A matrix's numbers, row by row. `as_slice` alone would take Fortran order too, and read it transposed.
pub fn row_major<'a>(matrix: &'a PyReadonlyArray2<'_, f64>) -> PyResult<&'a [f64]> {
    if !matrix.is_c_contiguous() {
        return Err(PyValueError::new_err("matrix is not row-major; pass numpy.ascontiguousarray(matrix)"));
    }
    Ok(matrix.as_slice()?)
}

/// The numbers of a stack of matrices of this shape, row by row.
pub fn stack<'a>(matrices: &'a PyReadonlyArray3<'_, f64>, shape: [usize; 3]) -> PyResult<&'a [f64]> {
    if matrices.shape() != shape || !matrices.is_c_contiguous() {
        let got = matrices.shape();
        return Err(PyValueError::new_err(format!("matrices have shape {got:?}; they must be row-major, {shape:?}")));
    }
    Ok(matrices.as_slice()?)
}

/// The caller's array to write to, if it has the shape and is row-major; else, if there is none, a new one.
pub fn output<'py>(
    py: Python<'py>,
    given: Option<Bound<'py, PyArray3<f64>>>,
    shape: [usize; 3],
) -> PyResult<Bound<'py, PyArray3<f64>>> {
    match given {
        None => Ok(PyArray3::zeros(py, shape, false)),
        Some(out) if out.shape() == shape && out.is_c_contiguous() => Ok(out),
        Some(out) => {
            Err(PyValueError::new_err(format!("out has shape {:?}; it must be row-major, {shape:?}", out.shape())))
        }
    }
}

/// A motor's columns, and its triangles as one array (blocks, columns + 1, columns + 1).
pub fn square_stack(py: Python<'_>, motor: Triangles) -> PyResult<(Vec<usize>, Bound<'_, PyArray3<f64>>)> {
    let (blocks, size) = (motor.blocks.len(), motor.columns.len() + 1);
    let stack = motor.blocks.concat().into_pyarray(py).reshape([blocks, size, size])?;
    Ok((motor.columns, stack))
}
