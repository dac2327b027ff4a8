"""A detector's weights in their two forms: safetensors to train on, ONNX to run. Needs torch; running ONNX does not."""

from __future__ import annotations

from pathlib import Path

import torch
from torch import Tensor, nn

from densecavoid.networks.torch_files import build, read_tensors, save_tensors, to_onnx, write_onnx
from densecavoid.perception.detector.card import DetectorCard
from densecavoid.perception.detector.darknet_config import parse_config, read_config_text
from densecavoid.perception.detector.darknet_weights import read_weights
from densecavoid.perception.detector.network import DarknetNetwork

_RGB_THRESHOLD, _RGB_OVERLAP = 0.25, 0.45


class _Heads(nn.Module):
    """The network with a tuple of outputs, as the exporter wants it."""

    def __init__(self, network: DarknetNetwork) -> None:
        super().__init__()
        self.network = network

    def forward(self, images: Tensor) -> tuple[Tensor, ...]:
        return tuple(self.network(images))


def save_detector(path: Path, network: DarknetNetwork, card: DetectorCard) -> None:
    """Writes the tensors with their card as safetensors."""
    save_tensors(path, network, card.to_metadata())


def load_detector(path: Path) -> tuple[DarknetNetwork, DetectorCard]:
    """The network and card of a file that `save_detector` wrote.

    Raises:
        FileNotFoundError: if there is no file.
        ValueError: if it is not a detector of this project, or its tensors do not fit its configuration.
    """
    tensors, metadata = read_tensors(path)
    card = DetectorCard.from_metadata(metadata, str(path))
    config = parse_config(card.network, str(path))
    return build(lambda: DarknetNetwork(config), tensors, path).eval(), card


def export_onnx(path: Path, network: DarknetNetwork, card: DetectorCard) -> None:
    """Writes one graph: `images` f32 [B, channels, height, width], any batch, to `head_0`, `head_1`, ... (raw)."""
    size = network.config.input
    example = torch.zeros(2, size.channels, size.height, size.width)
    heads = [f"head_{k}" for k in range(len(network.config.heads))]
    write_onnx(path, to_onnx(_Heads(network.cpu().eval()), (example,), ["images"], heads), card.to_metadata())


def import_darknet(
    weights: Path, out: Path, configuration: str | Path = "yolov3", size: tuple[int, int] | None = None
) -> DetectorCard:
    """Turns Darknet's weights of a network for colour images into an ONNX file that `detector.RgbDetector` runs.

    Args:
        weights: the .weights file, COCO's for example.
        out: where the ONNX file goes.
        configuration: which network they are of: a shipped one's name, or a .cfg file.
        size: width and height of the network's input, multiples of its largest stride; else those of the configuration.

    Raises:
        FileNotFoundError: if a file is missing.
        ValueError: if the weights are of another version or network.
    """
    text = read_config_text(configuration)
    if size is not None:
        text = f"{text}\n"
        for name, value in zip(("width", "height"), size, strict=True):
            text = _with_option(text, name, value)
    network = DarknetNetwork(parse_config(text, str(configuration)))
    for block, arrays in zip(network.convolutions(), read_weights(weights, network.config), strict=True):
        block.load(arrays)
    card = DetectorCard(
        name=str(configuration),
        kind="rgb",
        network=text,
        threshold=_RGB_THRESHOLD,
        max_overlap=_RGB_OVERLAP,
        training={"weights": weights.name},
    )
    export_onnx(out, network, card)
    return card


def _with_option(text: str, name: str, value: int) -> str:
    """The text with another value where the first section, [net], sets `name`."""
    lines = text.splitlines()
    first = next(k for k, line in enumerate(lines) if line.split("=")[0].strip() == name)
    lines[first] = f"{name}={value}"
    return "\n".join(lines) + "\n"
