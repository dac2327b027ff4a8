"""Promises of running moments, lasting noise, half-precision storage and randomised bodies."""

from __future__ import annotations

import dataclasses

import numpy as np
import pytest

torch = pytest.importorskip("torch")

from fake_env import PointEnv  # noqa: E402

from densecavoid.learning.collector import Collector  # noqa: E402
from densecavoid.learning.config import TrainConfig  # noqa: E402
from densecavoid.learning.ppo import PPOConfig, follow_inputs, make_optimiser, update  # noqa: E402
from densecavoid.learning.variety import VarietyConfig, vary_body, vary_places  # noqa: E402
from densecavoid.learning.worlds import make_training_envs  # noqa: E402
from densecavoid.policy.moments import RunningMoments  # noqa: E402
from densecavoid.policy.network import ActorCritic, NetworkConfig, ObservationTensors  # noqa: E402
from densecavoid.scenarios import TRAINING  # noqa: E402
from densecavoid.sim.config import SimConfig  # noqa: E402

CPU = torch.device("cpu")


def test_moments_merged_in_parts_are_those_of_everything() -> None:
    rng = np.random.default_rng(0)
    parts = [
        rng.normal(loc, 2.0 + abs(loc), (size, 3)).astype(np.float32) for loc, size in ((0, 40), (5, 7), (-3, 100))
    ]
    moments = RunningMoments(3)
    for part in parts:
        moments.merge(torch.tensor([float(len(part))]), torch.from_numpy(part.mean(0)), torch.from_numpy(part.var(0)))
    everything = np.concatenate(parts)
    np.testing.assert_allclose(moments.mean, everything.mean(0), rtol=1e-4, atol=1e-5)
    np.testing.assert_allclose(moments.variance, everything.var(0), rtol=1e-4)
    x = torch.from_numpy(everything)
    np.testing.assert_allclose(moments.restore(moments.normalise(x)), everything, rtol=1e-4, atol=1e-4)


def test_new_moments_of_returns_do_not_change_what_the_critic_says(tiny_network: NetworkConfig) -> None:
    torch.manual_seed(0)
    network = ActorCritic(dataclasses.replace(tiny_network, normalise_values=True))
    seen = ObservationTensors(**{name: torch.from_numpy(array) for name, array in PointEnv(9).observe().items()})
    with torch.no_grad():
        before = network.value(seen)
        for mean, variance in ((20.0, 49.0), (-3.0, 4.0)):
            network.follow_returns(torch.tensor([64.0]), torch.tensor([mean]), torch.tensor([variance]))
            torch.testing.assert_close(network.value(seen), before, atol=1e-4, rtol=1e-4)
    assert network.value_moments is not None and float(network.value_moments.mean) == pytest.approx(8.5)


@pytest.mark.parametrize("scale", [0.01, 100.0])
def test_with_normalised_values_the_size_of_rewards_does_not_matter(tiny_network: NetworkConfig, scale: float) -> None:
    torch.manual_seed(0)
    network = ActorCritic(dataclasses.replace(tiny_network, normalise_values=True, normalise_inputs=True))
    config = PPOConfig(learning_rate=3e-3, minibatch_size=128, schedule="fixed", target_kl=0.0)
    collector, generator = Collector([PointEnv(32)], 32, "densecavoid", scale, CPU), torch.Generator().manual_seed(0)
    collector.reset(0)
    optimiser, explained = make_optimiser(network, config), 0.0
    for _ in range(6):
        rollout = collector.collect(network, generator)
        statistics = update(network, optimiser, rollout, config, generator)
        assert statistics.first_ratio_error < 1e-5, "moments must not move between acting and learning"
        explained = statistics.explained_variance
        follow_inputs(network, rollout)
    assert explained > 0.3
    assert network.state_moments is not None and float(network.state_moments.count) == 6 * 32 * 32


