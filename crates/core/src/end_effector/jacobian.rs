//! Jacobian of the end effector and mass matrix at many poses, from joint positions and rates that the caller provides.
//!
//! The axis of every coordinate is transformed from link to link in the links' own frames, as for the rows of the
//! regressor, without motion: `A[a, b] = sum_i s_i^a . I_i s_i^b`, and the end-effector velocity is that of a point of
//! its link (Featherstone 2008, sections 6.2 and 2.9). Lanes of poses are computed together.
//!
//! Safety: pose slots have [`POSES`] numbers; unsafe functions take a `k` with `k + T::WIDTH <= POSES`.

use crate::error::{Error, expect_length};
use crate::linalg::vector::{Vector, cross_add, dot, zero};
use crate::mechanism::transform::JointTransform;
use crate::mechanism::{LINK_PARAMETERS, Mechanism};
use crate::memory::slot::{POSES, PoseSlot, pose_lanes};
use crate::simd::dispatch::dispatched;
use crate::simd::lane::Lane;
use crate::simd::token::Simd;
use rayon::prelude::*;

/// Poses per task of a thread.
const SHARE: usize = 512;
/// Starting threads costs more than the work on this many poses.
const SINGLE_THREAD: usize = 2000;
/// Components of the end-effector velocity: linear, then angular.
const COMPONENTS: usize = 6;

/// Joint positions and rates at the poses, channel major.
#[derive(Debug, Clone, Copy)]
pub struct Poses<'a> {
    /// Number of poses.
    pub samples: usize,
    /// Positions of all joints of the tree, joints x samples, rad or m.
    pub position: &'a [f64],
    /// Rates of all joints with respect to the coordinates: joints x coordinates, or joints x coordinates x samples
    /// where they vary.
    pub rates: &'a [f64],
}

/// The end effector: a point of a link.
#[derive(Debug, Clone, Copy)]
pub struct EndEffector {
    /// Index of the link.
    pub link: usize,
    /// Point in the link's frame, m.
    pub point: [f64; 3],
}

/// Inertial parameters of links and rotors.
#[derive(Debug, Clone, Copy)]
pub struct BodyParameters<'a> {
    /// Ten parameters of each link, see [`crate::Mechanism::columns`].
    pub chi: &'a [f64],
    /// Rotor velocities as combinations of the coordinates' velocities, rotors x coordinates, row-major.
    pub rotors: &'a [f64],
    /// Inertia of each rotor, kg m^2 or kg.
    pub inertia: &'a [f64],
}

/// What all poses have in common.
pub(crate) struct EndEffectorModel<'a> {
    pub mechanism: &'a Mechanism,
    poses: Poses<'a>,
    end_effector: EndEffector,
    bodies: BodyParameters<'a>,
    /// Whether each link carries the end effector, and whether it has mass.
    carries: Vec<bool>,
    has_mass: Vec<bool>,
    /// Contribution of the rotors to the mass matrix, coordinates x coordinates.
    rotor_mass: Vec<f64>,
}

impl<'a> EndEffectorModel<'a> {
    pub(crate) fn new(
        mechanism: &'a Mechanism,
        poses: &Poses<'a>,
        end_effector: &EndEffector,
        bodies: &BodyParameters<'a>,
    ) -> Result<EndEffectorModel<'a>, Error> {
        let (n, na) = (mechanism.links.len(), mechanism.coordinates);
        expect_length("position", poses.position.len(), n * poses.samples)?;
        if poses.rates.len() != n * na {
            expect_length("rates", poses.rates.len(), n * na * poses.samples)?;
        }
        expect_length("chi", bodies.chi.len(), LINK_PARAMETERS * n)?;
        expect_length("rotors", bodies.rotors.len(), bodies.inertia.len() * na)?;
        if end_effector.link >= n {
            return Err(Error::Index { name: "handle link", got: end_effector.link, limit: n });
        }
        let mut carries = vec![false; n];
        let mut link = Some(end_effector.link);
        while let Some(i) = link {
            carries[i] = true;
            link = mechanism.links[i].parent;
        }
        let has_mass = bodies.chi.chunks_exact(LINK_PARAMETERS).map(|chi| chi.iter().any(|&x| x != 0.0)).collect();
        let mut rotor_mass = vec![0.0; na * na];
        for (weights, inertia) in bodies.rotors.chunks_exact(na).zip(bodies.inertia) {
            for (k, entry) in rotor_mass.iter_mut().enumerate() {
                *entry += inertia * weights[k / na] * weights[k % na];
            }
        }
        Ok(EndEffectorModel {
            mechanism,
            poses: *poses,
            end_effector: *end_effector,
            bodies: *bodies,
            carries,
            has_mass,
            rotor_mass,
        })
    }

    pub(crate) fn bodies(&self) -> &BodyParameters<'a> {
        &self.bodies
    }
}

