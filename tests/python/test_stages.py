"""Stages from Python: the same bytes as from the command."""

import os
import signal
import subprocess
import sys
import threading
from pathlib import Path

import pytest
import tomllib

import holescout

FIXTURE = Path(__file__).parents[2] / "fixtures" / "helsinki"


def sums(directory: Path) -> str:
    return (directory / "SHA256SUMS").read_text()


@pytest.fixture(scope="module")
def settings() -> dict:
    return tomllib.loads((FIXTURE / "holescout.toml").read_text())


def test_the_fixtures_become_the_dataset_of_make(tmp_path: Path, helsinki: Path, settings: dict) -> None:
    heard: list[tuple[str, int, int | None]] = []
    tiles = holescout.rasterise(
        FIXTURE / "helsinki.osm.pbf", tmp_path / "tiles", settings=settings, progress=lambda *told: heard.append(told))
    assert tiles.manifest["schema"].startswith("tiles.") and heard
    rsrp = holescout.import_rsrp(FIXTURE / "rsrp", tiles.path, tmp_path / "rsrp", settings=settings)
    dataset = holescout.shard(tiles.path, rsrp.path, tmp_path / "dataset", settings=settings)
    assert sums(dataset.path) == sums(helsinki)
    verification = holescout.verify(dataset.path)
    assert verification.failures == [] and verification.items == len(holescout.Dataset(dataset.path))
    (next((dataset.path / "train").iterdir())).write_bytes(b"damaged")
    assert holescout.verify(dataset.path).failures


def test_scenes_are_made(tmp_path: Path, settings: dict) -> None:
    area = {"bbox": (24.93, 60.16, 24.95, 60.175)}
    tiles = holescout.rasterise([FIXTURE / "helsinki.osm.pbf"], tmp_path / "tiles", settings=settings, **area)  # type: ignore[arg-type]
    scenes = holescout.scenes(FIXTURE / "helsinki.osm.pbf", tiles.path, tmp_path / "scenes", settings=settings)
    assert scenes.manifest["schema"].startswith("scenes.")
    assert holescout.verify(scenes.path).failures == []


def test_what_is_wrong_is_an_exception(tmp_path: Path) -> None:
    with pytest.raises(holescout.InvalidInput, match="none.osm.pbf"):
        holescout.rasterise(tmp_path / "none.osm.pbf", tmp_path / "tiles")
    with pytest.raises(holescout.InvalidInput) as caught:
        holescout.rasterise(FIXTURE / "helsinki.osm.pbf", tmp_path / "tiles", settings={"grid": {"cell_m": 0.0}})
    assert caught.value.expected and caught.value.found == "0"
    with pytest.raises(holescout.InvalidInput, match="bounding box"):
        holescout.rasterise(FIXTURE / "helsinki.osm.pbf", tmp_path / "tiles", bbox=(3.0, 2.0, 1.0, 0.0))
    assert not (tmp_path / "tiles").exists()


def test_what_progress_raises_ends_a_stage(tmp_path: Path, settings: dict) -> None:
    def stop(phase: str, done: int, total: int | None) -> None:
        raise TimeoutError(phase)

    with pytest.raises(TimeoutError):
        holescout.rasterise(FIXTURE / "helsinki.osm.pbf", tmp_path / "tiles", settings=settings, progress=stop)
    assert not (tmp_path / "tiles" / "manifest.json").exists()
    holescout.rasterise(FIXTURE / "helsinki.osm.pbf", tmp_path / "tiles", settings=settings)


def test_ctrl_c_ends_a_stage(tmp_path: Path, settings: dict) -> None:
    timer = threading.Timer(0.3, lambda: os.kill(os.getpid(), signal.SIGINT))
    timer.start()
    with pytest.raises(KeyboardInterrupt):
        for run in range(100):
            holescout.rasterise(FIXTURE / "helsinki.osm.pbf", tmp_path / str(run), settings=settings)
    timer.join()


def test_the_command_is_there() -> None:
    beside = Path(sys.executable).with_name("holescout")
    for command in ([str(beside)], [sys.executable, "-m", "holescout"]):
        told = subprocess.run([*command, "--version"], check=True, capture_output=True, text=True).stdout
        assert told.strip() == f"holescout {holescout.__version__}"
    assert subprocess.run([sys.executable, "-m", "holescout", "verify", "/nowhere"], capture_output=True).returncode == 3
