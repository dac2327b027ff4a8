"""What perception is told: its sensors, where people's places come from, and how they are predicted and drawn."""

from __future__ import annotations

from dataclasses import dataclass, field
from typing import Literal, get_args

from densecavoid.frames import CameraConfig, LidarConfig, choose, require

PeopleFrom = Literal["detector", "boxes", "truth", "nothing"]
PredictorName = Literal["constant-velocity", "kalman", "robust-tp", "compact"]


def check_ahead(name: str, times_s: tuple[float, ...]) -> None:
    """
    Raises:
        ValueError: if times are not ascending from above 0 to 5 s, or there is none.
    """
    require(len(times_s) > 0 and list(times_s) == sorted(set(times_s)), name, times_s, "one or more, ascending")
    require(all(0.0 < time_s <= 5.0 for time_s in times_s), name, times_s, "above 0, at most 5 s")


@dataclass(frozen=True)
class PerceptionConfig:
    """How people are perceived."""

    lidar: LidarConfig = field(default_factory=LidarConfig)
    camera: CameraConfig = field(default_factory=CameraConfig)
    people_from: PeopleFrom = "truth"
    """detector: the network on each depth image, and legs in the scan: what a robot has. boxes: true places through the
    detector's errors, and legs: the same for hundreds of worlds, in training. truth: exact places of visible people.
    nothing: an empty prediction frame."""
    predictor: PredictorName = "constant-velocity"
    horizons_s: tuple[float, ...] = (0.8,)
    """How far ahead the prediction frame looks; several are drawn in ever lighter shades."""
    soft: bool = False
    """Draw how likely each pixel is taken, instead of boxes."""
    control_dt_s: float = 0.1
    threads: int = 0

    def __post_init__(self) -> None:
        choose("people_from", self.people_from, get_args(PeopleFrom))
        choose("predictor", self.predictor, get_args(PredictorName))
        check_ahead("horizons_s", self.horizons_s)
        require(self.control_dt_s > 0, "control_dt_s", self.control_dt_s, "positive")
        require(self.threads >= 0, "threads", self.threads, "0 (all cores) or more")

    @property
    def privileged(self) -> bool:
        """Whether ground truth is needed."""
        return self.people_from in ("boxes", "truth")
