"""Check Holescout's heights cell by cell against an independent reading of OpenStreetMap's buildings.

Nothing of Holescout is used: osmium reads the extract, PROJ projects the nodes, and what follows is written from
the rules alone (the design's section on height grids, the OSM wiki's "Simple 3D Buildings", "Relation:multipolygon"
and "Relation:building"). The tiles must have been made with the default heights of the configuration.

Objects. Closed ways and multipolygon relations with `building` are outlines, those with only `building:part` are
parts; `no`, lifecycle values and `location=underground` are neither. A relation of type `building` with such a tag
lends its tags to the members of role `outline` that have none; without one it only groups outlines and parts.

Rings. Members of a multipolygon count if their role is `outer`, `inner` or empty. A cell is inside if its centre is
inside an odd number of rings; an equal ring counts once; an inner ring across another ring is cut out. A closed way
that is an outer ring of a relation of its kind, and is tagged as that, is left out: the relation stands for it.

Heights. `height`, else `building:levels` and the roof's, else what the outer way of the ring says, else (for a part)
what its outline says, else the default of the type. What was said is known, the default is a guess. A top that was
not said for the object itself is at least one storey above its bottom.

Columns. A building's column over a cell is the highest known top of its parts there, else the highest guess of its
parts there, else its outline's. A cell takes the highest known column, a guess only where none is known. It is open
unless it lies in an outline or a part that stands on the ground: what begins above the flight height, or is a `roof`,
only raises what is below.

Where the rules leave a choice, no side is right: objects in doubt are named with the reason and their cells are
left out. Which outlines own a part is read in several ways (`Reading`), and cells that depend on it are left out, too.
All that is left out is counted, and must be little. Cells whose centre lies on an edge (within 1e-6 m) may differ.

Exit status 0: equal; 1: not, or nothing was compared, or an input is missing.
"""

import argparse
import gc
import json
import random
import re
import sys
from collections import Counter, defaultdict
from collections.abc import Iterable, Mapping, Sequence
from dataclasses import dataclass, field
from enum import Enum
from functools import cached_property
from itertools import combinations
from math import ceil, floor
from pathlib import Path

import numpy as np
import osmium
import shapely
from osmium.osm import RELATION, WAY
from pyproj import Transformer

from gdal_equality import Tile, on_an_edge, read_tiles, require

FLIGHT_HEIGHT_M = 2.0
LEVEL_M = 3.0
MAX_HEIGHT_M = 1000.0
FOOT_M = 0.3048
INCH_M = 0.0254
DEFAULT_HEIGHT_M = 6.0
DEFAULT_HEIGHTS_M = (dict.fromkeys(("carport", "garage", "garages", "hut", "shed"), 2.5)
                     | dict.fromkeys(("bungalow", "greenhouse", "kiosk", "service"), 3.0))

NOT_BUILT = {"no", "proposed", "planned", "demolished", "razed", "removed"}
RING_ROLES = {"outer", "inner", ""}

# What `height_source` holds.
OPEN, HEIGHT, LEVELS, GUESS = range(4)

BOTTOM_ON_WAY = "only the outer way has a bottom"
ROOF_ON_WAY = "only the outer way is a roof"
RAISED_IN_DOUBT = {BOTTOM_ON_WAY, ROOF_ON_WAY}

HEIGHT_TOLERANCE_M = 1e-3
# A share of a part's area that decides nothing: outlines that only touch it.
TOUCH = 0.01
ABOUT_HALF = 0.45
# A building with a wider span has a corner in a wrong place.
MAX_SPAN_M = 5000.0
# Larger windows are painted tile by tile.
MAX_WINDOW_CELLS = 40_000_000
MAX_LEFT_OUT_SHARE = 0.005
MAX_LEFT_OUT_BUILT_SHARE = 0.02
MAX_LISTED = 20


# ---------------------------------------------------------------- tags

NUMBER = r"(?:\d+(?:\.\d*)?|\.\d+|\d+,\d{1,2})"
PLAIN = re.compile(NUMBER)
METRES = re.compile(rf"({NUMBER})\s*(?:m|met(?:er|re)s?)?", re.IGNORECASE)
FEET = re.compile(rf"({NUMBER}|\d{{1,3}}(?:,\d{{3}})+(?:\.\d*)?)\s*(?:ft|foot|feet|')", re.IGNORECASE)
FEET_INCHES = re.compile(rf"({NUMBER}|\d{{1,3}}(?:,\d{{3}})+)\s*'\s*-?\s*({NUMBER})\s*\"")
STRAIGHT = str.maketrans("\u2018\u2019\u2032\u00b4\u201c\u201d\u2033", "''''\"\"\"")


def decimal(text: str) -> float:
    """Parse a number whose comma, before one or two digits, is that of a decimal fraction, else of thousands."""
    if re.search(r",\d{1,2}$", text):
        return float(text.replace(",", "."))
    return float(text.replace(",", ""))


def number(text: str | None) -> float | None:
    """Parse a plain number without a sign; None if it is none."""
    text = (text or "").strip()
    return decimal(text) if PLAIN.fullmatch(text) else None


def length_m(text: str | None) -> float | None:
    """Parse a length into metres; None if it is none, or if it could mean two lengths.

    Without a unit, and with metres, a comma before three digits may be one of thousands or of a fraction; with feet
    it separates thousands. A hyphen between feet and inches joins them; twelve inches are a foot.
    """
    text = (text or "").strip().translate(STRAIGHT).replace("''", '"')
    if match := METRES.fullmatch(text):
        return decimal(match[1])
    if match := FEET.fullmatch(text):
        return decimal(match[1]) * FOOT_M
    if (match := FEET_INCHES.fullmatch(text)) and decimal(match[2]) < 12.0:
        return decimal(match[1]) * FOOT_M + decimal(match[2]) * INCH_M
    return None


@dataclass(frozen=True)
class Top:
    """The height of a top in metres, and the code of its source."""

    metres: float
    source: int

    @property
    def is_known(self) -> bool:
        """Whether somebody said so."""
        return self.source != GUESS

    @property
    def rank(self) -> tuple[bool, float, int]:
        """Known before guessed, then high before low, then `height` before levels."""
        return self.is_known, self.metres, -self.source


def believable(height: float | None) -> bool:
    """Say whether a height can be one of a building."""
    return height is not None and 0.0 < height <= MAX_HEIGHT_M


def said_tops(tags: Mapping[str, str]) -> list[Top]:
    """Return what the tags say about the top, the best source first."""
    tops = []
    height = length_m(tags.get("height"))
    if believable(height):
        tops.append(Top(height, HEIGHT))
    levels = number(tags.get("building:levels"))
    if levels is not None:
        roof = length_m(tags.get("roof:height"))
        if not believable(roof):
            roof = LEVEL_M * (number(tags.get("roof:levels")) or 0.0)
        if believable(total := LEVEL_M * levels + roof):
            tops.append(Top(total, LEVELS))
    return tops


