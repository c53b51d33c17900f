"""Stages of the pipeline as functions; each does what the command of its name does, and gives the same bytes.

`settings` are those of the configuration file, as nested dictionaries: `{"grid": {"spacing_m": 512}}`. `progress(phase, done, total)`
is called now and then; what it raises, and Ctrl-C, ends the stage, which leaves nothing under a final name then.
"""

import json
import os
from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass
from functools import cached_property
from pathlib import Path
from typing import Any

from . import _native

Location = str | os.PathLike[str]
Progress = Callable[[str, int, int | None], object]


@dataclass(frozen=True)
class StageOutput:
    """A directory that a stage filled."""

    path: Path
    """The directory."""

    @cached_property
    def manifest(self) -> dict[str, Any]:
        """Its manifest (see `schemas/`)."""
        manifest: dict[str, Any] = json.loads((self.path / "manifest.json").read_bytes())
        return manifest


@dataclass(frozen=True)
class Verification:
    """What was found out about a directory."""

    schema: str
    """The schema of its manifest: what kind of output it is."""
    files: int
    """Files whose checksums were compared."""
    items: int
    """Tiles, scenes, maps or records that were read."""
    failures: list[str]
    """All that is wrong; empty if the directory is sound."""


@dataclass(frozen=True)
class _Common:
    settings: str
    out: Path
    overwrite: bool
    progress: Progress | None


def _common(settings: Mapping[str, Any] | None, out: Location, overwrite: bool, progress: Progress | None) -> _Common:
    return _Common(json.dumps(settings or {}), Path(out), overwrite, progress)


def _paths(osm: Location | Sequence[Location]) -> list[Path]:
    return [Path(osm)] if isinstance(osm, (str, os.PathLike)) else [Path(one) for one in osm]


def rasterise(
    osm: Location | Sequence[Location],
    out: Location,
    *,
    bbox: tuple[float, float, float, float] | None = None,
    area: Location | None = None,
    settings: Mapping[str, Any] | None = None,
    overwrite: bool = False,
    progress: Progress | None = None,
) -> StageOutput:
    """Buildings of `.osm.pbf` extracts to height grids; `bbox` is west, south, east, north in degrees, `area` a GeoJSON file."""
    _native.rasterise(_paths(osm), bbox, area, _common(settings, out, overwrite, progress))
    return StageOutput(Path(out))


def scenes(
    osm: Location | Sequence[Location],
    tiles: Location,
    out: Location,
    *,
    sites: Location | None = None,
    settings: Mapping[str, Any] | None = None,
    overwrite: bool = False,
    progress: Progress | None = None,
) -> StageOutput:
    """A scene with base stations for each tile, which Sionna RT traces."""
    _native.scenes(_paths(osm), tiles, sites, _common(settings, out, overwrite, progress))
    return StageOutput(Path(out))


def import_rsrp(
    maps: Location,
    tiles: Location,
    out: Location,
    *,
    scenes: Location | None = None,
    settings: Mapping[str, Any] | None = None,
    overwrite: bool = False,
    progress: Progress | None = None,
) -> StageOutput:
    """Radio maps, checked and aligned with the tiles; with `scenes` each map must be of the scene that is there."""
    _native.import_rsrp(maps, tiles, scenes, _common(settings, out, overwrite, progress))
    return StageOutput(Path(out))


def shard(
    tiles: Location,
    rsrp: Location,
    out: Location,
    *,
    settings: Mapping[str, Any] | None = None,
    overwrite: bool = False,
    progress: Progress | None = None,
) -> StageOutput:
    """Tiles and imported maps to a dataset of records."""
    _native.shard(tiles, rsrp, _common(settings, out, overwrite, progress))
    return StageOutput(Path(out))


def verify(directory: Location, *, progress: Progress | None = None) -> Verification:
    """Whether the output of any stage is what its manifest says, byte by byte and value by value."""
    return Verification(*_native.verify(directory, progress))
