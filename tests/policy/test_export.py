"""Promises of the exported forms: they compute what torch computes, and say what they are."""

from __future__ import annotations

import dataclasses
import hashlib
from pathlib import Path

import numpy as np
import pytest

torch = pytest.importorskip("torch")

import onnx  # noqa: E402

from densecavoid.frames import NUM_SCANS, Observation  # noqa: E402
from densecavoid.policy.export import describe, export_onnx, load_safetensors, save_safetensors  # noqa: E402
from densecavoid.policy.network import ActorCritic, NetworkConfig, ObservationTensors  # noqa: E402
from densecavoid.policy.runtime import POLICIES, OnnxPolicy  # noqa: E402


def random_observation(batch: int, scans: int = NUM_SCANS) -> Observation:
    rng = np.random.default_rng(batch)
    return Observation(
        rng.random((batch, scans, 512), dtype=np.float32),
        rng.integers(0, 256, (batch, 60, 80), dtype=np.uint8),
        rng.uniform([0, -3], [30, 3], (batch, 2)).astype(np.float32),
        rng.uniform([0, -0.4], [1, 0.4], (batch, 2)).astype(np.float32),
        rng.integers(0, 256, (batch, 60, 80), dtype=np.uint8),
        rng.uniform(-0.5, 1, (batch, 25)).astype(np.float32),
    )


@pytest.fixture(scope="module", params=["compact", "paper", "long2018", "weighing", "choosing"])
def exported(request: pytest.FixtureRequest, tmp_path_factory: pytest.TempPathFactory) -> tuple[ActorCritic, Path]:
    torch.manual_seed(0)
    weighs, chooses = request.param in ("weighing", "choosing"), request.param == "choosing"
    config = NetworkConfig.preset("compact" if weighs else request.param)
    network = ActorCritic(dataclasses.replace(config, worth_features=64 if weighs else 0, chooses=chooses))
    torch.nn.init.orthogonal_(network.actor_output.weight, gain=2.0)
    path = tmp_path_factory.mktemp("export") / f"{request.param}.onnx"
    export_onnx(path, network, describe(network, request.param, observation={"horizon_s": 0.4}, training={"steps": 3}))
    return network, path


@pytest.mark.parametrize("batch", [1, 7])
def test_onnx_agrees_with_torch(exported: tuple[ActorCritic, Path], batch: int) -> None:
    network, path = exported
    observation = random_observation(batch)
    mean = OnnxPolicy(path)(observation)
    with torch.no_grad():
        expected = network.command(ObservationTensors(*map(torch.from_numpy, observation))).numpy()
    assert mean.dtype == np.float32 and mean.shape == (batch, 2)
    assert np.abs(expected - [0.5, 0.0]).max() > 0.05, "the test needs commands unlike a blank network's"
    np.testing.assert_allclose(mean, expected, atol=1e-4, rtol=0)


def test_the_file_says_what_it_is(exported: tuple[ActorCritic, Path]) -> None:
    network, path = exported
    policy = OnnxPolicy(path)
    assert policy.sha256 == hashlib.sha256(path.read_bytes()).hexdigest()
    card = policy.card
    assert card == describe(network, path.stem, observation={"horizon_s": 0.4}, training={"steps": 3})
    if network.config.chooses:
        assert card.log_std is None
    else:
        assert card.log_std is not None and np.exp(card.log_std) == pytest.approx([0.4, 0.3])
    assert (card.max_linear_velocity, card.max_angular_velocity) == (1.0, 0.4)


def test_the_graph_is_clean(exported: tuple[ActorCritic, Path]) -> None:
    """One file, standard operators, no path of the machine that made it."""
    _, path = exported
    model = onnx.load(path, load_external_data=False)
    assert {node.domain for node in model.graph.node} == {""}
    assert len(model.functions) == 0
    assert all(tensor.data_location == onnx.TensorProto.DEFAULT for tensor in model.graph.initializer)
    assert b".py" not in path.read_bytes()
    assert [entry.name for entry in path.parent.iterdir()] == [path.name]


