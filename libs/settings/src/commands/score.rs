//! The command line of `vitreo score`.

use outputs::Force;
use std::path::PathBuf;

/// Arguments of `vitreo score`.
#[derive(Debug, clap::Args)]
pub struct ScoreArgs {
    /// Recordings, or folders, searched recursively for *.mcap; also s3://BUCKET/KEY.mcap or
    /// s3://BUCKET/PREFIX/.
    #[arg(value_name = "FILE.mcap|DIR", required_unless_present_any = ["doc", "manifest", "gather"])]
    pub files: Vec<PathBuf>,
    /// Options of batches.
    #[command(flatten)]
    pub batch: BatchArgs,
    /// Simulate the recorded poses and handles again and score the result.
    #[arg(long)]
    pub resimulate: bool,
    /// Print one line of JSON per recording.
    #[arg(long, conflicts_with_all = ["out", "csv", "parquet", "gather", "doc"])]
    pub json: bool,
    /// Print docs/score.md, which is generated from the table of metrics.
    #[arg(long, conflicts_with = "files")]
    pub doc: bool,
}

/// Arguments of a batch.
#[derive(Debug, Clone, Default, clap::Args)]
pub struct BatchArgs {
    /// Score the recordings listed in FILE, one path (relative to FILE's folder) or address per line.
    #[arg(long, value_name = "FILE", help_heading = "Batches")]
    pub manifest: Option<PathBuf>,
    /// Score only shard I of N, counted from 0.
    #[arg(long, value_name = "I/N", value_parser = shard, conflicts_with = "gather", help_heading = "Batches")]
    pub shard: Option<[u32; 2]>,
    /// Write the scores as one Parquet table per shard in this folder or address.
    #[arg(long, value_name = "DIR", conflicts_with = "gather", help_heading = "Batches")]
    pub out: Option<PathBuf>,
    /// Skip shards with a complete table; repeat those with a truncated one.
    #[arg(long, requires = "out", help_heading = "Batches")]
    pub resume: bool,
    /// Join the shards' tables in this folder or address instead of scoring. Missing or damaged tables are
    /// listed, and nothing is written.
    #[arg(long, value_name = "DIR", conflicts_with = "resimulate", help_heading = "Batches")]
    pub gather: Option<PathBuf>,
    /// Write the scores as CSV; - is standard output.
    #[arg(long, value_name = "FILE.csv")]
    pub csv: Option<PathBuf>,
    /// Write the scores as one Parquet file.
    #[arg(long, value_name = "FILE.parquet")]
    pub parquet: Option<PathBuf>,
    /// Recordings to score in parallel [default: one per processor].
    #[arg(long, value_name = "N", value_parser = super::numbers::whole::<u32>(1, 4096))]
    pub jobs: Option<u32>,
    /// `--force`.
    #[command(flatten)]
    pub force: Force,
}

/// Parses `I/N`: index and number of shards.
fn shard(text: &str) -> Result<[u32; 2], String> {
    let numbers = text.split_once('/').and_then(|(i, n)| Some([i.parse().ok()?, n.parse().ok()?]));
    let good = numbers.filter(|[index, count]| index < count);
    good.ok_or_else(|| format!("expected I/N with I from 0 to N - 1, found '{text}'"))
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn a_shard_is_a_part_that_there_is() {
        assert_eq!(shard("0/1"), Ok([0, 1]));
        assert_eq!(shard("3/64"), Ok([3, 64]));
        for wrong in ["", "1", "1/1", "2/1", "-1/2", "a/b", "1/2/3", "0/0", "0/4294967296"] {
            assert!(shard(wrong).is_err(), "{wrong:?} was taken");
        }
    }
}
