//! NumPy's `.npy` format (NEP 1), read from files that may be hostile.
//!
//! The header is parsed strictly and compared with the size of the file *before*
//! anything is allocated; Python objects are never unpickled. Writing is left to
//! `ndarray-npy`.

#[cfg(feature = "build")]
use half::f16;
use ndarray::{Array, Array2, Dimension, ShapeBuilder};
#[cfg(feature = "build")]
use ndarray_npy::{WritableElement, WriteNpyExt};

const MAGIC: &[u8; 6] = b"\x93NUMPY";
/// NumPy pads headers to 64 bytes; the longest sensible one names a few dimensions.
const MAX_HEADER: usize = 4096;

/// Why an array cannot be read.
#[derive(Debug, Clone, thiserror::Error, PartialEq, Eq)]
#[non_exhaustive]
pub enum NpyError {
    /// The magic bytes are not NumPy's.
    #[error("not an .npy array: does not begin with \\x93NUMPY")]
    Magic,
    /// The header is damaged.
    #[error("damaged .npy header: {0}")]
    Header(String),
    /// Python objects: would have to be unpickled.
    #[error(
        "holds pickled Python objects, which are never loaded; save plain arrays with np.savez"
    )]
    Pickled,
    /// A type that no radio map or grid has.
    #[error(
        "element type {0:?} is not supported; expected float16, float32, float64, uint8, int16 or uint16"
    )]
    DType(String),
    /// Header and size of the data contradict each other.
    #[error("shape {shape:?} of {dtype} needs {expected} bytes, found {found}")]
    Length {
        /// From the header.
        shape: Vec<usize>,
        /// From the header.
        dtype: String,
        /// Bytes that shape and type need.
        expected: u64,
        /// Bytes that are there.
        found: u64,
    },
    /// Not the shape or type that this place demands.
    #[error("is {found}, expected {expected}")]
    Unexpected {
        /// What the header says.
        found: String,
        /// What was demanded.
        expected: String,
    },
}

/// Type of the elements, without their byte order.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub enum DType {
    /// IEEE half precision.
    #[cfg(feature = "build")]
    Float16,
    /// IEEE single precision.
    Float32,
    /// IEEE double precision.
    Float64,
    /// Unsigned byte.
    UInt8,
    /// Signed integer of two bytes.
    Int16,
    /// Unsigned integer of two bytes.
    UInt16,
    /// Fixed-length text of one byte a character (`S`).
    Bytes(usize),
    /// Fixed-length text of four bytes a character (`U`).
    Unicode(usize),
}

impl DType {
    /// Bytes of an element.
    #[must_use]
    pub fn size(self) -> usize {
        match self {
            #[cfg(feature = "build")]
            Self::Float16 => 2,
            Self::Int16 | Self::UInt16 => 2,
            Self::Float32 => 4,
            Self::Float64 => 8,
            Self::UInt8 => 1,
            Self::Bytes(length) => length,
            Self::Unicode(length) => length.saturating_mul(4),
        }
    }

    /// NumPy's name.
    #[must_use]
    pub fn name(self) -> &'static str {
        match self {
            #[cfg(feature = "build")]
            Self::Float16 => "float16",
            Self::Float32 => "float32",
            Self::Float64 => "float64",
            Self::UInt8 => "uint8",
            Self::Int16 => "int16",
            Self::UInt16 => "uint16",
            Self::Bytes(_) => "bytes",
            Self::Unicode(_) => "text",
        }
    }
}

/// An array as it lies in a file: header and raw data, checked against each other.
#[derive(Debug, Clone, PartialEq, Eq)]
pub struct Npy<'a> {
    /// Type of the elements.
    pub dtype: DType,
    /// Whether elements are stored with the most significant byte first.
    pub big_endian: bool,
    /// Whether the first index runs fastest.
    pub fortran_order: bool,
    /// Extent of each axis.
    pub shape: Vec<usize>,
    data: &'a [u8],
}

/// A Rust type of array elements.
pub trait Element: Copy {
    /// The type in files.
    const DTYPE: DType;
    /// Decodes one element of that type.
    fn decode(bytes: &[u8], big_endian: bool) -> Self;
}

