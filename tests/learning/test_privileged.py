"""Promises of what training alone may know: true people for the critic, and a teacher to imitate."""

from __future__ import annotations

import dataclasses
from pathlib import Path

import numpy as np
import pytest

torch = pytest.importorskip("torch")

from fake_env import PointEnv  # noqa: E402

from densecavoid.learning.collector import Collector, Teacher  # noqa: E402
from densecavoid.learning.imitation import ImitationConfig, imitate  # noqa: E402
from densecavoid.learning.ppo import PPOConfig, make_optimiser  # noqa: E402
from densecavoid.policy.export import export_onnx  # noqa: E402
from densecavoid.policy.network import ActorCritic, NetworkConfig, ObservationTensors  # noqa: E402

CPU = torch.device("cpu")


def observation(batch: int) -> ObservationTensors:
    seen = PointEnv(batch)
    return ObservationTensors(**{name: torch.from_numpy(array) for name, array in seen.observe().items()})


def privileged(tiny: NetworkConfig, people: str) -> ActorCritic:
    torch.manual_seed(0)
    return ActorCritic(dataclasses.replace(tiny, people=people, num_people=3))


def test_true_people_reach_the_critic_and_not_the_actor(tiny_network: NetworkConfig) -> None:
    network = privileged(tiny_network, "critic")
    torch.nn.init.orthogonal_(network.actor_output.weight)
    some, others = torch.rand(2, 5, 3, 6, generator=torch.Generator().manual_seed(1)).unbind()
    with torch.no_grad():
        one, other = network(observation(5), some), network(observation(5), others)
    assert torch.equal(one.policy.mode, other.policy.mode)
    assert (one.value - other.value).abs().min() > 1e-4
    with torch.no_grad():
        assert torch.equal(network.command(observation(5)), one.policy.mode), "a robot runs it without the truth"
    with pytest.raises(ValueError, match="people is None, expected the true people"):
        network(observation(5))


def test_the_order_and_the_number_of_people_do_not_matter_but_who_is_there_does(tiny_network: NetworkConfig) -> None:
    network = privileged(tiny_network, "critic")
    people = torch.rand(1, 3, 6, generator=torch.Generator().manual_seed(2))
    people[..., 5] = torch.tensor([1.0, 1.0, 0.0])
    swapped = people[:, [1, 2, 0]].clone()
    elsewhere = people.clone()
    elsewhere[:, 2, :5] = 0.3  # nobody is there, whatever else is written
    with torch.no_grad():
        values = [float(network.value(observation(1), each)) for each in (people, swapped, elsewhere)]
        moved = people.clone()
        moved[:, 0, :2] += 1.0
        away = float(network.value(observation(1), moved))
    assert values[1:] == pytest.approx([values[0]] * 2, abs=1e-6)
    assert away != pytest.approx(values[0], abs=1e-4)


@pytest.mark.parametrize(("people", "least", "most"), [("critic", 0.0, 0.05), ("unseen", 0.8, 1.1)])
def test_the_critic_can_know_what_it_is_told_and_nothing_else(
    tiny_network: NetworkConfig, people: str, least: float, most: float
) -> None:
    """Its target is where somebody is whom the sensors do not show."""
    network = privileged(tiny_network, people)
    told = torch.zeros(256, 3, 6)
    told[:, 0, 0] = torch.linspace(-2.0, 2.0, 256)
    told[:, 0, 5] = 1.0
    target = told[:, 0, 0] / told[:, 0, 0].std()
    optimiser, error = torch.optim.Adam(network.parameters(), lr=3e-3), float("nan")
    for _ in range(150):
        loss = (network.value(observation(256)._replace(goal=torch.zeros(256, 2)), told) - target).square().mean()
        optimiser.zero_grad()
        loss.backward()
        optimiser.step()
        error = float(loss.detach())
    assert least <= error <= most


def test_imitation_brings_the_policy_to_the_teacher(tiny_network: NetworkConfig) -> None:
    teacher = privileged(tiny_network, "actor")
    torch.nn.init.orthogonal_(teacher.actor_output.weight, 10.0)
    torch.manual_seed(3)
    student = ActorCritic(tiny_network)
    config = PPOConfig(learning_rate=3e-3, minibatch_size=64)
    optimiser, generator = make_optimiser(student, config), torch.Generator().manual_seed(0)
    collector = Collector([PointEnv(32, people=3)], 16, "densecavoid", 1.0, CPU)
    collector.reset(0)
    losses = []
    for i in range(8):
        rollout = collector.collect(student, generator, teacher=Teacher(teacher, ImitationConfig(steps=10).share(i)))
        losses.append(imitate(student, optimiser, rollout, config, 10.0, generator).imitation_loss)
    assert losses[-1] < 0.05 * losses[0]


def test_the_teacher_drives_in_its_share_of_the_steps(tiny_network: NetworkConfig) -> None:
    teacher = privileged(tiny_network, "actor")
    collector = Collector([PointEnv(32, people=3)], 64, "densecavoid", 1.0, CPU)
    collector.reset(0)
    rollout = collector.collect(
        ActorCritic(tiny_network), torch.Generator().manual_seed(0), teacher=Teacher(teacher, 0.25)
    )
    assert rollout.teacher_mean is not None
    driven = (rollout.action == rollout.teacher_mean).all(dim=2).float().mean()
    assert float(driven) == pytest.approx(0.25, abs=0.03)
    assert ImitationConfig(steps=100, drives=0.5).share(0) == 0.5
    assert ImitationConfig(steps=100, drives=0.5).share(25) == 0.25
    assert ImitationConfig(steps=100, drives=0.5).share(60) == 0.0


def test_a_network_with_a_privileged_critic_is_exported_without_it(tiny_network: NetworkConfig, tmp_path: Path) -> None:
    onnxruntime = pytest.importorskip("onnxruntime")
    from densecavoid.policy.export import describe

    config = dataclasses.replace(tiny_network, people="critic", normalise_inputs=True)
    torch.manual_seed(0)
    network = ActorCritic(config)
    assert network.state_moments is not None and network.range_moments is not None
    network.state_moments.merge(torch.tensor([100.0]), torch.full((5,), 0.3), torch.full((5,), 0.2))
    network.range_moments.merge(torch.tensor([100.0]), torch.full((16,), 0.5), torch.full((16,), 0.1))
    torch.nn.init.orthogonal_(network.actor_output.weight)
    export_onnx(tmp_path / "policy.onnx", network, describe(network, "told"))
    session = onnxruntime.InferenceSession(tmp_path / "policy.onnx")
    seen = {name: array for name, array in PointEnv(3).observe().items() if name != "worth"}
    with torch.no_grad():
        expected = network.command(observation(3)).numpy()
    np.testing.assert_allclose(session.run(["mean"], seen)[0], expected, atol=1e-4)
