"""ONNX files that ship with the package or are given by path, opened in ONNX Runtime. No torch."""

from __future__ import annotations

from dataclasses import dataclass
from importlib import resources
from pathlib import Path

import onnxruntime


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
        """
        if Path(name_or_path).is_file():
            return Path(name_or_path).read_bytes()
        if str(name_or_path) in self.names():
            return (resources.files(self.package) / "weights" / f"{name_or_path}.onnx").read_bytes()
        raise FileNotFoundError(
            f"no {self.kind} {str(name_or_path)!r}: not a file, and not one of those shipped "
            f"({', '.join(self.names()) or 'none'})"
        )


def open_session(content: bytes, source: str | Path, threads: int) -> onnxruntime.InferenceSession:
    """A network ready to run.

    Args:
        content: of the ONNX file.
        source: what errors call it.
        threads: of one call.

    Raises:
        ValueError: if ONNX Runtime cannot load it.
    """
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
