//! Streams the records of a split in training order, from a directory or a server: a line for each
//! with its cursor, its id and the SHA-256 of its arrays.
//!
//! `stream https://example.org/dataset train --take 100 --threads 2` prints the first hundred;
//! `--cursor 100` goes on where that ended, with any number of threads, also as one of several
//! processes (`--rank 0 --world 2`).

#![allow(clippy::print_stdout, clippy::print_stderr, reason = "an example prints its result")]

use std::num::NonZero;
use std::path::PathBuf;
use std::process::ExitCode;
use std::sync::Arc;

use clap::Parser;
use holescout::config::{OnDamage, RemoteConfig, Split};
use holescout::dataset::{Dataset, Grids, Loader, LoaderOptions, Record, Share};
use holescout::store::sha256_bytes;

#[derive(Debug, Parser)]
struct Arguments {
    /// Directory, http(s):// or s3:// (feature remote)
    location: PathBuf,
    /// train, val or test
    split: Split,
    /// Records to print [default: an epoch]
    #[arg(long)]
    take: Option<usize>,
    /// Where to begin
    #[arg(long, default_value_t = 0)]
    cursor: u64,
    #[arg(long, default_value_t = 0)]
    seed: u64,
    #[arg(long, default_value = "1")]
    threads: NonZero<usize>,
    #[arg(long, default_value_t = 0)]
    rank: u32,
    #[arg(long, default_value = "1")]
    world: NonZero<u32>,
    /// Shards that are shuffled together [default: all]
    #[arg(long)]
    block: Option<NonZero<usize>>,
    /// Leave out what is damaged
    #[arg(long)]
    quarantine: bool,
    /// Directory of downloads
    #[arg(long)]
    cache: Option<PathBuf>,
    #[arg(long, default_value_t = 1000)]
    cache_mb: u32,
    #[arg(long, default_value_t = 8)]
    attempts: u32,
}

fn main() -> ExitCode {
    match stream(Arguments::parse()) {
        Ok(()) => ExitCode::SUCCESS,
        Err(error) => {
            eprintln!("error: {error}");
            ExitCode::FAILURE
        }
    }
}

fn stream(asked: Arguments) -> Result<(), Box<dyn std::error::Error>> {
    let remote = RemoteConfig {
        cache_dir: asked.cache,
        cache_mb: asked.cache_mb,
        attempts: asked.attempts,
        ..RemoteConfig::default()
    };
    let dataset = Arc::new(Dataset::open_with(&asked.location, &remote)?);
    let options = LoaderOptions {
        threads: asked.threads,
        block: asked.block,
        share: Share::of(asked.rank, asked.world).ok_or("--rank must be below --world")?,
        on_damage: if asked.quarantine { OnDamage::Quarantine } else { OnDamage::Error },
        ..LoaderOptions::new(asked.seed)
    };
    let digest = |record: Record, _: Grids| {
        let arrays = [&record.height_m[..], &record.rsrp_dbm, &record.mask].concat();
        (record.id, sha256_bytes(&arrays).sha256)
    };
    let mut loader = Loader::new(&dataset, asked.split, options, asked.cursor, digest)?;
    let epoch = loader.ids().len() / asked.world.get() as usize;
    for _ in 0..asked.take.unwrap_or(epoch) {
        let loaded = loader.next().ok_or("a loader has no end")??;
        let (id, sha256) = loaded.value;
        println!("{} {id} {sha256}", loaded.cursor);
    }
    for (id, reason) in loader.quarantined() {
        eprintln!("left out: {id}: {reason}");
    }
    Ok(())
}
