"""Tables and plot of the study of label reliability, from the packs in benches/labels alone.

Writes `benches/labels/tables.md` and `benches/labels/curves.svg`; benches/RESULTS.md says what they mean.
"""

import json
import math
from dataclasses import dataclass, field
from pathlib import Path

import numpy as np
from label_figures import HOLE_GAIN, Counts, Figure, compare, figures, local_minima, scatter
from label_packs import FOLDER, REFERENCE, load_pack, load_tiles, path_gain_of
from label_store import read_study

LONG, SHORT = "w1e8", "w1e7"
GROUPS = (1, 2, 4, 8, 16)
SENSITIVITY = {
    "depth3": "depth 3 instead of 5", "depth8": "depth 8", "no_diffraction": "no diffraction", "brick": "walls of brick",
    "glass": "walls of glass", "higher": "roofs 1 m higher", "lower": "roofs 1 m lower", "uneven": "each solid 1 m higher or lower",
}
HEAD = "κ | false holes, % | missed holes, % | hole share, points | rms, dB | bias, dB"


@dataclass
class Traces:
    """All packs: path gain [repeats, outdoor cells] by set and tile, and what the traces cost."""

    outdoor: dict[str, np.ndarray]
    built: dict[str, float]
    samples: dict[str, int]
    gains: dict[str, dict[str, np.ndarray]] = field(default_factory=dict)
    costs: dict[str, list[dict[str, float]]] = field(default_factory=dict)

    def of(self, name: str, tile: str) -> np.ndarray:
        """Repeats of a set on a tile; none if it was not traced."""
        return self.gains.get(name, {}).get(tile, np.zeros((0, self.outdoor[tile].sum())))

    def truth(self, tile: str, without: str = "", left_out: slice = slice(0)) -> tuple[np.ndarray, float]:
        """Mean of the long traces and, of a candidate among them, of the short ones too; and the rays in it.

        What the candidate is made of is left out: `left_out` of the repeats of set `without`.
        """
        long, short = self.of(LONG, tile), self.of(SHORT, tile)
        if without == LONG:
            long = np.delete(long, left_out, 0)
        pools = [(long, self.samples[LONG])] + ([(short, self.samples[SHORT])] if without == LONG else [])
        rays = sum(len(pool) * samples for pool, samples in pools)
        return sum(pool.sum(0) * samples for pool, samples in pools) / rays if rays else np.zeros(0), rays


def read_traces() -> Traces:
    """All packs of the repository."""
    outdoor, built = load_tiles()
    traces = Traces(outdoor, built, {name: settings["samples"] for name, settings in read_study()["sets"].items()})
    reference = load_pack(FOLDER / f"{REFERENCE}.xz", {})[0]
    gains: dict[str, dict[str, list[np.ndarray]]] = {}
    for path in sorted(FOLDER.glob("*.xz"), key=lambda path: (path.stem.rsplit("-", 1)[0], int(path.stem.rsplit("-", 1)[1]))):
        name = path.stem.rsplit("-", 1)[0]
        levels, costs = load_pack(path, reference)
        for tile, values in levels.items():
            gains.setdefault(name, {}).setdefault(tile, []).append(path_gain_of(values))
        traces.costs.setdefault(name, []).extend(costs.values())
    traces.gains = {name: {tile: np.array(found) for tile, found in tiles.items()} for name, tiles in gains.items()}
    return traces


def written(figure: Figure, digits: int = 1, sign: str = "") -> str:
    """A figure with its interval."""
    value, low, high = (f"{part:{sign}.{digits}f}" for part in figure)
    return f"{value} ({low} to {high})"


def row(name: str, found: dict[str, Figure]) -> str:
    """A row of a table under HEAD."""
    return (f"| {name} | {written(found['kappa'], 3)} | {written(found['false'])} | {written(found['missed'])} | "
            f"{written(found['share'], 2, '+')} | {written(found['rms'], 2)} | {written(found['bias'], 2, '+')} |")


