"""Recorded and simulated walks cut into what was seen and what followed: for training and measuring predictors."""

from __future__ import annotations

import json
from collections.abc import Sequence
from dataclasses import dataclass, fields, replace
from pathlib import Path

import numpy as np
from jaxtyping import Bool, Float, Float32, Int

from densecavoid.frames import choose, require
from densecavoid.perception.predictor.contract import (
    FIELD_PERIOD_S,
    FIELD_PREDICTED,
    FIELD_SEEN,
    Histories,
    histories_of,
)
from densecavoid.scenarios.recordings import hermes_path, hermes_width_m, resample
from densecavoid.scenarios.track_files import Tracks, read_hermes, read_tracks

SCENES: dict[str, tuple[str, ...]] = {
    "eth": ("biwi_eth",),
    "hotel": ("biwi_hotel",),
    "univ": ("students001", "students003"),
    "zara1": ("crowds_zara01",),
    "zara2": ("crowds_zara02",),
}
"""The five test scenes of ETH/UCY."""
EXTRA_FILES = ("crowds_zara03", "uni_examples")
"""Two more files that the field trains on in every fold."""
TRUE_RATE = {"biwi_eth": "biwi_eth_0p4s", "biwi_hotel": "biwi_hotel_0p4s"}
"""To train on: the published files of these two are stretched in time."""
HERMES_TEST = ("bo-360-090-090", "boa-300-065-105", "bot-360-120-120")
"""Two-way runs of .87, 1.24 and 1.52 people per m2 that no shipped predictor has seen."""
HERMES_VALIDATION = ("bot-300-065-065", "boa-300-080-120")
"""Two-way runs (.74 and 1.69 per m2) to fit temperatures and to choose weights by."""
DENSITY_STRETCH_M = 4.0
_CORRIDOR_END_Y = 4.0  # beyond it the corridor is open: density has no meaning there


@dataclass(frozen=True, eq=False)
class Windows:
    """N people, each seen for H steps and followed for S steps more. Those of one instant share a group."""

    pos: Float32[np.ndarray, "N H 2"]
    valid: Bool[np.ndarray, "N H"]
    group: Int[np.ndarray, "N"]
    future: Float32[np.ndarray, "N S 2"]
    """NaN where it is not known."""
    density: Float32[np.ndarray, "N"]
    """People per m2 around; NaN where it is not known."""
    velocity: Float32[np.ndarray, "N 2"]
    """What a tracker gives, m/s; NaN where there is no tracker."""
    weight: Float32[np.ndarray, "N"]
    """How much an error counts in training."""
    period_s: float

    def __len__(self) -> int:
        return len(self.pos)

    def histories(self) -> Histories:
        """What a predictor may see."""
        return histories_of(self.pos, self.period_s, self.valid, self.group, self.velocity)

    def subset(self, keep: Bool[np.ndarray, "N"] | Int[np.ndarray, "kept"] | slice) -> Windows:
        """The kept people alone; they see only each other from then on."""
        arrays = {field.name: getattr(self, field.name)[keep] for field in fields(self) if field.name != "period_s"}
        return replace(self, **arrays)


def join(parts: Sequence[Windows]) -> Windows:
    """All in one, groups renumbered.

    Raises:
        ValueError: if there are none, or their shapes or periods differ.
    """
    require(len(parts) > 0, "windows", parts, "some")
    for part in parts:
        same = part.period_s == parts[0].period_s and part.pos.shape[1:] == parts[0].pos.shape[1:]
        require(same, "windows", (part.period_s, part.pos.shape), f"as {(parts[0].period_s, parts[0].pos.shape)}")
    groups, first = [], 0
    for part in parts:
        groups.append(part.group + first)
        first += int(part.group.max(initial=-1)) + 1
    names = ("pos", "valid", "future", "density", "velocity", "weight")
    arrays = {name: np.concatenate([getattr(part, name) for part in parts]) for name in names}
    return Windows(group=np.concatenate(groups), period_s=parts[0].period_s, **arrays)


def cut(
    places: Float[np.ndarray, "T P 2"],
    period_s: float,
    seen: int,
    ahead: Sequence[int],
    *,
    stride: int = 1,
    complete: bool = False,
    density: Float[np.ndarray, "T P"] | None = None,
) -> Windows:
    """Cuts windows out of everybody's places at equal times.

    Args:
        places: NaN where somebody is not there.
        period_s: between two steps.
        seen: steps of history.
        ahead: which steps after it are the future.
        stride: steps between two windows.
        complete: True: as the field does, only people there at all steps, and windows of two at least. False:
            everybody there at the last step seen, with as much history and future as there is.
        density: around each person.
    """
    last = max(ahead) if complete else min(ahead)
    known: np.ndarray = np.all(np.isfinite(places), axis=2)
    rows: list[tuple[np.ndarray, ...]] = []
    for group, now in enumerate(range(seen - 1 if complete else 0, len(places) - last, stride)):
        steps = np.arange(now - seen + 1, now + 1)
        there = known[now] if not complete else known[now - seen + 1 : now + last + 1].all(axis=0)
        who = np.flatnonzero(there)
        if len(who) < (2 if complete else 1):
            continue
        inside = steps >= 0
        pos = np.where(inside[:, None, None], places[np.maximum(steps, 0)][:, who], np.nan).transpose(1, 0, 2)
        then = now + np.asarray(ahead)
        future = places[np.minimum(then, len(places) - 1)][:, who].transpose(1, 0, 2).copy()
        future[:, then >= len(places)] = np.nan
        around = np.full(len(who), np.nan) if density is None else density[now, who]
        rows.append((pos, future, np.full(len(who), group), around))
    if not rows:
        rows.append((np.zeros((0, seen, 2)), np.zeros((0, len(ahead), 2)), np.zeros(0, np.int64), np.zeros(0)))
    pos, future, group, around = (np.concatenate(column) for column in zip(*rows, strict=True))
    return Windows(
        pos=pos.astype(np.float32),
        valid=np.all(np.isfinite(pos), axis=2),
        group=group.astype(np.int64),
        future=future.astype(np.float32),
        density=around.astype(np.float32),
        velocity=np.full((len(pos), 2), np.nan, np.float32),
        weight=np.ones(len(pos), np.float32),
        period_s=period_s,
    )


