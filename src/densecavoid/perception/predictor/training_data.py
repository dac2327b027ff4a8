"""What learned predictors are trained on, and how each batch is varied. NumPy only."""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import replace
from pathlib import Path

import numpy as np
from jaxtyping import Int

from densecavoid.frames import choose
from densecavoid.perception.predictor.contract import (
    FIELD_PERIOD_S,
    FIELD_PREDICTED,
    ROBOT_HORIZONS_S,
    ROBOT_PERIOD_S,
    ROBOT_SAMPLES,
)
from densecavoid.perception.predictor.simulated import simulated_windows
from densecavoid.perception.predictor.track_noise import TrackNoise, as_tracked, jittered
from densecavoid.perception.predictor.windows import (
    HERMES_TEST,
    HERMES_VALIDATION,
    Windows,
    cut,
    eth_ucy_places,
    eth_ucy_training,
    hermes,
    join,
)
from densecavoid.scenarios.recordings import hermes_runs

TASKS = ("robot", "field")
FIELD_HORIZONS_S = tuple(round(FIELD_PERIOD_S * step, 1) for step in range(1, FIELD_PREDICTED + 1))
_ROBOT_AHEAD = tuple(round(horizon / ROBOT_PERIOD_S) for horizon in ROBOT_HORIZONS_S)
_VALIDATION_SHARE = 0.08  # of each ETH/UCY file
_CLEAN_SHARE = 0.4  # of a robot's batches that see the recorded places, without a tracker
_FIELD_JITTER_M = 0.10
_SCALES = {"robot": (-0.15, 0.15), "field": (-0.3, 0.5)}
"""Natural logarithm of how much larger a batch's world is: people of other sizes and speeds. The field's test scene
`eth` is stretched in time, so that its people seem to walk 1.7 times as fast."""


def robot_windows(data: Path, seed: int, log=print) -> tuple[Windows, Windows]:
    """To train on and to validate by: .1 s steps, from HERMES, ETH/UCY (between its .4 s steps on straight lines) and
    simulated crowds; HERMES_TEST is left out, HERMES_VALIDATION is what is validated by."""
    held_out = (*HERMES_TEST, *HERMES_VALIDATION)
    runs = [run for run in hermes_runs(data) if run not in held_out]
    parts = [hermes(data, run, ROBOT_PERIOD_S, ROBOT_SAMPLES, _ROBOT_AHEAD, stride=2) for run in runs]
    log(f"HERMES: {len(runs)} runs, {sum(map(len, parts)):,} histories")
    parts += [_between_steps(places) for places in eth_ucy_places(data)]
    parts.append(simulated_windows(ROBOT_SAMPLES, _ROBOT_AHEAD, 8, seed))
    log(f"simulated: {len(parts[-1]):,} histories")
    validation = [
        hermes(data, run, ROBOT_PERIOD_S, ROBOT_SAMPLES, _ROBOT_AHEAD, stride=8, inside=True)
        for run in HERMES_VALIDATION
    ]
    return join(parts), join(validation)


def field_windows(data: Path, without: str | None) -> tuple[Windows, Windows]:
    """ETH/UCY at .4 s without a scene (None: with all), to train on and, the last part of each file, to validate by."""
    return eth_ucy_training(data, without, _VALIDATION_SHARE)


def _between_steps(places: np.ndarray) -> Windows:
    """Windows of .1 s that end at a recorded step, so that nothing of the future shows in the past."""
    fine = round(FIELD_PERIOD_S / ROBOT_PERIOD_S)
    share = (np.arange((len(places) - 1) * fine + 1) / fine)[:, None, None]
    before = np.floor(share[:, 0, 0]).astype(np.int64)
    after, share = np.minimum(before + 1, len(places) - 1), share - before[:, None, None]
    # At a recorded step the next one has no weight, and may not be there.
    path = np.where(share > 0, (1 - share) * places[before] + share * places[after], places[before])
    windows = cut(path, ROBOT_PERIOD_S, ROBOT_SAMPLES, _ROBOT_AHEAD, stride=fine)
    future = windows.future.copy()
    future[:, [ahead % fine != 0 for ahead in _ROBOT_AHEAD]] = np.nan  # not recorded
    known: np.ndarray = np.any(np.all(np.isfinite(future), axis=2), axis=1)
    return replace(windows, future=future).subset(known)


def varied(windows: Windows, task: str, rng: np.random.Generator) -> Windows:
    """Each group turned, mirrored and scaled at random; then noise on the histories, a tracker's for the robot."""
    _, of = np.unique(windows.group, return_inverse=True)
    groups = int(of.max(initial=-1)) + 1
    angle = rng.uniform(-np.pi, np.pi, groups)
    scale = np.exp(rng.uniform(*_SCALES[choose("task", task, TASKS)], groups))
    cos, sin = scale * np.cos(angle), scale * np.sin(angle)
    mirror = rng.choice([-1.0, 1.0], groups)
    turn = np.stack([cos, -sin * mirror, sin, cos * mirror], axis=1).reshape(-1, 2, 2)[of]
    moved = replace(
        windows,
        pos=np.einsum("nij,nhj->nhi", turn, windows.pos).astype(np.float32),
        future=np.einsum("nij,nsj->nsi", turn, windows.future).astype(np.float32),
        weight=(windows.weight / scale[of]).astype(np.float32),
    )
    if task == "field":
        return jittered(moved, _FIELD_JITTER_M, rng)
    return moved if rng.random() < _CLEAN_SHARE else as_tracked(moved, TrackNoise(), rng)


def batches(windows: Windows, size: int, rng: np.random.Generator) -> Iterator[Windows]:
    """Once through all groups in random order, whole groups of about `size` rows at a time."""
    starts: Int[np.ndarray, "G"] = np.flatnonzero(np.diff(windows.group, prepend=windows.group[:1] - 1))
    stops = np.append(starts[1:], len(windows))
    rows: list[np.ndarray] = []
    count = 0
    for group in rng.permutation(len(starts)):
        rows.append(np.arange(int(starts[group]), int(stops[group])))
        count += len(rows[-1])
        if count >= size:
            yield windows.subset(np.concatenate(rows))
            rows, count = [], 0
    if rows:
        yield windows.subset(np.concatenate(rows))
