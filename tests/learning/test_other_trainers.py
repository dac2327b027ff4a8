"""Promises of the examples: other libraries' PPO trains on the same worlds."""

from __future__ import annotations

import warnings
from typing import Any

import pytest

torch = pytest.importorskip("torch")


def changed(before: dict, after: dict) -> bool:
    assert all(torch.isfinite(tensor).all() for tensor in after.values())
    return any(not torch.equal(before[name], tensor) for name, tensor in after.items())


def test_stable_baselines3_trains_on_the_same_worlds() -> None:
    pytest.importorskip("stable_baselines3")
    import stable_baselines3_ppo as example

    worlds = example.BatchedWorlds(example.densecavoid.make_vec("random-goal", 4))
    ppo = example.make_ppo(worlds, n_steps=64, batch_size=64, n_epochs=1, seed=0, device="cpu")
    before = {name: tensor.clone() for name, tensor in ppo.policy.state_dict().items()}
    ppo.learn(2 * 4 * 64)
    assert ppo.num_timesteps == 2 * 4 * 64 and ppo._n_updates == 2
    assert changed(before, ppo.policy.state_dict())


def test_stable_baselines3_is_told_of_time_limits_and_of_the_last_observation() -> None:
    pytest.importorskip("stable_baselines3")
    import numpy as np
    import stable_baselines3_ppo as example

    worlds = example.BatchedWorlds(example.densecavoid.make_vec("random-goal", 4))
    worlds.seed(0)
    before: Any = worlds.reset()
    seen: Any = before
    done = np.zeros(4, bool)
    ends: list[dict] = []
    while not ends:
        before = seen
        seen, _, done, infos = worlds.step(np.zeros((4, 2), np.float32))
        ends = [info for info in infos if info]
        assert len(ends) == done.sum()
    first = int(np.flatnonzero(done)[0])
    assert ends[0]["TimeLimit.truncated"] and not ends[0]["is_success"]
    # The robot stood still: the last observation is that of the step before, the one returned is of another world.
    assert np.array_equal(ends[0]["terminal_observation"]["goal"], before["goal"][first])
    assert not np.array_equal(seen["goal"][first], before["goal"][first])


def test_rsl_rl_trains_on_the_same_worlds(capsys: pytest.CaptureFixture) -> None:
    with warnings.catch_warnings():
        warnings.simplefilter("ignore")  # of its imports
        pytest.importorskip("rsl_rl")
        import rsl_rl_ppo as example

        worlds = example.BatchedWorlds(example.densecavoid.make_vec("random-goal", 4))
        runner = example.OnPolicyRunner(worlds, example.settings(32), log_dir=None, device="cpu")
        actor = runner.alg.get_policy()
        before = {name: tensor.clone() for name, tensor in actor.state_dict().items()}
        runner.learn(2)
    assert changed(before, actor.state_dict())
