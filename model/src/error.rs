//! Errors of the model crate.

/// What can be wrong with a head's configuration or its weights.
#[derive(Clone, Debug, PartialEq, Eq, thiserror::Error)]
pub enum Error {
    /// A field of the configuration is out of range.
    #[error("head configuration: {field} = {value}, but it must be {requirement}")]
    Config {
        /// The field's name.
        field: &'static str,
        /// Its value.
        value: String,
        /// The range it must lie in.
        requirement: &'static str,
    },
    /// A weight that the architecture has is missing.
    #[error("the weight `{0}` is missing")]
    MissingWeight(String),
    /// A weight that the architecture does not have.
    #[error("the weight `{0}` does not belong to this architecture")]
    UnknownWeight(String),
    /// A weight of the wrong shape.
    #[error("the weight `{name}` has shape {found:?} and {values} values, expected shape {expected:?}")]
    WeightShape {
        /// The weight's name.
        name: String,
        /// The shape that the architecture asks for.
        expected: Vec<usize>,
        /// The shape given.
        found: Vec<usize>,
        /// The number of values given.
        values: usize,
    },
    /// A weight holds an infinity or NaN.
    #[error("the weight `{0}` has a value that is not finite")]
    NonFiniteWeight(String),
}

/// The crate's result.
pub type Result<T> = std::result::Result<T, Error>;

/// Checks that a field of a configuration is in its range.
///
/// # Errors
/// [`Error::Config`] if it is not.
pub fn within<T: Copy + PartialOrd + std::fmt::Display>(
    field: &'static str,
    value: T,
    range: std::ops::RangeInclusive<T>,
    requirement: &'static str,
) -> Result<()> {
    if range.contains(&value) { Ok(()) } else { Err(Error::Config { field, value: value.to_string(), requirement }) }
}
