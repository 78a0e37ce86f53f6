//! Errors of the model crate.

/// An invalid head configuration or invalid weights.
#[derive(Clone, Debug, PartialEq, Eq, thiserror::Error)]
#[non_exhaustive]
pub enum Error {
    /// A field of the configuration is out of range.
    #[error("head configuration: {field} = {value}, but it must be {requirement}")]
    Config {
        /// The field's name.
        field: &'static str,
        /// Its value.
        value: String,
        /// The permitted range.
        requirement: &'static str,
    },
    /// A weight of the architecture is missing.
    #[error("the weight `{0}` is missing")]
    MissingWeight(String),
    /// A weight is not part of the architecture.
    #[error("the weight `{0}` does not belong to this architecture")]
    UnknownWeight(String),
    /// A weight has the wrong shape.
    #[error("the weight `{name}` has shape {found:?} and {values} values, expected shape {expected:?}")]
    WeightShape {
        /// The weight's name.
        name: String,
        /// The shape in the architecture.
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

/// The crate's result type.
pub type Result<T> = std::result::Result<T, Error>;

/// Checks that a field of a configuration is in its range.
///
/// # Errors
/// [`Error::Config`] if the value is out of range.
pub fn within<T: Copy + PartialOrd + std::fmt::Display>(
    field: &'static str,
    value: T,
    range: std::ops::RangeInclusive<T>,
    requirement: &'static str,
) -> Result<()> {
    if range.contains(&value) { Ok(()) } else { Err(Error::Config { field, value: value.to_string(), requirement }) }
}