macro_rules! element {
    ($type:ty, $dtype:expr) => {
        impl Element for $type {
            const DTYPE: DType = $dtype;
            fn decode(bytes: &[u8], big_endian: bool) -> Self {
                let bytes = bytes.try_into().expect("chunks have the size of the type");
                if big_endian { Self::from_be_bytes(bytes) } else { Self::from_le_bytes(bytes) }
            }
        }
    };
}
#[cfg(feature = "build")]
element!(f16, DType::Float16);
element!(f32, DType::Float32);
element!(f64, DType::Float64);
element!(u8, DType::UInt8);
element!(i16, DType::Int16);
element!(u16, DType::UInt16);

/// Parses an `.npy` file that lies in memory; nothing is copied.
///
/// # Errors
/// [`NpyError`] says which part is wrong.
pub fn read_npy(bytes: &[u8]) -> Result<Npy<'_>, NpyError> {
    let damaged = |what: &str| NpyError::Header(what.to_owned());
    if bytes.get(..6) != Some(MAGIC) {
        return Err(NpyError::Magic);
    }
    let version = *bytes.get(6).ok_or_else(|| damaged("ends after the magic bytes"))?;
    let (length, start) = match (version, bytes.get(8..10), bytes.get(8..12)) {
        (1, Some(&[a, b]), _) => (usize::from(u16::from_le_bytes([a, b])), 10),
        (2 | 3, _, Some(&[a, b, c, d])) => (u32::from_le_bytes([a, b, c, d]) as usize, 12),
        (1..=3, ..) => return Err(damaged("ends within the header's length")),
        _ => {
            return Err(NpyError::Header(format!("version {version}, expected 1, 2 or 3")));
        }
    };
    if length > MAX_HEADER {
        return Err(NpyError::Header(format!(
            "{length} bytes long, at most {MAX_HEADER} expected"
        )));
    }
    let text = bytes.get(start..start + length).ok_or_else(|| damaged("ends within the header"))?;
    let text = std::str::from_utf8(text).map_err(|_| damaged("not UTF-8"))?;
    let data = &bytes[start + length..];

    let (mut descr, mut fortran_order, mut shape) = (None, None, None);
    for (key, value) in dictionary(text)? {
        match key {
            "descr" => descr = Some(value),
            "fortran_order" => fortran_order = Some(parse_bool(value)?),
            "shape" => shape = Some(parse_shape(value)?),
            other => return Err(NpyError::Header(format!("unknown key {other:?}"))),
        }
    }
    let descr = descr.ok_or_else(|| damaged("no 'descr'"))?;
    let (dtype, big_endian) = parse_descr(descr)?;
    let fortran_order = fortran_order.ok_or_else(|| damaged("no 'fortran_order'"))?;
    let shape: Vec<usize> = shape.ok_or_else(|| damaged("no 'shape'"))?;
    // A zero must not hide how large the other extents are: indices are computed from them.
    let size = dtype.size() as u64;
    let expected = shape
        .iter()
        .try_fold(size.max(1), |product, &extent| product.checked_mul(extent.max(1) as u64))
        .filter(|&bytes| isize::try_from(bytes).is_ok())
        .map(|bytes| if size == 0 || shape.contains(&0) { 0 } else { bytes })
        .ok_or_else(|| NpyError::Header(format!("shape {shape:?} is larger than any memory")))?;
    if expected != data.len() as u64 {
        let (dtype, found) = (dtype.name().to_owned(), data.len() as u64);
        return Err(NpyError::Length { shape, dtype, expected, found });
    }
    Ok(Npy { dtype, big_endian, fortran_order, shape, data })
}

