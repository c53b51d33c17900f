#!/usr/bin/env python3
"""Writes fuzz/seeds from a radio map of the fixtures and a dataset made of them (`make fuzz-seeds`).

NumPy, msgpack and zstandard write the files, not Holescout: a seed shows how others write. Grids are cut to a few
cells, so that a mutation hits a header more often than a value.
"""

import io
import json
import shutil
import struct
import sys
import zipfile
from pathlib import Path

import msgpack
import numpy as np
import zstandard

MAP = Path("fixtures/helsinki/rsrp/utm35n_e385792_n6671744.npz")
CELLS = 3


def npy(array, version=(1, 0)):
    file = io.BytesIO()
    np.lib.format.write_array(file, np.asanyarray(array), version=version, allow_pickle=False)
    return file.getvalue()


def npz(save, **arrays):
    file = io.BytesIO()
    save(file, **arrays)
    return file.getvalue()


def streamed(arrays):
    """An archive as it is written to a pipe: sizes come after the data."""

    class Pipe(io.RawIOBase):
        data = b""

        def writable(self):
            return True

        def write(self, data):
            self.data += bytes(data)
            return len(data)

    pipe = Pipe()
    with zipfile.ZipFile(pipe, "w", zipfile.ZIP_DEFLATED) as archive:
        for name, array in arrays.items():
            archive.writestr(zipfile.ZipInfo(f"{name}.npy"), npy(array), zipfile.ZIP_DEFLATED)  # no time of day
    return pipe.data


def seekable(records):
    """A shard: frames, then their table (facebook/zstd, contrib/seekable_format)."""
    compressor = zstandard.ZstdCompressor(level=3, write_checksum=True)
    frames = [compressor.compress(record) for record in records]
    entries = b"".join(
        struct.pack("<II", len(frame), len(record)) + frame[-4:] for frame, record in zip(frames, records)
    )
    table = entries + struct.pack("<IBI", len(frames), 0x80, 0x8F92EAB1)
    return b"".join(frames) + struct.pack("<II", 0x184D2A5E, len(table)) + table


def small_record(record):
    def cut(array):
        return npy(np.load(io.BytesIO(array))[:CELLS, :CELLS])

    arrays = {key: cut(record[key]) for key in ("height_m", "rsrp_dbm", "mask")}
    return msgpack.packb({**record, **arrays})


def with_errors(record):
    """A small record as record.v2 has it: levels and errors as integers."""
    record = msgpack.unpackb(record)
    level = np.load(io.BytesIO(record["rsrp_dbm"]))
    there = np.load(io.BytesIO(record["mask"])) == 0
    arrays = {
        "rsrp_dbm": np.where(there, np.round(100 * level), -32768).astype(np.int16),
        "std_error_db": np.where(there, 125, 0).astype(np.uint16),
        "first_half_share": np.where(there, 130, 0).astype(np.uint8),
    }
    return msgpack.packb({**record, "schema": "record.v2", "repeats": 8, **{key: npy(value) for key, value in arrays.items()}})


