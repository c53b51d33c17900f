"""Scenes of whole cities: every mesh is closed, and holds the volume of its buildings.

The volumes are computed from the extracts alone: heights_reference.py reads them, shapely takes areas. Run by
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

from gdal_equality import Tile, read_tiles
from heights_reference import FLIGHT_HEIGHT_M, Kind, Member, Reference, Region, Top
from ply import read_ply

# Whole extracts with every tile that holds anything, but for the largest.
EXTRACTS = [("sanjose_buildings", 50), ("monaco", None), ("manhattan", None), ("london", None)]

SLAB_M = 0.3
# Why the reference has a doubt about an object that ends where it begins, or below.
NOT_ABOVE = "top is not above bottom"
# What rounding leaves of an outline that parts cover counts as a solid here and not there, or there and not here.
SLIVER_M2 = 0.01
MAX_ERROR = 1e-3
# Tiles that a relation lies in which is cut at the extract's border are not compared by volume; few are.
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


@dataclass
class Item:
    """A region of a footprint with its top."""

    member: Member
    area: shapely.Geometry
    top: Top

    @property
    def is_part(self) -> bool:
        return self.member.footprint.kind is Kind.PART

    @property
    def is_raised(self) -> bool:
        return self.member.footprint.is_raised

    @property
    def underside(self) -> float:
        """Where it begins; a raised one that does not tell is a slab."""
        bottom = self.member.footprint.bottom
        return max(0.0, self.top.metres - SLAB_M) if self.is_raised and bottom <= FLIGHT_HEIGHT_M else bottom


def area_of(region: Region) -> shapely.Geometry:
    """Return a region as shapely sees it: even-odd over its rings, within its limits."""
    def polygon(ring: np.ndarray) -> shapely.Geometry:
        return shapely.make_valid(shapely.Polygon(ring), method="linework")

    area = polygon(region.rings[0])
    for ring in region.rings[1:]:
        area = area.symmetric_difference(polygon(ring))
    if region.within is not None:
        area = area.intersection(polygon(region.within))
    for ring in (*region.cut, *region.without):
        area = area.difference(polygon(ring))
    return area


def united(items: list[Item]) -> shapely.Geometry:
    return shapely.union_all([item.area for item in items]) if items else shapely.Polygon()


def prisms(reference: Reference, refused: set[str]) -> list[tuple[shapely.Geometry, float]]:
    """Return area and depth of what all buildings become; `refused` are those that end below where they begin.

    What ends where it begins is nothing where it floats.
    Within its outline what is raised stands on the ground, but for what stands below it already; a known top takes what
    it covers from guesses, and parts that are at least as well known from their outline.
    """
    own_parts: dict[str, list[Member]] = {}
    outlines: dict[str, list[str]] = {}
    members: dict[str, Member] = {}
    for building in reference.city.buildings:
        members |= {member.footprint.ident: member for member in building.members}
        if building.outline:
            name = building.outline.footprint.ident
            own_parts[name] = building.parts
            for part in building.parts:
                outlines.setdefault(part.footprint.ident, []).append(name)
    items = [Item(member, area_of(region), top) for member in members.values() for region, top in member.regions]
    tree = shapely.STRtree([item.area for item in items])
    found = []
    for item in items:
        near = [items[index] for index in tree.query(item.area, predicate="intersects")]
        near = [other for other in near if other.member is not item.member]
        known = item.top.is_known
        name = item.member.footprint.ident
        parts = {part.footprint.ident for part in own_parts.get(name, [])}
        hidden = [other for other in near if (not known and other.top.is_known)
                  or (other.member.footprint.ident in parts and (other.top.is_known or not known))]
        area = item.area.difference(united(hidden))
        stands = shapely.Polygon()
        if item.is_raised:
            base = [other for other in near if not other.is_raised
                    and (other.member.footprint.ident in outlines.get(name, []) or (known and not other.top.is_known))]
            below = [other for other in near if other.is_part and not other.is_raised and (other.top.is_known or not known)]
            if base:
                stands = area.intersection(united(base)).difference(united(below))
            area = area.difference(stands)
        is_flat = NOT_ABOVE in reference.city.doubts[name] and name not in refused
        top = item.member.footprint.bottom if is_flat else item.top.metres
        found.append((stands, top))
        found.append((area, 0.0 if is_flat else top - item.underside))
    return [(area, depth) for area, depth in found if depth > 0 and area.area > 0]


def uncertain_boxes(reference: Reference) -> np.ndarray:
    """Return the bounding boxes [n, 4] of relations that are cut: the rules do not say what becomes of them."""
    boxes = [np.concatenate([points.min(axis=0), points.max(axis=0)])
             for _, points in reference.buildings.unclear.values() if len(points)]
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
    tiles_dir, scenes = tmp_path / "tiles", tmp_path / "scenes"
    holescout("rasterise", "--osm", osm, "--out", tiles_dir, "--min-buildings", "0", "--min-built", "0")
    summary = holescout("scenes", "--osm", osm, "--tiles", tiles_dir, "--out", scenes)
    epsg, tiles = read_tiles(tiles_dir)
    assert summary["scenes"] == len(tiles) and summary["left_out"]["not_closed"] == 0

    reference = Reference(osm, epsg)
    uncertain = uncertain_boxes(reference)
    rows = (line.split(",") for line in (tiles_dir / "problems.csv").read_text(encoding="utf-8").splitlines())
    solids = prisms(reference, {ident for ident, code, _ in rows if code == "top_below_bottom"})
    boxes = np.array([area.bounds for area, _ in solids])
    areas = np.array([area.area for area, _ in solids])
    volumes = areas * np.array([depth for _, depth in solids])

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
