"""A predictor's weights in their two forms: safetensors to train on, ONNX to run. Needs torch."""

from __future__ import annotations

import copy
import logging
import warnings
from pathlib import Path

import numpy as np
import onnx
import onnx.numpy_helper
import safetensors
import safetensors.torch
import torch
from torch import Tensor, nn

from densecavoid.perception.predictor.card import PredictorCard
from densecavoid.perception.predictor.compact import CompactConfig, CompactNetwork
from densecavoid.perception.predictor.features import NEIGHBOUR_NUMBERS, NEIGHBOURS, own_size
from densecavoid.perception.predictor.grids import NUM_CELLS, PAIR, SLOTS, STATE
from densecavoid.perception.predictor.robust_tp import RobustTP, RobustTPConfig
from densecavoid.policy.config_json import from_dict, to_json

_OPSET = 18
_INPUTS = {"compact": ("own", "neighbours"), "robust-tp": ("own", "neighbour", "pair", "cells")}
# It reports operators of torchvision as missing, which no network here uses.
logging.getLogger("torch.onnx._internal.exporter._registration").setLevel(logging.ERROR)


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
    tensors = {name: tensor.detach().cpu().contiguous() for name, tensor in network.state_dict().items()}
    safetensors.torch.save_file(tensors, folder / f"{file_name}.safetensors", card.to_metadata())
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
    if not path.exists():
        raise FileNotFoundError(f"there is no weights file {path}")
    try:
        with safetensors.safe_open(path, framework="pt") as file:
            card = PredictorCard.from_metadata(file.metadata() or {}, str(path))
            tensors = {name: file.get_tensor(name) for name in file.keys()}  # noqa: SIM118
    except safetensors.SafetensorError as error:
        raise ValueError(f"{path} is not a safetensors file: {error}") from error
    network = make_network(card)
    try:
        network.load_state_dict(tensors)
    except RuntimeError as error:
        raise ValueError(f"{path}: the tensors do not fit the network described beside them: {error}") from error
    return network.eval(), card


def _export_onnx(path: Path, network: nn.Module, card: PredictorCard) -> None:
    """Any number of rows to `gaussians` [N, S, 5]."""
    module = copy.deepcopy(network).cpu().eval()
    example = example_inputs(card, rows=3)  # the exporter takes a size of one for a constant
    batch = torch.export.Dim("batch")
    with warnings.catch_warnings():
        # The exporter warns about its own deprecated internals, which nobody here can act upon.
        warnings.simplefilter("ignore")
        program = torch.onnx.export(
            module,
            example,
            dynamo=True,
            opset_version=_OPSET,
            input_names=list(_INPUTS[card.kind]),
            output_names=["gaussians"],
            dynamic_shapes=tuple({0: batch} for _ in example),
            verbose=False,
        )
    assert program is not None
    model = program.model_proto
    for node in model.graph.node:
        # The exporter's traces name files of the machine that exported.
        del node.metadata_props[:]
        node.doc_string = ""
    for value in (*model.graph.input, *model.graph.output, *model.graph.value_info, *model.graph.initializer):
        del value.metadata_props[:]
    del model.graph.metadata_props[:]
    if card.kind == "robust-tp":
        _store_as_half(model)
    onnx.helper.set_model_props(model, card.to_metadata())
    onnx.checker.check_model(model)
    path.write_bytes(model.SerializeToString(deterministic=True))


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
