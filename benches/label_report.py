"""Tables and plot of the study of label reliability, from the packs in benches/labels alone.

Writes `benches/labels/tables.md` and `benches/labels/curves.svg`; benches/RESULTS.md says what they mean.
"""

import json
import math
from dataclasses import dataclass, field
from pathlib import Path

import numpy as np
from label_figures import HOLE_GAIN, Counts, Figure, compare, figures, local_minima, recurring, scatter
from label_packs import FOLDER, load_tiles, path_gain_of, read_packs
from label_store import planned, read_study

LONG, SHORT = "w1e8", "w1e7"
# As sionna_trace.py traces: eight repeats that share their wedges.
CHOSEN, REPEATS = "s1e7", 8
GROUPS = (1, 2, 4, 8, 16)
RULES = (0.5, 0.6, 0.7, 0.8, 0.9, 0.95)
# Sets of rays: those that hardly lose a wedge, and those with Sionna's own table.
RAYS = ("w4e6", SHORT, CHOSEN, LONG, "w1e9", "r1e7", "r1e8")
NOT_YET = "not traced yet"
SENSITIVITY = {
    "depth3": "depth 3 instead of 5", "depth8": "depth 8", "no_diffraction": "no diffraction", "brick": "walls of brick",
    "glass": "walls of glass", "higher": "roofs 1 m higher", "lower": "roofs 1 m lower", "uneven": "each solid 1 m higher or lower",
}
FIGURE_COLUMNS = 6
HEAD = "κ | false holes, % | missed holes, % | hole share, points | rms, dB | bias, dB"


def rays(count: float) -> str:
    """A number of rays, as 1.25·10⁷."""
    mantissa, exponent = f"{count:.2e}".split("e")
    power = "".join("⁰¹²³⁴⁵⁶⁷⁸⁹"[int(digit)] for digit in str(int(exponent)))
    return f"{float(mantissa):g}·10{power}".removeprefix("1·")


@dataclass
class Traces:
    """All packs: path gain [repeats, outdoor cells] by set and tile, and what the traces cost."""

    outdoor: dict[str, np.ndarray]
    built: dict[str, float]
    samples: dict[str, int]
    gains: dict[str, dict[str, np.ndarray]] = field(default_factory=dict)
    costs: dict[str, list[dict[str, float]]] = field(default_factory=dict)
    planned: dict[str, int] = field(default_factory=dict)

    def title(self, name: str) -> str:
        """What a set is, in a table."""
        special = {"r": ", Sionna's table", "s": ", shared wedges"}.get(name[0], "")
        return f"{rays(self.samples[name])}{special}"

    def groups(self, name: str) -> list[int]:
        """How many repeats of a set make a map. Those that share their wedges are a map together only."""
        return [group for group in GROUPS if group <= self.planned[name] and (name != CHOSEN or group == REPEATS)]

    def of(self, name: str, tile: str) -> np.ndarray:
        """Repeats of a set on a tile; none if it was not traced."""
        return self.gains.get(name, {}).get(tile, np.zeros((0, self.outdoor[tile].sum())))

    def truth(self, tile: str, without: str = "", left_out: slice = slice(0)) -> tuple[np.ndarray, float]:
        """Mean of the long traces and, of a candidate among them, of short ones too; and the rays in it.

        What the candidate is made of is left out: `left_out` of the repeats of set `without`.
        """
        long, short = self.of(LONG, tile), max(self.of(CHOSEN, tile), self.of(SHORT, tile), key=len)
        if without == LONG:
            long = np.delete(long, left_out, 0)
        pools = [(long, self.samples[LONG])] + ([(short, self.samples[SHORT])] if without == LONG else [])
        total = sum(len(pool) * samples for pool, samples in pools)
        return sum(pool.sum(0) * samples for pool, samples in pools) / total if total else np.zeros(0), total


def read_traces() -> Traces:
    """All packs of the repository."""
    outdoor, built = load_tiles()
    traces = Traces(outdoor, built, {name: settings["samples"] for name, settings in read_study()["sets"].items()}, planned=planned(read_study()))
    gains: dict[str, dict[str, list[np.ndarray]]] = {}
    for name, levels, costs in read_packs():
        for tile, values in levels.items():
            gains.setdefault(name, {}).setdefault(tile, []).append(path_gain_of(values))
        traces.costs.setdefault(name, []).extend(costs.values())
    traces.gains = {name: {tile: np.array(found) for tile, found in tiles.items()} for name, tiles in gains.items()}
    return traces


