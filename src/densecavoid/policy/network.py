"""The four-branch network of the paper (Fig. 3) and a compact one of the same plan, as torch modules. Neither sampling
nor losses: those are in `distribution` and `densecavoid.learning`.

Inputs are the arrays of `frames.Observation` as they are stored (uint8 images), so that what crosses memory stays
small; scaling to order one happens inside and therefore also inside every exported file:

- camera / 255 (nearness), (255 - prediction) / 255 (a person is 1, an empty frame is all 0),
- goal distance / 5 m, at most 4 (20 m); goal bearing in radians as it is,
- velocities as fractions of the robot's limits.
"""

from __future__ import annotations

import itertools
import math
from collections.abc import Sequence
from dataclasses import dataclass, replace
from typing import NamedTuple, cast

import torch
from jaxtyping import Float32, UInt8
from torch import Tensor, nn
from torch.nn import functional

from densecavoid.frames import choose, require

_GOAL_DISTANCE_SCALE_M = 5.0
_GOAL_DISTANCE_LIMIT = 4.0
_NUM_SCANS = 3
# A window of four uint8 pixels is one 32-bit word: moving words instead of pixels makes cutting an image into patches
# 20 times faster than a permutation of bytes.
_WORD_OF_WIDTH = {1: torch.uint8, 2: torch.int16, 4: torch.int32, 8: torch.int64}


