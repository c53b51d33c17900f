"""Packs of traced maps keep levels and errors to the hundredth of a decibel, and so does the dataset that is made of maps.

The packs and the dataset of the repository are whole.
"""

import hashlib
import json
import lzma
import sys
from pathlib import Path

import numpy as np
import pytest

ROOT = Path(__file__).parents[2]
sys.path.insert(0, str(ROOT / "pipeline"))
import map_packs  # noqa: E402: a program of the pipeline

sys.path.insert(0, str(ROOT / "examples"))
import read_shards  # noqa: E402

sys.path.insert(0, str(ROOT / "datasets/sanjose-maps"))
from missing import split_of  # noqa: E402

DATASET = ROOT / "datasets/sanjose-1.0.0"
ABOUT = ROOT / "datasets/sanjose-maps/about.xz"
PACKS = sorted((ROOT / "datasets/sanjose-maps").glob("maps-*.xz"))


def traced(folder: Path, name: str, seed: int) -> dict[str, np.ndarray]:
    """A map of eight repeats, some of which reach some cells, as `sionna_trace.py` writes it."""
    random = np.random.default_rng(seed)
    repeats = 10 ** random.uniform(-16, -7, (8, 6, 6)) * (random.random((8, 6, 6)) < random.random((6, 6)))
    arrays = {"path_gain": repeats.mean(0), "path_gain_std_error": repeats.std(0, ddof=1) / np.sqrt(8),
              "path_gain_first_half": repeats[:4].mean(0)}
    arrays = {key: array.astype(np.float32) for key, array in arrays.items()}
    meta = {"location_id": name, "value_kind": "path_gain_linear", "no_path_value": 0.0, "repeats": 8}
    np.savez(folder / f"{name}.npz", **arrays, meta_json=np.frombuffer(json.dumps(meta).encode(), dtype=np.uint8))
    return arrays


def test_packed_maps_are_those_that_were_traced(tmp_path: Path) -> None:
    maps, out = tmp_path / "maps", tmp_path / "out"
    maps.mkdir()
    original = {name: traced(maps, name, seed) for seed, name in enumerate(["a", "b", "c"])}
    assert map_packs.pack(maps, tmp_path / "one.xz", []) == 3
    assert map_packs.unpack(tmp_path / "one.xz", out) == 3
    for name, arrays in original.items():
        with np.load(out / f"{name}.npz") as unpacked:
            mean, level = arrays["path_gain"].astype(float), unpacked["path_gain_db"]
            assert np.array_equal(np.isfinite(level), mean > 0)
            reached = mean > 0
            assert np.abs(level[reached] - 10 * np.log10(mean[reached])).max() < 0.0051
            error = 10 / np.log(10) * arrays["path_gain_std_error"][reached] / mean[reached]
            assert np.abs(unpacked["path_gain_db_std_error"][reached] - error).max() < 0.0101
            share = 10 ** ((unpacked["path_gain_db_first_half"][reached] - level[reached]) / 10) / 2
            assert np.abs(share - arrays["path_gain_first_half"][reached] / mean[reached] / 2).max() < 0.0041
            about = json.loads(unpacked["meta_json"].tobytes())
            assert (about["value_kind"], about["no_path_value"], about["repeats"]) == ("path_gain_db", "-inf", 8)


def test_what_is_packed_again_is_the_same_and_what_others_have_is_left_out(tmp_path: Path) -> None:
    maps, out = tmp_path / "maps", tmp_path / "out"
    maps.mkdir()
    traced(maps, "a", 1)
    first, again, second = (tmp_path / name for name in ("first.xz", "again.xz", "second.xz"))
    map_packs.pack(maps, first, [])
    map_packs.unpack(first, out)
    map_packs.pack(out, again, [])
    assert first.read_bytes() == again.read_bytes()
    traced(maps, "b", 2)
    assert map_packs.pack(maps, second, [first]) == 1
    assert [about["location_id"] for about in map_packs.metadata_of(map_packs.read_pack(second))] == ["b"]


def test_what_the_repository_keeps_is_small_and_agrees() -> None:
    """Packs hold what is traced after a release: there may be none."""
    kept = json.loads(lzma.decompress(ABOUT.read_bytes()))
    for path in PACKS:
        assert path.stat().st_size < 5_000_000
        pack = map_packs.read_pack(path)
        packed = map_packs.metadata_of(pack)
        shape = (len(packed), 121, 121)
        assert all(pack[name].shape == shape for name in ("path_gain_db", "std_error_db", "first_half_share"))
        kept += packed
    assert {about["licence"] for about in kept} == {"ODbL-1.0"}
    # What is judged on has eight repeats; some of what is learned from has two.
    repeats = {split: {about["repeats"] for about in kept if split_of(about["location_id"]) == split} for split in ("train", "val", "test")}
    assert repeats == {"train": {2, 8}, "val": {8}, "test": {8}}
    # One setting, and each map with the scene that it was traced from.
    same = ["max_depth", "diffraction", "refraction", "sionna_version", "materials", "osm_sha256", "wedge_table"]
    assert len({json.dumps([about[key] for key in same], sort_keys=True) for about in kept}) == 1
    assert all(about["samples_per_tx"] <= 12_500_000 for about in kept), "fewer where a few reach the farthest cell"
    assert len({about["scene_sha256"] for about in kept}) == len(kept)
    assert all(path.stat().st_size < 5_000_000 for path in DATASET.rglob("*"))


def test_no_tile_is_kept_twice() -> None:
    packed = [about["location_id"] for path in PACKS for about in map_packs.metadata_of(map_packs.read_pack(path))]
    ids = packed + [record["id"] for record in read_shards.records(DATASET)]
    assert len(ids) == len(set(ids)) >= 123


def test_the_maps_of_the_dataset_come_back_to_the_byte(tmp_path: Path) -> None:
    recorded = {record["id"]: record["provenance"]["radio_map"]["digest"] for record in read_shards.records(DATASET)}
    assert map_packs.unpack(DATASET, tmp_path, ABOUT) == len(recorded)
    for name, digest in recorded.items():
        content = (tmp_path / f"{name}.npz").read_bytes()
        assert {"bytes": len(content), "sha256": hashlib.sha256(content).hexdigest()} == digest, name


def test_a_dataset_of_other_maps_is_refused(tmp_path: Path) -> None:
    maps = tmp_path / "maps"
    maps.mkdir()
    traced(maps, "elsewhere", 1)
    assert map_packs.describe(maps, tmp_path / "about.xz") == 1
    with pytest.raises(SystemExit, match="is not among the maps of .*about.xz: give the file"):
        map_packs.unpack(DATASET, tmp_path / "out", tmp_path / "about.xz")
