//! x
use super::Model;
pub fn model() -> Model {
    super::simple::plane()
}
