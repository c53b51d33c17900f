//! Event files of `TensorBoard`.
//!
//! A file is a sequence of records (`TFRecord`): length, checksum of the length, an `Event` in protocol
//! buffers, its checksum. The fields are those of `tensorflow/core/util/event.proto` and
//! `tensorflow/core/framework/summary.proto`.

use std::fs::File;
use std::io::Write;
use std::path::{Path, PathBuf};
use std::time::{SystemTime, UNIX_EPOCH};

use crate::error::FileError;

const VERSION: &str = "brain.Event:2";
/// Fields of `Event`.
const WALL_TIME: u8 = 1;
const STEP: u8 = 2;
const FILE_VERSION: u8 = 3;
const SUMMARY: u8 = 5;
const SESSION_LOG: u8 = 7;
/// `SessionLog.status = START`: what an earlier session wrote for later steps is void.
const STARTED: [u8; 2] = [1 << 3, 1];

/// A file that grows by scalars.
#[derive(Debug)]
pub(super) struct Events {
    path: PathBuf,
    file: File,
}

fn now() -> f64 {
    SystemTime::now().duration_since(UNIX_EPOCH).map_or(0.0, |since| since.as_secs_f64())
}

/// A number of variable length: seven bits a byte, the lowest first.
fn varint(out: &mut Vec<u8>, mut value: u64) {
    while value > 0x7f {
        out.push(value as u8 | 0x80);
        value >>= 7;
    }
    out.push(value as u8);
}

/// A field of bytes: text or another message.
fn bytes_field(out: &mut Vec<u8>, field: u8, bytes: &[u8]) {
    out.push(field << 3 | 2);
    varint(out, bytes.len() as u64);
    out.extend(bytes);
}

/// An `Event` with its time, a step, and one more field.
fn event(wall_time: f64, step: u64, field: u8, content: &[u8]) -> Vec<u8> {
    let mut out = vec![WALL_TIME << 3 | 1];
    out.extend(wall_time.to_le_bytes());
    out.push(STEP << 3);
    varint(&mut out, step);
    bytes_field(&mut out, field, content);
    out
}

/// A `Summary` of scalars.
fn summary(scalars: &[(&str, f64)]) -> Vec<u8> {
    let mut out = Vec::new();
    for (tag, value) in scalars {
        let mut one = Vec::new();
        bytes_field(&mut one, 1, tag.as_bytes());
        one.push(2 << 3 | 5);
        one.extend((*value as f32).to_le_bytes());
        bytes_field(&mut out, 1, &one);
    }
    out
}

/// The checksum of `TFRecord`: CRC-32C, turned so that it may itself be part of what is summed.
fn masked_crc(bytes: &[u8]) -> u32 {
    crc32c::crc32c(bytes).rotate_right(15).wrapping_add(0xa282_ead8)
}

fn record(data: &[u8]) -> Vec<u8> {
    let length = (data.len() as u64).to_le_bytes();
    let checksums = [masked_crc(&length), masked_crc(data)].map(u32::to_le_bytes);
    [&length[..], &checksums[0], data, &checksums[1]].concat()
}

impl Events {
    /// A new file in a directory, for a session that begins after an update.
    pub(super) fn create(directory: &Path, update: u64) -> Result<Self, FileError> {
        let (now, process) = (now(), std::process::id());
        let name = format!("events.out.tfevents.{:010}.holescout.{process}", now as u64);
        let path = directory.join(name);
        let file = File::create(&path).map_err(FileError::new("create", &path))?;
        let mut events = Self { path, file };
        events.write(&event(now, 0, FILE_VERSION, VERSION.as_bytes()))?;
        events.write(&event(now, update + 1, SESSION_LOG, &STARTED))?;
        Ok(events)
    }

    fn write(&mut self, data: &[u8]) -> Result<(), FileError> {
        self.file.write_all(&record(data)).map_err(FileError::new("write", &self.path))
    }

    /// Adds values of scalars after an update.
    pub(super) fn add(&mut self, update: u64, scalars: &[(&str, f64)]) -> Result<(), FileError> {
        self.write(&event(now(), update, SUMMARY, &summary(scalars)))
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    /// Bytes that `tensorboard.compat.proto` has for `Event(wall_time=1.5, step=300,
    /// summary=Summary(value=[Value(tag="loss", simple_value=0.25)]))`.
    #[test]
    fn events_are_protocol_buffers() {
        let expected = [
            &[0x09, 0, 0, 0, 0, 0, 0, 0xf8, 0x3f, 0x10, 0xac, 0x02, 0x2a, 0x0d, 0x0a, 0x0b][..],
            &[0x0a, 0x04],
            b"loss",
            &[0x15, 0, 0, 0x80, 0x3e],
        ];
        assert_eq!(event(1.5, 300, SUMMARY, &summary(&[("loss", 0.25)])), expected.concat());
    }

    /// RFC 3720, B.4: 32 bytes of zeros.
    #[test]
    fn checksums_are_masked() {
        let crc: u32 = 0x8a91_36aa;
        let expected = crc.rotate_left(17).wrapping_add(0xa282_ead8);
        assert_eq!(masked_crc(&[0; 32]), expected);
        assert_eq!(record(&[0; 32])[..8], 32_u64.to_le_bytes());
    }
}
