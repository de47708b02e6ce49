//! Joint shapes: special cases of a joint's geometry that the kernels are specialised for.

use crate::mechanism::Joint;

/// Special cases of the constant rotation between links, in which multiplications by 0 and 1 are skipped.
#[derive(Debug, Clone, Copy, PartialEq)]
pub(crate) enum Rotation {
    Identity,
    /// The child's y is the parent's z.
    AboutX,
    /// The child's y is the parent's -z.
    AboutMinusX,
    General,
}

/// Type of a joint.
#[derive(Debug, Clone, Copy, PartialEq)]
pub(crate) enum JointType {
    /// Revolute, with the axis through the parent's origin.
    RevoluteInPlace,
    /// Revolute, with the axis away from the parent's origin.
    Revolute,
    Prismatic,
}

/// What the kernels know of a joint before they see a sample.
#[derive(Debug, Clone, Copy, PartialEq)]
pub(crate) struct JointShape {
    pub rotation: Rotation,
    pub joint_type: JointType,
}

/// Evaluate an expression with the shape as a compile-time constant: it is compiled once for every shape.
macro_rules! for_shape {
    ($shape:expr, $name:ident => $body:expr) => {
        $crate::mechanism::shape::for_case!($shape.rotation, [Rotation::Identity, Rotation::AboutX, Rotation::AboutMinusX, Rotation::General], rotation =>
            $crate::mechanism::shape::for_case!($shape.joint_type, [JointType::RevoluteInPlace, JointType::Revolute, JointType::Prismatic], joint_type => {
                let $name = $crate::mechanism::shape::JointShape { rotation, joint_type };
                $body
            })
        )
    };
}
pub(crate) use for_shape;

macro_rules! for_case {
    ($value:expr, [$($kind:ident::$case:ident),*], $name:ident => $body:expr) => {
        match $value {
            $($crate::mechanism::shape::$kind::$case => {
                let $name = $crate::mechanism::shape::$kind::$case;
                $body
            })*
        }
    };
}
pub(crate) use for_case;

impl Rotation {
    pub(crate) fn of(inverse: &[f64; 9]) -> Rotation {
        // The bound is far below any effect on a torque and above the rounding of cos(pi/2).
        let is = |wanted: [f64; 9]| inverse.iter().zip(wanted).all(|(x, y)| (x - y).abs() < 1e-15);
        if is([1., 0., 0., 0., 1., 0., 0., 0., 1.]) {
            Rotation::Identity
        } else if is([1., 0., 0., 0., 0., 1., 0., -1., 0.]) {
            Rotation::AboutX
        } else if is([1., 0., 0., 0., 0., -1., 0., 1., 0.]) {
            Rotation::AboutMinusX
        } else {
            Rotation::General
        }
    }
}

impl JointType {
    pub(crate) fn of(joint: &Joint) -> JointType {
        match joint.prismatic {
            true => JointType::Prismatic,
            false if joint.translation == [0.0; 3] => JointType::RevoluteInPlace,
            false => JointType::Revolute,
        }
    }
}
