"""`pipeline/sionna_trace.py` with Sionna itself: geometry, the contract of maps, resuming, killing, and the way to a dataset.

Scenes are made by hand, but for the last test, which takes central Helsinki from OpenStreetMap to a verified dataset with the
program that HOLESCOUT names. Run by `make test-sionna`. What is missing is an error, never a skipped test.
"""

import fcntl
import io
import json
import os
import re
import shutil
import signal
import subprocess
import sys
import time
from pathlib import Path
from typing import Any

import jsonschema
import numpy as np
import pytest
from hand_scene import HOUSE, TRIANGLE, XML, prism, write_scene

ROOT = Path(__file__).parents[2]
TRACE = ROOT / "pipeline/sionna_trace.py"
STATION = [-50.0, 70.0, 25.0]
SINGLE = ["--repeats", "1"]
FEW = ["--samples", "1e6", *SINGLE]
EXTRACT = ROOT / "fixtures/helsinki/helsinki.osm.pbf"


def trace(*arguments: object, status: int = 0) -> str:
    """Runs the program; returns what it wrote to standard error."""
    command = [sys.executable, str(TRACE), *map(str, arguments)]
    done = subprocess.run(command, capture_output=True, text=True, check=False)
    assert done.returncode == status, done.stderr
    return done.stderr


def load(path: Path) -> tuple[np.ndarray, dict[str, Any]]:
    """Path gain and metadata of a map."""
    with np.load(path, allow_pickle=False) as archive:
        assert set(archive.files) == {"path_gain", "meta_json"}
        return archive["path_gain"], json.loads(archive["meta_json"].tobytes())


def cells(size_m: float = 200.0, cell_m: float = 4.0) -> tuple[np.ndarray, np.ndarray]:
    """East and north of the centres of cells, row 0 in the south."""
    centres = (np.arange(round(size_m / cell_m)) + 0.5) * cell_m - size_m / 2
    return np.meshgrid(centres, centres)


