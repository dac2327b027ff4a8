"""Weights as safetensors, and networks exported to ONNX. Needs torch; running ONNX does not (`onnx_files`)."""

from __future__ import annotations

import logging
import warnings
from collections.abc import Callable, Sequence
from pathlib import Path
from typing import TypeVar

import onnx
import safetensors
import safetensors.torch
import torch
from torch import Tensor, nn

M = TypeVar("M", bound=nn.Module)
_OPSET = 18
# It reports operators of torchvision as missing, which no network here uses.
logging.getLogger("torch.onnx._internal.exporter._registration").setLevel(logging.ERROR)


def save_tensors(path: Path, network: nn.Module, metadata: dict[str, str]) -> None:
    """Writes all weights as safetensors, with what is said about them."""
    tensors = {name: tensor.detach().cpu().contiguous() for name, tensor in network.state_dict().items()}
    path.write_bytes(safetensors.torch.save(tensors, metadata))


def read_tensors(path: Path) -> tuple[dict[str, Tensor], dict[str, str]]:
    """The tensors and what is said about them, as `save_tensors` wrote them.

    Raises:
        FileNotFoundError: if there is no such file.
        ValueError: if it is not a safetensors file.
    """
    if not path.is_file():
        raise FileNotFoundError(f"there is no weights file {path}")
    try:
        with safetensors.safe_open(path, framework="pt") as file:
            return {name: file.get_tensor(name) for name in file.keys()}, file.metadata() or {}  # noqa: SIM118
    except safetensors.SafetensorError as error:
        raise ValueError(f"{path} is not a safetensors file: {error}") from error


def build(make: Callable[[], M], tensors: dict[str, Tensor], path: Path) -> M:
    """A network with the tensors of a file.

    Args:
        make: makes the network that the file describes. It is made without memory first: a description of a few bytes
            can ask for any amount, and only one that fits the file's own tensors gets it.
        tensors: the file's.
        path: the file, for errors.

    Raises:
        ValueError: if they do not fit, naming the file.
    """
    try:
        with torch.device("meta"):
            wanted = {name: tuple(tensor.shape) for name, tensor in make().state_dict().items()}
        found = {name: tuple(tensor.shape) for name, tensor in tensors.items()}
        differ = [f"{n} {found.get(n)} for {wanted.get(n)}" for n in wanted | found if found.get(n) != wanted.get(n)]
        if differ:
            raise ValueError(f"{', '.join(differ[:3])}{', ...' if len(differ) > 3 else ''}")
        network = make()
        network.load_state_dict(tensors)
    except (RuntimeError, TypeError, ValueError, OverflowError) as error:
        raise ValueError(f"{path}: the tensors do not fit the network described beside them: {error}") from error
    return network


def to_onnx(
    module: nn.Module, example: tuple[Tensor, ...], inputs: Sequence[str], outputs: Sequence[str]
) -> onnx.ModelProto:
    """The graph of a module, for any number of rows.

    Args:
        module: on the CPU, as it shall run.
        example: one tensor an input, of two rows or more (the exporter takes a size of one for a constant).
        inputs, outputs: their names.
    """
    batch = torch.export.Dim("batch")
    with warnings.catch_warnings():
        # The exporter warns about its own deprecated internals, which nobody here can act upon.
        warnings.simplefilter("ignore")
        program = torch.onnx.export(
            module,
            example,
            dynamo=True,
            opset_version=_OPSET,
            input_names=list(inputs),
            output_names=list(outputs),
            dynamic_shapes=tuple({0: batch} for _ in example),
            verbose=False,
        )
    assert program is not None
    model = program.model_proto
    graph = model.graph
    # The exporter's traces name files of the machine that exported.
    for traced in (model, graph, *graph.node, *graph.input, *graph.output, *graph.value_info, *graph.initializer):
        del traced.metadata_props[:]
    for node in graph.node:
        node.doc_string = ""
    return model


def write_onnx(path: Path, model: onnx.ModelProto, metadata: dict[str, str]) -> None:
    """Writes a checked graph with what is said about it; the same graph gives the same bytes."""
    onnx.helper.set_model_props(model, metadata)
    onnx.checker.check_model(model)
    path.write_bytes(model.SerializeToString(deterministic=True))
