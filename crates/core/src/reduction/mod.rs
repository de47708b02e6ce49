//! Reduction of rows to triangles: FIR filter with decimation, and R factors per motor and time block.

pub(crate) mod dense;
pub(crate) mod fir;
pub(crate) mod reduce;
mod reducer;
