//! Joints cut out of loops: how far their frames are apart, by which joints that changes, and poses that close them.
//!
//! Gaps are those of the two frames that a joint brings together: of a turning joint the distance of the origins and the
//! difference of the z axes; of a sliding one the distance across the twin's z, and the differences of the x and z axes.
//! Directions are weighed with the mechanism's size, so that all gaps are lengths. A joint j that carries a frame changes
//! its origin p by z_j x (p - o_j) and its axes R by z_j x R, or by z_j and nothing where it slides.

use crate::error::{Error, expect_length};
use crate::mechanism::Joint;
use crate::number::Number;
use rayon::prelude::*;

/// Largest step of a joint towards closed cuts, rad, or m per m of size.
const STRIDE: f64 = 0.7;
/// Damping of such steps, relative: far below what slows the last ones down.
const DAMPING: f64 = 1e-13;
/// Samples that one thread takes at a time.
const SHARE: usize = 256;

type Vector<N> = [N; 3];

/// A frame fixed to a link; `None` is the base.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct Frame {
    pub link: Option<usize>,
    /// Rotation from the frame to the link's, row-major.
    pub rotation: [f64; 9],
    /// Origin in the link's frame, m.
    pub translation: [f64; 3],
}

/// A joint cut, and the frames that it brings together.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct Cut {
    pub prismatic: bool,
    pub frame: Frame,
    pub twin: Frame,
}

impl Cut {
    fn gaps(&self) -> usize {
        if self.prismatic { 8 } else { 6 }
    }
}

/// A tree and the joints cut out of its loops.
#[derive(Debug, Clone)]
pub struct Loops {
    joints: Vec<Joint>,
    cuts: Vec<Cut>,
    size: f64,
    /// Where each joint stands on its parent, and each cut's frame and twin on their links.
    stands: Vec<Placement>,
    cut_stands: Vec<[Placement; 2]>,
    /// For each cut the joints that carry its frames, and which of both they carry.
    carriers: Vec<Vec<Carrier>>,
}

/// A rotation, where there is one, and a shift.
#[derive(Debug, Clone, Copy)]
struct Placement {
    rotation: Option<[f64; 9]>,
    shift: [f64; 3],
}

impl Placement {
    fn new(rotation: [f64; 9], shift: [f64; 3]) -> Placement {
        Placement { rotation: Some(rotation).filter(|r| *r != [1., 0., 0., 0., 1., 0., 0., 0., 1.]), shift }
    }
}

/// A joint that carries a cut's frame, its twin, or both.
#[derive(Debug, Clone, Copy)]
struct Carrier {
    joint: usize,
    frame: bool,
    twin: bool,
}

/// Where a link or a frame is: axes and origin, seen from the base.
#[derive(Clone, Copy)]
struct Pose<N> {
    axes: [Vector<N>; 3],
    origin: Vector<N>,
}

/// One sample's links, gaps, and their Jacobian, gaps x joints.
pub(crate) struct Shape<N> {
    links: Vec<Pose<N>>,
    pub(crate) gaps: Vec<N>,
    pub(crate) jacobian: Vec<N>,
}

// No closure stands between these and the lanes: one that is not inlined would pass them through memory.

#[inline(always)]
fn dot<N: Number>(a: Vector<N>, b: Vector<N>) -> N {
    (a[0] * b[0]).plus(a[1], b[1]).plus(a[2], b[2])
}

#[inline(always)]
fn sub<N: Number>(a: Vector<N>, b: Vector<N>) -> Vector<N> {
    [a[0] - b[0], a[1] - b[1], a[2] - b[2]]
}

#[inline(always)]
fn cross<N: Number>(a: Vector<N>, b: Vector<N>) -> Vector<N> {
    [(a[1] * b[2]).minus(a[2], b[1]), (a[2] * b[0]).minus(a[0], b[2]), (a[0] * b[1]).minus(a[1], b[0])]
}

#[inline(always)]
fn times<N: Number>(a: Vector<N>, x: N) -> Vector<N> {
    [a[0] * x, a[1] * x, a[2] * x]
}

