"""The folder of a training run, which explains itself: what was asked for, with which code and packages, what happened,
and what came out. It knows paths and formats, not learning.
"""

from __future__ import annotations

import dataclasses
import json
import os
import platform
import subprocess
from importlib import metadata
from pathlib import Path
from typing import Any

from densecavoid.learning.checkpoint import write_atomically
from densecavoid.learning.config import TrainConfig
from densecavoid.networks.config_json import from_dict, to_json

_PACKAGES = ("densecavoid", "torch", "numpy", "numba", "gymnasium", "onnx", "onnxruntime", "safetensors")
BUDGET = ("run_dir", "total_steps", "max_minutes", "threads", "checkpoint_every")
"""Fields of `TrainConfig` that may change when a run is resumed."""


class RunFolder:
    """Paths and bookkeeping of one run."""

    def __init__(self, path: Path) -> None:
        self.path = path
        self.config_file = path / "config.json"
        self.metrics_file = path / "metrics.jsonl"
        self.tensorboard = path / "tensorboard"
        self.last_checkpoint = path / "checkpoints" / "last.safetensors"
        self.best_checkpoint = path / "checkpoints" / "best.safetensors"

    def create(self, config: TrainConfig) -> None:
        """Makes the folder and writes down what is asked for and with what.

        Raises:
            FileExistsError: if it already holds a run.
        """
        if self.config_file.exists():
            raise FileExistsError(f"{self.path} already holds a run: resume it (--resume), or give another run folder")
        self.last_checkpoint.parent.mkdir(parents=True, exist_ok=True)
        self.write_json(self.config_file, json.loads(to_json(config)))
        self.write_json(self.path / "provenance.json", provenance())

    def read_config(self) -> TrainConfig:
        """The configuration the run was started with.

        Raises:
            FileNotFoundError: if the folder holds no run.
        """
        if not self.config_file.exists():
            raise FileNotFoundError(f"{self.path} holds no run to resume: there is no {self.config_file.name}")
        return from_dict(TrainConfig, json.loads(self.config_file.read_text()))

    def check_resumable(self, config: TrainConfig) -> None:
        """
        Raises:
            FileNotFoundError: if the folder holds no run.
            ValueError: if `config` differs from the run's in more than its budget, naming the fields.
        """
        before, now = (json.loads(to_json(each)) for each in (self.read_config(), config))
        changed = [name for name in now if name not in BUDGET and before.get(name) != now[name]]
        if changed:
            differences = "; ".join(f"{name} was {before.get(name)!r} and is {now[name]!r}" for name in changed)
            raise ValueError(f"{self.path} cannot be resumed with other settings: {differences}")

    def forget_metrics_after(self, steps: int) -> None:
        """Drops the lines of iterations that the checkpoint does not know, so that a resumed log has no double."""
        if self.metrics_file.exists():
            lines = self.metrics_file.read_text().splitlines(keepends=True)
            kept = [line for line in lines if line.endswith("\n") and json.loads(line)["steps"] <= steps]
            write_atomically(self.metrics_file, "".join(kept).encode())

    def write_json(self, path: Path, content: dict[str, Any]) -> None:
        """Indented, in one atomic step."""
        write_atomically(path, (json.dumps(content, indent=2, default=str) + "\n").encode())


def provenance() -> dict[str, Any]:
    """Packages, machine and the state of the code."""
    return {
        "packages": {name: _version(name) for name in _PACKAGES},
        "python": platform.python_version(),
        "machine": {"system": platform.system(), "processor": platform.machine(), "cores": os.cpu_count()},
        "git": _git_state(),
    }


def config_summary(config: TrainConfig) -> dict[str, Any]:
    """What of the configuration goes into a policy's file: settings, no paths."""
    values = json.loads(json.dumps(dataclasses.asdict(config), default=str))
    return {name: value for name, value in values.items() if name not in ("run_dir", "initial_weights")}


def _version(package: str) -> str | None:
    try:
        return metadata.version(package)
    except metadata.PackageNotFoundError:
        return None


def _git_state() -> dict[str, Any] | None:
    """Commit and whether files differ from it; None outside a repository or without git."""
    here = Path(__file__).parent
    try:
        commit, status = (
            subprocess.run(["git", *arguments], cwd=here, capture_output=True, text=True, check=True, timeout=10).stdout
            for arguments in (["rev-parse", "HEAD"], ["status", "--porcelain", "--untracked-files=no"])
        )
    except (OSError, subprocess.SubprocessError):
        return None
    return {"commit": commit.strip(), "changed": bool(status.strip())}
