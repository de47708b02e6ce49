//! Rows of the observation matrix, a chunk of samples at a time, by axes carried forward.
//!
//! The axis of every coordinate is carried from link to link in the links' own frames and contracted there with the
//! link's wrench, `Y[a, i] = s_i^a . A_i(v_i, a_i)`; the 6 x 10 map A_i is never written out. Carrying the axes of
//! the *coordinates* rather than of the joints, `s_i^a = X_i s_parent^a + G[i, a] z`, projects a closed chain's
//! torques onto its motors at no cost (Khalil and Dombre 2002, chapter 10, done without forming the tree's rows).
//!
//! Without accelerations there are two rows for each coordinate in place of one: generalised momentum, and the rest of
//! the torque beside its rate of change (see `momentum`).
//!
//! Safety: [`rows`] is the one door. Behind it channels are staged with a whole lane after their last sample, slots hold
//! the widest lane, and the caller's places have room for a whole lane more; every unsafe function relies on just that.

use crate::course::{Course, Rate};
use crate::dispatch::dispatched;
use crate::lane::{Lane, MAX_WIDTH};
use crate::link::{JointMotion, LINK_NUMBERS, LinkMotion, contract, contract_slide, contract_turn, link_motion};
use crate::mechanism::{LINK_PARAMETERS, Mechanism};
use crate::momentum::{LinkVelocity, axis_rate, contract_momentum, contract_rest, link_velocity};
use crate::regressor::Motion;
use crate::terms::Law;
use crate::vector::Vector;

/// Samples made at a time: the inputs and a row's columns stay in the first caches.
pub(crate) const CHUNK: usize = 256;

/// What one thread needs to make rows; made once, then reused for every chunk.
pub(crate) struct Workspace {
    /// A chunk of the motion, every channel padded to whole lanes.
    staged: Vec<f64>,
    /// Link motions and axes, as many numbers as the widest lane needs.
    links: Vec<LinkSlot>,
    axes: Vec<AxisSlot>,
    /// Rates of change of the axes, where there are no accelerations.
    axis_rates: Vec<AxisSlot>,
}

/// Staged channels are this far apart.
const STAGE: usize = CHUNK + MAX_WIDTH;

type LinkSlot = [[f64; MAX_WIDTH]; LINK_NUMBERS];
type AxisSlot = [[f64; MAX_WIDTH]; 6];

impl Workspace {
    pub(crate) fn new(mechanism: &Mechanism) -> Workspace {
        let channels = 3 * mechanism.coordinates + mechanism.externals + mechanism.loops;
        Workspace {
            staged: vec![0.0; channels * STAGE],
            links: vec![[[0.0; MAX_WIDTH]; LINK_NUMBERS]; mechanism.links.len()],
            axes: vec![[[0.0; MAX_WIDTH]; 6]; mechanism.axes],
            axis_rates: vec![[[0.0; MAX_WIDTH]; 6]; mechanism.axes],
        }
    }

    /// Copy samples `from..from + count` in, and repeat the last one up to a whole lane. Accelerations that are not
    /// there stay zero.
    fn stage(&mut self, mechanism: &Mechanism, motion: &Motion, from: usize, count: usize) {
        let (na, ne, n) = (mechanism.coordinates, mechanism.externals, motion.samples);
        let acceleration = motion.acceleration.unwrap_or_default();
        let own = [(motion.external, ne), (motion.loops, mechanism.loops)];
        let groups = [(motion.position, na), (motion.velocity, na), (acceleration, na)].into_iter().chain(own);
        let channels = groups.flat_map(|(data, many)| (0..many).map(move |a| (data, a * n)));
        for ((data, at), staged) in channels.zip(self.staged.chunks_exact_mut(STAGE)) {
            let Some(source) = data.get(at..at + n) else { continue };
            staged[..count].copy_from_slice(&source[from..from + count]);
            let last = staged[count - 1];
            staged[count..count + MAX_WIDTH].fill(last);
        }
    }
}