def written(figure: Figure, digits: int = 1, sign: str = "") -> str:
    """A figure with its interval; without one where there is but one tile."""
    if math.isnan(figure[1]):
        return f"{figure[0]:{sign}.{digits}f} (one tile)"
    value, low, high = (f"{part:{sign}.{digits}f}" for part in figure)
    return f"{value} ({low} to {high})"


def row(name: str, found: dict[str, Figure]) -> str:
    """A row of a table under HEAD."""
    return (f"| {name} | {written(found['kappa'], 3)} | {written(found['false'])} | {written(found['missed'])} | "
            f"{written(found['share'], 2, '+')} | {written(found['rms'], 2)} | {written(found['bias'], 2, '+')} |")


def not_yet(name: str, columns: int = FIGURE_COLUMNS) -> str:
    """A row of what was not traced yet."""
    return f"| {name} |" + f" {NOT_YET} |" * columns


def comparisons(traces: Traces, name: str, group: int, tiles: list[str]) -> tuple[list[list[Counts]], float]:
    """Means of `group` repeats of a set against the truth, by tile; and the rays of the smallest truth.

    A truth of fewer rays than what is held against it is none.
    """
    found, least = [], math.inf
    for tile in tiles:
        repeats = traces.of(name, tile)
        of_tile = []
        for begin in range(0, len(repeats) - group + 1, group):
            truth, true_rays = traces.truth(tile, name, slice(begin, begin + group))
            if true_rays < group * traces.samples[name]:
                continue
            of_tile.append(compare(repeats[begin:begin + group].mean(0), truth))
            least = min(least, true_rays)
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
    """All rays and repeats that were traced."""
    points = []
    for name in RAYS:
        for group in traces.groups(name):
            tiles = [tile for tile in traces.outdoor if len(traces.of(name, tile)) >= group]
            found, truth = comparisons(traces, name, group, tiles)
            if found:
                points.append(Point(name, traces.samples[name], group, len(found), truth, figures(found)))
    return points


def seconds(traces: Traces, name: str, count: float) -> float:
    """Half of the CPU seconds that so many rays of a set took, a median: about what two idle cores take."""
    return float(np.median([cost["cpu_s"] for cost in traces.costs[name]])) / 2 * count / traces.samples[name]


def curve_table(traces: Traces, points: list[Point]) -> str:
    """Rays and repeats against the truth."""
    lines = [f"| rays x repeats | s | tiles | truth, rays | {HEAD} |", "|---" * (FIGURE_COLUMNS + 4) + "|"]
    found = {(point.name, point.group): point for point in points}
    for name in RAYS:
        for group in traces.groups(name):
            title = f"{traces.title(name)} x {group}"
            if point := found.get((name, group)):
                took = seconds(traces, name, point.samples * group)
                lines.append(row(f"{title} | {took:.1f} | {point.tiles} | {rays(point.truth)}", point.figures))
            else:
                lines.append(not_yet(f"{title} | - | 0 | -"))
    return "\n".join(lines)


def twin_table(traces: Traces) -> str:
    """Two independent traces of as many rays, each held against the other: no truth is needed."""
    lines = ["| rays | tiles | κ | holes that are none in the other, % | rms, dB |", "|---" * 5 + "|"]
    for name in (name for name in RAYS if traces.planned[name] > 1 and name != CHOSEN):
        tiles = [tile for tile in traces.outdoor if len(traces.of(name, tile)) >= 2]
        if tiles:
            pairs = [traces.of(name, tile)[:2] for tile in tiles]
            found = figures([[compare(one, other), compare(other, one)] for one, other in pairs])
            lines.append(f"| {traces.title(name)} | {len(tiles)} | {written(found['kappa'], 3)} | {written(found['false'])} | {written(found['rms'], 2)} |")
        else:
            lines.append(not_yet(f"{traces.title(name)} | 0", 3))
    return "\n".join(lines)


