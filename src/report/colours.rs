//! Colour maps for values: dark is low and bright is high, in brightness order also for colour-blind readers.

/// Equally spaced colours of a map.
pub struct Colours(&'static [[u8; 3]]);

/// For densities: matplotlib's "viridis", equally spaced.
pub const DENSITY: Colours = Colours(&[
    [0x44, 0x01, 0x54],
    [0x48, 0x28, 0x78],
    [0x3e, 0x49, 0x89],
    [0x31, 0x68, 0x8e],
    [0x26, 0x82, 0x8e],
    [0x1f, 0x9e, 0x89],
    [0x35, 0xb7, 0x79],
    [0x6e, 0xce, 0x58],
    [0xb5, 0xde, 0x2b],
    [0xfd, 0xe7, 0x25],
]);

/// For errors: matplotlib's "inferno", equally spaced.
pub const ERROR: Colours = Colours(&[
    [0x00, 0x00, 0x04],
    [0x1b, 0x0c, 0x41],
    [0x4a, 0x0c, 0x6b],
    [0x78, 0x1c, 0x6d],
    [0xa5, 0x2c, 0x60],
    [0xcf, 0x44, 0x46],
    [0xed, 0x69, 0x25],
    [0xfb, 0x9b, 0x06],
    [0xf7, 0xd1, 0x3d],
    [0xfc, 0xff, 0xa4],
]);

impl Colours {
    /// Returns the colour at a position in `[0, 1]`; positions outside are clamped.
    pub fn at(&self, place: f64) -> [u8; 3] {
        let place = place.clamp(0.0, 1.0) * (self.0.len() - 1) as f64;
        let below = (place as usize).min(self.0.len() - 2);
        let (a, b, t) = (self.0[below], self.0[below + 1], place - below as f64);
        std::array::from_fn(|c| (f64::from(a[c]) + t * (f64::from(b[c]) - f64::from(a[c]))).round() as u8)
    }

    /// Returns `count` equally spaced colours as a row of pixels.
    pub fn ramp(&self, count: u32) -> Vec<[u8; 3]> {
        (0..count).map(|k| self.at(f64::from(k) / f64::from(count - 1))).collect()
    }

    /// Iterates over CSS colours `#rrggbb` with their positions.
    pub fn stops(&self) -> impl Iterator<Item = (f64, String)> {
        let last = (self.0.len() - 1) as f64;
        self.0.iter().enumerate().map(move |(k, [r, g, b])| (k as f64 / last, format!("#{r:02x}{g:02x}{b:02x}")))
    }

    /// Returns a CSS gradient from left to right.
    pub fn gradient(&self) -> String {
        let colours: Vec<String> = self.stops().map(|(_, colour)| colour).collect();
        format!("linear-gradient(to right,{})", colours.join(","))
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn brightness_increases_along_the_colours() {
        for colours in [DENSITY, ERROR] {
            let brightness = |k: u32| {
                let [r, g, b] = colours.at(f64::from(k) / 90.0).map(f64::from);
                0.2126 * r + 0.7152 * g + 0.0722 * b
            };
            assert!((0..90).all(|k| brightness(k) < brightness(k + 1) + 1.0));
            assert_eq!((colours.at(-1.0), colours.at(f64::INFINITY)), (colours.0[0], colours.0[9]));
        }
    }
}