/// Where the rows go: entry (row r, column c) of sample k is written at `place[r * columns + c] + k`. Row r is that of
/// coordinate r; without accelerations it is that coordinate's momentum, and the rest of its torque is row
/// `coordinates + r`. Columns that are not wanted share a place that is never read.
pub(crate) struct Places<'a> {
    pub place: &'a [usize],
    pub out: *mut f64,
}

/// Make the rows of samples `from..from + count`, at most [`CHUNK`] of them. Up to a lane more is written after them.
///
/// # Safety
/// Every place has room for `count` rounded up to whole lanes of [`MAX_WIDTH`].
pub(crate) unsafe fn rows(
    mechanism: &Mechanism,
    motion: &Motion,
    from: usize,
    count: usize,
    places: &Places,
    workspace: &mut Workspace,
) {
    debug_assert!(count <= CHUNK && places.place.len() == motion.sets() * mechanism.coordinates * mechanism.columns());
    if count > 0 {
        workspace.stage(mechanism, motion, from, count);
        match motion.acceleration {
            Some(_) => unsafe { torques(mechanism.backend, mechanism, count, places, workspace) },
            None => unsafe { momenta(mechanism.backend, mechanism, count, places, workspace) },
        }
    }
}

dispatched! {
    unsafe fn torques = torques_in_lanes(mechanism: &Mechanism, count: usize, places: &Places, workspace: &mut Workspace)
}

dispatched! {
    unsafe fn momenta = momenta_in_lanes(mechanism: &Mechanism, count: usize, places: &Places, workspace: &mut Workspace)
}

#[inline(always)]
unsafe fn torques_in_lanes<T: Lane>(mechanism: &Mechanism, count: usize, places: &Places, workspace: &mut Workspace) {
    let mut k = 0;
    while k < count {
        // SAFETY: the staged channels are padded to whole lanes, and the places too.
        unsafe { torque_sample::<T>(mechanism, k, places, workspace) };
        k += T::WIDTH;
    }
}

#[inline(always)]
unsafe fn momenta_in_lanes<T: Lane>(mechanism: &Mechanism, count: usize, places: &Places, workspace: &mut Workspace) {
    let mut k = 0;
    while k < count {
        // SAFETY: as for torques.
        unsafe { momentum_sample::<T>(mechanism, k, places, workspace) };
        k += T::WIDTH;
    }
}

/// Numbers of a workspace slot as lanes of the back end in use.
///
/// # Safety
/// `slot` has room for `N` lanes, which [`Workspace`] gives every slot.
#[inline(always)]
unsafe fn get<T: Lane, const N: usize>(slot: &[[f64; MAX_WIDTH]]) -> [T; N] {
    debug_assert!(slot.len() >= N);
    core::array::from_fn(|k| unsafe { T::load(slot.as_ptr().add(k).cast()) })
}

#[inline(always)]
unsafe fn put<T: Lane, const N: usize>(slot: &mut [[f64; MAX_WIDTH]], lanes: [T; N]) {
    debug_assert!(slot.len() >= N);
    for (k, lane) in lanes.into_iter().enumerate() {
        unsafe { lane.store(slot.as_mut_ptr().add(k).cast()) };
    }
}

#[inline(always)]
unsafe fn get_axis<T: Lane>(slot: &AxisSlot) -> (Vector<T>, Vector<T>) {
    let s: [T; 6] = unsafe { get(slot) };
    ([s[0], s[1], s[2]], [s[3], s[4], s[5]])
}

#[inline(always)]
unsafe fn put_axis<T: Lane>(slot: &mut AxisSlot, (x, u): (Vector<T>, Vector<T>)) {
    unsafe { put(slot, [x[0], x[1], x[2], u[0], u[1], u[2]]) }
}

/// A lane of the staged motion, and where its rows go.
struct Sample<'a> {
    mechanism: &'a Mechanism,
    staged: *const f64,
    places: &'a Places<'a>,
    /// First sample of the lane in the chunk.
    k: usize,
}

