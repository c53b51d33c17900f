"""Which distribution tells best, from a few repeats, whether a level lies below a threshold?

    python benches/label_model.py        (NumPy and SciPy; 20 s)

Cells are made up: levels evenly within 20 dB of the threshold, in each repeat a sum of as many hits as a Poisson or a lattice
gives, each hit of lognormal power. From the mean of eight repeats and its standard error every model tells the chance that the
true level lies below the threshold; the table says how good that chance is, and which share of cells it calls sure.
Results: docs/LABELS.md.
"""

import argparse
from collections.abc import Callable

import numpy as np
from scipy import stats

REPEATS = 8
SPAN_DB = 20.0
# Name, fewest and most expected hits a repeat, standard deviation of a hit's power in dB, whether hits come as of a lattice.
CASES = [
    ("0.3 to 300 hits of equal power", 0.3, 300, 0, False),
    ("0.3 to 300 hits, 6 dB", 0.3, 300, 6, False),
    ("2 to 300 hits, 6 dB", 2, 300, 6, False),
    ("2 to 300 hits of a lattice, 3 dB", 2, 300, 3, True),
    ("0.3 to 3 hits, 6 dB", 0.3, 3, 6, False),
]


def student(scale: Callable[[np.ndarray], np.ndarray], slope: float) -> Callable:
    """Student's t of a power that is rescaled so that 1, the mean, goes to 0 with a slope of 1 / slope."""
    return lambda ratio, error: stats.t.cdf(slope * scale(ratio) / error, REPEATS - 1)


# Of the threshold and the standard error, both relative to the mean.
MODELS: dict[str, Callable[[np.ndarray, np.ndarray], np.ndarray]] = {
    "t, linear": student(lambda ratio: ratio - 1, 1),
    "t, cube root": student(lambda ratio: np.cbrt(ratio) - 1, 3),
    "t, dB (chosen)": student(np.log, 1),
    "gamma": lambda ratio, error: stats.gamma.cdf(ratio / error**2, 1 / error**2),
}


def simulate(random: np.random.Generator, cells: int, fewest: float, most: float, spread_db: float, lattice: bool):
    """Whether each cell is a hole (threshold 1), its mean and standard error; cells without any hit are left out."""
    power = 10 ** (random.uniform(-SPAN_DB, SPAN_DB, cells) / 10)
    expected = np.exp(random.uniform(np.log(fewest), np.log(most), cells))
    sigma = spread_db * np.log(10) / 10
    repeats = np.zeros((REPEATS, cells))
    for repeat in repeats:
        # A lattice gives one of the two whole numbers beside what is expected.
        hits = (np.floor(expected + random.random(cells)) if lattice else random.poisson(expected)).astype(int)
        for hit in range(hits.max()):
            there = hits > hit
            repeat[there] += random.lognormal(-sigma**2 / 2, sigma, there.sum())
        repeat *= power / expected
    mean = repeats.mean(0)
    error = repeats.std(0, ddof=1) / np.sqrt(REPEATS)
    seen = mean > 0
    return (power < 1)[seen], mean[seen], error[seen]


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0])
    parser.add_argument("--cells", type=int, default=60_000, metavar="N", help="cells of each case [%(default)s]")
    arguments = parser.parse_args()
    random = np.random.default_rng(1)
    print("| case | model | log loss | unsure | sure holes that are holes | sure others that are holes |\n|---|---|---|---|---|---|")
    for name, fewest, most, spread_db, lattice in CASES:
        hole, mean, error = simulate(random, arguments.cells, fewest, most, spread_db, lattice)
        for model, chance_of in MODELS.items():
            chance = np.clip(chance_of(1 / mean, np.clip(error / mean, 1e-6, 1)), 1e-9, 1 - 1e-9)
            loss = -np.log(np.where(hole, chance, 1 - chance)).mean()
            high, low = chance >= 0.95, chance <= 0.05
            print(f"| {name} | {model} | {loss:.3f} | {100 * (~high & ~low).mean():.1f} % "
                  f"| {100 * hole[high].mean():.2f} % | {100 * hole[low].mean():.2f} % |")


if __name__ == "__main__":
    main()