/// Buffers of one thread for a group of poses.
pub(crate) struct PoseGroup {
    position: Vec<PoseSlot>,
    rates: Vec<PoseSlot>,
    /// Angular and linear part of every axis, in its link's frame.
    pub axes: Vec<[PoseSlot; 6]>,
    /// Jacobian, components x coordinates.
    pub jacobian: Vec<PoseSlot>,
    /// Mass matrix, coordinates x coordinates.
    pub mass: Vec<PoseSlot>,
}

impl PoseGroup {
    pub(crate) fn new(model: &EndEffectorModel) -> PoseGroup {
        let (n, na) = (model.mechanism.links.len(), model.mechanism.coordinates);
        let zeros = |len| vec![PoseSlot::ZERO; len];
        let constant = |rates: &[f64]| rates.iter().map(|&rate| PoseSlot([rate; POSES])).collect();
        let varying = model.poses.rates.len() != n * na;
        PoseGroup {
            position: zeros(n),
            rates: if varying { zeros(n * na) } else { constant(model.poses.rates) },
            axes: vec![[PoseSlot::ZERO; 6]; model.mechanism.axes],
            jacobian: zeros(COMPONENTS * na),
            mass: zeros(na * na),
        }
    }

    /// Evaluate poses `from..from + count`, at most [`POSES`]; the last one is repeated up to the end.
    pub(crate) fn evaluate(&mut self, model: &EndEffectorModel, from: usize, count: usize) {
        let samples = model.poses.samples;
        let stage = |slots: &mut [PoseSlot], data: &[f64]| {
            for (slot, channel) in slots.iter_mut().zip(data.chunks_exact(samples)) {
                let source = &channel[from..from + count];
                slot.0.fill(source[count - 1]);
                slot.0[..count].copy_from_slice(source);
            }
        };
        stage(&mut self.position, model.poses.position);
        if model.poses.rates.len() != self.rates.len() {
            stage(&mut self.rates, model.poses.rates);
        }
        // SAFETY: the group has been made for the model, so that every link, axis and coordinate has its slots.
        unsafe { carry(model.mechanism.backend, model, self) };
    }
}

dispatched! {
    unsafe fn carry = carry_in_lanes(model: &EndEffectorModel, group: &mut PoseGroup)
}

#[inline(always)]
unsafe fn carry_in_lanes<T: Lane>(simd: Simd<T>, model: &EndEffectorModel, group: &mut PoseGroup) {
    for k in pose_lanes(simd) {
        // SAFETY: the loop leaves room for a lane in pose slots.
        unsafe { carry_lane(simd, model, group, k) };
    }
}

/// Angular and linear part of an axis.
///
/// # Safety
///
/// `k + T::WIDTH <= POSES`.
#[inline(always)]
pub(crate) unsafe fn load_pose_axis<T: Lane>(simd: Simd<T>, axis: &[PoseSlot; 6], k: usize) -> (Vector<T>, Vector<T>) {
    // SAFETY: the caller's promise.
    let part = |e: usize| unsafe { axis[e].load(simd, k) };
    ([part(0), part(1), part(2)], [part(3), part(4), part(5)])
}

