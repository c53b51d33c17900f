"""Check Holescout's UTM projection against PROJ (pyproj), forward and inverse.

The CSV has the columns epsg,lon,lat,easting,northing,lon_back,lat_back; the last two are the inverse
of the easting and northing beside them. Exit status 0: every point agrees; 1: one does not, or the
file is no good.
"""

import argparse
import csv
import sys
from collections import defaultdict
from pathlib import Path

import numpy as np
from pyproj import Transformer

COLUMNS = ("lon", "lat", "easting", "northing", "lon_back", "lat_back")
MIN_POINTS = 1000
FORWARD_TOLERANCE_M = 1e-3
INVERSE_TOLERANCE_DEG = 1e-8


def read_points(path: Path) -> dict[int, np.ndarray]:
    """Read the points as one [n, 6] float64 array for each EPSG code."""
    rows: dict[int, list[list[float]]] = defaultdict(list)
    with path.open(newline="", encoding="utf-8") as file:
        for row in csv.DictReader(file):
            rows[int(row["epsg"])].append([float(row[column]) for column in COLUMNS])
    return {epsg: np.array(points) for epsg, points in sorted(rows.items())}


def errors(epsg: int, points: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    """Return each point's distance from PROJ's forward (metres) and inverse (degrees) result."""
    lon, lat, easting, northing, lon_back, lat_back = points.T
    proj = Transformer.from_crs("EPSG:4326", f"EPSG:{epsg}", always_xy=True)
    proj_easting, proj_northing = proj.transform(lon, lat)
    proj_lon, proj_lat = proj.transform(easting, northing, direction="INVERSE")
    lon_error = np.abs((lon_back - proj_lon + 180.0) % 360.0 - 180.0)
    forward = np.hypot(easting - proj_easting, northing - proj_northing)
    return forward, np.maximum(lon_error, np.abs(lat_back - proj_lat))


def main() -> int:
    """Run the check and return the exit status."""
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--points", type=Path, required=True, metavar="CSV")
    path: Path = parser.parse_args().points
    if not path.is_file():
        sys.exit(f"error: {path} is missing")

    zones = read_points(path)
    count = sum(map(len, zones.values()))
    if count < MIN_POINTS:
        sys.exit(f"error: {path} has {count} points, at least {MIN_POINTS} are needed")

    results = [errors(epsg, points) for epsg, points in zones.items()]
    forward, inverse = (np.concatenate(parts) for parts in zip(*results))
    # Negated so that a NaN fails.
    wrong = ~((forward <= FORWARD_TOLERANCE_M) & (inverse <= INVERSE_TOLERANCE_DEG))
    codes = np.repeat(list(zones), [len(points) for points in zones.values()])
    everything = np.concatenate(list(zones.values()))
    for index in np.flatnonzero(wrong)[:20]:
        lon, lat = everything[index, :2]
        print(f"EPSG:{codes[index]} lon {lon} lat {lat}: forward off by {forward[index]:.3e} m, "
              f"inverse by {inverse[index]:.3e} degrees")
    print(f"{'FAILED' if wrong.any() else 'equal'}: {count} points in {len(zones)} zones, {wrong.sum()} wrong, "
          f"max forward difference {forward.max():.3e} m, max inverse difference {inverse.max():.3e} degrees")
    return int(wrong.any())


if __name__ == "__main__":
    sys.exit(main())
