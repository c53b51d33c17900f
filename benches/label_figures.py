"""Figures of the study of label reliability: how maps of few rays, or of several repeats, differ from maps of many more.

Maps are arrays of linear path gain over the outdoor cells of a tile. A hole is a cell whose RSRP is below -100 dBm at 15 dBm per resource
element. Shares are of all tiles' cells together; intervals are percentiles of 2,000 resamples of the tiles.
"""

from collections.abc import Callable
from dataclasses import dataclass

import numpy as np
from label_packs import HOLE_DBM, POWER_DBM

RESAMPLES = 2000
HOLE_GAIN = 10 ** ((HOLE_DBM - POWER_DBM) / 10)
# Sums over a tile's cells, from which all figures are made.
COUNTS = ("cells", "holes", "true_holes", "false", "missed", "both_reached", "db", "squared_db")
Counts = dict[str, float]
Figure = tuple[float, float, float]


def compare(path_gain: np.ndarray, truth: np.ndarray, hole: np.ndarray | None = None) -> Counts:
    """Sums over the cells of a tile: a map against a truth that shares no ray with it; `hole` tells the cells that are called holes,
    if it is another rule than that of their level.
    """
    hole, true = path_gain < HOLE_GAIN if hole is None else hole, truth < HOLE_GAIN
    both = (path_gain > 0) & (truth > 0)
    difference = 10 * np.log10(path_gain[both] / truth[both])
    return {"cells": hole.size, "holes": hole.sum(), "true_holes": true.sum(), "false": (hole & ~true).sum(),
            "missed": (~hole & true).sum(), "both_reached": both.sum(), "db": difference.sum(),
            "squared_db": (difference**2).sum()}


def kappa(sums: dict[str, np.ndarray]) -> np.ndarray:
    """Cohen's kappa: agreement about holes beyond what chance would give, 1 for full agreement."""
    cells = sums["cells"]
    agreed = 1 - (sums["false"] + sums["missed"]) / cells
    holes, true = sums["holes"] / cells, sums["true_holes"] / cells
    chance = holes * true + (1 - holes) * (1 - true)
    return (agreed - chance) / (1 - chance)


FIGURES: dict[str, Callable[[dict[str, np.ndarray]], np.ndarray]] = {
    "kappa": kappa,
    "false": lambda sums: 100 * sums["false"] / sums["holes"],
    "missed": lambda sums: 100 * sums["missed"] / sums["true_holes"],
    "share": lambda sums: 100 * (sums["holes"] - sums["true_holes"]) / sums["cells"],
    "rms": lambda sums: np.sqrt(sums["squared_db"] / sums["both_reached"]),
    "bias": lambda sums: sums["db"] / sums["both_reached"],
}


def figures(tiles: list[list[Counts]], seed: int = 1) -> dict[str, Figure]:
    """All figures with their 95 % intervals over tiles (nan for a single one); of each tile one or more comparisons."""
    table = {name: np.array([np.mean([counts[name] for counts in of_tile]) for of_tile in tiles]) for name in COUNTS}
    drawn = np.random.default_rng(seed).integers(0, len(tiles), (RESAMPLES, len(tiles)))
    resampled = {name: values[drawn].sum(1) for name, values in table.items()}
    whole = {name: values.sum(keepdims=True) for name, values in table.items()}
    found = {}
    for name, figure in FIGURES.items():
        low, high = np.nanpercentile(figure(resampled), [2.5, 97.5]) if len(tiles) > 1 else (np.nan, np.nan)
        found[name] = (float(figure(whole)[0]), float(low), float(high))
    return found


# ---------------------------------------------------------------- independence


@dataclass(frozen=True)
class Scatter:
    """How repeats scatter about a truth, in units of a cell's own variance: `single[g]` is g times the variance of the mean of g."""

    correlation: Figure
    law: dict[int, Figure]