def bottom_of(tags: Mapping[str, str]) -> float:
    """Return the height of the underside: `min_height`, else the lowest level's, else 0."""
    bottom = length_m(tags.get("min_height"))
    if bottom is None or bottom > MAX_HEIGHT_M:
        bottom = LEVEL_M * (number(tags.get("building:min_level")) or 0.0)
    return bottom


class Kind(Enum):
    """What an object is a footprint of; the values are the keys."""

    OUTLINE = "building"
    PART = "building:part"


def kind_of(tags: Mapping[str, str]) -> Kind | None:
    """Return what the tags make of an object: `building` goes before `building:part`."""
    for kind in Kind:
        if (value := tags.get(kind.value)) is not None:
            return None if value in NOT_BUILT or tags.get("location") == "underground" else kind
    return None


def is_tagged(tags: Mapping[str, str]) -> bool:
    """Say whether an object speaks of a building at all."""
    return any(kind.value in tags for kind in Kind)


# ---------------------------------------------------------------- cells


@dataclass(frozen=True)
class Box:
    """A window of cells of 1 m: [west, east) and [south, north), in whole metres."""

    west: int
    south: int
    east: int
    north: int

    @property
    def shape(self) -> tuple[int, int]:
        """Rows and columns; row 0 is the southernmost here."""
        return max(self.north - self.south, 0), max(self.east - self.west, 0)

    def meet(self, other: "Box") -> "Box":
        """Return what both cover."""
        return Box(max(self.west, other.west), max(self.south, other.south),
                   min(self.east, other.east), min(self.north, other.north))

    def of(self, inner: "Box") -> tuple[slice, slice]:
        """Return the slices of a window inside this one."""
        return (slice(inner.south - self.south, inner.north - self.south),
                slice(inner.west - self.west, inner.east - self.west))


def extremes(arrays: Iterable[np.ndarray]) -> tuple[list[float], list[float]]:
    """Return the least and the greatest easting and northing of some points [n, 2]."""
    arrays = list(arrays)
    points = np.concatenate(arrays) if len(arrays) > 1 else arrays[0]
    return points.min(axis=0).tolist(), points.max(axis=0).tolist()


def box_around(arrays: Iterable[np.ndarray]) -> Box:
    """Return the cells that some points [n, 2] span."""
    (west, south), (east, north) = extremes(arrays)
    return Box(floor(west), floor(south), ceil(east), ceil(north))


def union_box(boxes: Iterable[Box]) -> Box:
    """Return the smallest window around some."""
    boxes = list(boxes)
    return Box(min(box.west for box in boxes), min(box.south for box in boxes),
               max(box.east for box in boxes), max(box.north for box in boxes))


def even_odd(rings: Sequence[np.ndarray], box: Box) -> np.ndarray:
    """Mark the cells whose centre is inside an odd number of closed rings."""
    rows, columns = box.shape
    edges = np.concatenate([np.hstack([ring[:-1], ring[1:]]) for ring in rings])
    edges -= np.array([box.west, box.south] * 2) + 0.5
    # Rows whose centres an edge passes, its lower end included.
    low, high = np.sort(edges[:, [1, 3]], axis=1).T
    first, count = np.ceil(low).astype(int), (np.ceil(high) - np.ceil(low)).astype(int)
    edge = np.repeat(np.arange(len(edges)), count)
    row = np.arange(len(edge)) - np.repeat(np.cumsum(count) - count, count) + first[edge]
    inside = (row >= 0) & (row < rows)
    edge, row = edge[inside], row[inside]
    x0, y0, x1, y1 = edges[edge].T
    crossing = x0 + (row - y0) * (x1 - x0) / (y1 - y0)
    column = np.clip(np.floor(crossing).astype(int) + 1, 0, columns)
    flips = np.bincount(row * (columns + 1) + column, minlength=rows * (columns + 1))
    return (np.cumsum(flips.reshape(rows, columns + 1), axis=1)[:, :columns] % 2).astype(bool)


@dataclass
class Region:
    """What is inside an odd number of `rings`, outside of all `cut`, inside `within` and outside of all `without`."""

    rings: list[np.ndarray]
    cut: list[np.ndarray] = field(default_factory=list)
    within: np.ndarray | None = None
    without: list[np.ndarray] = field(default_factory=list)

    @cached_property
    def box(self) -> Box:
        """The cells that it can have."""
        return box_around(self.rings if self.within is None else [self.within])

    @cached_property
    def mask(self) -> np.ndarray:
        """The cells of `box` that it has."""
        inside = even_odd(self.rings, self.box)
        if self.within is not None:
            inside &= even_odd([self.within], self.box)
        for ring in (*self.cut, *self.without):
            inside &= ~even_odd([ring], self.box)
        return inside


# ---------------------------------------------------------------- rings

@dataclass
class Ring:
    """A closed chain of points, with the roles and ids of the ways that it is made of."""

    nodes: list[int]
    roles: set[str]
    ways: set[int]
    points: np.ndarray = field(default_factory=lambda: np.empty((0, 2)))

    @property
    def edges(self) -> frozenset[frozenset[int]]:
        """Its edges, without direction."""
        return frozenset(map(frozenset, zip(self.nodes, self.nodes[1:], strict=False)))

    @cached_property
    def polygon(self) -> shapely.Geometry:
        """What is inside of it by the even-odd rule, once the points are projected."""
        polygon = shapely.Polygon(self.points)
        return polygon if polygon.is_valid else areal(shapely.make_valid(polygon))


def areal(shape: shapely.Geometry) -> shapely.Geometry:
    """Return a shape without its points and lines."""
    return shapely.union_all([part for part in shapely.get_parts(shape) if part.geom_type.endswith("Polygon")])


def loops(nodes: Sequence[int]) -> list[list[int]]:
    """Split a closed chain wherever it comes back to a node; what encloses nothing is dropped."""
    found, chain, place = [], [], {}
    for node in nodes:
        if node in place:
            start = place[node]
            loop = [*chain[start:], node]
            for passed in chain[start + 1:]:
                del place[passed]
            del chain[start + 1:]
            if len(loop) >= 4:
                found.append(loop)
        elif not chain or chain[-1] != node:
            place[node] = len(chain)
            chain.append(node)
    return found


def distinct(rings: Iterable[Ring]) -> list[Ring]:
    """Return each ring once, however often it was drawn or walked."""
    rings = list(rings)
    if len(rings) < 2:
        return rings
    merged: dict[frozenset, Ring] = {}
    for ring in rings:
        if (same := merged.get(ring.edges)) is not None:
            same.roles |= ring.roles
            same.ways |= ring.ways
        else:
            merged[ring.edges] = ring
    return list(merged.values())


