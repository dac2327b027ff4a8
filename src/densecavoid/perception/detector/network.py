"""A Darknet configuration as a torch module: images in, raw heads out. Decoding is NumPy's (decode.py)."""

from __future__ import annotations

import numpy as np
import torch
from torch import Tensor, nn
from torch.nn import functional

from densecavoid.perception.detector.darknet_config import (
    Convolutional,
    DarknetConfig,
    Maxpool,
    Route,
    Shortcut,
    Upsample,
    Yolo,
)
from densecavoid.perception.detector.darknet_weights import ConvolutionWeights

LEAKY_SLOPE = 0.1
NORM_EPSILON = 1e-6
"""Torch divides by sqrt(variance + this), Darknet by sqrt(variance) + the same; Darknet's variances are turned into
those that make both equal."""


class ConvolutionBlock(nn.Module):
    """One `Convolutional` layer."""

    def __init__(self, layer: Convolutional, channels: int) -> None:
        super().__init__()
        self.conv = nn.Conv2d(
            channels, layer.filters, layer.size, layer.stride, layer.padding, bias=not layer.batch_normalize
        )
        self.norm = nn.BatchNorm2d(layer.filters, eps=NORM_EPSILON) if layer.batch_normalize else None
        self.leaky = layer.activation == "leaky"

    def forward(self, x: Tensor) -> Tensor:
        x = self.conv(x)
        if self.norm is not None:
            x = self.norm(x)
        return functional.leaky_relu(x, LEAKY_SLOPE) if self.leaky else x

    @torch.no_grad()
    def load(self, weights: ConvolutionWeights) -> None:
        """Takes over Darknet's weights."""
        self.conv.weight.copy_(torch.from_numpy(weights.kernel))
        if self.norm is None:
            assert self.conv.bias is not None
            self.conv.bias.copy_(torch.from_numpy(weights.bias))
            return
        assert weights.scale is not None and weights.mean is not None and weights.variance is not None
        assert self.norm.running_mean is not None and self.norm.running_var is not None
        self.norm.bias.copy_(torch.from_numpy(weights.bias))
        self.norm.weight.copy_(torch.from_numpy(weights.scale))
        self.norm.running_mean.copy_(torch.from_numpy(weights.mean))
        deviation = np.sqrt(weights.variance.astype(np.float64)) + NORM_EPSILON
        self.norm.running_var.copy_(torch.from_numpy(deviation**2 - NORM_EPSILON))

    def darknet_weights(self) -> ConvolutionWeights:
        """The weights as Darknet would hold them."""
        kernel = self.conv.weight.detach().cpu().numpy()
        if self.norm is None:
            assert self.conv.bias is not None
            return ConvolutionWeights(self.conv.bias.detach().cpu().numpy(), None, None, None, kernel)
        assert self.norm.running_mean is not None and self.norm.running_var is not None
        deviation = np.sqrt(self.norm.running_var.double().cpu().numpy() + NORM_EPSILON) - NORM_EPSILON
        return ConvolutionWeights(
            self.norm.bias.detach().cpu().numpy(),
            self.norm.weight.detach().cpu().numpy(),
            self.norm.running_mean.cpu().numpy(),
            (deviation**2).astype(np.float32),
            kernel,
        )


class DarknetNetwork(nn.Module):
    """Images [B, channels, height, width], any batch and the configuration's size, to one raw output a head."""

    def __init__(self, config: DarknetConfig) -> None:
        super().__init__()
        self.config = config
        self.blocks = nn.ModuleDict()
        channels = config.input.channels
        for k, (layer, shape) in enumerate(zip(config.layers, config.shapes, strict=True)):
            if isinstance(layer, Convolutional):
                self.blocks[str(k)] = ConvolutionBlock(layer, channels)
            channels = shape.channels
        sources: list[int] = []
        for layer in config.layers:
            sources += layer.sources if isinstance(layer, Route) else []
            sources += [layer.source] if isinstance(layer, Shortcut) else []
        self._kept = frozenset(sources)

    def forward(self, images: Tensor) -> list[Tensor]:
        """Raw outputs [B, anchors x (5 + classes), rows, columns] of each head, before any sigmoid."""
        kept: dict[int, Tensor] = {}
        heads: list[Tensor] = []
        x = images
        for k, layer in enumerate(self.config.layers):
            if isinstance(layer, Convolutional):
                x = self.blocks[str(k)](x)
            elif isinstance(layer, Maxpool):
                before = layer.padding // 2
                after = layer.padding - before
                x = functional.pad(x, (before, after, before, after), value=-torch.inf)
                x = functional.max_pool2d(x, layer.size, layer.stride)
            elif isinstance(layer, Shortcut):
                x = x + kept[layer.source]
            elif isinstance(layer, Route):
                x = torch.cat([kept[source] for source in layer.sources], dim=1)
            elif isinstance(layer, Upsample):
                x = functional.interpolate(x, scale_factor=float(layer.stride), mode="nearest")
            elif isinstance(layer, Yolo):
                heads.append(x)
            if k in self._kept:
                kept[k] = x
        return heads

    def convolutions(self) -> list[ConvolutionBlock]:
        """All convolutional layers in the order of the configuration."""
        return [block for block in self.blocks.values() if isinstance(block, ConvolutionBlock)]
