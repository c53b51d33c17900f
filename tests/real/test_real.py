"""Holescout on whole cities, against GDAL and PROJ. Run by `make test-real`.

Every test fails where the data or the program are missing; none is skipped.
"""

import csv
import json
import os
import re
import subprocess
import sys
from pathlib import Path

import numpy as np
import pytest

HERE = Path(__file__).parent
ROOT = HERE.parent.parent

# Parts off and one default height, as the independent reading in gdal_equality.py has it.
PLAIN_CONFIG = """
[grid]
spacing_m = {spacing}
[buildings]
parts = false
default_heights_m = {{}}
[filter]
min_buildings = 1
min_built = 0.0
"""

# Extract, spacing of tiles, number of tiles compared.
EXTRACTS = [
    ("sanjose_buildings", 512, 40),
    ("manhattan", 256, 15),
    ("helsinki", 256, 15),
    ("monaco", 256, 15),
    ("london", 256, 15),
]

# What each bad map is rejected for.
BAD_MAPS = {
    "bare_array_without_metadata.npy": "missing_metadata",
    "cell_size_contradicts_shape.npz": "cell_size_contradicts_shape",
    "db_labelled_linear.npz": "wrong_value_kind",
    "grid_270.npz": "misaligned_window",
    "linear_float16.npz": "unsupported_type",
    "nan_undeclared.npz": "nan_undeclared",
    "pickled_dict.npy": "pickled",
    "rows_flipped.npz": "wrong_orientation",
    "transposed.npz": "wrong_orientation",
    "two_transmitters.npz": "several_transmitters",
    "undersampled.npz": "undersampled",
    "unknown_location.npz": "unknown_location",
    "watts_called_dbm.npz": "wrong_value_kind",
}

# Mistakes that people make, the codes that name them, and the least share of San Jose's maps on which they must be found
# and named so. The next tile by name may lie too far away to be found: then its map fits none.
MISTAKES = {
    "flipped": ({"wrong_orientation"}, 0.99),
    "transposed": ({"wrong_orientation"}, 0.99),
    "shifted": ({"shifted"}, 0.99),
    "decibels_called_linear": ({"wrong_value_kind"}, 0.99),
    "watts_called_dbm": ({"wrong_value_kind"}, 1.0),
    "dbw_called_dbm": ({"wrong_value_kind"}, 0.98),
    "of_the_next_tile": ({"wrong_tile", "buildings_disagree"}, 0.97),
}


def path_from(variable: str) -> Path:
    path = Path(os.environ.get(variable, ""))
    assert os.environ.get(variable) and path.exists(), f"{variable} names nothing; use `make test-real`"
    return path


@pytest.fixture(scope="session")
def data() -> Path:
    return path_from("HOLESCOUT_DATA")


def holescout(*arguments: str | Path) -> dict:
    """Runs the program and returns its JSON summary."""
    command = [str(path_from("HOLESCOUT")), *map(str, arguments), "--json", "--quiet"]
    result = subprocess.run(command, capture_output=True, text=True, check=False)
    assert result.returncode == 0, result.stderr
    return json.loads(result.stdout.splitlines()[-1])


def script(name: str, *arguments: str | Path) -> str:
    result = subprocess.run(
        [sys.executable, HERE / name, *map(str, arguments)], capture_output=True, text=True, check=False
    )
    assert result.returncode == 0, result.stdout + result.stderr
    return result.stdout


@pytest.fixture(scope="session")
def sanjose(data: Path, tmp_path_factory: pytest.TempPathFactory) -> Path:
    """The San Jose dataset, built as a user would."""
    out = tmp_path_factory.mktemp("sanjose")
    subprocess.run(
        [
            "make", "dataset", f"OSM={data}/osm/sanjose_buildings.osm.pbf",
            f"RSRP={data}/rsrp/sanjose_4m", f"OUT={out}",
        ],
        cwd=ROOT,
        check=True,
    )
    return out