@dataclass
class Assembly:
    """The rings of some ways; `is_whole` is false if ways or ends are missing."""

    rings: list[Ring]
    is_whole: bool
    # More than two ends meet in a node: the rings could be put together otherwise.
    has_choice: bool = False


def assemble(members: Iterable[tuple[int, str]], ways: Mapping[int, "Way"]) -> Assembly:
    """Put ways together to rings."""
    roles: dict[int, set[str]] = defaultdict(set)
    for ref, role in members:
        roles[ref].add(role)
    if any(ref not in ways or not ways[ref].is_whole for ref in roles):
        return Assembly([], is_whole=False)
    rings = [Ring(loop, set(roles[ref]), {ref})
             for ref in roles if ways[ref].is_closed for loop in loops(ways[ref].nodes)]
    unused = {ref: ways[ref].nodes for ref in roles if not ways[ref].is_closed and len(ways[ref].nodes) > 1}
    ends = Counter(end for nodes in unused.values() for end in (nodes[0], nodes[-1]))
    if any(count % 2 for count in ends.values()):
        return Assembly([], is_whole=False)
    while unused:
        ref, chain = unused.popitem()
        used = {ref}
        while chain[0] != chain[-1]:
            ref = min(ref for ref, nodes in unused.items() if chain[-1] in (nodes[0], nodes[-1]))
            nodes = unused.pop(ref)
            chain = chain + (nodes if nodes[0] == chain[-1] else nodes[::-1])[1:]
            used.add(ref)
        rings += [Ring(loop, set().union(*(roles[ref] for ref in used)), used) for loop in loops(chain)]
    return Assembly(distinct(rings), is_whole=True, has_choice=any(count > 2 for count in ends.values()))


# ---------------------------------------------------------------- OSM


@dataclass
class Way:
    """A way: its tags, its nodes, and whether the extract holds them all."""

    tags: dict[str, str]
    nodes: list[int]
    is_whole: bool

    @property
    def is_closed(self) -> bool:
        """Whether it ends where it began."""
        return len(self.nodes) > 1 and self.nodes[0] == self.nodes[-1]


@dataclass
class Relation:
    """A relation: its tags, and its members as type, id and role."""

    tags: dict[str, str]
    members: list[tuple[str, int, str]]


@dataclass
class Extract:
    """The ways and relations that have to do with buildings, and the longitudes and latitudes of their nodes."""

    places: dict[int, tuple[float, float]] = field(default_factory=dict)
    ways: dict[int, Way] = field(default_factory=dict)
    relations: dict[int, Relation] = field(default_factory=dict)


def read_extract(path: Path) -> Extract:
    """Read an extract; of an object in several versions the highest counts, unless that is its deletion."""
    extract, versions = Extract(), {}
    for item in osmium.FileProcessor(path, RELATION):
        if item.version < versions.get(item.id, 0):
            continue
        versions[item.id] = item.version
        extract.relations.pop(item.id, None)
        if item.visible and item.tags.get("type") in ("multipolygon", "building"):
            members = [(member.type, member.ref, member.role) for member in item.members]
            extract.relations[item.id] = Relation(dict(item.tags), members)
    needed = {ref for relation in extract.relations.values() for kind, ref, _ in relation.members if kind == "w"}
    versions.clear()
    for item in osmium.FileProcessor(path).with_locations().with_filter(osmium.filter.EntityFilter(WAY)):
        if item.version < versions.get(item.id, 0):
            continue
        versions[item.id] = item.version
        extract.ways.pop(item.id, None)
        if item.visible and (item.id in needed or is_tagged(item.tags)):
            nodes = [node.ref for node in item.nodes]
            known = {node.ref: (node.lon, node.lat) for node in item.nodes if node.location.valid()}
            extract.places |= known
            extract.ways[item.id] = Way(dict(item.tags), nodes, bool(nodes) and all(node in known for node in nodes))
    return extract


# ---------------------------------------------------------------- buildings


@dataclass
class Piece:
    """A region of an object with the top that it says itself or inherits from its outer way; None: unknown."""

    region: Region
    top: Top | None


@dataclass
class Footprint:
    """An outline or a part."""

    ident: str
    kind: Kind
    bottom: float
    default: float
    is_raised: bool
    plain: list[Ring]
    cut: list[Ring]
    pieces: list[Piece] = field(default_factory=list)
    doubts: set[str] = field(default_factory=set)

    @cached_property
    def geometry(self) -> shapely.Geometry:
        """Its shape, for measuring areas."""
        shape = self.plain[0].polygon
        for ring in self.plain[1:]:
            shape = shapely.symmetric_difference(shape, ring.polygon)
        for ring in self.cut:
            shape = shapely.difference(shape, ring.polygon)
        return shape

    def at_least_a_storey(self, top: Top) -> Top:
        """Return a top that was not said for this object, or that of a storey above its bottom."""
        return top if top.metres > self.bottom else Top(self.bottom + LEVEL_M, GUESS)

    @property
    def guess(self) -> Top:
        """The top by its type."""
        return self.at_least_a_storey(Top(self.default, GUESS))


@dataclass
class Buildings:
    """What an extract holds, projected.

    `groups` holds, for each relation of type `building`, its outlines and its parts. `unclear` holds the points of
    relations that are cut, open or nested: the rules do not say what becomes of them. `no_footprint` counts, by
    reason, the objects that are not built: ways that are open or lack nodes, what encloses nothing or spans kilometres.
    """

    footprints: dict[str, Footprint] = field(default_factory=dict)
    groups: list[tuple[set[str], set[str]]] = field(default_factory=list)
    unclear: dict[str, tuple[str, np.ndarray]] = field(default_factory=dict)
    no_footprint: Counter[str] = field(default_factory=Counter)

    def of_kind(self, kind: Kind) -> list[Footprint]:
        """Return the outlines, or the parts."""
        return [footprint for footprint in self.footprints.values() if footprint.kind is kind]


class Projector:
    """Projects the nodes of an extract, all in one call of PROJ."""

    def __init__(self, extract: Extract, epsg: int) -> None:
        """Project every node of every way."""
        self.index = {node: index for index, node in enumerate(extract.places)}
        transformer = Transformer.from_crs("EPSG:4326", f"EPSG:{epsg}", always_xy=True)
        lon, lat = np.array(list(extract.places.values()), dtype=np.float64).reshape(-1, 2).T
        self.points = np.column_stack(transformer.transform(lon, lat))

    def __call__(self, nodes: Iterable[int]) -> np.ndarray:
        """Return eastings and northings [n, 2] of those nodes that are known."""
        return self.points[[self.index[node] for node in nodes if node in self.index]]


