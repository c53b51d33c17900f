//! A ZIP archive of members that are deflated already (APPNOTE 6.3.10, without ZIP64), with no clock and no owner.

use super::deflate::deflate_runs;

/// Deflate, and the version that knows it; made by Unix.
const DEFLATED: u16 = 8;
const VERSION: u16 = 20;
const UNIX: u16 = 3 << 8;
/// 1 January 1980, the first day that there is.
const FIRST_DAY: u16 = 0x21;
/// A regular file that all may read.
const PERMISSIONS: u32 = 0o100_644 << 16;

/// An array as `.npy`, and how its numbers lie: the bytes of an element, and of a row.
#[derive(Debug, Clone, Copy)]
pub(crate) struct Runs<'a> {
    pub(crate) npy: &'a [u8],
    pub(crate) header: usize,
    pub(crate) element: usize,
    pub(crate) row: usize,
}

/// The bytes of an `.npz` with members `<name>.npy`, in the given order, whose arrays consist of runs.
///
/// # Panics
/// If the archive is larger than 4 GiB.
pub(crate) fn npz_of_runs(members: &[(&str, Runs<'_>)]) -> Vec<u8> {
    let (mut archive, mut directory) = (Vec::new(), Vec::new());
    for &(name, Runs { npy, header, element, row }) in members {
        let name = format!("{name}.npy");
        let deflated = deflate_runs(npy, header, element, row);
        let offset = small(archive.len());
        let mut entry = Vec::new();
        put16(&mut entry, &[VERSION, 0, DEFLATED, 0, FIRST_DAY]);
        put32(&mut entry, &[crc32fast::hash(npy), small(deflated.len()), small(npy.len())]);
        put16(&mut entry, &[name.len() as u16, 0]);

        archive.extend(b"PK\x03\x04");
        archive.extend(&entry);
        archive.extend(name.as_bytes());
        archive.extend(deflated);

        directory.extend(b"PK\x01\x02");
        put16(&mut directory, &[UNIX | VERSION]);
        directory.extend(&entry);
        // No comment, the first disk, binary.
        put16(&mut directory, &[0, 0, 0]);
        put32(&mut directory, &[PERMISSIONS, offset]);
        directory.extend(name.as_bytes());
    }
    let (offset, count) = (small(archive.len()), members.len() as u16);
    let size = small(directory.len());
    archive.extend(directory);
    archive.extend(b"PK\x05\x06");
    put16(&mut archive, &[0, 0, count, count]);
    put32(&mut archive, &[size, offset]);
    put16(&mut archive, &[0]);
    archive
}

fn small(bytes: usize) -> u32 {
    u32::try_from(bytes).expect("less than 4 GiB")
}

fn put16(out: &mut Vec<u8>, numbers: &[u16]) {
    out.extend(numbers.iter().flat_map(|number| number.to_le_bytes()));
}

fn put32(out: &mut Vec<u8>, numbers: &[u32]) {
    out.extend(numbers.iter().flat_map(|number| number.to_le_bytes()));
}

#[cfg(test)]
mod tests {
    use std::io::Cursor;

    use ndarray::Array2;

    use super::*;
    use crate::store::{NpzReader, npy_bytes, read_npy};

    #[test]
    fn archives_are_read_back_by_the_strict_reader() {
        let grid =
            Array2::from_shape_fn((50, 70), |(row, column)| ((row / 9 + column / 11) % 3) as f32);
        let grid = npy_bytes(&grid);
        let text = npy_bytes(&ndarray::Array1::from_vec(b"{}".to_vec()));
        let bytes = npz_of_runs(&[
            ("height_m", Runs { npy: &grid, header: 128, element: 4, row: 280 }),
            ("meta_json", Runs { npy: &text, header: text.len(), element: 1, row: 1 }),
        ]);
        let mut archive = NpzReader::new(Cursor::new(&bytes), 1 << 20).expect("an archive");
        assert_eq!(archive.names(), ["height_m", "meta_json"]);
        assert_eq!(archive.member("height_m").expect("sound"), grid);
        let text = archive.metadata("meta_json").expect("sound");
        assert_eq!(read_npy(&text).expect("an array").text().as_deref(), Some(&b"{}"[..]));
        assert!(bytes.len() < 1500, "{}", bytes.len());
    }
}