def comparisons(traces: Traces, name: str, group: int, tiles: list[str]) -> tuple[list[list[Counts]], float]:
    """Means of `group` repeats of a set against the truth, by tile; and the rays of the smallest truth."""
    found, least = [], math.inf
    for tile in tiles:
        repeats = traces.of(name, tile)
        of_tile = []
        for begin in range(0, len(repeats) - group + 1, group):
            truth, rays = traces.truth(tile, name, slice(begin, begin + group))
            if not rays:
                continue
            of_tile.append(compare(repeats[begin:begin + group].mean(0), truth))
            least = min(least, rays)
        if of_tile:
            found.append(of_tile)
    return found, least


@dataclass
class Point:
    """A point of the curves."""

    name: str
    samples: int
    group: int
    tiles: int
    truth: float
    figures: dict[str, Figure]


def curves(traces: Traces) -> list[Point]:
    """All rays and repeats."""
    points = []
    for name in ("r4e6", SHORT, LONG, "r1e9"):
        for group in GROUPS:
            tiles = [tile for tile in traces.outdoor if len(traces.of(name, tile)) >= group]
            found, truth = comparisons(traces, name, group, tiles)
            if found:
                points.append(Point(name, traces.samples[name], group, len(found), truth, figures(found)))
    return points


def seconds(traces: Traces, name: str, rays: float) -> float:
    """Half of the CPU seconds that so many rays of a set took, a median: what two idle cores take."""
    return float(np.median([cost["cpu_s"] for cost in traces.costs[name]])) / 2 * rays / traces.samples[name]


def curve_table(traces: Traces, points: list[Point]) -> str:
    """Rays and repeats against the truth."""
    lines = [f"| rays x repeats | s | tiles | truth, rays | {HEAD} |", "|---" * 10 + "|"]
    for point in points:
        name = (f"{point.samples:.3g} x {point.group} | {seconds(traces, point.name, point.samples * point.group):.1f} | {point.tiles} "
                f"| {point.truth:.2g}")
        lines.append(row(name, point.figures))
    return "\n".join(lines)


def truth_table(traces: Traces) -> str:
    """The same map against truths of more and more rays: how much of the disagreement is the truth's own."""
    most = max(len(found) for found in traces.gains[LONG].values())
    tiles = [tile for tile in traces.outdoor if len(traces.of(LONG, tile)) == most and len(traces.of(SHORT, tile)) >= 8]
    if not tiles:
        return f"8 short and {most} long traces of a tile are wanted"
    lines = [f"| truth, rays | {HEAD} |", "|---" * 7 + "|"]
    for count in range(1, most + 1):
        found = [[compare(traces.of(SHORT, tile)[:8].mean(0), traces.of(LONG, tile)[begin:begin + count].mean(0))
                  for begin in range(0, most - count + 1, count)] for tile in tiles]
        lines.append(row(f"{count * traces.samples[LONG]:.2g}", figures(found)))
    return "\n".join(lines)


def independence_table(traces: Traces) -> str:
    """Correlation and the law of 1 / R on real tiles."""
    tiles = [tile for tile in traces.outdoor if len(traces.of(SHORT, tile)) >= 8 and len(traces.of(LONG, tile)) >= 2]
    if len(tiles) < 2:
        return "two long traces of the tiles are wanted"
    parts = []
    for tile in tiles:
        repeats, long = traces.of(SHORT, tile)[:8], traces.of(LONG, tile)
        # In units of the mean level of all traces, so that cells count alike whether they are near or far.
        parts.append((repeats, (long[0::2].mean(0), long[1::2].mean(0)), np.concatenate([repeats, long]).mean(0)))
    found = scatter(parts, (1, 2, 4, 8))
    law = " · ".join(f"R = {group}: {written(figure, 2)}" for group, figure in found.law.items())
    return f"{len(tiles)} tiles: correlation of residuals {written(found.correlation, 3)}; R x variance of the mean of R over that of one: {law}"


