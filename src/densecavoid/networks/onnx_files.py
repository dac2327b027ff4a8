"""ONNX files that ship with the package or are given by path, opened in ONNX Runtime. No torch."""

from __future__ import annotations

import hashlib
from dataclasses import dataclass
from importlib import resources
from pathlib import Path
from typing import NamedTuple

import onnxruntime

from densecavoid.frames import require

MAX_NETWORK_BYTES = 1 << 30
"""Four times YOLOv3."""


@dataclass(frozen=True)
class Shelf:
    """Where the networks of one kind are shipped."""

    kind: str
    """As errors call them: policy, detector, predictor."""
    package: str
    """Whose folder `weights` holds them."""
    prefix: str = ""
    """With which their names begin."""

    def names(self) -> tuple[str, ...]:
        """Of all that ship."""
        folder = resources.files(self.package) / "weights"
        if not folder.is_dir():
            return ()
        files = (entry.name for entry in folder.iterdir() if entry.name.startswith(self.prefix))
        return tuple(sorted(name.removesuffix(".onnx") for name in files if name.endswith(".onnx")))

    def read(self, name_or_path: str | Path) -> bytes:
        """The bytes of a file: that of a shipped network's name, or a path.

        Raises:
            FileNotFoundError: if it is neither, saying which are shipped.
            ValueError: if it is larger than any network (`MAX_NETWORK_BYTES`).
        """
        if Path(name_or_path).is_file():
            size = Path(name_or_path).stat().st_size
            require(size <= MAX_NETWORK_BYTES, f"size of {name_or_path}", size, f"at most {MAX_NETWORK_BYTES} bytes")
            return Path(name_or_path).read_bytes()
        if str(name_or_path) in self.names():
            return (resources.files(self.package) / "weights" / f"{name_or_path}.onnx").read_bytes()
        raise FileNotFoundError(
            f"no {self.kind} {str(name_or_path)!r}: not a file, and not one of those shipped "
            f"({', '.join(self.names()) or 'none'})"
        )

    def open(self, name_or_path: str | Path, threads: int) -> OpenedNetwork:
        """A network ready to run.

        Args:
            name_or_path: a shipped network's name or an ONNX file.
            threads: of one call.

        Raises:
            FileNotFoundError: as `read`.
            ValueError: if ONNX Runtime cannot load the file, or its metadata is no text.
        """
        content = self.read(name_or_path)
        session = _open_session(content, name_or_path, threads)
        try:
            metadata = session.get_modelmeta().custom_metadata_map
        except UnicodeDecodeError as error:
            raise ValueError(f"{name_or_path}: its metadata is no text: {error}") from error
        return OpenedNetwork(session, metadata, hashlib.sha256(content).hexdigest())


class OpenedNetwork(NamedTuple):
    """A network ready to run."""

    session: onnxruntime.InferenceSession
    metadata: dict[str, str]
    """The file's table of strings."""
    sha256: str
    """Hash of the file, for result tables."""


def _open_session(content: bytes, source: str | Path, threads: int) -> onnxruntime.InferenceSession:
    options = onnxruntime.SessionOptions()
    options.intra_op_num_threads = threads
    options.inter_op_num_threads = 1
    # A robot's other processes need the core between two control steps.
    options.add_session_config_entry("session.intra_op.allow_spinning", "0")
    options.log_severity_level = 3
    try:
        return onnxruntime.InferenceSession(content, options, providers=["CPUExecutionProvider"])
    except Exception as error:
        # ONNX Runtime's own exceptions have no common base but Exception.
        raise ValueError(f"{source} is not an ONNX file that ONNX Runtime can load: {error}") from error
