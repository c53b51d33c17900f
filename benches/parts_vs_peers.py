"""Reading an extract and filling a tile against the tools that do nothing else, side by side.

- `osmium export` (osmium-tool) reads an extract and assembles its polygons, but projects nothing.
- `gdal_rasterize` (gdal-bin) burns the polygons of a tile, sorted by height, into the same cells. What it takes for one small
  polygon, mostly the start of the process, is taken off.

Ours are the rows of `cargo bench --bench stages`: from extract to projected footprints, grouped as buildings and parts; and a
tile with its sources and figures. Runs alternate; ratios are of medians. Run by `make bench`; figures go to benches/RESULTS.md.
"""

import json
import os
import statistics
import subprocess
import sys
import tempfile
import time
from pathlib import Path

import numpy as np
import rasterio

ROOT = Path(__file__).parent.parent
sys.path.insert(0, str(ROOT / "tests/real"))
import gdal_equality as peer  # noqa: E402: the independent reader of the tests

REPETITIONS = 5
TILES = 12
CONFIG = "[buildings]\nparts = false\ndefault_heights_m = {}\n"


def ours(stages: Path, extract: Path) -> dict[str, float]:
    """Milliseconds of the rows that `stages` prints."""
    printed = subprocess.run([stages, extract, "rasterise"], check=True, capture_output=True, text=True).stdout
    rows = [line.split(" ms ")[0].rsplit(maxsplit=1) for line in printed.splitlines() if " ms " in line]
    return {name.strip(): float(figure) for name, figure in rows}


def milliseconds(command: list[object]) -> float:
    start = time.perf_counter()
    subprocess.run([str(word) for word in command], check=True, stdout=subprocess.DEVNULL)
    return 1000 * (time.perf_counter() - start)


def write_layer(path: Path, shapes: list[tuple[dict[str, object], float]], epsg: int) -> Path:
    """A FlatGeobuf of polygons with their heights, the highest last."""
    ordered = sorted(shapes, key=lambda shape: shape[1])
    features = [{"type": "Feature", "geometry": geometry, "properties": {"height": float(np.float32(height))}}
                for geometry, height in ordered]
    crs = {"type": "name", "properties": {"name": f"urn:ogc:def:crs:EPSG::{epsg}"}}
    collection = {"type": "FeatureCollection", "crs": crs, "features": features}
    text = path.with_suffix(".geojson")
    text.write_text(json.dumps(collection))
    subprocess.run(["ogr2ogr", "-f", "FlatGeobuf", "-lco", "SPATIAL_INDEX=NO", path, text], check=True)
    return path


def burn(layer: Path, tile: peer.Tile, out: Path) -> float:
    west, south, east, north = tile.bounds
    return milliseconds(["gdal_rasterize", "-q", "-a", "height", "-ot", "Float32", "-init", 0, "-tr", tile.cell, tile.cell,
                         "-te", west, south, east, north, layer, out])


def main() -> None:
    extract = Path(os.environ["HOLESCOUT_DATA"]) / "osm/sanjose_buildings.osm.pbf"
    stages = Path(os.environ["STAGES"])
    with tempfile.TemporaryDirectory() as name:
        folder = Path(name)
        (folder / "plain.toml").write_text(CONFIG)
        subprocess.run([os.environ["HOLESCOUT"], "rasterise", "--quiet", "--config", folder / "plain.toml", "--osm", extract,
                        "--out", folder / "tiles"], check=True, stdout=subprocess.DEVNULL)
        epsg, tiles = peer.read_tiles(folder / "tiles")
        built = {entry["id"]: entry["statistics"]["built"]
                 for entry in json.loads((folder / "tiles/manifest.json").read_text())["tiles"]}
        densest = sorted(tiles, key=lambda tile: -built[tile.ident])[:TILES]
        buildings = peer.read_buildings(extract)
        buildings.project(epsg)
        footprints = list(buildings.footprints.values())
        boxes = np.array([peer.box_of(footprint.rings) for footprint in footprints])
        layers, different = [], 0
        for tile in densest:
            near = [footprints[i] for i in np.flatnonzero(peer.touches(boxes, tile.bounds))]
            shapes = [shape for footprint in near for known in (False, True) for shape in footprint.shapes(known)]
            layers.append((write_layer(folder / f"{tile.ident}.fgb", shapes, epsg), tile))
            burn(*layers[-1], folder / "burnt.tif")
            with rasterio.open(folder / "burnt.tif") as burnt:
                different += int((burnt.read(1) != np.load(tile.path)["height_m"]).sum())
        corner = densest[0].bounds[:2]
        dot = [[corner[0] + x, corner[1] + y] for x, y in ((0, 0), (2, 0), (2, 2), (0, 0))]
        empty = write_layer(folder / "dot.fgb", [({"type": "Polygon", "coordinates": [dot]}, 1.0)], epsg)

        read, fill, started, exported, burnt = [], [], [], [], []
        for _ in range(REPETITIONS):
            rows = ours(stages, extract)
            read.append(rows["read extract (all threads)"])
            fill.append(rows["rasterise one tile (1 thread)"])
            exported.append(milliseconds(["osmium", "export", "--geometry-types=polygon", "-f", "geojsonseq", "-O", "-o",
                                          "/dev/null", extract]))
            started.append(statistics.median(burn(empty, densest[0], folder / "burnt.tif") for _ in range(TILES)))
            burnt.append(statistics.median(burn(layer, tile, folder / "burnt.tif") for layer, tile in layers) - started[-1])
    print(f"{extract.name}; medians of {REPETITIONS} alternating runs, {os.cpu_count()} cores; "
          f"{different} of {TILES * densest[0].cells ** 2} cells differ")
    for name, one, other in (("extract to footprints, osmium export", read, exported), ("fill of a tile, gdal_rasterize", fill, burnt)):
        ratio = statistics.median(other) / statistics.median(one)
        spread = [f"{statistics.median(times):.1f} ms ({min(times):.1f} to {max(times):.1f})" for times in (one, other)]
        print(f"{name:<40} {spread[0]} against {spread[1]}: {ratio:.1f} ×")
    print(f"start of gdal_rasterize, taken off: {statistics.median(started):.1f} ms")


if __name__ == "__main__":
    main()
