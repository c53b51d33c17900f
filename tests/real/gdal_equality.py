"""Check Holescout's height grids cell by cell against GDAL, on buildings read by osmium.

Nothing of Holescout is used: osmium reads the extract and assembles its multipolygons, PROJ projects
the nodes, GDAL rasterises. The tiles must have been made with building parts switched off and one
default height of 6 m. A cell may differ only where its centre lies on an edge (within 1e-6 m).

Where `problems.csv` says that the geometry of a relation, or of a way that is open or lacks nodes, was
repaired, or that it was skipped although osmium can use it, the two need not agree: the cells in the
object's bounding box are left out of the comparison and counted. What both skip is compared.

Exit status 0: equal; 1: not, or nothing was compared, or an input is missing.
"""

import argparse
import csv
import json
import random
import re
import sys
from collections.abc import Iterable, Mapping, Sequence
from dataclasses import dataclass, field
from pathlib import Path

import numpy as np
import osmium
import shapely
from osmium.osm import AREA, RELATION, WAY
from pyproj import Transformer
from rasterio.enums import MergeAlg
from rasterio.features import rasterize
from rasterio.transform import from_origin

EDGE_TOLERANCE_M = 1e-6
MAX_EXCLUDED_SHARE = 0.005
MAX_LISTED = 20
NEARBY_M = 2.0

NOT_BUILT = {"no", "proposed", "planned", "demolished", "razed", "removed"}
DEFAULT_HEIGHT_M = 6.0
LEVEL_M = 3.0
MAX_HEIGHT_M = 1000.0
FLIGHT_HEIGHT_M = 2.0
FOOT_M = 0.3048
INCH_M = 0.0254

# Repairs that leave the geometry alone.
COMPARABLE_REPAIRS = {"height_implausible", "height_unparsable", "duplicate_object"}
BROKEN_WAYS = {"missing_nodes", "open_way"}

DECIMAL = r"(\d+(?:[.,]\d*)?|[.,]\d+)"
NUMBER = re.compile(rf"\s*{DECIMAL}\s*")
LENGTH = re.compile(rf"\s*{DECIMAL}\s*(m|metres?|meters?|ft|feet)?\s*", re.IGNORECASE)
FEET_INCHES = re.compile(rf"\s*{DECIMAL}\s*'\s*(?:{DECIMAL}\s*\")?\s*")
TILE_ID = re.compile(r"utm(\d{1,2})([ns])_e(-?\d+)_n(-?\d+)")


# ---------------------------------------------------------------- tags


def to_float(text: str) -> float:
    """Parse a decimal written with a point or a comma."""
    return float(text.replace(",", "."))


def number(text: str | None) -> float | None:
    """Parse a plain non-negative decimal; None if it is none."""
    match = NUMBER.fullmatch(text or "")
    return to_float(match[1]) if match else None


def length_m(text: str | None) -> float | None:
    """Parse a length tag into metres; None if it is none."""
    if match := LENGTH.fullmatch(text or ""):
        in_feet = (match[2] or "").lower() in ("ft", "feet")
        return to_float(match[1]) * (FOOT_M if in_feet else 1.0)
    if match := FEET_INCHES.fullmatch(text or ""):
        return to_float(match[1]) * FOOT_M + to_float(match[2] or "0") * INCH_M
    return None


def valid_height(height: float | None) -> bool:
    """Say whether a height can be believed."""
    return height is not None and 0.0 < height <= MAX_HEIGHT_M


def is_building(tags: Mapping[str, str], key: str = "building") -> bool:
    """Say whether the tags are those of a building above ground that stands, or of a part of one.

    The key `building` makes a building of what has the other one as well.
    """
    value = tags.get(key)
    is_part_too = key != "building" and "building" in tags
    return value is not None and value not in NOT_BUILT and tags.get("location") != "underground" and not is_part_too