def probability_table(traces: Traces, count: int = 8) -> str:
    """P(hole) by several models of `count` repeats against the holes of the truth: Brier score and calibration."""
    from scipy import stats

    shares: dict[str, list[np.ndarray]] = {}
    outcome = []
    for tile in traces.outdoor:
        repeats, (truth, rays) = traces.of(SHORT, tile)[:count], traces.truth(tile)
        if len(repeats) < count or not rays:
            continue
        outcome.append(truth < HOLE_GAIN)
        mean, error = repeats.mean(0), repeats.std(0, ddof=1) / math.sqrt(count)
        with np.errstate(divide="ignore", invalid="ignore"):
            normal = np.where(error > 0, (HOLE_GAIN - mean) / error, np.where(mean < HOLE_GAIN, np.inf, -np.inf))
            # A log-normal mean of the same coefficient of variation.
            spread = np.sqrt(np.log1p((error / mean) ** 2))
            log = np.where((error > 0) & (mean > 0), (np.log(HOLE_GAIN / mean) + spread**2 / 2) / spread, normal)
        shares.setdefault("hole of the mean, 0 or 1", []).append((mean < HOLE_GAIN).astype(float))
        shares.setdefault("share of the repeats that are holes", []).append((repeats < HOLE_GAIN).mean(0))
        shares.setdefault("normal, linear power", []).append(stats.norm.cdf(normal))
        shares.setdefault(f"t with {count - 1} degrees of freedom, linear power", []).append(stats.t.cdf(normal, count - 1))
        shares.setdefault("log-normal", []).append(stats.norm.cdf(log))
        shares.setdefault(f"log-t with {count - 1} degrees of freedom", []).append(stats.t.cdf(log, count - 1))
    if not outcome:
        return f"{count} repeats of a tile with a truth are wanted"
    holes = np.concatenate(outcome).astype(float)
    edges = np.array([0, 0.05, 0.2, 0.4, 0.6, 0.8, 0.95, 1.0])
    names = [f"{low:g} to {high:g}" for low, high in zip(edges, edges[1:], strict=False)]
    lines = ["| P(hole) from the repeats | Brier | log loss | holes of the truth among cells of P, % (cells, %): " + " | ".join(names) + " |",
             "|---" * (len(names) + 3) + "|"]
    for name, found in shares.items():
        p = np.concatenate(found)
        brier = ((p - holes) ** 2).mean()
        clipped = np.clip(p, 1e-3, 1 - 1e-3)
        loss = -(holes * np.log(clipped) + (1 - holes) * np.log(1 - clipped)).mean()
        column = np.clip(np.searchsorted(edges, p, "right") - 1, 0, len(names) - 1)
        bins = [f"{100 * holes[column == k].mean():.1f} ({100 * (column == k).mean():.1f})" if (column == k).any() else "-" for k in range(len(names))]
        lines.append(f"| {name} | {brier:.4f} | {loss:.4f} | " + " | ".join(bins) + " |")
    return "\n".join(lines)


def sensitivity_table(traces: Traces) -> str:
    """What is modelled otherwise, against the truth of the model as it is; the first row of each pair is the model as it is."""
    lines = [f"| model | repeats | tiles | {HEAD} |", "|---" * 9 + "|"]
    for name, title in SENSITIVITY.items():
        if name not in traces.gains:
            continue
        count = min(len(found) for found in traces.gains[name].values())
        tiles = [tile for tile in traces.gains[name] if len(traces.of(SHORT, tile)) >= count and traces.truth(tile)[1]]
        for label, of_set in ((f"as it is ({title})", SHORT), (title, name)):
            found = [[compare(traces.of(of_set, tile)[:count].mean(0), traces.truth(tile)[0])] for tile in tiles]
            lines.append(row(f"{label} | {count} | {len(tiles)}", figures(found)))
    return "\n".join(lines)


def minima_table(traces: Traces) -> str:
    """How many cells are local minima, by rays."""
    lines = ["| rays | local minima among outdoor cells that are reached, % |", "|---|---|"]
    for name, group in ((SHORT, 1), (SHORT, 2), (SHORT, 4), (SHORT, 8), (LONG, 1), (LONG, 2), (LONG, 3)):
        tiles = [tile for tile in traces.outdoor if len(traces.of(name, tile)) >= group]
        if tiles:
            found = np.array([local_minima(traces.of(name, tile)[:group].mean(0), traces.outdoor[tile]) for tile in tiles])
            lines.append(f"| {traces.samples[name]:.3g} x {group} | {100 * found[:, 0].sum() / found[:, 1].sum():.1f} |")
    return "\n".join(lines)