impl Npy<'_> {
    /// All values as float64 in the order of the file; text has none.
    #[must_use]
    pub fn values_f64(&self) -> Vec<f64> {
        match self.dtype {
            #[cfg(feature = "build")]
            DType::Float16 => self.decode::<f16, f64>(f64::from),
            DType::Float32 => self.decode::<f32, f64>(f64::from),
            DType::Float64 => self.decode::<f64, f64>(|value| value),
            DType::UInt8 => self.decode::<u8, f64>(f64::from),
            DType::Int16 => self.decode::<i16, f64>(f64::from),
            DType::UInt16 => self.decode::<u16, f64>(f64::from),
            DType::Bytes(_) | DType::Unicode(_) => Vec::new(),
        }
    }

    /// One value as float64, by its place in the order of the file; text has none.
    #[must_use]
    pub fn value_f64(&self, index: usize) -> Option<f64> {
        let size = self.dtype.size();
        let bytes = self.data.get(index.checked_mul(size)?..)?.get(..size)?;
        match self.dtype {
            #[cfg(feature = "build")]
            DType::Float16 => Some(f16::decode(bytes, self.big_endian).to_f64()),
            DType::Float32 => Some(f32::decode(bytes, self.big_endian).into()),
            DType::Float64 => Some(f64::decode(bytes, self.big_endian)),
            DType::UInt8 => bytes.first().map(|&byte| byte.into()),
            DType::Int16 => Some(i16::decode(bytes, self.big_endian).into()),
            DType::UInt16 => Some(u16::decode(bytes, self.big_endian).into()),
            DType::Bytes(_) | DType::Unicode(_) => None,
        }
    }

    /// The text of an array of `uint8`, or of a single NumPy string, as UTF-8.
    #[must_use]
    pub fn text(&self) -> Option<Vec<u8>> {
        let unpadded = |bytes: &[u8]| {
            let length = bytes.iter().rposition(|&byte| byte != 0).map_or(0, |last| last + 1);
            bytes[..length].to_vec()
        };
        let single = self.shape.iter().all(|&extent| extent == 1);
        match self.dtype {
            DType::UInt8 => Some(self.data.to_vec()),
            DType::Bytes(_) if single => Some(unpadded(self.data)),
            DType::Unicode(_) if single => {
                let letters = self.data.chunks_exact(4).map(|bytes| {
                    let bytes = bytes.try_into().expect("chunks have four bytes");
                    char::from_u32(if self.big_endian {
                        u32::from_be_bytes(bytes)
                    } else {
                        u32::from_le_bytes(bytes)
                    })
                });
                Some(unpadded(letters.collect::<Option<String>>()?.as_bytes()))
            }
            _ => None,
        }
    }

    /// As a matrix of exactly this element type.
    ///
    /// # Errors
    /// [`NpyError::Unexpected`] if the type or the number of axes differs.
    pub fn to_array2<T: Element>(&self) -> Result<Array2<T>, NpyError> {
        let unexpected = || NpyError::Unexpected {
            found: format!("{} {:?}", self.dtype.name(), self.shape),
            expected: format!("{} with two axes", T::DTYPE.name()),
        };
        match self.shape[..] {
            [rows, columns] if self.dtype == T::DTYPE => {
                let shape = (rows, columns).set_f(self.fortran_order);
                let array = Array2::from_shape_vec(shape, self.decode(|value: T| value));
                Ok(array.expect("the length was checked against the shape"))
            }
            _ => Err(unexpected()),
        }
    }

    /// One loop for each order of bytes: for the machine's own the compiler makes a copy of it.
    fn decode<T: Element, U>(&self, of: impl Fn(T) -> U) -> Vec<U> {
        let elements = self.data.chunks_exact(T::DTYPE.size());
        if self.big_endian {
            elements.map(|bytes| of(T::decode(bytes, true))).collect()
        } else {
            elements.map(|bytes| of(T::decode(bytes, false))).collect()
        }
    }
}

#[cfg(feature = "build")]
/// The `.npy` file of an array, little-endian, C order.
#[must_use]
pub fn npy_bytes<A: WritableElement + Clone, D: Dimension>(array: &Array<A, D>) -> Vec<u8> {
    let mut bytes = Vec::with_capacity(128 + array.len() * size_of::<A>());
    array.as_standard_layout().write_npy(&mut bytes).expect("writing to memory cannot fail");
    bytes
}

