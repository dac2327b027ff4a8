"""The robot's loop without ROS: messages in, a safe velocity and the reason for it out. Both nodes, replay and the
fault campaign run this one class; they differ in where messages come from.

Times: `now_s` is a steady clock, `ros_now_s` the clock that stamps are made with.
"""

from __future__ import annotations

import dataclasses
import math
from collections.abc import Callable, Iterable
from dataclasses import dataclass
from typing import Any, TypeVar

import numpy as np

from densecavoid.frames import SensorFrame
from densecavoid.robot import messages
from densecavoid.robot.camera_mount import CameraMount
from densecavoid.robot.config import RobotSettings
from densecavoid.robot.pilot import InThread, InTurn, Pilot, blank_frame
from densecavoid.robot.reprojection import reproject
from densecavoid.robot.transforms import TransformTree
from densecavoid.robot.watchdog import SensorLimits, Watchdog, WatchdogConfig
from densecavoid.safety import NOBODY, PeopleNear, SafeCommand, SafetyFilter

T = TypeVar("T")
MALFORMED = (ValueError, TypeError, AttributeError, OverflowError, IndexError, KeyError)
"""What reading a message of the wrong shape raises."""
_FILTER_POINTS = 1500
_FILLING = 0.9  # share of the rays within the camera's view that must end too near for it
_GAP_S = 0.5
"""After a longer time without frames, scans and tracks of before are forgotten."""


@dataclass(frozen=True)
class Step:
    """What the loop decided at one instant."""

    command: SafeCommand
    fault: str
    """Why the robot must stand; empty if nothing is wrong."""
    goal_reached: bool
    goal_distance_m: float
    """NaN without a goal."""
    goal_odom: tuple[float, float] | None
    """Where it is in the odometry frame; None without a goal, and where its frame is lost."""
    people: PeopleNear
    asked: tuple[float, float]
    """What the policy asked for last."""

    @property
    def level(self) -> int:
        """As in diagnostic_msgs: 0 fine, 1 slowed down or escaping, 2 stopped by a fault."""
        return 2 if self.fault else 0 if self.command.action in ("pass", "limit") else 1

    @property
    def message(self) -> str:
        """One line for people."""
        return self.fault or self.command.reason or "driving"


