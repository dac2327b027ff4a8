"""Promises of rollout and update."""

from __future__ import annotations

import dataclasses

import numpy as np
import pytest

torch = pytest.importorskip("torch")

from fake_env import PointEnv  # noqa: E402

from densecavoid.learning import ppo  # noqa: E402
from densecavoid.learning.collector import Collector  # noqa: E402
from densecavoid.learning.rollout import Rollout  # noqa: E402
from densecavoid.policy.network import ActorCritic, NetworkConfig, ObservationTensors  # noqa: E402

CPU = torch.device("cpu")


def collect(
    config: NetworkConfig, limit_steps: int = 20, steps: int = 16, sensors: str = "densecavoid"
) -> tuple[ActorCritic, Rollout, PointEnv]:
    torch.manual_seed(0)
    network = ActorCritic(config)
    env = PointEnv(8, limit_steps)
    collector = Collector([env], steps, sensors, 1.0, CPU)
    collector.reset(0)
    return network, collector.collect(network, torch.Generator().manual_seed(0)), env


def test_the_first_ratio_is_one(tiny_network: NetworkConfig) -> None:
    network, rollout, _ = collect(tiny_network)
    config = ppo.PPOConfig(minibatch_size=rollout.num_steps)
    statistics = ppo.update(network, ppo.make_optimiser(network, config), rollout, config, torch.Generator())
    assert statistics.first_ratio_error < 2e-6


def test_the_first_ratio_is_not_one_for_another_policy(tiny_network: NetworkConfig) -> None:
    network, rollout, _ = collect(tiny_network)
    with torch.no_grad():
        network.actor_output.bias.add_(0.1)
    config = ppo.PPOConfig()
    statistics = ppo.update(network, ppo.make_optimiser(network, config), rollout, config, torch.Generator())
    assert statistics.first_ratio_error > 1e-3


def test_log_probabilities_are_those_of_the_actions_sent_unclipped(tiny_network: NetworkConfig) -> None:
    network, rollout, env = collect(tiny_network, steps=64)
    sent = np.stack(env.received)
    assert np.array_equal(sent, rollout.action.numpy())
    assert (np.abs(sent[..., 1]) > 0.4).any() or (sent[..., 0] < 0).any(), "the test needs draws outside the limits"
    flat = ObservationTensors(*(tensor.flatten(0, 1) for tensor in rollout.observation))
    with torch.no_grad():
        policy = network(flat).policy
        normal = torch.distributions.Normal(policy.mode, policy.std)
        expected = normal.log_prob(rollout.action.flatten(0, 1)).sum(1)
    torch.testing.assert_close(rollout.log_prob.flatten(), expected)


def test_a_time_limit_bootstraps_from_the_final_observation_not_from_the_next_episode(
    tiny_network: NetworkConfig,
) -> None:
    network, rollout, env = collect(tiny_network, limit_steps=3)
    assert rollout.truncated.any()
    bearing_before = rollout.observation.goal[..., 1]
    for t, n in rollout.truncated.nonzero().tolist():
        final_bearing = float(bearing_before[t, n]) - float(rollout.action[t, n, 1].clamp(-0.4, 0.4))
        observation = {name: torch.from_numpy(array[:1]) for name, array in env.observe().items()}
        observation["goal"] = torch.tensor([[1.0, final_bearing]])
        with torch.no_grad():
            expected = network.value(ObservationTensors(**observation))
        assert float(rollout.next_value[t, n]) == pytest.approx(float(expected), abs=1e-5)
        if t + 1 < rollout.value.shape[0]:
            assert float(rollout.next_value[t, n]) != pytest.approx(float(rollout.value[t + 1, n]), abs=1e-6)


def test_within_an_episode_the_next_value_is_that_of_the_next_step(tiny_network: NetworkConfig) -> None:
    _, rollout, _ = collect(tiny_network, limit_steps=5)
    carries_on = ~(rollout.terminated | rollout.truncated)[:-1]
    torch.testing.assert_close(rollout.next_value[:-1][carries_on], rollout.value[1:][carries_on], rtol=0, atol=0)


def test_sensors_that_are_not_there_are_blank_in_the_rollout(tiny_network: NetworkConfig) -> None:
    class Seen(PointEnv):
        def observe(self) -> dict[str, np.ndarray]:
            return super().observe() | {
                "lidar": np.full((self.num_envs, 3, 16), 0.3, np.float32),
                "prediction": np.zeros((self.num_envs, 4, 8), np.uint8),
                "worth": np.zeros((self.num_envs, 25), np.float32),
            }

    for sensors, lidar, prediction in (
        ("densecavoid", 0.3, 0),
        ("depth-lidar", 0.3, 255),
        ("depth", 1.0, 255),
        ("lidar", 0.3, 255),
    ):
        collector = Collector([Seen(2, 3)], 4, sensors, 1.0, CPU)
        collector.reset(0)
        observation = collector.collect(ActorCritic(tiny_network), torch.Generator()).observation
        assert torch.all(observation.lidar == torch.tensor(lidar)), sensors
        assert torch.all(observation.prediction == prediction), sensors