/// The entries of the header's Python dictionary literal, which holds no nested dictionary
/// and no string with a quote or a comma outside of the shape.
fn dictionary(text: &str) -> Result<Vec<(&str, &str)>, NpyError> {
    let damaged = || NpyError::Header(format!("{text:?} is no dictionary of three entries"));
    let mut rest = text
        .trim()
        .strip_prefix('{')
        .and_then(|text| text.strip_suffix('}'))
        .ok_or_else(damaged)?
        .trim();
    let mut entries = Vec::new();
    while !rest.is_empty() {
        let (key, after) = rest.split_once(':').ok_or_else(damaged)?;
        let key = unquote(key).ok_or_else(damaged)?;
        let after = after.trim_start();
        let end = match after.as_bytes().first() {
            Some(b'(') => after.find(')').ok_or_else(damaged)? + 1,
            // Structured types are lists.
            Some(b'[') => after.rfind(']').ok_or_else(damaged)? + 1,
            _ => after.find(',').unwrap_or(after.len()),
        };
        entries.push((key, after[..end].trim()));
        let tail = after[end..].trim_start();
        rest = tail.strip_prefix(',').unwrap_or(tail).trim_start();
        if entries.len() > 3 {
            return Err(damaged());
        }
    }
    Ok(entries)
}

fn unquote(text: &str) -> Option<&str> {
    let text = text.trim();
    ['\'', '"'].into_iter().find_map(|quote| text.strip_prefix(quote)?.strip_suffix(quote))
}

fn parse_bool(value: &str) -> Result<bool, NpyError> {
    match value {
        "True" => Ok(true),
        "False" => Ok(false),
        _ => Err(NpyError::Header(format!("fortran_order is {value:?}"))),
    }
}

/// A tuple in Python's syntax: one extent needs a comma after it, none needs none.
fn parse_shape(value: &str) -> Result<Vec<usize>, NpyError> {
    let damaged = || NpyError::Header(format!("shape is {value:?}"));
    let inner =
        value.strip_prefix('(').and_then(|text| text.strip_suffix(')')).ok_or_else(damaged)?.trim();
    if inner.is_empty() {
        return Ok(vec![]);
    }
    let (extents, is_tuple) = match inner.strip_suffix(',') {
        Some(extents) => (extents, true),
        None => (inner, inner.contains(',')),
    };
    let extents = extents.split(',').map(|text| parse_count(text.trim()).filter(|_| is_tuple));
    extents.collect::<Option<_>>().ok_or_else(damaged)
}

/// A number in digits; that of the standard library may have a sign.
fn parse_count(text: &str) -> Option<usize> {
    text.bytes().all(|byte| byte.is_ascii_digit()).then(|| text.parse().ok()).flatten()
}

