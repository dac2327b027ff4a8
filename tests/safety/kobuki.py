"""A base that obeys like a Kobuki: what the filter is tried on. Not the project's simulator."""

from __future__ import annotations

import math
from dataclasses import dataclass, field

import numpy as np

from densecavoid.safety import PeopleNear


@dataclass
class Kobuki:
    """Obeys one control step late, with 1.0 m/s2 and 3.5 rad/s2, and stops without commands for .6 s."""

    pose: list[float] = field(default_factory=lambda: [0.0, 0.0, 0.0])
    velocity: tuple[float, float] = (0.0, 0.0)
    _late: tuple[float, float] = (0.0, 0.0)
    silent_s: float = 0.0

    def drive(self, command: tuple[float, float] | None, dt: float) -> None:
        """One control step of `dt` s in small steps; None: no command arrives."""
        self.silent_s = 0.0 if command is not None else self.silent_s + dt
        target = self._late if self.silent_s < 0.6 else (0.0, 0.0)
        if command is not None:
            self._late = command
        for _ in range(10):
            step = dt / 10
            linear, angular = self.velocity
            linear += min(max(target[0] - linear, -step), step)
            angular += min(max(target[1] - angular, -3.5 * step), 3.5 * step)
            self.velocity = (linear, angular)
            self.pose[0] += linear * step * math.cos(self.pose[2])
            self.pose[1] += linear * step * math.sin(self.pose[2])
            self.pose[2] += angular * step

    def to_robot(self, points: np.ndarray) -> np.ndarray:
        """World points in the robot's frame."""
        offset = points - np.array(self.pose[:2])
        return self.turn(offset)

    def turn(self, vectors: np.ndarray) -> np.ndarray:
        """World vectors along the robot's axes."""
        cos, sin = math.cos(self.pose[2]), math.sin(self.pose[2])
        return np.stack([cos * vectors[:, 0] + sin * vectors[:, 1], cos * vectors[:, 1] - sin * vectors[:, 0]], axis=1)

    def people(self, pos_w: np.ndarray, vel_w: np.ndarray, radius_m: float = 0.25) -> PeopleNear:
        """As the filter wants them."""
        return PeopleNear(self.to_robot(pos_w), self.turn(vel_w), np.full(len(pos_w), radius_m))


def wall(x: float, width: float = 1.0, spacing: float = 0.02) -> np.ndarray:
    """Returns of a wall across the way, `x` ahead."""
    y = np.arange(-width / 2, width / 2, spacing)
    return np.stack([np.full(len(y), x), y], axis=1)
