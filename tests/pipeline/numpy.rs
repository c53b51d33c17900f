//! `.npy` and `.npz` files made and read by hand, so that byte order, memory order and element type
//! are the test's choice and the product's own reader is not used to check itself.

use std::collections::BTreeMap;
use std::io::{Cursor, Read, Write};
use std::path::Path;

use half::f16;
use ndarray::{Array2, ShapeBuilder};
use serde_json::Value;
use zip::write::SimpleFileOptions;
use zip::{CompressionMethod, ZipArchive, ZipWriter};

use super::read;

/// A floating-point type.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub(crate) enum Float {
    F2,
    F4,
    F8,
}

/// How an array lies in a file.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub(crate) struct Layout {
    pub(crate) float: Float,
    pub(crate) big_endian: bool,
    pub(crate) fortran: bool,
    /// Shape [1, n, n] instead of [n, n].
    pub(crate) leading_axis: bool,
}

impl Layout {
    /// Little-endian, C order, two axes.
    pub(crate) fn plain(float: Float) -> Self {
        Self { float, big_endian: false, fortran: false, leading_axis: false }
    }
}

/// An `.npy` file from its parts, which need not fit each other.
pub(crate) fn npy_raw(descr: &str, fortran: bool, shape: &str, data: &[u8]) -> Vec<u8> {
    let fortran = if fortran { "True" } else { "False" };
    let header = format!("{{'descr': {descr}, 'fortran_order': {fortran}, 'shape': {shape}, }}");
    // Magic, version and length take 10 bytes; all of it is padded to 64.
    let padded = (header.len() + 11).next_multiple_of(64) - 10;
    let mut bytes = b"\x93NUMPY\x01\x00".to_vec();
    bytes.extend(u16::try_from(padded).expect("a short header").to_le_bytes());
    bytes.extend(format!("{header:<width$}\n", width = padded - 1).bytes());
    bytes.extend(data);
    bytes
}

/// An `.npy` file of a matrix.
pub(crate) fn npy(values: &Array2<f64>, layout: Layout) -> Vec<u8> {
    let (rows, columns) = values.dim();
    let size = match layout.float {
        Float::F2 => 2,
        Float::F4 => 4,
        Float::F8 => 8,
    };
    let mut data = Vec::with_capacity(size * values.len());
    let mut push = |value: f64| {
        match layout.float {
            Float::F2 => data.extend(f16::from_f64(value).to_le_bytes()),
            Float::F4 => data.extend((value as f32).to_le_bytes()),
            Float::F8 => data.extend(value.to_le_bytes()),
        }
        if layout.big_endian {
            let start = data.len() - size;
            data[start..].reverse();
        }
    };
    if layout.fortran {
        values.t().iter().for_each(|&value| push(value));
    } else {
        values.iter().for_each(|&value| push(value));
    }
    let order = if layout.big_endian { '>' } else { '<' };
    let shape = if layout.leading_axis {
        format!("(1, {rows}, {columns})")
    } else {
        format!("({rows}, {columns})")
    };
    npy_raw(&format!("'{order}f{size}'"), layout.fortran, &shape, &data)
}

/// An `.npy` file of bytes: how text travels in an `.npz`.
pub(crate) fn npy_text(text: &[u8]) -> Vec<u8> {
    npy_raw("'|u1'", false, &format!("({},)", text.len()), text)
}

/// A ZIP of `<name>.npy` members.
pub(crate) fn npz(members: &[(&str, Vec<u8>)], method: CompressionMethod) -> Vec<u8> {
    let options = SimpleFileOptions::default().compression_method(method);
    let mut archive = ZipWriter::new(Cursor::new(Vec::new()));
    for (name, bytes) in members {
        let begun = archive.start_file(format!("{name}.npy"), options);
        begun.expect("a member begins");
        archive.write_all(bytes).expect("written to memory");
    }
    archive.finish().expect("written to memory").into_inner()
}

/// The members of an `.npz` without `.npy`, as they lie there.
pub(crate) fn npz_members(path: &Path) -> BTreeMap<String, Vec<u8>> {
    let mut archive = ZipArchive::new(Cursor::new(read(path))).expect("a ZIP");
    (0..archive.len())
        .map(|index| {
            let mut member = archive.by_index(index).expect("a member");
            let name = member.name().expect("a plain name").into_owned();
            let name = name.strip_suffix(".npy").expect("an array").to_owned();
            let mut bytes = Vec::new();
            member.read_to_end(&mut bytes).expect("unpacked");
            (name, bytes)
        })
        .collect()
}

/// The content of an `.npy` file without its header.
pub(crate) fn npy_content(bytes: &[u8]) -> &[u8] {
    &bytes[10 + usize::from(u16::from_le_bytes([bytes[8], bytes[9]]))..]
}

/// A little-endian matrix in C order.
pub(crate) fn matrix(bytes: &[u8]) -> Array2<f64> {
    let data = npy_content(bytes);
    let header = String::from_utf8_lossy(&bytes[10..bytes.len() - data.len()]).into_owned();
    let (_, shape) = header.split_once("'shape': (").expect("a shape");
    let (shape, _) = shape.split_once(')').expect("a shape");
    let extents: Vec<usize> =
        shape.split(',').map(|extent| extent.trim().parse().expect("a number")).collect();
    let values: Vec<f64> = if header.contains("'<f4'") {
        let four = data.chunks_exact(4);
        four.map(|b| f32::from_le_bytes([b[0], b[1], b[2], b[3]]).into()).collect()
    } else if header.contains("'<f2'") {
        let two = data.chunks_exact(2);
        two.map(|b| f16::from_le_bytes([b[0], b[1]]).into()).collect()
    } else {
        assert!(header.contains("'|u1'"), "float16, float32 or uint8: {header}");
        data.iter().map(|&byte| byte.into()).collect()
    };
    let shape = (extents[0], extents[1]).set_f(header.contains("True"));
    Array2::from_shape_vec(shape, values).expect("as many values as the shape says")
}

/// The `meta_json` of an `.npz`.
pub(crate) fn meta_json(path: &Path) -> Value {
    let members = npz_members(path);
    serde_json::from_slice(npy_content(&members["meta_json"])).expect("JSON")
}

/// Replaces a text in bytes, in ASCII or in UTF-32 of either byte order.
pub(crate) fn replaced(bytes: &[u8], from: &str, to: &str) -> Vec<u8> {
    let mut bytes = bytes.to_vec();
    let encodings: [fn(u8) -> Vec<u8>; 3] =
        [|byte| vec![byte], |byte| vec![byte, 0, 0, 0], |byte| vec![0, 0, 0, byte]];
    for encode in encodings {
        let (from, to): (Vec<u8>, Vec<u8>) =
            (from.bytes().flat_map(encode).collect(), to.bytes().flat_map(encode).collect());
        let Some(last) = bytes.len().checked_sub(from.len()) else {
            continue;
        };
        for at in 0..=last {
            if bytes[at..at + from.len()] == from[..] {
                bytes[at..at + to.len()].copy_from_slice(&to);
            }
        }
    }
    bytes
}
