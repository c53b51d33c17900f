//! Records a second that `dataset::Loader` gives, as one line of JSON for `loader_vs_peers.py`.
//!
//! `loader DATASET SPLIT [--epochs N] [--threads N] [--memory-mb N]`; where the memory does not hold
//! the split, every epoch decodes.
#![allow(clippy::print_stdout, reason = "a program of its own for some figures")]

use std::hint::black_box;
use std::num::NonZero;
use std::path::PathBuf;
use std::sync::Arc;
use std::time::Instant;

use clap::Parser;
use holescout::config::Split;
use holescout::dataset::{Dataset, Grids, Loader, LoaderOptions, Record};
use serde_json::json;

#[derive(Debug, Parser)]
struct Arguments {
    dataset: PathBuf,
    split: Split,
    #[arg(long, default_value_t = 5)]
    epochs: usize,
    #[arg(long, default_value = "2")]
    threads: NonZero<usize>,
    #[arg(long, default_value_t = 16)]
    memory_mb: usize,
    /// What `cargo bench` passes to every benchmark.
    #[arg(long)]
    bench: bool,
}

fn main() -> Result<(), Box<dyn std::error::Error>> {
    let asked = Arguments::parse();
    let begin = Instant::now();
    let dataset = Arc::new(Dataset::open(&asked.dataset)?);
    let memory_bytes = asked.memory_mb << 20;
    let options = LoaderOptions { threads: asked.threads, memory_bytes, ..LoaderOptions::new(1) };
    let decode = |_: Record, grids: Grids| Arc::new(grids);
    let mut loader = Loader::new(&dataset, asked.split, options, 0, decode)?;
    let records = loader.ids().len();
    let (mut first_sample_s, mut ends) = (0.0, vec![0.0]);
    for _ in 0..asked.epochs {
        for _ in 0..records {
            let grids = loader.next().ok_or("a loader has no end")??.value;
            // The peers' consumers look at as much.
            let middle = grids.height_m.dim().0 / 2;
            let at = [middle, middle];
            black_box((grids.height_m[at], grids.rsrp_dbm[at], grids.mask[at]));
            if first_sample_s == 0.0 {
                first_sample_s = begin.elapsed().as_secs_f64();
            }
        }
        ends.push(begin.elapsed().as_secs_f64());
    }
    let epoch_s: Vec<f64> = ends.windows(2).map(|pair| pair[1] - pair[0]).collect();
    let samples = records * asked.epochs;
    let report = json!({
        "samples": samples,
        "first_sample_s": first_sample_s,
        "epoch_s": epoch_s,
        "samples_per_s": samples as f64 / begin.elapsed().as_secs_f64(),
        "threads": asked.threads,
        "in_memory": loader.keeps(),
        "peak_kib": peak_kib(),
    });
    println!("{report}");
    Ok(())
}

/// The most memory that this process ever held, where the system tells (Linux).
fn peak_kib() -> Option<u64> {
    let status = std::fs::read_to_string("/proc/self/status").ok()?;
    let peak = status.lines().find_map(|line| line.strip_prefix("VmHWM:"))?;
    peak.trim().strip_suffix(" kB")?.parse().ok()
}
