//! Arrays in and out of Python.

use haptid_core::RFactors;
use numpy::{
    IntoPyArray, PyArray1, PyArray3, PyArrayMethods, PyReadonlyArray1, PyReadonlyArray2, PyReadonlyArray3,
    PyReadonlyArrayDyn, PyUntypedArrayMethods,
};
use pyo3::exceptions::{PyMemoryError, PyValueError};
use pyo3::prelude::*;
use pyo3::types::PySlice;
use std::mem::MaybeUninit;
use std::ops::Deref;

/// The numbers of a row-major matrix. `as_slice` alone would accept Fortran order too, and read it transposed.
pub fn row_major<'a>(matrix: &'a PyReadonlyArray2<'_, f64>) -> PyResult<&'a [f64]> {
    if !matrix.is_c_contiguous() {
        return Err(PyValueError::new_err("matrix is not row-major; pass numpy.ascontiguousarray(matrix)"));
    }
    Ok(matrix.as_slice()?)
}

/// The rows of a row-major matrix with N columns.
pub fn rows_of<'a, const N: usize>(name: &str, matrix: &'a PyReadonlyArray2<'_, f64>) -> PyResult<&'a [[f64; N]]> {
    match matrix.shape() {
        [_, columns] if *columns == N => Ok(row_major(matrix)?.as_chunks().0),
        shape => Err(PyValueError::new_err(format!("{name} have shape {shape:?}; they must be (rows, {N})"))),
    }
}

/// The numbers of a row-major matrix with a column for each sample.
pub fn of_samples<'a>(name: &str, matrix: &'a PyReadonlyArray2<'_, f64>, samples: usize) -> PyResult<&'a [f64]> {
    match matrix.shape() {
        [0, _] => Ok(&[]),
        [_, columns] if *columns == samples => row_major(matrix),
        [_, columns] => Err(PyValueError::new_err(format!("{name} has {columns} samples, positions have {samples}"))),
        _ => unreachable!("a matrix has two dimensions"),
    }
}

/// The numbers of a row-major stack of matrices of this shape.
pub fn stack<'a>(matrices: &'a PyReadonlyArray3<'_, f64>, shape: [usize; 3]) -> PyResult<&'a [f64]> {
    if matrices.shape() != shape || !matrices.is_c_contiguous() {
        let got = matrices.shape();
        return Err(PyValueError::new_err(format!("matrices have shape {got:?}; they must be row-major, {shape:?}")));
    }
    Ok(matrices.as_slice()?)
}

/// Parameters of all columns, (columns,), or several sets of them, (sets, columns).
pub fn sets<'a>(chi: &'a PyReadonlyArrayDyn<'_, f64>, columns: usize) -> PyResult<&'a [f64]> {
    match chi.shape() {
        [.., last] if chi.ndim() <= 2 && *last == columns && chi.is_c_contiguous() => Ok(chi.as_slice()?),
        shape => {
            Err(PyValueError::new_err(format!("chi has shape {shape:?}; it must be row-major, (sets, {columns})")))
        }
    }
}

/// A vector of zeros; MemoryError where it does not fit into memory.
pub fn room(numbers: usize) -> PyResult<Vec<f64>> {
    let mut room = reserved(numbers)?;
    room.resize(numbers, 0.0);
    Ok(room)
}

fn reserved(numbers: usize) -> PyResult<Vec<f64>> {
    let mut room = Vec::new();
    let refused = |_| PyMemoryError::new_err(format!("there is no memory for {numbers} numbers; take fewer samples"));
    room.try_reserve_exact(numbers).map_err(refused)?;
    Ok(room)
}

/// Numbers in a cache line.
const LINE: usize = 8;

/// The caller's output array, if it has the shape and is row-major.
pub fn fitting<'py>(out: Bound<'py, PyArray3<f64>>, shape: [usize; 3]) -> PyResult<Bound<'py, PyArray3<f64>>> {
    if out.shape() == shape && out.is_c_contiguous() {
        return Ok(out);
    }
    Err(PyValueError::new_err(format!("out has shape {:?}; it must be row-major, {shape:?}", out.shape())))
}

/// A new array that begins at a cache line, with what `write` writes: every number, where it succeeds.
pub fn written<'py>(
    py: Python<'py>,
    shape: [usize; 3],
    write: impl FnOnce(&mut [MaybeUninit<f64>]) -> PyResult<()>,
) -> PyResult<Bound<'py, PyArray3<f64>>> {
    let numbers: usize = shape.iter().product();
    let mut room = reserved(numbers + LINE - 1)?;
    let first = room.as_ptr().align_offset(LINE * size_of::<f64>());
    room.spare_capacity_mut()[..first].fill(MaybeUninit::new(0.0));
    write(&mut room.spare_capacity_mut()[first..first + numbers])?;
    // SAFETY: the capacity has been reserved; the numbers before the first have been written, and then `write` has
    // written all of its own.
    unsafe { room.set_len(first + numbers) };
    let part = PySlice::new(py, first as isize, (first + numbers) as isize, 1);
    room.into_pyarray(py).as_any().get_item(part)?.cast_into::<PyArray1<f64>>()?.reshape(shape)
}

/// Indices of columns: an array of 64-bit integers is read directly, any other sequence item by item.
pub struct Columns(Vec<usize>);

impl<'py> FromPyObject<'_, 'py> for Columns {
    type Error = PyErr;

    fn extract(columns: Borrowed<'_, 'py, PyAny>) -> PyResult<Columns> {
        let Ok(array) = columns.extract::<PyReadonlyArray1<'py, i64>>() else {
            return columns.extract().map(Columns);
        };
        Ok(Columns(array.as_array().iter().map(|&column| usize::try_from(column)).collect::<Result<_, _>>()?))
    }
}

impl Deref for Columns {
    type Target = [usize];

    fn deref(&self) -> &[usize] {
        &self.0
    }
}

/// A motor's columns, and its R factors as one array (blocks, columns + 1, columns + 1).
pub fn square_stack(py: Python<'_>, motor: RFactors) -> PyResult<(Vec<usize>, Bound<'_, PyArray3<f64>>)> {
    let (blocks, size) = (motor.blocks.len(), motor.columns.len() + 1);
    let stack = motor.blocks.concat().into_pyarray(py).reshape([blocks, size, size])?;
    Ok((motor.columns, stack))
}
