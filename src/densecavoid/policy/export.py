"""Weights in their two forms: safetensors to train on, ONNX to run. Needs torch; running ONNX does not (`runtime`)."""

from __future__ import annotations

import copy
import dataclasses
import hashlib
import json
from pathlib import Path
from typing import Any

import torch
from torch import Tensor, nn

from densecavoid.frames import COMMAND_GRID
from densecavoid.networks.config_json import from_dict
from densecavoid.networks.torch_files import build, read_tensors, save_tensors, to_onnx, write_onnx
from densecavoid.policy.card import PolicyCard
from densecavoid.policy.distribution import GridChoice
from densecavoid.policy.network import ActorCritic, NetworkConfig, ObservationTensors


def describe(
    network: ActorCritic,
    name: str,
    sensors: str = "densecavoid",
    observation: dict[str, Any] | None = None,
    training: dict[str, Any] | None = None,
) -> PolicyCard:
    """The card of a network's present weights; the arguments are fields of `PolicyCard`."""
    log_std = None
    if network.log_std is not None:
        linear, angular = network.log_std.detach().cpu().tolist()
        log_std = linear, angular
    return PolicyCard(
        name=name,
        sensors=sensors,
        network=_json_form(dataclasses.asdict(network.config)),
        observation=_json_form(observation or {}),
        log_std=log_std,
        max_linear_velocity=network.config.max_linear_velocity,
        max_angular_velocity=network.config.max_angular_velocity,
        weights_sha256=weights_sha256(network),
        training=_json_form(training or {}),
    )


def _json_form(values: dict[str, Any]) -> dict[str, Any]:
    """As it will be read back (lists for tuples), so that a card equals the one in its file."""
    return json.loads(json.dumps(values))


def weights_sha256(network: nn.Module) -> str:
    """Hash of all tensors (name, shape, bytes), in the order of their names."""
    digest = hashlib.sha256()
    for name, tensor in sorted(network.state_dict().items()):
        array = tensor.detach().cpu().contiguous().numpy()
        digest.update(f"{name} {array.dtype} {array.shape}\n".encode())
        digest.update(array.tobytes())
    return digest.hexdigest()


def save_safetensors(path: Path, network: ActorCritic, card: PolicyCard) -> None:
    """Writes all weights, the critic's too, with the card."""
    save_tensors(path, network, card.to_metadata())


def load_safetensors(path: Path) -> tuple[ActorCritic, PolicyCard]:
    """The network and card written by `save_safetensors`.

    Raises:
        FileNotFoundError: if there is no such file.
        ValueError: if it is not such a file, or its tensors do not fit its own configuration.
    """
    tensors, metadata = read_tensors(path)
    card = PolicyCard.from_metadata(metadata, str(path))
    config = from_dict(NetworkConfig, card.network)
    return build(lambda: ActorCritic(config), tensors, path), card


class _Command(nn.Module):
    """The part of the network that a robot runs, with one argument an input, as the exporter wants it."""

    def __init__(self, network: ActorCritic) -> None:
        super().__init__()
        self.network = network

    def forward(
        self,
        lidar: Tensor,
        camera: Tensor,
        goal: Tensor,
        velocity: Tensor,
        prediction: Tensor,
        worth: Tensor | None = None,
    ) -> Tensor | tuple[Tensor, Tensor]:
        worth = goal.new_zeros(0) if worth is None else worth
        policy = self.network.policy(ObservationTensors(lidar, camera, goal, velocity, prediction, worth))
        return (policy.mode, policy.log_probs) if isinstance(policy, GridChoice) else policy.mode


def export_onnx(path: Path, network: ActorCritic, card: PolicyCard) -> None:
    """Writes one graph: the arrays of an observation, any batch size, to `mean` [B, 2] (v m/s, w rad/s). What commands
    are worth is among them where the network looks at it. Where it chooses among them, `mean` is the likeliest, and
    there are the logarithms of their probabilities too, `log_probs` [B, 25].

    The branches are exported in float32 and as convolutions, whatever they were trained as.
    """
    module = _Command(copy.deepcopy(network).cpu().eval())
    module.network.set_compute_dtype(torch.float32)
    module.network.set_patch_products(False)
    example = _example_observation(network.config, batch=2)._asdict()
    if network.config.worth_features == 0:
        del example["worth"]
    outputs = ["mean", "log_probs"] if network.config.chooses else ["mean"]
    write_onnx(path, to_onnx(module, tuple(example.values()), tuple(example), outputs), card.to_metadata())


def _example_observation(config: NetworkConfig, batch: int) -> ObservationTensors:
    height, width = config.image_size
    ranges, image = torch.ones(batch, config.num_scans, config.num_rays), torch.zeros(batch, height, width).byte()
    worth = torch.zeros(batch, len(COMMAND_GRID))
    return ObservationTensors(ranges, image, torch.zeros(batch, 2), torch.zeros(batch, 2), image.clone(), worth)