def known_height(tags: Mapping[str, str]) -> float | None:
    """Return the height of a building's top: from `height`, else its levels; None if the tags tell neither."""
    height = length_m(tags.get("height"))
    if valid_height(height):
        return height
    levels = number(tags.get("building:levels"))
    if levels is not None:
        roof = length_m(tags.get("roof:height"))
        if not valid_height(roof):
            roof = LEVEL_M * (number(tags.get("roof:levels")) or 0.0)
        if valid_height(total := LEVEL_M * levels + roof):
            return total
    return None


def base_of(tags: Mapping[str, str]) -> float:
    """Return the height of a building's underside: from `min_height`, else its lowest level, else 0."""
    base = length_m(tags.get("min_height"))
    if base is None or base > MAX_HEIGHT_M:
        base = LEVEL_M * (number(tags.get("building:min_level")) or 0.0)
    return base


def is_elevated(tags: Mapping[str, str], key: str = "building") -> bool:
    """Say whether one can fly below the building: a roof on posts, a skyway."""
    return tags[key] == "roof" or base_of(tags) > FLIGHT_HEIGHT_M


# ---------------------------------------------------------------- OSM


@dataclass
class Footprint:
    """A building's polygons (each an outer ring and its holes), its underside, and the height of each; None: unknown."""

    ident: str
    heights: list[float | None]
    elevated: bool
    polygons: list[list[np.ndarray]]

    @property
    def rings(self) -> list[np.ndarray]:
        """All rings of all polygons."""
        return [ring for polygon in self.polygons for ring in polygon]

    def shapes(self, known: bool) -> list[tuple[dict[str, object], float]]:
        """The polygons of known height, or the others with the default, as GeoJSON geometries with their heights."""
        return [({"type": "Polygon", "coordinates": [ring.tolist() for ring in polygon]}, DEFAULT_HEIGHT_M if height is None else height)
                for polygon, height in zip(self.polygons, self.heights, strict=True) if (height is not None) is known]


@dataclass
class Buildings:
    """What osmium makes of the buildings of one or several extracts.

    `extents` holds the known nodes, an [n, 2] array, of every building relation and of every building
    way that is open or lacks nodes; `unusable` names those of them that have no footprint. `outlines`
    names the outer ways of assembled relations: the relation stands for them.
    """

    footprints: dict[str, Footprint] = field(default_factory=dict)
    extents: dict[str, np.ndarray] = field(default_factory=dict)
    unusable: set[str] = field(default_factory=set)
    outlines: set[str] = field(default_factory=set)

    def add(self, other: "Buildings") -> None:
        """Take in the objects of another extract that are not known yet."""
        self.outlines |= other.outlines
        merged = other.footprints | self.footprints
        self.footprints = {ident: merged[ident] for ident in merged if ident not in self.outlines}
        self.extents = other.extents | self.extents
        self.unusable = (self.unusable | other.unusable) - self.footprints.keys() - self.outlines

    def project(self, epsg: int) -> None:
        """Turn all longitudes and latitudes into eastings and northings, in one call of PROJ."""
        rings = [ring for footprint in self.footprints.values() for ring in footprint.rings]
        arrays = [array for array in [*rings, *self.extents.values()] if len(array)]
        if not arrays:
            return
        transformer = Transformer.from_crs("EPSG:4326", f"EPSG:{epsg}", always_xy=True)
        lon, lat = np.concatenate(arrays).T
        projected = np.column_stack(transformer.transform(lon, lat))
        start = 0
        for array in arrays:
            array[:] = projected[start:start + len(array)]
            start += len(array)


def known_nodes(nodes: Iterable[osmium.osm.NodeRef]) -> np.ndarray:
    """Return the longitudes and latitudes of the nodes that the extract holds."""
    points = [(node.lon, node.lat) for node in nodes if node.location.valid()]
    return np.array(points, dtype=np.float64).reshape(-1, 2)


