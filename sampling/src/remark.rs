//! What readers of files decide where a file is unusual, for whoever asked for the file.

use std::fmt;

/// A decision about a file that its user should know of.
#[derive(Clone, Debug, PartialEq, Eq)]
pub enum Remark {
    /// Something was converted or chosen as the file asks for it; the result is right.
    Note(String),
    /// Something in the file changes light or geometry and could not be applied, or had to be repaired.
    Warning(String),
}

impl Remark {
    /// What is to be said, as a clause without the name of the file.
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
