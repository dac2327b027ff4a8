"""The robot's sensors in all worlds: what they measure, how well, how often, and how late it is given out."""

from __future__ import annotations

from collections.abc import Callable, Mapping

import numpy as np
from jaxtyping import Bool, Float, Float32, Int

from densecavoid.frames import require
from densecavoid.sim import kernels, noise, returns
from densecavoid.sim._jit import for_worlds, threads_for
from densecavoid.sim.config import SimConfig
from densecavoid.sim.depth import camera_optics
from densecavoid.sim.lidar import lidar_optics
from densecavoid.sim.mesh import MeshSet
from densecavoid.sim.state import WorldState


class DelayLine:
    """Frames of one sensor, given out at its own rate and some control steps after they were measured."""

    def __init__(self, frame: Float32[np.ndarray, "B ..."], every: int, late: int) -> None:
        """Makes room for the past.

        Args:
            frame: what the sensor writes its measurement into, each control step.
            every: control steps between two frames that are given out.
            late: control steps between measuring a frame and giving it out.
        """
        require(every >= 1 and late >= 0, "DelayLine (every, late)", (every, late), "at least (1, 0)")
        self.frame = frame
        self.every, self.late = every, late
        self.immediate = every == 1 and late == 0
        self._given = frame if self.immediate else frame.copy()
        slots = 0 if self.immediate else every + late
        self._past = np.zeros((slots, *frame.shape), np.float32)

    @property
    def nbytes(self) -> int:
        """Memory of all worlds."""
        return self.frame.nbytes + (0 if self.immediate else self._given.nbytes + self._past.nbytes)

    def pass_on(self, step: Int[np.ndarray, "B"], which: Bool[np.ndarray, "B"]) -> Float32[np.ndarray, "B ..."]:
        """Takes in what was measured in the marked worlds at `step`, and gives what has come through by then.

        Until the first frame has come through, it is the episode's first.
        """
        if self.immediate:
            return self.frame
        worlds, slots = np.flatnonzero(which), len(self._past)
        now = step[worlds]
        measured = np.maximum((now - self.late) // self.every * self.every, 0)
        self._past[now % slots, worlds] = self.frame[worlds]
        self._given[worlds] = self._past[measured % slots, worlds]
        return self._given

    def state(self) -> dict[str, np.ndarray]:
        """Its memory, where it has any."""
        return {} if self.immediate else {"past": self._past.copy(), "given": self._given.copy()}

    def load(self, past: np.ndarray, given: np.ndarray) -> None:
        """Goes on from a `state`."""
        require(past.shape == self._past.shape, "saved sensor frames", past.shape, str(self._past.shape))
        self._past[:], self._given[:] = past, given


class SensorSuite:
    """A lidar, a depth camera and odometry on each robot."""

    def __init__(self, config: SimConfig, num_worlds: int) -> None:
        self.config = config
        lidar, camera = config.lidar, config.camera
        self.real = config.sensors == "real"
        self._lidar, self._camera = lidar_optics(lidar, sweep=self.real), camera_optics(camera)
        scan = np.full((num_worlds, lidar.num_rays), np.inf, np.float32)
        image = np.full((num_worlds, camera.height, camera.width), np.nan, np.float32)
        # What each ray meets is kept where somebody asks for it: exact sensors with a level camera do not.
        kept = num_worlds if self.real or camera.mount_pitch_rad != 0.0 else 0
        self._hits = (np.zeros((kept, *scan.shape[1:]), np.int32), np.zeros((kept, *image.shape[1:]), np.int32))
        self._returns = returns.returns(config.noise, lidar)
        self._errors = (
            noise.scan_noise(config.noise, lidar),
            noise.depth_noise(config.noise, camera),
            noise.odometry_noise(config.noise),
        )
        self._limits = np.float32(lidar.max_range_m), np.float32(camera.min_range_m), np.float32(camera.max_range_m)
        self._seeds = np.zeros(num_worlds, np.uint64)
        self._odometry, self._last_pose = np.zeros((2, num_worlds, 3))
        self._lines = {
            "scan": DelayLine(scan, *config.sensor_clock(lidar)),
            "depth": DelayLine(image, *config.sensor_clock(camera)),
        }

    @property
    def nbytes(self) -> int:
        """Memory of all worlds."""
        memory = (self._seeds, self._odometry, self._last_pose, *self._hits)
        return sum(line.nbytes for line in self._lines.values()) + sum(array.nbytes for array in memory)

    def reset(self, seeds: Int[np.ndarray, "B"], which: Bool[np.ndarray, "B"]) -> None:
        """Begins new episodes in the marked worlds, whose errors follow from their seeds."""
        self._seeds[which] = seeds[which].astype(np.uint64)
        self._last_pose[which] = np.nan

    def sense(
        self, state: WorldState, which: Bool[np.ndarray, "B"] | None = None, meshes: MeshSet | None = None
    ) -> tuple[Float32[np.ndarray, "B rays"], Float32[np.ndarray, "B height width"], Float[np.ndarray, "B 3"]]:
        """Scans, depth images and odometry of the marked worlds (all, without `which`); the others keep their last.

        The arrays are written again by the next call.
        """
        num_worlds = len(state.goal)
        which = np.ones(num_worlds, np.bool_) if which is None else which
        threads = threads_for(which, self.config.threads)
        scan, depth = self._lines["scan"], self._lines["depth"]
        frames = (scan.frame, depth.frame)
        optics = self._lidar, self._camera

        def each(kernel: Callable, *args: object) -> None:
            for_worlds(kernel, num_worlds, threads, *args)

        if meshes is not None and not len(self._hits[0]):  # meshes are met by the general kernels alone
            self._hits = np.zeros(scan.frame.shape, np.int32), np.zeros(depth.frame.shape, np.int32)
        if len(self._hits[0]):
            each(kernels.sense_hits, state, which, *frames, *self._hits, *optics)
            if meshes is not None:
                each(kernels.sense_meshes, state, which, *frames, *self._hits, *optics, meshes)
            if self.real:
                seen = *frames, *self._hits
                each(returns.lose_returns, state, which, self._seeds, *seen, *optics, self._returns, meshes)
            each(kernels.limit_ranges, which, *frames, *self._limits)
        else:
            each(kernels.sense_level, state, which, *frames, *optics, *self._limits)
        odometry = state.robot_pose
        if self.real:
            odometry = self._odometry
            each(noise.spoil, state, which, self._seeds, *frames, odometry, self._last_pose, *self._errors)
        return scan.pass_on(state.step_count, which), depth.pass_on(state.step_count, which), odometry

    def state_dict(self) -> dict[str, np.ndarray]:
        """What the sensors remember, as arrays; nothing for clean sensors without latency."""
        lines = self._lines.items()
        arrays = {f"sensors.{name}.{key}": value for name, line in lines for key, value in line.state().items()}
        if self.real:
            memory = {"seeds": self._seeds, "odometry": self._odometry, "last_pose": self._last_pose}
            arrays |= {f"sensors.{key}": value.copy() for key, value in memory.items()}
        return arrays

    def load_state_dict(self, arrays: Mapping[str, np.ndarray]) -> None:
        """Goes on from a `state_dict` of the same sensors in as many worlds."""
        for name, line in self._lines.items():
            if not line.immediate:
                line.load(arrays[f"sensors.{name}.past"], arrays[f"sensors.{name}.given"])
        if self.real:
            self._seeds[:] = arrays["sensors.seeds"]
            self._odometry[:], self._last_pose[:] = arrays["sensors.odometry"], arrays["sensors.last_pose"]