def footprint_of(
    ident: str, tags: Mapping[str, str], key: str, polygons: list[list[np.ndarray]],
    ways: Sequence[tuple[np.ndarray, float | None]] = (),
) -> Footprint:
    """Return polygons with what the tags say; a relation that tells no height has that of the ways around each ring."""
    def inherited(outer: np.ndarray) -> float | None:
        corners = {tuple(corner) for corner in outer}
        told = [height for nodes, height in ways if height is not None and corners.issuperset(map(tuple, nodes))]
        return max(told, default=None)

    own, base, elevated = known_height(tags), base_of(tags), is_elevated(tags, key)
    if own is not None and own < base:
        own = None
    if own is None and len({height for _, height in ways}) > 1 and all((nodes[0] == nodes[-1]).all() for nodes, _ in ways):
        # osmium makes one polygon of rings that share an edge; here each keeps the height of its own way.
        polygons = [[nodes.copy()] for nodes, _ in ways]
    heights = [own if own is not None else inherited(polygon[0]) for polygon in polygons]
    # What floats and begins where it ends raises nothing.
    return Footprint(ident, [0.0 if elevated and own == base else height for height in heights], elevated, polygons)


def area_polygons(area: osmium.osm.Area) -> list[list[np.ndarray]]:
    """Return the polygons that osmium assembled."""
    return [[known_nodes(ring) for ring in (outer, *area.inner_rings(outer))] for outer in area.outer_rings()]


def read_buildings(path: Path, key: str = "building") -> Buildings:
    """Read the buildings, or the parts, of one extract: closed ways as they are, relations as osmium assembles them."""
    relations: dict[int, list[tuple[int, str]]] = {}
    for relation in osmium.FileProcessor(path, RELATION):
        if is_building(relation.tags, key) and relation.tags.get("type") == "multipolygon":
            relations[relation.id] = [(member.ref, member.role) for member in relation.members if member.type == "w"]
    members = {ref for refs in relations.values() for ref, _ in refs}

    found = Buildings()
    member_nodes: dict[int, np.ndarray] = {}
    member_heights: dict[int, float | None] = {}
    processor = (osmium.FileProcessor(path)
                 .with_areas(osmium.filter.KeyFilter(key))
                 .with_filter(osmium.filter.EntityFilter(WAY | AREA)))
    for item in processor:
        if item.is_way():
            if item.id not in members and not is_building(item.tags, key):
                continue
            nodes = known_nodes(item.nodes)
            if item.id in members:
                member_nodes[item.id] = nodes
                member_heights[item.id] = known_height(item.tags)
            if is_building(item.tags, key):
                ident = f"w{item.id}"
                if not item.is_closed() or len(nodes) < len(item.nodes):
                    found.extents[ident] = nodes
                    found.unusable.add(ident)
                elif len(nodes) >= 4:
                    found.footprints[ident] = footprint_of(ident, item.tags, key, [[nodes]])
        elif not item.from_way() and item.orig_id() in relations and (polygons := area_polygons(item)):
            ident = f"r{item.orig_id()}"
            ways = [(member_nodes[ref], member_heights[ref]) for ref, role in relations[item.orig_id()]
                    if ref in member_nodes and role != "inner"]
            found.footprints[ident] = footprint_of(ident, item.tags, key, polygons, ways)

    for relation_id, refs in relations.items():
        ident = f"r{relation_id}"
        found.extents[ident] = np.concatenate(
            [np.empty((0, 2)), *(member_nodes[ref] for ref, _ in refs if ref in member_nodes)])
        if ident in found.footprints:
            found.outlines.update(f"w{ref}" for ref, role in refs if role == "outer")
        else:
            found.unusable.add(ident)
    return found


# ---------------------------------------------------------------- tiles


@dataclass(frozen=True)
class Tile:
    """A square of cells; row 0 is the northernmost, column 0 the westernmost."""

    ident: str
    path: Path
    west: float
    north: float
    cell: float
    cells: int

    @property
    def bounds(self) -> tuple[float, float, float, float]:
        """West, south, east, north."""
        side = self.cell * self.cells
        return self.west, self.north - side, self.west + side, self.north

    @property
    def eastings(self) -> np.ndarray:
        """Easting of the centre of each column."""
        return self.west + (np.arange(self.cells) + 0.5) * self.cell

    @property
    def northings(self) -> np.ndarray:
        """Northing of the centre of each row."""
        return self.north - (np.arange(self.cells) + 0.5) * self.cell

    def heights(self) -> np.ndarray:
        """Read the height grid that is to be checked."""
        with np.load(self.path) as arrays:
            heights = arrays["height_m"]
        if heights.dtype != np.float32 or heights.shape != (self.cells, self.cells):
            sys.exit(f"error: {self.path}: height_m is {heights.dtype} {heights.shape}, "
                     f"expected float32 {(self.cells, self.cells)}")
        return heights


