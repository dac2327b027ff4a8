"""Who decides where to drive, run so that it cannot hold up the wheels: in a thread of its own, or, for replay and
tests, in turn. Knows no ROS.
"""

from __future__ import annotations

import threading
from typing import NamedTuple, Protocol, runtime_checkable

import numpy as np

from densecavoid.frames import CameraConfig, LidarConfig, SensorFrame
from densecavoid.safety import NOBODY, PeopleNear


@runtime_checkable
class Pilot(Protocol):
    """A navigator of one robot that says what it must see."""

    @property
    def name(self) -> str: ...

    @property
    def lidar(self) -> LidarConfig: ...

    @property
    def camera(self) -> CameraConfig: ...

    def reset(self) -> None:
        """Forget what was seen: a new goal, or a gap."""
        ...

    def act(self, frame: SensorFrame) -> tuple[float, float]:
        """Linear (m/s) and angular (rad/s) velocity."""
        ...

    def people(self, pose: tuple[float, float, float]) -> PeopleNear:
        """Everybody tracked, seen from a pose in the odometry frame."""
        ...

    def prediction(self) -> np.ndarray | None:
        """The prediction frame of the last act, if there is one."""
        ...


class Outcome(NamedTuple):
    """What came of one frame."""

    command: tuple[float, float] | None
    people: PeopleNear
    failure: str
    """What the pilot raised; empty if it did not."""
    seen_at_s: float
    """When the frame was made that it was decided on."""


def _act(pilot: Pilot, frame: SensorFrame, afresh: bool) -> Outcome:
    seen_at_s = float(frame.time_s[0])
    try:
        if afresh:
            pilot.reset()
        linear, angular = pilot.act(frame)
        x, y, yaw = (float(value) for value in frame.odom_pose[0])
        return Outcome((float(linear), float(angular)), pilot.people((x, y, yaw)), "", seen_at_s)
    except Exception as error:  # whatever it is, the wheels must stop and say why
        return Outcome(None, NOBODY, f"{type(error).__name__}: {error}", seen_at_s)


class InTurn:
    """Acts while the caller waits: for recordings, simulators and tests, where time is not the wall's."""

    def __init__(self, pilot: Pilot) -> None:
        self._pilot = pilot
        self._outcome: Outcome | None = None

    def submit(self, frame: SensorFrame, afresh: bool) -> bool:
        """Acts at once."""
        self._outcome = _act(self._pilot, frame, afresh)
        return True

    def poll(self) -> Outcome | None:
        """The outcome that was not fetched yet."""
        outcome, self._outcome = self._outcome, None
        return outcome

    def close(self) -> None:
        """Nothing to end."""


class InThread:
    """Acts in a thread. While it is busy, frames are not taken: the watchdog sees that commands are missing."""

    def __init__(self, pilot: Pilot) -> None:
        self._pilot = pilot
        self._lock = threading.Condition()
        self._work: tuple[SensorFrame, bool] | None = None
        self._busy = False
        self._afresh = False
        self._outcome: Outcome | None = None
        self._closed = False
        self._thread = threading.Thread(target=self._run, name="pilot", daemon=True)
        self._thread.start()

    def submit(self, frame: SensorFrame, afresh: bool) -> bool:
        """Hands a frame over; its arrays must not be written to any more.

        Returns:
            Whether it was taken.
        """
        with self._lock:
            # Whoever had to forget and was busy forgets with the next frame.
            self._afresh |= afresh
            if self._busy:
                return False
            self._work, self._busy, self._afresh = (frame, self._afresh), True, False
            self._lock.notify()
            return True

    def poll(self) -> Outcome | None:
        """The outcome that was not fetched yet."""
        with self._lock:
            outcome, self._outcome = self._outcome, None
            return outcome

    def close(self) -> None:
        """Ends the thread as soon as it has nothing to do."""
        with self._lock:
            self._closed = True
            self._lock.notify()

    def _run(self) -> None:
        while True:
            with self._lock:
                self._lock.wait_for(lambda: self._work is not None or self._closed)
                if self._work is None:
                    return
                (frame, afresh), self._work = self._work, None
            outcome = _act(self._pilot, frame, afresh)
            with self._lock:
                self._outcome, self._busy = outcome, False


def blank_frame(lidar: LidarConfig, camera: CameraConfig) -> SensorFrame:
    """A frame in which nothing is seen: to warm up with, and to fill."""
    return SensorFrame(
        time_s=np.zeros(1),
        scan_m=np.full((1, lidar.num_rays), np.inf, np.float32),
        depth_m=np.full((1, camera.height, camera.width), np.nan, np.float32),
        odom_pose=np.zeros((1, 3)),
        velocity=np.zeros((1, 2), np.float32),
        goal_odom=np.array([[3.0, 0.0]]),
    )