class RobotRuntime:
    """Owns the last good message of each sensor, the goal, the watchdog and the filter of one robot."""

    def __init__(self, pilot: Pilot, settings: RobotSettings, *, threaded: bool) -> None:
        """
        Args:
            pilot: who decides.
            settings: of this robot.
            threaded: the pilot in a thread of its own (robots), or in turn (recordings, tests).
        """
        self.settings = settings
        self.pilot = pilot
        limits = {
            "scan": SensorLimits(settings.max_age_s, settings.scan_frame),
            "depth": SensorLimits(settings.max_age_s, settings.depth_frame, required=settings.use_camera),
            "odom": SensorLimits(settings.max_age_s, settings.odom_frame),
        }
        self.watchdog = Watchdog(WatchdogConfig(limits, policy_timeout_s=settings.max_age_s))
        self.filter = SafetyFilter(settings.safety)
        self.transforms = TransformTree()
        self._worker = InThread(pilot) if threaded else InTurn(pilot)
        self._resample_depth = messages.DepthResampler(pilot.camera)
        blank = blank_frame(pilot.lidar, pilot.camera)
        self._scan_m, self._depth_m = blank.scan_m, blank.depth_m
        self._intrinsics: messages.Intrinsics | None = None
        self._odometry: messages.Odometry | None = None
        self._goal: messages.Goal | None = None
        self._reached = False
        self._people = NOBODY
        self._asked = (0.0, 0.0)
        self._submitted_s = -math.inf
        self._afresh = True
        self._mounts: dict[str, messages.Mount] = {}
        self._camera_mounts: dict[str, CameraMount] = {}
        self._policys_place = CameraMount.of(pilot.camera)
        self.camera_place = "no image yet"
        """Where depth images are taken from, and who says so; for people."""
        self.goal_number = 0
        """Rises with every goal that comes, is refused or is taken away: whoever gave one sees that it is another."""

    @property
    def pose_odom(self) -> tuple[float, float, float] | None:
        """x, y (m), yaw (rad) by the last good odometry; None before it."""
        return self._odometry.pose if self._odometry is not None else None

    def warm_up(self) -> None:
        """Everything once, so that nothing is compiled, loaded or allocated at the first message."""
        frame = blank_frame(self.pilot.lidar, self.pilot.camera)
        if self.settings.use_camera and (self.settings.use_tf or self.settings.camera_mount is not None):
            blank = messages.DepthImage(0.0, "", frame.depth_m[0])
            reproject(blank, None, self._policys_place, self.pilot.camera)
        for _ in range(3):
            self.pilot.act(frame)
        self.pilot.people((0.0, 0.0, 0.0))
        self.pilot.reset()

    def close(self) -> None:
        """Ends the pilot's thread."""
        self._worker.close()

    # -- messages in ---------------------------------------------------------------------------------------------------

    def on_scan(self, message: Any, now_s: float, ros_now_s: float) -> str:
        """A LaserScan. Each `on_` method returns why the message was not used, or nothing."""
        scan = self._read("scan", messages.scan_from_ros, message)
        if scan is None:
            return self.watchdog.reason("scan")
        lidar = self.pilot.lidar
        ranges = messages.clean_ranges(scan, self.settings.zero_range, self.settings.ignore_within_m)
        fault, mount = self._mount_of(scan.frame, now_s)
        resampled, seen = messages.resample_scan(scan, ranges, mount, lidar)
        fault = fault or self._blindness(seen)
        refused = self.watchdog.check("scan", now_s, ros_now_s, scan.stamp_s, scan.frame, ranges.shape, fault)
        if refused:
            return refused
        self._scan_m = resampled[None]
        ends, _ = messages.scan_in_robot(scan, ranges, mount)
        ends = ends[np.isfinite(ranges)]
        self.filter.scan(now_s, self.settings.safety.sources[0], ends[:: max(1, len(ends) // _FILTER_POINTS)])
        return ""

    def on_depth(self, message: Any, now_s: float, ros_now_s: float) -> str:
        """An Image of depth."""
        if not self.settings.use_camera:
            return ""
        image = self._read("depth", messages.depth_from_ros, message)
        if image is None:
            return self.watchdog.reason("depth")
        depth, fault = None, ""
        mount = self._camera_mount_of(image.frame, now_s)
        try:
            if mount is None:
                depth, why = self._resample_depth(image, self._intrinsics), "covered?"
            else:
                depth, why = reproject(image, self._intrinsics, mount, self.pilot.camera), "covered, or mounted so?"
            share = float(np.isfinite(depth).mean())
            if share < self.settings.min_depth_share and not self._is_view_filled():
                fault = f"only {share:.1%} of its pixels have depth: {why}"
        except ValueError as error:
            fault = str(error)
        refused = self.watchdog.check("depth", now_s, ros_now_s, image.stamp_s, image.frame, image.shape, fault)
        if not refused and depth is not None:
            self._depth_m = depth[None]
        return refused

    def on_camera_info(self, message: Any) -> str:
        """A CameraInfo. One that is malformed is as none: the field of view of the training."""
        try:
            self._intrinsics = messages.intrinsics_from_ros(message)
        except MALFORMED as error:
            return f"camera_info: {error}"
        return ""

    def on_odom(self, message: Any, now_s: float, ros_now_s: float) -> str:
        """An Odometry."""
        odometry = self._read("odom", messages.odometry_from_ros, message)
        if odometry is None:
            return self.watchdog.reason("odom")
        refused = self.watchdog.check("odom", now_s, ros_now_s, odometry.stamp_s, odometry.frame)
        if not refused:
            self._odometry = odometry
        return refused

    def on_goal(self, message: Any, now_s: float) -> str:
        """A PoseStamped, in any frame. One relative to the robot is fixed in the odometry frame at once.

        Returns:
            Why it is refused; a refused goal also ends the one before, because that is no longer wanted.
        """
        self._goal, self._reached = None, False
        self.goal_number += 1
        try:
            goal = messages.goal_from_ros(message)
            if goal.frame.lstrip("/") == self.settings.base_frame:
                if self._odometry is None:
                    raise ValueError("a goal relative to the robot, and no odometry yet")
                goal = messages.Goal(goal.stamp_s, self.settings.odom_frame, self._from_robot(goal.pos))
        except MALFORMED as error:
            self.watchdog.goal(f"goal refused: {error}")
            return str(error)
        self._goal, self._afresh = goal, True
        self.filter.forget_freezing()
        self.watchdog.goal("")
        return ""

    def end_goal(self, why: str) -> None:
        """Takes the goal away: the robot stands from the next step on, and `why` is the reason that it gives."""
        self._goal, self._reached = None, False
        self.goal_number += 1
        self.watchdog.goal(why)

    def on_transforms(self, transforms: Iterable[Any], now_s: float, static: bool) -> list[str]:
        """The transforms of a TFMessage; returns what was wrong with those refused."""
        try:
            return self.transforms.take(transforms, now_s, static)
        except MALFORMED as error:
            return [str(error)]

    def sensed(self, now_s: float) -> SensorFrame | None:
        """What the last good messages say together, without a goal (NaN); None before the first odometry."""
        if self._odometry is None:
            return None
        return SensorFrame(
            time_s=np.array([now_s]),
            scan_m=self._scan_m,
            depth_m=self._depth_m,
            odom_pose=np.array([self._odometry.pose]),
            velocity=np.array([self._odometry.velocity], np.float32),
            goal_odom=np.full((1, 2), np.nan),
        )

    # -- the velocity out ----------------------------------------------------------------------------------------------

    def step(self, now_s: float, ros_now_s: float) -> Step:
        """To be called at `control_hz`, whatever comes in."""
        if self.watchdog.tick(now_s, ros_now_s):
            self.transforms.clear()
            self._afresh = True
        distance, goal_odom = self._toward_goal(now_s)
        if distance < self.settings.goal_tolerance_m:
            self._goal, self._reached = None, True
            self.watchdog.goal("goal reached")
        blocked = self.watchdog.sensors_fault(now_s)
        if not blocked and self._goal is not None and goal_odom is not None:
            self._ask(now_s, goal_odom)
        self._take(now_s)
        fault = self.watchdog.fault(now_s)
        pose = self.pose_odom
        command = self.filter.update(
            now_s, pose[:2] if pose is not None else None, fault, wants_to_drive=self._goal is not None
        )
        return Step(command, fault, self._reached, distance, goal_odom, self._people, self._asked)

    def _ask(self, now_s: float, goal_odom: tuple[float, float]) -> None:
        # A little early counts as due: timers jitter.
        if now_s - self._submitted_s < 0.8 / self.settings.policy_hz:
            return
        sensed = self.sensed(now_s)
        if sensed is None:
            return
        frame = dataclasses.replace(sensed, goal_odom=np.array([goal_odom]))
        afresh = self._afresh or now_s - self._submitted_s > _GAP_S
        if self._worker.submit(frame, afresh):
            self._submitted_s, self._afresh = now_s, False

    def _take(self, now_s: float) -> None:
        outcome = self._worker.poll()
        if outcome is None or now_s - outcome.seen_at_s > self.watchdog.config.policy_timeout_s:
            return  # decided on what was seen too long ago: as if it had not been decided
        if outcome.command is None:
            self.watchdog.policy_failed(outcome.failure)
            self._afresh = True
            return
        if not all(map(math.isfinite, outcome.command)):
            self.watchdog.policy_failed(f"command {outcome.command} is not finite")
            self._afresh = True
            return
        self._asked, self._people = outcome.command, outcome.people
        self.watchdog.policy_acted(now_s)
        self.filter.command(now_s, *outcome.command)
        self.filter.people(outcome.people)

    def _toward_goal(self, now_s: float) -> tuple[float, tuple[float, float] | None]:
        if self._goal is None:
            return math.nan, None
        goal = self._goal
        try:
            if goal.frame.lstrip("/") == self.settings.odom_frame:
                pos = goal.pos
            elif self.settings.use_tf:
                pose = self.transforms.look_up(
                    self.settings.odom_frame, goal.frame, now_s, self.settings.max_transform_age_s
                )
                pos = pose.apply(*goal.pos)
            else:
                raise ValueError(f"its frame is {goal.frame!r}, expected {self.settings.odom_frame!r} without TF")
        except ValueError as error:
            self.watchdog.goal(f"goal lost: {error}")
            return math.nan, None
        self.watchdog.goal("")
        if self._odometry is None:
            return math.nan, None
        return math.dist(pos, self._odometry.pose[:2]), pos

    def _from_robot(self, point: tuple[float, float]) -> tuple[float, float]:
        assert self._odometry is not None
        x, y, yaw = self._odometry.pose
        cos, sin = math.cos(yaw), math.sin(yaw)
        return x + cos * point[0] - sin * point[1], y + sin * point[0] + cos * point[1]

    def _mount_of(self, frame: str, now_s: float) -> tuple[str, messages.Mount]:
        if self.settings.lidar_mount is not None:
            return "", self.settings.lidar_mount
        if not self.settings.use_tf:
            return "", messages.Mount()
        if frame not in self._mounts:
            try:
                pose = self.transforms.look_up(
                    self.settings.base_frame, frame, now_s, self.settings.max_transform_age_s
                )
                self._mounts[frame] = messages.Mount(pose.x, pose.y, pose.yaw, pose.flipped)
            except ValueError as error:
                return str(error), messages.Mount()
        return "", self._mounts[frame]

    def _camera_mount_of(self, frame: str, now_s: float) -> CameraMount | None:
        """Where the depth camera sits; None where the policy's camera sat, as near as matters.

        A place that is not known is no fault, unlike a scanner's: the filter, which prevents collisions, does without
        images, and robots and recordings that never had a camera in TF would stand. `camera_place` says so instead.
        """
        mount, policys, who = self.settings.camera_mount, self._policys_place, "settings"
        if mount is None and self.settings.use_tf:
            who = "TF"
            if frame not in self._camera_mounts:
                try:
                    transform = self.transforms.look_up_3d(
                        self.settings.base_frame, frame, now_s, self.settings.max_transform_age_s
                    )
                    self._camera_mounts[frame] = CameraMount.from_transform(transform, frame)
                except ValueError as error:
                    self.camera_place = f"taken for the policy's ({policys}): {error}"
                    return None
            mount = self._camera_mounts[frame]
        if mount is None:
            self.camera_place = f"taken for the policy's ({policys}): no camera_mount, and no TF"
            return None
        is_same = mount.is_as(policys)
        self.camera_place = f"{mount} ({who}), {'as the policy had it' if is_same else 'reprojected'}"
        return None if is_same else mount

    def _is_view_filled(self) -> bool:
        """Whether the scan says that something nearer than the camera can measure stands across its whole view: then
        there is no depth to be had, and nothing is wrong with the camera."""
        ahead = np.abs(self.pilot.lidar.angles_rad) <= self.pilot.camera.fov_horizontal_rad / 2
        return float((self._scan_m[0, ahead] < self.pilot.camera.min_range_m).mean()) >= _FILLING

    def _blindness(self, seen: np.ndarray) -> str:
        """What is wrong with where the scanner looks: too little straight ahead, or a wide gap."""
        angles = self.pilot.lidar.angles_rad
        ahead = seen[np.abs(angles) <= math.pi / 4]
        if ahead.mean() < self.settings.min_lidar_share:
            return f"sees {ahead.mean():.0%} of what is straight ahead"
        front = np.flatnonzero(np.abs(angles) <= math.pi / 2)
        edges = np.concatenate([[front[0] - 1], front[seen[front]], [front[-1] + 1]])
        gap = np.diff(edges)
        widest = int(np.argmax(gap))
        width = (gap[widest] - 1) * (angles[1] - angles[0])
        if width > self.settings.max_blind_rad:
            start = math.degrees(angles[min(edges[widest] + 1, len(angles) - 1)])
            return f"blind over {math.degrees(width):.0f} degrees from {start:.0f} on"
        return ""

    def _read(self, sensor: str, reader: Callable[[Any], T], message: Any) -> T | None:
        try:
            return reader(message)
        except MALFORMED as error:
            self.watchdog.malformed(sensor, str(error))
            return None
