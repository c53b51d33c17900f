"""Reads the shards of a dataset with msgpack, zstandard and NumPy; no code of Holescout is needed.

    python read_shards.py DATASET_OR_SHARD ...

`records(path)` gives the records one after the other, in the order in which they are stored, and holds one at a time.
"""

import argparse
import io
from collections.abc import Iterator
from pathlib import Path

import msgpack
import numpy as np
import zstandard

ARRAYS = ("height_m", "rsrp_dbm", "mask")


def shards(path: Path, split: str = "*") -> list[Path]:
    """The shards of a dataset's directory (of one split, if you like), or the shard itself."""
    return sorted(path.glob(f"{split}/shard-*.msgpack.zst")) if path.is_dir() else [path]


def records(path: Path, split: str = "*") -> Iterator[dict]:
    """Records with their arrays, [row, column], row 0 north, column 0 west."""
    for shard in shards(Path(path), split):
        with open(shard, "rb") as file:
            # A shard is one Zstandard frame a record; the table at its end is skipped by every decoder.
            stream = zstandard.ZstdDecompressor().stream_reader(file, read_across_frames=True)
            for record in msgpack.Unpacker(stream, max_buffer_size=2**28):
                for key in ARRAYS:
                    record[key] = np.load(io.BytesIO(record[key]), allow_pickle=False)
                yield record


def holes(record: dict, threshold_dbm: float = -100.0) -> np.ndarray:
    """Coverage holes: outdoor cells below the threshold, those that no path reaches included."""
    return (record["mask"] != 1) & ((record["mask"] == 2) | (record["rsrp_dbm"] < threshold_dbm))


def main() -> None:
    parser = argparse.ArgumentParser(description="Lists the records of datasets or shards.")
    parser.add_argument("paths", nargs="+", type=Path, metavar="DATASET_OR_SHARD")
    parser.add_argument("--threshold", type=float, default=-100.0, metavar="DBM", help="coverage holes lie below it [%(default)s]")
    arguments = parser.parse_args()
    for path in arguments.paths:
        for record in records(path):
            outdoor = (record["mask"] != 1).sum()
            share = holes(record, arguments.threshold).sum() / max(outdoor, 1)
            print(record["id"], record["split"], *record["rsrp_dbm"].shape, f"{100 * share:.1f} % holes", sep="\t")


if __name__ == "__main__":
    main()
