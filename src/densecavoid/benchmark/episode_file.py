"""`episode.json`: one episode with its figures and its trajectory, for readers that do not have this package."""

from __future__ import annotations

import json
import math
import os
from dataclasses import asdict
from importlib import metadata
from pathlib import Path

import numpy as np

from densecavoid.benchmark.episode import Episode
from densecavoid.benchmark.metrics import DEFINITION, episode_metrics

PACKAGES = ("densecavoid", "numpy", "numba", "onnxruntime")


def write_episode(path: Path, episode: Episode) -> None:
    """Writes one episode as JSON.

    Args:
        path: Overwritten at once or not at all; its folder is made.
        episode: What to write. A value that is not finite (no clearance before the first step, no people) becomes null.
    """
    figures = asdict(episode_metrics(episode))
    write_json(
        path,
        {
            "definition": DEFINITION,
            "versions": versions(),
            "scenario": episode.scenario,
            "navigator": episode.navigator,
            "seed": episode.seed,
            "outcome": episode.outcome,
            "start": episode.start_pose_w,
            "goal": episode.goal_w,
            "metrics": {name: value for name, value in figures.items() if name not in ("scenario", "seed", "outcome")},
            "trajectory": {
                "t": episode.time_s,
                "x": episode.pose_w[:, 0],
                "y": episode.pose_w[:, 1],
                "yaw": episode.pose_w[:, 2],
                "v": episode.velocity[:, 0],
                "w": episode.velocity[:, 1],
                # Nothing is measured before the first step.
                "clearance": np.concatenate([[np.nan], episode.clearance_m]),
            },
        },
        indent=None,
    )


def write_json(path: Path, value: object, indent: int | None = 1) -> None:
    """Writes strict JSON (no NaN, no infinity) so that a reader finds the old file or the new, never half of one."""
    path = Path(path)
    path.parent.mkdir(parents=True, exist_ok=True)
    partial = path.with_name(path.name + ".part")
    partial.write_text(json.dumps(plain(value), indent=indent, allow_nan=False) + "\n", encoding="utf-8")
    os.replace(partial, path)


def versions() -> dict[str, str]:
    """Of the packages that a result depends on, where installed."""
    found = {}
    for package in PACKAGES:
        try:
            found[package] = metadata.version(package)
        except metadata.PackageNotFoundError:
            continue
    return found


def plain(value: object) -> object:
    """The same in what JSON knows: floats to six decimals, and None for those that are not finite."""
    if isinstance(value, np.ndarray):
        return plain(value.tolist())
    if isinstance(value, dict):
        return {str(key): plain(item) for key, item in value.items()}
    if isinstance(value, list | tuple):
        return [plain(item) for item in value]
    if isinstance(value, np.generic):
        return plain(value.item())
    if isinstance(value, float):
        return round(value, 6) if math.isfinite(value) else None
    if isinstance(value, Path):
        return str(value)
    return value
