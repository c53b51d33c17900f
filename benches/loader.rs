//! Records a second that `dataset::Loader` gives, for `loader_vs_peers.py`: one line of JSON.
//!
//! `loader DATASET SPLIT [--epochs N] [--threads N] [--memory-mb N]`
#![allow(clippy::print_stdout, clippy::unwrap_used, reason = "a program of its own for one figure")]

use std::num::NonZero;
use std::path::Path;
use std::sync::Arc;
use std::time::Instant;

use holescout::config::Split;
use holescout::dataset::{Dataset, Grids, Loader, LoaderOptions, Record};

fn main() {
    let args: Vec<String> = std::env::args().collect();
    let flag = |name: &str, default: usize| {
        let at = args.iter().position(|arg| arg == name);
        at.map_or(default, |at| args[at + 1].parse().expect("a number"))
    };
    let (root, split) = (Path::new(&args[1]), &args[2]);
    let split = Split::ALL.into_iter().find(|of| of.name() == split).expect("a split");
    let threads = NonZero::new(flag("--threads", 2)).expect("threads");
    let memory_bytes = flag("--memory-mb", 64) << 20;
    let epochs = flag("--epochs", 5);

    let begin = Instant::now();
    let dataset = Arc::new(Dataset::open(root).unwrap());
    let keep = !args.iter().any(|arg| arg == "--no-keep");
    let options = LoaderOptions { threads, memory_bytes, keep, ..LoaderOptions::new(1) };
    let mut loader =
        Loader::new(&dataset, split, options, 0, |_: Record, grids: Grids| Arc::new(grids))
            .unwrap();
    let records = loader.ids().len();
    let (mut first, mut epoch_s, mut sum) = (0.0, Vec::new(), 0.0);
    let mut last = begin;
    for epoch in 0..epochs {
        for number in 0..records {
            let grids = loader.next().unwrap().unwrap().value;
            sum += f64::from(grids.height_m[[0, 0]])
                + f64::from(grids.rsrp_dbm[[60, 60]])
                + f64::from(grids.mask[[7, 7]]);
            if epoch + number == 0 {
                first = begin.elapsed().as_secs_f64();
            }
        }
        epoch_s.push(last.elapsed().as_secs_f64());
        last = Instant::now();
    }
    let samples = epochs * records;
    let total: f64 = epoch_s.iter().sum();
    println!(
        "{{\"samples\": {samples}, \"first_sample_s\": {first:.6}, \"epoch_s\": {epoch_s:?}, \"samples_per_s\": {:.1}, \"threads\": {threads}, \"sum\": {sum}}}",
        samples as f64 / total
    );
}