/// a + b x
#[inline(always)]
fn plus<N: Number>(a: Vector<N>, b: Vector<N>, x: N) -> Vector<N> {
    [a[0].plus(b[0], x), a[1].plus(b[1], x), a[2].plus(b[2], x)]
}

/// a - b x
#[inline(always)]
fn minus<N: Number>(a: Vector<N>, b: Vector<N>, x: N) -> Vector<N> {
    [a[0].minus(b[0], x), a[1].minus(b[1], x), a[2].minus(b[2], x)]
}

/// a + b x, where x is constant.
#[inline(always)]
fn plus_times<N: Number>(a: Vector<N>, b: Vector<N>, x: f64) -> Vector<N> {
    [a[0].plus_times(b[0], x), a[1].plus_times(b[1], x), a[2].plus_times(b[2], x)]
}

impl<N: Number> Pose<N> {
    #[inline(always)]
    fn base() -> Self {
        let (one, none) = (N::of(1.0), N::of(0.0));
        Pose { axes: [[one, none, none], [none, one, none], [none, none, one]], origin: [none; 3] }
    }

    /// Rates of a frame that stands still.
    #[inline(always)]
    fn still() -> Self {
        let zero = [N::of(0.0); 3];
        Pose { axes: [zero; 3], origin: zero }
    }

    /// Rates of the axes and the origin with a joint that carries them, whose link is given.
    #[inline(always)]
    fn turned_by(&self, link: &Pose<N>, prismatic: bool) -> Self {
        let ([x, y, z], about) = (self.axes, link.axes[2]);
        if prismatic {
            return Pose { origin: about, ..Pose::still() };
        }
        let axes = [cross(about, x), cross(about, y), cross(about, z)];
        Pose { axes, origin: cross(about, sub(self.origin, link.origin)) }
    }

    /// A point, and how far it is from there along the axes.
    #[inline(always)]
    fn along(&self, from: Vector<N>, x: [f64; 3]) -> Vector<N> {
        let [a, b, c] = self.axes;
        plus_times(plus_times(plus_times(from, a, x[0]), b, x[1]), c, x[2])
    }

    /// A frame that stands in this one.
    #[inline(always)]
    fn placed(&self, at: &Placement) -> Self {
        let (origin, none) = (self.along(self.origin, at.shift), [N::of(0.0); 3]);
        let axes = match at.rotation {
            None => self.axes,
            Some([a, b, c, d, e, f, g, h, i]) => {
                [self.along(none, [a, d, g]), self.along(none, [b, e, h]), self.along(none, [c, f, i])]
            }
        };
        Pose { axes, origin }
    }

    /// Turned about, or moved along, its own z.
    #[inline(always)]
    fn moved(&self, prismatic: bool, q: N) -> Self {
        let [x, y, z] = self.axes;
        if prismatic {
            return Pose { axes: self.axes, origin: plus(self.origin, z, q) };
        }
        let (s, c) = q.sin_cos();
        Pose { axes: [plus(times(x, c), y, s), minus(times(y, c), x, s), z], origin: self.origin }
    }
}

impl<N: Number> Shape<N> {
    /// A frame, and where it stands on its link.
    #[inline(always)]
    fn pose(&self, link: Option<usize>, at: &Placement) -> Pose<N> {
        match link {
            None => Pose::base().placed(at),
            Some(link) => self.links[link].placed(at),
        }
    }
}

