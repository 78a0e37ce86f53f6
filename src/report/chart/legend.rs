//! The legend below a chart: markers with full names, in columns if names are short.

use super::super::{kind::Look, vector::Drawing};

/// A sampler of a legend.
pub struct Entry<'a> {
    /// Its marker.
    pub look: Look,
    /// Its full name.
    pub name: &'a str,
    /// Whether its name is bold and its marker ringed.
    pub on_front: bool,
}

/// The positions of the entries.
pub struct Legend<'a> {
    entries: Vec<(&'a Entry<'a>, Vec<String>, f64, f64)>,
    /// Its height.
    pub height: f64,
}

impl<'a> Legend<'a> {
    const LINE: f64 = 18.0;
    /// Upper estimate of the width of a letter.
    const LETTER: f64 = 7.4;
    const MARKER: f64 = 20.0;
    /// More entries than this are set in several columns if the names fit.
    const MANY: usize = 12;
    const LETTERS: f64 = 24.0;

    /// Arranges entries in columns that fit a width. Long names take several lines if there are many.
    pub fn new(entries: &'a [Entry<'a>], (left, width): (f64, f64)) -> Self {
        let longest = entries.iter().map(|entry| entry.name.chars().count()).max().unwrap_or(0);
        let widest = longest as f64 * Self::LETTER + Self::MARKER + 14.0;
        let whole = ((width / widest) as usize).clamp(1, entries.len().max(1));
        let broken = (width / (Self::LETTERS * Self::LETTER + Self::MARKER + 14.0)) as usize;
        let columns = if entries.len() > Self::MANY { whole.max(broken) } else { whole };
        let letters = (((width / columns as f64 - Self::MARKER) / Self::LETTER) as usize).max(8);
        let rows = entries.len().div_ceil(columns);
        let mut placed = Vec::new();
        let mut height = 0.0_f64;
        for (column, entries) in entries.chunks(rows.max(1)).enumerate() {
            let mut y = 0.0;
            for entry in entries {
                let lines = wrap(entry.name, letters);
                let below = y + Self::LINE * lines.len() as f64;
                placed.push((entry, lines, left + column as f64 * width / columns as f64, y));
                y = below;
            }
            height = height.max(y);
        }
        Self { entries: placed, height: height + 8.0 }
    }

    /// Draws the legend below `top`.
    pub fn draw(&self, drawing: &mut Drawing, top: f64) {
        for (entry, lines, left, y) in &self.entries {
            let (x, y) = (left + 6.0, top + y + 0.5 * Self::LINE);
            let best = if entry.on_front { " on-front" } else { "" };
            drawing.group(&format!("{}{best}", entry.look.class()), |drawing| {
                if entry.on_front {
                    ring(drawing, x, y);
                }
                drawing.raw(format_args!("{}", entry.look.marker(x, y)));
                for (k, line) in lines.iter().enumerate() {
                    let place = (left + Self::MARKER, y + 4.5 + Self::LINE * k as f64);
                    drawing.text("label", "start", place, line);
                }
            });
        }
    }
}

/// The ring around markers on the front.
pub fn ring(drawing: &mut Drawing, x: f64, y: f64) {
    drawing.raw(format_args!("<circle class=\"ring\" cx=\"{x:.1}\" cy=\"{y:.1}\" r=\"8.5\"/>"));
}

/// Breaks a name into lines of at most `letters` letters, preferably after a slash, colon, comma or space.
pub fn wrap(name: &str, letters: usize) -> Vec<String> {
    let mut rest: Vec<char> = name.chars().collect();
    let mut lines = Vec::new();
    while rest.len() > letters {
        let broken = rest[..letters].iter().rposition(|&c| "/\\:, ".contains(c));
        let length = broken.map_or(letters, |at| at + 1);
        lines.push(rest.drain(..length).collect());
    }
    lines.push(rest.into_iter().collect());
    lines
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn names_of_any_length_are_complete() {
        let long = "head+mis:out/a/very/long/path/to/the/sampler.safetensors";
        for letters in [8, 20, 100] {
            let lines = wrap(long, letters);
            assert_eq!(lines.concat(), long);
            assert!(lines.iter().all(|line| line.chars().count() <= letters));
        }
    }

    #[test]
    fn many_entries_are_set_in_columns() {
        let names: Vec<String> = (0..30).map(|k| format!("a head of {k} bins, after 250 steps")).collect();
        let looks = Look::of_all(names.iter().map(String::as_str));
        let entries: Vec<Entry> =
            names.iter().zip(looks).map(|(name, look)| Entry { look, name, on_front: false }).collect();
        let few = Legend::new(&entries[..12], (0.0, 480.0));
        let all = Legend::new(&entries, (0.0, 480.0));
        assert!(few.entries.iter().all(|entry| entry.2 == 0.0) && all.height < 30.0 * Legend::LINE * 1.1);
        assert_eq!(all.entries.iter().filter(|entry| entry.2 == 0.0).count(), 15);
    }

    #[test]
    fn entries_never_overlap() {
        let names = ["mis", "a/b/c/d/e/f/g/h/i/j/k/l/m/n/o/p/q/r/s/t/u/v/w/x/y/z/and/more/of/it", "ris:4"];
        let looks = Look::of_all(names.into_iter());
        let entries: Vec<Entry> =
            names.iter().zip(looks).map(|(name, look)| Entry { look, name, on_front: false }).collect();
        let legend = Legend::new(&entries, (0.0, 300.0));
        let tops: Vec<f64> = legend.entries.iter().map(|entry| entry.3).collect();
        assert_eq!(legend.entries[1].1.len(), 2);
        assert!(tops[2] - tops[1] >= 2.0 * Legend::LINE && legend.height > tops[2]);
    }
}
