//! Parsing of the heads of generated blocks.

use anyhow::{Context, Result, ensure};
use headtail_eval::summary::Comparison;

/// The head of a block: `KIND EXPERIMENT key=value ...`.
#[derive(Debug)]
pub struct Block {
    /// Kind of table or chart.
    pub kind: String,
    /// Experiment whose data it shows.
    pub experiment: String,
    settings: Vec<(String, String)>,
}

/// A row of samplers, represented in each view by the best of them.
#[derive(Debug, PartialEq)]
pub struct SamplerSet {
    /// Label of the row.
    pub label: String,
    /// The samplers.
    pub samplers: Vec<String>,
}

/// Keys of all kinds of blocks.
const KEYS: [&str; 14] = [
    "seconds",
    "samples",
    "preparation",
    "samplers",
    "baselines",
    "columns",
    "only",
    "file",
    "full",
    "baseline",
    "rows",
    "command",
    "table",
    "value",
];

impl Block {
    /// Parses the head of a block.
    ///
    /// # Errors
    /// If kind or experiment is missing, or a key is unknown.
    pub fn parse(head: &str) -> Result<Self> {
        let mut words = head.split_whitespace();
        let kind = words.next().context("a block names its kind")?.to_owned();
        let experiment = words.next().context("a block names its experiment")?.to_owned();
        let mut settings = Vec::new();
        for word in words {
            let (key, value) = word.split_once('=').with_context(|| format!("'{word}' is not key=value"))?;
            ensure!(KEYS.contains(&key), "the key '{key}' is unknown; there are {}", KEYS.join(", "));
            settings.push((key.to_owned(), value.to_owned()));
        }
        Ok(Self { kind, experiment, settings })
    }

    /// Returns the value of a key.
    pub fn get(&self, key: &str) -> Option<&str> {
        self.settings.iter().find(|(known, _)| known == key).map(|(_, value)| value.as_str())
    }

    /// Returns the value of a required key.
    ///
    /// # Errors
    /// If it is missing.
    pub fn need(&self, key: &str) -> Result<&str> {
        self.get(key).with_context(|| format!("{}: the key '{key}' is missing", self.kind))
    }

    /// Returns the names under a key, which commas separate.
    pub fn names(&self, key: &str) -> Vec<String> {
        self.get(key).map_or(Vec::new(), |value| value.split(',').map(str::to_owned).collect())
    }

    /// Parses the rows of samplers: `patches,best-of-ours=patches|direct`.
    pub fn sampler_sets(&self) -> Vec<SamplerSet> {
        let set = |text: String| match text.split_once('=') {
            None => SamplerSet { label: format!("`{text}`"), samplers: vec![text] },
            Some((label, names)) => {
                SamplerSet { label: label.replace('-', " "), samplers: names.split('|').map(str::to_owned).collect() }
            }
        };
        self.names("samplers").into_iter().map(set).collect()
    }

    /// Returns the cost at which samplers are compared: `seconds=1`, with `preparation=no` to exclude
    /// preparation, or `samples=16spp`.
    ///
    /// # Errors
    /// If neither is given.
    pub fn comparison(&self) -> Result<Comparison> {
        if let Some(samples) = self.get("samples") {
            return Ok(Comparison::Samples(samples.to_owned()));
        }
        let seconds = self.need("seconds")?.parse().context("seconds")?;
        Ok(Comparison::Time { seconds, counts_preparation: self.get("preparation") != Some("no") })
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn block_heads_are_parsed() {
        let block =
            Block::parse("ratios equal-time seconds=1 baselines=mis,mis2 samplers=patches,best-of-ours=patches|direct")
                .unwrap();
        assert_eq!((&*block.kind, &*block.experiment, block.names("baselines").len()), ("ratios", "equal-time", 2));
        let sets = block.sampler_sets();
        assert_eq!((&*sets[0].label, &*sets[1].label, sets[1].samplers.len()), ("`patches`", "best of ours", 2));
        assert!(Block::parse("ratios equal-time second=1").is_err() && Block::parse("ratios").is_err());
    }
}