impl Sample<'_> {
    /// A lane of a staged channel: coordinates' positions, velocities, accelerations, external columns, then loops.
    ///
    /// # Safety
    /// The channel was staged, and k is inside its chunk.
    #[inline(always)]
    unsafe fn channel<T: Lane>(&self, channel: usize) -> T {
        unsafe { T::load(self.staged.add(channel * STAGE + self.k)) }
    }

    /// A lane of a rate.
    #[inline(always)]
    unsafe fn rate<T: Lane>(&self, rate: Rate) -> T {
        match rate {
            Rate::Constant(rate) => T::splat(rate),
            Rate::Given { rate, .. } => unsafe { self.channel(rate) },
        }
    }

    /// A lane of a rate's change, where there is one.
    #[inline(always)]
    unsafe fn change<T: Lane>(&self, rate: Rate) -> Option<T> {
        match rate {
            Rate::Constant(_) => None,
            Rate::Given { change, .. } => Some(unsafe { self.channel(change) }),
        }
    }

    /// Position, velocity and acceleration of what follows the coordinates.
    #[inline(always)]
    unsafe fn follow<T: Lane>(&self, course: &Course) -> [T; 3] {
        let na = self.mechanism.coordinates;
        let mut x = [T::splat(course.offset), T::splat(0.0), T::splat(0.0)];
        for &(a, rate) in &course.rates {
            let weight: T = unsafe { self.rate(rate) };
            for (order, x) in x.iter_mut().enumerate() {
                *x = unsafe { self.channel::<T>(order * na + a) }.fma(weight, *x);
            }
            if let Some(change) = unsafe { self.change::<T>(rate) } {
                x[2] = unsafe { self.channel::<T>(na + a) }.fma(change, x[2]);
            }
        }
        if let Some(position) = course.given {
            x[0] = unsafe { self.channel(position) };
        }
        x
    }

    /// Write a lane of the entry of a row and a column.
    #[inline(always)]
    unsafe fn put<T: Lane>(&self, row: usize, c: usize, entry: T) {
        let at = self.places.place[row * self.mechanism.columns() + c];
        unsafe { entry.store(self.places.out.add(at + self.k)) };
    }
}

/// The rows of one lane of samples: ten columns for each link and axis, then the terms.
#[inline(always)]
unsafe fn torque_sample<T: Lane>(mechanism: &Mechanism, k: usize, places: &Places, workspace: &mut Workspace) {
    let Workspace { staged, links, axes, .. } = workspace;
    let sample = Sample { mechanism, staged: staged.as_ptr(), places, k };
    // SAFETY: the channels are staged, the slots are as many as links and axes, and the places have room for a lane.
    unsafe {
        for i in 0..mechanism.links.len() {
            link_rows::<T>(&sample, i, links, axes);
        }
        term_rows::<T>(&sample, 0);
    }
}

/// The same without accelerations: for each coordinate its momentum, and the rest of its torque.
#[inline(always)]
unsafe fn momentum_sample<T: Lane>(mechanism: &Mechanism, k: usize, places: &Places, workspace: &mut Workspace) {
    let Workspace { staged, links, axes, axis_rates } = workspace;
    let sample = Sample { mechanism, staged: staged.as_ptr(), places, k };
    // SAFETY: as for torques.
    unsafe {
        for i in 0..mechanism.links.len() {
            link_momenta::<T>(&sample, i, links, axes, axis_rates);
        }
        rotor_momenta::<T>(&sample);
        term_rows::<T>(&sample, mechanism.coordinates);
    }
}

#[inline(always)]
unsafe fn link_rows<T: Lane>(sample: &Sample, i: usize, links: &mut [LinkSlot], axes: &mut [AxisSlot]) {
    let link = &sample.mechanism.links[i];
    let [q, v, acceleration] = unsafe { sample.follow::<T>(&link.course) };
    let joint = JointMotion::new(link, q);
    let parent = link.parent.map(|p| LinkMotion::of(unsafe { get(&links[p]) }));
    let motion = link_motion(sample.mechanism, link, &joint, parent, v, acceleration);
    unsafe { put(&mut links[i], motion.flat()) };
    for (slot, axis) in link.axes.iter().enumerate() {
        let rate = unsafe { sample.rate(axis.rate) };
        let (x, u) = match axis.above {
            Some(above) => {
                let (x, u) = unsafe { get_axis::<T>(&axes[above]) };
                joint.carry(link, x, u, rate)
            }
            None => joint.own(link, rate),
        };
        unsafe { put_axis(&mut axes[link.first + slot], (x, u)) };
        let entries = match axis.above {
            Some(_) => contract(&motion, x, u),
            None if link.prismatic => contract_slide(&motion, u[2]),
            None => contract_turn(&motion, x[2]),
        };
        for (parameter, entry) in entries.into_iter().enumerate() {
            unsafe { sample.put(axis.coordinate, LINK_PARAMETERS * i + parameter, entry) };
        }
    }
}

