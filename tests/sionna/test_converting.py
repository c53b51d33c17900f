"""The snippets of docs/CONVERTING.md, run as they stand, and what `holescout import-rsrp` makes of their maps.

HOLESCOUT names the program. What is missing is an error, never a skipped test.
"""

import json
import os
import re
import subprocess
import sys
from pathlib import Path
from typing import Any

import h5py
import numpy as np
import pytest
import scipy.io

ROOT = Path(__file__).parents[2]
HELSINKI = ROOT / "fixtures/helsinki"
TILE = "utm35n_e385920_n6672000"
SNIPPETS = dict(re.findall(r"<!-- run: (\S+) -->\n```python\n(.*?)```", (ROOT / "docs/CONVERTING.md").read_text(), re.DOTALL))


def holescout(*arguments: object) -> dict[str, Any]:
    """Runs the program that HOLESCOUT names; returns its report."""
    binary = os.environ.get("HOLESCOUT") or pytest.fail("set HOLESCOUT to the program", pytrace=False)
    command = [binary, "--config", HELSINKI / "holescout.toml", *arguments, "--json"]
    return json.loads(subprocess.run(list(map(str, command)), capture_output=True, text=True, check=True).stdout.splitlines()[-1])


@pytest.fixture(scope="module")
def tiles(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """Tiles of Helsinki."""
    out = tmp_path_factory.mktemp("helsinki") / "tiles"
    holescout("rasterise", "--osm", HELSINKI / "helsinki.osm.pbf", "--out", out)
    return out


def run(folder: Path, code: str) -> None:
    """Runs the metadata's snippet and another one in a folder."""
    (folder / "maps").mkdir()
    (folder / "snippet.py").write_text(SNIPPETS["all"] + code)
    subprocess.run([sys.executable, "snippet.py"], cwd=folder, check=True)


def imported(maps: Path, tiles: Path, out: Path) -> np.ndarray:
    """RSRP of the one map of a folder after its import."""
    report = holescout("import-rsrp", "--maps", maps, "--tiles", tiles, "--out", out)
    assert (report["imported"], report["rejected"]) == (1, 0), (out / "rejected.csv").read_text()
    with np.load(out / f"{TILE}.npz") as archive:
        return archive["rsrp_dbm"]


@pytest.mark.parametrize("name", ["map.h5", "map_v7.mat", "map_v73.mat"])
def test_a_converted_map_is_imported_as_the_original_is(name: str, tiles: Path, tmp_path: Path) -> None:
    original = HELSINKI / f"rsrp/{TILE}.npz"
    with np.load(original) as archive:
        values = archive["path_gain_db"].astype(np.float32)
    if name == "map_v7.mat":
        scipy.io.savemat(tmp_path / name, {"path_gain_db": values})
    else:
        # MATLAB writes the transpose of what it shows.
        with h5py.File(tmp_path / name, "w") as file:
            file["path_gain_db"] = values.T if name == "map_v73.mat" else values
    run(tmp_path, SNIPPETS[name])
    (tmp_path / "original").mkdir()
    (tmp_path / "original" / original.name).write_bytes(original.read_bytes())
    expected = imported(tmp_path / "original", tiles, tmp_path / "expected")
    assert np.array_equal(imported(tmp_path / "maps", tiles, tmp_path / "rsrp"), expected, equal_nan=True)


def test_a_map_of_ones_own_script_is_imported(tiles: Path, tmp_path: Path) -> None:
    """With metadata of its own, and without any by what the document tells to assume."""
    scenes = tmp_path / "scenes"
    holescout("scenes", "--osm", HELSINKI / "helsinki.osm.pbf", "--tiles", tiles, "--out", scenes, "--placement", "roof")
    position = json.loads((scenes / TILE / "scene.json").read_text())["base_stations"][0]["position_m"]
    prepare = f"""
import sys
sys.path.insert(0, {str(ROOT / "pipeline")!r})
from sionna_trace import start_sionna
start_sionna(None)
from sionna.rt import PlanarArray, Transmitter, load_scene
scene = load_scene({str(scenes / TILE / "scene.xml")!r})
scene.frequency = 3.5e9
scene.tx_array = PlanarArray(num_rows=1, num_cols=1, pattern="iso", polarization="V")
scene.rx_array = scene.tx_array
scene.add(Transmitter("tx", position={position}))
"""
    run(tmp_path, prepare + SNIPPETS["scene"])
    rsrp = imported(tmp_path / "maps", tiles, tmp_path / "rsrp")
    assert rsrp.shape == (121, 121)
    with np.load(tmp_path / f"maps/{TILE}.npz") as archive:
        path_gain, told = archive["path_gain"], json.loads(archive["meta_json"].tobytes())
    assert np.allclose(told["tx_position_m"], position)

    (tmp_path / "bare").mkdir()
    np.savez(tmp_path / f"bare/{TILE}.npz", path_gain=path_gain)
    assumed = re.search(r"```toml\n(.*?)```", (ROOT / "docs/CONVERTING.md").read_text(), re.DOTALL)
    (tmp_path / "assumed.toml").write_text((HELSINKI / "holescout.toml").read_text() + "\n" + assumed[1])
    binary = os.environ["HOLESCOUT"]
    command = [binary, "import-rsrp", "--preset", "sionna", "--scenes", scenes, "--config", tmp_path / "assumed.toml",
               "--maps", tmp_path / "bare", "--tiles", tiles, "--out", tmp_path / "bare_rsrp"]
    subprocess.run(list(map(str, command)), check=True)
    with np.load(tmp_path / f"bare_rsrp/{TILE}.npz") as archive:
        assert np.array_equal(archive["rsrp_dbm"], rsrp)


def test_several_repeats_bring_their_error(tiles: Path, tmp_path: Path) -> None:
    with np.load(HELSINKI / f"rsrp/{TILE}.npz") as archive:
        gain = 10 ** (archive["path_gain_db"].astype(np.float64) / 10)
    traces = gain * np.random.default_rng(1).uniform(0.5, 1.5, (8, *gain.shape))
    np.save(tmp_path / "traces.npy", traces)
    run(tmp_path, SNIPPETS["traces.npy"])
    rsrp = imported(tmp_path / "maps", tiles, tmp_path / "rsrp")
    with np.load(tmp_path / f"rsrp/{TILE}.npz") as archive:
        mask, error, share = archive["mask"], archive["std_error_db"], archive["first_half_share"]
    # The map is south first, its import north first.
    mean, deviation, half = (values[::-1][mask == 0] for values in (traces.mean(0), traces.std(0, ddof=1), traces[:4].mean(0)))
    assert np.allclose(rsrp[mask == 0], 15 + 10 * np.log10(mean), atol=1e-4)
    assert np.allclose(error[mask == 0], 10 / np.log(10) * deviation / np.sqrt(8) / mean, atol=1e-4)
    assert np.allclose(share[mask == 0], half / mean / 2, atol=1e-5)


def test_every_snippet_is_run() -> None:
    document = (ROOT / "docs/CONVERTING.md").read_text()
    assert document.count("```python") == len(SNIPPETS) == 6