def require(path: Path) -> Path:
    """Return the path of a file that must be there."""
    if not path.is_file():
        sys.exit(f"error: {path} is missing")
    return path


def read_tiles(folder: Path) -> tuple[int, list[Tile]]:
    """Read the manifest: the EPSG code and the tiles."""
    manifest = json.loads(require(folder / "manifest.json").read_text(encoding="utf-8"))
    epsg = manifest["epsg"]
    side, cell = (float(manifest["config"]["grid"][key]) for key in ("side_m", "cell_m"))
    tiles = []
    for entry in manifest["tiles"]:
        match = TILE_ID.fullmatch(entry["id"])
        if not match or epsg != {"n": 32600, "s": 32700}[match[2]] + int(match[1]):
            sys.exit(f"error: tile id {entry['id']} does not fit EPSG:{epsg}")
        easting, northing = float(match[3]), float(match[4])
        tiles.append(Tile(entry["id"], require(folder / entry["file"]),
                          easting - side / 2, northing + side / 2, cell, round(side / cell)))
    return epsg, tiles


@dataclass(frozen=True)
class Problems:
    """The objects of `problems.csv`: all, and those skipped or repaired so that a comparison may fail."""

    listed: set[str]
    skipped: set[str]
    repaired: set[str]

    def uncomparable(self, buildings: Buildings) -> set[str]:
        """Return the objects that may look different here: skipped ones only if osmium has them."""
        return (self.repaired - self.skipped) | (self.skipped & buildings.footprints.keys())


def read_problems(path: Path) -> Problems:
    """Read the objects that Holescout reports."""
    problems = Problems(set(), set(), set())
    with require(path).open(newline="", encoding="utf-8") as file:
        reader = csv.DictReader(file)
        if not {"object", "code", "action"} <= set(reader.fieldnames or ()):
            sys.exit(f"error: {path} lacks the columns object, code and action")
        for row in reader:
            ident, code, action = row["object"], row["code"], row["action"]
            problems.listed.add(ident)
            if not ident.startswith("r") and code not in BROKEN_WAYS:
                continue
            if action == "skipped":
                problems.skipped.add(ident)
            elif action == "repaired" and code not in COMPARABLE_REPAIRS:
                problems.repaired.add(ident)
    return problems


# ---------------------------------------------------------------- comparison


def box_of(arrays: list[np.ndarray]) -> np.ndarray:
    """Return the bounding box of some points: west, south, east, north."""
    points = np.concatenate(arrays)
    return np.concatenate([points.min(axis=0), points.max(axis=0)])


def touches(boxes: np.ndarray, box: Iterable[float], margin: float = 0.0) -> np.ndarray:
    """Say which of the boxes [n, 4] touch a box widened by a margin."""
    west, south, east, north = box
    return ((boxes[:, 0] <= east + margin) & (boxes[:, 2] >= west - margin)
            & (boxes[:, 1] <= north + margin) & (boxes[:, 3] >= south - margin))


def burn(footprints: list[Footprint], tile: Tile, known: bool, elevated: bool) -> np.ndarray:
    """Rasterise footprints of one kind with GDAL, the highest last so that it wins."""
    shapes = [shape for footprint in footprints if footprint.elevated is elevated for shape in footprint.shapes(known)]
    if not shapes:
        return np.zeros((tile.cells, tile.cells), dtype=np.float32)
    ordered = sorted(shapes, key=lambda shape: shape[1])
    return rasterize([(geometry, float(np.float32(height))) for geometry, height in ordered],
                     out_shape=(tile.cells, tile.cells),
                     transform=from_origin(tile.west, tile.north, tile.cell, tile.cell),
                     fill=0, all_touched=False, merge_alg=MergeAlg.replace, dtype="float32")


