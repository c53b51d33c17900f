//! Maps of several repeats, made up: what each repeat gave is known in every cell.

use std::path::{Path, PathBuf};
use std::sync::LazyLock;

use ndarray::{Array2, Zip};
use serde_json::{Value, json};
use zip::CompressionMethod;

use super::maps::{SITE, Window, good_values, metadata};
use super::numpy::{Float, Layout, npy, npy_text, npz};
use super::{Random, import, run, shard, shared_dir, write};

/// Repeats of every map.
pub(crate) const REPEATS: u32 = 8;
/// Rays of one repeat: with all of them there are ten in the farthest cell, in one there are not.
pub(crate) const SAMPLES: u64 = 4_000_000;

/// Linear path gains of a coarse map, row 0 south, of each repeat; 0 where no path arrives.
pub(crate) struct Traces(pub(crate) Vec<Array2<f64>>);

impl Traces {
    /// Of a tile of the site. Most cells are hit by many rays and differ by 2 % from repeat to repeat;
    /// a third are hit by none, one or two rays in each.
    pub(crate) fn of(tile: &str) -> Self {
        let sound = good_values(tile);
        let mut random = Random(11);
        let is_rare = sound.mapv(|_| random.share() < 1.0 / 3.0);
        let traces = (0..REPEATS).map(|_| {
            Zip::from(&sound).and(&is_rare).map_collect(|&gain, &is_rare| {
                let hits = if is_rare {
                    random.below(3) as f64 * random.share()
                } else {
                    1.0 + 0.04 * (random.share() - 0.5)
                };
                gain * hits
            })
        });
        Self(traces.collect())
    }

    fn mean_of(traces: &[Array2<f64>]) -> Array2<f64> {
        let mut sum = Array2::zeros(traces[0].dim());
        for trace in traces {
            sum += trace;
        }
        sum / traces.len() as f64
    }

    /// As a file has it: rounded to float32.
    pub(crate) fn mean(&self) -> Array2<f64> {
        Self::mean_of(&self.0).mapv(|value| f64::from(value as f32))
    }

    /// Sample standard deviation over the square root of the number of repeats, as float32.
    pub(crate) fn std_error(&self) -> Array2<f64> {
        let (mean, count) = (Self::mean_of(&self.0), self.0.len() as f64);
        let mut squares: Array2<f64> = Array2::zeros(mean.dim());
        for trace in &self.0 {
            Zip::from(&mut squares).and(trace).and(&mean).for_each(|sum, value, mean| {
                *sum += (value - mean) * (value - mean);
            });
        }
        squares.mapv(|sum| f64::from((sum / (count - 1.0) / count).sqrt() as f32))
    }

    /// Mean of the first half, as float32.
    pub(crate) fn first_half(&self) -> Array2<f64> {
        Self::mean_of(&self.0[..self.0.len() / 2]).mapv(|value| f64::from(value as f32))
    }
}

/// Metadata of a map of repeats.
pub(crate) fn metadata_of_repeats(tile: &str) -> Value {
    let mut metadata = metadata(tile, Window::Coarse);
    metadata["samples_per_tx"] = json!(SAMPLES);
    metadata["repeats"] = json!(REPEATS);
    metadata["direction_shift"] = json!("random");
    metadata
}

pub(crate) fn f4(values: &Array2<f64>) -> Vec<u8> {
    npy(values, Layout::plain(Float::F4))
}

/// Writes an `.npz` of some arrays and metadata.
pub(crate) fn write_arrays(path: &Path, arrays: &[(&str, Vec<u8>)], metadata: &Value) {
    let mut members = arrays.to_vec();
    members.push(("meta_json", npy_text(metadata.to_string().as_bytes())));
    write(path, npz(&members, CompressionMethod::Deflated));
}

/// Writes the repeats of a tile by the contract.
pub(crate) fn write_repeats(path: &Path, tile: &str) {
    let traces = Traces::of(tile);
    let arrays = [
        ("path_gain", f4(&traces.mean())),
        ("path_gain_std_error", f4(&traces.std_error())),
        ("path_gain_first_half", f4(&traces.first_half())),
    ];
    write_arrays(path, &arrays, &metadata_of_repeats(tile));
}

/// A dataset of maps with repeats.
pub(crate) struct Repeated {
    pub(crate) maps: PathBuf,
    pub(crate) rsrp: PathBuf,
    pub(crate) dataset: PathBuf,
}

/// All tiles of the site with repeats, built once for each test binary.
pub(crate) static REPEATED: LazyLock<Repeated> = LazyLock::new(|| {
    let root = shared_dir(concat!("repeated-", env!("CARGO_CRATE_NAME")));
    let repeated = Repeated {
        maps: root.join("maps"),
        rsrp: root.join("rsrp"),
        dataset: root.join("dataset"),
    };
    let Repeated { maps, rsrp, dataset } = &repeated;
    for tile in &SITE.ids {
        write_repeats(&maps.join(format!("{tile}.npz")), tile);
    }
    run(&mut import(maps, &SITE.tiles, rsrp)).succeeds();
    run(&mut shard(&SITE.tiles, rsrp, dataset)).succeeds();
    repeated
});