#[inline(always)]
unsafe fn carry_lane<T: Lane>(simd: Simd<T>, model: &EndEffectorModel, group: &mut PoseGroup, k: usize) {
    let na = model.mechanism.coordinates;
    // SAFETY: the caller's promise about k.
    unsafe {
        for (slot, &entry) in group.mass.iter_mut().zip(&model.rotor_mass) {
            slot.store(k, simd.splat(entry));
        }
        let one = |e: usize| core::array::from_fn(|f| simd.splat(if e == f { 1.0 } else { 0.0 }));
        // Axes of the base frame, in the link's frame.
        let mut base: [Vector<T>; 3] = [one(0), one(1), one(2)];
        for (i, link) in model.mechanism.links.iter().enumerate() {
            let joint = JointTransform::at_zero(simd, link.shape, link).at(group.position[i].load(simd, k));
            for (slot, axis) in (link.first..).zip(&link.axes) {
                let rate = group.rates[i * na + axis.coordinate].load(simd, k);
                let (x, u) = match axis.above {
                    Some(above) => {
                        joint.add_joint_rate(joint.transform_axis(load_pose_axis(simd, &group.axes[above], k)), rate)
                    }
                    None => joint.joint_axis(rate),
                };
                for (e, part) in x.into_iter().chain(u).enumerate() {
                    group.axes[slot][e].store(k, part);
                }
            }
            if model.carries[i] {
                base = base.map(|axis| joint.rotate(axis));
            }
            if model.has_mass[i] {
                add_body(simd, model, group, i, k);
            }
        }
        for a in 0..na {
            for b in 0..a {
                let entry = group.mass[a * na + b].load(simd, k);
                group.mass[b * na + a].store(k, entry);
            }
        }
        end_effector_rows(simd, model, group, &base, k);
    }
}

/// Contribution of one body to the mass matrix, on and below its diagonal: its momentum under every axis, contracted with
/// every axis.
#[inline(always)]
unsafe fn add_body<T: Lane>(simd: Simd<T>, model: &EndEffectorModel, group: &mut PoseGroup, i: usize, k: usize) {
    let (link, na) = (&model.mechanism.links[i], model.mechanism.coordinates);
    let c: [T; LINK_PARAMETERS] = core::array::from_fn(|e| simd.splat(model.bodies.chi[LINK_PARAMETERS * i + e]));
    for (b, right) in link.axes.iter().enumerate() {
        // SAFETY: the caller's promise about k, here and below.
        let (x, u) = unsafe { load_pose_axis(simd, &group.axes[link.first + b], k) };
        let first = [c[6], c[7], c[8]];
        let turned = [
            c[0].fma(x[0], c[1].fma(x[1], c[2].mul(x[2]))),
            c[1].fma(x[0], c[3].fma(x[1], c[4].mul(x[2]))),
            c[2].fma(x[0], c[4].fma(x[1], c[5].mul(x[2]))),
        ];
        let angular = cross_add(first, u, turned);
        let linear = cross_add(x, first, u.map(|u| u.mul(c[9])));
        for (a, left) in link.axes[..=b].iter().enumerate() {
            // SAFETY: as above.
            let (x, u) = unsafe { load_pose_axis(simd, &group.axes[link.first + a], k) };
            let entry = dot(x, angular).add(dot(u, linear));
            let (a, b) = (left.coordinate, right.coordinate);
            let slot = &mut group.mass[a.max(b) * na + a.min(b)];
            // SAFETY: as above.
            unsafe { slot.store(k, slot.load(simd, k).add(entry)) };
        }
    }
}

/// Velocity of the end effector under every axis of its link, in the base frame.
#[inline(always)]
unsafe fn end_effector_rows<T: Lane>(
    simd: Simd<T>,
    model: &EndEffectorModel,
    group: &mut PoseGroup,
    base: &[Vector<T>; 3],
    k: usize,
) {
    let (link, na) = (&model.mechanism.links[model.end_effector.link], model.mechanism.coordinates);
    let point = model.end_effector.point.map(|x| simd.splat(x));
    for (slot, axis) in (link.first..).zip(&link.axes) {
        // SAFETY: the caller's promise about k, here and below.
        let (x, u) = unsafe { load_pose_axis(simd, &group.axes[slot], k) };
        let velocity = cross_add(x, point, u);
        for (row, &along) in base.iter().enumerate() {
            for (row, vector) in [(row, velocity), (row + 3, x)] {
                // SAFETY: as above.
                unsafe { group.jacobian[row * na + axis.coordinate].store(k, dot(along, vector)) };
            }
        }
    }
}

/// Evaluate groups of poses, by several threads where poses are many. `out` has `width` numbers for each pose, and
/// `work` fills those of one group.
pub(crate) fn for_each_group<S>(
    model: &EndEffectorModel,
    out: &mut [f64],
    width: usize,
    start: impl Fn() -> S + Sync,
    work: impl Fn(&PoseGroup, &mut S, &mut [f64]) + Sync,
) {
    let share = |(index, part): (usize, &mut [f64])| {
        let (mut group, mut state) = (PoseGroup::new(model), start());
        for (g, rows) in part.chunks_mut(POSES * width).enumerate() {
            let (from, count) = (index * SHARE + g * POSES, rows.len() / width);
            group.evaluate(model, from, count);
            work(&group, &mut state, rows);
        }
    };
    if model.poses.samples < SINGLE_THREAD {
        out.chunks_mut(SHARE * width).enumerate().for_each(share);
    } else {
        out.par_chunks_mut(SHARE * width).enumerate().for_each(share);
    }
}

