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
pub struct Cut {
    pub prismatic: bool,
    pub frame: Frame,
    pub twin: Frame,
}

impl Cut {
    pub(crate) fn gaps(&self) -> usize {
        if self.prismatic { 8 } else { 6 }
    }
}

/// A tree and the joints cut out of its loops.
#[derive(Debug, Clone)]
pub struct Loops {
    pub(crate) joints: Vec<Joint>,
    pub(crate) cuts: Vec<Cut>,
    pub(crate) size: f64,
    /// Where each joint stands on its parent, and each cut's frame and twin on their links.
    pub(crate) stands: Vec<Placement>,
    pub(crate) cut_stands: Vec<[Placement; 2]>,
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
}