impl Loops {
    /// Check the parts and put them together; `size` weighs directions, m.
    pub fn new(joints: &[Joint], cuts: &[Cut], size: f64) -> Result<Loops, Error> {
        let n = joints.len();
        let mut above = vec![false; n * n];
        for (i, joint) in joints.iter().enumerate() {
            if let Some(parent) = joint.parent {
                if parent >= i {
                    return Err(Error::Index { name: "parent", got: parent, limit: i });
                }
                above.copy_within(parent * n..(parent + 1) * n, i * n);
            }
            above[i * n + i] = true;
        }
        let links = cuts.iter().flat_map(|cut| [cut.frame.link, cut.twin.link]).flatten();
        if let Some(got) = links.max().filter(|&link| link >= n) {
            return Err(Error::Index { name: "link of a cut", got, limit: n });
        }
        if !(size.is_finite() && size > 0.0) {
            return Err(Error::Value { name: "size", got: size, wanted: "a finite number above zero" });
        }
        let carries = |j: usize, frame: &Frame| frame.link.is_some_and(|link| above[link * n + j]);
        let carriers = |cut: &Cut| {
            let both = (0..n).map(|joint| Carrier {
                joint,
                frame: carries(joint, &cut.frame),
                twin: carries(joint, &cut.twin),
            });
            both.filter(|carrier| carrier.frame || carrier.twin).collect()
        };
        let carriers = cuts.iter().map(carriers).collect();
        let stands = joints.iter().map(|joint| Placement::new(joint.rotation, joint.translation)).collect();
        let frames = |cut: &Cut| [cut.frame, cut.twin].map(|frame| Placement::new(frame.rotation, frame.translation));
        let cut_stands = cuts.iter().map(frames).collect();
        Ok(Loops { joints: joints.to_vec(), cuts: cuts.to_vec(), size, stands, cut_stands, carriers })
    }

    /// What a joint's move is measured by: rad where it turns, the mechanism's size where it slides, m.
    pub(crate) fn unit(&self, joint: usize) -> f64 {
        if self.joints[joint].prismatic { self.size } else { 1.0 }
    }

    /// What directions are weighed with, m.
    pub(crate) fn size(&self) -> f64 {
        self.size
    }

    /// Number of gaps.
    pub fn gaps(&self) -> usize {
        self.cuts.iter().map(Cut::gaps).sum()
    }

    /// Number of joints.
    pub fn joints(&self) -> usize {
        self.joints.len()
    }

    pub(crate) fn shape<N: Number>(&self) -> Shape<N> {
        let (m, n) = (self.gaps(), self.joints.len());
        Shape { links: vec![Pose::base(); n], gaps: vec![N::of(0.0); m], jacobian: vec![N::of(0.0); m * n] }
    }

    /// Gaps and their Jacobian at positions of the joints; entries of joints that carry no frame stay as they were made.
    #[inline(always)]
    pub(crate) fn measure<N: Number>(&self, q: &[N], shape: &mut Shape<N>) {
        self.place(q, shape);
        let mut first = 0;
        for (k, cut) in self.cuts.iter().enumerate() {
            if cut.prismatic {
                self.measure_cut::<N, Sliding>(k, first, shape);
            } else {
                self.measure_cut::<N, Turning>(k, first, shape);
            }
            first += cut.gaps();
        }
    }

    /// Gaps alone.
    #[inline(always)]
    pub(crate) fn measure_gaps<N: Number>(&self, q: &[N], shape: &mut Shape<N>) {
        self.place(q, shape);
        let mut first = 0;
        for (k, cut) in self.cuts.iter().enumerate() {
            let [own, twin] = self.frames(k, shape);
            let moved = Moved::between(&own, &twin);
            let gaps = &mut shape.gaps[first..];
            if cut.prismatic {
                Sliding::entries(self.size, &moved.twin, [N::of(0.0); 3], &moved, gaps, 1);
            } else {
                Turning::entries(self.size, &moved.twin, [N::of(0.0); 3], &moved, gaps, 1);
            }
            first += cut.gaps();
        }
    }

    /// Put the links where the joints bring them.
    #[inline(always)]
    fn place<N: Number>(&self, q: &[N], shape: &mut Shape<N>) {
        for (j, joint) in self.joints.iter().enumerate() {
            shape.links[j] = shape.pose(joint.parent, &self.stands[j]).moved(joint.prismatic, q[j]);
        }
    }

    /// Both frames of cut k.
    #[inline(always)]
    fn frames<N: Number>(&self, k: usize, shape: &Shape<N>) -> [Pose<N>; 2] {
        let (cut, [own, twin]) = (&self.cuts[k], &self.cut_stands[k]);
        [shape.pose(cut.frame.link, own), shape.pose(cut.twin.link, twin)]
    }

