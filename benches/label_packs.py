"""What the repository keeps of the study's traces: levels of outdoor cells in steps of 0.5 dB, a file for each repeat of a set.

A pack holds `ids` (JSON), `cells` (how many outdoor cells each tile has), `levels` (uint8, the tiles one behind the other, cells in the order
of rows from the north) and `costs` (JSON: wall and CPU seconds, load of the machine). Level 0: no path arrives. Level n: RSRP at 15 dBm per resource element in [-167.5 + n / 2, -167 + n / 2) dBm,
what is lower or higher counted to the last one; -100 dBm is the border of two, so that holes are exact. Arrays are stored as differences
to the same cells of the first pack of the study, which halves their size.

`tiles.npz` has the outdoor cells: ids, and a mask of 121 x 121 bits a tile, row 0 in the north.
"""

import json
import lzma
from collections.abc import Iterator
from pathlib import Path

import numpy as np

FOLDER = Path(__file__).parent / "labels"
POWER_DBM = 15.0
HOLE_DBM = -100.0
STEP_DB = 0.5
# Lower border of level 1.
LOWEST_DBM = HOLE_DBM - 134 * STEP_DB
FLIGHT_M = 2.0
GRID, FACTOR = 121, 4
REFERENCE = "w1e7-0"


def outdoor_of(height_grid: np.ndarray) -> np.ndarray:
    """Outdoor cells of a record, [121, 121], row 0 in the north, of a height grid at 1 m: no metre as high as a UAV flies."""
    begin = (height_grid.shape[0] - GRID * FACTOR) // 2
    window = height_grid[begin:begin + GRID * FACTOR, begin:begin + GRID * FACTOR]
    return window.reshape(GRID, FACTOR, GRID, FACTOR).max((1, 3)) < FLIGHT_M


def levels_of(path_gain: np.ndarray) -> np.ndarray:
    """Levels of path gains, linear."""
    with np.errstate(divide="ignore"):
        steps = np.floor((10 * np.log10(path_gain) + POWER_DBM - LOWEST_DBM) / STEP_DB)
    return np.where(path_gain > 0, np.clip(steps, 0, 254) + 1, 0).astype(np.uint8)


def path_gain_of(levels: np.ndarray, within: np.ndarray | float = 0.5) -> np.ndarray:
    """Path gain in the middle of levels, or elsewhere `within` them (0 to 1), linear; 0 where no path arrives."""
    rsrp_dbm = LOWEST_DBM + (levels.astype(float) - 1 + within) * STEP_DB
    return np.where(levels > 0, 10 ** ((rsrp_dbm - POWER_DBM) / 10), 0.0)


def save_tiles(masks: dict[str, np.ndarray], built: dict[str, float]) -> None:
    """Writes `tiles.npz`."""
    ids = json.dumps({tile: built[tile] for tile in masks}).encode()
    np.savez_compressed(FOLDER / "tiles.npz", ids=np.frombuffer(ids, dtype=np.uint8),
                        outdoor=np.packbits(np.array(list(masks.values())), axis=None))


def load_tiles() -> tuple[dict[str, np.ndarray], dict[str, float]]:
    """Outdoor cells and built share by tile."""
    with np.load(FOLDER / "tiles.npz") as archive:
        built = json.loads(archive["ids"].tobytes())
        bits = np.unpackbits(archive["outdoor"], count=len(built) * GRID * GRID).reshape(-1, GRID, GRID).astype(bool)
    return dict(zip(built, bits, strict=True)), built


def save_pack(name: str, levels: dict[str, np.ndarray], costs: dict[str, dict[str, float]], reference: dict[str, np.ndarray]) -> int:
    """Writes a pack; returns its bytes."""
    stored = [values - reference[tile] if reference else values for tile, values in levels.items()]
    head = json.dumps({"reference": bool(reference), "costs": costs, "cells": {tile: len(values) for tile, values in levels.items()}})
    path = FOLDER / f"{name}.xz"
    part = path.with_suffix(".part")
    part.write_bytes(lzma.compress(head.encode() + b"\n" + np.concatenate(stored).tobytes(), preset=9))
    part.replace(path)
    return path.stat().st_size


def pack_paths(name: str = "*") -> list[tuple[str, int, Path]]:
    """Set, repeat and file of all packs, or those of a set, in this order."""
    found = [(*path.stem.rsplit("-", 1), path) for path in FOLDER.glob(f"{name}-*.xz")]
    return sorted((of_set, int(repeat), path) for of_set, repeat, path in found)


def packed_tiles(path: Path) -> set[str]:
    """Tiles of a pack."""
    return set(json.loads(lzma.decompress(path.read_bytes()).partition(b"\n")[0])["cells"])


def load_pack(path: Path, reference: dict[str, np.ndarray]) -> tuple[dict[str, np.ndarray], dict[str, dict[str, float]]]:
    """Levels and costs by tile."""
    head, _, data = lzma.decompress(path.read_bytes()).partition(b"\n")
    described = json.loads(head)
    values, begin, levels = np.frombuffer(data, dtype=np.uint8), 0, {}
    for tile, count in described["cells"].items():
        levels[tile] = values[begin:begin + count] + (reference[tile] if described["reference"] else np.uint8(0))
        begin += count
    return levels, described["costs"]


def read_packs(name: str = "*") -> Iterator[tuple[str, dict[str, np.ndarray], dict[str, dict[str, float]]]]:
    """Set, levels and costs by tile of all packs, or those of a set, by set and repeat."""
    first = FOLDER / f"{REFERENCE}.xz"
    reference = load_pack(first, {})[0] if first.exists() else {}
    for of_set, _, path in pack_paths(name):
        yield of_set, *load_pack(path, reference)
