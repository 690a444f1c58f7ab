//! The command line of `vitreo score`.

use outputs::Force;
use std::path::PathBuf;

/// Arguments of `vitreo score`.
#[derive(Debug, clap::Args)]
pub struct ScoreArgs {
    /// The recordings; of a folder every *.mcap in it and below. Also in an object store:
    /// s3://BUCKET/KEY.mcap, or all below s3://BUCKET/PREFIX/.
    #[arg(value_name = "FILE.mcap|DIR", required_unless_present_any = ["doc", "manifest", "gather"])]
    pub files: Vec<PathBuf>,
    /// What only batches have.
    #[command(flatten)]
    pub batch: BatchArgs,
    /// Let the simulation do every step again from the recorded poses and handles, and score what
    /// comes of it.
    #[arg(long)]
    pub resimulate: bool,
    /// One line of JSON for each recording.
    #[arg(long, conflicts_with_all = ["out", "csv", "parquet", "gather", "doc"])]
    pub json: bool,
    /// Print docs/score.md, which is made from the table of metrics.
    #[arg(long, conflicts_with = "files")]
    pub doc: bool,
}

/// Arguments of a batch.
#[derive(Debug, Clone, Default, clap::Args)]
pub struct BatchArgs {
    /// Score the recordings that a file lists, one path or address a line, from the file's folder on.
    #[arg(long, value_name = "FILE")]
    pub manifest: Option<PathBuf>,
    /// Score only this machine's share: part I of N, counted from 0.
    #[arg(long, value_name = "I/N", value_parser = shard, conflicts_with = "gather")]
    pub shard: Option<[u32; 2]>,
    /// Write the scores as Parquet into this folder or below this address, one table for each shard.
    #[arg(long, value_name = "DIR", conflicts_with = "gather")]
    pub out: Option<PathBuf>,
    /// Leave a shard alone whose table is there and whole; do one again whose table is truncated.
    #[arg(long, requires = "out")]
    pub resume: bool,
    /// Put the shards' tables in this folder or below this address together, instead of scoring;
    /// each that is missing or damaged is named, and nothing is written.
    #[arg(long, value_name = "DIR", conflicts_with = "resimulate")]
    pub gather: Option<PathBuf>,
    /// Write the scores as comma-separated values; - is standard output.
    #[arg(long, value_name = "FILE.csv")]
    pub csv: Option<PathBuf>,
    /// Write the scores as one Parquet file.
    #[arg(long, value_name = "FILE.parquet")]
    pub parquet: Option<PathBuf>,
    /// Recordings scored at the same time [default: as many as there are processors].
    #[arg(long, value_name = "N", value_parser = clap::value_parser!(u32).range(1..=4096))]
    pub jobs: Option<u32>,
    /// Whether tables that exist are written over.
    #[command(flatten)]
    pub force: Force,
}

/// `I/N`: a part and how many there are.
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
