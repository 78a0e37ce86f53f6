//! Conversion of colours of other primaries to linear Rec.709.

use glam::{DMat3, DVec3};

/// The colour space of linear RGB values, as CIE 1931 xy chromaticities.
#[derive(Clone, Copy, Debug, PartialEq)]
pub(super) struct Primaries {
    /// Red, green and blue.
    pub colors: [[f64; 2]; 3],
    /// The white of equal values.
    pub white: [f64; 2],
}

/// Chromaticities that differ by less are equal: headers are written with three digits.
const TOLERANCE: f64 = 1e-3;

/// The white of equal energy, as in Radiance.
const EQUAL_ENERGY: [f64; 2] = [1.0 / 3.0, 1.0 / 3.0];

impl Primaries {
    /// Rec.709, which is also sRGB.
    pub const REC_709: Self = Self { colors: [[0.64, 0.33], [0.3, 0.6], [0.15, 0.06]], white: [0.3127, 0.3290] };

    /// ITU-R BT.2020.
    #[cfg(feature = "exr")]
    pub const REC_2020: Self =
        Self { colors: [[0.708, 0.292], [0.17, 0.797], [0.131, 0.046]], white: Self::REC_709.white };

    /// DCI-P3 with the white of Rec.709.
    #[cfg(feature = "exr")]
    pub const P3_D65: Self = Self { colors: [[0.68, 0.32], [0.265, 0.69], [0.15, 0.06]], white: Self::REC_709.white };

    /// Adobe RGB (1998).
    #[cfg(feature = "exr")]
    pub const ADOBE_RGB: Self = Self { colors: [[0.64, 0.33], [0.21, 0.71], [0.15, 0.06]], white: Self::REC_709.white };

    /// ACES2065-1, the primaries AP0.
    #[cfg(feature = "exr")]
    pub const ACES_2065_1: Self =
        Self { colors: [[0.7347, 0.2653], [0.0, 1.0], [0.0001, -0.077]], white: [0.32168, 0.33767] };

    /// ACEScg, the primaries AP1.
    #[cfg(any(feature = "exr", test))]
    pub const ACES_CG: Self =
        Self { colors: [[0.713, 0.293], [0.165, 0.83], [0.128, 0.044]], white: [0.32168, 0.33767] };

    /// The primaries of XYZ.
    pub const XYZ: Self = Self { colors: [[1.0, 0.0], [0.0, 1.0], [0.0, 0.0]], white: EQUAL_ENERGY };

    /// Whether two headers mean the same primaries.
    pub fn is_near(&self, other: &Self) -> bool {
        let numbers = |p: &Self| [p.colors[0], p.colors[1], p.colors[2], p.white].concat();
        numbers(self).iter().zip(numbers(other)).all(|(a, b)| (a - b).abs() < TOLERANCE)
    }

    /// The matrix to linear Rec.709; `None` if no conversion is needed.
    ///
    /// White stays white: different whites are adapted by the Bradford method (Lam 1985), as in colour
    /// management. The primaries of XYZ are not a colour space with a white, and are not adapted.
    ///
    /// The error is a clause that follows the name of the header's field.
    pub fn to_rec_709(self) -> Result<Option<DMat3>, String> {
        if self.is_near(&Self::REC_709) {
            return Ok(None);
        }
        let adaptation = if self.is_near(&Self::XYZ) { Some(DMat3::IDENTITY) } else { adaptation(self.white) };
        let matrix =
            adaptation.and_then(|adaptation| Some(invert(Self::REC_709.to_xyz()?)? * adaptation * self.to_xyz()?));
        matrix.filter(DMat3::is_finite).map(Some).ok_or_else(|| {
            let [[rx, ry], [gx, gy], [bx, by]] = self.colors;
            let [wx, wy] = self.white;
            format!("{rx},{ry} {gx},{gy} {bx},{by} with white {wx},{wy} are not valid primaries")
        })
    }

    /// The luminance of red, green and blue, whose sum is 1; `None` for invalid primaries.
    #[cfg(feature = "exr")]
    pub fn luminance(self) -> Option<DVec3> {
        let weights = self.to_xyz()?.row(1);
        Some(weights / weights.element_sum()).filter(|weights| weights.is_finite() && weights.y.abs() > 1e-9)
    }

