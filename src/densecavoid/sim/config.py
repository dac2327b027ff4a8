"""What a simulation is told: the body, its sensors and the clock."""

from __future__ import annotations

from dataclasses import dataclass, field
from typing import Literal, get_args

from densecavoid.frames import CameraConfig, LidarConfig, RobotConfig, choose, require
from densecavoid.sim.noise import SensorNoiseConfig

Motion = Literal["anticipation", "social-force", "orca"]
Pace = Literal["scenario", "brisk", "rush"]
Attitudes = Literal["scripted", "reactive", "mixed"]
MOTIONS, PACES, ATTITUDES = get_args(Motion), get_args(Pace), get_args(Attitudes)


@dataclass(frozen=True)
class AttitudeShares:
    """How many of a mixed crowd think what of the robot; the shares add up to 1."""

    ignore: float = 0.4
    """Do not notice it."""
    makes_way: float = 0.5
    """Make way for it as for a person."""
    block: float = 0.1
    """Are curious: step into its way and stop in front of it, for a while."""

    def __post_init__(self) -> None:
        for name in ("ignore", "makes_way", "block"):
            require(0 <= getattr(self, name) <= 1, f"AttitudeShares.{name}", getattr(self, name), "in [0, 1]")
        total = self.ignore + self.makes_way + self.block
        require(abs(total - 1.0) < 1e-6, "AttitudeShares' sum", total, "1")


@dataclass(frozen=True)
class SimConfig:
    """The body and the clock (BENCHMARK, The robot and the clock)."""

    lidar: LidarConfig = field(default_factory=LidarConfig)
    camera: CameraConfig = field(default_factory=CameraConfig)
    robot: RobotConfig = field(default_factory=RobotConfig)
    dynamics: Literal["ideal", "dynamic"] = "ideal"
    """ideal: commands take effect at once. dynamic: acceleration limits and one control step of delay."""
    sensors: Literal["clean", "real"] = "clean"
    """clean: exact sensors. real: with the errors of `noise`, and odometry that drifts."""
    noise: SensorNoiseConfig = field(default_factory=SensorNoiseConfig)
    people: Attitudes = "scripted"
    """scripted: nobody notices the robot (the paper's people). reactive: everybody makes way for it. mixed: some do,
    some do not, some stand in its way (`shares`)."""
    shares: AttitudeShares = field(default_factory=AttitudeShares)
    """Of a mixed crowd."""
    pace: Pace = "scenario"
    """scenario: people's speeds are the scenario's. brisk, rush: everybody's are N(1.0, .2), N(1.34, .26) m/s, clipped
    to [.15, 1.6]. Recorded people keep theirs."""
    motion: Motion = "anticipation"
    """How people make their way: crowds/, one file each."""
    control_dt_s: float = 0.1
    physics_dt_s: float = 0.05
    threads: int = 0
    """Threads over the worlds; 0 takes all cores."""

    def __post_init__(self) -> None:
        choose("SimConfig.dynamics", self.dynamics, ("ideal", "dynamic"))
        choose("SimConfig.sensors", self.sensors, ("clean", "real"))
        choose("SimConfig.people", self.people, ATTITUDES)
        choose("SimConfig.pace", self.pace, PACES)
        choose("SimConfig.motion", self.motion, MOTIONS)
        require(0 < self.physics_dt_s <= 0.05, "SimConfig.physics_dt_s", self.physics_dt_s, "in (0, 0.05] s")
        ratio = self.control_dt_s / self.physics_dt_s
        require(
            ratio >= 1 and abs(ratio - round(ratio)) < 1e-9,
            "SimConfig.control_dt_s",
            self.control_dt_s,
            f"a multiple of physics_dt_s = {self.physics_dt_s}",
        )
        for sensor in (self.lidar, self.camera):
            self.sensor_clock(sensor)
        require(self.threads >= 0, "SimConfig.threads", self.threads, "0 (all cores) or more")

    @property
    def sub_steps(self) -> int:
        """Physics steps a control step."""
        return round(self.control_dt_s / self.physics_dt_s)

    def sensor_clock(self, sensor: LidarConfig | CameraConfig) -> tuple[int, int]:
        """Control steps between two frames of a sensor, and control steps that a frame is late.

        Raises:
            ValueError: if either is not a whole number.
        """
        name, dt = type(sensor).__name__, self.control_dt_s
        every = 1.0 if sensor.rate_hz * dt >= 1.0 or sensor.rate_hz == 0.0 else 1.0 / (sensor.rate_hz * dt)
        late = sensor.latency_s / dt
        require(abs(every - round(every)) < 1e-6, f"{name}.rate_hz", sensor.rate_hz, f"{1 / dt} Hz over a whole number")
        require(abs(late - round(late)) < 1e-6, f"{name}.latency_s", sensor.latency_s, f"a multiple of {dt} s")
        return round(every), round(late)
