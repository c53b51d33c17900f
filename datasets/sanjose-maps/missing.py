"""Lists tiles of some splits that have no map yet, in the order of a hash of their names, so that any beginning is spread over the city.

    missing.py TILES MAPS SPLIT ...

A split is that of `holescout shard` by default: blocks of 4,096 m, drawn with seed 0, a tenth each for val and test.
"""

import csv
import hashlib
import sys
from pathlib import Path

BLOCK_M, SEED, VAL, TEST = 4096, 0, 0.1, 0.1
EPSG = 32610


def digest(text: str) -> str:
    return hashlib.sha256(text.encode()).hexdigest()


def split_of(tile: str) -> str:
    """The split that `src/dataset/split.rs` draws for a place."""
    easting, northing = (int(part[1:]) // BLOCK_M for part in tile.split("_")[1:])
    draw = (int(digest(f"{SEED} {EPSG} {easting} {northing}")[:16], 16) >> 11) / 2**53
    return "test" if draw < TEST else "val" if draw < TEST + VAL else "train"


def main() -> None:
    tiles, maps, splits = Path(sys.argv[1]), Path(sys.argv[2]), sys.argv[3:]
    with (tiles / "tiles.csv").open(newline="") as table:
        kept = [row["id"] for row in csv.DictReader(table) if row["verdict"] == "kept"]
    missing = [tile for tile in kept if split_of(tile) in splits and not (maps / f"{tile}.npz").exists()]
    for tile in sorted(missing, key=digest):
        print(tile)


if __name__ == "__main__":
    main()
