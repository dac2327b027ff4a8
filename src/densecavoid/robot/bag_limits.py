"""Bounds on what rosbags unpacks and asks a database for: a few kilobytes of a stranger's recording can stand for
gigabytes, or for a query that never ends. Nothing else of rosbags is changed; its version is bounded in pyproject.toml,
because its tables of decompressors are its own affair.
"""

from __future__ import annotations

import bz2
import importlib
from collections.abc import Callable
from typing import IO, Any

MAX_UNPACKED_BYTES = 256 << 20
"""Of one chunk or message; writers make chunks of about a megabyte."""


def bound_unpacking(max_file_bytes: int) -> None:
    """Puts bounded decompressors and databases (`PlainDatabases`) in the place of rosbags' own; may be called again.

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
    databases: Any = importlib.import_module("rosbags.rosbag2.storage_sqlite3")
    if not isinstance(databases.apsw, PlainDatabases):
        databases.apsw = PlainDatabases(databases.apsw)


class PlainDatabases:
    """The module apsw, but connections that only read refuse a file in which a name stands for a computation: views and
    columns may ask for anything, without end.
    """

    def __init__(self, apsw: Any) -> None:
        self._apsw = apsw

    def __getattr__(self, name: str) -> Any:
        return getattr(self._apsw, name)

    def Connection(self, filename: str, *, flags: int, vfs: str | None = None) -> Any:  # noqa: N802 (apsw's name)
        """As apsw's.

        Raises:
            ValueError: for a database with views, virtual tables or computed columns, naming the first.
        """
        connection = self._apsw.Connection(filename, flags=flags, vfs=vfs)
        if flags & self._apsw.SQLITE_OPEN_READONLY:
            computed = (
                "SELECT name FROM sqlite_master WHERE type NOT IN ('table', 'index') UNION ALL "
                "SELECT name FROM pragma_table_list WHERE schema = 'main' AND type = 'virtual' UNION ALL "
                "SELECT t.name || '.' || c.name FROM sqlite_master t, pragma_table_xinfo(t.name) c "
                "WHERE t.type = 'table' AND c.hidden <> 0"
            )
            found = connection.execute(computed).fetchone()
            if found is not None:
                connection.close()
                raise ValueError(f"{found[0]!r} in the database is computed, expected tables of data alone")
        return connection


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
