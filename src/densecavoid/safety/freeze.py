"""Whether the robot is frozen, and the turn that gets it out: towards the freest direction, then it is handed back.

Frozen is as in the benchmark's definition: hardly any net displacement over a while, although it wants to drive;
standing and swinging to and fro are the same. Turning in place is all that the escape does: a disc sweeps nothing then.
"""

from __future__ import annotations

import math
from collections import deque

import numpy as np
from jaxtyping import Float

from densecavoid.safety.approach import PeopleNear
from densecavoid.safety.config import FreezeConfig

_DIRECTIONS = np.linspace(-math.pi, math.pi, 48, endpoint=False)
_LOOK_AHEAD_S = (0.0, 1.0, 2.0)


def free_way_m(
    points: Float[np.ndarray, "n 2"], people: PeopleNear, half_width_m: float, reach_m: float
) -> Float[np.ndarray, "directions"]:
    """How far a strip of the robot's width reaches in each of 48 directions, past returns and people now and soon."""
    soon = [people.pos_r + ahead * people.vel_r for ahead in _LOOK_AHEAD_S]
    things = np.concatenate([points, *soon])
    extra = np.concatenate([np.zeros(len(points)), *([people.radius_m] * len(soon))])
    if len(things) == 0:
        return np.full(len(_DIRECTIONS), reach_m)
    cos, sin = np.cos(_DIRECTIONS)[:, None], np.sin(_DIRECTIONS)[:, None]
    along = cos * things[:, 0] + sin * things[:, 1]
    aside = np.abs(cos * things[:, 1] - sin * things[:, 0])
    ahead = (along > 0) & (aside < half_width_m + extra)
    return np.where(ahead, np.minimum(along - extra, reach_m), reach_m).min(axis=1).clip(0.0)


def freest_direction(
    points: Float[np.ndarray, "n 2"], people: PeopleNear, half_width_m: float, reach_m: float
) -> float:
    """Bearing (rad) of the longest free way; of equal ones, that which takes the least turn."""
    way = free_way_m(points, people, half_width_m, reach_m)
    return float(_DIRECTIONS[np.argmax(np.round(way, 2) - 1e-3 * np.abs(_DIRECTIONS))])


class FreezeGuard:
    """Owns the track of the last seconds and the state of an escape."""

    def __init__(self, config: FreezeConfig) -> None:
        self.config = config
        self._past: deque[tuple[float, float, float]] = deque()
        self._turning_since: float | None = None
        self._turn = 0.0

    @property
    def escaping(self) -> bool:
        """Whether the robot is turning out of it."""
        return self._turning_since is not None

    def forget(self) -> None:
        """A new goal, or nothing to do: what was before does not count."""
        self._past.clear()
        self._turning_since = None

    def update(
        self,
        now_s: float,
        pos_odom: tuple[float, float],
        wants_to_drive: bool,
        points: Float[np.ndarray, "n 2"],
        people: PeopleNear,
        half_width_m: float,
    ) -> float | None:
        """Takes in where the robot is.

        Returns:
            The turn rate of the escape (rad/s), or None: drive on.
        """
        config = self.config
        if not config.enabled or not wants_to_drive:
            self.forget()
            return None
        past = self._past
        if past and now_s < past[-1][0]:
            self.forget()
        past.append((now_s, *pos_odom))
        while len(past) > 1 and past[1][0] <= now_s - config.window_s:
            past.popleft()
        if self._turning_since is None:
            if now_s - past[0][0] < config.window_s:
                return None
            if math.dist(past[0][1:], pos_odom) >= config.distance_m:
                return None
            self._turning_since = now_s
            bearing = freest_direction(points, people, half_width_m, config.reach_m)
            self._turn = math.copysign(config.turn_rate, bearing)
        bearing = freest_direction(points, people, half_width_m, config.reach_m)
        if abs(bearing) < config.aligned_rad or now_s - self._turning_since > config.max_turn_s:
            self.forget()
            return None
        return self._turn