    /// Of cut k, whose gaps begin at `first`.
    #[inline(always)]
    fn measure_cut<N: Number, K: Kind>(&self, k: usize, first: usize, shape: &mut Shape<N>) {
        let (n, [own, twin]) = (self.joints.len(), self.frames(k, shape));
        let whole = Moved::between(&own, &twin);
        K::entries(self.size, &twin.axes, [N::of(0.0); 3], &whole, &mut shape.gaps[first..], 1);
        for carrier in &self.carriers[k] {
            let (link, prismatic) = (&shape.links[carrier.joint], self.joints[carrier.joint].prismatic);
            let by_own = if carrier.frame { own.turned_by(link, prismatic) } else { Pose::still() };
            let by_twin = if carrier.twin { twin.turned_by(link, prismatic) } else { Pose::still() };
            let change = Moved::between(&by_own, &by_twin);
            K::entries(
                self.size,
                &twin.axes,
                whole.apart,
                &change,
                &mut shape.jacobian[first * n + carrier.joint..],
                n,
            );
        }
    }

    /// Gaps, samples x gaps, and their Jacobian, samples x gaps x joints, at positions q, samples x joints.
    pub fn gaps_into(&self, q: &[f64], gaps: &mut [f64], jacobian: &mut [f64]) -> Result<(), Error> {
        let (m, n) = (self.gaps(), self.joints.len());
        let samples = q.len().checked_div(n).unwrap_or(0);
        expect_length("q", q.len(), samples * n)?;
        expect_length("gaps", gaps.len(), samples * m)?;
        expect_length("jacobian", jacobian.len(), samples * m * n)?;
        let shares = q.par_chunks(SHARE * n.max(1)).zip(gaps.par_chunks_mut(SHARE * m.max(1)));
        shares.zip(jacobian.par_chunks_mut(SHARE * (m * n).max(1))).for_each(|((q, gaps), jacobian)| {
            let mut shape = self.shape::<f64>();
            let each = q.chunks_exact(n).zip(gaps.chunks_exact_mut(m.max(1)));
            for ((q, gaps), jacobian) in each.zip(jacobian.chunks_exact_mut((m * n).max(1))) {
                self.measure(q, &mut shape);
                gaps.copy_from_slice(&shape.gaps);
                jacobian.copy_from_slice(&shape.jacobian);
            }
        });
        Ok(())
    }

    /// Move the unknown joints of every sample, samples x joints, until the cuts are as closed as they can be: damped
    /// Gauss-Newton steps, at most `steps`, until one is no longer than `settled`.
    pub fn close(&self, q: &mut [f64], unknown: &[usize], steps: usize, settled: f64) -> Result<(), Error> {
        let n = self.joints.len();
        expect_length("q", q.len(), q.len().checked_div(n).unwrap_or(0) * n)?;
        if let Some(&got) = unknown.iter().find(|&&j| j >= n) {
            return Err(Error::Index { name: "unknown joint", got, limit: n });
        }
        q.par_chunks_mut(SHARE * n.max(1)).for_each(|q| {
            let (mut shape, mut system) = (self.shape::<f64>(), System::new(unknown.len()));
            for q in q.chunks_exact_mut(n) {
                for _ in 0..steps {
                    self.measure(q, &mut shape);
                    system.assemble(&shape, n, unknown);
                    let step = system.solve();
                    let longest = step.iter().fold(0.0_f64, |longest, x| longest.max(x.abs()));
                    let share = (STRIDE / longest.max(STRIDE)).min(1.0);
                    unknown.iter().zip(step).for_each(|(&j, x)| q[j] -= share * x);
                    if longest <= settled {
                        break;
                    }
                }
            }
        });
        Ok(())
    }
}

/// What moved, or how fast: the distance between the origins, and the axes of both frames.
struct Moved<N> {
    apart: Vector<N>,
    own: [Vector<N>; 3],
    twin: [Vector<N>; 3],
}

