"""A recorded crowd in the form that the simulator replays. Reading files is the scenarios' part."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from jaxtyping import Float32, Int32, Int64

from densecavoid.frames import require


@dataclass(frozen=True, eq=False)
class Recording:
    """A recorded crowd, resampled: rows grouped by time step, sorted by person within a step. Cached: do not write.

    One id of the file that leaves and comes back is two people here. The rows of step t, at t * dt_s since the file's
    first frame, are `frame_start[t]` to `frame_start[t + 1]` (not included).
    """

    dt_s: float
    frame_start: Int32[np.ndarray, "starts"]
    state_w: Float32[np.ndarray, "rows 4"]
    """x, y (m), vx, vy (m/s)."""
    person: Int32[np.ndarray, "rows"]
    """0 to num_people - 1."""
    height_m: Float32[np.ndarray, "people"]
    radius_m: Float32[np.ndarray, "people"]
    file_id: Int64[np.ndarray, "people"]
    """The person's number in the file."""

    def __post_init__(self) -> None:
        require(1e-3 <= self.dt_s <= 1, "Recording.dt_s", self.dt_s, "from .001 to 1 s")
        start = self.frame_start
        require(len(start) >= 2 and not start[0], "Recording.frame_start", start[:2], "to begin with 0")
        require(bool(np.all(np.diff(start) >= 0)), "Recording.frame_start", start, "never to fall")
        require(
            int(start[-1]) == len(self.person), "Recording.frame_start[-1]", int(start[-1]), f"{len(self.person)} rows"
        )

    @property
    def num_steps(self) -> int:
        return len(self.frame_start) - 1

    @property
    def duration_s(self) -> float:
        """From the first step to the last."""
        return (self.num_steps - 1) * self.dt_s

    @property
    def num_people(self) -> int:
        return len(self.radius_m)

    @property
    def max_people(self) -> int:
        """The most people present at once."""
        return int(np.diff(self.frame_start).max())

    def at(self, step: int) -> tuple[Int32[np.ndarray, "present"], Float32[np.ndarray, "present 4"]]:
        """Who is present at a step, and their states."""
        require(0 <= step < self.num_steps, "step", step, f"from 0 to {self.num_steps - 1}")
        rows = slice(self.frame_start[step], self.frame_start[step + 1])
        return self.person[rows], self.state_w[rows]
