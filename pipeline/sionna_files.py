"""The files of `sionna_trace.py`: what it reads of a scene, and the maps that it writes.

Nothing here loads Sionna, so that a run that finds all its maps there ends in an instant.
"""

import hashlib
import importlib.metadata
import json
import math
import os
import re
import zipfile
import zlib
from dataclasses import dataclass
from pathlib import Path
from typing import Any
from xml.etree import ElementTree

import numpy as np

SIONNA_VERSION = "2.2.0"
SCHEMA = "radio_map.v1"
SCENE_SCHEMA = "scene.v1"
# How metadata call what makes repeats differ (`sionna_repeats`).
DIRECTION_SHIFT = "random"
# How far above free space a cell of a repeat is taken for an artefact of diffraction (`sionna_repeats`), in dB.
CEILING_DB = 15.0
# Places in the hash table of wedges as Sionna has it.
WEDGE_TABLE = 10_000
# What `holescout scenes` leaves while it is not finished.
JOURNALS = ".holescout-build*.jsonl"

Metadata = dict[str, Any]


class InvalidInput(Exception):
    """An input that does not fit: file, expected, found, mend."""


@dataclass(frozen=True)
class Options:
    """Parameters of tracing. Lengths in metres, frequency in Hz; None stands for the scene's own value.

    `samples` are the rays of one repeat, `rays_per_cell` and `max_samples` those of all of them together.
    """

    cell_m: float | None
    size_m: float | None
    samples: int | None
    rays_per_cell: float
    max_samples: int
    max_depth: int
    frequency_hz: float
    tx_power_dbm: float
    refraction: bool
    diffraction: bool
    seed: int
    repeats: int = 1
    wedge_table: int = WEDGE_TABLE


@dataclass(frozen=True)
class Scene:
    """A scene to be traced.

    `grid` is the number of cells along a side, `metadata` what is written beside the map, `note` what a person should know.
    """

    ident: str
    xml: Path
    metadata: Metadata
    grid: int
    note: str | None

    @property
    def base_stations(self) -> list[list[float]]:
        """East, north and up of every base station from the tile's centre on the ground, in metres."""
        positions = self.metadata["tx_position_m"]
        return positions if isinstance(positions[0], list) else [positions]


# ---------------------------------------------------------------- scenes


def sionna_version() -> str:
    """Version of the installed solver. Raises InvalidInput if it is not the one that this program was written for."""
    try:
        version = importlib.metadata.version("sionna-rt")
    except importlib.metadata.PackageNotFoundError:
        version = "none"
    if version != SIONNA_VERSION:
        raise InvalidInput(f"expected sionna-rt {SIONNA_VERSION}, found {version}: install pipeline/sionna-requirements.txt")
    return version


def rays_per_cell(samples: float, cell_m: float, distance_m: float, height_m: float) -> float:
    """Expected line-of-sight rays that cross a cell of the receiver plane.

    `samples` rays leave in all directions; the cell is `distance_m` away on the plane, `height_m` below the base station.
    """
    return samples * cell_m**2 * height_m / (4 * math.pi * math.hypot(distance_m, height_m) ** 3)


def farthest_corner_m(position: list[float], size_m: float) -> float:
    """Horizontal distance from a base station to the corner of the map that is farthest from it."""
    return math.hypot(abs(position[0]) + size_m / 2, abs(position[1]) + size_m / 2)