def test_exporting_leaves_the_network_as_it_was(tmp_path: Path) -> None:
    network = ActorCritic(NetworkConfig.preset("compact"))
    network.set_compute_dtype(torch.bfloat16)
    export_onnx(tmp_path / "a.onnx", network, describe(network, "a"))
    assert network.actor_encoder.compute_dtype == torch.bfloat16 and network.actor_encoder.patch_products


def test_safetensors_bring_back_weights_and_card(tmp_path: Path) -> None:
    network = ActorCritic(NetworkConfig.preset("compact"))
    path = tmp_path / "p.safetensors"
    card = describe(network, "p", sensors="depth-lidar")
    save_safetensors(path, network, card)
    again, card_again = load_safetensors(path)
    assert card_again == card
    for name, tensor in network.state_dict().items():
        assert torch.equal(tensor, again.state_dict()[name])
    assert describe(again, "p").weights_sha256 == card.weights_sha256
    with torch.no_grad():
        again.actor_output.bias.add_(1e-6)
    assert describe(again, "p").weights_sha256 != card.weights_sha256


def test_wrong_inputs_and_files_are_named(exported: tuple[ActorCritic, Path], tmp_path: Path) -> None:
    _, path = exported
    observation = random_observation(2)
    policy = OnnxPolicy(path)
    with pytest.raises(ValueError, match=r"observation.goal has shape \(1, 2\), expected \(2, 2\)"):
        policy(observation._replace(goal=observation.goal[:1]))
    with pytest.raises(ValueError, match=r"observation.lidar has shape \(2, 3, 100\), expected \(2, 3, 512\)"):
        policy(observation._replace(lidar=observation.lidar[:, :, :100].copy()))
    if policy.card.network["worth_features"] > 0:
        with pytest.raises(ValueError, match=r"observation.worth has shape \(2, 24\), expected \(2, 25\)"):
            policy(observation._replace(worth=observation.worth[:, :24]))
    with pytest.raises(FileNotFoundError, match="no policy 'nobody': not a file"):
        OnnxPolicy("nobody")
    (tmp_path / "broken.onnx").write_bytes(b"not a graph")
    with pytest.raises(ValueError, match=r"broken.onnx is not an ONNX file"):
        OnnxPolicy(tmp_path / "broken.onnx")
    model = onnx.load(path)
    del model.metadata_props[:]
    onnx.save(model, tmp_path / "anonymous.onnx")
    with pytest.raises(ValueError, match="is not a policy of this project"):
        OnnxPolicy(tmp_path / "anonymous.onnx")
    (tmp_path / "broken.safetensors").write_bytes(b"12345678")
    with pytest.raises(ValueError, match="is not a safetensors file"):
        load_safetensors(tmp_path / "broken.safetensors")


def test_weights_that_do_not_fit_their_description_are_refused(tmp_path: Path) -> None:
    network = ActorCritic(NetworkConfig.preset("compact"))
    card = describe(network, "p")
    card = dataclasses.replace(card, network=card.network | {"head_features": 64})
    save_safetensors(tmp_path / "p.safetensors", network, card)
    with pytest.raises(ValueError, match="do not fit the network"):
        load_safetensors(tmp_path / "p.safetensors")


@pytest.mark.parametrize("name", POLICIES.names())
def test_each_shipped_policy_loads_by_name_and_drives_within_limits(name: str) -> None:
    policy = OnnxPolicy(name)
    mean = policy(random_observation(3, policy.card.network["num_scans"]))
    assert np.all((mean[:, 0] >= 0) & (mean[:, 0] <= 1.0)) and np.all(np.abs(mean[:, 1]) <= 0.4)


@pytest.mark.parametrize("name", POLICIES.names())
def test_each_shipped_policy_is_the_same_in_both_its_forms(name: str) -> None:
    from importlib import resources

    policy = OnnxPolicy(name)
    with resources.as_file(resources.files("densecavoid.policy") / "weights" / f"{name}.safetensors") as path:
        network, card = load_safetensors(path)
    assert card == policy.card
    observation = random_observation(7, network.config.num_scans)
    with torch.no_grad():
        expected = network.command(ObservationTensors(*map(torch.from_numpy, observation))).numpy()
    np.testing.assert_allclose(policy(observation), expected, atol=1e-4, rtol=0)
