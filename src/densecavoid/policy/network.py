"""The four-branch network of the paper (Fig. 3) and a compact one of the same plan, as torch modules. Neither sampling
nor losses: those are in `distribution` and `densecavoid.learning`.

Inputs are the arrays of `frames.Observation` as they are stored (uint8 images), so that what crosses memory stays
small; scaling to order one happens inside and therefore also inside every exported file:

- camera / 255 (nearness), (255 - prediction) / 255 (a person is 1, an empty frame is all 0),
- goal distance / 5 m, at most 2 (10 m: farther than anything is seen); goal bearing in radians as it is,
- velocities as fractions of the robot's limits,
- what commands are worth as it is, and as exp(-loss / scale) of the loss against the best on several scales.
"""

from __future__ import annotations

import itertools
import math
from collections.abc import Sequence
from typing import NamedTuple, cast

import torch
from jaxtyping import Float, Float32, UInt8
from torch import Tensor, nn
from torch.nn import functional

from densecavoid.frames import PERSON_NUMBERS, require
from densecavoid.policy.moments import RunningMoments
from densecavoid.policy.network_config import (
    PRESETS,
    WORTH_SCALES,
    ConvConfig,
    NetworkConfig,
    count_mflop,
)

__all__ = [
    "PRESETS",
    "ActorCritic",
    "ConvConfig",
    "Encoder",
    "NetworkConfig",
    "ObservationTensors",
    "PolicyOutput",
    "count_mflop",
    "count_parameters",
    "preferred_dtype",
]

_GOAL_DISTANCE_SCALE_M = 5.0
_GOAL_DISTANCE_LIMIT = 2.0
_PEOPLE_SCALE_M = 5.0
# A window of four uint8 pixels is one 32-bit word: moving words instead of pixels makes cutting an image into patches
# 20 times faster than a permutation of bytes.
_WORD_OF_WIDTH = {1: torch.uint8, 2: torch.int16, 4: torch.int32, 8: torch.int64}


class ObservationTensors(NamedTuple):
    """`frames.Observation` as tensors of the same shapes and types."""

    lidar: Float[Tensor, "B scans rays"]
    """Stored as float16 in training, to halve what crosses memory."""
    camera: UInt8[Tensor, "B height width"]
    goal: Float32[Tensor, "B 2"]
    velocity: Float32[Tensor, "B 2"]
    prediction: UInt8[Tensor, "B height width"]
    worth: Float32[Tensor, "B commands"]


class PolicyOutput(NamedTuple):
    """What one pass gives."""

    mean: Float32[Tensor, "B 2"]
    """Mean command (v m/s, w rad/s)."""
    value: Float32[Tensor, "B"]
    """Expected return, in units of the scaled reward."""


