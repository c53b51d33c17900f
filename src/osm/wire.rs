//! Protobuf's wire format, read in place (protobuf.dev, "Encoding"): nothing is copied, and nothing kept
//! that nobody asks for.
//!
//! The crate `protobuf` builds every object of a block first: each way is five lists of its own, most of
//! which are thrown away. It reads the frames of a file and the blocks of unusual writers, see
//! [`super::block`].

/// Bytes that are no message, or not as a writer of extracts encodes it.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub(super) struct Malformed;

/// What a field holds.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub(super) enum WireValue<'a> {
    Varint(u64),
    /// Text, a message, or numbers one after the other.
    Bytes(&'a [u8]),
    /// Four or eight bytes, of which the format of extracts has none.
    Fixed,
}

impl<'a> WireValue<'a> {
    pub(super) fn varint(self) -> Result<u64, Malformed> {
        if let Self::Varint(value) = self { Ok(value) } else { Err(Malformed) }
    }

    /// A signed number as most fields have it: in two's complement.
    pub(super) fn int(self) -> Result<i64, Malformed> {
        Ok(self.varint()?.cast_signed())
    }

    /// A signed number of a field of type `sint64`.
    pub(super) fn sint(self) -> Result<i64, Malformed> {
        self.varint().map(zigzag)
    }

    pub(super) fn bytes(self) -> Result<&'a [u8], Malformed> {
        if let Self::Bytes(bytes) = self { Ok(bytes) } else { Err(Malformed) }
    }

    pub(super) fn packed(self) -> Result<Varints<'a>, Malformed> {
        Varints::new(self.bytes()?)
    }
}

/// The fields of a message, by number, in the order of the bytes.
pub(super) struct Fields<'a>(&'a [u8]);

impl<'a> Fields<'a> {
    pub(super) fn of(message: &'a [u8]) -> Self {
        Self(message)
    }

    fn take(&mut self, length: u64) -> Result<&'a [u8], Malformed> {
        let length = usize::try_from(length).map_err(|_| Malformed)?;
        let (taken, rest) = self.0.split_at_checked(length).ok_or(Malformed)?;
        self.0 = rest;
        Ok(taken)
    }

    fn field(&mut self) -> Result<(u32, WireValue<'a>), Malformed> {
        let tag = varint(&mut self.0)?;
        let number = u32::try_from(tag >> 3).map_err(|_| Malformed)?;
        let value = match tag & 7 {
            0 => WireValue::Varint(varint(&mut self.0)?),
            1 => self.take(8).map(|_| WireValue::Fixed)?,
            2 => {
                let length = varint(&mut self.0)?;
                WireValue::Bytes(self.take(length)?)
            }
            5 => self.take(4).map(|_| WireValue::Fixed)?,
            _ => return Err(Malformed),
        };
        if number == 0 { Err(Malformed) } else { Ok((number, value)) }
    }
}

impl<'a> Iterator for Fields<'a> {
    type Item = Result<(u32, WireValue<'a>), Malformed>;

    fn next(&mut self) -> Option<Self::Item> {
        (!self.0.is_empty()).then(|| self.field())
    }
}

/// Numbers of one field, one after the other.
#[derive(Debug, Clone, Copy, Default, PartialEq, Eq)]
pub(super) struct Varints<'a>(&'a [u8]);

impl<'a> Varints<'a> {
    /// Checks once that every number ends: what iterates does not check again.
    fn new(bytes: &'a [u8]) -> Result<Self, Malformed> {
        let ends = bytes.last().is_none_or(|last| *last < 0x80);
        if ends { Ok(Self(bytes)) } else { Err(Malformed) }
    }

    /// How many there are: each ends in the one byte that has no follower.
    pub(super) fn len(self) -> usize {
        self.0.iter().filter(|byte| **byte < 0x80).count()
    }

    pub(super) fn is_empty(self) -> bool {
        self.0.is_empty()
    }