@pytest.mark.parametrize(("extract", "spacing", "tiles"), EXTRACTS)
def test_every_cell_equals_gdal(data: Path, tmp_path: Path, extract: str, spacing: int, tiles: int) -> None:
    config = tmp_path / "plain.toml"
    config.write_text(PLAIN_CONFIG.format(spacing=spacing))
    osm = data / "osm" / f"{extract}.osm.pbf"
    holescout("rasterise", "--config", config, "--osm", osm, "--out", tmp_path / "tiles")
    print(script("gdal_equality.py", "--tiles", tmp_path / "tiles", "--osm", osm,
                 "--max-tiles", tiles, "--seed", 1))


def test_utm_agrees_with_proj(tmp_path: Path) -> None:
    points = tmp_path / "points.csv"
    points.write_bytes(subprocess.check_output([ROOT / "target/debug/examples/utm_points"]))
    print(script("utm_pyproj.py", "--points", points))


def test_every_sanjose_map_is_a_record_or_rejected(data: Path, sanjose: Path) -> None:
    maps = {path.name for path in (data / "rsrp/sanjose_4m").glob("*.npz")}
    assert len(maps) > 500
    manifest = json.loads((sanjose / "rsrp/manifest.json").read_text())
    imported = {entry["source"]["file"] for entry in manifest["maps"]}
    with (sanjose / "rsrp/rejected.csv").open(newline="") as file:
        rejected = {row["file"] for row in csv.DictReader(file)}
    assert imported | rejected == maps and not imported & rejected
    assert not rejected, "all of these maps follow the contract"
    dataset = json.loads((sanjose / "dataset/manifest.json").read_text())
    dropped = dataset["dropped"]["overlapping_another_split"]
    assert len(dataset["records"]) + len(dropped) == len(imported)
    assert not dropped, "windows of 484 m every 512 m never overlap"
    assert set(dataset["statistics"]) == {"train", "val", "test"}


def test_the_cards_python_reads_every_record(sanjose: Path) -> None:
    """msgpack, zstandard and numpy alone, by the lines that the dataset card gives."""
    card = (sanjose / "dataset/README.md").read_text()
    snippet = re.search(r"```python\n(.*?)```", card, re.DOTALL)
    assert snippet
    names: dict = {}
    exec(snippet[1], names)  # noqa: S102: the card's own lines are what is tested
    manifest = json.loads((sanjose / "dataset/manifest.json").read_text())
    seen = set()
    for shard in manifest["shards"]:
        for record in names["records"](sanjose / "dataset" / shard["file"]):
            seen.add(record["id"])
            assert record["split"] == shard["split"]
            heights, rsrp, mask = record["height_m"], record["rsrp_dbm"], record["mask"]
            assert heights.shape == rsrp.shape == mask.shape == (121, 121)
            assert ((mask == 1) == (heights >= record["flight_height_m"])).all()
            assert (rsrp[mask == 2] == record["floor_dbm"]).all() and np.isfinite(rsrp).all()
    assert seen == {entry["id"] for entry in manifest["records"]}


def test_records_hold_the_maps_own_values(data: Path, sanjose: Path) -> None:
    """One map, from the file that Sionna wrote to the record, by numpy alone."""
    manifest = json.loads((sanjose / "dataset/manifest.json").read_text())
    for entry in manifest["records"][::50]:
        summary = holescout("inspect", sanjose / "dataset", "--id", entry["id"])
        source = np.load(data / "rsrp/sanjose_4m" / f"{entry['id']}.npz")
        meta = json.loads(bytes(source["meta_json"]))
        assert meta["row_order"] == "south_first" and meta["tx_power_is"] == "per_re"
        gain = np.flipud(source["path_gain"]).astype(np.float64)
        mask, rsrp = np.array(summary["mask"]), np.array(summary["rsrp_dbm"])
        assert (gain[mask == 0] > 0).all() and (gain[mask == 2] == 0).all()
        expected = 10 * np.log10(gain[mask == 0]) + meta["tx_power_dbm"]
        np.testing.assert_allclose(rsrp[mask == 0], expected, atol=1e-4)


