//! Every sound `.npy` of NEP 1 that a writer may choose, whatever byte order, memory order, version
//! and spelling of the header: the values that were written are those that are read, bit by bit.
#![no_main]

use half::f16;
use holescout::store::{Element, NpyError, read_npy};
use holescout_fuzz as _;
use libfuzzer_sys::arbitrary::{self, Arbitrary};
use libfuzzer_sys::fuzz_target;
use ndarray::Array2;

#[derive(Debug, Clone, Copy, Arbitrary)]
enum Kind {
    F2,
    F4,
    F8,
    U1,
    I2,
    U2,
}

#[derive(Debug, Arbitrary)]
struct Written {
    kind: Kind,
    big_endian: bool,
    fortran_order: bool,
    /// 1, 2 or 3.
    version: u8,
    rows: u8,
    columns: u8,
    double_quotes: bool,
    /// In which order the three keys come.
    rotated: u8,
    final_comma: bool,
    spaces: u8,
    /// Bits of the values, repeated.
    bits: Vec<u64>,
}

impl Written {
    fn dim(&self) -> (usize, usize) {
        (usize::from(self.rows % 9), usize::from(self.columns % 9))
    }

    fn bits(&self, row: usize, column: usize) -> u64 {
        let at = row * self.dim().1 + column;
        let given = self.bits.get(at % self.bits.len().max(1)).copied().unwrap_or_default();
        given.rotate_left(at as u32)
    }

    fn file(&self) -> Vec<u8> {
        let (kind, size) = match self.kind {
            Kind::F2 => ("f2", 2),
            Kind::F4 => ("f4", 4),
            Kind::F8 => ("f8", 8),
            Kind::U1 => ("u1", 1),
            Kind::I2 => ("i2", 2),
            Kind::U2 => ("u2", 2),
        };
        let order = match (self.big_endian, size) {
            (_, 1) => '|',
            (true, _) => '>',
            (false, _) => '<',
        };
        let (rows, columns) = self.dim();
        let quote = if self.double_quotes { '"' } else { '\'' };
        let fortran_order = if self.fortran_order { "True" } else { "False" };
        let mut entries = [
            format!("{quote}descr{quote}: {quote}{order}{kind}{quote}"),
            format!("{quote}fortran_order{quote}: {fortran_order}"),
            format!("{quote}shape{quote}: ({rows}, {columns})"),
        ];
        entries.rotate_left(usize::from(self.rotated % 3));
        let comma = if self.final_comma { ", " } else { "" };
        let spaces = " ".repeat(usize::from(self.spaces));
        let header = format!("{{{}{comma}}}{spaces}\n", entries.join(", "));

        let version = self.version % 3 + 1;
        let mut file = b"\x93NUMPY".to_vec();
        file.extend([version, 0]);
        let length = header.len() as u32;
        file.extend(&length.to_le_bytes()[..if version == 1 { 2 } else { 4 }]);
        file.extend(header.bytes());
        let (slow, fast) = if self.fortran_order { (columns, rows) } else { (rows, columns) };
        for (slow, fast) in (0..slow).flat_map(|slow| (0..fast).map(move |fast| (slow, fast))) {
            let (row, column) = if self.fortran_order { (fast, slow) } else { (slow, fast) };
            let mut element = self.bits(row, column).to_le_bytes()[..size].to_vec();
            if self.big_endian {
                element.reverse();
            }
            file.extend(element);
        }
        file
    }

    fn demand<T: Element>(&self, file: &[u8], bits: impl Fn(T) -> u64) {
        let mask = u64::MAX >> (64 - 8 * size_of::<T>());
        let npy = read_npy(file).expect("sound");
        assert_eq!((npy.dtype, npy.fortran_order), (T::DTYPE, self.fortran_order));
        let read: Array2<T> = npy.to_array2().expect("a matrix");
        assert_eq!(read.dim(), self.dim());
        for ((row, column), &value) in read.indexed_iter() {
            assert_eq!(bits(value), self.bits(row, column) & mask, "[{row}, {column}]");
        }
    }
}

fuzz_target!(|written: Written| {
    let mut file = written.file();
    match written.kind {
        Kind::F2 => written.demand(&file, |value: f16| value.to_bits().into()),
        Kind::F4 => written.demand(&file, |value: f32| value.to_bits().into()),
        Kind::F8 => written.demand(&file, f64::to_bits),
        Kind::U1 => written.demand(&file, |value: u8| value.into()),
        Kind::I2 => written.demand(&file, |value: i16| (value as u16).into()),
        Kind::U2 => written.demand(&file, |value: u16| value.into()),
    }
    file.push(0);
    assert!(matches!(read_npy(&file), Err(NpyError::Length { .. })));
    file.truncate(file.len() - 2);
    assert!(read_npy(&file).is_err());
});
