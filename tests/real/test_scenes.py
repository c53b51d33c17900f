"""Scenes of whole cities: every mesh is closed, and holds the volume of its buildings.

The volumes are computed from the extracts alone: osmium reads and assembles, PROJ projects, shapely takes
areas. Nothing of Holescout is used for them but the list of objects that it repaired. Run by
`make test-real`; every test fails where the data or the program are missing.
"""

import json
import os
import random
import subprocess
from dataclasses import dataclass
from pathlib import Path

import numpy as np
import pytest
import shapely

from gdal_equality import FLIGHT_HEIGHT_M, Buildings, Footprint, Problems, Tile, read_buildings, read_problems, read_tiles

# Whole extracts with every tile that holds anything, but for the largest.
EXTRACTS = [("sanjose_buildings", 50), ("monaco", None), ("manhattan", None), ("london", None)]
CONFIG = "[buildings]\ndefault_heights_m = {}\n[filter]\nmin_buildings = 0\nmin_built = 0.0\n"

SLAB_M = 0.3
# What rounding leaves of an outline that parts cover counts as a solid here and not there, or there and not here.
SLIVER_M2 = 0.01
MAX_ERROR = 1e-3
# Tiles that a repaired object lies in are not compared by volume; few are.
MIN_COMPARED = 0.8


def holescout(*arguments: str | Path) -> dict:
    """Run the program and return its JSON summary."""
    program = os.environ.get("HOLESCOUT", "")
    assert Path(program).is_file(), "HOLESCOUT names no program; use `make test-real`"
    command = [program, *map(str, arguments), "--json", "--quiet"]
    result = subprocess.run(command, capture_output=True, text=True, check=False)
    assert result.returncode == 0, result.stderr
    return json.loads(result.stdout.splitlines()[-1])


# ---------------------------------------------------------------- meshes


def read_ply(path: Path) -> tuple[np.ndarray, np.ndarray]:
    """Return the vertices [n, 3] and the faces [m, 3] of a binary PLY file."""
    header, body = path.read_bytes().split(b"end_header\n", 1)
    lines = header.decode("ascii").splitlines()
    assert lines[:2] == ["ply", "format binary_little_endian 1.0"]
    assert [line for line in lines if line.startswith("property")] == [
        "property float x", "property float y", "property float z", "property list uchar int vertex_indices"]
    count = {line.split()[1]: int(line.split()[2]) for line in lines if line.startswith("element")}
    vertices = np.frombuffer(body, "<f4", 3 * count["vertex"]).reshape(-1, 3)
    face = np.dtype([("count", "u1"), ("index", "<i4", 3)])
    faces = np.frombuffer(body, face, count["face"], offset=vertices.nbytes)
    assert len(body) == vertices.nbytes + faces.nbytes
    assert (faces["count"] == 3).all()
    indices = faces["index"]
    assert not len(indices) or (indices.min() >= 0 and indices.max() < len(vertices))
    return vertices, indices


def open_edges(faces: np.ndarray) -> int:
    """Count the directed edges that are there more than once or lack their opposite."""
    edges = np.concatenate([faces[:, [0, 1]], faces[:, [1, 2]], faces[:, [2, 0]]]).astype(np.int64)
    forth = edges[:, 0] << 32 | edges[:, 1]
    back = edges[:, 1] << 32 | edges[:, 0]
    unique = np.unique(forth)
    return len(forth) - len(unique) + len(np.setdiff1d(unique, back))


def volume_of(vertices: np.ndarray, faces: np.ndarray) -> float:
    """Return the volume inside of a closed mesh."""
    a, b, c = np.moveaxis(vertices.astype(np.float64)[faces], 1, 0)
    return float(np.einsum("ij,ij->", a, np.cross(b, c)) / 6.0)


# ---------------------------------------------------------------- buildings


def projected(osm: Path, key: str, epsg: int) -> Buildings:
    """Return the buildings or parts of an extract, without ways that a relation stands for."""
    buildings = Buildings()
    buildings.add(read_buildings(osm, key))
    buildings.project(epsg)
    return buildings


@dataclass
class Prism:
    """What stands on the ground or floats above it."""

    area: shapely.Geometry
    depth: float


def area_of(footprint: Footprint) -> shapely.Geometry:
    """Return a footprint as shapely sees it: even-odd in each polygon, polygons united."""
    def even_odd(rings: list[np.ndarray]) -> shapely.Geometry:
        parts = [shapely.make_valid(shapely.Polygon(ring), method="linework") for ring in rings]
        area = parts[0]
        for part in parts[1:]:
            area = area.symmetric_difference(part)
        return area

    areas = [even_odd(rings) for rings in footprint.polygons]
    return areas[0] if len(areas) == 1 else shapely.union_all(areas)


