//! Mechanism: a tree of links, the closure that reduces its joints to independent coordinates, and terms in addition to
//! link inertia (friction, springs, rotors).

pub(crate) mod closure;
pub(crate) mod layout;
pub(crate) mod motion;
pub(crate) mod parameters;
pub(crate) mod shape;
pub(crate) mod terms;
pub(crate) mod transform;

use crate::error::{Error, expect_length};
use crate::mechanism::closure::{Closure, JointMap, Rate};
use crate::mechanism::layout::LayoutCache;
use crate::mechanism::shape::{JointShape, JointType, Rotation};
use crate::mechanism::terms::{Column, Law, Term};
use crate::simd::dispatch::Backend;

/// Inertial parameters of a link: XX XY XZ YY YZ ZZ MX MY MZ M, in the link's frame, with Khalil's signs (XY =
/// -integral of x y dm).
pub(crate) const LINK_PARAMETERS: usize = 10;

/// A joint and the link it carries, in normal form: a constant placement of the joint's frame in the parent's link
/// frame, then rotation about, or translation along, the joint's own z.
#[derive(Debug, Clone, PartialEq)]
pub struct Joint {
    /// The parent link; `None` is the base.
    pub parent: Option<usize>,
    /// Rotation matrix from the joint's frame to the parent's, row-major.
    pub rotation: [f64; 9],
    /// Origin of the joint's frame in the parent's, m.
    pub translation: [f64; 3],
    /// Whether the joint slides along its z; otherwise it turns about it.
    pub prismatic: bool,
}

/// A link in the form that the kernels use.
#[derive(Debug, Clone)]
pub(crate) struct Link {
    pub parent: Option<usize>,
    /// Rotation matrix from the parent's frame to the joint's, row-major.
    pub inverse: [f64; 9],
    pub shape: JointShape,
    pub translation: [f64; 3],
    /// How the joint follows the coordinates.
    pub joint_map: JointMap,
    /// The coordinates that move this link, with the indices of their axes in the workspace.
    pub axes: Vec<Axis>,
    /// Index of this link's first axis in the workspace.
    pub first: usize,
    /// Place of the link among those that a forward recursion needs at a time: it is that of a link whose children are
    /// done, where there is one.
    pub place: usize,
}

/// The axis (motion vector) of one coordinate on one link.
#[derive(Debug, Clone, Copy)]
pub(crate) struct Axis {
    pub coordinate: usize,
    /// The same coordinate's axis on the parent, if it moves the parent.
    pub above: Option<usize>,
    /// Rate of this link's own joint with respect to the coordinate.
    pub rate: Rate,
}

/// A tree or closed chain in the form that the kernels use.
#[derive(Debug, Clone)]
pub struct Mechanism {
    pub(crate) links: Vec<Link>,
    pub(crate) coordinates: usize,
    pub(crate) axes: usize,
    /// Places of links.
    pub(crate) places: usize,
    pub(crate) gravity: [f64; 3],
    pub(crate) terms: Vec<Column>,
    pub(crate) externals: usize,
    /// Channels that a motion brings for loops with varying rates.
    pub(crate) loops: usize,
    pub(crate) backend: Backend,
    pub(crate) layout_cache: LayoutCache,
}