def is_compact(points: np.ndarray) -> bool:
    """Say whether points [n, 2] can be corners of one building."""
    if not len(points):
        return True
    (west, south), (east, north) = extremes([points])
    return max(east - west, north - south) <= MAX_SPAN_M


class Reader:
    """Makes footprints of an extract's ways and relations."""

    def __init__(self, extract: Extract, epsg: int) -> None:
        """Take an extract that is to be projected."""
        self.extract = extract
        self.project = Projector(extract, epsg)
        self.buildings = Buildings()
        # Closed ways that a relation stands for.
        self.replaced: dict[str, str] = {}

    def read(self) -> Buildings:
        """Return all buildings."""
        relations = self.extract.relations.items()
        for ident, relation in relations:
            if relation.tags["type"] == "multipolygon" and (kind := kind_of(relation.tags)):
                self.add_multipolygon(ident, relation, kind)
        for ident, way in self.extract.ways.items():
            if f"w{ident}" not in self.replaced and (kind := kind_of(way.tags)):
                self.add_way(ident, way, kind)
        for ident, relation in relations:
            if relation.tags["type"] == "building":
                self.add_group(ident, relation)
        return self.buildings

    def add_way(self, ident: int, way: Way, kind: Kind) -> None:
        """Add a closed way; an open one is only a member."""
        if not way.is_closed or not way.is_whole:
            self.buildings.no_footprint["way lacks nodes" if not way.is_whole else "way is open"] += 1
        else:
            rings = distinct(Ring(loop, {"outer"}, {ident}) for loop in loops(way.nodes))
            self.add(f"w{ident}", way.tags, kind, rings)

    def add_multipolygon(self, ident: int, relation: Relation, kind: Kind) -> None:
        """Add a relation and remember which ways it stands for."""
        rings = self.rings_of(ident, relation)
        if rings is None:
            return
        footprint = self.add(f"r{ident}", relation.tags, kind, rings)
        if footprint is None:
            return
        for ring in self.outer_rings(rings):
            for ref in ring.ways:
                way = self.extract.ways[ref]
                if kind_of(way.tags) is not kind:
                    continue
                self.replaced[f"w{ref}"] = f"r{ident}"
                if bottom_of(relation.tags) == 0 and bottom_of(way.tags) > 0:
                    footprint.doubts.add(BOTTOM_ON_WAY)
                if kind is Kind.OUTLINE and way.tags["building"] == "roof" != relation.tags["building"]:
                    footprint.doubts.add(ROOF_ON_WAY)

    def rings_of(self, ident: int, relation: Relation) -> Assembly | None:
        """Return the rings of a multipolygon, those of member relations among them; None if it is cut or open."""
        members = [member for member in relation.members if member[2] in RING_ROLES and member[0] != "n"]
        ways = [(ref, role) for kind, ref, role in members if kind == "w"]
        nested = len(ways) < len(members)
        ways += [(way, role) for kind, ref, role in members if kind == "r" and ref in self.extract.relations
                 for type_, way, inner_role in self.extract.relations[ref].members
                 if type_ == "w" and inner_role in RING_ROLES]
        assembly = assemble(ways, self.extract.ways)
        if nested or not assembly.is_whole:
            reason = "relation has relations as members" if nested else "relation is cut or open"
            self.leave_out(f"r{ident}", reason, [ref for ref, _ in ways])
        return assembly if assembly.is_whole else None

    def leave_out(self, ident: str, reason: str, ways: Iterable[int]) -> None:
        """Remember the place of an object that nothing can be said about."""
        nodes = [node for ref in ways if ref in self.extract.ways for node in self.extract.ways[ref].nodes]
        points = self.project(nodes)
        self.buildings.unclear[ident] = reason, points if is_compact(points) else points[:0]

    def outer_rings(self, assembly: Assembly) -> list[Ring]:
        """Return the rings that lie inside an even number of others, inner rings across others excepted."""
        rings = assembly.rings
        across = {index for a, b in combinations(range(len(rings)), 2)
                  if shapely.overlaps(rings[a].polygon, rings[b].polygon) for index in (a, b)
                  if rings[index].roles == {"inner"}}
        depth = [sum(shapely.contains_properly(other.polygon, ring.polygon) or (
            shapely.covers(other.polygon, ring.polygon) and other.polygon.area > ring.polygon.area)
            for other in rings if other is not ring) for ring in rings]
        return [ring for index, ring in enumerate(rings) if depth[index] % 2 == 0 and index not in across]

    def add(
        self, ident: str, tags: Mapping[str, str], kind: Kind, rings: Assembly | list[Ring],
    ) -> Footprint | None:
        """Add an object with its tags and rings; None if it encloses nothing."""
        assembly = rings if isinstance(rings, Assembly) else Assembly(rings, is_whole=True)
        for ring in assembly.rings:
            ring.points = self.project(ring.nodes)
        if not assembly.rings or not is_compact(np.concatenate([ring.points for ring in assembly.rings])):
            self.buildings.no_footprint["spans kilometres" if assembly.rings else "encloses nothing"] += 1
            return None
        doubts: set[str] = set()
        cut = self.cut_rings(assembly, doubts)
        plain = [ring for ring in assembly.rings if ring not in cut]
        if not plain:
            self.buildings.no_footprint["encloses nothing"] += 1
            return None
        tops = said_tops(tags)
        bottom = bottom_of(tags)
        if tops and tops[0].metres <= bottom:
            doubts.add("top is not above bottom")
        own = next((top for top in tops if top.metres > bottom), None)
        value = tags[kind.value]
        footprint = Footprint(
            ident, kind, bottom, DEFAULT_HEIGHTS_M.get(value, DEFAULT_HEIGHT_M),
            value == "roof" or bottom > FLIGHT_HEIGHT_M, plain, cut, doubts=doubts)
        footprint.pieces = self.pieces(footprint, own, assembly)
        self.buildings.footprints[ident] = footprint
        return footprint

    def cut_rings(self, assembly: Assembly, doubts: set[str]) -> list[Ring]:
        """Return the inner rings that lie across another ring."""
        cut = []
        for a, b in combinations(assembly.rings, 2):
            if shapely.overlaps(a.polygon, b.polygon):
                if any(ring.roles not in ({"inner"}, {"outer"}) for ring in (a, b)):
                    doubts.add("rings of no clear role cross")
                cut += [ring for ring in (a, b) if ring.roles == {"inner"} and ring not in cut]
        for ring in assembly.rings:
            if ring.roles == {"inner"} and ring not in cut and not any(
                    shapely.covers(other.polygon, ring.polygon) for other in assembly.rings if other is not ring):
                doubts.add("inner ring is outside")
            if ring.roles > {"inner"}:
                doubts.add("ring is outer and inner")
        return cut

    def pieces(self, footprint: Footprint, own: Top | None, assembly: Assembly) -> list[Piece]:
        """Give each outer ring its top: that of the object, else of its ways."""
        everything = Region([ring.points for ring in footprint.plain], [ring.points for ring in footprint.cut])
        if own is not None or footprint.ident.startswith("w"):
            return [Piece(everything, own)]
        outer = self.outer_rings(assembly)
        tops = {id(ring): self.inherited(footprint, ring) for ring in outer}
        if len(set(tops.values())) <= 1:
            return [Piece(everything, next(iter(tops.values()), None))]
        if None in tops.values():
            footprint.doubts.add("the ways of one ring tell a top, those of another none")
        if assembly.has_choice:
            footprint.doubts.add("rings with different tops can be put together otherwise")
        pieces = []
        for ring in outer:
            inside = [other.points for other in outer if other is not ring
                      and other.polygon.area < ring.polygon.area and shapely.covers(ring.polygon, other.polygon)]
            region = Region(everything.rings, everything.cut, ring.points, inside)
            pieces.append(Piece(region, tops[id(ring)]))
        return pieces

    def inherited(self, footprint: Footprint, ring: Ring) -> Top | None:
        """Return the highest top that a way of a ring tells."""
        ways = [self.extract.ways[ref] for ref in sorted(ring.ways)]
        told = [(way, tops[0]) for way in ways if (tops := said_tops(way.tags))]
        if not told:
            return None
        if any(kind_of(way.tags) is not footprint.kind for way, _ in told):
            footprint.doubts.add("top of an outer way that is no building of this kind")
        if len({top for _, top in told}) > 1:
            footprint.doubts.add("ways of one ring tell different tops")
        best = footprint.at_least_a_storey(max((top for _, top in told), key=lambda top: top.rank))
        if not best.is_known:
            footprint.doubts.add("inherited top is not above bottom")
        return best

    def add_group(self, ident: int, relation: Relation) -> None:
        """Read a relation of type `building`: lend its tags to bare outlines, remember what belongs together."""
        kind = kind_of(relation.tags)
        outlines, parts, bare = set(), set(), []
        for type_, ref, role in relation.members:
            name = f"{type_}{ref}"
            name = self.replaced.get(name, name)
            if role == "part":
                parts.add(name)
            elif role == "outline":
                outlines.add(name)
                if kind is not None and name not in self.buildings.footprints:
                    bare.append((type_, ref))
        if bare:
            self.add_bare(ident, relation, kind, bare)
            outlines.add(f"r{ident}")
        self.buildings.groups.append((outlines, parts))

    def add_bare(self, ident: int, relation: Relation, kind: Kind, bare: list[tuple[str, int]]) -> None:
        """Add the outlines without tags of their own as one object with the relation's tags."""
        members = []
        for type_, ref in bare:
            holder = (self.extract.ways if type_ == "w" else self.extract.relations).get(ref)
            if holder is None:
                members.append((ref, "missing"))
            elif not is_tagged(holder.tags):
                members += [(ref, "outer")] if type_ == "w" else [
                    (way, role) for kind, way, role in holder.members if kind == "w" and role in RING_ROLES]
        if not members:
            return
        assembly = assemble(members, self.extract.ways)
        if assembly.is_whole:
            self.add(f"r{ident}", relation.tags, kind, assembly)
            return
        self.leave_out(f"r{ident}", "outline is cut or open", [ref for ref, _ in members])


