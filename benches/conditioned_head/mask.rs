//! What may be seen of the sky somewhere, made up: what heads learn from that shall serve scenes which they have not seen.
//!
//! Half of the masks are rooms, in which one to four windows are seen and no more; half are open places, of which one to four things hide a part.
//! Windows and things are caps of the sphere of 5 to 60 degrees, about directions from everywhere.

use glam::Vec3A;
use headtail_render::random::{Purpose, Stream};

/// Windows or things, at most.
const CAPS: usize = 4;
/// The least and the largest half angle of a cap, in degrees.
const HALF_ANGLES: [f32; 2] = [5.0, 60.0];

/// A made up visibility.
#[derive(Clone, Debug)]
pub struct Mask {
    /// The middle of each cap, and the cosine of its half angle.
    caps: Vec<(Vec3A, f32)>,
    is_room: bool,
}

impl Mask {
    /// The mask of a number, and the normal of a point that has it.
    pub fn random(number: u64) -> (Self, Vec3A) {
        let mut stream = Stream::new(number, Purpose::Weights, 0);
        let (normal, middles) = (stream.direction(), [(); CAPS].map(|()| stream.direction()));
        let count = 1 + (stream.uniform() * CAPS as f32) as usize;
        let [least, largest] = HALF_ANGLES;
        let mut angle = || (least * (largest / least).powf(stream.uniform())).to_radians();
        let caps = middles.into_iter().take(count).map(|middle| (middle, angle().cos())).collect();
        (Self { caps, is_room: stream.uniform() < 0.5 }, normal)
    }

    /// Whether the sky is seen there.
    pub fn is_seen(&self, direction: Vec3A) -> bool {
        self.caps.iter().any(|(middle, cosine)| middle.dot(direction) > *cosine) == self.is_room
    }
}
