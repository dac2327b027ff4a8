"""Promises of the network."""

from __future__ import annotations

import dataclasses

import numpy as np
import pytest

torch = pytest.importorskip("torch")

from densecavoid.networks.config_json import from_json, to_json  # noqa: E402
from densecavoid.policy.distribution import GridChoice  # noqa: E402
from densecavoid.policy.network import (  # noqa: E402
    PRESETS,
    ActorCritic,
    ConvConfig,
    NetworkConfig,
    ObservationTensors,
    count_mflop,
    count_parameters,
)


def random_observation(batch: int, seed: int = 0) -> ObservationTensors:
    rng = np.random.default_rng(seed)
    image = rng.integers(0, 256, (2, batch, 60, 80), dtype=np.uint8)
    return ObservationTensors(
        torch.from_numpy(rng.random((batch, 3, 512), dtype=np.float32)),
        torch.from_numpy(image[0]),
        torch.from_numpy(rng.uniform([0, -3], [20, 3], (batch, 2)).astype(np.float32)),
        torch.from_numpy(rng.uniform([0, -0.4], [1, 0.4], (batch, 2)).astype(np.float32)),
        torch.from_numpy(image[1]),
        torch.from_numpy(rng.uniform(-0.5, 1, (batch, 25)).astype(np.float32)),
    )


WEIGHING = dataclasses.replace(NetworkConfig.preset("compact"), name="weighing", worth_features=64)
CHOOSING = dataclasses.replace(WEIGHING, name="choosing", chooses=True)
"""Is told what commands are worth."""


@pytest.fixture(params=[NetworkConfig.preset("compact"), NetworkConfig.preset("paper"), WEIGHING], ids=lambda c: c.name)
def network(request: pytest.FixtureRequest) -> ActorCritic:
    torch.manual_seed(0)
    return ActorCritic(request.param)


def test_the_papers_network_has_the_published_layers() -> None:
    # FACTS: conv1d 5,32,2 and 3,16,2, FC 256; conv2d 5x5,64,2, 5x5,64,1, 3x3,32,2, FC 512, FC 256; 516 -> 128 -> 2.
    shapes = {
        "actor_encoder.lidar_convs.0": (32, 3, 5),
        "actor_encoder.lidar_convs.1": (16, 32, 3),
        "actor_encoder.lidar_linears.0": (256, 16 * 128),
        "actor_encoder.camera_convs.0": (64, 2, 5, 5),
        "actor_encoder.camera_convs.1": (64, 64, 5, 5),
        "actor_encoder.camera_convs.2": (32, 64, 3, 3),
        "actor_encoder.camera_linears.0": (512, 32 * 15 * 20),
        "actor_encoder.camera_linears.1": (256, 512),
        "actor_hidden.0": (128, 516),
        "actor_output": (2, 128),
        "critic_output": (1, 128),
    }
    state = ActorCritic(NetworkConfig.preset("paper")).state_dict()
    for name, shape in shapes.items():
        assert tuple(state[f"{name}.weight"].shape) == shape, name
        assert state[f"{name.replace('actor', 'critic')}.bias"].shape[0] in (shape[0], 1), "the critic has the same"


def test_the_papers_network_has_the_published_size() -> None:
    config = NetworkConfig.preset("paper")
    assert count_parameters(config) == pytest.approx(5.76e6, rel=0.002)
    assert count_mflop(config) == pytest.approx(276, abs=1)


def test_operations_are_those_that_torch_counts() -> None:
    from torch.utils.flop_counter import FlopCounterMode

    for config in (*PRESETS.values(), WEIGHING, CHOOSING):
        network = ActorCritic(config)
        network.set_patch_products(False)
        with FlopCounterMode(display=False) as counter, torch.no_grad():
            people = torch.zeros(1, config.num_people, 6) if config.people == "actor" else None
            network.command(random_observation(1), people)
        assert count_mflop(config) == pytest.approx(counter.get_total_flops() / 1e6, rel=1e-6), config.name


def test_the_compact_network_is_a_thirtieth_of_the_papers() -> None:
    assert count_mflop(NetworkConfig.preset("compact")) <= 2.5


def test_the_mean_keeps_the_robots_limits_for_every_input(network: ActorCritic) -> None:
    with torch.no_grad():
        network.actor_output.weight *= 1e4
        policy, value = network(random_observation(32))
    mean = policy.mode
    assert mean.shape == (32, 2) and value.shape == (32,)
    assert mean[:, 0].min() >= 0.0 and mean[:, 0].max() <= 1.0
    assert mean[:, 1].min() >= -0.4 and mean[:, 1].max() <= 0.4
    assert mean[:, 1].max() > 0.39 or mean[:, 1].min() < -0.39, "the test must reach the limits"


def test_one_pass_gives_what_actor_and_critic_give_alone(network: ActorCritic) -> None:
    observation = random_observation(3)
    with torch.no_grad():
        output = network(observation)
        torch.testing.assert_close(output.policy.mode, network.command(observation))
        torch.testing.assert_close(output.value, network.value(observation))


