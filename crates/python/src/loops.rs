//! The classes `Loops` and `Branch`: see `_core.pyi`.

use crate::arrays::row_major;
use crate::threads::detached;
use crate::to_python;
use haptid_core::{
    ActiveTrajectory, AssemblyMode, ClosureTolerances, CutJoint, CutKind, Frame, Joint, JointTrajectory, LinearClosure,
    LoopClosure,
};
use numpy::{
    IntoPyArray, PyArray1, PyArray2, PyArray3, PyArrayMethods, PyReadonlyArray1, PyReadonlyArray2, PyReadonlyArray3,
    PyUntypedArrayMethods,
};
use pyo3::exceptions::PyValueError;
use pyo3::prelude::*;

/// A tree with cut joints.
#[pyclass(name = "Loops", frozen, module = "haptid._core")]
pub struct PyLoops(LoopClosure);

/// A frame as passed from Python: link (-1 for the base), rotation row by row, translation.
type FrameArguments = (isize, [f64; 9], [f64; 3]);

fn frame((link, rotation, translation): FrameArguments) -> Frame {
    Frame { link: usize::try_from(link).ok(), rotation, translation }
}

/// The joints of a tree; parent -1 is the base.
pub fn joints(
    parent: &[isize],
    rotation: &PyReadonlyArray3<'_, f64>,
    translation: &PyReadonlyArray2<'_, f64>,
    prismatic: &[bool],
) -> PyResult<Vec<Joint>> {
    let (rotation, translation) = (rotation.as_array(), translation.as_array());
    let n = parent.len();
    if rotation.shape() != [n, 3, 3] || translation.shape() != [n, 3] || prismatic.len() != n {
        return Err(PyValueError::new_err(format!(
            "{n} joints need rotation ({n}, 3, 3), translation ({n}, 3) and {n} prismatic flags"
        )));
    }
    if let Some(wrong) = parent.iter().find(|&&p| p < -1) {
        return Err(PyValueError::new_err(format!("parent {wrong} is no link; the base is -1")));
    }
    let joint = |i: usize| Joint {
        parent: usize::try_from(parent[i]).ok(),
        rotation: core::array::from_fn(|k| rotation[[i, k / 3, k % 3]]),
        translation: core::array::from_fn(|k| translation[[i, k]]),
        prismatic: prismatic[i],
    };
    Ok((0..n).map(joint).collect())
}

#[pymethods]
impl PyLoops {
    #[new]
    fn new(
        parent: Vec<isize>,
        rotation: PyReadonlyArray3<'_, f64>,
        translation: PyReadonlyArray2<'_, f64>,
        prismatic: Vec<bool>,
        cuts: Vec<(String, FrameArguments, FrameArguments)>,
        size: f64,
    ) -> PyResult<Self> {
        let joints = joints(&parent, &rotation, &translation, &prismatic)?;
        let cut = |(kind, one, other): (String, _, _)| {
            let kind = match kind.as_str() {
                "revolute" => CutKind::Revolute,
                "prismatic" => CutKind::Prismatic,
                "spherical" => CutKind::Spherical,
                _ => return Err(PyValueError::new_err(format!("{kind} is no kind of cut"))),
            };
            Ok(CutJoint { kind, frame_a: frame(one), frame_b: frame(other) })
        };
        let cuts = cuts.into_iter().map(cut).collect::<PyResult<Vec<CutJoint>>>()?;
        LoopClosure::new(&joints, &cuts, size).map(PyLoops).map_err(to_python)
    }

    #[allow(clippy::type_complexity)]
    fn gaps<'py>(
        &self,
        py: Python<'py>,
        q: PyReadonlyArray2<'py, f64>,
    ) -> PyResult<(Bound<'py, PyArray2<f64>>, Bound<'py, PyArray3<f64>>)> {
        let (samples, m, n) = (q.shape()[0], self.0.gaps(), self.0.joints());
        let (mut gaps, mut jacobian) = (vec![0.0; samples * m], vec![0.0; samples * m * n]);
        let q = row_major(&q)?;
        detached(py, || self.0.evaluate_gaps(q, &mut gaps, &mut jacobian)).map_err(to_python)?;
        Ok((gaps.into_pyarray(py).reshape([samples, m])?, jacobian.into_pyarray(py).reshape([samples, m, n])?))
    }

    fn close<'py>(
        &self,
        py: Python<'py>,
        q: PyReadonlyArray2<'py, f64>,
        unknown: Vec<usize>,
        steps: usize,
        settled: f64,
    ) -> PyResult<Bound<'py, PyArray2<f64>>> {
        let shape = [q.shape()[0], self.0.joints()];
        let mut closed = row_major(&q)?.to_vec();
        detached(py, || self.0.close(&mut closed, &unknown, steps, settled)).map_err(to_python)?;
        closed.into_pyarray(py).reshape(shape)
    }
}

