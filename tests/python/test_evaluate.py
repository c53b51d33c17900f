"""Policies in Python, judged as the command judges its own."""

import json
import os
import signal
import subprocess
import sys
import threading
from pathlib import Path

import numpy as np
import pytest

import holescout

SETTINGS = {"evaluate": {"starts": 20, "bootstrap": 100, "gallery_maps": 0}}


def last(observations: dict[str, np.ndarray]) -> np.ndarray:
    """The cells that flights are in, [n, 2]."""
    flown = (observations["rows"] >= 0).sum(axis=1) - 1
    at = np.arange(len(flown))
    return np.stack([observations["rows"][at, flown], observations["columns"][at, flown]], axis=1)


def stay(_: holescout.Map, observations: dict[str, np.ndarray]) -> np.ndarray:
    return last(observations)


def optimal(game: holescout.Map, observations: dict[str, np.ndarray]) -> list[tuple[int, int]]:
    """To any cell from which a hole is a step nearer."""
    hops, waypoints = game.oracle(), []
    for (row, column), mask in zip(last(observations), observations["action_mask"]):
        offsets = np.flatnonzero(mask)
        rows, columns = row + offsets // 31 - 15, column + offsets % 31 - 15
        near = hops[rows, columns]
        best = np.flatnonzero(near == hops[row, column] - 1)
        at = best[0] if len(best) else np.flatnonzero(offsets == 480)[0]
        waypoints.append((rows[at], columns[at]))
    return waypoints


def test_a_policy_that_knows_all_is_as_good_as_the_oracle(sanjose: Path) -> None:
    report = holescout.evaluate(optimal, sanjose, "val", methods=["oracle", "random-walk"], settings=SETTINGS)
    for k in (1, 2, 4, 8):
        assert report.precision("agent", k) == pytest.approx(report.precision("oracle", k))
        assert report.precision("agent", k) > report.precision("random-walk", k)
    assert report.data["split"] == "val" and 0 < report.recall("agent", 8) <= 1
    with pytest.raises(KeyError, match="no score of trees"):
        report.precision("trees", 1)


def test_the_report_is_that_of_the_command(sanjose: Path, tmp_path: Path) -> None:
    config = tmp_path / "settings.toml"
    config.write_text("[evaluate]\nstarts = 20\nbootstrap = 100\ngallery_maps = 0\n")
    command = [str(Path(sys.executable).with_name("holescout")), "--config", str(config), "--quiet", "evaluate", "--dataset", str(sanjose),
               "--split", "val", "--methods", "wall-walk,oracle", "--out", str(tmp_path / "command")]
    subprocess.run(command, check=True, capture_output=True)
    told = json.loads((tmp_path / "command" / "report.json").read_text())
    own = holescout.evaluate(
        None, holescout.Dataset(sanjose, "val"), methods=["wall-walk", "oracle"], settings=SETTINGS, out=tmp_path / "python")
    assert own.data == told and own.path == tmp_path / "python"
    for name in os.listdir(tmp_path / "command"):
        assert (tmp_path / "command" / name).read_bytes() == (tmp_path / "python" / name).read_bytes(), name
    assert holescout.verify(tmp_path / "python").failures == []


def test_progress_is_told(sanjose: Path) -> None:
    heard: list[tuple[str, int, int | None]] = []
    holescout.evaluate(stay, sanjose, "val", methods=[], settings=SETTINGS, progress=lambda *told: heard.append(told))
    assert {phase for phase, _, _ in heard} >= {"flying"}
    done = [done for phase, done, _ in heard if phase == "flying"]
    assert done == sorted(done)


@pytest.mark.parametrize(
    ("policy", "error", "message"),
    [
        (lambda *_: 1 / 0, ZeroDivisionError, "division"),
        (lambda *_: np.zeros(3), holescout.InvalidInput, "waypoints"),
        (lambda *_: np.zeros((3, 3)), holescout.InvalidInput, r"\[\d+, 2\]"),
    ],
)
def test_what_a_policy_raises_comes_out(sanjose: Path, tmp_path: Path, policy: object, error: type[Exception], message: str) -> None:
    with pytest.raises(error, match=message):
        holescout.evaluate(policy, sanjose, "val", methods=[], settings=SETTINGS, out=tmp_path / "out")  # type: ignore[arg-type]
    assert not (tmp_path / "out" / "manifest.json").exists()


def test_ctrl_c_ends_an_evaluation(sanjose: Path) -> None:
    timer = threading.Timer(1.0, lambda: os.kill(os.getpid(), signal.SIGINT))
    timer.start()
    with pytest.raises(KeyboardInterrupt):
        for _ in range(100):
            holescout.evaluate(stay, sanjose, None, methods=["wall-walk", "oracle"], settings={"evaluate": {"starts": 500}})
    timer.join()


def test_settings_are_checked(sanjose: Path) -> None:
    for settings, message in [({"evaluate": {"start": 1}}, "unknown field"), ({"evaluate": {"starts": 0}}, "evaluate.starts")]:
        with pytest.raises(holescout.InvalidInput, match=message):
            holescout.evaluate(stay, sanjose, "val", methods=[], settings=settings)
    with pytest.raises(holescout.InvalidInput, match="no method"):
        holescout.evaluate(stay, sanjose, "val", methods=["oracles"])
