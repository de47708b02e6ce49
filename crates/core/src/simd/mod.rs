//! SIMD: lanes of samples, their back ends and the choice between them, elementary functions, and real numbers in
//! lanes.

pub(crate) mod dispatch;
pub(crate) mod elementary;
pub(crate) mod inlined;
pub(crate) mod lane;
pub(crate) mod portable;
pub(crate) mod real;
pub(crate) mod token;
#[cfg(target_arch = "x86_64")]
pub(crate) mod x86;
