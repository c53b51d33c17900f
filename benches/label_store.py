"""The traces of the study of label reliability: tiles, scenes, the queue, and a folder that keeps every trace.

    STORE/tiles.json               ids of the tiles, in the study's order, with built share
    STORE/tiles/<id>.npz           height grids
    STORE/scenes/<set>/<id>/       scenes: `base`, and those of sets that change them
    STORE/traces/<set>/<id>-<repeat>.npz   path_gain (float32, linear, row 0 south), meta_json, cost_json (seconds)

A trace is whole or absent, so that a killed queue goes on where it was.
"""

import csv
import json
import random
import shutil
import subprocess
import tempfile
import tomllib
from collections.abc import Iterator
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np

STUDY = Path(__file__).parent / "labels/study.toml"
# Keys of a set that change the scene, and not the options of a trace.
SCENE_KEYS = ("walls", "roofs_m", "uneven")
Settings = dict[str, Any]


@dataclass(frozen=True)
class Job:
    """One trace: repeat `repeat` of a set on a tile."""

    set: str
    tile: str
    repeat: int

    def path(self, store: Path) -> Path:
        """Where the trace is kept."""
        return store / "traces" / self.set / f"{self.tile}-{self.repeat}.npz"


def read_study() -> Settings:
    """Tiles, sets and queue."""
    return tomllib.loads(STUDY.read_text())


def queue(study: Settings, tiles: list[str]) -> Iterator[Job]:
    """All jobs in the order in which they are traced, each once."""
    seen = set()
    for step in study["queue"]:
        names = [step["set"]] if isinstance(step["set"], str) else step["set"]
        for repeat in range(step["repeats"]):
            for name in names:
                for tile in tiles[:step["tiles"]]:
                    job = Job(name, tile, repeat)
                    if job not in seen:
                        seen.add(job)
                        yield job


def planned(study: Settings) -> dict[str, int]:
    """How many repeats of each set the queue asks for."""
    most = dict.fromkeys(study["sets"], 0)
    for step in study["queue"]:
        for name in [step["set"]] if isinstance(step["set"], str) else step["set"]:
            most[name] = max(most[name], step["repeats"])
    return most


# ---------------------------------------------------------------- tiles


def bit_reversed(count: int) -> list[int]:
    """0 to count - 1 in the order of the van der Corput sequence: any first few are spread over all."""
    bits = max(1, (count - 1).bit_length())
    return [value for index in range(2**bits) if (value := int(f"{index:0{bits}b}"[::-1], 2)) < count]


