//! What can be wrong with the numbers a caller hands to the core.

use std::fmt;

/// A misuse of the core. Numerical outcomes are values, not errors.
#[derive(Debug, Clone, PartialEq)]
pub enum Error {
    /// A slice whose length does not fit the other arguments.
    Length { name: &'static str, got: usize, wanted: usize },
    /// An index outside what it points into.
    Index { name: &'static str, got: usize, limit: usize },
    /// An index that stands twice where each may stand once.
    Repeated { name: &'static str, got: usize },
    /// A number that must be finite, or inside a range, and is not.
    Value { name: &'static str, got: f64, wanted: &'static str },
    /// Rows asked for that the filter cannot make from the samples given.
    Window { first: usize, rows: usize, half: usize, decimation: usize, samples: usize },
    /// A backend that this machine does not have.
    Backend { name: String },
}

impl fmt::Display for Error {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        match self {
            Error::Length { name, got, wanted } => write!(f, "{name} has length {got}, wanted {wanted}"),
            Error::Index { name, got, limit } => write!(f, "{name} is {got}, and must be below {limit}"),
            Error::Repeated { name, got } => write!(f, "{name} {got} is given twice"),
            Error::Value { name, got, wanted } => write!(f, "{name} is {got}, wanted {wanted}"),
            Error::Window { first, rows, half, decimation, samples } => write!(
                f,
                "{rows} rows from sample {first}, every {decimation} samples and {half} to either side, do not fit into \
                 {samples} samples"
            ),
            Error::Backend { name } => write!(f, "this machine has no backend {name:?}"),
        }
    }
}

impl std::error::Error for Error {}

/// The slice has the length wanted, or an error that names it.
pub(crate) fn expect_length(name: &'static str, got: usize, wanted: usize) -> Result<(), Error> {
    if got == wanted { Ok(()) } else { Err(Error::Length { name, got, wanted }) }
}
