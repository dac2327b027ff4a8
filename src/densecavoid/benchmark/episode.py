"""What one episode left behind: the robot's way through a world, and how it ended. A record, without judgement."""

from __future__ import annotations

import math
from dataclasses import dataclass
from typing import NamedTuple

import numpy as np
from jaxtyping import Float, Float32, Int32

from densecavoid.frames import choose, require
from densecavoid.sim.floorplan import FloorPlan

OUTCOMES = ("success", "collision", "timeout")


class PeopleTracks(NamedTuple):
    """Everybody's places during an episode, one row for each person and instant, in the order of the instants."""

    instant: Int32[np.ndarray, "M"]
    """Which row of the episode's `time_s`."""
    id: Int32[np.ndarray, "M"]
    pos_w: Float32[np.ndarray, "M 2"]
    radius_m: Float32[np.ndarray, "M"]

    def of(self, person: int) -> PeopleTracks:
        """The rows of one person."""
        return PeopleTracks(*(column[self.id == person] for column in self))


@dataclass(frozen=True)
class Episode:
    """One episode in T control steps. What is known at an instant has T + 1 rows, what holds during a step has T."""

    scenario: str
    navigator: str
    seed: int
    outcome: str
    """One of OUTCOMES."""
    collided_person: bool
    """Whether a collision was with a person; else it was with a thing."""
    robot_approached: bool
    """Whether the robot moved faster than .1 m/s towards that person in the last .5 s."""
    time_s: Float[np.ndarray, "T1"]
    pose_w: Float[np.ndarray, "T1 3"]
    velocity: Float[np.ndarray, "T1 2"]
    """Linear (m/s) and angular (rad/s) velocity that the robot really had."""
    command: Float[np.ndarray, "T 2"]
    clearance_m: Float[np.ndarray, "T"]
    """Least distance during the step from the robot's centre to anything."""
    clearance_people_m: Float[np.ndarray, "T"]
    """The same to people's bodies; inf where there is nobody."""
    goal_w: Float[np.ndarray, "2"]
    spawn_time_s: float = math.nan
    """When people appeared suddenly; NaN if they did not."""
    spawn_line_x: float = math.nan
    """World x of the line that they appeared on; the robot passes it along +x."""
    floor_plan: FloorPlan | None = None
    people: PeopleTracks | None = None

    def __post_init__(self) -> None:
        choose("outcome", self.outcome, OUTCOMES)
        steps = len(self.time_s) - 1
        require(steps >= 1, "Episode.time_s", self.time_s, "at least two instants")
        for name, rows in (("pose_w", steps + 1), ("velocity", steps + 1), ("command", steps), ("clearance_m", steps)):
            require(len(getattr(self, name)) == rows, f"rows of Episode.{name}", len(getattr(self, name)), f"{rows}")

    @property
    def start_pose_w(self) -> Float[np.ndarray, "3"]:
        return self.pose_w[0]

    @property
    def duration_s(self) -> float:
        return float(self.time_s[-1] - self.time_s[0])