# ---------------------------------------------------------------- parts and outlines


class Reading(Enum):
    """What the rules can be taken to mean where a part lies across outlines, or below a raised outline of its own."""

    USUAL = "a part belongs to every outline with more than half of it, else to the one with most of it"
    HALF = "a part belongs to every outline with about half of it or more, else to none"
    MOST = "a part belongs to the outline with most of it"
    TOUCHED = "a part belongs to every outline with more of it than a touch"
    APART = "as usual, but a raised outline is a building besides its parts"


class Ownership:
    """Which outlines each part can belong to."""

    def __init__(self, buildings: Buildings) -> None:
        """Measure which share of each part lies in which outline."""
        self.shares: dict[str, dict[str, float]] = defaultdict(dict)
        self.by_relation: dict[str, set[str]] = defaultdict(set)
        outlines, parts = buildings.of_kind(Kind.OUTLINE), buildings.of_kind(Kind.PART)
        if not outlines or not parts:
            return
        names = {outline.ident for outline in outlines}
        for grouped, members in buildings.groups:
            for part in members:
                self.by_relation[part] |= grouped & names
        shapes = np.array([outline.geometry for outline in outlines])
        pieces = np.array([part.geometry for part in parts])
        part, outline = shapely.STRtree(shapes).query(pieces, predicate="intersects")
        areas = shapely.area(shapely.intersection(pieces[part], shapes[outline]))
        shares = areas / np.maximum(shapely.area(pieces[part]), 1e-9)
        for a, b, share in zip(part, outline, shares, strict=True):
            if share > TOUCH:
                self.shares[parts[a].ident][outlines[b].ident] = float(share)

    def owners(self, part: str, reading: Reading) -> set[str]:
        """Return the outlines that a part belongs to, by a reading."""
        shares = self.shares.get(part, {})
        most = {max(shares, key=lambda outline: (shares[outline], outline))} if shares else set()
        by_place = {
            Reading.USUAL: {outline for outline, share in shares.items() if share > 0.5} or most,
            Reading.HALF: {outline for outline, share in shares.items() if share > ABOUT_HALF},
            Reading.MOST: most,
            Reading.TOUCHED: set(shares),
        }[Reading.USUAL if reading is Reading.APART else reading]
        return by_place | self.by_relation.get(part, set())


@dataclass
class Member:
    """A footprint with its regions and their tops, none of them unknown."""

    footprint: Footprint
    regions: list[tuple[Region, Top]]


@dataclass
class Building:
    """An outline with its parts, or a part by itself."""

    outline: Member | None
    parts: list[Member]

    @property
    def members(self) -> list[Member]:
        """All of them."""
        return [*self.parts, self.outline] if self.outline else self.parts

    @property
    def box(self) -> Box:
        """The cells that it can have."""
        return union_box(region.box for member in self.members for region, _ in member.regions)


