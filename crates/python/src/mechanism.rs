//! The class `Mechanism`: see `_core.pyi`.

use crate::arguments::{Matrix, MotionArguments, Sets, Stack, Vector};
use crate::arrays::{Columns, fitting, of_samples, room, row_major, sets, square_stack, written};
use crate::loops::joints;
use crate::threads::detached;
use crate::to_python;
use haptid_core::{Backend, Closure, Law, Mechanism, Motion, Reduction, Term};
use numpy::{IntoPyArray, PyArray2, PyArray3, PyArray4, PyArrayMethods, PyReadonlyArray2};
use pyo3::exceptions::PyValueError;
use pyo3::prelude::*;

/// A term as passed from Python: kind, weights, offset, and up to three constants of its law.
type TermArguments<'py> = (String, Vector<'py>, f64, f64, f64, f64);

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
pub(crate) struct PyMechanism(pub(crate) Mechanism);

#[pymethods]
impl PyMechanism {
    #[new]
    #[pyo3(signature = (parent, rotation, translation, prismatic, gravity, rates, offset, terms, backend=None, given=None, on=None))]
    #[allow(clippy::too_many_arguments)]
    fn new(
        parent: Vec<isize>,
        rotation: Stack<'_>,
        translation: Matrix<'_>,
        prismatic: Vec<bool>,
        gravity: [f64; 3],
        rates: Matrix<'_>,
        offset: Vector<'_>,
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
        position: Matrix<'py>,
        velocity: Matrix<'py>,
        acceleration: Matrix<'py>,
        external: Matrix<'py>,
        columns: Columns,
        loops: Option<Matrix<'py>>,
        out: Option<Bound<'py, PyArray3<f64>>>,
    ) -> PyResult<Bound<'py, PyArray3<f64>>> {
        let arguments = MotionArguments { position, velocity, acceleration: Some(acceleration), external, loops };
        let motion = arguments.motion()?;
        let shape = [self.0.coordinates(), columns.len(), motion.samples];
        let Some(out) = out else {
            return written(py, shape, |numbers| {
                detached(py, || haptid_core::new_regressor(&self.0, &motion, &columns, numbers)).map_err(to_python)
            });
        };
        let out = fitting(out, shape)?;
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
        position: Matrix<'py>,
        velocity: Matrix<'py>,
        acceleration: Matrix<'py>,
        external: Matrix<'py>,
        chi: Sets<'py>,
        loops: Option<Matrix<'py>>,
    ) -> PyResult<Bound<'py, PyArray2<f64>>> {
        let arguments = MotionArguments { position, velocity, acceleration: Some(acceleration), external, loops };
        let (motion, chi) = (arguments.motion()?, sets(&chi, self.0.columns())?);
        let shape = [self.0.coordinates(), motion.samples];
        let mut out = room(shape.iter().product())?;
        detached(py, || haptid_core::inverse_dynamics(&self.0, &motion, chi, &mut out)).map_err(to_python)?;
        out.into_pyarray(py).reshape(shape)
    }

    #[pyo3(signature = (position, chi, loops=None))]
    fn mass_matrix<'py>(
        &self,
        py: Python<'py>,
        position: Matrix<'py>,
        chi: Sets<'py>,
        loops: Option<Matrix<'py>>,
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
        position: Matrix<'py>,
        velocity: Matrix<'py>,
        torque: Matrix<'py>,
        external: Matrix<'py>,
        chi: Sets<'py>,
        loops: Option<Matrix<'py>>,
    ) -> PyResult<(Bound<'py, PyArray2<f64>>, Option<usize>)> {
        let arguments = MotionArguments { position, velocity, acceleration: None, external, loops };
        let (motion, torque) =
            (arguments.motion()?, of_samples("torque", &torque, arguments.position.as_array().ncols())?);
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
        position: Matrix<'py>,
        velocity: Matrix<'py>,
        external: Matrix<'py>,
        columns: Columns,
        loops: Option<Matrix<'py>>,
    ) -> PyResult<Bound<'py, PyArray4<f64>>> {
        let arguments = MotionArguments { position, velocity, acceleration: None, external, loops };
        let motion = arguments.motion()?;
        let shape = [motion.sets(), self.0.coordinates(), columns.len(), motion.samples];
        let mut out = room(shape.iter().product())?;
        detached(py, || haptid_core::regressor(&self.0, &motion, &columns, &mut out)).map_err(to_python)?;
        out.into_pyarray(py).reshape(shape)
    }

    #[pyo3(signature = (position, velocity, external, chi, loops=None))]
    fn momentum<'py>(
        &self,
        py: Python<'py>,
        position: Matrix<'py>,
        velocity: Matrix<'py>,
        external: Matrix<'py>,
        chi: Sets<'py>,
        loops: Option<Matrix<'py>>,
    ) -> PyResult<Bound<'py, PyArray3<f64>>> {
        let arguments = MotionArguments { position, velocity, acceleration: None, external, loops };
        let (motion, chi) = (arguments.motion()?, sets(&chi, self.0.columns())?);
        let shape = [motion.sets(), self.0.coordinates(), motion.samples];
        let mut out = room(shape.iter().product())?;
        detached(py, || haptid_core::inverse_dynamics(&self.0, &motion, chi, &mut out)).map_err(to_python)?;
        out.into_pyarray(py).reshape(shape)
    }

    #[pyo3(signature = (position, velocity, acceleration, external, columns, factors, loops=None))]
    #[allow(clippy::too_many_arguments)]
    fn inner_products<'py>(
        &self,
        py: Python<'py>,
        position: Matrix<'py>,
        velocity: Matrix<'py>,
        acceleration: Matrix<'py>,
        external: Matrix<'py>,
        columns: Columns,
        factors: Matrix<'py>,
        loops: Option<Matrix<'py>>,
    ) -> PyResult<Bound<'py, PyArray2<f64>>> {
        let arguments = MotionArguments { position, velocity, acceleration: Some(acceleration), external, loops };
        let (motion, factors) = (arguments.motion()?, row_major(&factors)?);
        let shape = [columns.len(), columns.len()];
        let mut out = room(shape.iter().product())?;
        detached(py, || haptid_core::gram_matrix(&self.0, &motion, &columns, factors, &mut out)).map_err(to_python)?;
        out.into_pyarray(py).reshape(shape)
    }

    #[pyo3(signature = (position, velocity, acceleration, external, columns, form, factors, loops=None))]
    #[allow(clippy::too_many_arguments)]
    fn form_slopes<'py>(
        &self,
        py: Python<'py>,
        position: Matrix<'py>,
        velocity: Matrix<'py>,
        acceleration: Matrix<'py>,
        external: Matrix<'py>,
        columns: Columns,
        form: Matrix<'py>,
        factors: Matrix<'py>,
        loops: Option<Matrix<'py>>,
    ) -> PyResult<Bound<'py, PyArray2<f64>>> {
        let arguments = MotionArguments { position, velocity, acceleration: Some(acceleration), external, loops };
        let (motion, form, factors) = (arguments.motion()?, row_major(&form)?, row_major(&factors)?);
        let shape = [self.0.channels(), motion.samples];
        let mut out = room(shape.iter().product())?;
        detached(py, || haptid_core::quadratic_form_gradients(&self.0, &motion, &columns, form, factors, &mut out))
            .map_err(to_python)?;
        out.into_pyarray(py).reshape(shape)
    }

    #[pyo3(signature = (position, velocity, acceleration, external, columns, chi, loops=None))]
    #[allow(clippy::too_many_arguments)]
    fn torque_slopes<'py>(
        &self,
        py: Python<'py>,
        position: Matrix<'py>,
        velocity: Matrix<'py>,
        acceleration: Matrix<'py>,
        external: Matrix<'py>,
        columns: Columns,
        chi: Vec<f64>,
        loops: Option<Matrix<'py>>,
    ) -> PyResult<Bound<'py, PyArray3<f64>>> {
        let arguments = MotionArguments { position, velocity, acceleration: Some(acceleration), external, loops };
        let motion = arguments.motion()?;
        let shape = [self.0.coordinates(), self.0.channels(), motion.samples];
        let mut out = room(shape.iter().product())?;
        detached(py, || haptid_core::torque_gradients(&self.0, &motion, &columns, &chi, &mut out))
            .map_err(to_python)?;
        out.into_pyarray(py).reshape(shape)
    }

    /// Which of the chosen columns can differ from zero in each coordinate's row.
    fn reach(&self, columns: Columns) -> PyResult<Vec<Vec<bool>>> {
        let flat = haptid_core::structural_nonzeros(&self.0, &columns).map_err(to_python)?;
        Ok((0..self.0.coordinates()).map(|a| flat[a * columns.len()..][..columns.len()].to_vec()).collect())
    }

    #[pyo3(signature = (position, velocity, acceleration, external, torque, columns, taps, decimation, first, rows, block, weights, slope=None, loops=None))]
    #[allow(clippy::too_many_arguments, clippy::type_complexity)]
    fn reduce<'py>(
        &self,
        py: Python<'py>,
        position: Matrix<'py>,
        velocity: Matrix<'py>,
        acceleration: Option<Matrix<'py>>,
        external: Matrix<'py>,
        torque: Matrix<'py>,
        columns: Columns,
        taps: Vector<'py>,
        decimation: usize,
        first: usize,
        rows: usize,
        block: usize,
        weights: Matrix<'py>,
        slope: Option<Vector<'py>>,
        loops: Option<Matrix<'py>>,
    ) -> PyResult<Vec<(Vec<usize>, Bound<'py, PyArray3<f64>>)>> {
        let arguments = MotionArguments { position, velocity, acceleration, external, loops };
        let motion = arguments.motion()?;
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