def gdal_heights(footprints: list[Footprint], tile: Tile) -> np.ndarray:
    """Return the height grid as it should be: the highest known top, else the highest guess, where something stands.

    Elevated buildings only raise grounded ones.
    """
    known, guessed = (burn(footprints, tile, known, False) for known in (True, False))
    known_above, guessed_above = (burn(footprints, tile, known, True) for known in (True, False))
    highest_known = np.maximum(known, known_above)
    heights = np.where(highest_known > 0, highest_known, np.maximum(guessed, guessed_above))
    return np.where((known > 0) | (guessed > 0), heights, 0)


def excluded_cells(boxes: np.ndarray, tile: Tile) -> np.ndarray:
    """Mark the cells whose centre lies in one of the boxes."""
    mask = np.zeros((tile.cells, tile.cells), dtype=bool)
    for west, south, east, north in boxes:
        rows = (tile.northings >= south) & (tile.northings <= north)
        columns = (tile.eastings >= west) & (tile.eastings <= east)
        mask |= rows[:, None] & columns[None, :]
    return mask


def edges_of(footprints: list[Footprint]) -> np.ndarray:
    """Return all edges as [n, 2, 2]: start and end, easting and northing."""
    rings = [ring for footprint in footprints for ring in footprint.rings]
    return np.concatenate([np.empty((0, 2, 2)), *(np.stack([ring[:-1], ring[1:]], axis=1) for ring in rings)])


def distances(points: np.ndarray, edges: np.ndarray) -> np.ndarray:
    """Return the distance of each point to its edge (both broadcast)."""
    start, step = edges[:, 0], edges[:, 1] - edges[:, 0]
    offset = points - start
    squared = np.maximum((step * step).sum(axis=1), np.finfo(np.float64).tiny)
    along = np.clip((offset * step).sum(axis=1) / squared, 0.0, 1.0)
    return np.hypot(*(offset - along[:, None] * step).T)


def on_an_edge(points: np.ndarray, edges: np.ndarray) -> np.ndarray:
    """Say which points [n, 2] lie within the tolerance of an edge."""
    tree = shapely.STRtree(shapely.linestrings(edges))
    point, edge = tree.query(shapely.points(points), predicate="dwithin", distance=1000 * EDGE_TOLERANCE_M)
    result = np.zeros(len(points), dtype=bool)
    result[point[distances(points[point], edges[edge]) <= EDGE_TOLERANCE_M]] = True
    return result


@dataclass
class Totals:
    """What was compared, and how it came out."""

    tiles: int = 0
    objects: set[str] = field(default_factory=set)
    cells: int = 0
    building_cells: int = 0
    differing_cells: int = 0
    on_edge_cells: int = 0
    excluded_cells: int = 0
    excluded_objects: set[str] = field(default_factory=set)
    unreported_objects: set[str] = field(default_factory=set)
    differences: list[dict[str, object]] = field(default_factory=list)

    def failures(self) -> list[str]:
        """Return the reasons why the check fails; none if the tiles are equal to GDAL's."""
        wrong = self.differing_cells - self.on_edge_cells
        reasons = {
            "no tile was compared": self.tiles == 0,
            "no building cell was compared": self.building_cells == 0,
            f"{wrong} cells differ that lie on no edge": wrong > 0,
            f"more than {MAX_EXCLUDED_SHARE:.1%} of the cells are excluded":
                self.excluded_cells > MAX_EXCLUDED_SHARE * (self.cells + self.excluded_cells),
            "osmium cannot use these objects and problems.csv does not list them: "
            + " ".join(sorted(self.unreported_objects)): bool(self.unreported_objects),
        }
        return [reason for reason, holds in reasons.items() if holds]

    def summary(self) -> dict[str, int]:
        """Return the counts."""
        return {name: value if isinstance(value, int) else len(value)
                for name, value in vars(self).items() if name != "differences"}