def depth_of(footprint: Footprint) -> float:
    """Return the height between underside and top; a roof without underside is a slab."""
    if footprint.elevated and footprint.base <= FLIGHT_HEIGHT_M:
        return min(SLAB_M, footprint.height)
    return footprint.height - footprint.base


def prisms(outlines: Buildings, parts: Buildings) -> list[Prism]:
    """Return what all buildings become: parts on the ground stand for what they cover of outlines."""
    replacing = [area_of(part) for part in parts.footprints.values() if not part.elevated]
    tree = shapely.STRtree(replacing)
    found = [Prism(area_of(part), depth_of(part)) for part in parts.footprints.values()]
    for outline in outlines.footprints.values():
        area = area_of(outline)
        near = [] if outline.elevated else tree.query(area, predicate="intersects")
        if len(near):
            area = area.difference(shapely.union_all([replacing[index] for index in near]))
        found.append(Prism(area, depth_of(outline)))
    return [prism for prism in found if prism.depth > 0 and prism.area.area > 0]


def uncertain_boxes(problems: Problems, *kinds: Buildings) -> np.ndarray:
    """Return the bounding boxes [n, 4] of objects that were repaired and may look different here."""
    boxes = [np.concatenate([nodes.min(axis=0), nodes.max(axis=0)])
             for buildings in kinds for ident, nodes in buildings.extents.items()
             if len(nodes) and ident in problems.uncomparable(buildings) | (buildings.unusable - problems.skipped)]
    return np.array(boxes).reshape(-1, 4)


def meet(boxes: np.ndarray, tile: Tile) -> np.ndarray:
    """Say which boxes meet a tile's square."""
    west, south, east, north = tile.bounds
    return (boxes[:, 0] <= east) & (boxes[:, 2] >= west) & (boxes[:, 1] <= north) & (boxes[:, 3] >= south)


# ---------------------------------------------------------------- the test


@pytest.mark.parametrize(("extract", "sample"), EXTRACTS)
def test_meshes_are_closed_and_hold_the_buildings(tmp_path: Path, extract: str, sample: int | None) -> None:
    data = Path(os.environ.get("HOLESCOUT_DATA", ""))
    osm = data / "osm" / f"{extract}.osm.pbf"
    assert osm.is_file(), f"{osm} is missing; use `make test-real`"
    config, tiles_dir, scenes = tmp_path / "all.toml", tmp_path / "tiles", tmp_path / "scenes"
    config.write_text(CONFIG)
    holescout("rasterise", "--config", config, "--osm", osm, "--out", tiles_dir)
    summary = holescout("scenes", "--osm", osm, "--tiles", tiles_dir, "--out", scenes)
    epsg, tiles = read_tiles(tiles_dir)
    assert summary["scenes"] == len(tiles) and summary["left_out"]["not_closed"] == 0

    outlines, parts = projected(osm, "building", epsg), projected(osm, "building:part", epsg)
    uncertain = uncertain_boxes(read_problems(tiles_dir / "problems.csv"), outlines, parts)
    solids = prisms(outlines, parts)
    boxes = np.array([prism.area.bounds for prism in solids])
    areas = np.array([prism.area.area for prism in solids])
    volumes = areas * np.array([prism.depth for prism in solids])

    tiles = tiles if sample is None else random.Random(1).sample(tiles, sample)
    compared, wrong = 0, []
    for tile in tiles:
        vertices, faces = read_ply(scenes / tile.ident / "buildings.ply")
        meta = json.loads((scenes / tile.ident / "scene.json").read_text(encoding="utf-8"))
        assert open_edges(faces) == 0, tile.ident
        assert meta["triangles"] == len(faces), tile.ident
        if meet(uncertain, tile).any():
            continue
        compared += 1
        here = meet(boxes, tile)
        expected, found = volumes[here].sum(), volume_of(vertices, faces)
        least = int((here & (areas >= SLIVER_M2)).sum())
        if abs(found - expected) > MAX_ERROR * expected + 1e-6 or meta["solids"] < least:
            wrong.append((tile.ident, found, expected, meta["solids"], least))
    assert not wrong, wrong[:10]
    assert compared >= MIN_COMPARED * len(tiles), f"{compared} of {len(tiles)} tiles compared"