def residual_products(repeats: np.ndarray, truths: tuple[np.ndarray, np.ndarray], scale: np.ndarray, group: int) -> float:
    """Mean over cells of (mean of `group` repeats - one truth) x (the same - the other truth), in units of `scale` squared.

    The truths are independent of each other, so that their own errors drop out: what is left is the variance of the mean. `scale` must
    depend on neither repeats nor truths.
    """
    means = repeats[: len(repeats) // group * group].reshape(-1, group, repeats.shape[1]).mean(1)
    noisy = scale > 0
    return float((((means - truths[0]) * (means - truths[1])).mean(0)[noisy] / scale[noisy] ** 2).mean())


def scatter(tiles: list[tuple[np.ndarray, tuple[np.ndarray, np.ndarray], np.ndarray]], groups: tuple[int, ...], seed: int = 1) -> Scatter:
    """Correlation of the residuals of two repeats, and the law of 1 / R, over tiles with intervals."""
    variance = np.array([[group * residual_products(*tile, group) for group in groups] for tile in tiles])
    drawn = np.random.default_rng(seed).integers(0, len(tiles), (RESAMPLES, len(tiles)))

    def interval(figure: Callable[[np.ndarray], np.ndarray]) -> Figure:
        low, high = np.percentile(figure(variance[drawn].sum(1)), [2.5, 97.5])
        return float(figure(variance.sum(0)[None])[0]), float(low), float(high)

    most = groups[-1]
    return Scatter(interval(lambda sums: (sums[:, -1] / sums[:, 0] - 1) / (most - 1)),
                   {group: interval(lambda sums, column=column: sums[:, column] / sums[:, 0]) for column, group in enumerate(groups)})


# ---------------------------------------------------------------- roughness


def local_minima(path_gain: np.ndarray, outdoor: np.ndarray) -> tuple[int, int]:
    """Outdoor cells that are weaker than all outdoor ones of their eight neighbours, and all outdoor cells that a path reaches.

    Cells without a path are weaker than all others and no minima themselves. Levels of packs have steps of 0.5 dB, so that neighbours
    may be equal, where the trace itself has a minimum. Noise alone would make a ninth of the cells minima.
    """
    level = np.full((outdoor.shape[0] + 2, outdoor.shape[1] + 2), np.inf)
    inner = np.full(outdoor.shape, np.inf)
    inner[outdoor] = path_gain
    level[1:-1, 1:-1] = inner
    lowest = np.min([level[1 + row:level.shape[0] - 1 + row, 1 + column:level.shape[1] - 1 + column]
                     for row in (-1, 0, 1) for column in (-1, 0, 1) if (row, column) != (0, 0)], axis=0)
    reached = outdoor & (inner > 0) & np.isfinite(inner)
    return int((reached & (lowest > inner)).sum()), int(reached.sum())


def recurring(tiles: list[tuple[np.ndarray, np.ndarray, np.ndarray]], seed: int = 1) -> tuple[Figure, Figure]:
    """How steps between neighbouring cells recur in an independent trace: rms of a step in dB, and the share of its variance that
    both traces have in common, in percent; the rest is noise. Of each tile two maps and its outdoor cells.
    """
    sums = []
    for one, other, outdoor in tiles:
        levels = np.full((2, *outdoor.shape), np.nan)
        with np.errstate(divide="ignore"):
            levels[:, outdoor] = 10 * np.log10([one, other])
        levels[np.isinf(levels)] = np.nan
        steps = [np.diff(levels, axis=axis).reshape(2, -1) for axis in (1, 2)]
        first, second = np.concatenate(steps, 1)
        both = np.isfinite(first) & np.isfinite(second)
        first, second = first[both], second[both]
        sums.append((both.sum(), (first**2 + second**2).sum() / 2, (first * second).sum()))
    table = np.array(sums, dtype=float)
    drawn = np.random.default_rng(seed).integers(0, len(table), (RESAMPLES, len(table)))

    def interval(figure: Callable[[np.ndarray], np.ndarray]) -> Figure:
        low, high = np.percentile(figure(table[drawn].sum(1)), [2.5, 97.5])
        return float(figure(table.sum(0)[None])[0]), float(low), float(high)

    return interval(lambda found: np.sqrt(found[:, 1] / found[:, 0])), interval(lambda found: 100 * found[:, 2] / found[:, 1])