@pytest.fixture(scope="module")
def traced(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """A directory with `scenes/one`, `scenes/two` (two base stations), and their `maps`."""
    root = tmp_path_factory.mktemp("traced")
    write_scene(root / "scenes/one", [STATION])
    write_scene(root / "scenes/two", [STATION, [90.0, -80.0, 8.0]])
    trace(root / "scenes", "--out", root / "maps", *FEW)
    return root


def copy(traced: Path, to: Path) -> Path:
    """The same, to be changed."""
    shutil.copytree(traced, to, dirs_exist_ok=True)
    return to


def test_row_0_is_south_and_column_0_west(traced: Path) -> None:
    path_gain, _ = load(traced / "maps/one.npz")
    east, north = cells()
    # Cells of 4 m that lie wholly within the house or the triangle.
    inside = (east > 22) & (east < 78) & (north > 42) & (north < 58)
    inside |= (east < -32) & (north > -48) & (north - east < 6)
    assert inside.sum() > 50
    assert (path_gain[inside] == 0).all(), "without refraction no path goes into a building"
    for other in (path_gain[::-1], path_gain[:, ::-1], path_gain.T, path_gain[::-1, ::-1]):
        assert (other[inside] > 0).any(), "a flipped map would not pass"
    # East of the long house, seen from the base station, lies its shadow; the same place in the west is lit.
    shadow = (east > 84) & (north > 36) & (north < 44)
    assert path_gain[shadow].max() < 0.1 * path_gain[shadow[:, ::-1]].min()


def test_levels_are_those_of_free_space_in_the_open(traced: Path) -> None:
    path_gain, meta = load(traced / "maps/one.npz")
    east, north = cells()
    distance = np.sqrt((east - STATION[0]) ** 2 + (north - STATION[1]) ** 2 + (STATION[2] - meta["rx_height_m"]) ** 2)
    excess_db = 10 * np.log10(path_gain / (299_792_458.0 / meta["frequency_hz"] / (4 * np.pi * distance)) ** 2,
                              where=path_gain > 0, out=np.full_like(distance, np.nan))
    open_ground = (east < 0) & (north > 0)
    # The direct path and the one from the ground, added as powers: between 0 and 3 dB.
    assert 0.0 < np.nanmedian(excess_db[open_ground]) < 3.0


def test_a_map_follows_the_contract(traced: Path) -> None:
    schema = json.loads((ROOT / "schemas/radio_map.v1.json").read_text())
    scene = json.loads((traced / "scenes/one/scene.json").read_text())
    path_gain, meta = load(traced / "maps/one.npz")
    jsonschema.validate(meta, schema)
    assert (path_gain.dtype, path_gain.shape) == (np.float32, (50, 50))
    assert meta["location_id"] == "one"
    assert meta["map_center_m"] == scene["center_m"]
    assert meta["crs"] == "EPSG:32635"
    assert meta["materials"] == {"buildings": "concrete 0.3 m", "ground": "medium_dry_ground"}
    assert meta["samples_per_tx"] == 1_000_000
    assert meta["sionna_version"] == "sionna-rt 2.2.0"
    assert (meta["refraction"], meta["diffraction"], meta["no_path_value"]) == (False, True, 0.0)


def test_several_base_stations_are_traced_as_if_alone(traced: Path) -> None:
    alone, _ = load(traced / "maps/one.npz")
    path_gain, meta = load(traced / "maps/two.npz")
    assert path_gain.shape == (2, 50, 50)
    assert meta["tx_position_m"] == [STATION, [90.0, -80.0, 8.0]]
    both = (alone > 0) & (path_gain[0] > 0)
    assert np.array_equal(alone > 0, path_gain[0] > 0)
    assert np.allclose(alone[both], path_gain[0][both], rtol=1e-3), "no more than the order of additions differs"
    brightest = np.unravel_index(path_gain[1].argmax(), (50, 50))
    assert np.hypot(cells()[0][brightest] - 90.0, cells()[1][brightest] + 80.0) < 8.0


def test_samples_follow_the_farthest_corner(tmp_path: Path) -> None:
    write_scene(tmp_path / "scenes/one", [[0.0, 0.0, 42.0]])
    told = trace(tmp_path / "scenes", "--out", tmp_path / "maps", *SINGLE)
    samples = load(tmp_path / "maps/one.npz")[1]["samples_per_tx"]
    # lambda = N A h / (4 pi (r^2 + h^2)^1.5), 10 at r = 100 sqrt(2) m, h = 40 m: N = 622,000.
    assert samples == 630_000
    assert "cap" not in told
    told = trace(tmp_path / "scenes", "--out", tmp_path / "maps", "--max-samples", "300000", "--overwrite", *SINGLE)
    assert load(tmp_path / "maps/one.npz")[1]["samples_per_tx"] == 300_000
    assert "cap of 3.0e+05" in told
    assert "leaves 4.8" in told


def test_a_run_goes_on_and_refuses_other_parameters(traced: Path, tmp_path: Path) -> None:
    root = copy(traced, tmp_path)
    before = (root / "maps/one.npz").stat().st_mtime_ns
    (root / "maps/two.npz").unlink()
    assert "1 maps traced, 1 kept" in trace(root / "scenes", "--out", root / "maps", *FEW)
    assert (root / "maps/one.npz").stat().st_mtime_ns == before
    told = trace(root / "scenes", "--out", root / "maps", *FEW, "--max-depth", 3, status=3)
    assert "one.npz was traced otherwise: max_depth 5 instead of 3" in told
    assert (root / "maps/one.npz").stat().st_mtime_ns == before

    # A building grows: other geometry is another scene, and only its map is replaced.
    shutil.rmtree(root / "scenes/one")
    write_scene(root / "scenes/one", [STATION], [prism(HOUSE[0], 21.0), prism(*TRIANGLE)])
    assert "scene_sha256" in trace(root / "scenes", "--out", root / "maps", *FEW, status=3)
    assert "1 maps traced, 1 kept" in trace(root / "scenes", "--out", root / "maps", *FEW, "--overwrite")
    (root / "maps/one.npz").write_bytes(b"PK")
    assert "is no map of this program" in trace(root / "scenes", "--out", root / "maps", *FEW, status=3)


def test_a_killed_run_leaves_whole_maps_only(tmp_path: Path) -> None:
    scenes, maps = tmp_path / "scenes", tmp_path / "maps"
    for name in "abc":
        write_scene(scenes / name, [STATION])
    command = [sys.executable, str(TRACE), str(scenes), "--out", str(maps), "--samples", "6e6", *SINGLE]
    with subprocess.Popen(command, stderr=subprocess.DEVNULL) as run:
        while run.poll() is None and not (maps / "a.npz").exists():
            time.sleep(0.02)
        time.sleep(0.2)
        run.send_signal(signal.SIGKILL)
    assert run.returncode == -signal.SIGKILL, "it was killed while it traced"
    there = sorted(path.name for path in maps.glob("*.npz"))
    assert there == ["a.npz"]
    load(maps / "a.npz")
    # As a run leaves it that is killed while it writes.
    (maps / ".b.npz.part").write_bytes(b"half")
    assert "2 maps traced, 1 kept" in trace(scenes, "--out", maps, "--samples", "6e6", *SINGLE)
    assert sorted(path.name for path in maps.iterdir()) == ["a.npz", "b.npz", "c.npz"]


def test_tasks_trace_every_scene_once(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    scenes, maps = tmp_path / "scenes", tmp_path / "maps"
    for name in "abc":
        write_scene(scenes / name, [STATION])
    tasks = [scenes, "--out", maps, *FEW, "--task-count", 2]
    assert "3 scenes have no map: a, b, c" in trace(*tasks, "--merge", status=1)
    # As other runs leave it that were killed while they wrote; that of a task which may still run is left alone.
    for part in (".a.npz.task-0-of-2.part", ".b.npz.task-1-of-2.part", ".task-1-of-2.lock"):
        (maps / part).write_bytes(b"half")
    assert "2 maps traced, 0 kept" in trace(*tasks, "--task-index", 0)
    assert sorted(path.name for path in maps.iterdir()) == [".b.npz.task-1-of-2.part", ".task-1-of-2.lock", "a.npz", "c.npz"]
    assert "1 scenes have no map: b;" in trace(*tasks, "--merge", status=1)
    monkeypatch.setenv("JOB_COMPLETION_INDEX", "1")
    assert "1 maps traced, 0 kept" in trace(*tasks)
    assert "0 maps traced, 3 kept" in trace(*tasks, "--merge")
    assert sorted(path.name for path in maps.iterdir()) == ["a.npz", "b.npz", "c.npz"]
    for path in maps.iterdir():
        load(path)


def test_tasks_say_whether_trying_again_may_help(traced: Path, tmp_path: Path) -> None:
    root = copy(traced, tmp_path)
    tasks = [root / "scenes", "--out", root / "maps", *FEW, "--task-count", 2]
    for flags, why in [(["--task-index", 2], "task 2 of 2: tasks are counted from 0 to 1"), ([], "JOB_COMPLETION_INDEX"),
                       (["--task-index", "one"], "invalid int"), (["--task-index", 0, "--overwrite"], "--overwrite"),
                       (["--task-index", 0, "--max-depth", 3], "was traced otherwise")]:
        assert why in trace(*tasks, *flags, status=42)
    assert "--task-count is 'many', expected a number" in trace(*tasks[:-1], "many", status=42)
    assert "need --task-count" in trace(root / "scenes", "--out", root / "maps", "--merge", status=2)

    def busy(path: Path, kind: int, index: int, status: int) -> None:
        descriptor = os.open(path, os.O_RDWR | os.O_CREAT if path.suffix == ".lock" else os.O_RDONLY)
        fcntl.flock(descriptor, kind)
        told = trace(*tasks, "--task-index", index, status=status)
        assert ("another run writes to it" in told) == bool(status)
        os.close(descriptor)

    busy(root / "maps", fcntl.LOCK_EX, 0, 1)
    busy(root / "maps", fcntl.LOCK_SH, 0, 0)
    busy(root / "maps/.task-0-of-2.lock", fcntl.LOCK_EX, 0, 1)
    busy(root / "maps/.task-0-of-2.lock", fcntl.LOCK_EX, 1, 0)


def test_open_ground_is_traced(tmp_path: Path) -> None:
    ground = re.sub(r'  <shape type="ply" id="mesh-buildings">.*?</shape>\n', "", XML, flags=re.DOTALL)
    write_scene(tmp_path / "scenes/open", [STATION], [], ground)
    trace(tmp_path / "scenes", "--out", tmp_path / "maps", *FEW)
    path_gain, meta = load(tmp_path / "maps/open.npz")
    assert (path_gain > 0).all()
    assert meta["materials"] == {"ground": "medium_dry_ground"}


def test_a_scene_that_fails_is_named_and_the_others_go_on(tmp_path: Path) -> None:
    scenes = tmp_path / "scenes"
    house, triangle = prism(*HOUSE), prism(*TRIANGLE)
    soup = (house[0][house[1].ravel()], np.arange(house[1].size).reshape(-1, 3))
    write_scene(scenes / "good", [STATION])
    write_scene(scenes / "inside", [[50.0, 50.0, 10.0]])
    write_scene(scenes / "soup", [STATION], [soup, triangle])
    write_scene(scenes / "low", [[0.0, 0.0, 1.0]])
    write_scene(scenes / "far", [[0.0, 201.0, 20.0]])
    write_scene(scenes / "merged", [STATION], xml=XML.replace(
        '<ref name="bsdf" id="mat-itu_medium_dry_ground"/>', '<ref name="bsdf" id="mat-itu_concrete"/>'))
    write_scene(scenes / "torn", [STATION])
    torn = scenes / "torn/buildings.ply"
    torn.write_bytes(torn.read_bytes()[:-40])
    write_scene(scenes / "lost", [STATION])
    (scenes / "lost/buildings.ply").unlink()
    told = trace(scenes, "--out", tmp_path / "maps", *FEW, status=1)
    for name, why in {"inside": "10.0 m below its roof", "soup": "36 of 60 edges have no", "low": "is not above the receivers at 2.0 m", "far": "outside of the scene",
                      "merged": "expected the materials", "torn": "RuntimeError", "lost": "FileNotFoundError"}.items():
        assert re.search(f"^{name} failed: .*({why})", told, re.MULTILINE), told
    assert "1 maps traced, 0 kept, 7 scenes failed" in told
    assert [path.name for path in (tmp_path / "maps").iterdir()] == ["good.npz"]


def test_wrong_input_ends_the_run_before_anything_is_traced(traced: Path, tmp_path: Path) -> None:
    root = copy(traced, tmp_path)
    scenes, maps = root / "scenes", root / "maps"
    trace(scenes, "--out", maps, "--samples", "1e10", status=2)
    assert "no scene three" in trace(scenes, "--out", maps, "--only", "one", "three", status=3)
    assert "found none" in trace(maps, "--out", root / "other", status=3)
    descriptor = os.open(maps, os.O_RDONLY)
    fcntl.flock(descriptor, fcntl.LOCK_EX)
    assert "another run writes to it" in trace(scenes, "--out", maps, *FEW, status=3)
    os.close(descriptor)
    (scenes / ".holescout-build.jsonl").touch()
    assert "is not finished" in trace(scenes, "--out", maps, *FEW, status=3)


def test_another_version_of_sionna_is_refused(traced: Path, tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    other = tmp_path / "sionna_rt-2.1.0.dist-info"
    other.mkdir()
    (other / "METADATA").write_text("Metadata-Version: 2.1\nName: sionna-rt\nVersion: 2.1.0\n")
    monkeypatch.setenv("PYTHONPATH", str(tmp_path))
    told = trace(traced / "scenes", "--out", tmp_path / "maps", status=3)
    assert "expected sionna-rt 2.2.0, found 2.1.0" in told


def test_the_last_line_is_for_machines(traced: Path) -> None:
    command = [sys.executable, TRACE, traced / "scenes", "--out", traced / "maps", *FEW, "--json"]
    last = subprocess.run(command, capture_output=True, text=True, check=True).stdout.splitlines()[-1]
    summary = json.loads(last)
    assert (summary["stage"], summary["traced"], summary["kept"], summary["failed"]) == ("sionna_trace", 0, 2, {})


def holescout(*arguments: object) -> dict[str, Any]:
    """Runs the program that HOLESCOUT names; returns its report."""
    binary = os.environ.get("HOLESCOUT") or pytest.fail("set HOLESCOUT to the program", pytrace=False)
    command = [binary, "--config", ROOT / "fixtures/helsinki/holescout.toml", *arguments, "--json"]
    done = subprocess.run(list(map(str, command)), capture_output=True, text=True, check=False)
    assert done.returncode == 0, done.stderr
    return json.loads(done.stdout.splitlines()[-1])


def test_from_openstreetmap_to_a_verified_dataset(tmp_path: Path) -> None:
    tiles, scenes, maps = tmp_path / "tiles", tmp_path / "scenes", tmp_path / "maps"
    holescout("rasterise", "--osm", EXTRACT, "--out", tiles)
    holescout("scenes", "--osm", EXTRACT, "--tiles", tiles, "--out", scenes, "--placement", "roof")
    descriptions = [json.loads(path.read_text()) for path in sorted(scenes.glob("*/scene.json"))]
    ident = max(descriptions, key=lambda scene: scene["solids"])["id"]
    trace(scenes, "--out", maps, "--only", ident, "--samples", "2e7", *SINGLE)
    path_gain, meta = load(maps / f"{ident}.npz")
    assert path_gain.shape == (121, 121)
    assert 0.05 < (path_gain == 0).mean() < 0.95, "buildings are empty, streets are not"
    with np.load(io.BytesIO((tiles / f"{ident}.npz").read_bytes())) as tile:
        heights = tile["height_m"]
    # Cells that lie wholly within buildings of the height grid (row 0 north) are those that nothing reaches.
    crop = (heights.shape[0] - 484) // 2
    covered = (heights[crop:-crop, crop:-crop] >= meta["rx_height_m"]).reshape(121, 4, 121, 4).all(axis=(1, 3))[::-1]
    assert covered.sum() > 1000
    assert (path_gain[covered] == 0).mean() > 0.99
    assert (path_gain[~covered] == 0).mean() < 0.9

    assert holescout("import-rsrp", "--maps", maps, "--tiles", tiles, "--out", tmp_path / "rsrp")["imported"] == 1
    holescout("shard", "--tiles", tiles, "--rsrp", tmp_path / "rsrp", "--out", tmp_path / "dataset")
    holescout("verify", tmp_path / "dataset")

    # The same map as people spoil maps; each is rejected for just that.
    near = min(
        (other["id"] for other in descriptions if other["id"] != ident),
        key=lambda other: np.hypot(*(np.subtract(place(other), place(ident)))),
    )
    with np.errstate(divide="ignore"):
        decibels = 10 * np.log10(path_gain)
    watts = path_gain * 10 ** ((meta["tx_power_dbm"] - 30) / 10)
    dbm = {"value_kind": "rss_dbm", "no_path_value": 0.0}
    easting, northing = place(near)
    mistakes = {
        "flipped": ("wrong_orientation", "path_gain", path_gain[::-1], {}),
        "transposed": ("wrong_orientation", "path_gain", path_gain.T, {}),
        "decibels_called_linear": ("wrong_value_kind", "path_gain", decibels, {"no_path_value": "-inf"}),
        "watts_called_dbm": ("wrong_value_kind", "rss_dbm", watts, dbm),
        "shifted": ("shifted", "path_gain", np.roll(path_gain, 3, axis=1), {}),
        "of_the_next_tile": (
            "wrong_tile", "path_gain", path_gain, {"location_id": near, "map_center_m": [easting, northing]},
        ),
    }
    for mistake, (code, name, values, change) in mistakes.items():
        spoiled = tmp_path / mistake
        spoiled.mkdir()
        text = np.frombuffer(json.dumps(meta | change).encode(), dtype=np.uint8)
        np.savez(spoiled / "map.npz", meta_json=text, **{name: values.astype(np.float32)})
        told = holescout("import-rsrp", "--maps", spoiled, "--tiles", tiles, "--out", spoiled / "rsrp")
        assert told["rejected_by_code"] == {code: 1}, mistake


def place(ident: str) -> tuple[float, float]:
    """Easting and northing of a tile, from its name."""
    easting, northing = re.fullmatch(r"utm\d\d[ns]_e(-?\d+)_n(-?\d+)", ident).groups()
    return float(easting), float(northing)
