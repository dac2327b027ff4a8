"""NumPy's .npz files from strangers: sizes are looked at before memory is taken, nothing is unpickled."""

from __future__ import annotations

import io
import math
import zipfile
import zlib
from collections.abc import Sequence
from pathlib import Path

import numpy as np
from numpy.lib import format as npy

from densecavoid.frames import require

_BROKEN = (ValueError, KeyError, TypeError, OSError, EOFError, SyntaxError, OverflowError, RuntimeError)
"""What zipfile and NumPy raise for files that are none (RuntimeError: encrypted, or an unknown compression)."""


def read_arrays(path: Path, names: Sequence[str], max_bytes: int) -> dict[str, np.ndarray]:
    """Arrays of a file by name.

    Args:
        path: the file.
        names: those that are wanted; what else is in it is not looked at.
        max_bytes: of the file, and of each of its arrays unpacked.

    Raises:
        FileNotFoundError: if there is no such file.
        ValueError: if it is no such file, lacks an array, or one is larger or holds objects.
    """
    size = path.stat().st_size
    require(size <= max_bytes, f"size of {path}", size, f"at most {max_bytes} bytes")
    try:
        with zipfile.ZipFile(path) as archive:
            return {name: _read(archive, name, max_bytes) for name in names}
    except (zipfile.BadZipFile, zlib.error, *_BROKEN) as error:
        raise ValueError(f"{path}: {error}") from error


def _read(archive: zipfile.ZipFile, name: str, max_bytes: int) -> np.ndarray:
    with archive.open(f"{name}.npy") as packed:
        raw = packed.read(max_bytes + 1)
    require(len(raw) <= max_bytes, f"size of array {name!r}", "more", f"at most {max_bytes} bytes")
    stream = io.BytesIO(raw)
    version = npy.read_magic(stream)
    require(version == (1, 0), f"version of array {name!r}", version, "(1, 0)")
    shape, _, dtype = npy.read_array_header_1_0(stream)
    # NumPy would take memory for whatever the header says before it looks whether there is so much.
    expected = math.prod(shape) * dtype.itemsize
    require(min(shape, default=0) >= 0, f"shape of array {name!r}", shape, "0 or more")
    require(expected == len(raw) - stream.tell(), f"bytes of array {name!r}", len(raw) - stream.tell(), str(expected))
    return np.load(io.BytesIO(raw), allow_pickle=False)
