//! How records are loaded.

use std::num::NonZero;

use crate::config::OnDamage;

/// Which records of each epoch a process loads: those at the cursors that leave `rank` when divided
/// by `world`. All ranks together have every record of an epoch once, their numbers within one.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub struct Share {
    rank: u32,
    world: NonZero<u32>,
}

impl Share {
    /// All of them.
    pub const ALL: Self = Self { rank: 0, world: NonZero::<u32>::MIN };

    /// The share of a process of several; `None` unless `rank` is below `world`.
    #[must_use]
    pub fn of(rank: u32, world: NonZero<u32>) -> Option<Self> {
        (rank < world.get()).then_some(Self { rank, world })
    }

    /// Number of processes.
    #[must_use]
    pub fn world(self) -> NonZero<u32> {
        self.world
    }

    /// The first cursor of the share that is not before another one.
    pub(super) fn first(self, from: u64) -> u64 {
        let (rank, world) = (u64::from(self.rank), u64::from(self.world.get()));
        from.wrapping_add((rank + world - from % world) % world)
    }

    /// Items of the share from its cursor `first` on that come before another cursor.
    pub(super) fn items(self, first: u64, cursor: u64) -> u64 {
        cursor.saturating_sub(first).div_ceil(self.world.get().into())
    }

    /// The cursor that comes so many items after another one of the share.
    pub(super) fn after(self, cursor: u64, items: u64) -> u64 {
        cursor.wrapping_add(items.wrapping_mul(self.world.get().into()))
    }
}

/// How records are loaded. Only `seed`, `block` and `share` decide which record comes when.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub struct LoaderOptions {
    /// Decides the order, see [`super::Order`].
    pub seed: u64,
    /// Shards that are shuffled together; `None` shuffles all of the split, for which all of it
    /// must be at hand.
    pub block: Option<NonZero<usize>>,
    /// The part of each epoch that this process loads.
    pub share: Share,
    /// Most threads that decode; fewer if the memory does not hold so many.
    pub threads: NonZero<usize>,
    /// Memory for threads, and for records that are being decoded, wait to be taken or are kept, in
    /// bytes. A thread is taken to need a MiB, a record twice its arrays and a little more; one of
    /// each is always allowed.
    pub memory_bytes: usize,
    /// Whether decoded records are kept, and cloned for each epoch, if `memory_bytes` holds all of
    /// the split.
    pub keep: bool,
    /// What becomes of damaged records.
    pub on_damage: OnDamage,
}

impl LoaderOptions {
    /// A full shuffle by a seed on all cores within 256 MiB.
    #[must_use]
    pub fn new(seed: u64) -> Self {
        Self {
            seed,
            block: None,
            share: Share::ALL,
            threads: std::thread::available_parallelism().unwrap_or(NonZero::<usize>::MIN),
            memory_bytes: 256 << 20,
            keep: true,
            on_damage: OnDamage::Error,
        }
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn shares_cover_all_cursors_once() {
        for world in 1..=5 {
            let world = NonZero::new(world).expect("processes");
            let shares: Vec<Share> =
                (0..world.get()).filter_map(|rank| Share::of(rank, world)).collect();
            assert!(Share::of(world.get(), world).is_none());
            for from in 0..12 {
                let mut cursors: Vec<u64> = shares
                    .iter()
                    .flat_map(|share| (0..4).map(|items| share.after(share.first(from), items)))
                    .collect();
                cursors.sort_unstable();
                assert!(cursors.iter().copied().eq(from..from + 4 * u64::from(world.get())));
            }
        }
        assert_eq!(Share::ALL.first(u64::MAX), u64::MAX);
    }
}