@dataclass
class City:
    """Buildings by one reading, and the objects that are in doubt, by themselves or because their outlines are."""

    buildings: list[Building]
    doubts: dict[str, set[str]]

    @cached_property
    def boxes(self) -> np.ndarray:
        """West, south, east, north of each building, [n, 4]."""
        boxes = [building.box for building in self.buildings]
        return np.array([(box.west, box.south, box.east, box.north) for box in boxes]).reshape(-1, 4)

    def near(self, box: Box) -> list[Building]:
        """Return the buildings that can have cells in a window."""
        west, south, east, north = self.boxes.T
        touches = (west < box.east) & (east > box.west) & (south < box.north) & (north > box.south)
        return [self.buildings[index] for index in np.flatnonzero(touches)]


def settle(buildings: Buildings, ownership: Ownership, reading: Reading) -> City:
    """Give every region a top and every part its buildings."""
    doubts = {name: set(footprint.doubts) for name, footprint in buildings.footprints.items()}
    outlines = {outline.ident: Member(outline, [(piece.region, piece.top or outline.guess)
                                                for piece in outline.pieces])
                for outline in buildings.of_kind(Kind.OUTLINE)}
    belonging: dict[str, list[Member]] = defaultdict(list)
    alone: list[Member] = []
    for part in buildings.of_kind(Kind.PART):
        owners = sorted(ownership.owners(part.ident, reading))
        inherited = None
        if any(piece.top is None for piece in part.pieces):
            inherited = inherited_top(part, [outlines[owner] for owner in owners], doubts)
        member = Member(part, [(piece.region, piece.top or inherited) for piece in part.pieces])
        for owner in owners:
            belonging[owner].append(member)
        if not owners:
            alone.append(member)
    city = [Building(outlines[name], belonging[name]) for name in outlines] + [
        Building(None, [member]) for member in alone]
    if reading is Reading.APART:
        city += [Building(outline, []) for outline in outlines.values() if outline.footprint.is_raised]
    return City(city, doubts)


def inherited_top(part: Footprint, owners: list[Member], doubts: dict[str, set[str]]) -> Top:
    """Return the top that a silent part takes from its outlines, else that of its type."""
    known = []
    for owner in owners:
        if doubts[owner.footprint.ident]:
            doubts[part.ident].add("inherits from an outline in doubt")
        tops = {top for _, top in owner.regions}
        if len(tops) > 1:
            doubts[part.ident].add("inherits from an outline with several tops")
        known += [top for top in tops if top.is_known]
    if not known:
        return part.guess
    if len(set(known)) > 1:
        doubts[part.ident].add("outlines that contain the part tell different tops")
    best = part.at_least_a_storey(max(known, key=lambda top: top.rank))
    if not best.is_known:
        doubts[part.ident].add("inherited top is not above bottom")
    return best


# ---------------------------------------------------------------- painting


@dataclass
class Layer:
    """The highest known tops with their sources, and the highest guesses; 0 where there is none.

    `is_tie` marks cells where the same height comes from two sources: either is right.
    """

    box: Box
    known: np.ndarray
    source: np.ndarray
    guess: np.ndarray
    is_tie: np.ndarray

    @classmethod
    def empty(cls, box: Box) -> "Layer":
        """Return a layer without anything."""
        return cls(box, np.zeros(box.shape), np.zeros(box.shape, np.uint8), np.zeros(box.shape),
                   np.zeros(box.shape, bool))

    def raise_to(self, box: Box, mask: np.ndarray, top: Top) -> None:
        """Raise some cells to a top, where that is higher."""
        common = self.box.meet(box)
        if 0 in common.shape:
            return
        here, mask = self.box.of(common), mask[box.of(common)]
        if not top.is_known:
            guess = self.guess[here]
            guess[mask & (guess < top.metres)] = top.metres
            return
        known, source, is_tie = self.known[here], self.source[here], self.is_tie[here]
        higher = mask & (known < top.metres)
        is_tie[mask & (known == top.metres) & (source != top.source)] = True
        is_tie[higher] = False
        known[higher] = top.metres
        source[higher] = top.source
        source[mask & (known == top.metres)] = np.minimum(source, top.source)[mask & (known == top.metres)]

    def merge(self, other: "Layer") -> None:
        """Raise this layer to another's."""
        common = self.box.meet(other.box)
        if 0 in common.shape:
            return
        here, there = self.box.of(common), other.box.of(common)
        known, theirs = self.known[here], other.known[there]
        source, other_source = self.source[here], other.source[there]
        equal = (theirs > 0) & (theirs == known)
        higher = theirs > known
        self.is_tie[here][equal & ((source != other_source) | other.is_tie[there])] = True
        self.is_tie[here][higher] = other.is_tie[there][higher]
        source[equal] = np.minimum(source, other_source)[equal]
        source[higher] = other_source[higher]
        known[higher] = theirs[higher]
        np.maximum(self.guess[here], other.guess[there], out=self.guess[here])


@dataclass
class Surface:
    """Heights, sources and ties of a window; row 0 is the southernmost."""

    heights: np.ndarray
    sources: np.ndarray
    is_tie: np.ndarray


def column(building: Building) -> Layer:
    """Return the cells of one building: its parts' tops, and its outline's where no part lies."""
    layer = Layer.empty(building.box)
    for part in building.parts:
        for region, top in part.regions:
            layer.raise_to(region.box, region.mask, top)
    if building.outline:
        bare = (layer.known == 0) & (layer.guess == 0)
        for region, top in building.outline.regions:
            layer.raise_to(region.box, region.mask & bare[layer.box.of(region.box)], top)
    return layer


def paint(city: City, box: Box) -> Surface:
    """Return what a window holds by one reading."""
    layer, ground = Layer.empty(box), np.zeros(box.shape, bool)
    for building in city.near(box):
        for member in building.members:
            for region, _ in member.regions:
                common = box.meet(region.box)
                if not member.footprint.is_raised and 0 not in common.shape:
                    ground[box.of(common)] |= region.mask[region.box.of(common)]
        layer.merge(column(building))
    known = ground & (layer.known > 0)
    guessed = ground & ~known & (layer.guess > 0)
    heights = np.where(known, layer.known, np.where(guessed, layer.guess, 0.0)).astype(np.float32)
    sources = np.where(known, layer.source, np.where(guessed, GUESS, OPEN)).astype(np.uint8)
    return Surface(heights, sources, layer.is_tie & known)