def test_losses_agree_with_values_computed_by_hand() -> None:
    # Ratios 1.5 and .5 with advantages 2 and -1, clip .2: min(3, 2.4) = 2.4 and min(-.5, -.8) = -.8.
    loss, ratio = ppo.policy_loss(torch.tensor([1.5, 0.5]).log(), torch.zeros(2), torch.tensor([2.0, -1.0]), clip=0.2)
    assert ratio.tolist() == pytest.approx([1.5, 0.5])
    assert loss.tolist() == pytest.approx([-2.4, 0.8])
    # Errors 3 and 1: (9 + 1) / 2 / 2. Clipped by .5, the first value is .5 and its error 2.5 < 3: unchanged; the second
    # moved from 0 to 2 towards 3, is kept at .5 and its error grows to 2.5: (9 + 6.25) / 4.
    value, old, target = torch.tensor([1.0, 2.0]), torch.tensor([0.0, 0.0]), torch.tensor([-2.0, 3.0])
    assert float(ppo.value_loss(value, old, target, clip=0.0).mean()) == pytest.approx(2.5)
    assert float(ppo.value_loss(value, old, target, clip=0.5).mean()) == pytest.approx(15.25 / 4)


def test_a_loss_that_is_not_finite_stops_the_update_before_the_weights_change(tiny_network: NetworkConfig) -> None:
    network, rollout, _ = collect(tiny_network)
    before = {name: tensor.clone() for name, tensor in network.state_dict().items()}
    rollout.reward[3, 2] = float("nan")
    config = ppo.PPOConfig(minibatch_size=rollout.num_steps)
    with pytest.raises(ppo.TrainingDivergedError, match="loss is nan"):
        ppo.update(network, ppo.make_optimiser(network, config), rollout, config, torch.Generator())
    assert all(torch.equal(before[name], tensor) for name, tensor in network.state_dict().items())


def test_the_update_stops_when_the_policy_has_moved_too_far(tiny_network: NetworkConfig) -> None:
    network, rollout, _ = collect(tiny_network)
    careful = ppo.PPOConfig(minibatch_size=16, epochs=20, learning_rate=0.01, target_kl=0.01, schedule="fixed")
    statistics = ppo.update(network, ppo.make_optimiser(network, careful), rollout, careful, torch.Generator())
    assert statistics.stopped_early and statistics.gradient_steps < 20 * 8
    bold = dataclasses.replace(careful, target_kl=0.0)
    statistics = ppo.update(network, ppo.make_optimiser(network, bold), rollout, bold, torch.Generator())
    assert not statistics.stopped_early and statistics.gradient_steps == 20 * 8


def test_learning_rate_schedules(tiny_network: NetworkConfig) -> None:
    network, rollout, _ = collect(tiny_network)
    config = ppo.PPOConfig(schedule="linear", learning_rate=1e-3)
    statistics = ppo.update(network, ppo.make_optimiser(network, config), rollout, config, torch.Generator(), 0.75)
    assert statistics.learning_rate == pytest.approx(0.25e-3)
    assert ppo.adapted_learning_rate(1e-3, kl=0.05, target_kl=0.02) == pytest.approx(1e-3 / 1.5)
    assert ppo.adapted_learning_rate(5e-4, kl=0.001, target_kl=0.02) == pytest.approx(7.5e-4)
    assert ppo.adapted_learning_rate(9e-4, kl=0.001, target_kl=0.02) == 1e-3
    assert ppo.adapted_learning_rate(1e-3, kl=0.01, target_kl=0.02) == 1e-3


def test_standard_deviations_stay_above_their_floor(tiny_network: NetworkConfig) -> None:
    network = ActorCritic(tiny_network)
    assert network.log_std is not None
    with torch.no_grad():
        network.log_std.copy_(torch.tensor([-9.0, 0.1]))
    network.raise_std_to_floor()
    assert network.log_std.exp().tolist() == pytest.approx([0.05, float(np.exp(0.1))])


def test_ppo_solves_a_toy_task(tiny_network: NetworkConfig) -> None:
    torch.manual_seed(1)
    network = ActorCritic(tiny_network)
    config = ppo.PPOConfig(learning_rate=3e-3, minibatch_size=128, target_kl=0.0, schedule="fixed")
    optimiser = ppo.make_optimiser(network, config)
    generator = torch.Generator().manual_seed(1)
    collector = Collector([PointEnv(32)], 32, "densecavoid", 1.0, CPU)
    collector.reset(1)
    first = last = success = float("nan")
    for iteration in range(25):
        rollout = collector.collect(network, generator)
        ppo.update(network, optimiser, rollout, config, generator)
        success, reward = np.mean(rollout.episodes.success), float(rollout.reward.mean())
        first, last = (reward, reward) if iteration == 0 else (first, reward)
    assert success > 0.95
    assert last > first + 0.2
    # Perfect: .4 rad a step, and standing still costs nothing.
    goal = torch.tensor([[1.0, 2.0], [1.0, -2.0]])
    observation = {name: torch.from_numpy(array[:2]) for name, array in PointEnv(2).observe().items()} | {"goal": goal}
    with torch.no_grad():
        mean = network.command(ObservationTensors(**observation))
    assert mean[0, 1] > 0.25 and mean[1, 1] < -0.25
    assert mean[:, 0].max() < 0.35
