"""A dataset of the fixtures' maps as several repeats would give them, for tests of what reads errors."""

import json
import subprocess
from pathlib import Path

import numpy as np

HELSINKI = Path(__file__).parents[1] / "fixtures/helsinki"
REPEATS = 8


def repeats_of(path: Path) -> dict[str, np.ndarray]:
    """The arrays of a fixture with noise: a third of the cells differ strongly, and may be missed."""
    with np.load(path) as archive:
        gain = 10 ** (archive["path_gain_db"].astype(np.float64) / 10)
        metadata = json.loads(archive["meta_json"].tobytes())
    random = np.random.default_rng(1)
    rare = random.random(gain.shape) < 1 / 3
    hits = np.where(rare, random.poisson(1, (REPEATS, *gain.shape)), random.uniform(0.98, 1.02, (REPEATS, *gain.shape)))
    traces = gain * hits
    metadata |= dict(value_kind="path_gain_linear", no_path_value=0, repeats=REPEATS, direction_shift="random")
    return dict(
        path_gain=traces.mean(0).astype(np.float32),
        path_gain_std_error=(traces.std(0, ddof=1) / np.sqrt(REPEATS)).astype(np.float32),
        path_gain_first_half=traces[: REPEATS // 2].mean(0).astype(np.float32),
        meta_json=np.frombuffer(json.dumps(metadata).encode(), np.uint8),
    )


def build(holescout: Path | str, root: Path) -> Path:
    """Builds it below a directory, with the program; every fourth map stays as it is, without errors."""
    maps, tiles, rsrp, dataset = (root / name for name in ("maps", "tiles", "rsrp", "dataset"))
    maps.mkdir(parents=True)
    for number, path in enumerate(sorted((HELSINKI / "rsrp").glob("*.npz"))):
        if number % 4 == 0:
            (maps / path.name).write_bytes(path.read_bytes())
        else:
            np.savez(maps / path.name, **repeats_of(path))
    config = ["--config", HELSINKI / "holescout.toml", "--quiet"]
    for stage in (
        ["rasterise", "--osm", HELSINKI / "helsinki.osm.pbf", "--out", tiles],
        ["import-rsrp", "--maps", maps, "--tiles", tiles, "--out", rsrp],
        ["shard", "--tiles", tiles, "--rsrp", rsrp, "--out", dataset],
    ):
        subprocess.run([holescout, *map(str, [*stage, *config])], check=True, stdout=subprocess.DEVNULL)
    return dataset
