"""Any callable, judged beside the baselines."""

import json
import os
import tempfile
from collections.abc import Callable, Iterable, Mapping
from dataclasses import dataclass
from pathlib import Path
from typing import Any

from numpy.typing import ArrayLike, NDArray

from . import _native
from .dataset import Dataset, Split
from .stages import Progress

Policy = Callable[["_native.Map", dict[str, NDArray[Any]]], ArrayLike]


@dataclass(frozen=True)
class Report:
    """What all methods came to: `report.json` of `holescout evaluate` (see `schemas/report.v1.json`)."""

    data: dict[str, Any]
    """The whole report."""
    path: Path | None
    """Directory of report.html and its plots, if one was asked for."""

    def precision(self, method: str, k: int) -> float:
        """Share of predictions of a method after k steps that are coverage holes, 0 to 1, from all starts: the mean over maps."""
        return float(self._score(method, k)["precision"]["mean"])

    def recall(self, method: str, k: int) -> float:
        """Share of coverage holes that a method found after k steps, 0 to 1, from all starts: the mean over maps."""
        return float(self._score(method, k)["recall"]["mean"])

    def _score(self, method: str, k: int) -> dict[str, Any]:
        found = [score for score in self.data["scores"] if score["method"] == method and score["k"] == k]
        if not found:
            known = sorted({(score["method"], score["k"]) for score in self.data["scores"]})
            raise KeyError(f"no score of {method} after {k} steps; there are {known}")
        return max(found, key=lambda score: score["starts"])


def evaluate(
    policy: Policy | None,
    dataset: Dataset | str | os.PathLike[str],
    split: Split | None = None,
    *,
    methods: Iterable[str] | None = None,
    name: str = "python",
    settings: Mapping[str, Any] | None = None,
    out: str | os.PathLike[str] | None = None,
    overwrite: bool = False,
    progress: Progress | None = None,
) -> Report:
    """Judges a policy on a split: precision and recall with intervals, by the same rules and from the same starts as every method.

    `policy(map, observations)` is asked once a step for all flights over a map, and returns their waypoints, `[n, 2]`: row and column
    in cells. What is not permissible is pulled back (Algorithm 1). `observations` has

    - `rows`, `columns`, int16 `[n, k + 1]`: the cells that each flight has visited, the start first;
    - `rsrp_dbm`, float32 `[n, k + 1]`: the levels that it measured there;
    - `action_mask`, int8 `[n, 961]`: where one step may lead, as far as the map that it has stored tells.

    `map` has heights and what follows from them; a policy that looks at `map.rsrp_dbm`, `map.holes` or `map.base_station` knows
    what no UAV knows. The policy is called from several threads, one at a time.

    The report calls it `agent`. `methods` names the others (`holescout evaluate --help`), by default those that need no fitting
    on train; `settings` are those of `[rl]` and `[evaluate]`. `name` stands for its weights in the report: give another one to
    another policy. With `out` the report is written there, with plots.
    """
    if isinstance(dataset, Dataset):
        location, split = dataset.location, split or dataset.split
    else:
        location = os.fspath(dataset)
    settings = {section: dict(values) for section, values in (settings or {}).items()}
    chosen = list(methods) if methods is not None else ["rsp", "bnp-8", "g-rsp", "g-bnp-8", "random-walk", "wall-walk", "oracle"]
    if policy is not None and "agent" not in chosen:
        chosen.append("agent")
    settings.setdefault("evaluate", {})["methods"] = chosen
    with tempfile.TemporaryDirectory() as scratch:
        to = Path(out) if out is not None else Path(scratch) / "evaluation"
        text = _native.evaluate(
            location, policy, name, split_name=split, settings=json.dumps(settings), out=to, overwrite=overwrite, progress=progress)
    return Report(json.loads(text), None if out is None else Path(out))
