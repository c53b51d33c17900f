"""Scenes made by hand after the contract of `holescout scenes` (schema scene.v1), with nothing of Holescout."""

import json
from pathlib import Path

import numpy as np

XML = """<scene version="2.1.0">
  <bsdf type="itu-radio-material" id="mat-itu_concrete">
    <string name="type" value="concrete"/>
    <float name="thickness" value="0.3"/>
  </bsdf>
  <bsdf type="itu-radio-material" id="mat-itu_medium_dry_ground">
    <string name="type" value="medium_dry_ground"/>
  </bsdf>
  <shape type="ply" id="mesh-buildings">
    <string name="filename" value="buildings.ply"/>
    <boolean name="face_normals" value="true"/>
    <ref name="bsdf" id="mat-itu_concrete"/>
  </shape>
  <shape type="ply" id="mesh-ground">
    <string name="filename" value="ground.ply"/>
    <boolean name="face_normals" value="true"/>
    <ref name="bsdf" id="mat-itu_medium_dry_ground"/>
  </shape>
</scene>
"""
Solid = tuple[np.ndarray, np.ndarray]

# Nothing maps this pair onto itself: a long house in the north-east, a triangular one in the south-west.
HOUSE = ([(20, 40), (80, 40), (80, 60), (20, 60)], 20.0)
TRIANGLE = ([(-60, -50), (-30, -50), (-30, -20)], 12.0)


def prism(corners: list[tuple[float, float]], height_m: float) -> Solid:
    """A closed prism over a convex footprint (counter-clockwise): vertices [n, 3], faces [m, 3] seen from outside."""
    n = len(corners)
    ring = np.array(corners, dtype=float)
    vertices = np.vstack([np.c_[ring, np.zeros(n)], np.c_[ring, np.full(n, height_m)]])
    walls = [face for i in range(n) for j in [(i + 1) % n] for face in [(i, j, n + j), (i, n + j, n + i)]]
    roof_and_floor = [face for i in range(1, n - 1) for face in [(n, n + i, n + i + 1), (0, i + 1, i)]]
    return vertices, np.array(walls + roof_and_floor)


def join(solids: list[Solid]) -> Solid:
    """Solids in one mesh, none of them sharing a vertex with another."""
    solids = [(np.zeros((0, 3)), np.zeros((0, 3), dtype=int)), *solids]
    offsets = np.cumsum([0] + [len(vertices) for vertices, _ in solids])
    return (np.vstack([vertices for vertices, _ in solids]),
            np.vstack([faces + offset for (_, faces), offset in zip(solids, offsets, strict=False)]))


def write_ply(path: Path, solid: Solid) -> None:
    """Writes a mesh as binary PLY."""
    vertices, faces = solid
    header = (f"ply\nformat binary_little_endian 1.0\nelement vertex {len(vertices)}\nproperty float x\nproperty float y\n"
              f"property float z\nelement face {len(faces)}\nproperty list uchar int vertex_indices\nend_header\n")
    records = np.zeros(len(faces), dtype=[("corners", "u1"), ("face", "<i4", 3)])
    records["corners"], records["face"] = 3, faces
    path.write_bytes(header.encode() + vertices.astype("<f4").tobytes() + records.tobytes())


def write_scene(folder: Path, base_stations: list[list[float]], solids: list[Solid] | None = None, xml: str = XML,
                side_m: float = 400.0) -> Path:
    """Writes a scene whose map covers 200 x 200 m; its id is the folder's name."""
    folder.mkdir(parents=True)
    half = side_m / 2
    ground = np.array([(-half, -half, 0), (half, -half, 0), (half, half, 0), (-half, half, 0)])
    write_ply(folder / "ground.ply", (ground, np.array([(0, 1, 2), (0, 2, 3)])))
    solids = [prism(*HOUSE), prism(*TRIANGLE)] if solids is None else solids
    mesh = join(solids)
    write_ply(folder / "buildings.ply", mesh)
    (folder / "scene.xml").write_text(xml)
    (folder / "scene.json").write_text(json.dumps({
        "schema": "scene.v1", "id": folder.name, "epsg": 32635, "center_m": [385920.0, 6672768.0],
        "center_lon_lat": [24.944, 60.174], "side_m": side_m, "cell_m": 1.0, "map_size_m": 200, "map_cell_m": 4.0,
        "rx_height_m": 2.0,
        "base_stations": [{"position_m": position, "on_building": False, "name": None} for position in base_stations],
        "materials": {"buildings": "concrete", "ground": "medium_dry_ground"},
        "solids": len(solids), "triangles": len(mesh[1]) + 2, "osm_sha256": ["0" * 64],
        "licence": "ODbL-1.0", "attribution": "© OpenStreetMap contributors",
    }))
    return folder