def seeds(dataset):
    with np.load(MAP) as archive:
        gain = archive["path_gain_db"]
        text = archive["meta_json"].tobytes()
    metadata = json.loads(text)
    # The corner with most reached cells of a map that is mostly unreached.
    corner = max(((r, c) for r in range(0, 480, 20) for c in range(0, 480, 20)),
                 key=lambda at: np.isfinite(gain[at[0]:at[0] + CELLS, at[1]:at[1] + CELLS]).sum())
    gain = gain[corner[0]:corner[0] + CELLS, corner[1]:corner[1] + CELLS]
    linear = 10 ** (gain.astype(np.float64) / 10)

    yield "npy/float16", npy(gain)
    yield "npy/float32_fortran", npy(np.asfortranarray(linear.astype(np.float32)))
    yield "npy/float64_big_endian", npy(linear.astype(">f8"))
    yield "npy/one_transmitter_v2", npy(linear[np.newaxis], version=(2, 0))
    yield "npy/vector_v3", npy(linear[0], version=(3, 0))
    yield "npy/scalar", npy(np.float32(-100))
    yield "npy/empty", npy(np.zeros((0, 4), np.float32))
    yield "npy/int16", npy(np.array([[-32768, -1], [0, 32767]], np.int16))
    yield "npy/uint16_big_endian", npy(np.array([[0, 256], [257, 65535]], ">u2"))
    yield "npy/text_uint8", npy(np.frombuffer(b'{"a": 1}', np.uint8))
    yield "npy/text_bytes", npy(np.array(b'{"a": 1}'))
    yield "npy/text_unicode", npy(np.array('{"ä": 1}'))
    yield "npy/text_unicode_big_endian", npy(np.array('{"ä": 1}').astype(">U8"))

    arrays = {"path_gain_db": gain, "meta_json": np.frombuffer(text, np.uint8)}
    yield "npz/deflated", npz(np.savez_compressed, **arrays)
    yield "npz/stored", npz(np.savez, **arrays)
    yield "npz/streamed", streamed(arrays)
    yield "npz/empty", npz(np.savez)
    yield "npz/unnamed", npz(np.savez, arr_0=linear, meta_json=np.array(json.dumps(metadata)))

    yield "map/fixture", npz(np.savez_compressed, **arrays)
    yield "map/sionna", npz(np.savez, path_gain=linear.astype(np.float32)[np.newaxis])
    yield "map/large", npz(np.savez, rm=linear.astype(np.float32), tx_positions=np.array([[9.0], [8.0], [7.0]]))
    yield "map/text", npz(np.savez, rm=linear.astype(np.float32), tx_positions=np.array([[b"a"], [b"b"], [b"c"]]))
    two = metadata | {"value_kind": "path_gain_linear", "tx_position_m": [[0, 0, 9], [1, 2, 3]], "no_path_value": [0, "-inf", "nan"]}
    stacked = np.stack([linear, linear / 2], axis=-1)
    yield "map/two", npz(np.savez, path_gain=stacked, meta_json=np.array(json.dumps(two)))

    repeated = metadata | {"value_kind": "path_gain_linear", "no_path_value": 0, "repeats": 8, "direction_shift": "random"}
    yield "map/repeats", npz(np.savez, path_gain=linear, path_gain_std_error=linear / 4, path_gain_first_half=linear,
                             meta_json=np.array(json.dumps(repeated)))

    yield "metadata/fixture.json", text
    changes = {
        "total_power": {"tx_power_is": "total", "n_subcarriers": 1200, "crs": 32635},
        "special_value": {"no_path_value": "-inf", "value_kind": "path_gain_db", "schema": "radio_map.v1"},
        "exponents": {"samples_per_tx": 3e7, "max_depth": 5.0, "frequency_hz": 3.5e9, "no_path_value": -1e-300},
        "all_keys": {"materials": {"wall": ["itu_concrete", 0.3, None]}, "seed": 42, "osm_sha256": "00" * 32},
    }
    for name, change in changes.items():
        yield f"metadata/{name}.json", json.dumps(metadata | change).encode()

    records = []
    for shard in sorted(Path(dataset).glob("*/shard-*.msgpack.zst")):
        with open(shard, "rb") as file, zstandard.ZstdDecompressor().stream_reader(file, read_across_frames=True) as stream:
            records += list(msgpack.Unpacker(stream))[:2]
    records = [small_record(record) for record in records]
    for number, record in enumerate(records):
        yield f"record/{number}", record
        yield f"record/{number}_with_errors", with_errors(record)
    yield "seekable/records", seekable(records[:2])
    yield "seekable/small", seekable([b"one record", b"", b"another record"])
    yield "seekable/long", seekable([bytes(1 << 16)])
    yield "seekable/none", seekable([])

    # Bytes from which libFuzzer makes a value: that they differ is enough.
    yield "npy_exact/counting", bytes(range(96))


def main():
    dataset, out = sys.argv[1], Path(sys.argv[2])
    shutil.rmtree(out, ignore_errors=True)
    for name, content in seeds(dataset):
        path = out / name
        path.parent.mkdir(parents=True, exist_ok=True)
        path.write_bytes(content)


main()
