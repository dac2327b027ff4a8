"""What the network sees with: the four branches of the paper (Fig. 3), joined, and the critic's look at true people.

Convolutions whose windows do not overlap run as matrix products, which is most of what makes `compact` fast.
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

from densecavoid.frames import PERSON_NUMBERS
from densecavoid.policy.network_config import WORTH_SCALES, ConvConfig, NetworkConfig

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
        self.lidar_linears = linears(
            config.lidar_layers[-1].filters * math.prod(lidar_sizes[-1]), config.lidar_features
        )
        camera_places = config.camera_layers[-1].filters * math.prod(camera_sizes[-1]) if config.camera_layers else 0
        self.camera_linears = linears(camera_places, config.camera_features)
        self.sees_camera = len(config.camera_layers) > 0
        self.worth_linear = linears(config.num_worth_inputs, (config.worth_features,) if config.worth_features else ())
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
        return feed(torch.cat([worth, *((behind / scale).exp() for scale in WORTH_SCALES)], dim=1), self.worth_linear)

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
        return feed(x.flatten(1), self.lidar_linears)

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
        return feed(x.flatten(1), self.camera_linears)


class PeopleEncoder(nn.Module):
    """Features of the true people around, whatever their order and number: two layers a person, then the greatest."""

    def __init__(self, config: NetworkConfig) -> None:
        super().__init__()
        self.layers = linears(PERSON_NUMBERS, (config.people_features, config.people_features))
        scale = torch.tensor([1 / _PEOPLE_SCALE_M, 1 / _PEOPLE_SCALE_M, 1.0, 1.0, 1.0, 1.0])
        self.register_buffer("scale", scale, persistent=False)
        self.scale: Tensor

    def forward(self, people: Float32[Tensor, "B K numbers"]) -> Float32[Tensor, "B features"]:
        # Features are not negative: nobody (all zeros) cannot be the greatest.
        return (feed(people * self.scale, self.layers) * people[..., -1:]).amax(dim=1)


def _convolutions(kind: type[nn.Conv1d | nn.Conv2d], channels: int, layers: Sequence[ConvConfig]) -> nn.ModuleList:
    inputs = [channels, *(layer.filters for layer in layers)]
    return nn.ModuleList(
        kind(inputs[i], layer.filters, layer.kernel, layer.stride, layer.padding)  # type: ignore[arg-type]
        for i, layer in enumerate(layers)
    )


def linears(inputs: int, outputs: Sequence[int]) -> nn.ModuleList:
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


def feed(x: Tensor, layers: nn.ModuleList) -> Tensor:
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
