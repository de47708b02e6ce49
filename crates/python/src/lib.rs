//! The seam between haptid-core and Python: borrow arrays, leave the interpreter, map the error. No arithmetic.

mod arrays;
mod handle;
mod loops;
mod threads;

use arrays::{Columns, of_samples, output, room, row_major, sets, square_stack, stack};
use haptid_core::{Backend, Closure, Error, Law, Mechanism, Motion, Reduction, Term};
use loops::{PyBranch, PyLoops, joints};
use numpy::{
    IntoPyArray, PyArray2, PyArray3, PyArray4, PyArrayMethods, PyReadonlyArray1, PyReadonlyArray2, PyReadonlyArray3,
    PyReadonlyArrayDyn,
};
use pyo3::exceptions::PyValueError;
use pyo3::prelude::*;
use threads::detached;

fn to_python(error: Error) -> PyErr {
    PyValueError::new_err(error.to_string())
}

/// A term as Python gives it: kind, weights, offset, and up to three settings.
type TermArguments<'py> = (String, PyReadonlyArray1<'py, f64>, f64, f64, f64, f64);

fn term((kind, weights, offset, a, b, c): TermArguments, coordinates: usize, joint: Option<usize>) -> PyResult<Term> {
    let law = match kind.as_str() {
        "rotor" => Law::Rotor,
        "viscous" => Law::Viscous,
        "coulomb" => Law::Coulomb { width: a },
        "coulomb+" => Law::CoulombForward { width: a },
        "coulomb-" => Law::CoulombBackward { width: a },
        "stribeck" => Law::Stribeck { velocity: a, exponent: b, width: c },
        "offset" => Law::Offset,
        "spring" => Law::Spring { rest: a },
        "external" => Law::External,
        _ => return Err(PyValueError::new_err(format!("unknown kind of term {kind:?}"))),
    };
    if weights.as_array().len() != coordinates {
        return Err(PyValueError::new_err(format!(
            "a term has {} weights, wanted {coordinates}: one for each coordinate",
            weights.as_array().len()
        )));
    }
    let weights = weights.as_array().iter().copied().enumerate().filter(|w| w.1 != 0.0).collect();
    Ok(Term { law, weights, offset, joint })
}

/// A tree or closed chain, ready for the kernels. See `_core.pyi`.
#[pyclass(name = "Mechanism", frozen, module = "haptid._core")]
struct PyMechanism(Mechanism);

/// Position, velocity, acceleration (where there is one), external columns and loops (where there are some), each
/// (channels, samples).
struct Borrowed<'py> {
    position: PyReadonlyArray2<'py, f64>,
    velocity: PyReadonlyArray2<'py, f64>,
    acceleration: Option<PyReadonlyArray2<'py, f64>>,
    external: PyReadonlyArray2<'py, f64>,
    loops: Option<PyReadonlyArray2<'py, f64>>,
}

impl<'py> Borrowed<'py> {
    fn motion(&self) -> PyResult<Motion<'_>> {
        let shape = self.position.as_array().raw_dim();
        let other = |array: &PyReadonlyArray2<'py, f64>| array.as_array().raw_dim() != shape;
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

#[pymethods]
impl PyMechanism {
    #[new]
    #[pyo3(signature = (parent, rotation, translation, prismatic, gravity, rates, offset, terms, backend=None, given=None, on=None))]
    #[allow(clippy::too_many_arguments)]
    fn new(
        parent: Vec<isize>,
        rotation: PyReadonlyArray3<'_, f64>,
        translation: PyReadonlyArray2<'_, f64>,
        prismatic: Vec<bool>,
        gravity: [f64; 3],
        rates: PyReadonlyArray2<'_, f64>,
        offset: PyReadonlyArray1<'_, f64>,
        terms: Vec<TermArguments<'_>>,
        backend: Option<&str>,
        given: Option<PyReadonlyArray2<'_, bool>>,
        on: Option<Vec<Option<usize>>>,
    ) -> PyResult<Self> {
        let joints = joints(&parent, &rotation, &translation, &prismatic)?;
        let closure = Closure {
            rates: rates.as_array().iter().copied().collect(),
            offset: offset.as_array().to_vec(),
            given: given.map_or(Vec::new(), |given| given.as_array().iter().copied().collect()),
        };
        let coordinates = rates.as_array().ncols();
        let on = on.unwrap_or_else(|| vec![None; terms.len()]);
        if on.len() != terms.len() {
            return Err(PyValueError::new_err(format!("{} terms act on {} joints", terms.len(), on.len())));
        }
        let terms: Vec<Term> =
            terms.into_iter().zip(on).map(|(t, joint)| term(t, coordinates, joint)).collect::<PyResult<_>>()?;
        let backend = backend.map_or_else(Backend::selected, Backend::named).map_err(to_python)?;
        Mechanism::new(&joints, &closure, gravity, &terms, backend).map(PyMechanism).map_err(to_python)
    }

