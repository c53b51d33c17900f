//! The order of records in training: a shuffle without a table.
//!
//! A cursor counts records over all epochs. Each epoch has a permutation of its own, computed
//! for one place at a time: a balanced Feistel network permutes the numbers below a power of
//! four (Luby and Rackoff, "How to construct pseudorandom permutations from pseudorandom
//! functions", 1988), and what falls outside of the split goes through it again until it falls
//! inside (cycle walking; Black and Rogaway, "Ciphers with arbitrary finite domains", 2002).
//! So a checkpoint needs nothing but the cursor, whatever the size of the split.
//!
//! With blocks, an epoch permutes the shards, takes so many of them at a time, and permutes the
//! records of those: a split that does not fit on the disk is read shard by shard. How far that
//! is from a full shuffle is measured by [`Order::distance`].

use std::num::NonZero;
use std::sync::Arc;

use crate::random::{GOLDEN, mix};

/// The shuffled order of a split's records, epoch after epoch. Records are numbered from 0, shard
/// after shard.
#[derive(Debug, Clone, PartialEq, Eq)]
pub struct Order {
    seed: u64,
    records: NonZero<u32>,
    /// Records before each shard.
    starts: Arc<[u32]>,
    /// Shards that are shuffled together.
    block: NonZero<usize>,
}

/// Four make a Feistel network pseudorandom on large numbers. Splits of few records need more:
/// over 10^6 orders of 4 to 7 records, which record follows which is visibly uneven with 8.
const ROUNDS: u64 = 12;

impl Order {
    /// The full shuffle of a number of records by a seed.
    #[must_use]
    pub fn new(seed: u64, records: NonZero<u32>) -> Self {
        Self::of_blocks(seed, &[records], NonZero::<usize>::MIN)
            .expect("the number of records fits, since it was given")
    }

    /// The shuffle of shards of so many records, `block` of them at a time. `None` without shards,
    /// or with 2^32 records.
    #[must_use]
    pub fn of_blocks(seed: u64, shards: &[NonZero<u32>], block: NonZero<usize>) -> Option<Self> {
        let mut starts = Vec::with_capacity(shards.len());
        let mut records = 0_u32;
        for size in shards {
            starts.push(records);
            records = records.checked_add(size.get())?;
        }
        Some(Self { seed, records: NonZero::new(records)?, starts: starts.into(), block })
    }

    /// Records of an epoch.
    #[must_use]
    pub fn records(&self) -> NonZero<u32> {
        self.records
    }

    /// The epoch that a cursor lies in, from 0, and the number of its record. Every epoch has
    /// every record once. For many cursors, ask [`Order::epoch`] once.
    #[must_use]
    pub fn at(&self, cursor: u64) -> (u64, u32) {
        let (epoch, place) = self.split(cursor);
        (epoch, self.epoch(epoch).at(place))
    }

    /// The epoch of a cursor, and its place there.
    #[must_use]
    pub fn split(&self, cursor: u64) -> (u64, u32) {
        let records = u64::from(self.records.get());
        (cursor / records, (cursor % records) as u32)
    }

    /// The order of one epoch.
    #[must_use]
    pub fn epoch(&self, epoch: u64) -> Epoch {
        let key = mix(mix(self.seed.wrapping_add(GOLDEN)) ^ mix(epoch));
        let shards = self.starts.len();
        if self.block.get() >= shards {
            let all = ShardBlock { first: 0, shards: vec![(0, self.records.get())] };
            return Epoch { number: epoch, key, records: self.records, blocks: vec![all] };
        }
        let size = |shard: usize| {
            let end = self.starts.get(shard + 1).copied().unwrap_or(self.records.get());
            (self.starts[shard], end - self.starts[shard])
        };
        // Another key than that of the first block, which counts from 0.
        let of_shards = mix(key ^ u64::MAX);
        let order: Vec<_> = (0..shards)
            .map(|at| size(permute(of_shards, shards as u32, at as u32) as usize))
            .collect();
        let mut first = 0;
        let blocks = order.chunks(self.block.get()).map(|shards| {
            let block = ShardBlock { first, shards: shards.to_vec() };
            first += shards.iter().map(|(_, size)| size).sum::<u32>();
            block
        });
        Epoch { number: epoch, key, records: self.records, blocks: blocks.collect() }
    }

    /// How far the shuffle is from a uniform one: the total variation distance between the shard
    /// of the record after another one and that of a record drawn from all others, averaged over
    /// an epoch. 0 is a full shuffle, about 1 is one shard after the other.
    #[must_use]
    pub fn distance(&self, epoch: u64) -> f64 {
        let records = f64::from(self.records.get());
        let order = self.epoch(epoch);
        let of_block = |block: &ShardBlock| {
            // What follows lies in the block, but for the last record of it.
            let inside: f64 = block.shards.iter().map(|(_, size)| f64::from(*size)).sum();
            inside / records * (1.0 - inside / records)
        };
        order.blocks.iter().map(of_block).sum()
    }
}

