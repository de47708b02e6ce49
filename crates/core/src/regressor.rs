//! Rows of the observation matrix, by axes carried forward.
//!
//! The axis of every coordinate is carried from link to link in the links' own frames and contracted there with the
//! link's wrench, `Y[a, i] = s_i^a . A_i(v_i, a_i)`; the 6 x 10 map A_i is never written out. Carrying the axes of
//! the *coordinates* rather than of the joints, `s_i^a = X_i s_parent^a + G[i, a] z`, projects a closed chain's
//! torques onto its motors at no cost (Khalil and Dombre 2002, eq. 10.30, done without forming the tree's rows).

use crate::dispatch::dispatched;
use crate::error::{Error, expect_length};
use crate::lane::{Lane, MAX_WIDTH, sin_cos};
use crate::mechanism::{LINK_PARAMETERS, Link, Mechanism, Turn};
use crate::vector::{Vector, cross, cross_add, dot, zero};

/// Samples made at a time: the inputs and a row's columns stay in the first caches.
pub(crate) const CHUNK: usize = 256;

/// Positions, velocities and accelerations of the coordinates, and the caller's own columns, channel major:
/// sample `k` of coordinate `a` is at `a * samples + k`.
#[derive(Debug, Clone, Copy)]
pub struct Motion<'a> {
    pub samples: usize,
    pub position: &'a [f64],
    pub velocity: &'a [f64],
    pub acceleration: &'a [f64],
    pub external: &'a [f64],
}

impl Motion<'_> {
    pub(crate) fn check(&self, mechanism: &Mechanism) -> Result<(), Error> {
        let wanted = self.samples * mechanism.coordinates;
        expect_length("position", self.position.len(), wanted)?;
        expect_length("velocity", self.velocity.len(), wanted)?;
        expect_length("acceleration", self.acceleration.len(), wanted)?;
        expect_length("external", self.external.len(), self.samples * mechanism.externals)
    }
}

/// What one thread needs to make rows; made once, then reused for every chunk.
pub(crate) struct Workspace {
    /// A chunk of the motion, every channel padded to whole lanes.
    staged: Vec<f64>,
    /// Link motions and axes, as many numbers as the widest lane needs.
    links: Vec<[[f64; MAX_WIDTH]; LINK_NUMBERS]>,
    axes: Vec<[[f64; MAX_WIDTH]; 6]>,
}

const LINK_NUMBERS: usize = 18;
const STAGE: usize = CHUNK + MAX_WIDTH;

impl Workspace {
    pub(crate) fn new(mechanism: &Mechanism) -> Workspace {
        let channels = 3 * mechanism.coordinates + mechanism.externals;
        Workspace {
            staged: vec![0.0; channels * STAGE],
            links: vec![[[0.0; MAX_WIDTH]; LINK_NUMBERS]; mechanism.links.len()],
            axes: vec![[[0.0; MAX_WIDTH]; 6]; mechanism.axes],
        }
    }

    /// Copy samples `from..from + count` in, and repeat the last one up to a whole lane.
    fn stage(&mut self, mechanism: &Mechanism, motion: &Motion, from: usize, count: usize) {
        let (na, ne, n) = (mechanism.coordinates, mechanism.externals, motion.samples);
        let groups = [(motion.position, na), (motion.velocity, na), (motion.acceleration, na), (motion.external, ne)];
        let channels = groups.iter().flat_map(|&(data, many)| (0..many).map(move |a| &data[a * n..][..n]));
        for (source, staged) in channels.zip(self.staged.chunks_exact_mut(STAGE)) {
            staged[..count].copy_from_slice(&source[from..from + count]);
            let last = staged[count - 1];
            staged[count..count + MAX_WIDTH].fill(last);
        }
    }
}

/// Where the rows go: entry (row a, column c) of sample k is written at `place[a * columns + c] + k`. Columns that
/// are not wanted share a place that is never read.
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
    debug_assert!(count <= CHUNK && places.place.len() == mechanism.coordinates * mechanism.columns());
    if count > 0 {
        workspace.stage(mechanism, motion, from, count);
        unsafe { chunk(mechanism.backend, mechanism, count, places, workspace) }
    }
}