    /// The numbers; bits beyond 64 of one are dropped.
    pub(super) fn varints(self) -> impl Iterator<Item = u64> + use<'a> {
        let mut bytes = self.0.iter();
        std::iter::from_fn(move || {
            let first = *bytes.next()?;
            let (mut value, mut shift, mut last) = (u64::from(first & 0x7f), 0_u32, first);
            while last >= 0x80 {
                last = *bytes.next()?;
                shift += 7;
                value |= u64::from(last & 0x7f).checked_shl(shift).unwrap_or(0);
            }
            Some(value)
        })
    }

    /// The sums of differences, as ids and coordinates are kept; those of a hostile file wrap.
    pub(super) fn undelta(self) -> impl Iterator<Item = i64> + use<'a> {
        self.varints().scan(0_i64, |sum, difference| {
            *sum = sum.wrapping_add(zigzag(difference));
            Some(*sum)
        })
    }
}

/// The number that the bytes begin with, which they lose.
#[inline]
fn varint(bytes: &mut &[u8]) -> Result<u64, Malformed> {
    let mut value = 0_u64;
    for shift in (0..70).step_by(7) {
        let (&byte, rest) = bytes.split_first().ok_or(Malformed)?;
        *bytes = rest;
        value |= u64::from(byte & 0x7f) << shift.min(63);
        if byte < 0x80 {
            return Ok(value);
        }
    }
    Err(Malformed)
}

fn zigzag(value: u64) -> i64 {
    (value >> 1).cast_signed() ^ -((value & 1).cast_signed())
}

#[cfg(test)]
mod tests {
    use super::*;
    use proptest::prelude::*;
    use protobuf::CodedOutputStream;

    fn written(write: impl Fn(&mut CodedOutputStream<'_>)) -> Vec<u8> {
        let mut bytes = Vec::new();
        let mut stream = CodedOutputStream::vec(&mut bytes);
        write(&mut stream);
        stream.flush().expect("memory can be written");
        drop(stream);
        bytes
    }

    proptest! {
        /// What the crate `protobuf` writes is read as it was meant.
        #[test]
        fn numbers_of_the_crate_are_read(values in prop::collection::vec(any::<i64>(), 0..40), number in 1_u32..1000) {
            let packed = written(|stream| {
                for value in &values {
                    stream.write_sint64_no_tag(*value).expect("memory");
                }
            });
            let message = written(|stream| {
                stream.write_bytes(number, &packed).expect("memory");
                stream.write_fixed32(number, 7).expect("memory");
                stream.write_fixed64(number, 7).expect("memory");
                for value in &values {
                    stream.write_int64(number, *value).expect("memory");
                    stream.write_sint64(number, *value).expect("memory");
                }
            });
            let fields: Vec<_> = Fields::of(&message).map(|field| field.expect("sound")).collect();
            prop_assert!(fields.iter().all(|(found, _)| *found == number));
            let list = fields[0].1.packed().expect("a list");
            prop_assert_eq!(list.len(), values.len());
            let sums = values.iter().scan(0_i64, |sum, value| { *sum = sum.wrapping_add(*value); Some(*sum) });
            prop_assert!(list.undelta().eq(sums));
            prop_assert_eq!(&[fields[1].1, fields[2].1], &[WireValue::Fixed, WireValue::Fixed]);
            for (pair, value) in fields[3..].chunks(2).zip(&values) {
                prop_assert_eq!((pair[0].1.int(), pair[1].1.sint()), (Ok(*value), Ok(*value)));
            }
        }

        /// Any bytes are fields or an error, and lists of numbers end where they say.
        #[test]
        fn any_bytes_are_read_without_a_panic(bytes in prop::collection::vec(any::<u8>(), 0..80)) {
            for (_, value) in Fields::of(&bytes).map_while(Result::ok) {
                if let Ok(list) = value.packed() {
                    prop_assert_eq!(list.varints().count(), list.len());
                }
            }
        }
    }

    #[test]
    fn what_ends_early_or_never_is_malformed() {
        for bytes in
            [&[0x08][..], &[0x08, 0x80], &[0x12, 2, 0], &[0x0d, 0, 0], &[0x09, 0], &[0x0b], &[0, 0]]
        {
            assert_eq!(Fields::of(bytes).next(), Some(Err(Malformed)), "{bytes:?}");
        }
        let endless = [&[0x08][..], &[0xff; 10], &[0x01]].concat();
        assert_eq!(Fields::of(&endless).next(), Some(Err(Malformed)));
        assert_eq!(WireValue::Bytes(&[1, 0x80]).packed(), Err(Malformed));
        assert_eq!(WireValue::Varint(3).bytes(), Err(Malformed));
        assert_eq!(WireValue::Fixed.varint(), Err(Malformed));
    }
}
