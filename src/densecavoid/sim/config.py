"""What a simulation is told: the body, its sensors and the clock."""

from __future__ import annotations

from dataclasses import dataclass, field
from typing import Literal

from densecavoid.frames import CameraConfig, LidarConfig, RobotConfig, choose, require
from densecavoid.sim.noise import SensorNoiseConfig


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
    people: Literal["scripted", "reactive"] = "scripted"
    """scripted: nobody notices the robot (the paper's people). reactive: everybody makes way for it."""
    control_dt_s: float = 0.1
    physics_dt_s: float = 0.05
    threads: int = 0
    """Threads over the worlds; 0 takes all cores."""

    def __post_init__(self) -> None:
        choose("SimConfig.dynamics", self.dynamics, ("ideal", "dynamic"))
        choose("SimConfig.sensors", self.sensors, ("clean", "real"))
        choose("SimConfig.people", self.people, ("scripted", "reactive"))
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