    /// The matrix from RGB to XYZ: equal values of 1 are the white of luminance 1.
    fn to_xyz(self) -> Option<DMat3> {
        let colors = DMat3::from_cols_array_2d(&self.colors.map(|[x, y]| [x, y, 1.0 - x - y]));
        let scale = invert(colors)? * xyz_of(self.white)?;
        Some(colors * DMat3::from_diagonal(scale))
    }
}

/// The matrix that adapts tristimulus values from a white to that of Rec.709.
fn adaptation(white: [f64; 2]) -> Option<DMat3> {
    // From XYZ to sharpened cone responses.
    const BRADFORD: DMat3 = DMat3::from_cols_array(&[
        0.8951, -0.7502, 0.0389, //
        0.2664, 1.7135, -0.0685, //
        -0.1614, 0.0367, 1.0296,
    ]);
    let (from, to) = (BRADFORD * xyz_of(white)?, BRADFORD * xyz_of(Primaries::REC_709.white)?);
    Some(invert(BRADFORD)? * DMat3::from_diagonal(to / from) * BRADFORD)
}

/// Tristimulus values of luminance 1.
fn xyz_of([x, y]: [f64; 2]) -> Option<DVec3> {
    (y > 0.0).then(|| DVec3::new(x / y, 1.0, (1.0 - x - y) / y)).filter(|xyz| xyz.is_finite())
}

fn invert(matrix: DMat3) -> Option<DMat3> {
    (matrix.determinant().abs() > 1e-9).then(|| matrix.inverse())
}

/// The matrix from tristimulus values of Radiance files, whose white is that of equal energy.
pub(super) fn radiance_xyz_to_rec_709() -> Option<DMat3> {
    Some(invert(Primaries::REC_709.to_xyz()?)? * adaptation(EQUAL_ENERGY)?)
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn rec_709_is_not_converted() {
        assert_eq!(Primaries::REC_709.to_rec_709(), Ok(None));
        let rounded = Primaries { white: [0.313, 0.329], ..Primaries::REC_709 };
        assert_eq!(rounded.to_rec_709(), Ok(None));
    }

    #[test]
    fn white_stays_white() {
        let matrix = Primaries::ACES_CG.to_rec_709().unwrap().unwrap();
        assert!((matrix * DVec3::ONE - DVec3::ONE).abs().max_element() < 1e-6);
        let matrix = radiance_xyz_to_rec_709().unwrap();
        assert!((matrix * DVec3::ONE - DVec3::ONE).abs().max_element() < 1e-6);
    }

    /// The matrix published by the Academy (ACEScg to linear Rec.709 with Bradford adaptation).
    #[test]
    fn aces_cg_gives_the_published_matrix() {
        let matrix = Primaries::ACES_CG.to_rec_709().unwrap().unwrap();
        let published = DMat3::from_cols_array(&[
            1.70505, -0.13026, -0.02400, -0.62179, 1.14080, -0.12897, -0.08326, -0.01055, 1.15297,
        ]);
        // Five digits are published.
        assert!(matrix.abs_diff_eq(published, 2e-5), "{matrix}");
    }

    #[test]
    fn tristimulus_values_are_not_adapted() {
        let matrix = Primaries::XYZ.to_rec_709().unwrap().unwrap();
        let white = xyz_of(Primaries::REC_709.white).unwrap();
        assert!((matrix * white - DVec3::ONE).abs().max_element() < 1e-9);
    }

    #[test]
    fn collinear_primaries_are_rejected() {
        let line = Primaries { colors: [[0.1, 0.1], [0.2, 0.2], [0.3, 0.3]], ..Primaries::REC_709 };
        assert!(line.to_rec_709().unwrap_err().contains("not valid primaries"));
        for white in [[0.3, 0.0], [f64::NAN, 0.3]] {
            assert!(Primaries { white, ..Primaries::ACES_CG }.to_rec_709().is_err());
        }
    }
}