/// Chosen rows of the end effector's Jacobian (rows x coordinates), then the mass matrix (coordinates x coordinates),
/// as one row of `out` for each pose. Rows are velocities in the base frame: 0 to 2 linear, 3 to 5 angular.
///
/// # Example
///
/// ```
/// # use haptid_core::*;
/// # let joint = Joint { parent: None, rotation: [1., 0., 0., 0., 1., 0., 0., 0., 1.], translation: [0.; 3], prismatic: false };
/// # let pendulum = Mechanism::new(&[joint], &Closure::open(1), [0., -9.81, 0.], &[], Backend::best())?;
/// # let chi = [0., 0., 0., 0., 0., 0.5, 1., 0., 0., 2.];
/// // A pendulum of 2 kg whose end effector is the mass, at 0.5 m: J by angular velocity, then ZZ.
/// let poses = Poses { samples: 1, position: &[0.3], rates: &[1.] };
/// let end_effector = EndEffector { link: 0, point: [0.5, 0., 0.] };
/// let bodies = BodyParameters { chi: &chi, rotors: &[], inertia: &[] };
/// let mut out = [0.; 2];
/// end_effector_dynamics(&pendulum, &poses, &end_effector, &bodies, &[5], &mut out)?;
/// assert!((out[0] - 1.).abs() < 1e-12 && (out[1] - 0.5).abs() < 1e-12);
/// # Ok::<(), haptid_core::Error>(())
/// ```
pub fn end_effector_dynamics(
    mechanism: &Mechanism,
    poses: &Poses,
    end_effector: &EndEffector,
    bodies: &BodyParameters,
    rows: &[usize],
    out: &mut [f64],
) -> Result<(), Error> {
    let model = EndEffectorModel::new(mechanism, poses, end_effector, bodies)?;
    check_indices("row", rows, COMPONENTS)?;
    let na = mechanism.coordinates;
    let width = (rows.len() + na) * na;
    expect_length("out", out.len(), poses.samples * width)?;
    if out.is_empty() {
        return Ok(());
    }
    let work = |group: &PoseGroup, _: &mut (), out: &mut [f64]| {
        let chosen = rows.iter().flat_map(|&row| &group.jacobian[row * na..][..na]);
        for (e, slot) in chosen.chain(&group.mass).enumerate() {
            for (pose, &number) in out.chunks_exact_mut(width).zip(&slot.0) {
                pose[e] = number;
            }
        }
    };
    for_each_group(&model, out, width, || (), work);
    Ok(())
}

/// Check that indices are below a limit, each at most once.
pub(crate) fn check_indices(name: &'static str, indices: &[usize], limit: usize) -> Result<(), Error> {
    for (k, &got) in indices.iter().enumerate() {
        if got >= limit {
            return Err(Error::Index { name, got, limit });
        }
        if indices[..k].contains(&got) {
            return Err(Error::Repeated { name, got });
        }
    }
    Ok(())
}

/// Velocity of link i: a weighted sum of its axes.
///
/// # Safety
///
/// `k + T::WIDTH <= POSES`.
#[inline(always)]
pub(crate) unsafe fn link_velocity<T: Lane>(
    simd: Simd<T>,
    model: &EndEffectorModel,
    group: &PoseGroup,
    i: usize,
    weights: &[PoseSlot],
    k: usize,
) -> (Vector<T>, Vector<T>) {
    let link = &model.mechanism.links[i];
    let (mut x, mut u) = (zero(simd), zero(simd));
    for (slot, axis) in (link.first..).zip(&link.axes) {
        // SAFETY: the caller's promise about k.
        let ((dx, du), weight) =
            unsafe { (load_pose_axis(simd, &group.axes[slot], k), weights[axis.coordinate].load(simd, k)) };
        x = core::array::from_fn(|e| dx[e].fma(weight, x[e]));
        u = core::array::from_fn(|e| du[e].fma(weight, u[e]));
    }
    (x, u)
}