    /// Number of coordinates, and of torque rows.
    #[getter]
    fn coordinates(&self) -> usize {
        self.0.coordinates()
    }

    /// Number of columns: ten for each link, one for each term.
    #[getter]
    fn columns(&self) -> usize {
        self.0.columns()
    }

    #[pyo3(signature = (position, velocity, acceleration, external, columns, loops=None, out=None))]
    #[allow(clippy::too_many_arguments)]
    fn regressor<'py>(
        &self,
        py: Python<'py>,
        position: PyReadonlyArray2<'py, f64>,
        velocity: PyReadonlyArray2<'py, f64>,
        acceleration: PyReadonlyArray2<'py, f64>,
        external: PyReadonlyArray2<'py, f64>,
        columns: Columns,
        loops: Option<PyReadonlyArray2<'py, f64>>,
        out: Option<Bound<'py, PyArray3<f64>>>,
    ) -> PyResult<Bound<'py, PyArray3<f64>>> {
        let borrowed = Borrowed { position, velocity, acceleration: Some(acceleration), external, loops };
        let motion = borrowed.motion()?;
        let out = output(py, out, [self.0.coordinates(), columns.len(), motion.samples])?;
        let mut borrowed = out.try_readwrite()?;
        let numbers = borrowed.as_slice_mut()?;
        detached(py, || haptid_core::regressor(&self.0, &motion, &columns, numbers)).map_err(to_python)?;
        Ok(out)
    }

    #[pyo3(signature = (position, velocity, acceleration, external, chi, loops=None))]
    #[allow(clippy::too_many_arguments)]
    fn torque<'py>(
        &self,
        py: Python<'py>,
        position: PyReadonlyArray2<'py, f64>,
        velocity: PyReadonlyArray2<'py, f64>,
        acceleration: PyReadonlyArray2<'py, f64>,
        external: PyReadonlyArray2<'py, f64>,
        chi: PyReadonlyArrayDyn<'py, f64>,
        loops: Option<PyReadonlyArray2<'py, f64>>,
    ) -> PyResult<Bound<'py, PyArray2<f64>>> {
        let borrowed = Borrowed { position, velocity, acceleration: Some(acceleration), external, loops };
        let (motion, chi) = (borrowed.motion()?, sets(&chi, self.0.columns())?);
        let shape = [self.0.coordinates(), motion.samples];
        let mut out = room(shape.iter().product())?;
        detached(py, || haptid_core::inverse_dynamics(&self.0, &motion, chi, &mut out)).map_err(to_python)?;
        out.into_pyarray(py).reshape(shape)
    }

    #[pyo3(signature = (position, chi, loops=None))]
    fn mass_matrix<'py>(
        &self,
        py: Python<'py>,
        position: PyReadonlyArray2<'py, f64>,
        chi: PyReadonlyArrayDyn<'py, f64>,
        loops: Option<PyReadonlyArray2<'py, f64>>,
    ) -> PyResult<Bound<'py, PyArray3<f64>>> {
        let motion = Motion {
            samples: position.as_array().ncols(),
            position: row_major(&position)?,
            velocity: &[],
            acceleration: None,
            external: &[],
            loops: loops.as_ref().map_or(Ok(&[][..]), row_major)?,
        };
        let (na, chi) = (self.0.coordinates(), sets(&chi, self.0.columns())?);
        let mut out = room(motion.samples * na * na)?;
        detached(py, || haptid_core::mass_matrix(&self.0, &motion, chi, &mut out)).map_err(to_python)?;
        out.into_pyarray(py).reshape([motion.samples, na, na])
    }

    #[pyo3(signature = (position, velocity, torque, external, chi, loops=None))]
    #[allow(clippy::too_many_arguments)]
    fn acceleration<'py>(
        &self,
        py: Python<'py>,
        position: PyReadonlyArray2<'py, f64>,
        velocity: PyReadonlyArray2<'py, f64>,
        torque: PyReadonlyArray2<'py, f64>,
        external: PyReadonlyArray2<'py, f64>,
        chi: PyReadonlyArrayDyn<'py, f64>,
        loops: Option<PyReadonlyArray2<'py, f64>>,
    ) -> PyResult<(Bound<'py, PyArray2<f64>>, Option<usize>)> {
        let borrowed = Borrowed { position, velocity, acceleration: None, external, loops };
        let (motion, torque) =
            (borrowed.motion()?, of_samples("torque", &torque, borrowed.position.as_array().ncols())?);
        let (shape, chi) = ([self.0.coordinates(), motion.samples], sets(&chi, self.0.columns())?);
        let mut out = room(shape.iter().product())?;
        let failed = detached(py, || haptid_core::forward_dynamics(&self.0, &motion, torque, chi, &mut out))
            .map_err(to_python)?;
        Ok((out.into_pyarray(py).reshape(shape)?, failed))
    }

    #[pyo3(signature = (position, velocity, external, columns, loops=None))]
    fn momentum_regressor<'py>(
        &self,
        py: Python<'py>,
        position: PyReadonlyArray2<'py, f64>,
        velocity: PyReadonlyArray2<'py, f64>,
        external: PyReadonlyArray2<'py, f64>,
        columns: Columns,
        loops: Option<PyReadonlyArray2<'py, f64>>,
    ) -> PyResult<Bound<'py, PyArray4<f64>>> {
        let borrowed = Borrowed { position, velocity, acceleration: None, external, loops };
        let motion = borrowed.motion()?;
        let shape = [motion.sets(), self.0.coordinates(), columns.len(), motion.samples];
        let mut out = room(shape.iter().product())?;
        detached(py, || haptid_core::regressor(&self.0, &motion, &columns, &mut out)).map_err(to_python)?;
        out.into_pyarray(py).reshape(shape)
    }

    #[pyo3(signature = (position, velocity, external, chi, loops=None))]
    fn momentum<'py>(
        &self,
        py: Python<'py>,
        position: PyReadonlyArray2<'py, f64>,
        velocity: PyReadonlyArray2<'py, f64>,
        external: PyReadonlyArray2<'py, f64>,
        chi: PyReadonlyArrayDyn<'py, f64>,
        loops: Option<PyReadonlyArray2<'py, f64>>,
    ) -> PyResult<Bound<'py, PyArray3<f64>>> {
        let borrowed = Borrowed { position, velocity, acceleration: None, external, loops };
        let (motion, chi) = (borrowed.motion()?, sets(&chi, self.0.columns())?);
        let shape = [motion.sets(), self.0.coordinates(), motion.samples];
        let mut out = room(shape.iter().product())?;
        detached(py, || haptid_core::inverse_dynamics(&self.0, &motion, chi, &mut out)).map_err(to_python)?;
        out.into_pyarray(py).reshape(shape)
    }

    #[pyo3(signature = (position, velocity, acceleration, external, columns, loops=None))]
    #[allow(clippy::too_many_arguments)]
    fn inner_products<'py>(
        &self,
        py: Python<'py>,
        position: PyReadonlyArray2<'py, f64>,
        velocity: PyReadonlyArray2<'py, f64>,
        acceleration: PyReadonlyArray2<'py, f64>,
        external: PyReadonlyArray2<'py, f64>,
        columns: Columns,
        loops: Option<PyReadonlyArray2<'py, f64>>,
    ) -> PyResult<Bound<'py, PyArray3<f64>>> {
        let borrowed = Borrowed { position, velocity, acceleration: Some(acceleration), external, loops };
        let motion = borrowed.motion()?;
        let shape = [self.0.coordinates(), columns.len(), columns.len()];
        let mut out = room(shape.iter().product())?;
        detached(py, || haptid_core::gram_matrices(&self.0, &motion, &columns, &mut out)).map_err(to_python)?;
        out.into_pyarray(py).reshape(shape)
    }

    #[pyo3(signature = (position, velocity, acceleration, external, columns, forms, loops=None))]
    #[allow(clippy::too_many_arguments)]
    fn form_slopes<'py>(
        &self,
        py: Python<'py>,
        position: PyReadonlyArray2<'py, f64>,
        velocity: PyReadonlyArray2<'py, f64>,
        acceleration: PyReadonlyArray2<'py, f64>,
        external: PyReadonlyArray2<'py, f64>,
        columns: Columns,
        forms: PyReadonlyArray3<'py, f64>,
        loops: Option<PyReadonlyArray2<'py, f64>>,
    ) -> PyResult<Bound<'py, PyArray2<f64>>> {
        let borrowed = Borrowed { position, velocity, acceleration: Some(acceleration), external, loops };
        let motion = borrowed.motion()?;
        let wanted = [self.0.coordinates(), columns.len(), columns.len()];
        let forms = stack(&forms, wanted)?;
        let shape = [self.0.channels(), motion.samples];
        let mut out = room(shape.iter().product())?;
        detached(py, || haptid_core::quadratic_form_gradients(&self.0, &motion, &columns, forms, &mut out))
            .map_err(to_python)?;
        out.into_pyarray(py).reshape(shape)
    }

    #[pyo3(signature = (position, velocity, acceleration, external, columns, chi, loops=None))]
    #[allow(clippy::too_many_arguments)]
    fn torque_slopes<'py>(
        &self,
        py: Python<'py>,
        position: PyReadonlyArray2<'py, f64>,
        velocity: PyReadonlyArray2<'py, f64>,
        acceleration: PyReadonlyArray2<'py, f64>,
        external: PyReadonlyArray2<'py, f64>,
        columns: Columns,
        chi: Vec<f64>,
        loops: Option<PyReadonlyArray2<'py, f64>>,
    ) -> PyResult<Bound<'py, PyArray3<f64>>> {
        let borrowed = Borrowed { position, velocity, acceleration: Some(acceleration), external, loops };
        let motion = borrowed.motion()?;
        let shape = [self.0.coordinates(), self.0.channels(), motion.samples];
        let mut out = room(shape.iter().product())?;
        detached(py, || haptid_core::torque_gradients(&self.0, &motion, &columns, &chi, &mut out))
            .map_err(to_python)?;
        out.into_pyarray(py).reshape(shape)
    }

    /// Which of the chosen columns each coordinate's row can reach.
    fn reach(&self, columns: Columns) -> PyResult<Vec<Vec<bool>>> {
        let flat = haptid_core::structural_nonzeros(&self.0, &columns).map_err(to_python)?;
        Ok((0..self.0.coordinates()).map(|a| flat[a * columns.len()..][..columns.len()].to_vec()).collect())
    }

    #[pyo3(signature = (position, velocity, acceleration, external, torque, columns, taps, decimation, first, rows, block, weights, slope=None, loops=None))]
    #[allow(clippy::too_many_arguments, clippy::type_complexity)]
    fn reduce<'py>(
        &self,
        py: Python<'py>,
        position: PyReadonlyArray2<'py, f64>,
        velocity: PyReadonlyArray2<'py, f64>,
        acceleration: Option<PyReadonlyArray2<'py, f64>>,
        external: PyReadonlyArray2<'py, f64>,
        torque: PyReadonlyArray2<'py, f64>,
        columns: Columns,
        taps: PyReadonlyArray1<'py, f64>,
        decimation: usize,
        first: usize,
        rows: usize,
        block: usize,
        weights: PyReadonlyArray2<'py, f64>,
        slope: Option<PyReadonlyArray1<'py, f64>>,
        loops: Option<PyReadonlyArray2<'py, f64>>,
    ) -> PyResult<Vec<(Vec<usize>, Bound<'py, PyArray3<f64>>)>> {
        let borrowed = Borrowed { position, velocity, acceleration, external, loops };
        let motion = borrowed.motion()?;
        let reduction = Reduction {
            columns: &columns,
            torque: of_samples("torque", &torque, motion.samples)?,
            taps: taps.as_slice()?,
            derivative_taps: slope.as_ref().map_or(Ok(&[][..]), |slope| slope.as_slice())?,
            decimation,
            first,
            rows,
            block,
            weights: row_major(&weights)?,
        };
        let done = detached(py, || haptid_core::reduce(&self.0, &motion, &reduction)).map_err(to_python)?;
        done.into_iter().map(|motor| square_stack(py, motor)).collect()
    }
}

/// The square upper triangles of stacks of rows, (stacks, columns, columns).
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
    threads::settle();
    module.add_class::<PyMechanism>()?;
    module.add_class::<PyLoops>()?;
    module.add_class::<PyBranch>()?;
    module.add_function(wrap_pyfunction!(backends, module)?)?;
    module.add_function(wrap_pyfunction!(triangles, module)?)?;
    module.add_function(wrap_pyfunction!(handle::handle_dynamics, module)?)?;
    module.add_function(wrap_pyfunction!(handle::felt_mass, module)?)?;
    module.add("__version__", env!("CARGO_PKG_VERSION"))
}