def test_lasting_noise_has_the_same_size_and_lasts(tiny_network: NetworkConfig) -> None:
    network = ActorCritic(tiny_network)
    assert network.log_std is not None
    torch.nn.init.zeros_(network.actor_output.weight)
    found = {}
    for kept in (0.0, 0.8):
        collector = Collector([PointEnv(64)], 200, "densecavoid", 1.0, CPU)
        collector.reset(0)
        action = collector.collect(network, torch.Generator().manual_seed(0), noise_persistence=kept).action[..., 0]
        noise = (action - 0.5) / network.log_std.exp()[0].detach()
        found[kept] = float((noise[1:] * noise[:-1]).mean())
        assert float(noise.square().mean()) == pytest.approx(1.0, abs=0.05)
    assert found == pytest.approx({0.0: 0.0, 0.8: 0.8}, abs=0.04)


def test_ranges_in_half_precision_move_the_policy_by_less_than_a_millimetre_a_second(
    tiny_network: NetworkConfig,
) -> None:
    class Seeing(PointEnv):
        def observe(self) -> dict[str, np.ndarray]:
            rng = np.random.default_rng(0)
            return super().observe() | {"lidar": rng.random((self.num_envs, 3, 16), dtype=np.float32)}

    torch.manual_seed(0)
    network = ActorCritic(tiny_network)
    means = []
    for dtype in (torch.float32, torch.float16):
        collector = Collector([Seeing(8)], 4, "densecavoid", 1.0, CPU, lidar_dtype=dtype)
        collector.reset(0)
        rollout = collector.collect(network, torch.Generator().manual_seed(0))
        assert rollout.observation.lidar.dtype == dtype
        means.append(rollout.action)
        config = PPOConfig(minibatch_size=rollout.num_steps)
        copied = ActorCritic(tiny_network)
        copied.load_state_dict(network.state_dict())
        statistics = update(copied, make_optimiser(copied, config), rollout, config, torch.Generator())
        assert statistics.first_ratio_error < 2e-6, "what is learned from is what was seen"
    torch.testing.assert_close(means[0], means[1], atol=1e-3, rtol=0)


def test_each_body_differs_and_follows_the_seed() -> None:
    sim = SimConfig()
    bodies = [vary_body(sim, 3, group) for group in range(8)]
    assert bodies == [vary_body(sim, 3, group) for group in range(8)]
    assert vary_body(sim, 4, 0) != bodies[0]
    assert len({body.noise for body in bodies}) == 8 and all(body.sensors == "real" for body in bodies)
    assert {body.dynamics for body in bodies} == {"ideal", "dynamic"}
    assert len({(body.lidar.latency_s, body.camera.latency_s) for body in bodies}) > 3
    assert len({body.people for body in bodies}) > 1
    datasheet = sim.noise.lidar_range_share
    assert all(datasheet / 2 <= body.noise.lidar_range_share <= datasheet * 2 for body in bodies)


def test_places_are_mixed_in_by_their_share() -> None:
    stage = TRAINING["random-goal"]
    assert vary_places(stage, 0.0, 0.5) is stage
    mixed = vary_places(stage, 0.4, 0.5)
    rng = np.random.default_rng(0)
    found = [mixed.spawn(rng).scenario for _ in range(60)]
    assert 0.4 < np.mean([name == "random-goal" for name in found]) < 0.8 and len(set(found)) > 3


@pytest.mark.slow  # compiles the kernels of real sensors
def test_varied_worlds_are_groups_with_bodies_of_their_own() -> None:
    config = TrainConfig(num_envs=4, variety=VarietyConfig(bodies=2), privileged_critic=True)
    envs = make_training_envs(config, TRAINING["random-goal"], 0)
    assert [env.num_envs for env in envs] == [2, 2]
    assert envs[0].task.simulator.config != envs[1].task.simulator.config
    assert envs[1].reset(seed=0)[0]["people"].shape == (2, 8, 6)


def test_the_network_that_settings_ask_for() -> None:
    asked = TrainConfig(critic="separate", privileged_critic=True, normalise_inputs=True).network_config
    assert (asked.shared_encoder, asked.people, asked.normalise_inputs, asked.normalise_values) == (
        False,
        "critic",
        True,
        False,
    )
    assert TrainConfig(network="teacher", privileged_critic=True).network_config.people == "actor"
    assert TrainConfig(network="paper", critic="shared").network_config.shared_encoder