def table_pairs(traces: Traces) -> str:
    """Sionna's own table of wedges against one that hardly loses any: as many rays, on the tiles that have both."""
    lines = [f"| rays | tiles | {HEAD} |", "|---" * (FIGURE_COLUMNS + 2) + "|"]
    for own, large in (("r1e7", SHORT), ("r1e8", LONG)):
        tiles = [tile for tile in traces.outdoor if len(traces.of(own, tile)) and len(traces.of(large, tile))]
        title = f"{traces.title(large)} | {len(tiles)}"
        if tiles:
            lines.append(row(title, figures([[compare(traces.of(own, tile)[0], traces.of(large, tile)[0])] for tile in tiles])))
        else:
            lines.append(not_yet(title))
    return "\n".join(lines)


def truth_table(traces: Traces) -> str:
    """The same map against truths of more and more rays: how much of the disagreement is the truth's own."""
    complete = [tile for tile in traces.outdoor if len(traces.of(CHOSEN, tile)) >= REPEATS]
    most = max((len(traces.of(LONG, tile)) for tile in complete), default=1)
    tiles = [tile for tile in complete if len(traces.of(LONG, tile)) == most]
    if not tiles:
        return f"{NOT_YET}: {REPEATS} repeats and {most} long traces of a tile"
    lines = [f"| truth, rays | tiles | {HEAD} |", "|---" * (FIGURE_COLUMNS + 2) + "|"]
    for count in range(1, most + 1):
        found = [[compare(traces.of(CHOSEN, tile)[:REPEATS].mean(0), traces.of(LONG, tile)[begin:begin + count].mean(0))
                  for begin in range(0, most - count + 1, count)] for tile in tiles]
        lines.append(row(f"{rays(count * traces.samples[LONG])} | {len(tiles)}", figures(found)))
    return "\n".join(lines)


def independence_table(traces: Traces) -> str:
    """Correlation and the law of 1 / R on real tiles, of repeats that share their wedges."""
    tiles = [tile for tile in traces.outdoor
             if len(traces.of(CHOSEN, tile)) >= REPEATS and len(traces.of(LONG, tile)) >= 2 and len(traces.of(SHORT, tile)) >= REPEATS]
    if len(tiles) < 2:
        return f"{NOT_YET}: {REPEATS} repeats with and without shared wedges and 2 long traces of two tiles"
    parts = []
    for tile in tiles:
        long = traces.of(LONG, tile)
        # In units of a cell's level, so that cells count alike whether they are near or far. Levels come from traces that are neither
        # repeats nor truth: else cells that are low by chance would have smaller units, and repeats would seem to agree.
        parts.append((traces.of(CHOSEN, tile)[:REPEATS], (long[0::2].mean(0), long[1::2].mean(0)), traces.of(SHORT, tile).mean(0)))
    found = scatter(parts, (1, 2, 4, REPEATS))
    law = " · ".join(f"R = {group}: {written(figure, 2)}" for group, figure in found.law.items())
    return f"{len(tiles)} tiles: correlation of residuals {written(found.correlation, 3)}; R x variance of the mean of R over that of one: {law}"


def probability_table(traces: Traces, count: int = REPEATS) -> str:
    """P(hole) by several models of `count` repeats against the holes of the truth: Brier score and calibration."""
    from scipy import stats

    shares: dict[str, list[np.ndarray]] = {}
    outcome = []
    for tile in traces.outdoor:
        repeats, (truth, true_rays) = traces.of(CHOSEN, tile)[:count], traces.truth(tile)
        if len(repeats) < count or not true_rays:
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
        shares.setdefault(f"t with {count - 1} degrees of freedom, dB (records)", []).append(hole_probability(repeats))
    if not outcome:
        return f"{NOT_YET}: {count} repeats of a tile with a truth"
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


