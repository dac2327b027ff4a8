"""Bounds on what rosbags unpacks: a few kilobytes of a stranger's recording can stand for gigabytes. Nothing else of
rosbags is changed; its version is bounded in pyproject.toml, because its tables of decompressors are its own affair.
"""

from __future__ import annotations

import bz2
import importlib
from collections.abc import Callable
from typing import IO, Any

MAX_UNPACKED_BYTES = 256 << 20
"""Of one chunk or message; writers make chunks of about a megabyte."""


def bound_unpacking(max_file_bytes: int) -> None:
    """Puts bounded decompressors in the place of rosbags' own; may be called again.

    Args:
        max_file_bytes: of a file that is compressed as a whole, which rosbags unpacks into a temporary folder.
    """
    bags1: Any = importlib.import_module("rosbags.rosbag1.reader")
    bags2: Any = importlib.import_module("rosbags.rosbag2.reader")
    mcap: Any = importlib.import_module("rosbags.rosbag2.storage_mcap")
    lz4 = _bounded(importlib.import_module("lz4.frame").LZ4FrameDecompressor)
    zstd = _bounded(mcap.zstd.ZstdDecompressor)
    bags1.decompressors |= {"bz2": _bounded(bz2.BZ2Decompressor), "lz4": lz4}
    mcap.DECOMPRESSORS |= {"lz4": lambda data, _: lz4(data), "zstd": lambda data, _: zstd(data)}

    class BoundedZstd:
        """What rosbag2's reader uses of the module."""

        decompress = staticmethod(zstd)

        @staticmethod
        def open(file: IO[bytes], mode: str) -> BoundedFile:
            return BoundedFile(mcap.zstd.open(file, mode), max_file_bytes)

    bags2.zstd = BoundedZstd


class BoundedFile:
    """A file to read from that ends in an error if there is too much in it."""

    def __init__(self, file: Any, max_bytes: int) -> None:
        self._file, self._left = file, max_bytes

    def __enter__(self) -> BoundedFile:
        return self

    def __exit__(self, *error: object) -> None:
        self._file.close()

    def read(self, size: int) -> bytes:
        """The next bytes, at most `size`.

        Raises:
            ValueError: when there were too many.
        """
        block = self._file.read(size)
        self._left -= len(block)
        if self._left < 0:
            raise ValueError("it unpacks to more than a recording may have")
        return block


def _bounded(decompressor: Callable[[], Any]) -> Callable[[bytes], bytes]:
    """One stream of bytes unpacked, as the classes of bz2, lz4 and zstd do it.

    Raises (the function):
        ValueError: if there is more in it than `MAX_UNPACKED_BYTES`, or it breaks off.
    """

    def unpack(data: bytes) -> bytes:
        stream = decompressor()
        raw = stream.decompress(data, max_length=MAX_UNPACKED_BYTES + 1)
        if len(raw) > MAX_UNPACKED_BYTES:
            raise ValueError(f"a chunk unpacks to more than {MAX_UNPACKED_BYTES} bytes")
        if not stream.eof:
            raise ValueError("a compressed chunk breaks off")
        return raw

    return unpack
