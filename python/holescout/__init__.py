"""Coverage holes in urban radio maps.

    import holescout

    dataset = holescout.Dataset("datasets/sanjose-1.0.0", "train")
    record = dataset[0]                       # heights, levels, mask: NumPy arrays, row 0 north, column 0 west
    env = holescout.make_vec(dataset, num_envs=64)

`Dataset` reads released datasets, from a directory or a server; `make_vec` is the paper's task as a `gymnasium.vector.VectorEnv`;
`evaluate` judges any callable as the command `holescout evaluate` judges its own methods. The command, which makes datasets from
OpenStreetMap and ray-traced radio maps, is part of the package; its stages are functions here as well (`holescout.rasterise` ...).

Nothing here needs PyTorch; `holescout.torch` has what PyTorch's users want. `RAYON_NUM_THREADS` bounds the threads.
"""

from importlib.metadata import version as _version
from typing import Any

from .dataset import Dataset, Loader, Record
from .errors import HolescoutError, InvalidInput, RunFailed
from .evaluation import Report, evaluate
from .maps import Map, Maps
from .registration import register as _register
from .replay import ReplayBuffer
from .stages import StageOutput, Verification, import_rsrp, rasterise, scenes, shard, verify

_register()

__version__ = _version("holescout")

__all__ = [
    "CoverageHoleEnv",
    "CoverageHoleVectorEnv",
    "Dataset",
    "HolescoutError",
    "InvalidInput",
    "Loader",
    "Map",
    "Maps",
    "Record",
    "ReplayBuffer",
    "Report",
    "RunFailed",
    "StageOutput",
    "Verification",
    "evaluate",
    "import_rsrp",
    "make_vec",
    "rasterise",
    "scenes",
    "shard",
    "verify",
]

_OF_GYMNASIUM = ("CoverageHoleEnv", "CoverageHoleVectorEnv", "make_vec")


def __getattr__(name: str) -> Any:
    # Gymnasium need not be installed.
    if name in _OF_GYMNASIUM:
        from . import env

        return getattr(env, name)
    raise AttributeError(f"module {__name__!r} has no attribute {name!r}")
