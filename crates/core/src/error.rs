//! Errors: arguments that the core refuses.

use std::fmt;

/// An invalid argument. Numerical outcomes (a singular mass matrix, a pose that cannot be assembled) are values, not
/// errors.
#[derive(Debug, Clone, PartialEq)]
pub enum Error {
    /// A slice whose length does not fit the other arguments.
    Length {
        /// The argument.
        name: &'static str,
        /// Its length.
        got: usize,
        /// The length required.
        wanted: usize,
    },
    /// An index out of range.
    Index {
        /// What the index refers to.
        name: &'static str,
        /// The index.
        got: usize,
        /// It must be below this.
        limit: usize,
    },
    /// An index that occurs twice where it may occur once.
    Repeated {
        /// What the index refers to.
        name: &'static str,
        /// The index.
        got: usize,
    },
    /// A number that is not finite, or outside its range.
    Value {
        /// The argument.
        name: &'static str,
        /// The number.
        got: f64,
        /// The range, in words.
        wanted: &'static str,
    },
    /// Output rows that the filter cannot compute from the samples available.
    Window {
        /// Sample at the centre of the first row.
        first: usize,
        /// Number of rows.
        rows: usize,
        /// Samples on either side of a row's centre.
        half: usize,
        /// Samples from one row to the next.
        decimation: usize,
        /// Number of samples.
        samples: usize,
    },
    /// A back end that this machine does not have.
    Backend {
        /// Its name.
        name: String,
    },
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

/// Check the length of a slice.
pub(crate) fn expect_length(name: &'static str, got: usize, wanted: usize) -> Result<(), Error> {
    if got == wanted { Ok(()) } else { Err(Error::Length { name, got, wanted }) }
}
