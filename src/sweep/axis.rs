//! One axis of a space: a list or a range of values of one setting.

use anyhow::{Context, Result, anyhow, bail, ensure};
use rand::Rng;
use serde::Deserialize;
use toml::{Table, Value};

use crate::run::one_line;

/// A setting and its values.
#[derive(Clone, Debug, PartialEq)]
pub struct Axis {
    /// Dotted key in the run's table.
    pub key: String,
    /// Values of the key.
    pub values: Values,
    /// Values of other keys under which this one is set; for a list, any of its values.
    pub when: Vec<(String, Value)>,
}

/// Values of a setting.
#[derive(Clone, Debug, PartialEq)]
pub enum Values {
    /// The listed values.
    List(Vec<Value>),
    /// A range, both ends included.
    Range {
        /// Ends of the range.
        ends: (f64, f64),
        /// Whether the range is logarithmic.
        log: bool,
        /// Whether values are integers.
        integer: bool,
        /// Number of values in a grid.
        points: Option<usize>,
    },
}

/// An axis in the form of a table.
#[derive(Deserialize)]
#[serde(deny_unknown_fields)]
struct File {
    values: Option<Vec<Value>>,
    linear: Option<[f64; 2]>,
    log: Option<[f64; 2]>,
    integer: Option<[i64; 2]>,
    log_integer: Option<[i64; 2]>,
    points: Option<usize>,
    #[serde(default)]
    when: Table,
}

/// Keys that mark a table as an axis rather than a table of axes.
const KINDS: [&str; 5] = ["values", "linear", "log", "integer", "log_integer"];

/// Returns the axes of a table; keys of nested tables are dotted.
pub fn axes_of(table: &Table) -> Result<Vec<Axis>> {
    let mut axes = Vec::new();
    gather("", table, &mut axes)?;
    axes.sort_by(|a, b| a.key.cmp(&b.key));
    let twice = axes.windows(2).find(|pair| pair[0].key == pair[1].key);
    ensure!(twice.is_none(), "axes: `{}` is there twice", twice.map_or("", |pair| &pair[0].key));
    Ok(axes)
}

fn gather(path: &str, table: &Table, axes: &mut Vec<Axis>) -> Result<()> {
    for (key, value) in table {
        let full = if path.is_empty() { key.clone() } else { format!("{path}.{key}") };
        match value {
            Value::Array(values) => axes.push(Axis::new(full, Values::List(values.clone()), Vec::new())?),
            Value::Table(inner) if KINDS.iter().any(|kind| inner.contains_key(*kind)) => {
                axes.push(Axis::from_table(full, inner)?);
            }
            Value::Table(inner) => gather(&full, inner, axes)?,
            _ => bail!("axes: `{full}` must be a list or a range; a fixed value belongs into [run]"),
        }
    }
    Ok(())
}

impl Axis {
    fn from_table(key: String, table: &Table) -> Result<Self> {
        let file: File = table.clone().try_into().map_err(|error| anyhow!("axes: `{key}`: {}", one_line(&error)))?;
        let File { values, linear, log, integer, log_integer, points, when } = file;
        let whole = |ends: [i64; 2]| (ends[0] as f64, ends[1] as f64);
        let range = |ends: (f64, f64), log: bool, integer: bool| Values::Range { ends, log, integer, points };
        let mut given = [
            values.map(Values::List),
            linear.map(|ends| range(ends.into(), false, false)),
            log.map(|ends| range(ends.into(), true, false)),
            integer.map(|ends| range(whole(ends), false, true)),
            log_integer.map(|ends| range(whole(ends), true, true)),
        ]
        .into_iter()
        .flatten();
        let (Some(values), None) = (given.next(), given.next()) else {
            bail!("axes: `{key}`: give one of {}", KINDS.join(", "));
        };
        Self::new(key, values, flat("", &when))
    }

    fn new(key: String, values: Values, when: Vec<(String, Value)>) -> Result<Self> {
        match &values {
            Values::List(list) => ensure!(!list.is_empty(), "axes: `{key}` has no values"),
            Values::Range { ends: (low, high), log, points, .. } => {
                ensure!(
                    low.is_finite() && high.is_finite() && low < high,
                    "axes: `{key}`: a range goes from a number to a larger one"
                );
                ensure!(!log || *low > 0.0, "axes: `{key}`: a logarithmic range begins above 0");
                let points = points.unwrap_or(2);
                ensure!(
                    (2..=10_000).contains(&points),
                    "axes: `{key}`: points = {points}, but it must be in 2..=10000"
                );
            }
        }
        Ok(Self { key, values, when })
    }