dispatched! {
    unsafe fn chunk = chunk_in_lanes(mechanism: &Mechanism, count: usize, places: &Places, workspace: &mut Workspace)
}

#[inline(always)]
unsafe fn chunk_in_lanes<T: Lane>(mechanism: &Mechanism, count: usize, places: &Places, workspace: &mut Workspace) {
    let mut k = 0;
    while k < count {
        // SAFETY: the staged channels are padded to whole lanes, and the places too.
        unsafe { sample::<T>(mechanism, k, places, workspace) };
        k += T::WIDTH;
    }
}

/// Motion of a link, in its own frame.
#[derive(Clone, Copy)]
struct LinkMotion<T> {
    /// Angular velocity and acceleration.
    w: Vector<T>,
    wd: Vector<T>,
    /// Acceleration of the origin less gravity.
    a: Vector<T>,
    /// `skew(wd) + skew(w)^2`, row-major.
    b: [T; 9],
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

/// The rows of one lane of samples.
#[inline(always)]
unsafe fn sample<T: Lane>(mechanism: &Mechanism, k: usize, places: &Places, workspace: &mut Workspace) {
    let columns = mechanism.columns();
    let Workspace { staged, links, axes } = workspace;
    let staged = staged.as_ptr();
    let na = mechanism.coordinates;
    // SAFETY (all loads below): channel < 3 na + ne, and k is below the chunk, whose channels are padded.
    let channel = |c: usize| unsafe { T::load(staged.add(c * STAGE + k)) };
    for (i, link) in mechanism.links.iter().enumerate() {
        let mut q = T::splat(link.offset);
        let (mut v, mut acceleration) = (T::splat(0.0), T::splat(0.0));
        for &(a, rate) in &link.rates {
            let rate = T::splat(rate);
            q = channel(a).fma(rate, q);
            v = channel(na + a).fma(rate, v);
            acceleration = channel(2 * na + a).fma(rate, acceleration);
        }
        let joint = JointMotion::new(link, q);
        let parent = link.parent.map(|p| {
            let m: [T; LINK_NUMBERS] = unsafe { get(&links[p]) };
            LinkMotion {
                w: [m[0], m[1], m[2]],
                wd: [m[3], m[4], m[5]],
                a: [m[6], m[7], m[8]],
                b: core::array::from_fn(|e| m[9 + e]),
            }
        });
        let motion = link_motion(mechanism, link, &joint, parent, v, acceleration);
        let mut flat = [T::splat(0.0); LINK_NUMBERS];
        flat[..3].copy_from_slice(&motion.w);
        flat[3..6].copy_from_slice(&motion.wd);
        flat[6..9].copy_from_slice(&motion.a);
        flat[9..].copy_from_slice(&motion.b);
        unsafe { put(&mut links[i], flat) };
        for (slot, axis) in link.axes.iter().enumerate() {
            let (x, u) = match axis.above {
                Some(above) => {
                    let s: [T; 6] = unsafe { get(&axes[above]) };
                    joint.carry(link, [s[0], s[1], s[2]], [s[3], s[4], s[5]], axis.rate)
                }
                None => joint.own(link, axis.rate),
            };
            unsafe { put(&mut axes[link.first + slot], [x[0], x[1], x[2], u[0], u[1], u[2]]) };
            let entries = if axis.above.is_some() {
                contract(&motion, x, u)
            } else if link.prismatic {
                contract_slide(&motion, u[2])
            } else {
                contract_turn(&motion, x[2])
            };
            let place = &places.place[axis.coordinate * columns + LINK_PARAMETERS * i..][..LINK_PARAMETERS];
            for (entry, &at) in entries.into_iter().zip(place) {
                unsafe { entry.store(places.out.add(at + k)) };
            }
        }
    }
    let mut external = 3 * na;
    for (t, term) in mechanism.terms.iter().enumerate() {
        let mut x = T::splat(term.offset);
        let (mut v, mut acceleration) = (T::splat(0.0), T::splat(0.0));
        for (a, &weight) in term.weights.iter().enumerate().filter(|w| *w.1 != 0.0) {
            let weight = T::splat(weight);
            x = channel(a).fma(weight, x);
            v = channel(na + a).fma(weight, v);
            acceleration = channel(2 * na + a).fma(weight, acceleration);
        }
        let mut own = T::splat(0.0);
        if term.is_external() {
            own = channel(external);
            external += 1;
        }
        let column = term.law.column(x, v, acceleration, own);
        for (a, &weight) in term.weights.iter().enumerate().filter(|w| *w.1 != 0.0) {
            let at = places.place[a * columns + mechanism.inertial_columns() + t];
            unsafe { column.mul(T::splat(weight)).store(places.out.add(at + k)) };
        }
    }
}

/// A joint at one position: how vectors of the parent's frame look in the link's, and where the link's origin is.
struct JointMotion<T> {
    cosine: T,
    sine: T,
    /// Origin of the link in the parent's frame.
    origin: Vector<T>,
}

impl<T: Lane> JointMotion<T> {
    #[inline(always)]
    fn new(link: &Link, q: T) -> Self {
        let p = link.translation.map(T::splat);
        if link.prismatic {
            // The joint's z in the parent's frame is the last row of the inverse rotation.
            let z = [link.inverse[6], link.inverse[7], link.inverse[8]].map(T::splat);
            let origin = core::array::from_fn(|e| z[e].fma(q, p[e]));
            JointMotion { cosine: T::splat(1.0), sine: T::splat(0.0), origin }
        } else {
            let (sine, cosine) = sin_cos(q);
            JointMotion { cosine, sine, origin: p }
        }
    }