def rule_table(traces: Traces, count: int = REPEATS) -> str:
    """The same maps, with holes that are called so from some P(hole) on: what fewer false holes cost in missed ones."""
    tiles = [tile for tile in traces.outdoor if len(traces.of(CHOSEN, tile)) >= count and traces.truth(tile)[1]]
    if not tiles:
        return f"{NOT_YET}: {count} repeats of a tile with a truth"
    lines = ["| hole from | κ | false holes, % | missed holes, % | hole share, points |", "|---" * 5 + "|"]
    for least in RULES:
        found = []
        for tile in tiles:
            repeats = traces.of(CHOSEN, tile)[:count]
            found.append([compare(repeats.mean(0), traces.truth(tile)[0], hole_probability(repeats) >= least)])
        row = figures(found)
        lines.append(f"| P = {least:g} | {written(row['kappa'], 3)} | {written(row['false'])} | {written(row['missed'])} | "
                     f"{written(row['share'], 2, '+')} |")
    return "\n".join(lines)


def hole_probability(repeats: np.ndarray) -> np.ndarray:
    """P(hole) as records have it (docs/LABELS.md): Student's t of the level of the mean in dB; 1 where no repeat finds a path."""
    from scipy import stats

    count, mean = len(repeats), repeats.mean(0)
    with np.errstate(divide="ignore", invalid="ignore"):
        error_db = 10 / math.log(10) * repeats.std(0, ddof=1) / math.sqrt(count) / mean
        t = 10 * np.log10(HOLE_GAIN / mean) / error_db
    return np.where(error_db > 0, stats.t.cdf(t, count - 1), (mean < HOLE_GAIN).astype(float))


def sensitivity_table(traces: Traces) -> str:
    """What is modelled otherwise, against the truth of the model as it is; the first row of each pair is the model as it is."""
    lines = [f"| model | repeats | tiles | {HEAD} |", "|---" * (FIGURE_COLUMNS + 3) + "|"]
    for name, title in SENSITIVITY.items():
        tiles = [tile for tile in traces.gains.get(name, {}) if len(traces.of(SHORT, tile)) and traces.truth(tile)[1]]
        if not tiles:
            lines.append(not_yet(f"{title} | 0 | 0"))
            continue
        count = min(len(traces.of(of_set, tile)) for of_set in (name, SHORT) for tile in tiles)
        for label, of_set in ((f"as it is ({title})", SHORT), (title, name)):
            found = [[compare(traces.of(of_set, tile)[:count].mean(0), traces.truth(tile)[0])] for tile in tiles]
            lines.append(row(f"{label} | {count} | {len(tiles)}", figures(found)))
    return "\n".join(lines)


def roughness_table(traces: Traces) -> str:
    """Local minima, and how much of the steps between neighbouring cells another trace finds again."""
    lines = ["| rays x repeats | tiles | cells below all eight neighbours, % of those reached | rms step to a neighbour, dB | "
             "of its variance recurs in as many other rays, % |", "|---" * 5 + "|"]
    for name in (SHORT, CHOSEN, LONG):
        for group in traces.groups(name):
            tiles = [tile for tile in traces.outdoor if len(traces.of(name, tile)) >= group]
            title = f"{traces.title(name)} x {group} | {len(tiles)}"
            if not tiles:
                lines.append(not_yet(title, 3))
                continue
            found = np.array([local_minima(traces.of(name, tile)[:group].mean(0), traces.outdoor[tile]) for tile in tiles])
            minima = f"{100 * found[:, 0].sum() / found[:, 1].sum():.1f}"
            twice = [tile for tile in tiles if len(traces.of(name, tile)) >= 2 * group]
            if not twice:
                lines.append(f"| {title} | {minima} | {NOT_YET} | {NOT_YET} |")
                continue
            step, share = recurring([(traces.of(name, tile)[:group].mean(0), traces.of(name, tile)[group:2 * group].mean(0),
                                      traces.outdoor[tile]) for tile in twice])
            lines.append(f"| {title} | {minima} | {written(step, 2)} | {written(share)} |")
    return "\n".join(lines)


def hole_table(traces: Traces) -> str:
    """Every tile: what it is and how its map does."""
    lines = [f"-: {NOT_YET}.", "", "| tile | built, % | holes of the truth, % | κ of 1.25·10⁷ x 1 | κ of 1.25·10⁷ x 8 | the same, shared wedges | κ of 10⁸ x 1 |", "|---" * 7 + "|"]
    for tile in sorted(traces.outdoor, key=traces.built.get):
        truth, true_rays = traces.truth(tile)
        cells = []
        for name, group in ((SHORT, 1), (SHORT, REPEATS), (CHOSEN, REPEATS), (LONG, 1)):
            found, _ = comparisons(traces, name, group, [tile])
            cells.append(f"{figures(found)['kappa'][0]:.3f}" if found else "-")
        share = f"{100 * (truth < HOLE_GAIN).mean():.1f}" if true_rays else "-"
        lines.append(f"| {tile} | {100 * traces.built[tile]:.1f} | {share} | " + " | ".join(cells) + " |")
    return "\n".join(lines)