impl<N: Number> Moved<N> {
    #[inline(always)]
    fn between(own: &Pose<N>, twin: &Pose<N>) -> Self {
        Moved { apart: sub(own.origin, twin.origin), own: own.axes, twin: twin.axes }
    }
}

/// How the gaps of a cut follow from what moved, as far as they are linear in it.
trait Kind {
    /// Write gap after gap, each so many places after the last, the twin's own turn against a distance added.
    fn entries<N: Number>(
        size: f64,
        twin: &[Vector<N>; 3],
        apart: Vector<N>,
        moved: &Moved<N>,
        out: &mut [N],
        after: usize,
    );
}

/// A joint that turns.
struct Turning;

/// A joint that slides.
struct Sliding;

impl Kind for Turning {
    #[inline(always)]
    fn entries<N: Number>(size: f64, _: &[Vector<N>; 3], _: Vector<N>, moved: &Moved<N>, out: &mut [N], after: usize) {
        for e in 0..3 {
            out[e * after] = moved.apart[e];
            out[(3 + e) * after] = (moved.own[2][e] - moved.twin[2][e]).times(size);
        }
    }
}

impl Kind for Sliding {
    #[inline(always)]
    fn entries<N: Number>(
        size: f64,
        twin: &[Vector<N>; 3],
        apart: Vector<N>,
        moved: &Moved<N>,
        out: &mut [N],
        after: usize,
    ) {
        for k in 0..2 {
            out[k * after] = dot(twin[k], moved.apart) + dot(moved.twin[k], apart);
            for e in 0..3 {
                out[(2 + 2 * e + k) * after] = (moved.own[2 * k][e] - moved.twin[2 * k][e]).times(size);
            }
        }
    }
}

/// The damped normal equations of one step: small, and solved again and again, so that their error does not stay.
struct System {
    size: usize,
    matrix: Vec<f64>,
    right: Vec<f64>,
}

impl System {
    fn new(size: usize) -> System {
        System { size, matrix: vec![0.0; size * size], right: vec![0.0; size] }
    }

    fn assemble(&mut self, shape: &Shape<f64>, joints: usize, unknown: &[usize]) {
        self.matrix.fill(0.0);
        self.right.fill(0.0);
        for (row, gap) in shape.jacobian.chunks_exact(joints).zip(&shape.gaps) {
            for (i, &a) in unknown.iter().enumerate() {
                self.right[i] += row[a] * gap;
                for (k, &b) in unknown[..=i].iter().enumerate() {
                    self.matrix[i * self.size + k] += row[a] * row[b];
                }
            }
        }
        let trace: f64 = (0..self.size).map(|i| self.matrix[i * (self.size + 1)]).sum();
        (0..self.size).for_each(|i| self.matrix[i * (self.size + 1)] += DAMPING * trace.max(1e-100));
    }

