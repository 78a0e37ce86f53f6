//! Lines of shared-exponent pixels (Ward 1991): flat, and in Radiance's old and new run-length coding.

/// Widths that the new coding supports.
const CODED_WIDTHS: std::ops::RangeInclusive<usize> = 8..=32_767;

const TOO_SHORT: &str = "the file ends too early";

/// Decodes the next line of a file; the error is a clause.
pub(super) fn read_line(rest: &mut &[u8], line: &mut [[u8; 4]]) -> Result<(), String> {
    let length = line.len();
    match rest {
        [2, 2, high @ 0..=127, low, ..] if CODED_WIDTHS.contains(&length) => {
            let stated = usize::from(*high) << 8 | usize::from(*low);
            if stated != length {
                return Err(format!("a line of {stated} pixels is in an image of {length}"));
            }
            *rest = &rest[4..];
            (0..4).try_for_each(|component| read_component(rest, line, component))
        }
        _ => read_pixels(rest, line),
    }
}

/// Reads one component of all pixels in the new coding: counts above 128 are runs of one byte, others
/// are numbers of literal bytes.
fn read_component(rest: &mut &[u8], line: &mut [[u8; 4]], component: usize) -> Result<(), String> {
    let mut filled = 0;
    while filled < line.len() {
        let (&count, after) = rest.split_first().ok_or(TOO_SHORT)?;
        let (count, is_run) = if count > 128 { (usize::from(count - 128), true) } else { (usize::from(count), false) };
        let Some(pixels) = line.get_mut(filled..filled + count).filter(|pixels| !pixels.is_empty()) else {
            return Err(format!("a run of {count} does not fit into its line"));
        };
        let taken = if is_run { 1 } else { count };
        let values = after.get(..taken).ok_or(TOO_SHORT)?;
        for (k, pixel) in pixels.iter_mut().enumerate() {
            pixel[component] = values[if is_run { 0 } else { k }];
        }
        filled += count;
        *rest = &after[taken..];
    }
    Ok(())
}

/// Reads pixels of the old coding: `1 1 1 n` repeats the last pixel n times, a second one in a row
/// `n << 8` times, and so on.
fn read_pixels(rest: &mut &[u8], line: &mut [[u8; 4]]) -> Result<(), String> {
    let (mut filled, mut shift) = (0, 0);
    while filled < line.len() {
        let (&pixel, after) = rest.split_first_chunk::<4>().ok_or(TOO_SHORT)?;
        *rest = after;
        let [1, 1, 1, count] = pixel else {
            line[filled] = pixel;
            (filled, shift) = (filled + 1, 0);
            continue;
        };
        let fits = |&count: &usize| count <= line.len() - filled;
        let count = (u64::from(count)).checked_shl(shift).and_then(|count| usize::try_from(count).ok()).filter(fits);
        let (Some(count), Some(&last)) = (count, line[..filled].last()) else {
            return Err("a run does not fit into its line".into());
        };
        line[filled..filled + count].fill(last);
        (filled, shift) = (filled + count, shift + 8);
    }
    Ok(())
}

/// Decodes a pixel.
pub(super) fn to_linear([r, g, b, exponent]: [u8; 4]) -> [f32; 3] {
    if exponent == 0 {
        return [0.0; 3];
    }
    let unit = (f32::from(exponent) - 136.0).exp2();
    [r, g, b].map(|mantissa| unit * f32::from(mantissa))
}

#[cfg(test)]
mod tests {
    use super::*;

    fn lines(mut bytes: &[u8], length: usize) -> Result<Vec<[u8; 4]>, String> {
        let mut line = vec![[0; 4]; length];
        read_line(&mut bytes, &mut line)?;
        assert!(bytes.is_empty(), "{} bytes are left", bytes.len());
        Ok(line)
    }

    #[test]
    fn narrow_lines_are_never_in_the_new_coding() {
        let pixels = [[2, 2, 0, 6], [7, 8, 9, 10], [2, 2, 0, 6], [1, 2, 3, 4], [2, 2, 0, 6], [5, 5, 5, 5]];
        assert_eq!(lines(pixels.as_flattened(), 6).unwrap(), pixels);
    }

    #[test]
    fn runs_of_the_old_coding_grow_by_256() {
        let mut bytes = vec![9, 8, 7, 130];
        bytes.extend([1, 1, 1, 3, 1, 1, 1, 1]);
        assert_eq!(lines(&bytes, 1 + 3 + 256).unwrap(), vec![[9, 8, 7, 130]; 260]);
        // An empty run still counts as a run.
        bytes[7] = 0;
        assert_eq!(lines(&bytes, 257).unwrap().len(), 257);
    }

    #[test]
    fn runs_beyond_a_line_are_rejected() {
        let old = |runs: usize| [[9, 8, 7, 130]].into_iter().chain(std::iter::repeat_n([1, 1, 1, 255], runs));
        for runs in [1, 2, 5, 9, 20] {
            let bytes: Vec<[u8; 4]> = old(runs).collect();
            assert!(lines(bytes.as_flattened(), 100).unwrap_err().contains("run"));
        }
        assert!(lines(&[1, 1, 1, 2], 4).unwrap_err().contains("run"), "there is nothing to repeat");
        assert!(lines(&[2, 2, 0, 8, 128 + 9, 1], 8).unwrap_err().contains("run of 9"));
        assert!(lines(&[2, 2, 0, 8, 0], 8).unwrap_err().contains("run of 0"));
        assert!(lines(&[2, 2, 0, 9, 128 + 8, 1], 8).unwrap_err().contains("a line of 9 pixels is in an image of 8"));
        assert!(lines(&[2, 2, 0, 8, 128 + 8], 8).unwrap_err().contains("ends too early"));
    }
}