class Reference:
    """The heights of an extract, with what is in doubt."""

    def __init__(self, path: Path, epsg: int) -> None:
        """Read an extract."""
        self.buildings = Reader(read_extract(path), epsg).read()
        ownership = Ownership(self.buildings)
        self.city = settle(self.buildings, ownership, Reading.USUAL)
        # A reading that changes nothing need not be painted.
        parts = [part.ident for part in self.buildings.of_kind(Kind.PART)]
        raised = {outline.ident for outline in self.buildings.of_kind(Kind.OUTLINE) if outline.is_raised}
        self.others = {}
        for reading in list(Reading)[1:]:
            usual = [(ownership.owners(part, Reading.USUAL), ownership.owners(part, reading)) for part in parts]
            if any(ours != theirs or (reading is Reading.APART and ours & raised) for ours, theirs in usual):
                self.others[reading] = settle(self.buildings, ownership, reading)

    @property
    def box(self) -> Box:
        """The window of all buildings."""
        return union_box(piece.region.box for footprint in self.buildings.footprints.values()
                         for piece in footprint.pieces)

    def surface(self, box: Box) -> Surface:
        """Return the heights of a window."""
        return paint(self.city, box)

    def doubtful(self, box: Box, surface: Surface) -> dict[str, np.ndarray]:
        """Mark by reason the cells of a window that are to be left out."""
        masks: dict[str, np.ndarray] = defaultdict(lambda: np.zeros(box.shape, bool))
        for name, reasons in self.city.doubts.items():
            for reason in reasons:
                footprint = self.buildings.footprints[name]
                for piece in footprint.pieces:
                    common = box.meet(piece.region.box)
                    if 0 in common.shape:
                        continue
                    cells = piece.region.mask[piece.region.box.of(common)]
                    # What is raised leaves open ground open, however high it is.
                    if footprint.is_raised and reason not in RAISED_IN_DOUBT:
                        cells = cells & (surface.sources[box.of(common)] != OPEN)
                    masks[reason][box.of(common)] |= cells
        for reason, points in self.buildings.unclear.values():
            if len(points) and 0 not in (common := box.meet(box_around([points]))).shape:
                masks[reason][box.of(common)] = True
        for reading, other in self.others.items():
            different = paint(other, box)
            masks[f"reading {reading.name}"] |= (different.heights != surface.heights) | (
                different.sources != surface.sources)
        return {reason: mask for reason, mask in masks.items() if mask.any()}

    def objects_in_doubt(self) -> dict[str, list[str]]:
        """Return the objects that the rules do not settle, with the reasons."""
        doubts = {name: sorted(reasons) for name, reasons in self.city.doubts.items() if reasons}
        return doubts | {name: [reason] for name, (reason, _) in self.buildings.unclear.items()}

    def edges_at(self, points: np.ndarray) -> np.ndarray:
        """Return the edges [n, 2, 2] of the objects near some points."""
        boxes = shapely.box(*(points - 1).T, *(points + 1).T)
        tree = shapely.STRtree(boxes)
        rings = []
        for footprint in self.buildings.footprints.values():
            for piece in footprint.pieces:
                box = piece.region.box
                if len(tree.query(shapely.box(box.west, box.south, box.east, box.north))):
                    rings += [*piece.region.rings, *piece.region.cut]
        return np.concatenate([np.empty((0, 2, 2)), *(np.stack([ring[:-1], ring[1:]], axis=1) for ring in rings)])

    def at(self, easting: float, northing: float) -> tuple[float, int]:
        """Return height and source of the cell at a place."""
        west, south = floor(easting), floor(northing)
        surface = self.surface(Box(west, south, west + 1, south + 1))
        return float(surface.heights[0, 0]), int(surface.sources[0, 0])

    def tops(self, ident: str) -> Counter[tuple[float, int]]:
        """Count the cells of an object's footprint by height and source."""
        cells: Counter[tuple[float, int]] = Counter()
        for piece in self.buildings.footprints[ident].pieces:
            surface = self.surface(piece.region.box)
            mask = piece.region.mask
            cells.update(zip(surface.heights[mask].tolist(), surface.sources[mask].tolist(), strict=True))
        return cells


# ---------------------------------------------------------------- comparison


def tile_box(tile: Tile) -> Box:
    """Return a tile's window."""
    west, south, east, north = tile.bounds
    if tile.cell != 1.0 or any(value != int(value) for value in tile.bounds):
        sys.exit(f"error: {tile.ident}: expected cells of 1 m at whole metres, found {tile.cell} m from {west} {north}")
    return Box(int(west), int(south), int(east), int(north))


def read_arrays(tile: Tile) -> tuple[np.ndarray, np.ndarray]:
    """Read heights and sources of a tile, the southernmost row first."""
    heights = tile.heights()
    with np.load(tile.path) as arrays:
        sources = arrays["height_source"]
    return heights[::-1], sources[::-1]


def found_tops(reference: Reference, tiles: list[Tile], ident: str) -> Counter[tuple[float, int]]:
    """Count the cells of an object's footprint by the height and source that the tiles hold."""
    cells: dict[tuple[int, int], tuple[float, int]] = {}
    for tile in tiles:
        box = tile_box(tile)
        for piece in reference.buildings.footprints[ident].pieces:
            common = box.meet(piece.region.box)
            if 0 in common.shape:
                continue
            heights, sources = read_arrays(tile)
            rows, columns = np.nonzero(piece.region.mask[piece.region.box.of(common)])
            here = box.of(common)
            places = zip((rows + common.south).tolist(), (columns + common.west).tolist(), strict=True)
            tops = zip(heights[here][rows, columns].tolist(), sources[here][rows, columns].tolist(), strict=True)
            cells.update(zip(places, tops, strict=True))
    return Counter(cells.values())


@dataclass
class Totals:
    """What was compared, and how it came out."""

    tiles: int = 0
    cells: int = 0
    by_source: Counter[int] = field(default_factory=Counter)
    left_out: Counter[str] = field(default_factory=Counter)
    left_out_cells: int = 0
    left_out_built_cells: int = 0
    left_out_that_differ: int = 0
    on_edge_cells: int = 0
    wrong_cells: int = 0
    differences: list[dict[str, object]] = field(default_factory=list)

    def failures(self) -> list[str]:
        """Return the reasons why the check fails; none if the tiles are right."""
        built = sum(self.by_source[source] for source in (HEIGHT, LEVELS, GUESS))
        reasons = {
            "no building cell was compared": built == 0,
            f"{self.wrong_cells} cells differ that lie on no edge": self.wrong_cells > 0,
            f"more than {MAX_LEFT_OUT_SHARE:.1%} of the cells are left out":
                self.left_out_cells > MAX_LEFT_OUT_SHARE * (self.cells + self.left_out_cells),
            f"more than {MAX_LEFT_OUT_BUILT_SHARE:.1%} of the building cells are left out":
                self.left_out_built_cells > MAX_LEFT_OUT_BUILT_SHARE * (built + self.left_out_built_cells),
        }
        return [reason for reason, holds in reasons.items() if holds]

    def summary(self) -> dict[str, object]:
        """Return the counts."""
        names = ("open", "height", "levels", "guess")
        return {name: value for name, value in vars(self).items() if name != "differences"} | {
            "by_source": {names[source]: count for source, count in sorted(self.by_source.items())},
            "left_out": dict(sorted(self.left_out.items())),
        }


