//! Random numbers whose whole state is two integers.
//!
//! `SplitMix64` (Steele, Lea and Flood, "Fast splittable pseudorandom number generators", 2014) read
//! as a counter: the n-th number is a hash of the key and n. A stream for each map, start or
//! episode is keyed by what it belongs to, so no result depends on threads or on order, and
//! a checkpoint stores a key and a counter. The functions are `libm`'s: the same bits everywhere.

use serde::{Deserialize, Serialize};

/// A stream of random numbers.
#[derive(Debug, Clone, PartialEq, Eq, Serialize, Deserialize)]
pub struct Random {
    key: u64,
    counter: u64,
}

/// What a counter goes on by.
pub(crate) const GOLDEN: u64 = 0x9E37_79B9_7F4A_7C15;

/// The finaliser: a hash of 64 bits.
pub(crate) fn mix(mut z: u64) -> u64 {
    z = (z ^ (z >> 30)).wrapping_mul(0xBF58_476D_1CE4_E5B9);
    z = (z ^ (z >> 27)).wrapping_mul(0x94D0_49BB_1331_11EB);
    z ^ (z >> 31)
}

impl Random {
    /// The stream that belongs to some numbers, for instance seed, map and start.
    #[must_use]
    pub fn keyed(by: &[u64]) -> Self {
        let key = by.iter().fold(GOLDEN, |key, &part| mix(key ^ mix(part.wrapping_add(GOLDEN))));
        Self { key, counter: 0 }
    }

    /// All 64 bits random.
    pub fn bits(&mut self) -> u64 {
        self.counter += 1;
        mix(self.key.wrapping_add(self.counter.wrapping_mul(GOLDEN)))
    }

    /// From 0 to below `end`; 0 if `end` is 0. The bias is below `end` / 2^64.
    pub fn below(&mut self, end: usize) -> usize {
        ((u128::from(self.bits()) * end as u128) >> 64) as usize
    }

    /// Uniform from 0 to below 1.
    pub fn unit(&mut self) -> f64 {
        (self.bits() >> 11) as f64 / (1_u64 << 53) as f64
    }

    /// Normal with mean 0 and standard deviation 1 (Box and Muller, 1958).
    pub fn normal(&mut self) -> f64 {
        let radius = libm::sqrt(-2.0 * libm::log(1.0 - self.unit()));
        radius * libm::cos(std::f64::consts::TAU * self.unit())
    }

    /// `count` different items (all, if there are fewer) in random order: the beginning of a
    /// Fisher-Yates shuffle, so that fewer items are the beginning of more.
    #[must_use]
    pub fn sample<T: Copy>(&mut self, items: &[T], count: usize) -> Vec<T> {
        let mut items = items.to_vec();
        let count = count.min(items.len());
        for at in 0..count {
            let other = at + self.below(items.len() - at);
            items.swap(at, other);
        }
        items.truncate(count);
        items
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn streams_are_told_apart_by_each_part_of_their_key() {
        let first = |by: &[u64]| Random::keyed(by).bits();
        let keys: [&[u64]; 6] = [&[], &[0], &[1], &[0, 1], &[1, 0], &[0, 0]];
        let firsts: std::collections::BTreeSet<u64> = keys.iter().map(|by| first(by)).collect();
        assert_eq!(firsts.len(), keys.len());
        assert_eq!(first(&[7, 8]), first(&[7, 8]));
    }

    #[test]
    fn numbers_have_the_moments_they_should() {
        let mut random = Random::keyed(&[3]);
        let n = 100_000;
        let uniform: f64 = (0..n).map(|_| random.unit()).sum::<f64>() / f64::from(n);
        assert!((uniform - 0.5).abs() < 0.005, "{uniform}");
        let normal: Vec<f64> = (0..n).map(|_| random.normal()).collect();
        let mean = normal.iter().sum::<f64>() / f64::from(n);
        let variance = normal.iter().map(|x| x * x).sum::<f64>() / f64::from(n);
        assert!(mean.abs() < 0.02 && (variance - 1.0).abs() < 0.03, "{mean} {variance}");
        let mut counts = [0; 7];
        (0..70_000).for_each(|_| counts[random.below(7)] += 1);
        assert!(counts.iter().all(|count| (9_500..10_500).contains(count)), "{counts:?}");
    }

    #[test]
    fn fewer_samples_begin_more_samples() {
        let items: Vec<u32> = (0..50).collect();
        let sample = |count| Random::keyed(&[1]).sample(&items, count);
        assert_eq!(sample(10)[..], sample(30)[..10]);
        let mut all = sample(100);
        all.sort_unstable();
        assert_eq!(all, items);
    }
}
