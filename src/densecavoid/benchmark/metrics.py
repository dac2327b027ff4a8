"""The figures of BENCHMARK.md: what one episode is worth, and what many are. Pure functions of recorded episodes."""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
from jaxtyping import Float

from densecavoid.benchmark.episode import Episode
from densecavoid.benchmark.statistics import wilson_interval
from densecavoid.frames import require

DEFINITION = "1"
"""Version of the definitions in BENCHMARK.md; results of different versions are not to be compared."""

FROZEN_WINDOW_S = 10.0
FROZEN_DISPLACEMENT_M = 0.30
FREEZING_PATIENCE_S = 30.0
PERSONAL_SPACE_M = 0.45
TURN_DEAD_BAND = 0.02
"""rad/s: slower turning is noise, not a change of mind."""

RATES = ("success", "collision", "collision_at_fault", "walked_into", "timeout", "frozen")


@dataclass(frozen=True)
class EpisodeMetrics:
    """One episode in figures. None where a figure has no meaning."""

    scenario: str
    seed: int
    outcome: str
    frozen: bool
    at_fault: bool
    """A collision that the robot caused: with a thing, or with a person whom it moved towards."""
    walked_into: bool
    """A collision that is not at fault."""
    duration_s: float
    path_length_m: float
    time_to_goal_s: float | None
    spl: float
    clearance_m: float | None
    """Least distance from the robot's centre to anything."""
    clearance_people_m: float | None
    """Least distance from the robot's centre to a person's body."""
    personal_space: float
    """Share of time with a person's body within .45 m of the robot's centre."""
    jerk_m_s3: float
    w_sign_changes: int
    reference_time_s: float | None = None
    """Time to goal of the planner that knows everybody's future; None where it found no way."""
    density_per_m2: float | None = None
    """People per m2 around the straight way from start to goal (`planner.Judgement`)."""

    @property
    def success(self) -> bool:
        return self.outcome == "success"

    @property
    def collision(self) -> bool:
        return self.outcome == "collision"

    @property
    def timeout(self) -> bool:
        return self.outcome == "timeout"

    @property
    def collision_at_fault(self) -> bool:
        return self.at_fault


def is_frozen(
    time_s: Float[np.ndarray, "T1"],
    position_w: Float[np.ndarray, "T1 2"],
    window_s: float = FROZEN_WINDOW_S,
    displacement_m: float = FROZEN_DISPLACEMENT_M,
) -> bool:
    """Whether the net displacement over some `window_s` was under `displacement_m`, standing or oscillating.

    Args:
        time_s: Instants at which the goal has not been reached.
        position_w: The robot's place at each of them.
        window_s: An episode that is shorter is not frozen.
        displacement_m: Net, from the first instant of the window to the last.
    """
    before = np.searchsorted(time_s, time_s - window_s + 1e-6, side="right") - 1
    full = before >= 0
    moved = np.linalg.norm(position_w[full] - position_w[before[full]], axis=-1)
    return bool((moved < displacement_m).any())


def stayed_behind(
    time_s: Float[np.ndarray, "T1"],
    x_w: Float[np.ndarray, "T1"],
    spawn_time_s: float,
    line_x: float,
    patience_s: float = FREEZING_PATIENCE_S,
) -> bool:
    """The rule of the Robot Freezing scenario: `patience_s` after people appeared the robot has not passed their line.

    Args:
        time_s: Instants of the episode.
        x_w: The robot's place along the corridor.
        spawn_time_s: When they appeared; NaN if they did not.
        line_x: Where they stand along the corridor.
        patience_s: How long is long enough. An episode that ends sooner is not frozen by this rule.
    """
    deadline = spawn_time_s + patience_s
    if math.isnan(spawn_time_s) or time_s[-1] < deadline - 1e-6:
        return False
    return bool(x_w[time_s <= deadline + 1e-6].max() <= line_x)


def path_length(position_w: Float[np.ndarray, "T1 2"]) -> float:
    """Metres driven, as the sum of straight pieces between control steps."""
    return float(np.linalg.norm(np.diff(position_w, axis=0), axis=-1).sum())


def success_by_path_length(success: bool, path_length_m: float, shortest_m: float) -> float:
    """One episode's term of SPL: success x shortest / max(driven, shortest) (Anderson et al., arXiv 1807.06757)."""
    require(shortest_m > 0, "shortest_m", shortest_m, "positive")
    return shortest_m / max(path_length_m, shortest_m) if success else 0.0


def personal_space_share(clearance_people_m: Float[np.ndarray, "T"], space_m: float = PERSONAL_SPACE_M) -> float:
    """Share of control steps in which the robot's centre came within `space_m` of a person's body."""
    return float((clearance_people_m < space_m).mean())


