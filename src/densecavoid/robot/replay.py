"""`densecavoid replay`: a recording through the robot's loop, as if it were there now. The robot in it went its own
way: this shows what would have been commanded at each instant, not where that would have led. Draws nothing: whoever
wants pictures (`viz.replay_film`) is called at each step.
"""

from __future__ import annotations

import dataclasses
import json
import math
import time
from collections.abc import Callable
from dataclasses import dataclass
from pathlib import Path
from types import SimpleNamespace as Message
from typing import Any, Literal, TextIO

import numpy as np
import tyro

from densecavoid.frames import SensorFrame, choose, require
from densecavoid.policy.folder_export import export_folder
from densecavoid.robot.bags import Bag, Recorded, Recorder, Topics
from densecavoid.robot.config import RobotSettings, load_settings
from densecavoid.robot.folder import FolderPilot
from densecavoid.robot.messages import Mount, stamp_of
from densecavoid.robot.runtime import RobotRuntime, Step


@dataclass(frozen=True)
class ReplayConfig:
    """A recording to run through the robot's loop."""

    bag: tyro.conf.Positional[Path]
    """A ROS 1 .bag, or a ROS 2 .mcap or .db3 file or folder."""
    folder: Path | None = None
    """Exported folder; without it, the policy that ships."""
    robot: str = "turtlebot2"
    """Settings: a robot that ships, or a YAML file."""
    out: Path = Path("runs/replay")
    """commands.jsonl, summary.json, the film, and the recording of what was commanded."""
    film: Literal["mp4", "gif", "none"] = "mp4"
    """Kind of film."""
    scan: str = ""
    """Topic of the scans; the fullest LaserScan without it."""
    depth: str = ""
    """Topic of depth images; without one the camera sees nothing."""
    odom: str = ""
    """Topic of odometry; without one the robot is taken to stand."""
    goal: tuple[float, float] = (5.0, 0.0)
    """Ahead and to the left of the robot at the beginning (m), unless the recording has goals."""
    record: bool = False
    """Writes commands, reasons and scans to MCAP."""
    max_seconds: float = math.inf
    """Stops after so much of the recording."""

    def __post_init__(self) -> None:
        choose("film", self.film, ("mp4", "gif", "none"))
        require(all(map(math.isfinite, self.goal)), "goal", self.goal, "finite")
        require(self.max_seconds > 0, "max_seconds", self.max_seconds, "positive")

    @property
    def film_path(self) -> Path | None:
        return None if self.film == "none" else self.out / f"replay.{self.film}"


@dataclass(frozen=True)
class Moment:
    """One step of the loop on a recording. Arrays are the loop's own: to look at, and only now."""

    time_s: float
    """Since the recording's first message."""
    step: Step
    sensed: SensorFrame | None
    """None before the first odometry."""
    pilot: FolderPilot
    settings: RobotSettings


OnStep = Callable[[Moment], None]


@dataclass(frozen=True)
class ReplaySummary:
    """What came of a recording."""

    seconds: float
    scans: int
    commands: int
    moving_share: float
    """Of commands that are not zero."""
    people_most: int
    act_ms_p50: float
    act_ms_p99: float
    refused: dict[str, int]
    """Messages refused, by reason."""
    reasons: dict[str, int]
    """Commands by what the loop said about them."""
    unreadable: int


