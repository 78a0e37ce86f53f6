//! Lists of a document whose broken elements matter only where they are used.

use serde::{Deserialize, Deserializer, de::DeserializeOwned};
use serde_json::Value;

/// A list; empty if the document has something else in its place.
pub struct List<T>(Vec<Result<T, String>>);

impl<T> Default for List<T> {
    fn default() -> Self {
        Self(Vec::new())
    }
}

impl<T> List<T> {
    /// Returns the number of elements, broken ones included.
    pub fn len(&self) -> usize {
        self.0.len()
    }

    /// Returns whether there are no elements.
    pub fn is_empty(&self) -> bool {
        self.0.is_empty()
    }

    /// Returns an element, if it exists and can be read.
    pub fn get(&self, index: usize) -> Option<&T> {
        self.0.get(index)?.as_ref().ok()
    }

    /// Returns an element.
    ///
    /// # Errors
    /// A clause that says why there is none.
    pub fn find(&self, index: u64) -> Result<&T, String> {
        match usize::try_from(index).ok().and_then(|index| self.0.get(index)) {
            Some(Ok(element)) => Ok(element),
            Some(Err(error)) => Err(format!("element {index} cannot be read: {error}")),
            None => Err(format!("index {index} is out of range")),
        }
    }

    /// Returns the elements, `None` for broken ones.
    pub fn iter(&self) -> impl DoubleEndedIterator<Item = Option<&T>> + ExactSizeIterator {
        self.0.iter().map(|element| element.as_ref().ok())
    }
}

impl<'de, T: DeserializeOwned> Deserialize<'de> for List<T> {
    fn deserialize<D: Deserializer<'de>>(deserializer: D) -> Result<Self, D::Error> {
        let Value::Array(elements) = Value::deserialize(deserializer)? else { return Ok(Self::default()) };
        Ok(Self(elements.into_iter().map(|own| T::deserialize(own).map_err(|error| error.to_string())).collect()))
    }
}

/// The names of an object's extensions, sorted.
#[derive(Default)]
pub struct Extensions(pub Vec<String>);

impl<'de> Deserialize<'de> for Extensions {
    fn deserialize<D: Deserializer<'de>>(deserializer: D) -> Result<Self, D::Error> {
        let Value::Object(extensions) = Value::deserialize(deserializer)? else { return Ok(Self::default()) };
        let mut names: Vec<String> = extensions.into_iter().map(|(name, _)| name).collect();
        names.sort_unstable();
        Ok(Self(names))
    }
}
