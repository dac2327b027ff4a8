"""Promises of learning in the mirror."""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import dataclass
from typing import Any

import numpy as np
import pytest

torch = pytest.importorskip("torch")

from fake_env import PointEnv  # noqa: E402

from densecavoid.env import DenseCAvoidVectorEnv  # noqa: E402
from densecavoid.env.observation import ObserverConfig  # noqa: E402
from densecavoid.learning import ppo  # noqa: E402
from densecavoid.learning.collector import Collector  # noqa: E402
from densecavoid.learning.mirror import mirror_action, mirror_observation, mirror_people  # noqa: E402
from densecavoid.learning.peers import Peers  # noqa: E402
from densecavoid.learning.rollout import Rollout  # noqa: E402
from densecavoid.learning.shuffling import Minibatch, minibatches  # noqa: E402
from densecavoid.policy.network import ActorCritic, NetworkConfig, ObservationTensors  # noqa: E402
from densecavoid.sim.floorplan import FloorPlan  # noqa: E402
from densecavoid.sim.spec import WorldSpec  # noqa: E402


@dataclass(frozen=True)
class OneSided:
    """Things on the left, or with `side` -1 the same on the right."""

    side: float

    @property
    def name(self) -> str:
        return "one-sided"

    def spawn(self, rng: np.random.Generator) -> WorldSpec:
        plan = FloorPlan()
        plan.pillar(2.0, 0.7 * self.side, 0.2)
        plan.box(1.6, -0.9 * self.side, 0.5, 0.3, 0.4 * self.side)
        return WorldSpec("one-sided", plan, (0.0, 0.0, 0.0), (5.0, 1.5 * self.side), time_limit_s=60.0)


def test_the_mirror_shows_what_a_mirrored_world_shows() -> None:
    seen = []
    for side in (1.0, -1.0):
        config = ObserverConfig(route_every_s=0.5, weighs_commands=True)
        env = DenseCAvoidVectorEnv(OneSided(side), 1, observer=config)
        observation, _ = env.reset(seed=0)
        for _ in range(4):
            observation, *_ = env.step(np.array([[0.3, 0.25 * side]], np.float32))
        seen.append(ObservationTensors(**{name: torch.from_numpy(array) for name, array in observation.items()}))
    left, right = seen
    assert (left.lidar - right.lidar).abs().max() > 0.1, "the test needs a world with two different sides"
    mirrored = mirror_observation(left, torch.tensor([True]))
    torch.testing.assert_close(mirrored.lidar, right.lidar, atol=2e-3, rtol=0)
    assert (left.worth - right.worth).abs().max() > 0.01
    # The map's cells are not mirrored with the world.
    torch.testing.assert_close(mirrored.worth, right.worth, atol=0.003, rtol=0)
    torch.testing.assert_close(mirrored.goal, right.goal, atol=0.1, rtol=0)
    torch.testing.assert_close(mirrored.velocity, right.velocity, atol=1e-6, rtol=0)
    differ = (mirrored.camera.int() - right.camera.int()).abs() > 2
    assert differ.float().mean() < 0.01, "but for pixels on an edge"
    assert torch.equal(mirror_observation(left, torch.tensor([False])).lidar, left.lidar)


def test_people_and_actions_change_sides() -> None:
    person = torch.tensor([[[2.0, 0.5, -1.0, 0.3, 0.25, 1.0]]])
    assert mirror_people(person, torch.tensor([True])).flatten().tolist() == pytest.approx(
        [2.0, -0.5, -1.0, -0.3, 0.25, 1.0]
    )
    actions = torch.tensor([[0.7, 0.2], [0.7, 0.2]])
    assert mirror_action(actions, torch.tensor([True, False])).tolist() == [
        pytest.approx([0.7, -0.2]),
        pytest.approx([0.7, 0.2]),
    ]


def collected(tiny: NetworkConfig) -> tuple[ActorCritic, Rollout]:
    torch.manual_seed(1)
    network = ActorCritic(tiny)
    torch.nn.init.orthogonal_(network.actor_output.weight)
    collector = Collector([PointEnv(8)], 16, "densecavoid", 1.0, torch.device("cpu"))
    collector.reset(1)
    return network, collector.collect(network, torch.Generator().manual_seed(1))


def test_learning_in_the_mirror_is_learning_from_mirrored_samples(
    tiny_network: NetworkConfig, monkeypatch: pytest.MonkeyPatch
) -> None:
    """With every sample mirrored, weights end as they do for samples that were mirrored by hand beforehand."""
    original, ends = ppo.minibatches, []

    def all_mirrored(*args: Any) -> Iterator[Minibatch]:
        for minibatch in original(*args):
            yield minibatch._replace(other_half=torch.ones_like(minibatch.other_half))

    for by_hand in (True, False):
        network, rollout = collected(tiny_network)
        if by_hand:
            across = torch.tensor([1.0, -1.0])
            seen = rollout.observation
            turned = {name: getattr(seen, name).flip(-1) for name in ("lidar", "camera", "prediction")}
            turned |= {name: getattr(seen, name) * across for name in ("goal", "velocity")}
            turned |= {"worth": seen.worth.unflatten(-1, (5, 5)).flip(-1).flatten(-2)}
            rollout.observation, rollout.action = ObservationTensors(**turned), rollout.action * across
        else:
            monkeypatch.setattr(ppo, "minibatches", all_mirrored)
        config = ppo.PPOConfig(minibatch_size=64, target_kl=0.0, schedule="fixed", mirror=not by_hand)
        ppo.update(network, ppo.make_optimiser(network, config), rollout, config, torch.Generator().manual_seed(2))
        ends.append(network.state_dict())
    for name, tensor in ends[0].items():
        torch.testing.assert_close(ends[1][name], tensor, atol=1e-6, rtol=1e-5, msg=name)


def test_each_sample_is_mirrored_in_every_second_pass(tiny_network: NetworkConfig) -> None:
    _, rollout = collected(tiny_network)
    mirrored = torch.zeros(2, rollout.num_steps, dtype=torch.bool)
    found = list(minibatches(rollout, 2, 64, torch.Generator().manual_seed(0), Peers()))
    for number, minibatch in enumerate(found):
        mirrored[number // 2, minibatch.own] = minibatch.other_half
    assert torch.equal(mirrored[0], ~mirrored[1]) and int(mirrored[0].sum()) == rollout.num_steps // 2


def test_the_first_ratio_is_taken_of_samples_as_they_were(tiny_network: NetworkConfig) -> None:
    network, rollout = collected(tiny_network)
    config = ppo.PPOConfig(mirror=True, minibatch_size=rollout.num_steps)
    statistics = ppo.update(network, ppo.make_optimiser(network, config), rollout, config, torch.Generator())
    assert statistics.first_ratio_error < 2e-6