def hole_table(traces: Traces) -> str:
    """Every tile: what it is and how its map does."""
    lines = ["| tile | built, % | holes of the truth, % | κ of 1.25e7 x 1 | κ of 1.25e7 x 8 | κ of 1e8 x 1 |", "|---" * 6 + "|"]
    for tile in sorted(traces.outdoor, key=traces.built.get):
        truth, rays = traces.truth(tile)
        cells = []
        for name, group in ((SHORT, 1), (SHORT, 8), (LONG, 1)):
            found, _ = comparisons(traces, name, group, [tile])
            cells.append(f"{figures(found)['kappa'][0]:.3f}" if found else "-")
        share = f"{100 * (truth < HOLE_GAIN).mean():.1f}" if rays else "-"
        lines.append(f"| {tile} | {100 * traces.built[tile]:.1f} | {share} | " + " | ".join(cells) + " |")
    return "\n".join(lines)


def plot(traces: Traces, points: list[Point], path: Path) -> None:
    """Four figures over the seconds that a map takes."""
    import matplotlib

    matplotlib.use("svg")
    matplotlib.rcParams |= {"svg.hashsalt": "labels", "font.size": 9}
    from matplotlib import pyplot

    names = {"r4e6": "4·10⁶ rays a repeat", SHORT: "1.25·10⁷ rays a repeat", LONG: "10⁸ rays a repeat", "r1e9": "10⁹ rays"}
    drawing, axes = pyplot.subplots(1, 4, figsize=(13, 3.4), constrained_layout=True)
    titles = (("kappa", "Cohen's κ"), ("false", "false holes, %"), ("missed", "missed holes, %"), ("rms", "rms difference, dB"))
    for axis, (figure, title) in zip(axes, titles, strict=True):
        for name, label in names.items():
            mine = [point for point in points if point.name == name]
            if not mine:
                continue
            x = [seconds(traces, name, point.samples * point.group) for point in mine]
            value, low, high = np.array([point.figures[figure] for point in mine]).T
            axis.errorbar(x, value, [value - low, high - value], marker="o", capsize=2, label=label)
        axis.set(xscale="log", xlabel="seconds a map, two cores", title=title)
        axis.grid(alpha=0.3)
        axis.axvline(60, color="grey", linewidth=0.8)
    for axis, wanted in ((axes[0], 0.9), (axes[1], 10)):
        axis.axhline(wanted, color="grey", linewidth=0.8, linestyle="--")
    axes[0].legend()
    drawing.savefig(path, metadata={"Date": None})


def cost_lines(traces: Traces) -> str:
    """What traces took."""
    lines = ["| set | traces | CPU s a trace, median (range) | wall s, median (range), beside other work |", "|---|---|---|---|"]
    for name, costs in traces.costs.items():
        cpu, wall = (np.array([cost[key] for cost in costs]) for key in ("cpu_s", "wall_s"))
        lines.append(f"| {name} | {len(costs)} | " + " | ".join(
            f"{np.median(found):.1f} ({found.min():.1f} to {found.max():.1f})" for found in (cpu, wall)) + " |")
    return "\n".join(lines)


def report() -> None:
    """Writes tables and plot."""
    traces = read_traces()
    points = curves(traces)
    parts = {
        "Rays and repeats against the truth": curve_table(traces, points),
        "1.25e7 x 8 against truths of more and more rays": truth_table(traces),
        "Independence": independence_table(traces),
        "P(hole)": probability_table(traces),
        "Sensitivity": sensitivity_table(traces),
        "Local minima": minima_table(traces),
        "Cost": cost_lines(traces),
        "Tiles": hole_table(traces),
    }
    text = "\n\n".join(f"## {title}\n\n{body}" for title, body in parts.items())
    (FOLDER / "tables.md").write_text(f"# Tables of `benches/label_reliability.py report`\n\n{text}\n")
    plot(traces, points, FOLDER / "curves.svg")
    print(text)


if __name__ == "__main__":
    report()