impl Mechanism {
    /// A mechanism of joints in an order in which parents precede their children. `gravity` is in the base frame, m/s^2.
    /// Errors where shapes do not fit, an index is out of range, a rotation is not orthonormal, or a number not finite.
    ///
    /// # Example
    ///
    /// ```
    /// use haptid_core::{Backend, Closure, Joint, Law, Mechanism, Term};
    /// const EYE: [f64; 9] = [1., 0., 0., 0., 1., 0., 0., 0., 1.];
    /// let joint = Joint { parent: None, rotation: EYE, translation: [0.; 3], prismatic: false };
    /// let friction = Term { law: Law::Viscous, weights: vec![(0, 1.)], offset: 0., joint: None };
    /// let pendulum = Mechanism::new(&[joint], &Closure::open(1), [0., -9.81, 0.], &[friction], Backend::best())?;
    /// assert_eq!(pendulum.columns(), 11);
    /// # Ok::<(), haptid_core::Error>(())
    /// ```
    pub fn new(
        joints: &[Joint],
        closure: &Closure,
        gravity: [f64; 3],
        terms: &[Term],
        backend: Backend,
    ) -> Result<Mechanism, Error> {
        let n = joints.len();
        expect_length("closure offset", closure.offset.len(), n)?;
        let coordinates = closure.rates.len().checked_div(n).unwrap_or(0);
        expect_length("closure rates", closure.rates.len(), n * coordinates)?;
        if !closure.given.is_empty() {
            expect_length("closure given", closure.given.len(), n * coordinates)?;
        }
        check_finite("closure", closure.rates.iter().chain(&closure.offset))?;
        check_finite("gravity", &gravity)?;
        for term in terms {
            term.check(coordinates)?;
        }
        let externals = terms.iter().filter(|t| t.law == Law::External).count();
        let mut mechanism = Mechanism {
            links: Vec::new(),
            coordinates,
            axes: 0,
            places: 0,
            gravity,
            terms: Vec::new(),
            externals,
            loops: 0,
            backend,
            layout_cache: LayoutCache::default(),
        };
        for (i, joint) in joints.iter().enumerate() {
            let joint_map = mechanism.joint_map(closure, i);
            mechanism.append(joint, joint_map)?;
        }
        mechanism.place_links();
        mechanism.terms = terms.iter().map(|term| mechanism.column(term)).collect::<Result<_, _>>()?;
        Ok(mechanism)
    }

    /// How joint `i` follows the coordinates; a joint that the motion prescribes takes the next channels.
    fn joint_map(&mut self, closure: &Closure, i: usize) -> JointMap {
        let row = i * self.coordinates..(i + 1) * self.coordinates;
        let rates = &closure.rates[row.clone()];
        match closure.given.get(row) {
            Some(given) if given.contains(&true) => {
                let first = 3 * self.coordinates + self.externals;
                let (joint_map, end) = JointMap::given(first + self.loops, rates, given);
                self.loops = end - first;
                joint_map
            }
            _ => JointMap::linear(closure.offset[i], rates.iter().copied().enumerate()),
        }
    }

    fn column(&self, term: &Term) -> Result<Column, Error> {
        let joint_map = match term.joint {
            None => JointMap::linear(term.offset, term.weights.iter().copied()),
            Some(got) => match self.links.get(got) {
                Some(link) => link.joint_map.clone(),
                None => return Err(Error::Index { name: "term joint", got, limit: self.links.len() }),
            },
        };
        Ok(Column { law: term.law, joint_map })
    }

    fn append(&mut self, joint: &Joint, joint_map: JointMap) -> Result<(), Error> {
        let index = self.links.len();
        if let Some(parent) = joint.parent.filter(|&p| p >= index) {
            return Err(Error::Index { name: "parent", got: parent, limit: index });
        }
        check_finite("placement", joint.rotation.iter().chain(&joint.translation))?;
        check_rotation(&joint.rotation)?;
        let above = |a| joint.parent.and_then(|p| self.links[p].axis(a));
        let axes: Vec<Axis> = (0..self.coordinates)
            .map(|a| Axis { coordinate: a, above: above(a), rate: joint_map.rate(a) })
            .filter(|axis| axis.above.is_some() || !axis.rate.is_zero())
            .collect();
        let r = &joint.rotation;
        let inverse = [r[0], r[3], r[6], r[1], r[4], r[7], r[2], r[5], r[8]];
        let first = self.axes;
        self.axes += axes.len();
        self.links.push(Link {
            parent: joint.parent,
            inverse,
            shape: JointShape { rotation: Rotation::of(&inverse), joint_type: JointType::of(joint) },
            translation: joint.translation,
            joint_map,
            axes,
            first,
            place: 0,
        });
        Ok(())
    }

    fn place_links(&mut self) {
        // The last link that reads each: the last child, or the link itself.
        let mut last: Vec<usize> = (0..self.links.len()).collect();
        self.links.iter().enumerate().for_each(|(i, link)| link.parent.into_iter().for_each(|p| last[p] = i));
        let mut free = Vec::new();
        for i in 0..self.links.len() {
            self.links[i].place = free.pop().unwrap_or(self.places);
            self.places = self.places.max(self.links[i].place + 1);
            free.extend((0..=i).filter(|&k| last[k] == i).map(|k| self.links[k].place));
        }
    }