def mean_absolute_jerk(time_s: Float[np.ndarray, "T1"], linear_velocity: Float[np.ndarray, "T1"]) -> float:
    """Mean |d2v/dt2| in m/s3 by central differences over equal control steps; 0 for fewer than three instants."""
    if len(time_s) < 3:
        return 0.0
    dt_s = (time_s[-1] - time_s[0]) / (len(time_s) - 1)
    return float(np.abs(np.diff(linear_velocity, 2)).mean() / dt_s**2)


def turn_sign_changes(angular_velocity: Float[np.ndarray, "T1"], dead_band: float = TURN_DEAD_BAND) -> int:
    """How often the robot changes from turning one way to turning the other; slower than `dead_band` is no turning."""
    turning = angular_velocity[np.abs(angular_velocity) > dead_band]
    return int((np.diff(np.sign(turning)) != 0).sum())


def episode_metrics(
    episode: Episode,
    shortest_m: float | None = None,
    reference_time_s: float | None = None,
    density_per_m2: float | None = None,
) -> EpisodeMetrics:
    """All figures of one episode.

    Args:
        episode: Its record.
        shortest_m: Length of the shortest path for SPL; the straight line from start to goal unless given.
        reference_time_s, density_per_m2: What is known of its world.
    """
    position_w = episode.pose_w[:, :2]
    success, collision = episode.outcome == "success", episode.outcome == "collision"
    walked_into = collision and episode.collided_person and not episode.robot_approached
    if shortest_m is None:
        shortest_m = float(np.linalg.norm(episode.goal_w - position_w[0]))
    under_way = slice(None, -1) if success else slice(None)
    length_m = path_length(position_w)
    return EpisodeMetrics(
        scenario=episode.scenario,
        seed=episode.seed,
        outcome=episode.outcome,
        frozen=is_frozen(episode.time_s[under_way], position_w[under_way])
        or stayed_behind(episode.time_s, position_w[:, 0], episode.spawn_time_s, episode.spawn_line_x),
        at_fault=collision and not walked_into,
        walked_into=walked_into,
        duration_s=episode.duration_s,
        path_length_m=length_m,
        time_to_goal_s=episode.duration_s if success else None,
        spl=success_by_path_length(success, length_m, shortest_m),
        clearance_m=_least(episode.clearance_m),
        clearance_people_m=_least(episode.clearance_people_m),
        personal_space=personal_space_share(episode.clearance_people_m),
        jerk_m_s3=mean_absolute_jerk(episode.time_s, episode.velocity[:, 0]),
        w_sign_changes=turn_sign_changes(episode.velocity[:, 1]),
        reference_time_s=reference_time_s,
        density_per_m2=density_per_m2,
    )


def summarise(episodes: Sequence[EpisodeMetrics]) -> dict[str, object]:
    """The figures of one cell of a table: rates with Wilson 95 % intervals, and means.

    Path length and time to goal are means over successes, the sign changes are all of them over all metres driven,
    the other means are over episodes. None where there is nothing to average.
    """
    require(len(episodes) > 0, "episodes", list(episodes), "at least one")
    cell: dict[str, object] = {"episodes": len(episodes)}
    for rate in RATES:
        count = sum(getattr(episode, rate) for episode in episodes)
        cell[rate] = count / len(episodes)
        cell[f"{rate}_ci95"] = list(wilson_interval(count, len(episodes)))
    successes = [episode for episode in episodes if episode.success]
    driven_m = sum(episode.path_length_m for episode in episodes)
    cell["path_length_m"] = _mean([episode.path_length_m for episode in successes])
    cell["time_to_goal_s"] = _mean([episode.time_to_goal_s for episode in successes])
    known = [episode for episode in successes if episode.reference_time_s is not None]
    cell["time_over_reference"] = _mean([episode.duration_s / (episode.reference_time_s or 1.0) for episode in known])
    cell["spl"] = _mean([episode.spl for episode in episodes])
    cell["clearance_m"] = _mean([episode.clearance_m for episode in episodes])
    cell["clearance_people_m"] = _mean([episode.clearance_people_m for episode in episodes])
    cell["personal_space"] = _mean([episode.personal_space for episode in episodes])
    cell["jerk_m_s3"] = _mean([episode.jerk_m_s3 for episode in episodes])
    changes = sum(episode.w_sign_changes for episode in episodes)
    cell["w_sign_changes_per_m"] = changes / driven_m if driven_m > 0 else None
    return cell


def _least(distances_m: Float[np.ndarray, "T"]) -> float | None:
    """None where there was nothing to be near to."""
    least = float(distances_m.min())
    return least if math.isfinite(least) else None


def _mean(values: Sequence[float | None]) -> float | None:
    known = [value for value in values if value is not None]
    return float(np.mean(known)) if known else None
