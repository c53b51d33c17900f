"""Makes the environment known to Gymnasium, where that is installed."""


def register() -> None:
    """Called when the package is imported; `gymnasium.make` then knows the environment by its name."""
    try:
        from gymnasium.envs.registration import register, registry
    except ImportError:
        return
    name = "holescout/CoverageHole-v0"
    if name not in registry:
        register(name, entry_point="holescout.env:CoverageHoleEnv", vector_entry_point="holescout.env:CoverageHoleVectorEnv")