    /// A vector of the parent's frame in the link's.
    #[inline(always)]
    fn rotate(&self, link: &Link, v: Vector<T>) -> Vector<T> {
        let r = &link.inverse;
        let row = |k: usize| v[2].fma(T::splat(r[k + 2]), v[1].fma(T::splat(r[k + 1]), v[0].mul(T::splat(r[k]))));
        let [x, y, z] = match link.turn {
            Turn::Identity => v,
            Turn::AboutX => [v[0], v[2], v[1].neg()],
            Turn::AboutMinusX => [v[0], v[2].neg(), v[1]],
            Turn::General => [row(0), row(3), row(6)],
        };
        if link.prismatic {
            return [x, y, z];
        }
        [x.fma(self.cosine, y.mul(self.sine)), x.fnma(self.sine, y.mul(self.cosine)), z]
    }

    /// The parent's axis of a coordinate (angular x, linear u) carried to this link, with the joint's own rate added.
    #[inline(always)]
    fn carry(&self, link: &Link, x: Vector<T>, u: Vector<T>, rate: f64) -> (Vector<T>, Vector<T>) {
        let at_origin = if link.displaced { cross_add(x, self.origin, u) } else { u };
        let (mut x, mut u) = (self.rotate(link, x), self.rotate(link, at_origin));
        let own = if link.prismatic { &mut u[2] } else { &mut x[2] };
        *own = own.add(T::splat(rate));
        (x, u)
    }

