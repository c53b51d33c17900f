"""Sionna RT loads the scenes of whole cities, and what it loads is what the height grids say.

Every scene of some fifty tiles of San Jose and all of Monaco, Manhattan, Helsinki and London is loaded, checked as `sionna_trace.py`
does before it traces (objects, materials, closed meshes, base stations outside of buildings), and hit by rays from above at the
centre of every cell of the tile's height grid. What stands on the ground there, with all
above it, must be as high as the grid says. Only a cell may differ whose centre lies within a step of the meshes' lattice of an edge.

Run by `make test-real`; HOLESCOUT names the program, HOLESCOUT_DATA the data. Exit status 1 if a scene fails or nothing was checked.
"""

import json
import os
import subprocess
import sys
import tempfile
import time
from pathlib import Path
from typing import Any

import numpy as np
from ply import read_ply

sys.path.insert(0, str(Path(__file__).parents[2] / "pipeline"))
from sionna_files import Scene, read_scene  # noqa: E402
from sionna_trace import FAILURES, check_loaded, options_of, parse_arguments, start_sionna  # noqa: E402

EVERY = ["--min-buildings=0", "--min-built=0"]
# Extract, the least number of scenes, options of `rasterise`.
CITIES = {
    "sanjose_buildings": (60, ["--bbox=-121.915,37.315,-121.865,37.352"]),
    "monaco": (37, EVERY),
    "manhattan": (66, EVERY),
    "helsinki": (19, EVERY),
    "london": (27, EVERY),
}
OPTIONS = options_of(parse_arguments(["SCENES", "--out", "MAPS", "--repeats", "1"]))
TOLERANCE_M = 0.01
# Corners lie on a lattice of 2^-13 m: an edge may lie so far off.
ON_EDGE_M = 1.8e-4
# Rays from here resolve a tenth of a millimetre.
ABOVE_M = 2000.0
EPSILON_M = 1e-3


def holescout(*arguments: object) -> None:
    subprocess.run([os.environ["HOLESCOUT"], *map(str, arguments), "--quiet"], check=True, stdout=subprocess.DEVNULL)


def surfaces(loaded: Any, side: int, flight_height_m: float) -> np.ndarray:
    """Height of what stands on the ground at the centre of each cell of 1 m, and of what lies above that; row 0 in the north.

    Where one can fly below everything it is the height of what is there below, mostly 0.
    """
    import mitsuba

    centres = np.arange(side) + 0.5 - side / 2
    east, north = np.meshgrid(centres, centres[::-1])
    if "buildings" not in loaded.objects:
        return np.zeros((side, side))
    buildings = mitsuba.load_dict({"type": "scene", "buildings": loaded.objects["buildings"].mi_mesh})

    def below(height_m: float) -> tuple[np.ndarray, np.ndarray]:
        """Height of the first surface of a building below a height, 0 if there is none, and whether it is an underside."""
        origin = mitsuba.Point3f(east.ravel(), north.ravel(), np.full(side * side, height_m))
        hit = buildings.ray_intersect(mitsuba.Ray3f(origin, mitsuba.Vector3f(0.0, 0.0, -1.0)))
        there = hit.is_valid().numpy()
        return np.where(there, height_m - hit.t.numpy(), 0.0), there & (hit.n.z.numpy() < 0)

    top, _ = below(ABOVE_M)
    # From within a solid that stands on the ground, or begins no higher than one flies, the way down ends at its underside.
    low, inside = below(flight_height_m + EPSILON_M)
    return np.where(inside | (top <= flight_height_m), top, low).reshape(side, side)


def on_an_edge(scene: Scene, points: np.ndarray) -> np.ndarray:
    """Say which places [n, 2] relative to a tile's centre lie on an edge of a roof or a wall."""
    vertices, faces = read_ply(scene.xml.parent / "buildings.ply")
    corners = vertices[faces][..., :2].astype(np.float64)
    start = corners.reshape(-1, 2)
    along = np.roll(corners, -1, axis=1).reshape(-1, 2) - start
    length = np.maximum((along**2).sum(axis=1), 1e-12)
    found = []
    for point in points:
        share = np.clip(((point - start) * along).sum(axis=1) / length, 0, 1)
        found.append(np.hypot(*(start + share[:, None] * along - point).T).min() <= ON_EDGE_M)
    return np.array(found, bool)


def check_scene(scene: Scene, tile: Path) -> tuple[float, int, int, int]:
    """Seconds to load a scene, cells compared, and cells that differ: on an edge, and elsewhere."""
    from sionna.rt import load_scene

    start = time.perf_counter()
    loaded = load_scene(str(scene.xml), merge_shapes=False)
    seconds = time.perf_counter() - start
    check_loaded(loaded, scene)
    with np.load(tile) as archive:
        heights = archive["height_m"]
    # The height of receivers is that of flight.
    differ = np.abs(surfaces(loaded, len(heights), scene.metadata["rx_height_m"]) - heights) > TOLERANCE_M
    row, column = np.nonzero(differ)
    half = len(heights) / 2
    on_edge = on_an_edge(scene, np.column_stack([column + 0.5 - half, half - row - 0.5]))
    return seconds, differ.size, int(on_edge.sum()), int((~on_edge).sum())


def check_city(city: str, folder: Path) -> bool:
    """Makes and checks the scenes of a city; returns whether they are right."""
    least, options = CITIES[city]
    extract = Path(os.environ["HOLESCOUT_DATA"]) / f"osm/{city}.osm.pbf"
    tiles, scenes = folder / "tiles", folder / "scenes"
    holescout("rasterise", "--osm", extract, "--out", tiles, *options)
    start = time.perf_counter()
    holescout("scenes", "--osm", extract, "--tiles", tiles, "--out", scenes, "--placement", "any")
    made = time.perf_counter() - start
    seconds, cells, on_edges, different, triangles, failed = [], 0, 0, 0, 0, 0
    for path in sorted(scenes.glob("*/scene.json")):
        triangles += json.loads(path.read_text())["triangles"]
        try:
            loading, size, on_edge, unlike = check_scene(read_scene(path.parent, OPTIONS), tiles / f"{path.parent.name}.npz")
        except FAILURES as error:
            failed += 1
            print(f"{city} {path.parent.name}: {error}")
            continue
        if unlike:
            print(f"{city} {path.parent.name}: {unlike} of {size} cells differ")
        seconds.append(loading)
        cells, on_edges, different = cells + size, on_edges + on_edge, different + unlike
    if not seconds:
        print(f"{city}: no scene could be checked")
        return False
    milliseconds = 1000 * np.array(seconds)
    print(f"{city}: {len(seconds)} scenes, {triangles} triangles, made in {made:.1f} s, loaded in {np.median(milliseconds):.0f} ms "
          f"(at most {milliseconds.max():.0f}); of {cells} cells {different} differ from the height grid, "
          f"and {on_edges} on edges; {failed} failed", flush=True)
    return not failed and len(seconds) >= least and not different


def main() -> int:
    cities = sys.argv[1:] or list(CITIES)
    start_sionna(None)
    right = []
    for city in cities:
        with tempfile.TemporaryDirectory() as folder:
            right.append(check_city(city, Path(folder)))
    return 0 if all(right) else 1


if __name__ == "__main__":
    sys.exit(main())
