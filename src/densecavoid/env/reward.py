"""The paper's reward as named terms (paper, Reward Function; FACTS of the published version where the two differ)."""

from __future__ import annotations

import math
from dataclasses import dataclass
from typing import Literal, NamedTuple

import numpy as np
from jaxtyping import Bool, Float

from densecavoid.frames import choose, require


@dataclass(frozen=True)
class RewardConfig:
    """Weights and thresholds; the defaults are the paper's."""

    form: Literal["published", "text"] = "published"
    """Oscillation and safe distance as in the published equations (changes of angular velocity; nearness) or as in the
    text (angular velocity itself; distance short of the lidar's range)."""
    goal: float = 20.0
    waypoint: float = 10.0
    waypoint_distance_m: float = 0.2
    collision: float = -20.0
    progress: float = 2.5
    """Per metre nearer to the goal."""
    oscillation: float = -0.1
    oscillation_threshold: float = 0.3
    """rad/s."""
    safe_distance: float = -0.1
    """Per metre nearer than the threshold, each step."""
    safe_distance_threshold_m: float = 0.8
    """From the robot's centre to the nearest surface; the published text leaves it open."""

    def __post_init__(self) -> None:
        choose("RewardConfig.form", self.form, ("published", "text"))
        for name in self.__dataclass_fields__:
            value = getattr(self, name)
            if name != "form":
                require(math.isfinite(value), f"RewardConfig.{name}", value, "finite")


class Transition(NamedTuple):
    """What the reward is computed from, after one control step."""

    distance_before_m: Float[np.ndarray, "B"]
    distance_m: Float[np.ndarray, "B"]
    """From the robot to the goal."""
    succeeded: Bool[np.ndarray, "B"]
    reached_waypoint: Bool[np.ndarray, "B"]
    """A waypoint was reached for the first time."""
    collided: Bool[np.ndarray, "B"]
    angular_before: Float[np.ndarray, "B"]
    angular: Float[np.ndarray, "B"]
    """Angular velocity, rad/s."""
    clearance_m: Float[np.ndarray, "B"]
    """From the robot's centre to the nearest surface."""
    lidar_shortfall_m: Float[np.ndarray, "B"]
    """The lidar's greatest range less the nearest range."""


def reward_terms(config: RewardConfig, step: Transition) -> dict[str, Float[np.ndarray, "B"]]:
    """The terms of the reward, whose sum it is; goal, waypoint and progress exclude each other (paper, eq. r_g)."""
    goal = np.where(step.succeeded, config.goal, 0.0)
    waypoint = np.where(step.reached_waypoint & ~step.succeeded, config.waypoint, 0.0)
    on_the_way = ~step.succeeded & ~step.reached_waypoint
    progress = np.where(on_the_way, config.progress * (step.distance_before_m - step.distance_m), 0.0)
    if config.form == "published":
        turning = np.abs(step.angular - step.angular_before)
        shortfall = np.maximum(config.safe_distance_threshold_m - step.clearance_m, 0.0)
    else:
        turning = np.abs(step.angular)
        shortfall = np.abs(step.lidar_shortfall_m)
    return {
        "goal": goal,
        "waypoint": waypoint,
        "progress": progress,
        "collision": np.where(step.collided, config.collision, 0.0),
        "oscillation": np.where(turning > config.oscillation_threshold, config.oscillation * turning, 0.0),
        "safe_distance": config.safe_distance * shortfall,
    }
