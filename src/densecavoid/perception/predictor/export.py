"""A predictor's weights in their two forms: safetensors to train on, ONNX to run. Needs torch."""

from __future__ import annotations

import copy
from pathlib import Path

import numpy as np
import onnx
import onnx.numpy_helper
import torch
from torch import Tensor, nn

from densecavoid.networks.config_json import from_dict, to_json
from densecavoid.networks.torch_files import build, read_tensors, save_tensors, to_onnx, write_onnx
from densecavoid.perception.predictor.card import INPUTS, PredictorCard
from densecavoid.perception.predictor.compact import CompactConfig, CompactNetwork
from densecavoid.perception.predictor.features import NEIGHBOUR_NUMBERS, NEIGHBOURS, own_size
from densecavoid.perception.predictor.grids import NUM_CELLS, PAIR, SLOTS, STATE
from densecavoid.perception.predictor.robust_tp import RobustTP, RobustTPConfig


def make_network(card: PredictorCard) -> nn.Module:
    """An untrained network of the kind and configuration that a card tells."""
    if card.kind == "compact":
        return CompactNetwork(from_dict(CompactConfig, card.network))
    return RobustTP(from_dict(RobustTPConfig, card.network))


def example_inputs(card: PredictorCard, rows: int) -> tuple[Tensor, ...]:
    """Zeros in the shapes that the network takes."""
    if card.kind == "compact":
        return torch.zeros(rows, own_size(card.samples)), torch.zeros(rows, NEIGHBOURS, NEIGHBOUR_NUMBERS)
    return (
        torch.zeros(rows, card.samples, STATE),
        torch.zeros(rows, SLOTS, dtype=torch.int64),
        torch.zeros(rows, SLOTS, PAIR),
        torch.zeros(rows, SLOTS, sum(NUM_CELLS)),
    )


def save_predictor(folder: Path, file_name: str, network: nn.Module, card: PredictorCard) -> Path:
    """Writes `file_name`.safetensors, .onnx and .json (the card) into a folder.

    Returns:
        The ONNX file.
    """
    folder.mkdir(parents=True, exist_ok=True)
    if card.kind == "robust-tp":
        network = _rounded(network)
    save_tensors(folder / f"{file_name}.safetensors", network, card.to_metadata())
    (folder / f"{file_name}.json").write_text(to_json(card) + "\n", "utf-8")
    path = folder / f"{file_name}.onnx"
    _export_onnx(path, network, card)
    return path


def _rounded(network: nn.Module) -> nn.Module:
    """The network with weights that float16 can hold: half the file, and both forms still agree to the last digits."""
    network = copy.deepcopy(network)
    with torch.no_grad():
        for tensor in network.state_dict().values():
            if tensor.is_floating_point():
                tensor.copy_(tensor.half().float())
    return network


def load_predictor(path: Path) -> tuple[nn.Module, PredictorCard]:
    """The network (ready to run) and card in a safetensors file.

    Raises:
        FileNotFoundError: if there is no such file.
        ValueError: if it is not such a file, or its tensors do not fit its own configuration.
    """
    tensors, metadata = read_tensors(path)
    card = PredictorCard.from_metadata(metadata, str(path))
    return build(lambda: make_network(card), tensors, path).eval(), card


def _export_onnx(path: Path, network: nn.Module, card: PredictorCard) -> None:
    """Any number of rows to `gaussians` [N, S, 5]."""
    module = copy.deepcopy(network).cpu().eval()
    example = example_inputs(card, rows=3)  # the exporter takes a size of one for a constant
    model = to_onnx(module, example, INPUTS[card.kind], ["gaussians"])
    if card.kind == "robust-tp":
        _store_as_half(model)
    write_onnx(path, model, card.to_metadata())


def _store_as_half(model: onnx.ModelProto) -> None:
    """Weights as float16, turned into float32 when the file is loaded (ONNX Runtime folds the casts)."""
    graph = model.graph
    casts = []
    for tensor in graph.initializer:
        values = onnx.numpy_helper.to_array(tensor)
        if tensor.data_type != onnx.TensorProto.FLOAT or values.size < 64:
            continue
        name = tensor.name
        tensor.CopyFrom(onnx.numpy_helper.from_array(values.astype(np.float16), f"{name}.half"))
        casts.append(onnx.helper.make_node("Cast", [tensor.name], [name], to=onnx.TensorProto.FLOAT))
    nodes = [*casts, *graph.node]
    del graph.node[:]
    graph.node.extend(nodes)
