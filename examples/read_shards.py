"""Reads the shards of a dataset with msgpack, zstandard and NumPy; no code of Holescout is needed.

    python read_shards.py DATASET_OR_SHARD ...

`records(path)` gives the records one after the other, in the order in which they are stored, and holds one at a time.
Those of maps that were traced several times (schema record.v2) have errors: `hole_probability(record)`.
"""

import argparse
import io
from collections.abc import Iterator
from pathlib import Path

import msgpack
import numpy as np
import zstandard

ARRAYS = ("height_m", "rsrp_dbm", "mask", "std_error_db", "first_half_share")
# What record.v2 stores where no path arrives; its other levels and errors are hundredths, its shares 250ths.
NO_LEVEL = -32768


def shards(path: Path, split: str = "*") -> list[Path]:
    """The shards of a dataset's directory (of one split, if you like), or the shard itself."""
    return sorted(path.glob(f"{split}/shard-*.msgpack.zst")) if path.is_dir() else [path]


def records(path: Path, split: str = "*") -> Iterator[dict]:
    """Records with their arrays, [row, column], row 0 north, column 0 west; levels and errors in dBm and dB."""
    for shard in shards(Path(path), split):
        with open(shard, "rb") as file:
            # A shard is one Zstandard frame a record; the table at its end is skipped by every decoder.
            stream = zstandard.ZstdDecompressor().stream_reader(file, read_across_frames=True)
            for record in msgpack.Unpacker(stream, max_buffer_size=2**28):
                for key in ARRAYS:
                    if key in record:
                        record[key] = np.load(io.BytesIO(record[key]), allow_pickle=False)
                if record["schema"] == "record.v2":
                    in_decibels(record)
                yield record


def in_decibels(record: dict) -> None:
    """Integers of record.v2 to float32, as record.v1 has them."""
    level = record["rsrp_dbm"]
    record["rsrp_dbm"] = np.where(level == NO_LEVEL, np.float32(record["floor_dbm"]), level.astype(np.float32) / 100)
    record["std_error_db"] = record["std_error_db"].astype(np.float32) / 100
    if "first_half_share" in record:
        record["first_half_share"] = record["first_half_share"].astype(np.float32) / 250


def holes(record: dict, threshold_dbm: float = -100.0) -> np.ndarray:
    """Coverage holes: outdoor cells below the threshold, those that no path reaches included."""
    return (record["mask"] != 1) & ((record["mask"] == 2) | (record["rsrp_dbm"] < threshold_dbm))


def hole_probability(record: dict, threshold_dbm: float = -100.0) -> np.ndarray:
    """The chance that each cell is a coverage hole: 0 or 1 where no error is known."""
    chance = holes(record, threshold_dbm).astype(np.float64)
    if "std_error_db" not in record:
        return chance
    unsure = (record["mask"] == 0) & (record["std_error_db"] > 0)
    error = record["std_error_db"][unsure].astype(np.float64)
    chance[unsure] = student_t((threshold_dbm - record["rsrp_dbm"][unsure]) / error, record["repeats"] - 1)
    return chance


def student_t(t: np.ndarray, degrees: int) -> np.ndarray:
    """Distribution function of Student's t, as scipy.stats.t.cdf (Abramowitz and Stegun, 26.7.3 and 26.7.4)."""
    angle = np.arctan(t / np.sqrt(degrees))
    odd = degrees % 2
    term = np.cos(angle) if odd else np.ones_like(angle)
    total = np.zeros_like(angle)
    for n in range(1 + odd, degrees, 2):
        total += term
        term = term * n / (n + 1) * np.cos(angle) ** 2
    within = 2 / np.pi * (angle + np.sin(angle) * total) if odd else np.sin(angle) * total
    return (1 + within) / 2


def main() -> None:
    parser = argparse.ArgumentParser(description="Lists the records of datasets or shards.")
    parser.add_argument("paths", nargs="+", type=Path, metavar="DATASET_OR_SHARD")
    parser.add_argument("--threshold", type=float, default=-100.0, metavar="DBM", help="coverage holes lie below it [%(default)s]")
    arguments = parser.parse_args()
    for path in arguments.paths:
        for record in records(path):
            outdoor = max((record["mask"] != 1).sum(), 1)
            share = holes(record, arguments.threshold).sum() / outdoor
            columns = [record["id"], record["split"], *record["rsrp_dbm"].shape, f"{100 * share:.1f} % holes"]
            if "std_error_db" in record:
                chance = hole_probability(record, arguments.threshold)
                unsure = ((chance > 0.05) & (chance < 0.95) & (record["mask"] != 1)).sum() / outdoor
                columns.append(f"{100 * unsure:.1f} % unsure")
            print(*columns, sep="\t")


if __name__ == "__main__":
    main()
