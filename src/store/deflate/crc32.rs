//! Checksums of bytes that are put together, from those of their parts.

use crc32fast::Hasher;

/// What a CRC-32 becomes when so many bytes follow. Appending zeros is linear in the bits of the checksum, so
/// four look-ups do what `crc32fast` needs a product of matrices for.
#[derive(Debug)]
pub(super) struct Crc32Shift([[u32; 256]; 4]);

impl Crc32Shift {
    /// Over so many bytes.
    pub(super) fn over(bytes: usize) -> Self {
        let moved = |crc32: u32| {
            let mut before = Hasher::new_with_initial_len(crc32, 0);
            before.combine(&Hasher::new_with_initial_len(0, bytes as u64));
            before.finalize()
        };
        let bits: Vec<u32> = (0..32).map(|bit| moved(1 << bit)).collect();
        let sum = |byte: usize, value: usize| {
            let set = (0..8).filter(|bit| value >> bit & 1 == 1);
            set.fold(0, |sum, bit| sum ^ bits[byte * 8 + bit])
        };
        let table = |byte| std::array::from_fn(|value| sum(byte, value));
        Self(std::array::from_fn(table))
    }

    /// The checksum of bytes with `crc32` and those behind them, which have the checksum `next`.
    pub(super) fn append(&self, crc32: u32, next: u32) -> u32 {
        let tables = self.0.iter().zip(crc32.to_le_bytes());
        tables.fold(next, |sum, (table, byte)| sum ^ table[usize::from(byte)])
    }
}

#[cfg(test)]
mod tests {
    use proptest::prelude::*;

    use super::*;

    proptest! {
        #[test]
        fn parts_have_the_checksum_of_the_whole(
            one in prop::collection::vec(any::<u8>(), 0..300),
            other in prop::collection::vec(any::<u8>(), 0..300),
        ) {
            let shift = Crc32Shift::over(other.len());
            let joined = shift.append(crc32fast::hash(&one), crc32fast::hash(&other));
            prop_assert_eq!(joined, crc32fast::hash(&[one, other].concat()));
        }
    }
}