class Encoder(nn.Module):
    """The four branches, joined: observation -> features [B, num_features].

    Convolutions whose windows do not overlap run as matrix products on channels-last data, which halves the time of an
    update on a CPU; `patch_products = False` runs the same weights as convolutions, for export.
    """

    def __init__(self, config: NetworkConfig) -> None:
        super().__init__()
        lidar_sizes, camera_sizes = config.branch_sizes()
        self.lidar_convs = _convolutions(nn.Conv1d, config.num_scans, config.lidar_layers)
        self.camera_convs = _convolutions(nn.Conv2d, 2, config.camera_layers)
        self.lidar_linears = _linears(
            config.lidar_layers[-1].filters * math.prod(lidar_sizes[-1]), config.lidar_features
        )
        camera_places = config.camera_layers[-1].filters * math.prod(camera_sizes[-1]) if config.camera_layers else 0
        self.camera_linears = _linears(camera_places, config.camera_features)
        self.sees_camera = len(config.camera_layers) > 0
        self.worth_linear = _linears(config.num_worth_inputs, (config.worth_features,) if config.worth_features else ())
        features = [*config.lidar_features[-1:], *config.camera_features[-1:], config.worth_features]
        self.num_features = sum(features) + config.num_state_features
        self.patch_products = True
        self.compute_dtype = torch.float32
        self._lidar_is_patches = all(layer.is_patch for layer in config.lidar_layers)
        self._camera_is_patches = (
            self.sees_camera
            and all(layer.is_patch for layer in config.camera_layers)
            and config.camera_layers[0].kernel[1] in _WORD_OF_WIDTH
        )

    def forward(
        self,
        observation: ObservationTensors,
        ranges: Float32[Tensor, "B scans rays"],
        state: Float32[Tensor, "B state"],
    ) -> Float32[Tensor, "B features"]:
        """The images of the observation, with ranges and state as `ActorCritic.numbers` prepared them."""
        branches = [self._lidar(ranges).float()]
        if self.sees_camera:
            branches.append(self._camera(observation.camera, observation.prediction).float())
        if len(self.worth_linear) > 0:
            branches.append(self._worth(observation.worth))
        return torch.cat([*branches, state], dim=1)

    def _worth(self, worth: Tensor) -> Tensor:
        behind = worth - worth.amax(dim=1, keepdim=True)
        return _feed(torch.cat([worth, *((behind / scale).exp() for scale in WORTH_SCALES)], dim=1), self.worth_linear)

    def _lidar(self, ranges: Tensor) -> Tensor:
        x = ranges.to(self.compute_dtype)
        convs = cast(list[nn.Conv1d], list(self.lidar_convs))
        if not (self.patch_products and self._lidar_is_patches):
            for conv in convs:
                x = _convolve(x, conv)
            x = x.transpose(1, 2)
        else:
            B, channels, rays = x.shape
            for depth, conv in enumerate(convs):
                window = conv.weight.shape[2]
                if depth == 0:
                    x = x.view(B, channels, rays // window, window).transpose(1, 2).reshape(B, rays // window, -1)
                    weight = conv.weight.flatten(1)
                else:
                    x = x.view(B, x.shape[1] // window, -1)
                    weight = conv.weight.transpose(1, 2).flatten(1)
                x = _product(x, weight, conv.bias)
        return _feed(x.flatten(1), self.lidar_linears)

    def _camera(self, camera: Tensor, prediction: Tensor) -> Tensor:
        convs = cast(list[nn.Conv2d], list(self.camera_convs))
        if not (self.patch_products and self._camera_is_patches):
            x = torch.stack([camera.to(self.compute_dtype), 255.0 - prediction.to(self.compute_dtype)], dim=1) / 255.0
            for conv in convs:
                x = _convolve(x, conv)
            x = x.permute(0, 2, 3, 1)
        else:
            first, *others = convs
            # The first layer's windows in the order in which the second layer gathers them: it then finds its own side
            # by side. To sort bytes here is cheaper than to sort floats there, forward and backward.
            gathered = (others[0].weight.shape[2], others[0].weight.shape[3]) if others else (1, 1)
            x = _image_patches(camera, prediction, (first.weight.shape[2], first.weight.shape[3]), gathered)
            # 0..255 is exact even in bfloat16; the scale goes into the weights, which are far fewer than the pixels.
            x = _product(x.to(self.compute_dtype), first.weight.flatten(1) / 255.0, first.bias)
            for depth, conv in enumerate(others):
                kh, kw = conv.weight.shape[2:]
                if depth > 0:
                    B, height, width, channels = x.shape
                    x = x.view(B, height // kh, kh, width // kw, kw, channels).transpose(2, 3)
                x = x.reshape(*x.shape[:3], -1)
                x = _product(x, conv.weight.permute(0, 2, 3, 1).flatten(1), conv.bias)
        return _feed(x.flatten(1), self.camera_linears)


class PeopleEncoder(nn.Module):
    """Features of the true people around, whatever their order and number: two layers a person, then the greatest."""

    def __init__(self, config: NetworkConfig) -> None:
        super().__init__()
        self.layers = _linears(PERSON_NUMBERS, (config.people_features, config.people_features))
        scale = torch.tensor([1 / _PEOPLE_SCALE_M, 1 / _PEOPLE_SCALE_M, 1.0, 1.0, 1.0, 1.0])
        self.register_buffer("scale", scale, persistent=False)
        self.scale: Tensor

    def forward(self, people: Float32[Tensor, "B K numbers"]) -> Float32[Tensor, "B features"]:
        # Features are not negative: nobody (all zeros) cannot be the greatest.
        return (_feed(people * self.scale, self.layers) * people[..., -1:]).amax(dim=1)


class ActorCritic(nn.Module):
    """The policy's mean, its state-independent standard deviation, and the critic."""

    def __init__(self, config: NetworkConfig) -> None:
        super().__init__()
        self.config = config
        self.actor_encoder = Encoder(config)
        self.critic_encoder = None if config.shared_encoder else Encoder(config)
        self.people_encoder = PeopleEncoder(config) if config.privileged else None
        features, told = self.actor_encoder.num_features, config.people_features
        self.actor_hidden = _linears(features + (told if config.people == "actor" else 0), (config.head_features,))
        self.critic_hidden = _linears(features + (told if config.privileged else 0), (config.head_features,))
        self.actor_output = nn.Linear(config.head_features, 2)
        self.critic_output = nn.Linear(config.head_features, 1)
        self.log_std = nn.Parameter(torch.tensor(config.initial_std).log())
        self.range_moments = RunningMoments(config.num_rays) if config.normalise_inputs else None
        self.state_moments = RunningMoments(config.num_state_features) if config.normalise_inputs else None
        self.value_moments = RunningMoments(1) if config.normalise_values else None
        self.register_buffer("min_log_std", torch.tensor(config.min_std).log(), persistent=False)
        self.min_log_std: Tensor
        self.register_buffer(
            "limits", torch.tensor([config.max_linear_velocity, config.max_angular_velocity]), persistent=False
        )
        self.limits: Tensor
        for module in self.modules():
            if isinstance(module, nn.Conv1d | nn.Conv2d | nn.Linear):
                nn.init.orthogonal_(module.weight, math.sqrt(2.0))
                nn.init.zeros_(module.bias)  # type: ignore[arg-type]
        # A small last layer makes the first policy the same everywhere, so that no input is favoured by chance.
        nn.init.orthogonal_(self.actor_output.weight, 0.01)
        nn.init.orthogonal_(self.critic_output.weight, 1.0)

    def forward(
        self, observation: ObservationTensors, people: Float32[Tensor, "B K numbers"] | None = None
    ) -> PolicyOutput:
        """Mean command and value, in one pass of the encoder where it is shared.

        Args:
            observation: what the sensors give.
            people: the true people, where the configuration is privileged.
        """
        ranges, state = self.numbers(observation)
        told = self._told(people)
        features = self.actor_encoder(observation, ranges, state)
        critic_features = features if self.critic_encoder is None else self.critic_encoder(observation, ranges, state)
        return PolicyOutput(self._mean(features, told), self._value(critic_features, told))

    def mean(
        self, observation: ObservationTensors, people: Float32[Tensor, "B K numbers"] | None = None
    ) -> Float32[Tensor, "B 2"]:
        """Mean command (v m/s, w rad/s) alone: what a robot runs."""
        told = self._told(people) if self.config.people == "actor" else None
        return self._mean(self.actor_encoder(observation, *self.numbers(observation)), told)

    def value(
        self, observation: ObservationTensors, people: Float32[Tensor, "B K numbers"] | None = None
    ) -> Float32[Tensor, "B"]:
        """The critic alone."""
        encoder = self.critic_encoder or self.actor_encoder
        return self._value(encoder(observation, *self.numbers(observation)), self._told(people))

    def numbers(
        self, observation: ObservationTensors
    ) -> tuple[Float32[Tensor, "B scans rays"], Float32[Tensor, "B state"]]:
        """Ranges, and goal and velocity, scaled to order one and normalised where the configuration says so."""
        ranges, state = self.raw_numbers(observation)
        if self.range_moments is not None and self.state_moments is not None:
            ranges, state = self.range_moments.normalise(ranges), self.state_moments.normalise(state)
        return ranges, self.config.state_gain * state

    def raw_numbers(
        self, observation: ObservationTensors
    ) -> tuple[Float32[Tensor, "B scans rays"], Float32[Tensor, "B state"]]:
        """What the running moments of the inputs are taken of."""
        lidar, falloff = observation.lidar.float(), self.config.lidar_falloff
        ranges = torch.exp(-falloff * lidar) if falloff > 0 else lidar
        distance = (observation.goal[:, :1] / _GOAL_DISTANCE_SCALE_M).clamp(max=_GOAL_DISTANCE_LIMIT)
        bearing = observation.goal[:, 1:]
        direction = (bearing.cos(), bearing.sin()) if self.config.goal_direction else (bearing,)
        return ranges, torch.cat([distance, *direction, observation.velocity / self.limits], dim=1)

    def _told(self, people: Tensor | None) -> Tensor | None:
        if self.people_encoder is None:
            return None
        require(people is not None, "people", None, f"the true people, for people={self.config.people!r}")
        return self.people_encoder(people)

    def _mean(self, features: Tensor, told: Tensor | None) -> Tensor:
        if told is not None and self.config.people == "actor":
            features = torch.cat([features, told], dim=1)
        raw = self.actor_output(_feed(features, self.actor_hidden))
        linear = self.config.max_linear_velocity * torch.sigmoid(raw[:, :1])
        angular = self.config.max_angular_velocity * torch.tanh(raw[:, 1:])
        return torch.cat([linear, angular], dim=1)

    def _value(self, features: Tensor, told: Tensor | None) -> Tensor:
        if told is not None:
            features = torch.cat([features, told], dim=1)
        value = self.critic_output(_feed(features, self.critic_hidden)).squeeze(1)
        if self.value_moments is not None:
            value = self.value_moments.restore(value)
        return value

    def follow_returns(self, count: Tensor, mean: Tensor, variance: Tensor) -> None:
        """Takes the moments of new returns (each [1], over all processes) into those of the critic, whose last layer is
        rescaled so that it goes on giving the same values (van Hasselt et al. 2016, Pop-Art).
        """
        moments = self.value_moments
        if moments is None:
            return
        old_mean, old_std = moments.mean.clone(), moments.std.clone()
        moments.merge(count, mean, variance)
        with torch.no_grad():
            self.critic_output.weight.mul_(old_std / moments.std)
            self.critic_output.bias.mul_(old_std).add_(old_mean - moments.mean).div_(moments.std)

    def set_std(self, std: tuple[float, float]) -> None:
        """The policy's standard deviations (m/s, rad/s), as they are from now on."""
        with torch.no_grad():
            self.log_std.copy_(torch.tensor(std).log())

    def raise_std_to_floor(self) -> None:
        """Call after each optimiser step. A clamp in the forward pass would cut the gradient that could raise it."""
        with torch.no_grad():
            self.log_std.copy_(torch.maximum(self.log_std, self.min_log_std))

    def set_compute_dtype(self, dtype: torch.dtype) -> None:
        """Precision of the branches' arithmetic (weights, heads and losses stay float32)."""
        for encoder in self.encoders:
            encoder.compute_dtype = dtype

    def set_patch_products(self, enabled: bool) -> None:
        """See `Encoder`."""
        for encoder in self.encoders:
            encoder.patch_products = enabled

    @property
    def encoders(self) -> list[Encoder]:
        return [self.actor_encoder] if self.critic_encoder is None else [self.actor_encoder, self.critic_encoder]


def count_parameters(config: NetworkConfig) -> int:
    """Weights and biases of what the robot runs: branches, head and mean (no critic)."""
    with torch.device("meta"):
        network = ActorCritic(config)
    actor = [network.actor_encoder, network.actor_hidden, network.actor_output]
    if config.people == "actor" and network.people_encoder is not None:
        actor.append(network.people_encoder)
    return sum(parameter.numel() for module in actor for parameter in module.parameters())


def preferred_dtype(device: torch.device) -> torch.dtype:
    """bfloat16 where the processor multiplies it natively (AVX-512 BF16, AMX, CUDA), float32 elsewhere."""
    if device.type == "cuda":
        return torch.bfloat16 if torch.cuda.is_bf16_supported() else torch.float32
    return torch.bfloat16 if torch.cpu.get_capabilities().get("avx512_bf16", False) else torch.float32


def _convolutions(kind: type[nn.Conv1d | nn.Conv2d], channels: int, layers: Sequence[ConvConfig]) -> nn.ModuleList:
    inputs = [channels, *(layer.filters for layer in layers)]
    return nn.ModuleList(
        kind(inputs[i], layer.filters, layer.kernel, layer.stride, layer.padding)  # type: ignore[arg-type]
        for i, layer in enumerate(layers)
    )


def _linears(inputs: int, outputs: Sequence[int]) -> nn.ModuleList:
    sizes = [inputs, *outputs]
    return nn.ModuleList(nn.Linear(before, after) for before, after in itertools.pairwise(sizes))


def _convolve(x: Tensor, conv: nn.Conv1d | nn.Conv2d) -> Tensor:
    assert conv.bias is not None
    function = functional.conv1d if isinstance(conv, nn.Conv1d) else functional.conv2d
    return function(x, conv.weight.to(x.dtype), conv.bias.to(x.dtype), conv.stride, conv.padding).relu()  # type: ignore[arg-type]


def _product(x: Tensor, weight: Tensor, bias: Tensor | None) -> Tensor:
    assert bias is not None
    # On rows of one axis: of more axes the product is a view, and a ReLU in place of a view costs the way back four
    # passes over the memory.
    rows = functional.linear(x.flatten(0, -2), weight.to(x.dtype), bias.to(x.dtype)).relu_()
    return rows.view(*x.shape[:-1], -1)


def _feed(x: Tensor, layers: nn.ModuleList) -> Tensor:
    for layer in cast(list[nn.Linear], list(layers)):
        x = _product(x, layer.weight, layer.bias)
    return x


def _image_patches(
    camera: UInt8[Tensor, "B height width"],
    prediction: UInt8[Tensor, "B height width"],
    window: tuple[int, int],
    gathered: tuple[int, int],
) -> UInt8[Tensor, "B rows columns inner pixels"]:
    """Both images cut into windows; pixels in the order (channel, row, column) of a convolution's weights. The
    prediction is inverted (all bits flipped: 255 - x).

    Args:
        camera, prediction: images.
        window: height and width of a window, pixels.
        gathered: rows and columns of windows that make one place of the result; they follow each other along `inner`.
    """
    kh, kw = window
    gh, gw = gathered
    word = _WORD_OF_WIDTH[kw]
    B, height, width = camera.shape
    rows, columns = height // (kh * gh), width // (kw * gw)
    patches = torch.empty(B, rows, columns, gh, gw, 2, kh, dtype=word, device=camera.device)
    for channel, image in enumerate((camera, prediction)):
        words = image.contiguous().view(word).view(B, rows, gh, kh, columns, gw).permute(0, 1, 4, 2, 5, 3)
        patches[..., channel, :] = words if channel == 0 else ~words
    return patches.view(B, rows, columns, gh * gw, 2 * kh).view(torch.uint8)
