//! Remarks on unusual files, for the user who opened them.

use std::fmt;

/// A decision about a file that its user should be told.
#[derive(Clone, Debug, PartialEq, Eq)]
pub enum Remark {
    /// Something was converted or chosen as the file specifies; the result is correct.
    Note(String),
    /// Something in the file changes light or geometry and could not be applied, or had to be repaired.
    Warning(String),
}

impl Remark {
    /// The text, a clause without the name of the file.
    pub fn text(&self) -> &str {
        match self {
            Self::Note(text) | Self::Warning(text) => text,
        }
    }

    /// Whether the result may differ from what the file's author sees.
    pub fn is_warning(&self) -> bool {
        matches!(self, Self::Warning(_))
    }
}

impl fmt::Display for Remark {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        f.write_str(self.text())
    }
}