def test_one_metre_maps_reach_the_same_grid(data: Path, sanjose: Path, tmp_path: Path) -> None:
    tiles, rsrp, dataset = sanjose / "tiles", tmp_path / "rsrp", tmp_path / "dataset"
    summary = holescout("import-rsrp", "--maps", data / "rsrp/sanjose_1m", "--tiles", tiles, "--out", rsrp)
    assert (summary["imported"], summary["rejected"]) == (6, 0)
    assert holescout("shard", "--tiles", tiles, "--rsrp", rsrp, "--out", dataset)["records"] == 6
    assert holescout("verify", dataset)["failures"] == []
    assert json.loads((dataset / "manifest.json").read_text())["cells"] == 121


def test_bad_maps_are_rejected_for_what_their_names_tell(data: Path, sanjose: Path, tmp_path: Path) -> None:
    rsrp = tmp_path / "rsrp"
    holescout("import-rsrp", "--maps", data / "rsrp/bad", "--tiles", sanjose / "tiles", "--out", rsrp)
    with (rsrp / "rejected.csv").open(newline="") as file:
        rows = list(csv.DictReader(file))
    assert {row["file"]: row["code"] for row in rows} == BAD_MAPS
    assert all(row["expected"] and row["found"] and row["mend"] for row in rows)


def spoiled(mistake: str, gain: np.ndarray, meta: dict, maps: list[Path]) -> tuple[str, np.ndarray, dict]:
    """Name of the array, values and metadata of a sound map (linear path gain, south first) after a mistake."""
    with np.errstate(divide="ignore"):
        decibels = 10 * np.log10(gain)
    match mistake:
        case "flipped":
            return "path_gain", gain[::-1], meta
        case "transposed":
            return "path_gain", gain.T, meta
        case "shifted":
            return "path_gain", np.roll(gain, 3, axis=0), meta
        case "decibels_called_linear":
            return "path_gain", decibels, meta | {"value_kind": "path_gain_linear", "no_path_value": "-inf"}
        case "watts_called_dbm":
            power = 10 ** ((meta["tx_power_dbm"] - 30) / 10)
            return "rss_dbm", gain * power, meta | {"value_kind": "rss_dbm"}
        case "dbw_called_dbm":
            dbw = decibels + meta["tx_power_dbm"] - 30
            return "rss_dbm", dbw, meta | {"value_kind": "rss_dbm", "no_path_value": "-inf"}
        case "of_the_next_tile":
            here = next(i for i, path in enumerate(maps) if path.stem == meta["location_id"])
            other = np.load(maps[(here + 1) % len(maps)])
            told = json.loads(bytes(other["meta_json"]))
            return "path_gain", other["path_gain"], meta | {"tx_position_m": told["tx_position_m"]}
    raise AssertionError(mistake)


@pytest.mark.parametrize("mistake", MISTAKES)
def test_common_mistakes_are_named_on_every_map(data: Path, sanjose: Path, tmp_path: Path, mistake: str) -> None:
    """Each mistake on every third map of San Jose: it is found, and called what it is, nearly everywhere."""
    maps = sorted((data / "rsrp/sanjose_4m").glob("*.npz"))
    (tmp_path / "maps").mkdir()
    for path in maps[::3]:
        with np.load(path) as sound:
            meta = json.loads(bytes(sound["meta_json"]))
            name, values, meta = spoiled(mistake, sound["path_gain"], meta, maps)
        text = np.frombuffer(json.dumps(meta).encode(), dtype=np.uint8)
        np.savez(tmp_path / "maps" / path.name, meta_json=text, **{name: values.astype(np.float32)})
    rsrp = tmp_path / "rsrp"
    summary = holescout("import-rsrp", "--maps", tmp_path / "maps", "--tiles", sanjose / "tiles", "--out", rsrp)
    codes, least = MISTAKES[mistake]
    named = sum(count for code, count in summary["rejected_by_code"].items() if code in codes)
    print(mistake, summary["rejected_by_code"], summary["imported"], "taken")
    assert named >= least * len(maps[::3]), summary