/// A loop closure in one of its assembly modes.
#[pyclass(name = "Branch", frozen, module = "haptid._core")]
pub struct PyBranch(AssemblyMode);

/// The first sample that is not reached, and the last closed pose on the way to it; None where all are reached.
type Stopped<'py> = Option<(usize, Bound<'py, PyArray1<f64>>)>;

#[pymethods]
impl PyBranch {
    #[new]
    #[allow(clippy::too_many_arguments)]
    fn new(
        loops: &PyLoops,
        active: Vec<usize>,
        unknown: Vec<usize>,
        constant: PyReadonlyArray2<'_, f64>,
        offset: PyReadonlyArray1<'_, f64>,
        start: PyReadonlyArray1<'_, f64>,
        varying: PyReadonlyArray2<'_, bool>,
        closed: f64,
        singular: f64,
    ) -> PyResult<Self> {
        let linear = LinearClosure { rates: row_major(&constant)?, offset: offset.as_slice()? };
        let varying: Vec<bool> = varying.as_array().iter().copied().collect();
        let tolerances = ClosureTolerances { gap: closed, singular_value: singular };
        let made = AssemblyMode::new(&loops.0, &active, &unknown, &linear, start.as_slice()?, &varying, tolerances);
        made.map(PyBranch).map_err(to_python)
    }

    #[allow(clippy::type_complexity)]
    fn positions<'py>(
        &self,
        py: Python<'py>,
        qa: PyReadonlyArray2<'py, f64>,
    ) -> PyResult<(Bound<'py, PyArray2<f64>>, Stopped<'py>)> {
        let shape = [qa.shape()[0], self.0.joints()];
        let mut q = vec![0.0; shape[0] * shape[1]];
        let path = ActiveTrajectory { position: row_major(&qa)?, velocity: &[] };
        let out = JointTrajectory { position: &mut q, rates: &mut [], rate_derivatives: &mut [] };
        let stop = detached(py, || self.0.follow(&path, out)).map_err(to_python)?;
        let stop = stop.map(|stop| (stop.sample, stop.last_pose.into_pyarray(py)));
        Ok((q.into_pyarray(py).reshape(shape)?, stop))
    }

    #[allow(clippy::type_complexity)]
    fn follow<'py>(
        &self,
        py: Python<'py>,
        qa: PyReadonlyArray2<'py, f64>,
        qda: PyReadonlyArray2<'py, f64>,
    ) -> PyResult<(Bound<'py, PyArray2<f64>>, Bound<'py, PyArray3<f64>>, Bound<'py, PyArray3<f64>>, Stopped<'py>)> {
        let (samples, n) = (qa.shape()[0], self.0.joints());
        let shape = [samples, n, self.0.active()];
        let entries = shape.iter().product();
        let (mut q, mut rates, mut change) = (vec![0.0; samples * n], vec![0.0; entries], vec![0.0; entries]);
        let path = ActiveTrajectory { position: row_major(&qa)?, velocity: row_major(&qda)? };
        let out = JointTrajectory { position: &mut q, rates: &mut rates, rate_derivatives: &mut change };
        let stop = detached(py, || self.0.follow(&path, out)).map_err(to_python)?;
        let stop = stop.map(|stop| (stop.sample, stop.last_pose.into_pyarray(py)));
        let (rates, change) = (rates.into_pyarray(py).reshape(shape)?, change.into_pyarray(py).reshape(shape)?);
        Ok((q.into_pyarray(py).reshape([samples, n])?, rates, change, stop))
    }

    #[allow(clippy::type_complexity)]
    fn reach<'py>(
        &self,
        py: Python<'py>,
        qa: PyReadonlyArray2<'py, f64>,
    ) -> PyResult<(Bound<'py, PyArray2<f64>>, Bound<'py, PyArray1<bool>>)> {
        let shape = [qa.shape()[0], self.0.joints()];
        let (mut q, mut reached) = (vec![0.0; shape[0] * shape[1]], vec![false; shape[0]]);
        let targets = row_major(&qa)?;
        detached(py, || self.0.reach_from_start(targets, &mut q, &mut reached)).map_err(to_python)?;
        Ok((q.into_pyarray(py).reshape(shape)?, reached.into_pyarray(py)))
    }
}
