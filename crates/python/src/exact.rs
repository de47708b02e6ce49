//! Exact arithmetic modulo a prime, and rows of the regressor in floating point: see `_core.pyi`.

use crate::threads::detached;
use crate::to_python;
use haptid_core::{Backend, Error, ExactStates, TreeStates};
use numpy::{
    Element, IntoPyArray, PyArray3, PyArrayMethods, PyReadonlyArray2, PyReadonlyArray3, PyReadonlyArray4,
    PyUntypedArrayMethods,
};
use pyo3::exceptions::PyValueError;
use pyo3::prelude::*;

/// The numbers of a row-major array.
macro_rules! numbers {
    ($name:literal, $array:expr) => {
        if $array.is_c_contiguous() {
            $array.as_slice()?
        } else {
            return Err(PyValueError::new_err(concat!($name, " must be row-major")));
        }
    };
}

/// Reduced row echelon forms modulo a prime, and the pivots' columns; None where the matrices differ in them.
#[pyfunction]
#[allow(clippy::type_complexity)]
pub(crate) fn echelon<'py>(
    py: Python<'py>,
    matrices: PyReadonlyArray3<'py, i64>,
    candidates: usize,
    prime: u32,
) -> PyResult<Option<(Bound<'py, PyArray3<i64>>, Vec<usize>)>> {
    let [count, rows, columns] = [matrices.shape()[0], matrices.shape()[1], matrices.shape()[2]];
    let mut forms: Vec<i64> = matrices.as_array().iter().copied().collect();
    let backend = Backend::selected().map_err(to_python)?;
    let work = || haptid_core::echelon(backend, &mut forms, [count, rows, columns], candidates, prime);
    let Some(pivots) = detached(py, work).map_err(to_python)? else { return Ok(None) };
    Ok(Some((forms.into_pyarray(py).reshape([count, rows, columns])?, pivots)))
}

/// Rows of the regressor modulo a prime, (states, active, columns).
#[pyfunction]
#[allow(clippy::too_many_arguments)]
pub(crate) fn exact_rows<'py>(
    py: Python<'py>,
    parent: Vec<isize>,
    prismatic: Vec<bool>,
    placements: PyReadonlyArray4<'py, i64>,
    motion: PyReadonlyArray3<'py, i64>,
    rates: PyReadonlyArray3<'py, i64>,
    base: PyReadonlyArray2<'py, i64>,
    samples: usize,
    prime: u32,
) -> PyResult<Bound<'py, PyArray3<i64>>> {
    let work = |states: &ExactStates, out: &mut [i64]| haptid_core::exact_rows(states, prime, out);
    tree_rows(py, (parent, prismatic, samples), (placements, motion, rates, base), work)
}

/// The same in floating point.
#[pyfunction]
#[allow(clippy::too_many_arguments)]
pub(crate) fn real_rows<'py>(
    py: Python<'py>,
    parent: Vec<isize>,
    prismatic: Vec<bool>,
    placements: PyReadonlyArray4<'py, f64>,
    motion: PyReadonlyArray3<'py, f64>,
    rates: PyReadonlyArray3<'py, f64>,
    base: PyReadonlyArray2<'py, f64>,
    samples: usize,
) -> PyResult<Bound<'py, PyArray3<f64>>> {
    tree_rows(py, (parent, prismatic, samples), (placements, motion, rates, base), haptid_core::real_rows)
}

/// Placements, motion, rates and base.
type Parts<'py, N> =
    (PyReadonlyArray4<'py, N>, PyReadonlyArray3<'py, N>, PyReadonlyArray3<'py, N>, PyReadonlyArray2<'py, N>);

fn tree_rows<'py, N: Element + Copy + Default + Send + Sync>(
    py: Python<'py>,
    (parent, prismatic, samples): (Vec<isize>, Vec<bool>, usize),
    (placements, motion, rates, base): Parts<'py, N>,
    work: impl FnOnce(&TreeStates<N>, &mut [N]) -> Result<(), Error> + Send,
) -> PyResult<Bound<'py, PyArray3<N>>> {
    let parent: Vec<Option<usize>> = parent.into_iter().map(|parent| usize::try_from(parent).ok()).collect();
    let (count, active) = (base.shape()[0], rates.shape()[2]);
    let states = TreeStates {
        parent: &parent,
        prismatic: &prismatic,
        active,
        samples,
        placements: numbers!("placements", placements),
        motion: numbers!("motion", motion),
        rates: numbers!("rates", rates),
        base: numbers!("base", base),
    };
    let shape = [count, active, 10 * parent.len()];
    let mut out = vec![N::default(); shape.iter().product()];
    detached(py, || work(&states, &mut out)).map_err(to_python)?;
    out.into_pyarray(py).reshape(shape)
}