def test_tiles_are_readable_by_numpy(sanjose: Path) -> None:
    manifest = json.loads((sanjose / "tiles/manifest.json").read_text())
    tile = np.load(sanjose / "tiles" / manifest["tiles"][0]["file"])
    assert tile["height_m"].shape == (1080, 1080) and tile["height_m"].dtype == np.float32
    assert json.loads(bytes(tile["meta_json"]))["id"] == manifest["tiles"][0]["id"]
    assert ((tile["height_m"] > 0) == (tile["height_source"] > 0)).all()


def test_sanjose_has_the_papers_orderings(sanjose: Path, tmp_path: Path) -> None:
    """Section "Simulation Results" of the paper, on the test split."""
    methods = "rsp,bnp-32,bnp-16,bnp-8,g-rsp,g-rsp-continuous,g-bnp-8,random-walk,oracle"
    options = ["--out", tmp_path / "evaluation", "--methods", methods]
    summary = holescout("evaluate", "--dataset", sanjose / "dataset", *options)
    precision = {(score["method"], score["k"]): score["precision"]["mean"] for score in summary["scores"]}
    assert summary["maps"]["evaluated"] >= 100
    assert precision["bnp-8", 0] > precision["bnp-16", 0] > precision["bnp-32", 0] > precision["rsp", 0]
    for method in ("g-rsp", "g-rsp-continuous", "g-bnp-8", "random-walk", "oracle"):
        rising = [precision[method, k] for k in (0, 1, 2, 4, 8)]
        assert all(less < more for less, more in zip(rising, rising[1:], strict=False)), method
    # More is gained by the second step than by two more.
    gain = [precision["g-rsp", b] - precision["g-rsp", a] for a, b in ((1, 2), (2, 4))]
    assert gain[0] > gain[1]


def test_what_learns_from_the_train_split_beats_walls_and_is_ordered_by_what_it_knows(sanjose: Path, tmp_path: Path) -> None:
    options = ["--methods", "wall-walk,trees,belief,trees-told-bs,leave-one-out", "--starts", "20", "--steps", "2"]
    summary = holescout("evaluate", "--dataset", sanjose / "dataset", "--out", tmp_path / "evaluation", *options)
    precision = {score["method"]: score["precision"]["mean"] for score in summary["scores"]}
    rising = [precision[method] for method in ("wall-walk", "trees", "trees-told-bs", "leave-one-out")]
    assert all(less + 0.02 < more for less, more in zip(rising, rising[1:], strict=False)), precision
    assert precision["trees"] < precision["belief"] < precision["trees-told-bs"], precision


def test_neighbourhoods_find_no_more_than_they_hold(sanjose: Path, tmp_path: Path) -> None:
    """The paper's recall curves: with many starts BNP ends below RSP, the lower the narrower."""
    options = ["--methods", "rsp,bnp-32,bnp-16,bnp-8,g-bnp-8", "--starts", "20000", "--bootstrap", "100"]
    summary = holescout("evaluate", "--dataset", sanjose / "dataset", "--out", tmp_path / "evaluation", *options)
    recall = {(score["method"], score["k"]): score["recall"]["mean"] for score in summary["scores"]}
    assert recall["rsp", 0] == pytest.approx(1.0), "every outdoor cell is a start"
    assert 1.0 > recall["bnp-32", 0] > recall["bnp-16", 0] > recall["bnp-8", 0]
    # Bound to the same cells, descent finds no other holes.
    assert recall["g-bnp-8", 8] == pytest.approx(recall["bnp-8", 0])
