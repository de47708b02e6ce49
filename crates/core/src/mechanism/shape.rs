//! Shapes of joints.

use crate::mechanism::Joint;

/// How a constant rotation acts, so that the kernel can skip multiplications by 0 and 1.
#[derive(Debug, Clone, Copy, PartialEq)]
pub(crate) enum Turn {
    Identity,
    /// The child's y is the parent's z.
    AboutX,
    /// The child's y is the parent's -z.
    AboutMinusX,
    General,
}

/// What a joint does beside the constant rotation.
#[derive(Debug, Clone, Copy, PartialEq)]
pub(crate) enum Way {
    /// It turns about an axis through the parent's origin.
    TurnsInPlace,
    /// It turns about an axis away from the parent's origin.
    Turns,
    Slides,
}

/// What the kernels know of a joint before they see a sample.
#[derive(Debug, Clone, Copy, PartialEq)]
pub(crate) struct Shape {
    pub turn: Turn,
    pub way: Way,
}

/// Evaluate an expression with a shape that is a constant in it, so that it is compiled once for every shape.
macro_rules! for_shape {
    ($shape:expr, $name:ident => $body:expr) => {
        $crate::mechanism::shape::for_case!($shape.turn, [Turn::Identity, Turn::AboutX, Turn::AboutMinusX, Turn::General], turn =>
            $crate::mechanism::shape::for_case!($shape.way, [Way::TurnsInPlace, Way::Turns, Way::Slides], way => {
                let $name = $crate::mechanism::shape::Shape { turn, way };
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

impl Turn {
    pub(crate) fn of(inverse: &[f64; 9]) -> Turn {
        // The bound is far below any effect on a torque and above the rounding of cos(pi/2).
        let is = |wanted: [f64; 9]| inverse.iter().zip(wanted).all(|(x, y)| (x - y).abs() < 1e-15);
        if is([1., 0., 0., 0., 1., 0., 0., 0., 1.]) {
            Turn::Identity
        } else if is([1., 0., 0., 0., 0., 1., 0., -1., 0.]) {
            Turn::AboutX
        } else if is([1., 0., 0., 0., 0., -1., 0., 1., 0.]) {
            Turn::AboutMinusX
        } else {
            Turn::General
        }
    }
}

impl Way {
    pub(crate) fn of(joint: &Joint) -> Way {
        match joint.prismatic {
            true => Way::Slides,
            false if joint.translation == [0.0; 3] => Way::TurnsInPlace,
            false => Way::Turns,
        }
    }
}
