"""Stable-Baselines3 takes the environment."""

import warnings

import pytest
from sb3_contrib import MaskablePPO
from stable_baselines3.common.env_checker import check_env

import holescout


def test_its_checker_has_nothing_to_say(few: holescout.Maps) -> None:
    with warnings.catch_warnings():
        warnings.simplefilter("error")
        check_env(holescout.CoverageHoleEnv(few))


@pytest.mark.filterwarnings("ignore")
def test_maskable_ppo_learns_on_it(few: holescout.Maps) -> None:
    model = MaskablePPO("MultiInputPolicy", holescout.CoverageHoleEnv(few), n_steps=64, batch_size=32, n_epochs=1, seed=0)
    model.learn(128)
    assert model.num_timesteps == 128
