"""The wheel is installed; these tests know of the repository what people have: its datasets and fixtures.

`HOLESCOUT_DATASET` is the dataset that `make dataset` builds, `TRAJECTORIES` the example of that name.
"""

import os
import sys
from pathlib import Path

import pytest

import holescout

ROOT = Path(__file__).parents[2]
sys.path.insert(0, str(ROOT / "examples"))


@pytest.fixture(scope="session")
def helsinki() -> Path:
    return Path(os.environ["HOLESCOUT_DATASET"])


@pytest.fixture(scope="session")
def sanjose() -> Path:
    return sorted((ROOT / "datasets").glob("sanjose-*.*.*"))[-1]


@pytest.fixture(scope="session")
def train(sanjose: Path) -> holescout.Dataset:
    return holescout.Dataset(sanjose, "train")


@pytest.fixture(scope="session")
def maps(train: holescout.Dataset) -> holescout.Maps:
    return holescout.Maps(train)


@pytest.fixture(scope="session")
def few(train: holescout.Dataset) -> holescout.Maps:
    """A few maps of train."""
    return holescout.Maps(train, ids=train.ids[:4])
