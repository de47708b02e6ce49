//! Joints cut out of loops: how far their frames are apart, by which joints that changes, and poses that close them.
//!
//! Gaps are those of the two frames that a joint brings together: of a turning joint the distance of the origins and the
//! difference of the z axes; of a sliding one the distance across the twin's z, and the differences of the x and z axes.
//! Directions are weighed with the mechanism's size, so that all gaps are lengths. A joint j that carries a frame changes
//! its origin p by z_j x (p - o_j) and its axes R by z_j x R, or by z_j and nothing where it slides.

use crate::error::Error;
use crate::loops::pose::Placement;
use crate::mechanism::Joint;

/// Samples that one thread takes at a time.
pub(crate) const SHARE: usize = 256;

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
pub struct CutJoint {
    pub prismatic: bool,
    pub frame_a: Frame,
    pub frame_b: Frame,
}

impl CutJoint {
    pub(crate) fn gaps(&self) -> usize {
        if self.prismatic { 8 } else { 6 }
    }
}

/// A tree and the joints cut out of its loops.
#[derive(Debug, Clone)]
pub struct LoopClosure {
    pub(crate) joints: Vec<Joint>,
    pub(crate) cuts: Vec<CutJoint>,
    pub(crate) length_scale: f64,
    /// Where each joint joint_placements on its parent, and each cut's frame and twin on their links.
    pub(crate) joint_placements: Vec<Placement>,
    pub(crate) frame_placements: Vec<[Placement; 2]>,
    /// For each cut the joints that carry its frames, and which of both they carry.
    pub(crate) carriers: Vec<Vec<Carrier>>,
}

/// A joint that carries a cut's frame, its twin, or both.
#[derive(Debug, Clone, Copy)]
pub(crate) struct Carrier {
    pub(crate) joint: usize,
    pub(crate) frame: bool,
    pub(crate) twin: bool,
}

impl LoopClosure {
    /// Check the parts and put them together; `size` weighs directions, m.
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
                frame: carries(joint, &cut.frame_a),
                twin: carries(joint, &cut.frame_b),
            });
            both.filter(|carrier| carrier.frame || carrier.twin).collect()
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

    /// What a joint's move is measured by: rad where it turns, the mechanism's size where it slides, m.
    pub(crate) fn joint_scale(&self, joint: usize) -> f64 {
        if self.joints[joint].prismatic { self.length_scale } else { 1.0 }
    }

    /// What directions are weighed with, m.
    pub(crate) fn length_scale(&self) -> f64 {
        self.length_scale
    }

    /// Number of gaps.
    pub fn gaps(&self) -> usize {
        self.cuts.iter().map(CutJoint::gaps).sum()
    }

    /// Number of joints.
    pub fn joints(&self) -> usize {
        self.joints.len()
    }
}
