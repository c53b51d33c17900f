"""Keeps traced maps in few small files: levels and errors in hundredths of a decibel, as records of a dataset have them.

    map_packs.py pack MAPS PACK.xz [--beside PACK.xz ...]   packs the maps of a directory that the other packs lack
    map_packs.py unpack PACK.xz ... --out MAPS              writes them as maps for `holescout import-rsrp`
    map_packs.py describe MAPS ABOUT.xz                     keeps what the maps say of themselves
    map_packs.py unpack DATASET --about ABOUT.xz --out MAPS writes the maps that became the records of a dataset

A record of a dataset with cells of 4 m is its map, but for what the map says of itself: whoever keeps the dataset and that need not
keep the maps. What a record lacks, levels inside of buildings and an error where there is no level, is lost; so a dataset that is made of
maps which came back gives the same maps again, to the byte.

Only maps of several repeats (`sionna_trace.py`) are packed. A pack is an `.npz` of n maps, compressed as a whole with LZMA:

- `path_gain_db`: int16 `[n, rows, columns]`, path gain in 0.01 dB; -32768 where no path arrives;
- `std_error_db`: uint16, its standard error in 0.01 dB, at least 1 where there is one;
- `first_half_share`: uint8, of the summed power what the first half of the repeats received, in 1/250;
- `meta_json`: a list of n metadata (schema radio_map.v1) as UTF-8 in uint8.

A level that is unpacked differs from the one that was traced by 0.005 dB at most. What is unpacked and packed again is the same.
Maps are written without compression, whose bytes would depend on the version of zlib.
"""

import argparse
import io
import json
import lzma
import sys
from pathlib import Path

import numpy as np
from sionna_files import write_map

sys.path.insert(0, str(Path(__file__).parents[1] / "examples"))

STEPS, SHARES, NO_PATH = 100, 250, -32768
DB = 10 / np.log(10)


def read_pack(path: Path) -> dict[str, np.ndarray]:
    """The arrays of a pack."""
    with np.load(io.BytesIO(lzma.decompress(path.read_bytes()))) as archive:
        return dict(archive)


def metadata_of(pack: dict[str, np.ndarray]) -> list[dict]:
    """What the maps of a pack say of themselves."""
    return json.loads(pack["meta_json"].tobytes())


def levels_of(archive: dict[str, np.ndarray]) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
    """Path gain and its error in decibels, -inf and 0 where no path arrives, and the share of the first half."""
    if "path_gain_db" in archive:
        level, half = archive["path_gain_db"].astype(float), archive["path_gain_db_first_half"].astype(float)
        error, share = archive["path_gain_db_std_error"].astype(float), 10 ** ((half - np.where(np.isfinite(level), level, 0)) / 10) / 2
    else:
        mean = archive["path_gain"].astype(float)
        some = np.where(mean > 0, mean, 1)
        level = np.where(mean > 0, 10 * np.log10(some), -np.inf)
        error = DB * archive["path_gain_std_error"] / some
        share = archive["path_gain_first_half"] / some / 2
    reached = np.isfinite(level)
    return level, np.where(reached, error, 0), np.where(reached, np.clip(share, 0, 1), 0)


def hundredths(archive: dict[str, np.ndarray]) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
    """The three arrays as a pack has them."""
    level, error, share = levels_of(archive)
    reached = np.isfinite(level)
    packed = np.where(reached, np.round(np.where(reached, level, 0) * STEPS), NO_PATH).astype(np.int16)
    errors = np.maximum(np.round(error * STEPS), error > 0).astype(np.uint16)
    # A share that is neither none nor all, up to what float32 rounds, stays so.
    shares = np.clip(np.round(share * SHARES), share > 0, np.where(share < 1 - 1e-5, SHARES - 1, SHARES)).astype(np.uint8)
    return packed, errors, shares


def about(archive: dict[str, np.ndarray]) -> dict:
    """What a map says of itself once it is unpacked."""
    return json.loads(archive["meta_json"].tobytes()) | {"no_path_value": "-inf", "value_kind": "path_gain_db"}


def pack(maps: Path, path: Path, beside: list[Path]) -> int:
    """Packs what other packs lack; returns the number of maps."""
    known = {metadata["location_id"] for other in beside for metadata in metadata_of(read_pack(other))}
    arrays, metadata = [], []
    for file in sorted(maps.glob("*.npz")):
        if file.stem in known:
            continue
        with np.load(file) as archive:
            metadata.append(about(archive))
            arrays.append(hundredths(dict(archive)))
    if arrays:
        levels, errors, shares = (np.stack(one) for one in zip(*arrays, strict=True))
        text = np.frombuffer(json.dumps(metadata, sort_keys=True).encode(), dtype=np.uint8)
        buffer = io.BytesIO()
        np.savez(buffer, path_gain_db=levels, std_error_db=errors, first_half_share=shares, meta_json=text)
        part = path.with_suffix(".part")
        part.write_bytes(lzma.compress(buffer.getvalue(), preset=9))
        part.replace(path)
    return len(arrays)


