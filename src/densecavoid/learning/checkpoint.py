"""Checkpoints: a tree of arrays and plain values in one safetensors file, written so that a crash at any moment leaves
the old file or the new one, never half of one. No pickle. It does not know what it stores.
"""

from __future__ import annotations

import json
import os
from collections.abc import Mapping
from pathlib import Path
from typing import Any

import numpy as np
import safetensors
import safetensors.numpy
import torch

_FORMAT = "densecavoid-checkpoint-2"
_SEPARATOR = "/"


def write_atomically(path: Path, content: bytes) -> None:
    """Replaces `path` by `content` in one step that survives a loss of power.

    Raises:
        OSError: naming the file, if it cannot be written (a full disk); what was there before is untouched.
    """
    temporary = path.with_name(path.name + ".tmp")
    try:
        with temporary.open("wb") as file:
            file.write(content)
            file.flush()
            os.fsync(file.fileno())
        os.replace(temporary, path)
    except OSError as error:
        temporary.unlink(missing_ok=True)
        raise OSError(
            error.errno, f"{os.strerror(error.errno or 0)}; the file was left as it was", str(path)
        ) from error
    directory = os.open(path.parent, os.O_RDONLY)
    try:
        os.fsync(directory)
    finally:
        os.close(directory)


def save_checkpoint(path: Path, state: Mapping[str, Any]) -> None:
    """Writes nested mappings with string keys whose leaves are tensors, numeric or text arrays, or JSON values.

    Raises:
        TypeError: naming the key of a leaf that is none of these.
        OSError: as `write_atomically`.
    """
    arrays: dict[str, np.ndarray] = {}
    plain: dict[str, Any] = {}
    _flatten("", state, arrays, plain)
    metadata = {"format": _FORMAT, "state": json.dumps(plain)}
    write_atomically(path, safetensors.numpy.save(arrays, metadata))


def load_checkpoint(path: Path) -> dict[str, Any]:
    """What `save_checkpoint` wrote; tensors come back as arrays.

    Raises:
        FileNotFoundError: if there is no such file.
        ValueError: if it is not a checkpoint of this format.
    """
    if not path.exists():
        raise FileNotFoundError(f"there is no checkpoint {path}")
    try:
        with safetensors.safe_open(path, framework="numpy") as file:
            metadata = file.metadata() or {}
            arrays = {key: file.get_tensor(key) for key in file.keys()}  # noqa: SIM118
    except safetensors.SafetensorError as error:
        raise ValueError(f"{path} is not a checkpoint: {error}") from error
    if metadata.get("format") != _FORMAT:
        raise ValueError(f"{path} has format {metadata.get('format')!r}, expected {_FORMAT!r}")
    state: dict[str, Any] = {}
    for key, leaf in [*json.loads(metadata["state"]).items(), *arrays.items()]:
        *parents, name = key.split(_SEPARATOR)
        node = state
        for parent in parents:
            node = node.setdefault(parent, {})
        node[name] = np.array(leaf["text"]) if isinstance(leaf, dict) and "text" in leaf else leaf
    return state


def as_tensors(arrays: Mapping[str, Any]) -> dict[str, torch.Tensor]:
    """Arrays of a checkpoint as tensors of their own."""
    return {name: torch.from_numpy(np.array(array)) for name, array in arrays.items()}


def _flatten(prefix: str, node: Mapping[str, Any], arrays: dict[str, np.ndarray], plain: dict[str, Any]) -> None:
    for name, value in node.items():
        if not isinstance(name, str) or _SEPARATOR in name:
            raise TypeError(f"checkpoint key {prefix}{name!r} must be a string without {_SEPARATOR!r}")
        key = prefix + name
        if isinstance(value, Mapping):
            if value:
                _flatten(key + _SEPARATOR, value, arrays, plain)
            else:
                plain[key] = {}
            continue
        if isinstance(value, torch.Tensor):
            value = value.detach().cpu().numpy()
        if isinstance(value, np.ndarray | np.generic):
            array = np.asarray(value)
            if array.dtype.kind == "U":
                plain[key] = {"text": array.tolist()}
            elif array.dtype.kind in "biuf":
                arrays[key] = np.array(array, order="C")
            else:
                raise TypeError(f"checkpoint entry {key} has the array type {array.dtype}, which cannot be stored")
            continue
        try:
            json.dumps(value)
        except TypeError as error:
            raise TypeError(f"checkpoint entry {key} is a {type(value).__name__}, which cannot be stored") from error
        plain[key] = value