def compare(reference: Reference, tiles: list[Tile]) -> Totals:
    """Compare tiles with the reference; of a small city all are painted in one go."""
    totals = Totals()
    boxes = [tile_box(tile) for tile in tiles]
    windows = list(zip(boxes, [[index] for index in range(len(tiles))], strict=True))
    if tiles and np.prod((whole := union_box(boxes)).shape) <= MAX_WINDOW_CELLS:
        windows = [(whole, list(range(len(tiles))))]
    for window, indices in windows:
        surface = reference.surface(window)
        masks = reference.doubtful(window, surface)
        for index in indices:
            compare_tile(reference, tiles[index], window, surface, masks, totals)
    return totals


def compare_tile(
    reference: Reference, tile: Tile, window: Box, surface: Surface, masks: dict[str, np.ndarray], totals: Totals,
) -> None:
    """Compare one tile with its part of a painted window."""
    box = tile_box(tile)
    here = window.of(box)
    heights, sources = read_arrays(tile)
    expected, expected_sources = surface.heights[here], surface.sources[here]
    left_out = np.zeros(box.shape, bool)
    for reason, mask in masks.items():
        left_out |= mask[here]
        totals.left_out[reason] += int(mask[here].sum())
    wrong = (np.abs(heights - expected) > HEIGHT_TOLERANCE_M) | (
        (sources != expected_sources) & ~surface.is_tie[here])
    totals.tiles += 1
    totals.cells += int((~left_out).sum())
    totals.left_out_cells += int(left_out.sum())
    totals.left_out_built_cells += int((left_out & (expected_sources != OPEN)).sum())
    totals.left_out_that_differ += int((wrong & left_out).sum())
    totals.by_source.update(dict(enumerate(np.bincount(expected_sources[~left_out], minlength=4).tolist())))
    rows, columns = np.nonzero(wrong & ~left_out)
    if not len(rows):
        return
    points = np.column_stack([box.west + columns + 0.5, box.south + rows + 0.5])
    edges = reference.edges_at(points)
    on_edge = on_an_edge(points, edges) if len(edges) else np.zeros(len(points), bool)
    totals.on_edge_cells += int(on_edge.sum())
    totals.wrong_cells += int((~on_edge).sum())
    # One cell of each kind is enough to look at.
    kinds = np.column_stack([array[rows, columns] for array in (heights, sources, expected, expected_sources)])
    _, first, count = np.unique(kinds[~on_edge], axis=0, return_index=True, return_counts=True)
    for kind, cells in zip(first[np.argsort(-count)], np.sort(count)[::-1], strict=True):
        if len(totals.differences) == MAX_LISTED:
            break
        index = np.flatnonzero(~on_edge)[kind]
        objects = objects_at(reference, *points[index])
        if objects not in [listed["objects"] for listed in totals.differences]:
            height, source, expected_height, expected_source = kinds[index].tolist()
            totals.differences.append({
                "tile": tile.ident, "cells": int(cells), "easting": float(points[index, 0]),
                "northing": float(points[index, 1]), "found": [height, int(source)],
                "expected": [expected_height, int(expected_source)], "objects": objects,
            })


def objects_at(reference: Reference, easting: float, northing: float) -> list[str]:
    """Name the objects over a place, with their bottoms and tops."""
    west, south = int(easting), int(northing)
    names = []
    cell = Box(west, south, west + 1, south + 1)
    for building in reference.city.near(cell):
        outline = building.outline
        for member in building.members:
            for region, top in member.regions:
                common = region.box.meet(cell)
                if 0 not in common.shape and region.mask[region.box.of(common)].any():
                    footprint = member.footprint
                    owner = f" in {outline.footprint.ident}" if outline and member is not outline else ""
                    names.append(f"{footprint.ident} {footprint.kind.value}{owner} "
                                 f"{footprint.bottom:g}..{top.metres:g} m ({top.source})")
    return sorted(set(names))


def show(reference: Reference, idents: list[str], name: str) -> None:
    """Print what some objects' cells hold, and how many objects there are."""
    for ident in idents:
        for (height, source), cells in sorted(reference.tops(ident).items()):
            print(f"{ident}: {cells} cells at {height:g} m of source {source}")
    outlines, parts = (len(reference.buildings.of_kind(kind)) for kind in Kind)
    by_reason = Counter(reason for reasons in reference.objects_in_doubt().values() for reason in reasons)
    print(f"{name}: {outlines} outlines, {parts} parts, in doubt: {dict(by_reason)}, "
          f"without a footprint: {dict(reference.buildings.no_footprint)}")


def main() -> int:
    """Run the check, or show some objects, and return the exit status."""
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--osm", type=Path, required=True, metavar="FILE")
    given = parser.add_mutually_exclusive_group(required=True)
    given.add_argument("--tiles", type=Path, metavar="DIR", help="compare these")
    given.add_argument("--epsg", type=int, metavar="CODE", help="compare nothing; read the extract in this projection")
    parser.add_argument("--object", action="append", default=[], metavar="ID",
                        help="show this one's cells by height and source, for instance w34633854; may be repeated")
    parser.add_argument("--max-tiles", type=int, metavar="N", help="compare a random sample of N tiles")
    parser.add_argument("--seed", type=int, default=0, metavar="S", help="of the sample (default 0)")
    parser.add_argument("--json", type=Path, metavar="OUT", help="write the counts and differences here")
    args = parser.parse_args()

    epsg, tiles = read_tiles(args.tiles) if args.tiles else (args.epsg, [])
    if args.max_tiles is not None and args.max_tiles < len(tiles):
        tiles = random.Random(args.seed).sample(tiles, args.max_tiles)
    # What is read lives until the end; looking for garbage in it takes a third of the time.
    gc.disable()
    reference = Reference(require(args.osm), epsg)
    show(reference, args.object, args.osm.name)
    if not args.tiles:
        return 0

    totals = compare(reference, tiles)
    failures, summary, doubts = totals.failures(), totals.summary(), reference.objects_in_doubt()
    if args.json:
        report = {"equal": not failures, "failures": failures, **summary, "objects_in_doubt": doubts,
                  "differences": totals.differences}
        args.json.write_text(json.dumps(report, indent=2) + "\n", encoding="utf-8")
    if failures:
        for name, reasons in doubts.items():
            print(f"in doubt: {name}: {', '.join(reasons)}")
    for difference in totals.differences:
        print("  ".join(f"{name} {value}" for name, value in difference.items()))
    for failure in failures:
        print(f"failure: {failure}")
    print(f"{'FAILED' if failures else 'equal'}: {args.osm.name}: {json.dumps(summary)}")
    return int(bool(failures))


if __name__ == "__main__":
    sys.exit(main())