def test_before_it_has_learned_a_choice_is_what_is_worth_most_and_losses_count_by_the_scale() -> None:
    torch.manual_seed(2)
    network, observation = ActorCritic(CHOOSING), random_observation(9)
    torch.nn.init.zeros_(network.actor_output.weight)
    with torch.no_grad():
        policy = network(observation).policy
    assert isinstance(policy, GridChoice)
    assert torch.equal(policy.mode, policy.grid[observation.worth.argmax(dim=1)])
    assert policy.grid[:, 0].max() == 1.0 and policy.grid[:, 1].min() == pytest.approx(-0.4)
    apart = (observation.worth[:, 3] - observation.worth[:, 8]) / CHOOSING.indifference
    torch.testing.assert_close(policy.log_probs[:, 3] - policy.log_probs[:, 8], apart, rtol=1e-4, atol=1e-4)
    with torch.no_grad():
        network.actor_output.bias[8] = 1000.0
        corrected = network(observation).policy
    assert torch.equal(corrected.mode, policy.grid[[8] * 9])


def test_who_is_told_nothing_cannot_choose() -> None:
    with pytest.raises(ValueError, match="worth_features is 0, expected positive to choose"):
        dataclasses.replace(CHOOSING, worth_features=0)


def test_matrix_products_on_patches_agree_with_convolutions() -> None:
    torch.manual_seed(1)
    network = ActorCritic(NetworkConfig.preset("compact"))
    observation = random_observation(5)
    products = network(observation)
    (products.policy.mode.sum() + products.value.sum()).backward()
    gradients = {
        name: parameter.grad.clone() for name, parameter in network.named_parameters() if parameter.grad is not None
    }
    network.zero_grad()
    network.set_patch_products(False)
    convolutions = network(observation)
    (convolutions.policy.mode.sum() + convolutions.value.sum()).backward()
    torch.testing.assert_close(products.policy.mode, convolutions.policy.mode, atol=1e-6, rtol=1e-5)
    torch.testing.assert_close(products.value, convolutions.value, atol=1e-5, rtol=1e-5)
    for name, parameter in network.named_parameters():
        if parameter.grad is not None:
            torch.testing.assert_close(gradients[name], parameter.grad, atol=1e-4, rtol=1e-3, msg=name)


def test_every_part_of_the_observation_matters(network: ActorCritic) -> None:
    torch.nn.init.orthogonal_(network.actor_output.weight)
    one, other = random_observation(4, seed=1), random_observation(4, seed=2)
    with torch.no_grad():
        before = network.command(one)
        for name in ObservationTensors._fields:
            after = network.command(one._replace(**{name: getattr(other, name)}))
            seen = name != "worth" or network.config.worth_features > 0
            assert ((after - before).abs().max() > 1e-4) == seen, name


def test_an_empty_view_is_all_zeros_to_the_camera_branch() -> None:
    """No depth (0) and nobody predicted (white, 255) reach the first layer as zeros: its output is its bias."""
    network = ActorCritic(NetworkConfig.preset("compact"))
    encoder = network.actor_encoder
    blank = torch.zeros(1, 60, 80, dtype=torch.uint8)
    white = torch.full((1, 60, 80), 255, dtype=torch.uint8)
    for products in (True, False):
        network.set_patch_products(products)
        with torch.no_grad():
            for linear in encoder.camera_linears:
                torch.nn.init.constant_(linear.get_parameter("bias"), 0.25)
            empty = encoder._camera(blank, white)
            person = encoder._camera(blank, blank)
        assert torch.all(empty == 0.25)
        assert not torch.allclose(person, empty)


def test_bfloat16_branches_stay_close_to_float32(network: ActorCritic) -> None:
    observation = random_observation(16)
    with torch.no_grad():
        exact = network(observation)
        network.set_compute_dtype(torch.bfloat16)
        rounded = network(observation)
    assert rounded.policy.mode.dtype == torch.float32
    torch.testing.assert_close(rounded.policy.mode, exact.policy.mode, atol=0.01, rtol=0)
    torch.testing.assert_close(rounded.value, exact.value, atol=0.1, rtol=0.05)


def test_a_shared_encoder_learns_from_both_heads_and_separate_ones_from_their_own() -> None:
    shared = ActorCritic(NetworkConfig.preset("compact"))
    shared.value(random_observation(2)).sum().backward()
    assert shared.actor_encoder.lidar_convs[0].weight.grad is not None
    separate = ActorCritic(dataclasses.replace(NetworkConfig.preset("compact"), shared_encoder=False))
    separate.value(random_observation(2)).sum().backward()
    assert separate.actor_encoder.lidar_convs[0].weight.grad is None
    assert separate.critic_encoder is not None and separate.critic_encoder.lidar_convs[0].weight.grad is not None


def test_a_configuration_survives_json() -> None:
    for config in PRESETS.values():
        assert from_json(NetworkConfig, to_json(config)) == config
    with pytest.raises(ValueError, match="NetworkConfig has no field 'depth'"):
        from_json(NetworkConfig, '{"depth": 3}')


def test_settings_that_do_not_fit_are_named() -> None:
    compact = NetworkConfig.preset("compact")
    with pytest.raises(ValueError, match=r"ConvConfig.kernel is \(8,\), expected a divisor of the input size \(500,\)"):
        dataclasses.replace(compact, num_rays=500)
    with pytest.raises(ValueError, match="unknown network 'tiny', expected one of: paper, compact, long2018, teacher"):
        NetworkConfig.preset("tiny")
    with pytest.raises(ValueError, match=r"ConvConfig.kernel is \(4,\)"):
        ConvConfig(8, (4,), (2,))
