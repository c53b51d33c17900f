"""What downsampling of a radio map from 1 m to 4 m should do: compared with a map that was traced at 4 m.

    make bench-downsampling SCENES=dir TILES="id id"

Each scene is traced with Sionna RT at 4 m with N rays, and at 1 m with the very same rays, which leaves nothing but the downsampling (and
the noise of diffraction), and with as many rays in a cell (16 N), which is what one would compute. A second map at 4 m with 1.1 N
rays, none of them the same, shows how far two traces differ by themselves. The 1 m maps are downsampled in four ways; differences
in dB are taken over the cells that both maps reach.
Figures go to benches/RESULTS.md.
"""

import subprocess
import sys
import tempfile
from pathlib import Path

import numpy as np

TRACE = Path(__file__).parent.parent / "pipeline/sionna_trace.py"
SAMPLES = 5_000_000
FACTOR = 4
FLOOR_DB = -160.0


def trace(scenes: Path, ident: str, cell_m: int, samples: int) -> np.ndarray:
    """Path gain of a scene's first base station, linear, [rows, columns]."""
    with tempfile.TemporaryDirectory() as maps:
        subprocess.run([sys.executable, TRACE, scenes, "--out", maps, "--only", ident, "--size", "484", "--cell", str(cell_m),
                        "--samples", str(samples), "--repeats", "1"], check=True, capture_output=True)
        with np.load(f"{maps}/{ident}.npz") as archive:
            return np.atleast_3d(archive["path_gain"].astype(float).T).T[0]


def to_db(linear: np.ndarray) -> np.ndarray:
    """In dB; NaN where nothing arrives."""
    return 10 * np.log10(linear, where=linear > 0, out=np.full_like(linear, np.nan))


def downsampled(fine: np.ndarray) -> dict[str, np.ndarray]:
    """The map by each way of downsampling, in dB."""
    rows, columns = (side // FACTOR for side in fine.shape)
    blocks = fine.reshape(rows, FACTOR, columns, FACTOR).swapaxes(1, 2).reshape(rows, columns, -1)
    blocks_db = to_db(blocks)
    reached = np.isfinite(blocks_db)
    count = reached.sum(2)
    skipping = np.nansum(blocks_db, 2) / np.where(count, count, np.nan)
    return {
        "linear mean, unreached cells as 0": to_db(blocks.mean(2)),
        "mean in dB, unreached cells left out": skipping,
        f"mean in dB, unreached cells as {FLOOR_DB:.0f} dB": np.where(count, np.where(reached, blocks_db, FLOOR_DB).mean(2), np.nan),
        "every fourth cell of every fourth row": blocks_db[:, :, 0],
    }


def difference(name: str, map_db: np.ndarray, direct_db: np.ndarray) -> str:
    """A row of a table: mean and standard deviation of the difference, and how many cells only one of the maps reaches."""
    both = np.isfinite(map_db) & np.isfinite(direct_db)
    delta = map_db[both] - direct_db[both]
    lost, won = (np.count_nonzero(np.isfinite(a) & ~np.isfinite(b)) for a, b in ((direct_db, map_db), (map_db, direct_db)))
    return f"| {name} | {delta.mean():+.2f} ± {delta.std():.2f} | {np.median(np.abs(delta)):.2f} | {both.sum()} | {lost} / {won} |"


def main() -> None:
    scenes, idents = Path(sys.argv[1]), sys.argv[2:]
    for ident in idents:
        direct = to_db(trace(scenes, ident, 4, SAMPLES))
        print(f"\n{ident}\n\n| against 4 m, N = {SAMPLES:.1e} | mean ± sd, dB | median of absolute values | cells | only in 4 m / only here |")
        print("|---|---|---|---|---|")
        print(difference("4 m again, 1.1 N", to_db(trace(scenes, ident, 4, round(1.1 * SAMPLES))), direct))
        for rays, factor in (("N", 1), ("16 N", 16)):
            for name, map_db in downsampled(trace(scenes, ident, 1, factor * SAMPLES)).items():
                print(difference(f"1 m, {rays}, {name}", map_db, direct), flush=True)


if __name__ == "__main__":
    main()