def compare(tile: Tile, footprints: list[Footprint], excluded: np.ndarray, totals: Totals) -> None:
    """Compare one tile with what GDAL makes of the footprints that touch it."""
    ours, gdal = tile.heights(), gdal_heights(footprints, tile)
    totals.tiles += 1
    totals.objects.update(footprint.ident for footprint in footprints)
    totals.cells += int((~excluded).sum())
    totals.excluded_cells += int(excluded.sum())
    totals.building_cells += int((((ours > 0) | (gdal > 0)) & ~excluded).sum())

    rows, columns = np.nonzero((ours != gdal) & ~excluded)
    if not len(rows):
        return
    points = np.column_stack([tile.eastings[columns], tile.northings[rows]])
    edges = edges_of(footprints)
    on_edge = on_an_edge(points, edges)
    totals.differing_cells += len(rows)
    totals.on_edge_cells += int(on_edge.sum())
    for index in np.flatnonzero(~on_edge)[:MAX_LISTED - len(totals.differences)]:
        row, column, point = rows[index], columns[index], points[index]
        nearby = [footprint.ident for footprint in footprints
                  if touches(box_of(footprint.rings)[None], (*point, *point), NEARBY_M).any()]
        totals.differences.append({
            "tile": tile.ident, "row": int(row), "col": int(column),
            "easting": float(point[0]), "northing": float(point[1]),
            "ours": float(ours[row, column]), "gdal": float(gdal[row, column]),
            "edge_distance_m": float(distances(point, edges).min()) if len(edges) else None,
            "nearby": nearby,
        })


def check(tiles: list[Tile], buildings: Buildings, problems: Problems) -> Totals:
    """Compare all tiles; the buildings must be projected."""
    footprints = list(buildings.footprints.values())
    boxes = np.array([box_of(footprint.rings) for footprint in footprints]).reshape(-1, 4)
    uncomparable = problems.uncomparable(buildings)
    extents = {ident: box_of([nodes]) for ident, nodes in buildings.extents.items() if len(nodes)}
    totals = Totals()
    for tile in tiles:
        here = {ident for ident, box in extents.items() if touches(box[None], tile.bounds).any()}
        out = here & uncomparable
        totals.excluded_objects |= out
        totals.unreported_objects |= (here & buildings.unusable) - problems.listed
        inside = [footprints[index] for index in np.flatnonzero(touches(boxes, tile.bounds))]
        excluded = excluded_cells(np.array([extents[ident] for ident in out]).reshape(-1, 4), tile)
        compare(tile, inside, excluded, totals)
    return totals


def main() -> int:
    """Run the check and return the exit status."""
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--tiles", type=Path, required=True, metavar="DIR")
    parser.add_argument("--osm", type=Path, required=True, action="append", metavar="FILE", help="may be repeated")
    parser.add_argument("--max-tiles", type=int, metavar="N", help="compare a random sample of N tiles")
    parser.add_argument("--seed", type=int, default=0, metavar="S", help="of the sample (default 0)")
    parser.add_argument("--json", type=Path, metavar="OUT", help="write the counts and differences here")
    args = parser.parse_args()

    epsg, tiles = read_tiles(args.tiles)
    if args.max_tiles is not None and args.max_tiles < len(tiles):
        tiles = random.Random(args.seed).sample(tiles, args.max_tiles)
    problems = read_problems(args.tiles / "problems.csv")
    buildings = Buildings()
    for path in args.osm:
        buildings.add(read_buildings(require(path)))
    buildings.project(epsg)
    totals = check(tiles, buildings, problems)

    failures = totals.failures()
    summary = totals.summary()
    if args.json:
        report = {"equal": not failures, "failures": failures, **summary, "differences": totals.differences}
        args.json.write_text(json.dumps(report, indent=2) + "\n", encoding="utf-8")
    for difference in totals.differences:
        print("  ".join(f"{name} {value}" for name, value in difference.items()))
    for failure in failures:
        print(f"failure: {failure}")
    counts = ", ".join(f"{count} {name.replace('_', ' ')}" for name, count in summary.items())
    print(f"{'FAILED' if failures else 'equal'}: {' '.join(path.name for path in args.osm)}: {counts}")
    return int(bool(failures))


if __name__ == "__main__":
    sys.exit(main())