/// The order of one epoch.
#[derive(Debug, Clone, PartialEq, Eq)]
pub struct Epoch {
    number: u64,
    key: u64,
    records: NonZero<u32>,
    blocks: Vec<ShardBlock>,
}

/// Shards that are shuffled together.
#[derive(Debug, Clone, PartialEq, Eq)]
struct ShardBlock {
    /// Place of its first record in the epoch.
    first: u32,
    /// First record and number of records of each shard.
    shards: Vec<(u32, u32)>,
}

impl Epoch {
    /// Which one it is, from 0.
    #[must_use]
    pub fn number(&self) -> u64 {
        self.number
    }

    /// The blocks from that of a place on: the place where each begins, and the first record and
    /// number of records of what it is made of.
    pub(super) fn blocks(&self, place: u32) -> impl Iterator<Item = (u32, &[(u32, u32)])> {
        let first = self.blocks.partition_point(|block| block.first <= place) - 1;
        self.blocks[first..].iter().map(|block| (block.first, &block.shards[..]))
    }

    /// The number of the record at a place of the epoch, below the number of records.
    ///
    /// # Panics
    /// If the epoch has fewer records.
    #[must_use]
    pub fn at(&self, place: u32) -> u32 {
        assert!(place < self.records.get(), "an epoch of {} records", self.records);
        let block = self.blocks.partition_point(|block| block.first <= place) - 1;
        let ShardBlock { first, shards } = &self.blocks[block];
        let records = shards.iter().map(|(_, size)| size).sum();
        let mut within = permute(mix(self.key ^ block as u64), records, place - first);
        for (start, size) in shards {
            if within < *size {
                return start + within;
            }
            within -= size;
        }
        unreachable!("a permutation stays below the number of records")
    }
}

/// Where a permutation of the numbers below `records` takes one of them.
fn permute(key: u64, records: u32, number: u32) -> u32 {
    let bits = u32::BITS - (records - 1).leading_zeros();
    let half = bits.div_ceil(2);
    let mask = (1_u64 << half) - 1;
    let mut number = u64::from(number);
    // The walk ends: at the latest it comes back to where it began, which is inside.
    loop {
        let (mut left, mut right) = (number >> half, number & mask);
        for round in 0..ROUNDS {
            let counter = (round << half | right) + 1;
            let random = mix(key.wrapping_add(counter.wrapping_mul(GOLDEN)));
            (left, right) = (right, left ^ (random & mask));
        }
        number = left << half | right;
        if number < u64::from(records) {
            return number as u32;
        }
    }
}

#[cfg(test)]
mod tests {
    use proptest::prelude::*;

    use super::*;

    fn order(seed: u64, records: u32) -> Order {
        Order::new(seed, NonZero::new(records).expect("records"))
    }

    fn epoch(seed: u64, records: u32, epoch: u64) -> Vec<u32> {
        let (order, first) = (order(seed, records), epoch * u64::from(records));
        (first..first + u64::from(records))
            .map(|cursor| {
                let (of, number) = order.at(cursor);
                assert_eq!(of, epoch);
                number
            })
            .collect()
    }

    fn is_permutation(mut numbers: Vec<u32>) -> bool {
        numbers.sort_unstable();
        (0..numbers.len() as u32).eq(numbers)
    }

    proptest! {
        #[test]
        fn each_epoch_has_every_record_once(
            records in 1..=5000_u32,
            seed: u64,
            of in prop_oneof![0..4_u64, 0..=u64::MAX / 5000 - 1],
        ) {
            prop_assert!(is_permutation(epoch(seed, records, of)));
        }
    }

    #[test]
    fn few_records_and_powers_of_two_are_permuted_too() {
        for records in (1..=70).chain([255, 256, 257, 1023, 1024, 1025, 4096, 4097]) {
            for seed in 0..5 {
                assert!(is_permutation(epoch(seed, records, seed)), "{records} records");
            }
        }
        assert_eq!(order(1, 1).at(u64::MAX), (u64::MAX, 0));
        let (of, number) = order(1, u32::MAX).at(u64::MAX);
        assert!(of == u64::MAX / u64::from(u32::MAX) && number < u32::MAX);
    }

    #[test]
    fn epochs_and_seeds_have_different_orders() {
        let orders: std::collections::BTreeSet<Vec<u32>> =
            (0..20).flat_map(|seed| (0..20).map(move |of| epoch(seed, 100, of))).collect();
        assert_eq!(orders.len(), 400);
    }

    fn blocks(seed: u64, shards: &[u32], block: usize) -> Order {
        let shards: Vec<_> = shards.iter().filter_map(|size| NonZero::new(*size)).collect();
        let block = NonZero::new(block).expect("shards");
        Order::of_blocks(seed, &shards, block).expect("records")
    }

