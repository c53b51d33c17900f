//! The inner loops of the task on one thread: steps of the environment, permissible sets,
//! encodings, the oracle.
//!
//! `HOLESCOUT_DATASET=DIR cargo bench --bench task`; by default the dataset of the fixtures that
//! `make dataset` builds. `benches/RESULTS.md` keeps the figures.

use std::hint::black_box;
use std::path::PathBuf;
use std::sync::Arc;

use criterion::{Criterion, Throughput, criterion_group, criterion_main};
use holescout::config::RlConfig;
use holescout::dataset::Dataset;
use holescout::rl::{
    Cell, Encoder, Environment, Hops, MapList, Measurement, Random, Sight, State, World,
};

/// Episodes at a time.
const SLOTS: usize = 1024;
/// Maps of the pool.
const MAPS: usize = 64;

fn worlds(config: &RlConfig) -> Vec<Arc<World>> {
    let path = std::env::var_os("HOLESCOUT_DATASET");
    let path = path.map_or_else(|| PathBuf::from("build/helsinki/dataset"), PathBuf::from);
    let dataset = Dataset::open(&path).expect("a dataset: run `make dataset`");
    let records = dataset.manifest().records.iter().take(MAPS);
    let worlds = records.map(|entry| {
        let (record, grids) = dataset.record_with_grids(entry.id).expect("a sound record");
        Arc::new(World::new(&record, &grids, config))
    });
    worlds.collect()
}

fn benchmark(criterion: &mut Criterion) {
    let config = RlConfig::default();
    let maps = worlds(&config);
    let sight = Sight::new(config.reach_cells);

    let mut group = criterion.benchmark_group("environment");
    group.throughput(Throughput::Elements(SLOTS as u64));
    let list = MapList::of(maps.clone()).expect("maps with holes");
    let mut environment = Environment::new(&list, SLOTS, config.max_steps, 0);
    let mut random = Random::keyed(&[1]);
    let pool = rayon::ThreadPoolBuilder::new().num_threads(1).build().expect("a pool");
    group.bench_function("step, random permissible action", |bencher| {
        bencher.iter(|| {
            let actions: Vec<usize> = (0..SLOTS)
                .map(|slot| {
                    let set = environment.permissible(slot);
                    set.nth(random.below(set.count())).expect("to stay is permissible")
                })
                .collect();
            pool.install(|| environment.step(&list, &actions))
        });
    });
    group.bench_function("step, random action", |bencher| {
        let count = environment.actions().count();
        bencher.iter(|| {
            let actions: Vec<usize> = (0..SLOTS).map(|_| random.below(count)).collect();
            pool.install(|| environment.step(&list, &actions))
        });
    });
    group.finish();

    let mut group = criterion.benchmark_group("one state");
    group.throughput(Throughput::Elements(1));
    let mut set = sight.empty();
    let places: Vec<(&World, Cell)> = maps
        .iter()
        .flat_map(|map| random.sample(&map.free_cells(), 64).into_iter().map(|cell| (&**map, cell)))
        .collect();
    let mut next = places.iter().cycle();
    group.bench_function("permissible set", |bencher| {
        bencher.iter(|| {
            let (map, cell) = *next.next().expect("a cycle never ends");
            sight.permissible_into(map, cell, &mut set);
            black_box(&set);
        });
    });
    let encoder = Encoder::new(maps[0].cells(), &config);
    let (mut map, mut window) = (vec![0.0; encoder.map_len()], vec![0.0; encoder.window_len()]);
    for visited in [1, 4] {
        group.bench_function(format!("encoding, {visited} measurements"), |bencher| {
            bencher.iter(|| {
                let (world, cell) = *next.next().expect("a cycle never ends");
                let measured = Measurement { cell, rsrp_dbm: world.rsrp_dbm(cell) };
                let measurements = vec![measured; visited];
                encoder.encode(State::new(world, &measurements), &mut map, &mut window);
                black_box((&map, &window));
            });
        });
    }
    group.finish();

    let mut next = maps.iter().cycle();
    criterion.bench_function("oracle, all cells of a map", |bencher| {
        bencher.iter(|| Hops::new(next.next().expect("a cycle never ends"), &sight));
    });
    criterion.bench_function("table of shadows", |bencher| bencher.iter(|| Sight::new(15)));
}

criterion_group!(benches, benchmark);
criterion_main!(benches);