def describe(maps: Path, path: Path) -> int:
    """Keeps the metadata of the maps of a directory; returns their number."""
    metadata = []
    for file in sorted(maps.glob("*.npz")):
        with np.load(file) as archive:
            metadata.append(about(archive))
    text = json.dumps(metadata, sort_keys=True, ensure_ascii=False).encode()
    part = path.with_suffix(".part")
    part.write_bytes(lzma.compress(text, preset=9))
    part.replace(path)
    return len(metadata)


def read_dataset(root: Path, kept: Path) -> dict[str, np.ndarray]:
    """The maps that became the records of a dataset, as a pack has them; `kept` is what `describe` wrote."""
    import read_shards  # noqa: PLC0415: needs msgpack and zstandard, which those who trace do not

    known = {metadata["location_id"]: metadata for metadata in json.loads(lzma.decompress(kept.read_bytes()))}
    arrays, metadata = [], []
    for record in read_shards.records(root):
        meta = known.get(record["id"])
        if meta is None or record["schema"] != "record.v2":
            lacking = "is not among the maps of" if meta is None else "has no errors, and no map in"
            raise SystemExit(f"{root}: record {record['id']} {lacking} {kept}: give the file that was kept with this dataset")
        power, flip = meta["tx_power_dbm"], slice(None, None, -1 if meta["row_order"] == "south_first" else 1)
        # A level that happens to be the floor has an error, unlike the floor where there is no level.
        reached = (record["rsrp_dbm"] != record["floor_dbm"]) | (record["std_error_db"] > 0)
        level = np.where(reached, np.round((record["rsrp_dbm"].astype(float) - power) * STEPS), NO_PATH).astype(np.int16)
        error = np.where(reached, np.round(record["std_error_db"].astype(float) * STEPS), 0).astype(np.uint16)
        share = np.where(reached, np.round(record["first_half_share"].astype(float) * SHARES), 0).astype(np.uint8)
        arrays.append((level[flip], error[flip], share[flip]))
        metadata.append(meta)
    levels, errors, shares = (np.stack(one) for one in zip(*arrays, strict=True))
    text = np.frombuffer(json.dumps(metadata).encode(), dtype=np.uint8)
    return dict(path_gain_db=levels, std_error_db=errors, first_half_share=shares, meta_json=text)


def unpack(path: Path, out: Path, kept: Path | None = None) -> int:
    """Writes the maps of a pack, or of a dataset; returns their number."""
    arrays = read_dataset(path, kept) if kept else read_pack(path)
    metadata = metadata_of(arrays)
    out.mkdir(parents=True, exist_ok=True)
    for at, meta in enumerate(metadata):
        packed, error, share = (arrays[name][at] for name in ("path_gain_db", "std_error_db", "first_half_share"))
        level = np.where(packed == NO_PATH, -np.inf, packed / STEPS)
        with np.errstate(divide="ignore"):
            half = level + 10 * np.log10(share * (2.0 / SHARES))
        values = {"path_gain_db": level, "path_gain_db_std_error": error / STEPS, "path_gain_db_first_half": half}
        values = {name: array.astype(np.float32) for name, array in values.items()}
        write_map(out / f"{meta['location_id']}.npz", values, meta, ".part", compress=False)
    return len(metadata)


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    commands = parser.add_subparsers(required=True)
    packing = commands.add_parser("pack")
    packing.add_argument("maps", type=Path)
    packing.add_argument("path", type=Path)
    packing.add_argument("--beside", type=Path, nargs="*", default=[])
    packing.set_defaults(run=lambda given: pack(given.maps, given.path, given.beside))
    unpacking = commands.add_parser("unpack")
    unpacking.add_argument("packs", type=Path, nargs="+")
    unpacking.add_argument("--about", type=Path)
    unpacking.add_argument("--out", type=Path, required=True)
    unpacking.set_defaults(run=lambda given: sum(unpack(path, given.out, given.about) for path in given.packs))
    describing = commands.add_parser("describe")
    describing.add_argument("maps", type=Path)
    describing.add_argument("path", type=Path)
    describing.set_defaults(run=lambda given: describe(given.maps, given.path))
    given = parser.parse_args()
    print(f"{given.run(given)} maps")


if __name__ == "__main__":
    main()