def choose_tiles(table: Path, count: int, seed: int) -> list[dict[str, Any]]:
    """A random kept tile of each of `count` quantiles of built share, in bit-reversed order of the quantiles."""
    with table.open() as file:
        kept = sorted((float(row["built"]), row["id"]) for row in csv.DictReader(file) if row["verdict"] == "kept")
    draw = random.Random(seed)
    bounds = [len(kept) * index // count for index in range(count + 1)]
    chosen = [draw.choice(kept[begin:end]) for begin, end in zip(bounds, bounds[1:], strict=False)]
    return [{"id": chosen[index][1], "built": chosen[index][0], "quantile": index} for index in bit_reversed(count)]


def prepare(store: Path, holescout: Path, extract: Path) -> None:
    """Makes tiles and scenes of the study's tiles with the program, once."""
    if (store / "tiles.json").exists():
        return
    study = read_study()["tiles"]
    store.mkdir(parents=True, exist_ok=True)
    with tempfile.TemporaryDirectory(dir=store) as name:
        work = Path(name)
        subprocess.run([holescout, "rasterise", "--osm", extract, "--out", work / "tiles"], check=True, capture_output=True)
        subprocess.run([holescout, "scenes", "--osm", extract, "--tiles", work / "tiles", "--out", work / "scenes", "--placement", "any"],
                       check=True, capture_output=True)
        chosen = choose_tiles(work / "tiles/tiles.csv", study["count"], study["seed"])
        (store / "tiles").mkdir(exist_ok=True)
        for tile in chosen:
            shutil.copy(work / "tiles" / f"{tile['id']}.npz", store / "tiles")
            shutil.copytree(work / "scenes" / tile["id"], store / "scenes/base" / tile["id"], dirs_exist_ok=True)
        (store / "tiles.json").write_text(json.dumps(chosen, indent=1))


def read_tiles(store: Path) -> list[str]:
    """Ids of the study's tiles, in its order."""
    return [tile["id"] for tile in json.loads((store / "tiles.json").read_text())]


# ---------------------------------------------------------------- scenes


def scene_of(store: Path, name: str, settings: Settings, tile: str) -> Path:
    """The folder of a tile's scene as a set wants it, made from the base scene if need be."""
    base = store / "scenes/base" / tile
    changes = {key: settings[key] for key in SCENE_KEYS if key in settings}
    if not changes:
        return base
    folder = store / "scenes" / name / tile
    if not folder.exists():
        part = store / "scenes" / f".{name}-{tile}"
        shutil.rmtree(part, ignore_errors=True)
        shutil.copytree(base, part)
        if "walls" in changes:
            change_walls(part, changes["walls"])
        if "roofs_m" in changes:
            change_roofs(part, changes["roofs_m"], changes.get("uneven", False))
        folder.parent.mkdir(exist_ok=True)
        part.rename(folder)
    return folder


def change_walls(folder: Path, material: str) -> None:
    """Buildings of another ITU material."""
    xml, description = folder / "scene.xml", folder / "scene.json"
    found = json.loads(description.read_text())
    old = found["materials"]["buildings"]
    xml.write_text(xml.read_text().replace(f'"{old}"', f'"{material}"').replace(f"itu_{old}", f"itu_{material}"))
    found["materials"]["buildings"] = material
    description.write_text(json.dumps(found))


def change_roofs(folder: Path, by_m: float, uneven: bool) -> None:
    """All solids higher by some metres (lower if negative), or each at random higher or lower.

    No roof comes below half of its height. A base station on a building keeps its height over the roof.
    """
    path = folder / "buildings.ply"
    data = path.read_bytes()
    end = data.index(b"end_header\n") + len(b"end_header\n")
    header = data[:end].decode()
    vertices, faces = (int(header.split(f"element {kind} ")[1].split()[0]) for kind in ("vertex", "face"))
    expected = ("format binary_little_endian", "property float x\nproperty float y\nproperty float z\nelement",
                "property list uchar int vertex_ind")
    if not all(text in header for text in expected):
        raise ValueError(f"{path}: expected a mesh as `holescout scenes` writes it, found {header!r}")
    points = np.frombuffer(data, "<f4", 3 * vertices, end).reshape(-1, 3).copy()
    corners = np.frombuffer(data, [("n", "u1"), ("of", "<i4", 3)], faces, end + points.nbytes)["of"]
    solid = solids_of(vertices, corners)
    step = np.full(solid.max() + 1, by_m)
    if uneven:
        step *= np.random.default_rng(1).choice([-1.0, 1.0], len(step))
    height = points[:, 2].copy()
    points[:, 2] = np.where(height > 0, np.maximum(height + step[solid], height / 2), height)
    path.write_bytes(data[:end] + points.tobytes() + data[end + points.nbytes:])

    description = folder / "scene.json"
    found = json.loads(description.read_text())
    for station in found["base_stations"]:
        if station["on_building"]:
            east, north, up = station["position_m"]
            # The roof under it belongs to the triangle, seen from above, that it stands over.
            a, b, c = (points[corners[:, k], :2].astype(float) - (east, north) for k in range(3))
            areas = [p[:, 0] * q[:, 1] - p[:, 1] * q[:, 0] for p, q in ((a, b), (b, c), (c, a))]
            over = np.all([area >= 0 for area in areas], 0) & (sum(areas) > 0)
            old = height[corners[over]].max(1)
            roof = corners[over][np.abs(old - old.max()) < 1e-3][0]
            station["position_m"][2] = round(float(up + (points[roof, 2] - height[roof]).max()), 3)
    description.write_text(json.dumps(found))


def solids_of(vertices: int, corners: np.ndarray) -> np.ndarray:
    """The number of the solid that each vertex belongs to."""
    from scipy.sparse import coo_matrix
    from scipy.sparse.csgraph import connected_components

    edges = np.vstack([corners[:, [0, 1]], corners[:, [1, 2]]])
    graph = coo_matrix((np.ones(len(edges), dtype=np.int8), (edges[:, 0], edges[:, 1])), shape=(vertices, vertices))
    return connected_components(graph, directed=False)[1]