    /// Returns the values of a grid.
    ///
    /// # Errors
    /// For a range without `points`.
    pub fn grid(&self) -> Result<Vec<Value>> {
        match &self.values {
            Values::List(values) => Ok(values.clone()),
            Values::Range { points, .. } => {
                let points =
                    points.with_context(|| format!("axes: `{}`: a grid needs `points` of a range", self.key))?;
                let mut values: Vec<Value> =
                    (0..points).map(|index| self.at(index as f64 / (points - 1) as f64)).collect();
                values.dedup();
                Ok(values)
            }
        }
    }

    /// Draws a value uniformly.
    pub fn draw(&self, random: &mut impl Rng) -> Value {
        let uniform = (random.next_u64() >> 11) as f64 / (1_u64 << 53) as f64;
        match &self.values {
            Values::List(values) => values[(uniform * values.len() as f64) as usize].clone(),
            Values::Range { .. } => self.at(uniform),
        }
    }

    /// Returns the value at a position in `[0, 1]` of a range; each integer covers an interval of length 1
    /// around it.
    pub fn at(&self, place: f64) -> Value {
        let Values::Range { ends: (low, high), log, integer, .. } = self.values else { return Value::Boolean(false) };
        let (low, high) = if integer { (low - 0.5, high + 0.5) } else { (low, high) };
        let value = if log { low * (high / low).powf(place) } else { low + (high - low) * place };
        if integer {
            return Value::Integer(value.round().clamp(low + 0.5, high - 0.5) as i64);
        }
        // Six digits: names and files stay short, and no setting needs more.
        Value::Float(format!("{value:.5e}").parse().unwrap_or(value))
    }

    /// Returns the position in `[0, 1]` of a value of a range, or the index of one of a list.
    pub fn place(&self, value: &Value) -> Option<f64> {
        match &self.values {
            Values::List(values) => values.iter().position(|known| known == value).map(|index| index as f64),
            Values::Range { ends: (low, high), log, integer, .. } => {
                let value = value.as_float().or_else(|| value.as_integer().map(|whole| whole as f64))?;
                let (low, high) = if *integer { (low - 0.5, high + 0.5) } else { (*low, *high) };
                let place = if *log { (value / low).ln() / (high / low).ln() } else { (value - low) / (high - low) };
                Some(place.clamp(0.0, 1.0))
            }
        }
    }
}

/// Returns a table's values by dotted keys.
fn flat(path: &str, table: &Table) -> Vec<(String, Value)> {
    let join = |key: &str| if path.is_empty() { key.to_owned() } else { format!("{path}.{key}") };
    let mut values = Vec::new();
    for (key, value) in table {
        match value {
            Value::Table(inner) => values.extend(flat(&join(key), inner)),
            value => values.push((join(key), value.clone())),
        }
    }
    values
}

#[cfg(test)]
mod tests {
    use rand::SeedableRng;
    use rand::rngs::ChaCha8Rng;

    use super::*;

    fn axes(text: &str) -> Vec<Axis> {
        axes_of(&text.parse().unwrap()).unwrap()
    }

    #[test]
    fn dotted_keys_are_axes_with_or_without_quotes() {
        let keys = |text: &str| axes(text).into_iter().map(|axis| axis.key).collect::<Vec<_>>();
        assert_eq!(
            keys("head.bins = [4]\n\"head.mode\" = ['coupled']\nrate = { log = [1, 2] }"),
            ["head.bins", "head.mode", "rate"]
        );
        assert!(axes_of(&"head.bins = [4]\n\"head.bins\" = [5]".parse().unwrap()).is_err());
        assert!(axes_of(&"steps = 4".parse().unwrap()).unwrap_err().to_string().contains("[run]"));
    }

    #[test]
    fn grids_include_both_ends() {
        let [axis] = &axes("x = { log = [1e-3, 1e-1], points = 3 }")[..] else { panic!() };
        assert_eq!(axis.grid().unwrap(), [1e-3, 1e-2, 1e-1].map(Value::Float));
        let [axis] = &axes("x = { integer = [2, 5], points = 4 }")[..] else { panic!() };
        assert_eq!(axis.grid().unwrap(), [2, 3, 4, 5].map(Value::Integer));
    }

    #[test]
    fn draws_are_in_range_and_positions_invert() {
        let mut random = ChaCha8Rng::seed_from_u64(1);
        for text in ["x = { linear = [-1, 2] }", "x = { log = [1e-3, 1] }", "x = { log_integer = [4, 64] }"] {
            let [axis] = &axes(text)[..] else { panic!() };
            for _ in 0..100 {
                let value = axis.draw(&mut random);
                let again = axis.at(axis.place(&value).unwrap());
                let number = |value: &Value| value.as_float().unwrap_or_else(|| value.as_integer().unwrap() as f64);
                let (value, again) = (number(&value), number(&again));
                assert!(
                    (-1.0..=64.0).contains(&value) && (value - again).abs() <= 2e-5 * value.abs().max(1.0),
                    "{text}: {value} {again}"
                );
            }
        }
    }
}