    /// The axis of a coordinate that moves this joint and no joint before it.
    #[inline(always)]
    fn own(&self, link: &Link, rate: f64) -> (Vector<T>, Vector<T>) {
        let z = T::splat(0.0);
        let along = [z, z, T::splat(rate)];
        if link.prismatic { (zero(), along) } else { (along, zero()) }
    }
}

/// Khalil and Dombre (2002), eqs 9.86 to 9.90, in the link's frame.
#[inline(always)]
fn link_motion<T: Lane>(
    mechanism: &Mechanism,
    link: &Link,
    joint: &JointMotion<T>,
    parent: Option<LinkMotion<T>>,
    v: T,
    acceleration: T,
) -> LinkMotion<T> {
    let (mut w, mut wd, mut a);
    match parent {
        None => {
            (w, wd) = (zero(), zero());
            a = joint.rotate(link, mechanism.gravity.map(|g| T::splat(-g)));
        }
        Some(parent) => {
            w = joint.rotate(link, parent.w);
            wd = joint.rotate(link, parent.wd);
            let (b, p) = (&parent.b, joint.origin);
            let row = |k: usize| b[3 * k + 2].fma(p[2], b[3 * k + 1].fma(p[1], b[3 * k].fma(p[0], parent.a[k])));
            a = joint.rotate(link, if link.displaced { [row(0), row(1), row(2)] } else { parent.a });
        }
    }
    if link.prismatic {
        let twice = v.add(v);
        a = [w[1].fma(twice, a[0]), w[0].fnma(twice, a[1]), a[2].add(acceleration)];
    } else {
        wd = [w[1].fma(v, wd[0]), w[0].fnma(v, wd[1]), wd[2].add(acceleration)];
        w[2] = w[2].add(v);
    }
    let (xx, yy, zz) = (w[0].mul(w[0]), w[1].mul(w[1]), w[2].mul(w[2]));
    let (xy, xz, yz) = (w[0].mul(w[1]), w[0].mul(w[2]), w[1].mul(w[2]));
    let b = [
        yy.add(zz).neg(),
        xy.sub(wd[2]),
        xz.add(wd[1]),
        xy.add(wd[2]),
        xx.add(zz).neg(),
        yz.sub(wd[0]),
        xz.sub(wd[1]),
        yz.add(wd[0]),
        xx.add(yy).neg(),
    ];
    LinkMotion { w, wd, a, b }
}

/// The wrench of a link's ten unit parameters, contracted with an axis (angular x, linear u).
#[inline(always)]
fn contract<T: Lane>(m: &LinkMotion<T>, x: Vector<T>, u: Vector<T>) -> [T; LINK_PARAMETERS] {
    let (w, wd, b) = (m.w, m.wd, &m.b);
    let y = cross(x, w);
    let h = cross(m.a, x);
    let moment = |k: usize| b[k].fma(u[0], b[k + 3].fma(u[1], b[k + 6].fma(u[2], h[k])));
    let mixed = |i: usize, j: usize| x[i].fma(wd[j], x[j].fma(wd[i], y[i].fma(w[j], y[j].mul(w[i]))));
    let square = |i: usize| x[i].fma(wd[i], y[i].mul(w[i]));
    [
        square(0),
        mixed(0, 1),
        mixed(0, 2),
        square(1),
        mixed(1, 2),
        square(2),
        moment(0),
        moment(1),
        moment(2),
        dot(u, m.a),
    ]
}

/// [`contract`] for a pure rotation about the link's own z.
#[inline(always)]
fn contract_turn<T: Lane>(m: &LinkMotion<T>, rate: T) -> [T; LINK_PARAMETERS] {
    let (w, wd, a) = (m.w, m.wd, m.a);
    let xy = w[0].mul(w[1]).mul(rate);
    [
        xy.neg(),
        w[0].mul(w[0]).sub(w[1].mul(w[1])).mul(rate),
        w[1].fnma(w[2], wd[0]).mul(rate),
        xy,
        w[0].fma(w[2], wd[1]).mul(rate),
        wd[2].mul(rate),
        a[1].mul(rate),
        a[0].neg().mul(rate),
        T::splat(0.0),
        T::splat(0.0),
    ]
}

/// [`contract`] for a pure translation along the link's own z.
#[inline(always)]
fn contract_slide<T: Lane>(m: &LinkMotion<T>, rate: T) -> [T; LINK_PARAMETERS] {
    let z = T::splat(0.0);
    let b = &m.b;
    [z, z, z, z, z, z, b[6].mul(rate), b[7].mul(rate), b[8].mul(rate), m.a[2].mul(rate)]
}

/// Which of the chosen columns each row can reach: coordinates x columns, row-major. The rest is structurally zero.
pub fn reach(mechanism: &Mechanism, columns: &[usize]) -> Result<Vec<bool>, Error> {
    let inertial = mechanism.inertial_columns();
    check_columns(mechanism, columns)?;
    let reaches = |a: usize, c: usize| {
        if c >= inertial {
            return mechanism.terms[c - inertial].weights[a] != 0.0;
        }
        mechanism.links[c / LINK_PARAMETERS].axes.iter().any(|axis| axis.coordinate == a)
    };
    let na = mechanism.coordinates;
    Ok((0..na).flat_map(|a| columns.iter().map(move |&c| reaches(a, c))).collect())
}

pub(crate) fn check_columns(mechanism: &Mechanism, columns: &[usize]) -> Result<(), Error> {
    let limit = mechanism.columns();
    match columns.iter().find(|&&c| c >= limit) {
        Some(&got) => Err(Error::Index { name: "column", got, limit }),
        None => Ok(()),
    }
}

/// A buffer for one chunk of rows, one run of samples per entry (row a, chosen column).
pub(crate) struct Tile {
    numbers: Vec<f64>,
    place: Vec<usize>,
    /// First sample of entry (a, c): `at[a * chosen + c]`.
    at: Vec<usize>,
}

/// Runs are this far apart: a multiple of 4 KiB would make them fight for the same cache lines.
const RUN: usize = CHUNK + MAX_WIDTH;

impl Tile {
    pub(crate) fn new(mechanism: &Mechanism, columns: &[usize]) -> Tile {
        let (na, all) = (mechanism.coordinates, mechanism.columns());
        let mut place = vec![0; na * all]; // the first run takes what nobody wants
        let mut at = Vec::with_capacity(na * columns.len());
        for a in 0..na {
            for &c in columns {
                at.push((1 + at.len()) * RUN);
                place[a * all + c] = at[at.len() - 1];
            }
        }
        Tile { numbers: vec![0.0; (1 + at.len()) * RUN], place, at }
    }

