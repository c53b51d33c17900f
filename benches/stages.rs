//! The inner loops of the pipeline on the fixtures: medians over repetitions.
//!
//! `cargo bench --bench stages [EXTRACT.osm.pbf [rasterise]]`; with `rasterise` only what
//! `rasterise_vs_peers.py` compares. The deflate and Zstandard levels that the code uses were chosen from
//! this table; `benches/RESULTS.md` keeps the figures.

#![allow(clippy::print_stdout, reason = "a benchmark prints its figures")]

use std::collections::BTreeSet;
use std::hint::black_box;
use std::path::PathBuf;
use std::time::{Duration, Instant};

use holescout::building::City;
use holescout::config::Config;
use holescout::dataset::downsample_heights;
use holescout::grid::{Area, BoxIndex, TileId};
use holescout::osm::read_buildings;
use holescout::progress::Silent;
use holescout::rasterise::{HeightGrid, TileSource};
use holescout::scenes::{Mesh, Solid, Solids, extrude, ply_bytes};
use holescout::store::{compress_frame, npy_bytes, npz_bytes, sha256_bytes};
use rayon::prelude::*;

const REPETITIONS: usize = 9;
/// Tiles that each repetition works on.
const TILES: usize = 12;

/// Median time of one call, the first not counted.
fn median(mut call: impl FnMut()) -> Duration {
    let mut times: Vec<Duration> = (0..=REPETITIONS)
        .map(|_| {
            let start = Instant::now();
            call();
            start.elapsed()
        })
        .skip(1)
        .collect();
    times.sort_unstable();
    times[times.len() / 2]
}

fn row(what: &str, time: Duration, per: usize, note: &str) {
    println!("{what:<34} {:>10.3} ms  {note}", time.as_secs_f64() * 1e3 / per as f64);
}

/// Prisms of all buildings, then the meshes of the densest tiles.
fn scenes(city: &City, tiles: &BTreeSet<TileId>, config: &Config) {
    let made = || extrude(city);
    let time = median(|| drop(made()));
    let Solids { solids, .. } = made();
    let rate = solids.len() as f64 / time.as_secs_f64();
    row("extrude all buildings (all threads)", time, 1, &format!("{rate:.0} solids/s"));

    let boxes = solids.iter().map(Solid::bounds).collect();
    let index = BoxIndex::new(boxes, config.grid.spacing_m.into());
    let mesh = |id: TileId| {
        let meeting = index.meeting(&id.square(config.grid.side_m.into()));
        Mesh::of_solids(meeting.into_iter().map(|at| &solids[at]), id)
    };
    let densest = tiles.iter().copied().max_by_key(|id| mesh(*id).triangles.len());
    let densest = densest.expect("the extract fills a tile");
    let triangles = mesh(densest).triangles.len();
    let time = median(|| drop(black_box(ply_bytes(&mesh(densest)))));
    row("densest mesh and PLY (1 thread)", time, 1, &format!("{triangles} triangles"));
    let all = || tiles.par_iter().map(|id| ply_bytes(&mesh(*id)).len()).sum::<usize>();
    let time = median(|| {
        black_box(all());
    });
    row("all meshes and PLYs (all threads)", time, 1, &format!("{} tiles", tiles.len()));
}

fn main() {
    let mut arguments = std::env::args().skip(1).filter(|argument| !argument.starts_with("--"));
    let extract = arguments.next();
    let files =
        [PathBuf::from(extract.unwrap_or_else(|| "fixtures/helsinki/helsinki.osm.pbf".to_owned()))];
    let config = Config::default();
    let read = || {
        read_buildings(&files, &config.buildings, None, &Area::Whole, &Silent)
            .expect("the extract is readable")
    };
    let extract = read();
    println!(
        "{}: {} buildings; median of {REPETITIONS}",
        files[0].display(),
        extract.city.buildings().len()
    );
    row("read extract (all threads)", median(|| drop(read())), 1, "");

    let source = TileSource::new(&extract.city, &config.grid, extract.utm);
    let mut tiles: Vec<(TileId, HeightGrid)> =
        source.candidates().into_iter().map(|id| (id, source.rasterise(id))).collect();
    tiles.sort_by(|(_, a), (_, b)| b.statistics.built.total_cmp(&a.statistics.built));
    tiles.truncate(TILES);
    let count = tiles.len();
    let rasterise = median(|| tiles.iter().for_each(|(id, _)| drop(source.rasterise(*id))));
    row("rasterise one tile (1 thread)", rasterise, count, "the densest tiles");
    if arguments.next().as_deref() == Some("rasterise") {
        return;
    }

    scenes(&extract.city, &source.candidates(), &config);

    let members: Vec<Vec<u8>> = tiles.iter().map(|(_, tile)| npy_bytes(&tile.height_m)).collect();
    let raw: usize = members.iter().map(Vec::len).sum();
    for level in [1, 2, 3, 4, 6, 9] {
        let compress =
            || members.iter().map(|m| npz_bytes(&[("height_m", m.clone())], level).len());
        let time = median(|| {
            black_box(compress().sum::<usize>());
        });
        let ratio = raw as f64 / compress().sum::<usize>() as f64;
        row(&format!("npz of one tile, deflate {level}"), time, count, &format!("{ratio:.1} : 1"));
    }
    row("SHA-256 of one raw tile", median(|| drop(sha256_bytes(&members[0]))), 1, "");

    let window = |tile: &HeightGrid| {
        let crop = config.grid.crop_offset_cells()
            ..config.grid.crop_offset_cells() + config.grid.crop_cells();
        let cells = tile.height_m.slice(ndarray::s![crop.clone(), crop]);
        downsample_heights(cells, 4, config.shard.height)
    };
    let downsample = median(|| tiles.iter().for_each(|(_, tile)| drop(window(tile))));
    row("crop and downsample heights", downsample, count, "");
    let records: Vec<Vec<u8>> = tiles.iter().map(|(_, tile)| npy_bytes(&window(tile))).collect();
    for level in [1, 3, 6, 9, 15, 19] {
        let compress =
            || records.iter().map(|record| compress_frame(record, level).map_or(0, |f| f.len()));
        let time = median(|| {
            black_box(compress().sum::<usize>());
        });
        let ratio =
            records.iter().map(Vec::len).sum::<usize>() as f64 / compress().sum::<usize>() as f64;
        row(&format!("frame of heights, zstd {level}"), time, count, &format!("{ratio:.1} : 1"));
    }
}
