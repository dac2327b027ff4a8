"""Recorded crowds as scenarios: the robot among the people of a HERMES corridor or of any file of tracks.

Definitions: BENCHMARK, Real crowds. People are replayed to the letter, or keep the recorded way as an intention.
"""

from __future__ import annotations

import math
from dataclasses import dataclass
from pathlib import Path

import numpy as np
from jaxtyping import Float

from densecavoid.frames import RobotConfig
from densecavoid.scenarios.recordings import hermes_path, hermes_width_m, load_recording, resolve_data
from densecavoid.sim.clearance import clearances_m
from densecavoid.sim.crowds.recording import Recording
from densecavoid.sim.floorplan import FloorPlan
from densecavoid.sim.spec import Replay, WorldSpec

_TIME_LIMIT_S = 90.0
_WALL_END_Y = 4.0
_END_Y = 6.0
_START_CLEARANCE_M = 0.6  # from the robot's centre to a person's: a step apart
_SIDE_M = 0.5  # from a wall's line to where the robot may start
_SPEED_FOR_START = 0.5  # m/s: the latest start leaves time to cross at this mean speed
_TRIES = 500


def _people_near(recording: Recording, time_s: float, x: float, y: float) -> bool:
    _, state = recording.at(min(round(time_s / recording.dt_s), recording.num_steps - 1))
    return bool((np.hypot(state[:, 0] - x, state[:, 1] - y) < _START_CLEARANCE_M).any())


def _draw_start(
    rng: np.random.Generator, recording: Recording, name: str, plan: FloorPlan, draw_way
) -> tuple[tuple[float, float], tuple[float, float], float]:
    """Start, goal and time with room for the robot and nobody on it; the first tenth of the recording is left out."""
    for _ in range(_TRIES):
        start, goal = draw_way(rng)
        first = 0.1 * recording.duration_s
        last = max(first, recording.duration_s - math.dist(start, goal) / _SPEED_FOR_START)
        time_s = rng.uniform(first, last)
        clear = clearances_m(plan, np.array([start, goal])) > RobotConfig().radius_m
        if clear.all() and not _people_near(recording, time_s, *start):
            return start, goal, time_s
    raise ValueError(
        f"{name}: no start and goal clear of walls, and free of people for {_START_CLEARANCE_M} m around the start, "
        f"in {_TRIES} tries"
    )


@dataclass(frozen=True)
class Hermes:
    """A two-way corridor of the HERMES experiments: 12 m from one end to the other, against and with the flow."""

    run: str
    data: Path
    reactive: bool = False

    def __post_init__(self) -> None:
        hermes_path(self.data, self.run)

    @property
    def name(self) -> str:
        return f"hermes:{self.run}" + (":reactive" if self.reactive else "")

    def spawn(self, rng: np.random.Generator) -> WorldSpec:
        recording = load_recording(hermes_path(self.data, self.run), "hermes")
        width = hermes_width_m(self.data, self.run)
        plan = FloorPlan()
        for x in (-0.05, width + 0.05):
            plan.wall(x, -_WALL_END_Y, x, _WALL_END_Y)

        def draw_way(rng: np.random.Generator) -> tuple[tuple[float, float], tuple[float, float]]:
            end = _END_Y * float(rng.choice([-1.0, 1.0]))
            return (rng.uniform(_SIDE_M, width - _SIDE_M), end), (width / 2, -end)

        start, goal, start_s = _draw_start(rng, recording, self.name, plan, draw_way)
        return WorldSpec(
            scenario=self.name,
            floor_plan=plan,
            start_pose=(*start, math.copysign(math.pi / 2, goal[1])),
            goal=goal,
            time_limit_s=_TIME_LIMIT_S,
            collision_distance_m=RobotConfig().radius_m,
            replay=Replay(recording, start_s, self.reactive),
        )


@dataclass(frozen=True)
class TrackFile:
    """Any file of tracks in the form `frame id x y`: the robot crosses the middle of the scene, 6 to 12 m.

    Walls are optional: a file of the same name with the suffix `.walls`, a line `x0 y0 x1 y1` (m) for each.
    """

    path: Path
    reactive: bool = False

    def __post_init__(self) -> None:
        if not self.path.is_file():
            raise ValueError(f"tracks: no file {self.path}, expected one with rows `frame id x y`")
        read_walls(self.path.with_suffix(".walls"))

    @property
    def name(self) -> str:
        return f"tracks:{self.path.name}" + (":reactive" if self.reactive else "")

    def spawn(self, rng: np.random.Generator) -> WorldSpec:
        recording = load_recording(self.path, "tracks")
        plan = FloorPlan()
        for x0, y0, x1, y1 in read_walls(self.path.with_suffix(".walls")):
            plan.wall(x0, y0, x1, y1)
        low, high = np.percentile(recording.state_w[:, :2], [2.0, 98.0], axis=0)

        def draw_way(rng: np.random.Generator) -> tuple[tuple[float, float], tuple[float, float]]:
            centre = rng.uniform(0.7 * low + 0.3 * high, 0.3 * low + 0.7 * high)
            angle = rng.uniform(-math.pi, math.pi)
            half = 0.5 * np.clip(min(high - low), 6.0, 12.0) * np.array([math.cos(angle), math.sin(angle)])
            a, b = centre - half, centre + half
            return (float(a[0]), float(a[1])), (float(b[0]), float(b[1]))

        start, goal, start_s = _draw_start(rng, recording, self.name, plan, draw_way)
        return WorldSpec(
            scenario=self.name,
            floor_plan=plan,
            start_pose=(*start, math.atan2(goal[1] - start[1], goal[0] - start[0])),
            goal=goal,
            time_limit_s=_TIME_LIMIT_S,
            collision_distance_m=RobotConfig().radius_m,
            replay=Replay(recording, start_s, self.reactive),
        )


def read_walls(path: Path) -> Float[np.ndarray, "N 4"]:
    """Walls as rows x0, y0, x1, y1 (m); none where there is no file.

    Raises:
        ValueError: naming file, line and what was expected.
    """
    if not path.is_file():
        return np.zeros((0, 4))
    rows = []
    for number, line in enumerate(path.read_text(encoding="utf-8", errors="replace").splitlines(), start=1):
        if not line.strip() or line.lstrip().startswith("#"):
            continue
        try:
            row = [float(word) for word in line.split()]
        except ValueError:
            row = []
        if len(row) != 4 or not np.isfinite(row).all():
            raise ValueError(f"{path}:{number}: {line.strip()!r}, expected a wall as four numbers: x0 y0 x1 y1 (m)")
        rows.append(row)
    return np.array(rows, dtype=np.float64).reshape(-1, 4)


def recorded_scenario(name: str, data: Path | None) -> Hermes | TrackFile:
    """The scenario that `hermes:<run>[:reactive]` or `tracks:FILE[:reactive]` names.

    Raises:
        ValueError: if there is no such run or file, saying what there is.
    """
    kind, _, rest = name.partition(":")
    reactive = rest.endswith(":reactive")
    rest = rest.removesuffix(":reactive")
    if not rest:
        raise ValueError(f"scenario {name!r} is incomplete, expected {kind}:<{'run' if kind == 'hermes' else 'file'}>")
    if kind == "hermes":
        return Hermes(rest, resolve_data(data), reactive)
    return TrackFile(Path(rest), reactive)