    /// By L D L', the lower triangle in place; a pivot that rounding took stays at the damping.
    fn solve(&mut self) -> &[f64] {
        let (n, l, x) = (self.size, &mut self.matrix, &mut self.right);
        let least = DAMPING * (0..n).map(|i| l[i * (n + 1)]).sum::<f64>();
        for i in 0..n {
            for k in 0..i {
                let known: f64 = (0..k).map(|e| l[i * n + e] * l[k * n + e] * l[e * (n + 1)]).sum();
                l[i * n + k] = (l[i * n + k] - known) / l[k * (n + 1)];
            }
            let known: f64 = (0..i).map(|e| l[i * n + e] * l[i * n + e] * l[e * (n + 1)]).sum();
            l[i * (n + 1)] = (l[i * (n + 1)] - known).max(least);
            x[i] -= (0..i).map(|e| l[i * n + e] * x[e]).sum::<f64>();
        }
        for i in (0..n).rev() {
            x[i] = x[i] / l[i * (n + 1)] - (i + 1..n).map(|e| l[e * n + i] * x[e]).sum::<f64>();
        }
        x
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::dual::Dual;

    /// Four bars in a plane, the last joint cut, and a slider beside it.
    fn bars() -> Loops {
        let eye = [1., 0., 0., 0., 1., 0., 0., 0., 1.];
        let aside = [0., 0., 1., 1., 0., 0., 0., 1., 0.];
        let bar = |parent, x| Joint { parent, rotation: eye, translation: [x, 0.1, 0.0], prismatic: false };
        let slider = Joint { parent: Some(2), rotation: aside, translation: [0.2, 0.0, 0.1], prismatic: true };
        let frame = |link, x| Frame { link, rotation: aside, translation: [x, 0.0, 0.3] };
        let cuts = [
            Cut { prismatic: false, frame: frame(Some(1), 0.5), twin: frame(Some(2), 0.4) },
            Cut { prismatic: true, frame: frame(Some(3), 0.1), twin: frame(Some(0), 0.2) },
        ];
        Loops::new(&[bar(None, 0.0), bar(Some(0), 0.3), bar(None, 0.6), slider], &cuts, 0.6).expect("four bars")
    }

    fn measured(loops: &Loops, q: &[f64]) -> (Vec<f64>, Vec<f64>) {
        let mut made = (vec![0.0; loops.gaps()], vec![0.0; loops.gaps() * q.len()]);
        loops.gaps_into(q, &mut made.0, &mut made.1).expect("shapes");
        made
    }

    #[test]
    fn jacobians_and_their_change_are_those_of_differences() {
        let (loops, q, qd, h) = (bars(), [0.3, -0.7, 1.1, 0.2], [0.5, 1.2, -0.8, 0.4], 1e-6);
        let shifted = |h: f64, by: &dyn Fn(usize) -> f64| {
            let q: Vec<f64> = q.iter().enumerate().map(|(j, q)| q + h * by(j)).collect();
            measured(&loops, &q)
        };
        let jacobian = measured(&loops, &q).1;
        for j in 0..4 {
            let by = |k: usize| if k == j { 1.0 } else { 0.0 };
            let (ahead, behind) = (shifted(h, &by).0, shifted(-h, &by).0);
            for e in 0..loops.gaps() {
                let slope = (ahead[e] - behind[e]) / (2.0 * h);
                assert!((slope - jacobian[4 * e + j]).abs() < 1e-8, "gap {e} by joint {j}");
            }
        }
        let mut moving = loops.shape();
        let duals = [0, 1, 2, 3].map(|j| Dual { value: q[j], rate: qd[j] });
        loops.measure(&duals, &mut moving);
        let (ahead, behind) = (shifted(h, &|j| qd[j]).1, shifted(-h, &|j| qd[j]).1);
        for (e, entry) in moving.jacobian.iter().enumerate() {
            assert!(((ahead[e] - behind[e]) / (2.0 * h) - entry.rate).abs() < 1e-8, "entry {e}");
        }
    }

    #[test]
    fn two_bars_meet_where_the_law_of_cosines_says() {
        let eye = [1., 0., 0., 0., 1., 0., 0., 0., 1.];
        let bar = |x| Joint { parent: None, rotation: eye, translation: [x, 0., 0.], prismatic: false };
        let tip = |link, x| Frame { link: Some(link), rotation: eye, translation: [x, 0.0, 0.0] };
        let cut = Cut { prismatic: false, frame: tip(0, 0.5), twin: tip(1, 0.4) };
        let loops = Loops::new(&[bar(0.0), bar(0.6)], &[cut], 0.6).expect("two bars");
        let mut q = [0.5, 2.0].repeat(300);
        loops.close(&mut q, &[0, 1], 60, 1e-12).expect("shapes");
        let (first, second) = ((0.25 + 0.36 - 0.16_f64) / 0.6, (0.16 + 0.36 - 0.25_f64) / 0.48);
        for q in q.chunks_exact(2) {
            assert!((q[0].cos() - first).abs() < 1e-10 && (-q[1].cos() - second).abs() < 1e-10, "{q:?}");
        }
    }
}