    proptest! {
        #[test]
        fn blocks_are_permutations_of_their_own_shards(
            shards in proptest::collection::vec(1..=60_u32, 1..20),
            block in 1..=25_usize,
            seed: u64,
            of in 0..1000_u64,
        ) {
            let order = blocks(seed, &shards, block);
            let records = order.records().get();
            let epoch = order.epoch(of);
            let numbers: Vec<u32> = (0..records).map(|place| epoch.at(place)).collect();
            prop_assert!(is_permutation(numbers.clone()));
            let first = of * u64::from(records);
            for (place, &number) in (0..).zip(&numbers) {
                prop_assert_eq!(order.at(first + place), (of, number));
            }
            let of_shard = |number| order.starts.partition_point(|&start| start <= number) - 1;
            let mut ends: Vec<usize> = epoch.blocks(0).map(|(begin, _)| begin as usize).collect();
            ends.push(numbers.len());
            for ends in ends.windows(2) {
                let mut shards: Vec<usize> =
                    numbers[ends[0]..ends[1]].iter().map(|&number| of_shard(number)).collect();
                shards.sort_unstable();
                shards.dedup();
                prop_assert!(block >= order.starts.len() || shards.len() <= block);
            }
        }
    }

    /// The distance from uniform is what is found among the successive records of some epochs.
    #[test]
    fn the_distance_of_blocks_from_a_full_shuffle_is_measured() {
        const SHARDS: usize = 8;
        const EACH: u32 = 2000;
        let mut last = 1.0;
        for block in [1, 2, 4, SHARDS] {
            let order = blocks(5, &[EACH; SHARDS], block);
            let (epochs, mut found) = (4, 0.0);
            for of in 0..epochs {
                let epoch = order.epoch(of);
                let of_shards: Vec<usize> =
                    (0..EACH * SHARDS as u32).map(|at| (epoch.at(at) / EACH) as usize).collect();
                let mut follows = [[0.0; SHARDS]; SHARDS];
                of_shards.windows(2).for_each(|pair| follows[pair[0]][pair[1]] += 1.0);
                for counts in follows {
                    let all: f64 = counts.iter().sum();
                    let even = 1.0 / SHARDS as f64;
                    let off = counts.map(|count| (count / all - even).abs() / 2.0);
                    found += off.iter().sum::<f64>() / SHARDS as f64 / epochs as f64;
                }
            }
            let expected = order.distance(0);
            // Of 2,000 draws from 8 shards about 0.025 is left by chance.
            assert!((expected - found).abs() < 0.05, "{block}: {expected}, found {found}");
            assert!(expected < last, "larger blocks are nearer");
            last = expected;
        }
        assert!(last < 1e-12, "all shards together are a full shuffle: {last}");
    }

    /// The sum over all outcomes of (found - expected)² / expected.
    fn chi_square(counts: &[u32], expected: f64) -> f64 {
        counts.iter().map(|count| (f64::from(*count) - expected).powi(2) / expected).sum()
    }

    /// By how many standard deviations chi-square exceeds its mean, the degrees of freedom; its
    /// variance is twice them.
    fn excess(chi_square: f64, freedom: f64) -> f64 {
        (chi_square - freedom) / (2.0 * freedom).sqrt()
    }

    /// Every record stands equally often at every place and after every other one.
    #[test]
    fn the_shuffle_is_close_to_uniform() {
        const DRAWS: u32 = 20_000;
        for records in [2, 3, 4, 5, 7, 12, 16, 17, 40_u32] {
            let n = records as usize;
            let (mut places, mut steps) = (vec![0; n * n], vec![0; n * n]);
            for draw in 0..u64::from(DRAWS) {
                // Every other draw is another seed, the rest other epochs.
                let (seed, of) = if draw % 2 == 0 { (draw, 0) } else { (0, draw) };
                let numbers: Vec<usize> =
                    epoch(seed, records, of).into_iter().map(|number| number as usize).collect();
                numbers.iter().enumerate().for_each(|(at, number)| places[at * n + number] += 1);
                numbers.windows(2).for_each(|pair| steps[pair[0] * n + pair[1]] += 1);
            }
            let mut diagonal = (0..n * n).map(|at| at % (n + 1) == 0);
            steps.retain(|_| !diagonal.next().expect("as many"));
            let n = f64::from(records);
            let expected = f64::from(DRAWS) / n;
            // An order's records exclude each other, which leaves (n - 1)² degrees of freedom,
            // each with n / (n - 1) of the usual variance at the places.
            let freedom = (n - 1.0).powi(2);
            let of_places = excess(chi_square(&places, expected) * (n - 1.0) / n, freedom);
            let of_steps = excess(chi_square(&steps, expected), freedom);
            assert!(of_places < 5.0, "{records} records: places off by {of_places} sd");
            assert!(of_steps < 5.0, "{records} records: steps off by {of_steps} sd");
        }
    }

    #[test]
    fn all_orders_of_few_records_are_about_equally_frequent() {
        let draws = 24_000;
        let mut counts = std::collections::BTreeMap::new();
        (0..draws).for_each(|seed| *counts.entry(epoch(seed, 4, 0)).or_insert(0) += 1);
        let counts: Vec<u32> = counts.into_values().collect();
        assert_eq!(counts.len(), 24);
        let off = excess(chi_square(&counts, 1000.0), 23.0);
        assert!(off < 5.0, "off by {off} sd");
    }
}