def dense_places(tracks: Tracks) -> Float[np.ndarray, "T P 2"]:
    """Everybody's places at each step of the file, NaN where somebody is not there."""
    _, person = np.unique(tracks.person_id, return_inverse=True)
    step = np.round(tracks.time_s / tracks.period_s).astype(np.int64)
    places = np.full((int(step.max()) + 1, int(person.max()) + 1, 2), np.nan)
    places[step, person] = tracks.pos_w
    return places


def eth_ucy_test(data: Path, scene: str) -> Windows:
    """The windows that the field tests a scene on: 8 steps of .4 s seen, 12 to predict.

    Raises:
        ValueError: if there is no such scene.
    """
    files = SCENES[choose("ETH/UCY scene", scene, tuple(SCENES))]
    places = [dense_places(read_tracks(data / "eth_ucy" / "all_data" / f"{name}.txt")) for name in files]
    return _eth_ucy(places, complete=True)


def eth_ucy_training(data: Path, without: str | None = None, held_back: float = 0.0) -> tuple[Windows, Windows]:
    """All scenes but one (None: all), eth and hotel at their true rate, with the two extra files.

    People whose history or future is incomplete are kept: the more to learn from.

    Args:
        held_back: share of each file, its last part, that is not trained on.

    Returns:
        What to train on, and what was held back.
    """
    early, late = [], []
    for places in eth_ucy_places(data, without):
        split = round(len(places) * (1.0 - held_back))
        early.append(places[:split])
        late.append(places[split:])
    return _eth_ucy(early, complete=False), _eth_ucy(late, complete=False)


def eth_ucy_places(data: Path, without: str | None = None) -> list[np.ndarray]:
    """Everybody's places [T, P, 2] every .4 s in each file that is trained on."""
    files = [name for scene, names in SCENES.items() if scene != without for name in names] + list(EXTRA_FILES)
    folder = data / "eth_ucy"
    paths = [
        folder / "true_rate" / f"{TRUE_RATE[name]}.txt" if name in TRUE_RATE else folder / "all_data" / f"{name}.txt"
        for name in files
    ]
    return [dense_places(read_tracks(path)) for path in paths]


def _eth_ucy(places: Sequence[np.ndarray], complete: bool) -> Windows:
    ahead = range(1, FIELD_PREDICTED + 1)
    return join([cut(place, FIELD_PERIOD_S, FIELD_SEEN, ahead, complete=complete) for place in places])


def hermes(
    data: Path, run: str, period_s: float, seen: int, ahead: Sequence[int], *, stride: int = 1, inside: bool = False
) -> Windows:
    """A HERMES run: heads as recorded, with their sway, at equal times; nothing is smoothed.

    Args:
        period_s, seen, ahead, stride: as in `cut`.
        inside: only people now between the corridor's walls, where density has a meaning.
    """
    recording = resample(read_hermes(hermes_path(data, run)), dt_s=period_s)
    places = np.full((recording.num_steps, recording.num_people, 2), np.nan)
    step = np.repeat(np.arange(recording.num_steps), np.diff(recording.frame_start))
    places[step, recording.person] = recording.state_w[:, :2]
    density = _corridor_density(places, hermes_width_m(data, run))
    windows = cut(places, period_s, seen, ahead, stride=stride, density=density)
    return windows.subset(np.isfinite(windows.density)) if inside else windows


def _corridor_density(places: Float[np.ndarray, "T P 2"], width_m: float) -> Float[np.ndarray, "T P"]:
    """People per m2 in the stretch of 4 m around each (themselves among them); NaN outside the corridor proper."""
    along = places[..., 1]
    near = np.abs(along[:, :, None] - along[:, None, :]) <= DENSITY_STRETCH_M / 2  # NaN is near nobody
    reach = np.minimum(along + DENSITY_STRETCH_M / 2, 7.0) - np.maximum(along - DENSITY_STRETCH_M / 2, -7.0)
    density = near.sum(axis=2) / (width_m * reach)
    return np.where(np.abs(along) <= _CORRIDOR_END_Y, density, np.nan)


def two_way_runs(data: Path) -> tuple[str, ...]:
    """HERMES runs with people coming from both ends."""
    table = json.loads((data / "hermes" / "run_table.json").read_text("utf-8"))
    return tuple(entry["run"] for entry in table if min(entry["left_right"]) > 0)
