//! A ZIP archive of members that are deflated already (APPNOTE 6.3.10, without ZIP64), with no clock and no owner.

use super::deflate::Deflated;

/// Deflate, and the version that knows it; made by Unix.
const DEFLATED: u16 = 8;
const VERSION: u16 = 20;
const UNIX: u16 = 3 << 8;
/// 1 January 1980, the first day that there is.
const FIRST_DAY: u16 = 0x21;
/// A regular file that all may read.
const PERMISSIONS: u32 = 0o100_644 << 16;

/// The bytes of an `.npz` with members `<name>.npy`, in the given order.
///
/// # Panics
/// If the archive is larger than 4 GiB.
pub(crate) fn npz_of_deflated(members: &[(&str, Deflated)]) -> Vec<u8> {
    let (mut archive, mut directory) = (Vec::new(), Vec::new());
    for (name, Deflated { bytes, crc32, length }) in members {
        let name = format!("{name}.npy");
        let offset = small(archive.len());
        let mut entry = Vec::new();
        put16(&mut entry, &[VERSION, 0, DEFLATED, 0, FIRST_DAY]);
        put32(&mut entry, &[*crc32, small(bytes.len()), small(*length)]);
        put16(&mut entry, &[name.len() as u16, 0]);

        archive.extend(b"PK\x03\x04");
        archive.extend(&entry);
        archive.extend(name.as_bytes());
        archive.extend(bytes);

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
    use crate::store::deflate::{ArrayFormat, Deflater, Segment, StripWriter, deflate_small};
    use crate::store::{NpzReader, npy_bytes, read_npy};

    #[test]
    fn archives_are_read_back_by_the_strict_reader() {
        let grid = npy_bytes(&Array2::<f32>::zeros((50, 70)));
        let text = npy_bytes(&ndarray::Array1::from_vec(b"{}".to_vec()));
        let format = ArrayFormat::new(grid[..128].to_vec(), 4, 70, &[70]);
        let mut strip = StripWriter::new(&format, 70);
        (0..50).for_each(|_| strip.row(&[Segment { end: 70, value: [0; 4] }]));
        let strip = strip.finish();
        let mut heights = Deflater::new(&format);
        (0..50).for_each(|row| heights.add(&strip, row));
        let members = [("height_m", heights.finish()), ("meta_json", deflate_small(&text))];
        let bytes = npz_of_deflated(&members);
        let mut archive = NpzReader::new(Cursor::new(&bytes), 1 << 20).expect("an archive");
        assert_eq!(archive.names(), ["height_m", "meta_json"]);
        assert_eq!(archive.member("height_m").expect("sound"), grid);
        let text = archive.metadata("meta_json").expect("sound");
        assert_eq!(read_npy(&text).expect("an array").text().as_deref(), Some(&b"{}"[..]));
        assert!(bytes.len() < 800, "{}", bytes.len());
    }
}