class _Replay:
    """Owns the loop's clock: the recording's own."""

    def __init__(
        self,
        pilot: FolderPilot,
        settings: RobotSettings,
        topics: Topics,
        config: ReplayConfig,
        lines: TextIO,
        on_step: OnStep | None,
    ) -> None:
        self.pilot, self.topics, self.config, self.lines, self.on_step = pilot, topics, config, lines, on_step
        self.runtime = RobotRuntime(pilot, settings, threaded=False)
        self.first_s = self.next_s = math.nan
        self.scans = self.people_most = self.commands = self.moving = 0
        self.times_ms: list[float] = []
        self.reasons: dict[str, int] = {}
        self.refused: dict[str, int] = {}
        self.recorder: Recorder | None = None
        self._spent_s = 0.0
        self._offsets: dict[str, float] = {}

    def take(self, item: Recorded) -> None:
        """One message, and all control steps that are due before it."""
        if math.isnan(self.first_s):
            self.first_s = self.next_s = item.time_s
        period_s = 1.0 / self.runtime.settings.control_hz
        if item.time_s - self.next_s > 5.0:
            self.next_s = item.time_s  # a hole in the recording
        while self.next_s <= item.time_s:
            self._step(self.next_s)
            self.next_s += period_s
        begin = time.perf_counter()
        reason = self._hand_over(item)
        self._spent_s += time.perf_counter() - begin
        if reason:
            word = "".join(letter for letter in reason if not letter.isdigit())
            self.refused[word] = self.refused.get(word, 0) + 1

    def _hand_over(self, item: Recorded) -> str:
        runtime, message, now_s = self.runtime, item.message, item.time_s
        if item.kind in ("tf", "tf_static"):
            return "; ".join(runtime.on_transforms(message.transforms, now_s, item.kind == "tf_static"))
        if item.kind == "camera_info":
            return runtime.on_camera_info(message)
        if item.kind == "goal":
            return runtime.on_goal(message, now_s)
        # Stamps are the sensors' clock, times the recorder's: the difference that the first one has is theirs for good.
        ros_now_s = self._ros_now(item)
        if item.kind == "odom":
            return runtime.on_odom(message, now_s, ros_now_s)
        if item.kind == "depth":
            return runtime.on_depth(message, now_s, ros_now_s)
        self.scans += 1
        if not self.topics.odom:
            runtime.on_odom(_standing(now_s), now_s, now_s)
        if self.scans == 1 and not self.topics.goal:
            goal = Message(x=self.config.goal[0], y=self.config.goal[1], z=0.0)
            header = Message(stamp=Message(sec=0, nanosec=0), frame_id=runtime.settings.base_frame)
            runtime.on_goal(Message(header=header, pose=Message(position=goal)), now_s)
        if self.recorder is not None:
            self.recorder.scan(now_s, message)
        return runtime.on_scan(message, now_s, ros_now_s)

    def _ros_now(self, item: Recorded) -> float:
        try:
            stamp_s = stamp_of(item.message.header)
        except (AttributeError, TypeError, ValueError):
            return item.time_s
        if item.kind not in self._offsets:
            self._offsets[item.kind] = stamp_s - item.time_s
        return item.time_s + self._offsets[item.kind]

    def _step(self, now_s: float) -> None:
        begin = time.perf_counter()
        step = self.runtime.step(now_s, now_s)
        self.times_ms.append(1e3 * (self._spent_s + time.perf_counter() - begin))
        self._spent_s = 0.0
        self._write(now_s, step)
        if self.on_step is not None:
            sensed = self.runtime.sensed(now_s)
            self.on_step(Moment(now_s - self.first_s, step, sensed, self.pilot, self.runtime.settings))

    def _write(self, now_s: float, step: Step) -> None:
        command, people = step.command, step.people
        self.commands += 1
        self.moving += command.linear_velocity != 0.0 or command.angular_velocity != 0.0
        self.people_most = max(self.people_most, len(people.pos_r))
        word = step.message.split(" is ")[0].split(": contact")[0]
        self.reasons[word] = self.reasons.get(word, 0) + 1
        row: dict[str, Any] = {
            "time_s": round(now_s - self.first_s, 3),
            "linear": round(command.linear_velocity, 4),
            "angular": round(command.angular_velocity, 4),
            "action": command.action,
            "reason": step.message,
            "people": np.round(np.hstack([people.pos_r, people.vel_r]), 3).tolist(),
        }
        self.lines.write(json.dumps(row) + "\n")
        if self.recorder is not None:
            frame = self.runtime.settings.base_frame
            self.recorder.step(now_s, step, frame)


def _standing(now_s: float) -> Any:
    seconds = math.floor(now_s)
    header = Message(stamp=Message(sec=seconds, nanosec=int(1e9 * (now_s - seconds))), frame_id="odom")
    pose = Message(position=Message(x=0.0, y=0.0, z=0.0), orientation=Message(x=0.0, y=0.0, z=0.0, w=1.0))
    twist = Message(linear=Message(x=0.0), angular=Message(z=0.0))
    return Message(header=header, child_frame_id="base", pose=Message(pose=pose), twist=Message(twist=twist))


def _settings(config: ReplayConfig, topics: Topics) -> RobotSettings:
    settings = load_settings(config.robot)
    changes: dict[str, Any] = {"use_camera": bool(topics.depth)}
    if not topics.odom:
        # Nobody knows how it moved: it stands at the origin of a frame of its own, and never counts as frozen.
        freeze = dataclasses.replace(settings.safety.freeze, enabled=False)
        changes |= {"odom_frame": "odom", "safety": dataclasses.replace(settings.safety, freeze=freeze)}
        changes |= {"lidar_mount": settings.lidar_mount or Mount(), "use_tf": False}
    return dataclasses.replace(settings, **changes)


def replay(config: ReplayConfig, on_step: OnStep | None = None) -> ReplaySummary:
    """Runs the whole recording.

    Args:
        config: which, and how.
        on_step: is shown each step; the time it takes counts for nothing.

    Raises:
        ValueError: if the recording, the folder or the settings cannot be read.
    """
    config.out.mkdir(parents=True, exist_ok=True)
    folder = config.folder or export_folder("densecavoid", config.out / "exported")[0]
    with Bag(config.bag) as bag, (config.out / "commands.jsonl").open("w") as lines:
        topics = bag.choose(Topics(scan=config.scan, depth=config.depth, odom=config.odom))
        settings = _settings(config, topics)
        run = _Replay(FolderPilot(folder, settings.robot), settings, topics, config, lines, on_step)
        run.runtime.warm_up()
        try:
            if config.record:
                run.recorder = Recorder(config.out / "recording")
            last_s = math.nan
            for item in bag.messages(topics):
                run.take(item)
                last_s = item.time_s
                if last_s - run.first_s > config.max_seconds:
                    break
        finally:
            if run.recorder is not None:
                run.recorder.__exit__()
        summary = ReplaySummary(
            seconds=last_s - run.first_s,
            scans=run.scans,
            commands=run.commands,
            moving_share=run.moving / max(run.commands, 1),
            people_most=run.people_most,
            act_ms_p50=float(np.percentile(run.times_ms, 50)) if run.times_ms else math.nan,
            act_ms_p99=float(np.percentile(run.times_ms, 99)) if run.times_ms else math.nan,
            refused=run.refused,
            reasons=run.reasons,
            unreadable=bag.unreadable,
        )
    (config.out / "summary.json").write_text(json.dumps(dataclasses.asdict(summary), indent=1) + "\n")
    return summary