@dataclass(frozen=True)
class ConvConfig:
    """One convolution followed by ReLU. Where kernel and stride are equal the windows do not overlap and there is no
    padding; otherwise it is padded so that the output has ceil(input / stride) places (SAME).
    """

    filters: int
    kernel: tuple[int, ...]
    stride: tuple[int, ...]

    def __post_init__(self) -> None:
        require(self.filters > 0, "ConvConfig.filters", self.filters, "positive")
        require(min(self.kernel + self.stride) > 0, "ConvConfig", (self.kernel, self.stride), "positive sizes")
        require(
            len(self.kernel) == len(self.stride), "ConvConfig.stride", self.stride, "as many sizes as the kernel has"
        )
        require(
            self.is_patch or all(size % 2 == 1 for size in self.kernel),
            "ConvConfig.kernel",
            self.kernel,
            "odd sizes, or sizes equal to the stride",
        )

    @property
    def is_patch(self) -> bool:
        """Whether the windows do not overlap, which makes the convolution one matrix product."""
        return self.kernel == self.stride

    @property
    def padding(self) -> tuple[int, ...]:
        return tuple(0 if self.is_patch else (size - 1) // 2 for size in self.kernel)

    def output_size(self, size: Sequence[int]) -> tuple[int, ...]:
        """Places along each axis after this layer."""
        if self.is_patch:
            for length, window in zip(size, self.kernel, strict=True):
                require(
                    length % window == 0, "ConvConfig.kernel", self.kernel, f"a divisor of the input size {tuple(size)}"
                )
        return tuple(-(-length // stride) for length, stride in zip(size, self.stride, strict=True))


@dataclass(frozen=True)
class NetworkConfig:
    """What the network is made of. `NetworkConfig.preset(name)` gives the named ones."""

    name: str
    lidar_layers: tuple[ConvConfig, ...]
    lidar_features: tuple[int, ...]
    """Sizes of the fully connected layers behind the lidar's convolutions."""
    camera_layers: tuple[ConvConfig, ...]
    camera_features: tuple[int, ...]
    head_features: int
    """Size of the fully connected layer behind the joined branches, one for the actor and one for the critic."""
    goal_direction: bool
    """Whether the goal's bearing is given as cosine and sine, continuous all around, or raw as in the paper."""
    lidar_falloff: float
    """Ranges r (fractions of the greatest) are given as exp(-lidar_falloff r), so that free space is near 0 and what
    is close stands out; with 0 raw, as in the paper."""
    state_gain: float
    """Goal and velocity are multiplied by it, so that these few numbers are heard beside hundreds of features of the
    sensors: with raw ranges, 4 took .1 M steps to the first goals instead of .16 M (three seeds each)."""
    shared_encoder: bool
    """Whether actor and critic read the same branches (one pass) or each has its own."""
    num_rays: int = 512
    image_size: tuple[int, int] = (60, 80)
    """Height and width of depth image and prediction frame, pixels."""
    max_linear_velocity: float = 1.0
    """m/s; the mean lies in (0, max)."""
    max_angular_velocity: float = 0.4
    """rad/s; the mean lies in (-max, max)."""
    initial_std: tuple[float, float] = (0.4, 0.3)
    """Standard deviations of v (m/s) and w (rad/s) before training."""
    min_std: tuple[float, float] = (0.12, 0.12)
    """The floor that training keeps them above (m/s, rad/s): a policy that no longer tries anything once it reaches
    goals in an empty world learns to avoid obstacles several times more slowly."""

    def __post_init__(self) -> None:
        for name in ("num_rays", "head_features", "state_gain", "max_linear_velocity", "max_angular_velocity"):
            require(getattr(self, name) > 0, f"NetworkConfig.{name}", getattr(self, name), "positive")
        for name in ("lidar_layers", "lidar_features", "camera_layers", "camera_features"):
            require(len(getattr(self, name)) > 0, f"NetworkConfig.{name}", getattr(self, name), "at least one layer")
        for initial, floor in zip(self.initial_std, self.min_std, strict=True):
            require(
                0 < floor <= initial, "NetworkConfig.min_std", self.min_std, f"positive, at most {self.initial_std}"
            )
        self.branch_sizes()

    @staticmethod
    def preset(name: str) -> NetworkConfig:
        """`compact` (shared branches, about 1.4 MFLOP a pass) or `paper` (published Fig. 3, 276 MFLOP).

        Raises:
            ValueError: if there is no preset of this name.
        """
        return PRESETS[choose("network", name, tuple(PRESETS))]

    @property
    def num_goal_features(self) -> int:
        """Distance, and the bearing as one number or as two."""
        return 3 if self.goal_direction else 2

    def with_robot(self, max_linear_velocity: float, max_angular_velocity: float) -> NetworkConfig:
        """A copy for a robot with other limits (m/s, rad/s)."""
        return replace(self, max_linear_velocity=max_linear_velocity, max_angular_velocity=max_angular_velocity)

    def branch_sizes(self) -> tuple[list[tuple[int, ...]], list[tuple[int, ...]]]:
        """Places along each axis after every convolution: lidar [(places,)], camera [(rows, columns)]."""
        lidar: list[tuple[int, ...]] = [(self.num_rays,)]
        for layer in self.lidar_layers:
            lidar.append(layer.output_size(lidar[-1]))
        camera: list[tuple[int, ...]] = [self.image_size]
        for layer in self.camera_layers:
            camera.append(layer.output_size(camera[-1]))
        return lidar[1:], camera[1:]


PRESETS = {
    "paper": NetworkConfig(
        name="paper",
        lidar_layers=(ConvConfig(32, (5,), (2,)), ConvConfig(16, (3,), (2,))),
        lidar_features=(256,),
        camera_layers=(ConvConfig(64, (5, 5), (2, 2)), ConvConfig(64, (5, 5), (1, 1)), ConvConfig(32, (3, 3), (2, 2))),
        camera_features=(512, 256),
        head_features=128,
        goal_direction=False,
        lidar_falloff=0.0,
        state_gain=1.0,
        shared_encoder=False,
    ),
    "compact": NetworkConfig(
        name="compact",
        lidar_layers=(ConvConfig(32, (8,), (8,)), ConvConfig(32, (2,), (2,))),
        lidar_features=(128,),
        camera_layers=(ConvConfig(16, (4, 4), (4, 4)), ConvConfig(32, (3, 4), (3, 4))),
        camera_features=(128,),
        head_features=128,
        goal_direction=True,
        lidar_falloff=4.0,
        state_gain=2.0,
        shared_encoder=True,
    ),
}


class ObservationTensors(NamedTuple):
    """`frames.Observation` as tensors of the same shapes and types."""

    lidar: Float32[Tensor, "B 3 rays"]
    camera: UInt8[Tensor, "B height width"]
    goal: Float32[Tensor, "B 2"]
    velocity: Float32[Tensor, "B 2"]
    prediction: UInt8[Tensor, "B height width"]


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
        self.lidar_convs = _convolutions(nn.Conv1d, _NUM_SCANS, config.lidar_layers)
        self.camera_convs = _convolutions(nn.Conv2d, 2, config.camera_layers)
        self.lidar_linears = _linears(
            config.lidar_layers[-1].filters * math.prod(lidar_sizes[-1]), config.lidar_features
        )
        self.camera_linears = _linears(
            config.camera_layers[-1].filters * math.prod(camera_sizes[-1]), config.camera_features
        )
        self.goal_direction = config.goal_direction
        self.lidar_falloff = config.lidar_falloff
        self.state_gain = config.state_gain
        self.num_features = config.lidar_features[-1] + config.camera_features[-1] + config.num_goal_features + 2
        self.patch_products = True
        self.compute_dtype = torch.float32
        self._lidar_is_patches = all(layer.is_patch for layer in config.lidar_layers)
        self._camera_is_patches = (
            all(layer.is_patch for layer in config.camera_layers)
            and config.camera_layers[0].kernel[1] in _WORD_OF_WIDTH
        )
        self.register_buffer(
            "limits", torch.tensor([config.max_linear_velocity, config.max_angular_velocity]), persistent=False
        )
        self.limits: Tensor

    def forward(self, observation: ObservationTensors) -> Float32[Tensor, "B features"]:
        lidar = self._lidar(observation.lidar)
        camera = self._camera(observation.camera, observation.prediction)
        distance = (observation.goal[:, :1] / _GOAL_DISTANCE_SCALE_M).clamp(max=_GOAL_DISTANCE_LIMIT)
        velocity = observation.velocity / self.limits
        bearing = observation.goal[:, 1:]
        direction = (bearing.cos(), bearing.sin()) if self.goal_direction else (bearing,)
        state = self.state_gain * torch.cat([distance, *direction, velocity], dim=1)
        return torch.cat([lidar.float(), camera.float(), state], dim=1)

    def _lidar(self, lidar: Tensor) -> Tensor:
        seen = torch.exp(-self.lidar_falloff * lidar) if self.lidar_falloff > 0 else lidar
        x = seen.to(self.compute_dtype)
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
            x = _image_patches(camera, prediction, (first.weight.shape[2], first.weight.shape[3]))
            # 0..255 is exact even in bfloat16; the scale goes into the weights, which are far fewer than the pixels.
            x = _product(x.to(self.compute_dtype), first.weight.flatten(1) / 255.0, first.bias)
            for conv in others:
                B, height, width, channels = x.shape
                kh, kw = conv.weight.shape[2:]
                x = x.view(B, height // kh, kh, width // kw, kw, channels).transpose(2, 3)
                x = x.reshape(B, height // kh, width // kw, kh * kw * channels)
                x = _product(x, conv.weight.permute(0, 2, 3, 1).flatten(1), conv.bias)
        return _feed(x.flatten(1), self.camera_linears)


class ActorCritic(nn.Module):
    """The policy's mean, its state-independent standard deviation, and the critic."""

    def __init__(self, config: NetworkConfig) -> None:
        super().__init__()
        self.config = config
        self.actor_encoder = Encoder(config)
        self.critic_encoder = None if config.shared_encoder else Encoder(config)
        features = self.actor_encoder.num_features
        self.actor_hidden = _linears(features, (config.head_features,))
        self.critic_hidden = _linears(features, (config.head_features,))
        self.actor_output = nn.Linear(config.head_features, 2)
        self.critic_output = nn.Linear(config.head_features, 1)
        self.log_std = nn.Parameter(torch.tensor(config.initial_std).log())
        self.register_buffer("min_log_std", torch.tensor(config.min_std).log(), persistent=False)
        self.min_log_std: Tensor
        for module in self.modules():
            if isinstance(module, nn.Conv1d | nn.Conv2d | nn.Linear):
                nn.init.orthogonal_(module.weight, math.sqrt(2.0))
                nn.init.zeros_(module.bias)  # type: ignore[arg-type]
        # A small last layer makes the first policy the same everywhere, so that no input is favoured by chance.
        nn.init.orthogonal_(self.actor_output.weight, 0.01)
        nn.init.orthogonal_(self.critic_output.weight, 1.0)

    def forward(self, observation: ObservationTensors) -> PolicyOutput:
        """Mean command and value, in one pass of the encoder where it is shared."""
        features = self.actor_encoder(observation)
        critic_features = features if self.critic_encoder is None else self.critic_encoder(observation)
        return PolicyOutput(self._mean(features), self._value(critic_features))

    def mean(self, observation: ObservationTensors) -> Float32[Tensor, "B 2"]:
        """Mean command (v m/s, w rad/s) alone: what a robot runs."""
        return self._mean(self.actor_encoder(observation))

    def value(self, observation: ObservationTensors) -> Float32[Tensor, "B"]:
        """The critic alone."""
        return self._value((self.critic_encoder or self.actor_encoder)(observation))

    def _mean(self, features: Tensor) -> Tensor:
        raw = self.actor_output(_feed(features, self.actor_hidden))
        linear = self.config.max_linear_velocity * torch.sigmoid(raw[:, :1])
        angular = self.config.max_angular_velocity * torch.tanh(raw[:, 1:])
        return torch.cat([linear, angular], dim=1)

    def _value(self, features: Tensor) -> Tensor:
        return self.critic_output(_feed(features, self.critic_hidden)).squeeze(1)

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
    actor = (network.actor_encoder, network.actor_hidden, network.actor_output)
    return sum(parameter.numel() for module in actor for parameter in module.parameters())


def count_mflop(config: NetworkConfig) -> float:
    """Million floating-point operations of one pass of what the robot runs; a multiplication with its addition is 2."""
    lidar_sizes, camera_sizes = config.branch_sizes()
    operations, joined = 0, config.num_goal_features + 2
    for channels, layers, sizes, features in (
        (_NUM_SCANS, config.lidar_layers, lidar_sizes, config.lidar_features),
        (2, config.camera_layers, camera_sizes, config.camera_features),
    ):
        for layer, size in zip(layers, sizes, strict=True):
            operations += 2 * channels * math.prod(layer.kernel) * layer.filters * math.prod(size)
            channels = layer.filters
        inputs = channels * math.prod(sizes[-1])
        for outputs in features:
            operations += 2 * inputs * outputs
            inputs = outputs
        joined += inputs
    return (operations + 2 * joined * config.head_features + 2 * config.head_features * 2) / 1e6


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
    return functional.linear(x, weight.to(x.dtype), bias.to(x.dtype)).relu_()


def _feed(x: Tensor, layers: nn.ModuleList) -> Tensor:
    for layer in cast(list[nn.Linear], list(layers)):
        x = _product(x, layer.weight, layer.bias)
    return x


def _image_patches(
    camera: UInt8[Tensor, "B height width"], prediction: UInt8[Tensor, "B height width"], window: tuple[int, int]
) -> UInt8[Tensor, "B rows columns pixels"]:
    """Both images cut into windows; pixels in the order (channel, row, column) of a convolution's weights. The
    prediction is inverted (all bits flipped: 255 - x).
    """
    kh, kw = window
    word = _WORD_OF_WIDTH[kw]
    B, height, width = camera.shape
    rows, columns = height // kh, width // kw
    patches = torch.empty(B, rows, columns, 2, kh, dtype=word, device=camera.device)
    for channel, image in enumerate((camera, prediction)):
        words = image.contiguous().view(word).view(B, rows, kh, columns).transpose(2, 3)
        patches[:, :, :, channel] = words if channel == 0 else ~words
    return patches.view(B, rows, columns, 2 * kh).view(torch.uint8)