def plot(traces: Traces, points: list[Point], path: Path) -> None:
    """Four figures over the seconds that a map takes."""
    import matplotlib

    matplotlib.use("svg")
    matplotlib.rcParams |= {"svg.hashsalt": "labels", "svg.fonttype": "none", "font.size": 10}
    from matplotlib import pyplot, ticker

    drawing, axes = pyplot.subplots(2, 2, figsize=(9, 6.5), constrained_layout=True, sharex=True)
    titles = (("kappa", "Cohen's κ"), ("false", "false holes, % of holes found"), ("missed", "missed holes, % of true holes"), ("rms", "rms difference, dB"))
    for axis, (figure, title) in zip(axes.flat, titles, strict=True):
        for colour, name in enumerate(RAYS):
            mine = [point for point in points if point.name == name and point.tiles > 1]
            if not mine:
                continue
            tiles = sorted({point.tiles for point in mine})
            x = [seconds(traces, name, point.samples * point.group) for point in mine]
            value, low, high = np.array([point.figures[figure] for point in mine]).T
            style = "--s" if name.startswith("r") else "-o"
            axis.errorbar(x, value, [value - low, high - value], fmt=style, color=f"C{colour}", capsize=3,
                          label=f"{traces.title(name)} ({' to '.join(map(str, dict.fromkeys((tiles[0], tiles[-1]))))} tiles)")
            if axis is axes[0, 0] and not name.startswith("r"):
                for at, point in zip(zip(x, value, strict=True), mine, strict=True):
                    axis.annotate(f"×{point.group}", at, (5, -12), textcoords="offset points", fontsize=8)
        axis.set(xscale="log", title=title)
        axis.set_xlim(1, 1000)
        axis.xaxis.set_major_formatter(ticker.FormatStrFormatter("%g"))
        axis.grid(alpha=0.3)
        axis.axvline(60, color="grey", linewidth=0.8)
    for axis in axes[1]:
        axis.set_xlabel("half of the CPU seconds of a map")
    for axis, wanted in ((axes[0, 0], 0.9), (axes[0, 1], 10)):
        axis.axhline(wanted, color="grey", linewidth=0.8, linestyle=":")
    axes[0, 0].set_ylim(top=1)
    for axis in axes.flat[1:]:
        axis.set_ylim(bottom=0)
    if points:
        drawing.legend(*axes[0, 0].get_legend_handles_labels(), loc="outside upper center", ncols=3, title="rays a repeat")
    drawing.savefig(path, metadata=dict.fromkeys(("Date", "Creator", "Format", "Type")))
    pyplot.close(drawing)


def cost_lines(traces: Traces) -> str:
    """What traces took."""
    lines = ["| set | traces | CPU s a trace, median (range) | wall s, median (range), beside other work |", "|---|---|---|---|"]
    for name in traces.samples:
        costs = traces.costs.get(name)
        if not costs:
            lines.append(not_yet(f"{name} | 0", 2))
            continue
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
        "1.25·10⁷ x 8, shared wedges, against truths of more and more rays": truth_table(traces),
        "Two traces of as many rays": twin_table(traces),
        "Sionna's table of wedges": table_pairs(traces),
        "Independence": independence_table(traces),
        "P(hole)": probability_table(traces),
        "Holes from a P(hole) on": rule_table(traces),
        "Sensitivity": sensitivity_table(traces),
        "Roughness": roughness_table(traces),
        "Cost": cost_lines(traces),
        "Tiles": hole_table(traces),
    }
    text = "\n\n".join(f"## {title}\n\n{body}" for title, body in parts.items())
    (FOLDER / "tables.md").write_text(f"# Tables of `benches/label_reliability.py report`\n\n{text}\n")
    plot(traces, points, FOLDER / "curves.svg")
    print(text)


if __name__ == "__main__":
    report()
