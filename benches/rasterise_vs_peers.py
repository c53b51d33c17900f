"""`holescout rasterise` against what one would otherwise write in Python, side by side.

Both read the same extract, project it, rasterise the same tiles (1080 m at 1 m) and write them as
compressed .npz, on all cores. The peer is osmium (reading, multipolygons), PROJ, and GDAL's rasteriser
with NumPy, in one process a core: the libraries whose results the tests compare with. A second peer only
reads: pyrosm, the usual way from a PBF to a table of buildings.

Runs alternate; ratios are of medians. Run by `make bench`; options of `rasterise` may follow; figures go to benches/RESULTS.md.
"""

import json
import multiprocessing
import os
import statistics
import subprocess
import sys
import tempfile
import time
from collections.abc import Callable
from pathlib import Path

import numpy as np

ROOT = Path(__file__).parent.parent
sys.path.insert(0, str(ROOT / "tests/real"))
import gdal_equality as peer  # noqa: E402: the independent reader and rasteriser of the tests

REPETITIONS = 5
CONFIG = "[buildings]\nparts = false\ndefault_heights_m = {}\n"


def run_holescout(extract: Path, folder: Path, area: list[str]) -> None:
    """One whole run of the program."""
    config = folder / "plain.toml"
    config.write_text(CONFIG)
    command = [os.environ["HOLESCOUT"], "rasterise", "--quiet", "--config", config, "--osm", extract]
    out = tempfile.mkdtemp(dir=folder)
    subprocess.run([*command, "--out", out, *area], check=True, stdout=subprocess.DEVNULL)


class PeerRun:
    """The same work in Python; tiles are shared among processes that inherit the buildings."""

    def __init__(self, extract: Path, folder: Path, epsg: int, tiles: list[peer.Tile]) -> None:
        self.extract, self.epsg, self.tiles = extract, epsg, tiles
        self.out = Path(tempfile.mkdtemp(dir=folder))

    def tile(self, tile: peer.Tile) -> None:
        near = [self.footprints[i] for i in np.flatnonzero(peer.touches(self.boxes, tile.bounds))]
        np.savez_compressed(self.out / f"{tile.ident}.npz", height_m=peer.gdal_heights(near, tile))

    def run(self) -> None:
        buildings = peer.read_buildings(self.extract)
        buildings.project(self.epsg)
        self.footprints = list(buildings.footprints.values())
        self.boxes = np.array([peer.box_of(footprint.rings) for footprint in self.footprints])
        cores = os.cpu_count() or 1
        workers = [multiprocessing.get_context("fork").Process(
            target=lambda part: [self.tile(tile) for tile in part], args=(self.tiles[core::cores],))
            for core in range(cores)]
        for worker in workers:
            worker.start()
        for worker in workers:
            worker.join()
            assert worker.exitcode == 0


def read_with_pyrosm(extract: Path) -> None:
    """In a process of its own, so that its memory does not stay."""
    code = f"import pyrosm; assert len(pyrosm.OSM({str(extract)!r}).get_buildings())"
    subprocess.run([sys.executable, "-W", "ignore", "-c", code], check=True, stdout=subprocess.DEVNULL)


def seconds(work: Callable[[], None]) -> float:
    start = time.perf_counter()
    work()
    return time.perf_counter() - start


def main() -> None:
    extract = Path(os.environ["HOLESCOUT_DATA"]) / "osm/sanjose_buildings.osm.pbf"
    area = sys.argv[1:]  # --bbox W,S,E,N for a quicker comparison
    with tempfile.TemporaryDirectory() as name:
        folder = Path(name)
        run_holescout(extract, folder, area)
        tiles_folder = next(path.parent for path in folder.glob("*/manifest.json"))
        epsg, tiles = peer.read_tiles(tiles_folder)
        assert epsg == json.loads((tiles_folder / "manifest.json").read_text())["epsg"]
        works = {
            "holescout rasterise": lambda: run_holescout(extract, folder, area),
            "osmium + PROJ + GDAL + NumPy": lambda: PeerRun(extract, folder, epsg, tiles).run(),
            "pyrosm, reading only": lambda: read_with_pyrosm(extract),
        }
        times: dict[str, list[float]] = {name: [] for name in works}
        for _ in range(REPETITIONS):
            for name, work in works.items():
                times[name].append(seconds(work))
                print(f"{name}: {times[name][-1]:.2f} s", flush=True)
    medians = {name: statistics.median(values) for name, values in times.items()}
    ours = medians["holescout rasterise"]
    print(f"{extract.name}: {len(tiles)} tiles; median of {REPETITIONS} alternating runs, {os.cpu_count()} cores")
    for name, median in medians.items():
        spread = f"{min(times[name]):.2f} to {max(times[name]):.2f}"
        print(f"{name:<30} {median:8.2f} s ({spread})   {median / ours:6.1f} ×")


if __name__ == "__main__":
    main()