    /// Number of independent coordinates, which is also the number of torque rows.
    ///
    /// # Example
    ///
    /// ```
    /// # use haptid_core::*;
    /// # let joint = Joint { parent: None, rotation: [1., 0., 0., 0., 1., 0., 0., 0., 1.], translation: [0.; 3], prismatic: false };
    /// # let pendulum = Mechanism::new(&[joint], &Closure::open(1), [0., -9.81, 0.], &[], Backend::best())?;
    /// assert_eq!(pendulum.coordinates(), 1);
    /// # Ok::<(), haptid_core::Error>(())
    /// ```
    pub fn coordinates(&self) -> usize {
        self.coordinates
    }

    /// Number of channels of a motion: positions, velocities and accelerations of the coordinates, external columns,
    /// then those of loops.
    ///
    /// # Example
    ///
    /// ```
    /// # use haptid_core::*;
    /// # let joint = Joint { parent: None, rotation: [1., 0., 0., 0., 1., 0., 0., 0., 1.], translation: [0.; 3], prismatic: false };
    /// # let pendulum = Mechanism::new(&[joint], &Closure::open(1), [0., -9.81, 0.], &[], Backend::best())?;
    /// assert_eq!(pendulum.channels(), 3);
    /// # Ok::<(), haptid_core::Error>(())
    /// ```
    pub fn channels(&self) -> usize {
        3 * self.coordinates + self.externals + self.loops
    }

    /// Number of columns of the regressor: ten for each link, then one for each term.
    ///
    /// # Example
    ///
    /// ```
    /// # use haptid_core::*;
    /// # let joint = Joint { parent: None, rotation: [1., 0., 0., 0., 1., 0., 0., 0., 1.], translation: [0.; 3], prismatic: false };
    /// # let pendulum = Mechanism::new(&[joint], &Closure::open(1), [0., -9.81, 0.], &[], Backend::best())?;
    /// assert_eq!(pendulum.columns(), 10);
    /// # Ok::<(), haptid_core::Error>(())
    /// ```
    pub fn columns(&self) -> usize {
        self.inertial_columns() + self.terms.len()
    }

    pub(crate) fn inertial_columns(&self) -> usize {
        LINK_PARAMETERS * self.links.len()
    }

    /// Whether a column can differ from zero in the row of coordinate `a`.
    pub(crate) fn is_structural_nonzero(&self, a: usize, column: usize) -> bool {
        match column.checked_sub(self.inertial_columns()) {
            Some(t) => !self.terms[t].joint_map.rate(a).is_zero(),
            None => self.links[column / LINK_PARAMETERS].axis(a).is_some(),
        }
    }

    /// Whether a column contributes to the generalised momentum: those of links and rotors do.
    pub(crate) fn has_momentum(&self, column: usize) -> bool {
        column.checked_sub(self.inertial_columns()).is_none_or(|t| self.terms[t].law == Law::Rotor)
    }
}

impl Link {
    pub(crate) fn is_prismatic(&self) -> bool {
        self.shape.joint_type == JointType::Prismatic
    }

    /// Index of the axis of coordinate `a` in the workspace, if it moves this link.
    fn axis(&self, a: usize) -> Option<usize> {
        self.axes.iter().position(|axis| axis.coordinate == a).map(|k| self.first + k)
    }
}

fn check_finite<'a>(name: &'static str, values: impl IntoIterator<Item = &'a f64>) -> Result<(), Error> {
    match values.into_iter().find(|x| !x.is_finite()) {
        Some(&got) => Err(Error::Value { name, got, wanted: "a finite number" }),
        None => Ok(()),
    }
}

/// Check that the rows are orthonormal and right-handed to 1e-9.
fn check_rotation(r: &[f64; 9]) -> Result<(), Error> {
    let row = |i: usize| [r[3 * i], r[3 * i + 1], r[3 * i + 2]];
    let dot = |a: [f64; 3], b: [f64; 3]| a[0] * b[0] + a[1] * b[1] + a[2] * b[2];
    let (x, y, z) = (row(0), row(1), row(2));
    let normal = [x[1] * y[2] - x[2] * y[1], x[2] * y[0] - x[0] * y[2], x[0] * y[1] - x[1] * y[0]];
    let errors = [dot(x, x) - 1.0, dot(y, y) - 1.0, dot(x, y), dot(normal, z) - 1.0];
    match errors.into_iter().find(|e| e.abs() > 1e-9) {
        Some(got) => Err(Error::Value { name: "rotation", got, wanted: "an orthonormal, right-handed matrix" }),
        None => Ok(()),
    }
}