#[inline(always)]
unsafe fn link_momenta<T: Lane>(
    sample: &Sample,
    i: usize,
    links: &mut [LinkSlot],
    axes: &mut [AxisSlot],
    axis_rates: &mut [AxisSlot],
) {
    let mechanism = sample.mechanism;
    let link = &mechanism.links[i];
    let [q, speed, _] = unsafe { sample.follow::<T>(&link.course) };
    let joint = JointMotion::new(link, q);
    let parent = link.parent.map(|p| LinkVelocity::of(unsafe { get(&links[p]) }));
    let velocity = link_velocity(mechanism, link, &joint, parent, speed);
    unsafe { put(&mut links[i], velocity.flat()) };
    for (slot, axis) in link.axes.iter().enumerate() {
        let above = axis.above.map(|k| unsafe { (get_axis::<T>(&axes[k]), get_axis::<T>(&axis_rates[k])) });
        let (rate, change) = unsafe { (sample.rate(axis.rate), sample.change(axis.rate)) };
        let (x, u) = match above {
            Some(((x, u), _)) => joint.carry(link, x, u, rate),
            None => joint.own(link, rate),
        };
        let own = (!axis.rate.is_zero()).then_some(rate);
        let change = axis_rate(&velocity, link, &joint, above.map(|pair| pair.1), own, change);
        let momenta = contract_momentum(&velocity, x, u);
        let rests = contract_rest(&velocity, (x, u), change);
        unsafe {
            put_axis(&mut axes[link.first + slot], (x, u));
            put_axis(&mut axis_rates[link.first + slot], change);
            for parameter in 0..LINK_PARAMETERS {
                let column = LINK_PARAMETERS * i + parameter;
                sample.put(axis.coordinate, column, momenta[parameter]);
                sample.put(mechanism.coordinates + axis.coordinate, column, rests[parameter]);
            }
        }
    }
}

/// Of the terms only rotors have momentum; what is left of their torque is that of a rate that changes. The others' runs
/// stay zero.
#[inline(always)]
unsafe fn rotor_momenta<T: Lane>(sample: &Sample) {
    let mechanism = sample.mechanism;
    let inertial = mechanism.inertial_columns();
    for (c, term) in (inertial..).zip(&mechanism.terms).filter(|(_, term)| term.law == Law::Rotor) {
        let [_, speed, _] = unsafe { sample.follow::<T>(&term.course) };
        for &(a, rate) in &term.course.rates {
            unsafe {
                sample.put(a, c, speed.mul(sample.rate(rate)));
                let rest = sample.change(rate).map_or(T::splat(0.0), |change: T| speed.mul(change).neg());
                sample.put(mechanism.coordinates + a, c, rest);
            }
        }
    }
}

/// The columns of the terms, into the rows from `first` on.
#[inline(always)]
unsafe fn term_rows<T: Lane>(sample: &Sample, first: usize) {
    let mechanism = sample.mechanism;
    let mut external = 3 * mechanism.coordinates;
    for (t, term) in mechanism.terms.iter().enumerate() {
        if first > 0 && term.law == Law::Rotor {
            continue; // it has momentum
        }
        let [x, v, a] = unsafe { sample.follow::<T>(&term.course) };
        let mut own = T::splat(0.0);
        if term.law == Law::External {
            own = unsafe { sample.channel(external) };
            external += 1;
        }
        let column = term.law.column(x, v, a, own);
        for &(a, rate) in &term.course.rates {
            let entry = unsafe { column.mul(sample.rate(rate)) };
            unsafe { sample.put(first + a, mechanism.inertial_columns() + t, entry) };
        }
    }
}
