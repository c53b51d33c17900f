"""Meshes as `holescout scenes` writes them."""

from pathlib import Path

import numpy as np


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