fn parse_descr(value: &str) -> Result<(DType, bool), NpyError> {
    let unsupported = || NpyError::DType(value.to_owned());
    let descr = unquote(value).ok_or_else(unsupported)?;
    let (order, kind) = descr.split_at_checked(1).ok_or_else(unsupported)?;
    let dtype = match kind {
        #[cfg(feature = "build")]
        "f2" => DType::Float16,
        "f4" => DType::Float32,
        "f8" => DType::Float64,
        "u1" => DType::UInt8,
        "i2" => DType::Int16,
        "u2" => DType::UInt16,
        "O" => return Err(NpyError::Pickled),
        _ => match kind.split_at_checked(1) {
            Some(("S", length)) => DType::Bytes(parse_count(length).ok_or_else(unsupported)?),
            Some(("U", length)) => DType::Unicode(parse_count(length).ok_or_else(unsupported)?),
            _ => return Err(unsupported()),
        },
    };
    match order {
        "<" | "|" => Ok((dtype, false)),
        ">" => Ok((dtype, true)),
        _ => Err(unsupported()),
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use ndarray::array;

    fn file(header: &str, data: &[u8]) -> Vec<u8> {
        let mut bytes = MAGIC.to_vec();
        bytes.extend([1, 0]);
        bytes.extend((header.len() as u16).to_le_bytes());
        bytes.extend(header.as_bytes());
        bytes.extend(data);
        bytes
    }

    #[test]
    fn what_ndarray_npy_writes_is_read_back() {
        let original = array![[1.0_f32, 2.0, 3.0], [4.0, 5.0, 6.0]];
        let bytes = npy_bytes(&original);
        assert_eq!(read_npy(&bytes).expect("valid").to_array2::<f32>(), Ok(original));
    }

    #[test]
    fn integers_of_two_bytes_are_read_in_either_byte_order() {
        let original = array![[-32768_i16, -1], [300, 32767]];
        let bytes = npy_bytes(&original);
        assert_eq!(read_npy(&bytes).expect("valid").to_array2::<i16>(), Ok(original));
        let header = "{'descr': '>u2', 'fortran_order': False, 'shape': (1, 2), }";
        let bytes = file(header, &[1, 0, 255, 255]);
        let read = read_npy(&bytes).expect("valid");
        assert_eq!(read.to_array2::<u16>(), Ok(array![[256, 65535]]));
        assert_eq!((read.values_f64(), read.value_f64(1)), (vec![256.0, 65535.0], Some(65535.0)));
    }

    #[test]
    fn byte_order_and_fortran_order_are_honoured() {
        let data: Vec<u8> = [1.0_f64, 2.0, 3.0, 4.0].iter().flat_map(|v| v.to_be_bytes()).collect();
        let bytes = file("{'descr': '>f8', 'fortran_order': True, 'shape': (2, 2), }", &data);
        let read = read_npy(&bytes).expect("valid");
        assert_eq!(read.to_array2::<f64>(), Ok(array![[1.0, 3.0], [2.0, 4.0]]));
    }

    /// Found by fuzzing: `(0, 2^63)` has no element, yet ndarray cannot make it; nor has text of no
    /// characters any bytes, however much there is of it.
    #[test]
    fn an_empty_array_hides_no_huge_extent() {
        let read = |descr: &str, shape: &str| {
            let header =
                format!("{{'descr': '{descr}', 'fortran_order': False, 'shape': {shape}, }}");
            let bytes = file(&header, &[]);
            read_npy(&bytes).and_then(|npy| npy.to_array2::<f32>())
        };
        for shape in ["(0, 9223372036854775808)", "(0, 18446744073709551615)"] {
            assert!(matches!(read("<f4", shape), Err(NpyError::Header(_))), "{shape}");
        }
        assert!(matches!(read("<f4", "(0, 4611686018427387904)"), Err(NpyError::Header(_))));
        assert_eq!(read("<f4", "(0, 7)"), Ok(Array2::zeros((0, 7))));
        for descr in ["<U1000000000", "<U0", "|S0"] {
            let text = read(descr, "(4611686018427387904, 4)");
            assert!(matches!(text, Err(NpyError::Header(_))), "{descr}");
        }
    }

    #[test]
    fn every_error_is_reachable() {
        let header = |descr: &str, shape: &str| {
            format!("{{'descr': {descr}, 'fortran_order': False, 'shape': {shape}, }}")
        };
        let error = |bytes: &[u8]| read_npy(bytes).expect_err("invalid");
        assert_eq!(error(b"PK\x03\x04"), NpyError::Magic);
        assert!(matches!(error(b"\x93NUMPY"), NpyError::Header(_)));
        assert!(matches!(error(b"\x93NUMPY\x09\x00\x00\x00"), NpyError::Header(_)));
        assert!(matches!(error(&file("{", &[])), NpyError::Header(_)));
        assert_eq!(error(&file(&header("'|O'", "()"), &[])), NpyError::Pickled);
        assert!(matches!(error(&file(&header("'<c8'", "(1,)"), &[0; 8])), NpyError::DType(_)));
        assert!(matches!(
            error(&file(&header("[('a', '<f4')]", "(1,)"), &[0; 4])),
            NpyError::DType(_)
        ));
        let lie = header("'<f4'", "(100000, 100000)");
        assert!(matches!(error(&file(&lie, &[0; 4])), NpyError::Length { .. }));
        let overflow = header("'<f4'", "(18446744073709551615, 2)");
        assert!(matches!(error(&file(&overflow, &[])), NpyError::Header(_)));
        for shape in ["(4)", "(+4,)", "(4,,1)", "(,4)", "(,)", "(4, -1)", "(4 1)", "4,", "(4,,)"] {
            assert!(matches!(error(&file(&header("'|u1'", shape), &[0; 4])), NpyError::Header(_)));
        }
        let vector = file(&header("'<f4'", "(1,)"), &[0; 4]);
        let unexpected = read_npy(&vector).expect("valid").to_array2::<f32>();
        assert!(matches!(unexpected, Err(NpyError::Unexpected { .. })));
    }
}
