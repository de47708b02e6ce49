//! What can be wrong with the numbers a caller hands to the core.

use std::fmt;

/// A misuse of the core. Numerical outcomes are values, not errors.
#[derive(Debug, Clone, PartialEq)]
pub enum Error {
    /// A slice whose length does not fit the other arguments.
    Length { name: &'static str, got: usize, wanted: usize },
    /// An index outside what it points into.
    Index { name: &'static str, got: usize, limit: usize },
    /// A number that must be finite, or inside a range, and is not.
    Value { name: &'static str, got: f64, wanted: &'static str },
    /// Rows asked for that the filter cannot make from the samples given.
    Window { needed_from: i64, needed_to: i64, samples: usize },
    /// A backend that this machine does not have.
    Backend { name: String },
}

impl fmt::Display for Error {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        match self {
            Error::Length { name, got, wanted } => write!(f, "{name} has length {got}, wanted {wanted}"),
            Error::Index { name, got, limit } => write!(f, "{name} is {got}, and must be below {limit}"),
            Error::Value { name, got, wanted } => write!(f, "{name} is {got}, wanted {wanted}"),
            Error::Window { needed_from, needed_to, samples } => {
                write!(f, "the rows asked for need samples {needed_from} to {needed_to}, and there are only {samples}")
            }
            Error::Backend { name } => write!(f, "this machine has no backend {name:?}"),
        }
    }
}

impl std::error::Error for Error {}

/// The slice has the length wanted, or an error that names it.
pub(crate) fn expect_length(name: &'static str, got: usize, wanted: usize) -> Result<(), Error> {
    if got == wanted { Ok(()) } else { Err(Error::Length { name, got, wanted }) }
}
