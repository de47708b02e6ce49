//! Cut joints: a tree with the joints that are cut to open its loops.
//!
//! The gaps of a cut joint are those of the two frames that it brings together: of a revolute joint the distance of the
//! origins and the difference of the z axes; of a prismatic one the distance perpendicular to the second frame's z, and
//! the differences of the x and z axes; of a spherical one the distance of the origins alone. Directions are weighted by the length scale, so that all gaps are lengths. A
//! joint j that carries a frame moves its origin p by z_j x (p - o_j) and its axes R by z_j x R, or by z_j and zero if
//! it is prismatic.

use crate::error::Error;
use crate::loops::pose::Placement;
use crate::mechanism::Joint;

/// Samples per task of a thread.
pub(crate) const SHARE: usize = 256;

/// A frame fixed to a link.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct Frame {
    /// The link; `None` is the base.
    pub link: Option<usize>,
    /// Rotation matrix from the frame to the link's, row-major.
    pub rotation: [f64; 9],
    /// Origin in the link's frame, m.
    pub translation: [f64; 3],
}

/// Kind of a cut joint.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub enum CutKind {
    /// The origins and z axes of both frames coincide.
    Revolute,
    /// The z axes are one line, and the orientations are equal.
    Prismatic,
    /// The origins coincide.
    Spherical,
}

/// A cut joint: the two frames that it brings together.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct CutJoint {
    /// What it leaves free.
    pub kind: CutKind,
    /// Frame on one side of the cut.
    pub frame_a: Frame,
    /// Frame on the other side, along whose axes the gaps of a prismatic joint are measured.
    pub frame_b: Frame,
}

impl CutJoint {
    pub(crate) fn gaps(&self) -> usize {
        match self.kind {
            CutKind::Revolute => 6,
            CutKind::Prismatic => 8,
            CutKind::Spherical => 3,
        }
    }
}

/// A tree with cut joints, whose gaps are the loop-closure equations.
#[derive(Debug, Clone)]
pub struct LoopClosure {
    pub(crate) joints: Vec<Joint>,
    pub(crate) cuts: Vec<CutJoint>,
    pub(crate) length_scale: f64,
    /// Placement of each joint on its parent, and of the frames of each cut joint on their links.
    pub(crate) joint_placements: Vec<Placement>,
    pub(crate) frame_placements: Vec<[Placement; 2]>,
    /// For each cut joint the joints that carry its frames.
    pub(crate) carriers: Vec<Vec<Carrier>>,
}

/// A joint that carries one or both frames of a cut joint.
#[derive(Debug, Clone, Copy)]
pub(crate) struct Carrier {
    pub(crate) joint: usize,
    pub(crate) frame_a: bool,
    pub(crate) frame_b: bool,
}

impl LoopClosure {
    /// Cut joints of a tree whose joints come after their parents. `length_scale`, m, weights directions. Errors where an
    /// index or the length scale is out of range.
    ///
    /// # Example
    ///
    /// ```
    /// use haptid_core::*;
    /// const EYE: [f64; 9] = [1., 0., 0., 0., 1., 0., 0., 0., 1.];
    /// let bar = |x| Joint { parent: None, rotation: EYE, translation: [x, 0., 0.], prismatic: false };
    /// let tip = |link, x| Frame { link: Some(link), rotation: EYE, translation: [x, 0., 0.] };
    /// let cut = CutJoint { kind: CutKind::Revolute, frame_a: tip(0, 0.5), frame_b: tip(1, 0.4) };
    /// let loops = LoopClosure::new(&[bar(0.), bar(0.6)], &[cut], 0.6)?;
    /// # Ok::<(), haptid_core::Error>(())
    /// ```
    pub fn new(joints: &[Joint], cuts: &[CutJoint], length_scale: f64) -> Result<LoopClosure, Error> {
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
        let links = cuts.iter().flat_map(|cut| [cut.frame_a.link, cut.frame_b.link]).flatten();
        if let Some(got) = links.max().filter(|&link| link >= n) {
            return Err(Error::Index { name: "link of a cut", got, limit: n });
        }
        if !(length_scale.is_finite() && length_scale > 0.0) {
            return Err(Error::Value { name: "size", got: length_scale, wanted: "a finite number above zero" });
        }
        let carries = |j: usize, frame: &Frame| frame.link.is_some_and(|link| above[link * n + j]);
        let carriers = |cut: &CutJoint| {
            let both = (0..n).map(|joint| Carrier {
                joint,
                frame_a: carries(joint, &cut.frame_a),
                frame_b: carries(joint, &cut.frame_b),
            });
            both.filter(|carrier| carrier.frame_a || carrier.frame_b).collect()
        };
        let carriers = cuts.iter().map(carriers).collect();
        let joint_placements = joints.iter().map(|joint| Placement::new(joint.rotation, joint.translation)).collect();
        let frames =
            |cut: &CutJoint| [cut.frame_a, cut.frame_b].map(|frame| Placement::new(frame.rotation, frame.translation));
        let frame_placements = cuts.iter().map(frames).collect();
        Ok(LoopClosure {
            joints: joints.to_vec(),
            cuts: cuts.to_vec(),
            length_scale,
            joint_placements,
            frame_placements,
            carriers,
        })
    }

    /// Unit of a joint's displacement: 1 rad if it is revolute, the length scale, m, if it is prismatic.
    pub(crate) fn joint_scale(&self, joint: usize) -> f64 {
        if self.joints[joint].prismatic { self.length_scale } else { 1.0 }
    }

    /// Weight of directions, m.
    pub(crate) fn length_scale(&self) -> f64 {
        self.length_scale
    }

    /// Number of gaps.
    ///
    /// # Example
    ///
    /// ```
    /// # use haptid_core::*;
    /// # const EYE: [f64; 9] = [1., 0., 0., 0., 1., 0., 0., 0., 1.];
    /// # let bar = |x| Joint { parent: None, rotation: EYE, translation: [x, 0., 0.], prismatic: false };
    /// # let tip = |link, x| Frame { link: Some(link), rotation: EYE, translation: [x, 0., 0.] };
    /// # let cut = CutJoint { kind: CutKind::Revolute, frame_a: tip(0, 0.5), frame_b: tip(1, 0.4) };
    /// # let loops = LoopClosure::new(&[bar(0.), bar(0.6)], &[cut], 0.6)?;
    /// // One cut revolute joint: three distances, three differences of directions.
    /// assert_eq!(loops.gaps(), 6);
    /// # Ok::<(), haptid_core::Error>(())
    /// ```
    pub fn gaps(&self) -> usize {
        self.cuts.iter().map(CutJoint::gaps).sum()
    }

    /// Number of joints.
    ///
    /// # Example
    ///
    /// ```
    /// # use haptid_core::*;
    /// # const EYE: [f64; 9] = [1., 0., 0., 0., 1., 0., 0., 0., 1.];
    /// # let bar = |x| Joint { parent: None, rotation: EYE, translation: [x, 0., 0.], prismatic: false };
    /// # let tip = |link, x| Frame { link: Some(link), rotation: EYE, translation: [x, 0., 0.] };
    /// # let cut = CutJoint { kind: CutKind::Revolute, frame_a: tip(0, 0.5), frame_b: tip(1, 0.4) };
    /// # let loops = LoopClosure::new(&[bar(0.), bar(0.6)], &[cut], 0.6)?;
    /// assert_eq!(loops.joints(), 2);
    /// # Ok::<(), haptid_core::Error>(())
    /// ```
    pub fn joints(&self) -> usize {
        self.joints.len()
    }
}
