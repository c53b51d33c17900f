//! PBF files taken apart and put together again, to damage them in chosen places.

use std::io::Read;
use std::ops::Range;

use osmpbfreader::fileformat::{Blob, BlobHeader};
use osmpbfreader::osmformat::PrimitiveBlock;
use protobuf::Message;

/// Where the parts of one blob lie in a file.
#[derive(Debug, Clone)]
pub(crate) struct Frame {
    /// `OSMHeader` or `OSMData`.
    pub(crate) kind: String,
    /// The four bytes that hold the length of the header.
    pub(crate) length: Range<usize>,
    pub(crate) header: Range<usize>,
    pub(crate) blob: Range<usize>,
}

/// The frames of a sound file.
pub(crate) fn frames(file: &[u8]) -> Vec<Frame> {
    let mut frames = Vec::new();
    let mut at = 0;
    while at < file.len() {
        let length = at..at + 4;
        let four = file[length.clone()].try_into().expect("four bytes");
        let header = length.end..length.end + u32::from_be_bytes(four) as usize;
        let parsed = BlobHeader::parse_from_bytes(&file[header.clone()]).expect("a sound header");
        let size = usize::try_from(parsed.datasize()).expect("a sound size");
        let blob = header.end..header.end + size;
        at = blob.end;
        frames.push(Frame { kind: parsed.type_().to_owned(), length, header, blob });
    }
    frames
}

/// The content of a blob, decompressed.
pub(crate) fn content(file: &[u8], frame: &Frame) -> Vec<u8> {
    let mut blob = Blob::parse_from_bytes(&file[frame.blob.clone()]).expect("a sound blob");
    if blob.has_raw() {
        return blob.take_raw();
    }
    let mut bytes = Vec::new();
    flate2::read::ZlibDecoder::new(blob.zlib_data())
        .read_to_end(&mut bytes)
        .expect("sound zlib data");
    bytes
}

/// How the content of a blob is stored.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub(crate) enum Packing {
    Raw,
    Zlib,
}

/// A blob with its frame.
pub(crate) fn framed(kind: &str, content: &[u8], packing: Packing) -> Vec<u8> {
    let mut blob = Blob::new();
    match packing {
        Packing::Raw => blob.set_raw(content.to_vec()),
        Packing::Zlib => {
            let mut packed = Vec::new();
            flate2::read::ZlibEncoder::new(content, flate2::Compression::fast())
                .read_to_end(&mut packed)
                .expect("memory can be read");
            blob.set_raw_size(i32::try_from(content.len()).expect("a small block"));
            blob.set_zlib_data(packed);
        }
    }
    let blob = blob.write_to_bytes().expect("a complete message");
    let mut header = BlobHeader::new();
    header.set_type(kind.to_owned());
    header.set_datasize(i32::try_from(blob.len()).expect("a small blob"));
    let header = header.write_to_bytes().expect("a complete message");
    let length = u32::try_from(header.len()).expect("a small header");
    [&length.to_be_bytes()[..], &header, &blob].concat()
}

/// The same file without any compression, so that damage reaches what is inside.
pub(crate) fn unpacked(file: &[u8]) -> Vec<u8> {
    let raw = |frame: &Frame| framed(&frame.kind, &content(file, frame), Packing::Raw);
    frames(file).iter().flat_map(raw).collect()
}

/// The file with the content of one data blob (counted from 0) replaced.
pub(crate) fn with_content(file: &[u8], data_blob: usize, new: &[u8], packing: Packing) -> Vec<u8> {
    let frames = frames(file);
    let mut data = frames.iter().filter(|frame| frame.kind == "OSMData");
    let frame = data.nth(data_blob).expect("the file has such a blob");
    [&file[..frame.length.start], &framed("OSMData", new, packing), &file[frame.blob.end..]]
        .concat()
}

/// The file with every data block changed.
pub(crate) fn edited(file: &[u8], edit: impl Fn(&mut PrimitiveBlock)) -> Vec<u8> {
    let change = |frame: &Frame| {
        let bytes = content(file, frame);
        if frame.kind != "OSMData" {
            return framed(&frame.kind, &bytes, Packing::Raw);
        }
        let mut block = PrimitiveBlock::parse_from_bytes(&bytes).expect("a sound block");
        edit(&mut block);
        let bytes = block.write_to_bytes().expect("a complete message");
        framed(&frame.kind, &bytes, Packing::Zlib)
    };
    frames(file).iter().flat_map(change).collect()
}