def choose_samples(options: Options, rx_height_m: float, cell_m: float, size_m: float,
                   positions: list[list[float]]) -> tuple[int, str | None]:
    """Rays per base station in each repeat, and a note if all repeats have fewer than the wanted density needs.

    Two significant digits, so that many scenes share a number and with it the kernels compiled for it.
    """
    if options.samples is not None:
        return options.samples, None
    lowest = min(rays_per_cell(1, cell_m, farthest_corner_m(position, size_m), position[2] - rx_height_m)
                 for position in positions)
    needed = options.rays_per_cell / lowest / options.repeats
    unit = 10 ** max(0, math.floor(math.log10(needed)) - 1)
    samples = math.ceil(needed / unit) * unit
    cap = max(1, options.max_samples // options.repeats)
    if samples <= cap:
        return samples, None
    return cap, (
        f"{options.rays_per_cell:g} rays in the farthest cell need {samples * options.repeats:.1e} samples; the cap of "
        f"{options.max_samples:.1e} (--max-samples) leaves {options.max_samples * lowest:.2g}")


def read_materials(xml: Path) -> dict[str, str]:
    """ITU material and thickness of each object of a scene.xml, such as {"buildings": "concrete 0.3 m"}."""
    root = ElementTree.parse(xml).getroot()
    materials = {}
    for bsdf in root.findall("bsdf"):
        kind, thickness = bsdf.find("string[@name='type']"), bsdf.find("float[@name='thickness']")
        ident = bsdf.get("id", "")
        name = kind.get("value", "") if kind is not None else re.sub("^(mat-)?itu[_-]", "", ident)
        materials[ident] = name if thickness is None else f"{name} {float(thickness.get('value', 'nan')):g} m"
    return {shape.get("id", "").removeprefix("mesh-"): materials.get(reference.get("id", ""), "")
            for shape in root.findall("shape") if (reference := shape.find("ref")) is not None}


def read_scene(folder: Path, options: Options) -> Scene:
    """Reads what is needed of a scene but its geometry.

    Raises one of FAILURES if a file is missing or does not follow the contract.
    """
    description = json.loads((folder / "scene.json").read_text())
    if description.get("schema") != SCENE_SCHEMA:
        raise InvalidInput(f"scene.json: expected schema {SCENE_SCHEMA}, found {description.get('schema')}; "
                           "make the scenes again with `holescout scenes`")
    if description["id"] != folder.name:
        raise InvalidInput(f"scene.json: expected id {folder.name}, found {description['id']}; rename the folder")
    xml = folder / "scene.xml"
    materials = read_materials(xml)
    # Where nothing is built Sionna must not be given an empty mesh.
    declared = {name: kind for name, kind in description["materials"].items() if description["solids"] or name != "buildings"}
    if {name: material.split()[0] for name, material in materials.items() if material} != declared:
        raise InvalidInput(f"scene.xml: expected the materials {declared} of scene.json, found {materials}; "
                           "make the scene again with `holescout scenes`")

    cell_m, size_m = options.cell_m or description["map_cell_m"], options.size_m or description["map_size_m"]
    grid = round(size_m / cell_m)
    if grid < 1 or not math.isclose(grid * cell_m, size_m, rel_tol=1e-9):
        raise InvalidInput(f"a map of {size_m} m is no whole number of cells of {cell_m} m; change --size or --cell")
    if size_m > description["side_m"]:
        raise InvalidInput(f"a map of {size_m} m is larger than the scene, {description['side_m']} m; lower --size")
    rx_height_m = float(description["rx_height_m"])
    positions = [[float(value) for value in station["position_m"]] for station in description["base_stations"]]
    if not positions:
        raise InvalidInput("scene.json: expected a base station, found none; add one with `holescout scenes --sites`")
    for position in positions:
        if max(abs(position[0]), abs(position[1])) > description["side_m"] / 2:
            raise InvalidInput(f"scene.json: the base station at {position} is outside of the scene of "
                               f"{description['side_m']} m; correct its position")
        # The solver counts rays that cross the plane of receivers: from within it there would be no line of sight.
        if position[2] <= rx_height_m:
            raise InvalidInput(f"scene.json: the base station at {position} is not above the receivers at {rx_height_m} m; "
                               "put it higher, or on a roof")
    samples, note = choose_samples(options, rx_height_m, cell_m, size_m, positions)
    return Scene(folder.name, xml, {
        "schema": SCHEMA,
        "location_id": description["id"],
        "value_kind": "path_gain_linear",
        "row_order": "south_first",
        "no_path_value": 0.0,
        "cell_size_m": float(cell_m),
        "map_center_m": [float(value) for value in description["center_m"]],
        "map_size_m": float(size_m),
        "crs": f"EPSG:{description['epsg']}",
        "rx_height_m": rx_height_m,
        "tx_position_m": positions[0] if len(positions) == 1 else positions,
        "tx_power_dbm": options.tx_power_dbm,
        "tx_power_is": "per_re",
        "frequency_hz": options.frequency_hz,
        "tx_pattern": "iso",
        "tx_polarization": "V",
        "sionna_version": f"sionna-rt {sionna_version()}",
        "samples_per_tx": samples,
        "max_depth": options.max_depth,
        "refraction": options.refraction,
        "diffraction": options.diffraction,
        "seed": options.seed,
        "materials": materials,
        "osm_sha256": " ".join(description["osm_sha256"]),
        "scene_sha256": hashlib.sha256((folder / "buildings.ply").read_bytes()).hexdigest(),
        "licence": description["licence"],
        "attribution": description["attribution"],
        **({"repeats": options.repeats, "direction_shift": DIRECTION_SHIFT, "ceiling_db": CEILING_DB} if options.repeats > 1 else {}),
        **({"wedge_table": options.wedge_table} if options.wedge_table != WEDGE_TABLE else {}),
    }, grid, note)


def find_scenes(root: Path, only: list[str], limit: int | None) -> list[Path]:
    """Folders of scenes, by name."""
    if not (root / "manifest.json").exists() and (journal := next(root.glob(JOURNALS), None)):
        raise InvalidInput(f"{root} is not finished ({journal.name} is there): run `holescout scenes` again, it resumes")
    folders = {path.parent.name: path.parent for path in sorted(root.glob("*/scene.json"))}
    if not folders:
        raise InvalidInput(f"{root}: expected <id>/scene.json, found none; make scenes with `holescout scenes`")
    if missing := [ident for ident in only if ident not in folders]:
        raise InvalidInput(f"{root}: no scene {', '.join(missing)} (--only)")
    return [folders[ident] for ident in sorted(set(only) or folders)][:limit]


# ---------------------------------------------------------------- maps


def read_metadata(path: Path) -> Metadata:
    """Metadata of a map that is there already. Raises InvalidInput if it is none."""
    try:
        with np.load(path, allow_pickle=False) as archive:
            metadata = json.loads(archive["meta_json"].tobytes())
        if not isinstance(metadata, dict):
            raise ValueError("meta_json is no object")
        return metadata
    except (OSError, EOFError, ValueError, KeyError, TypeError, AttributeError, NotImplementedError,
            zlib.error, zipfile.BadZipFile) as error:
        raise InvalidInput(f"{path} is no map of this program ({error}); remove it, or give --overwrite") from error


def is_traced(path: Path, metadata: Metadata, overwrite: bool) -> bool:
    """Whether the map is there with these very metadata.

    Raises InvalidInput if another one is, unless it may be overwritten.
    """
    if not path.exists():
        return False
    try:
        found = read_metadata(path)
    except InvalidInput:
        if overwrite:
            return False
        raise
    differences = [f"{key} {found.get(key)} instead of {metadata.get(key)}"
                   for key in sorted(metadata.keys() | found.keys()) if found.get(key) != metadata.get(key)]
    if differences and not overwrite:
        raise InvalidInput(f"{path} was traced otherwise: {'; '.join(differences)}. "
                           "Give the same parameters, another --out, or --overwrite")
    return not differences


def write_map(path: Path, arrays: dict[str, np.ndarray], metadata: Metadata, part_suffix: str, *, compress: bool = True) -> None:
    """Writes a map so that at any time the old one, none, or the whole new one is there."""
    part = path.with_name(f".{path.name}{part_suffix}")
    text = json.dumps(metadata, sort_keys=True, ensure_ascii=False)
    with part.open("wb") as file:
        save = np.savez_compressed if compress else np.savez
        save(file, **arrays, meta_json=np.frombuffer(text.encode(), dtype=np.uint8))
        file.flush()
        os.fsync(file.fileno())
    part.replace(path)
    sync_folder(path.parent)


def sync_folder(folder: Path) -> None:
    """Makes a renaming last."""
    descriptor = os.open(folder, os.O_RDONLY)
    try:
        os.fsync(descriptor)
    finally:
        os.close(descriptor)
