"""Darknet's .weights files, to and from arrays. Not torch: network.py takes the arrays in.

A file is int32 major, minor, revision, then the number of images seen (8 bytes from version 0.2 on, else 4), then
float32: for each convolution its bias, with batch normalisation also scale, mean and variance, then its weights
[out][in][rows][columns]. Nothing in it says which network it is of, but for its size.
"""

from __future__ import annotations

import math
from pathlib import Path
from typing import NamedTuple

import numpy as np

from densecavoid.frames import require
from densecavoid.perception.detector.darknet_config import Convolutional, DarknetConfig

_VERSIONS = ((0, 1), (0, 2))
_VERSION_BYTES, _FLOAT_BYTES = 12, 4


class ConvolutionWeights(NamedTuple):
    """One convolution; the three of batch normalisation are None without it."""

    bias: np.ndarray  # f32 [out]
    scale: np.ndarray | None  # f32 [out]
    mean: np.ndarray | None  # f32 [out]
    variance: np.ndarray | None  # f32 [out]
    kernel: np.ndarray  # f32 [out, in, rows, columns]


def kernel_shapes(config: DarknetConfig) -> list[tuple[tuple[int, int, int, int], bool]]:
    """Of each convolution in the order of the file: shape of its weights, whether it has batch normalisation."""
    shapes = []
    channels = config.input.channels
    for layer, shape in zip(config.layers, config.shapes, strict=True):
        if isinstance(layer, Convolutional):
            shapes.append(((layer.filters, channels, layer.size, layer.size), layer.batch_normalize))
        channels = shape.channels
    return shapes


def num_weights(config: DarknetConfig) -> int:
    """Numbers in the network's file."""
    return sum(math.prod(shape) + shape[0] * (4 if norm else 1) for shape, norm in kernel_shapes(config))


def read_weights(path: Path, config: DarknetConfig) -> list[ConvolutionWeights]:
    """The weights of the network that `config` describes.

    Raises:
        FileNotFoundError: if there is no file.
        ValueError: if its version or its size is not that of such a network's file, saying what was expected and what
            was found (looked at before the weights are read), or if a number is not finite or a variance negative.
    """
    size = path.stat().st_size
    with path.open("rb") as file:
        version = np.frombuffer(file.read(_VERSION_BYTES), "<i4") if size >= _VERSION_BYTES else np.zeros(0, "<i4")
        known = " or ".join(f"{major}.{minor}" for major, minor in _VERSIONS)
        found = ".".join(map(str, version.tolist())) or f"none, in {size} bytes"
        require(tuple(version[:2].tolist()) in _VERSIONS, f"version of {path}", found, f"{known} of Darknet's weights")
        seen_bytes = 8 if 10 * version[0] + version[1] >= 2 else 4
        expected = _VERSION_BYTES + seen_bytes + _FLOAT_BYTES * num_weights(config)
        require(size == expected, f"size of {path}", f"{size:,} bytes", f"{expected:,} bytes for this configuration")
        file.seek(seen_bytes, 1)

        def take(*shape: int) -> np.ndarray:
            return np.fromfile(file, "<f4", math.prod(shape)).astype(np.float32, copy=False).reshape(shape)

        convolutions = []
        for shape, norm in kernel_shapes(config):
            bias = take(shape[0])
            scale, mean, variance = (take(shape[0]) if norm else None for _ in range(3))
            convolutions.append(ConvolutionWeights(bias, scale, mean, variance, take(*shape)))
    for k, convolution in enumerate(convolutions):
        finite = all(array is None or bool(np.isfinite(array).all()) for array in convolution)
        require(finite, f"convolution {k} of {path}", "not all finite", "finite weights")
        least = 0.0 if convolution.variance is None else float(convolution.variance.min())
        require(least >= 0.0, f"least variance of convolution {k} of {path}", least, "0 or more")
    return convolutions


def write_weights(path: Path, convolutions: list[ConvolutionWeights], images_seen: int = 0) -> None:
    """Writes a file of version 0.2."""
    with path.open("wb") as file:
        np.array([0, 2, 0], "<i4").tofile(file)
        np.array([images_seen], "<u8").tofile(file)
        for convolution in convolutions:
            for array in convolution:
                if array is not None:
                    np.ascontiguousarray(array, "<f4").tofile(file)