    fn fill(&mut self, mechanism: &Mechanism, motion: &Motion, from: usize, count: usize, workspace: &mut Workspace) {
        let places = Places { place: &self.place, out: self.numbers.as_mut_ptr() };
        // SAFETY: every run has room for a chunk and a lane.
        unsafe { rows(mechanism, motion, from, count, &places, workspace) }
    }

    fn run(&self, entry: usize, count: usize) -> &[f64] {
        &self.numbers[self.at[entry]..][..count]
    }
}

/// The regressor of every sample: `out[(a * chosen + c) * samples + k]`, for coordinate a, chosen column c, sample k.
pub fn regressor(mechanism: &Mechanism, motion: &Motion, columns: &[usize], out: &mut [f64]) -> Result<(), Error> {
    motion.check(mechanism)?;
    check_columns(mechanism, columns)?;
    let n = motion.samples;
    expect_length("out", out.len(), mechanism.coordinates * columns.len() * n)?;
    let (mut tile, mut workspace) = (Tile::new(mechanism, columns), Workspace::new(mechanism));
    for from in (0..n).step_by(CHUNK) {
        let count = CHUNK.min(n - from);
        tile.fill(mechanism, motion, from, count, &mut workspace);
        for (entry, column) in out.chunks_exact_mut(n).enumerate() {
            column[from..from + count].copy_from_slice(tile.run(entry, count));
        }
    }
    Ok(())
}

/// Torques of the chosen columns' parameters `chi`: `out[a * samples + k]`.
pub fn torque(
    mechanism: &Mechanism,
    motion: &Motion,
    columns: &[usize],
    chi: &[f64],
    out: &mut [f64],
) -> Result<(), Error> {
    motion.check(mechanism)?;
    check_columns(mechanism, columns)?;
    expect_length("chi", chi.len(), columns.len())?;
    let n = motion.samples;
    expect_length("out", out.len(), mechanism.coordinates * n)?;
    let (mut tile, mut workspace) = (Tile::new(mechanism, columns), Workspace::new(mechanism));
    out.fill(0.0);
    for from in (0..n).step_by(CHUNK) {
        let count = CHUNK.min(n - from);
        tile.fill(mechanism, motion, from, count, &mut workspace);
        for (a, row) in out.chunks_exact_mut(n).enumerate() {
            let row = &mut row[from..from + count];
            for (c, &parameter) in chi.iter().enumerate() {
                let column = tile.run(a * columns.len() + c, count);
                row.iter_mut().zip(column).for_each(|(tau, y)| *tau += y * parameter);
            }
        }
    }
    Ok(())
}
