"""A second body: a scenario's world in MuJoCo, which casts the rays, moves the robot and finds the collisions.

Only where people walk comes from the project's simulator, where they walk without the robot. One world at a time, exact
sensors, ideal wheels, and people who do not heed the robot. Needs the extra `mujoco`.
"""

from __future__ import annotations

import importlib
import math
from collections.abc import Sequence
from dataclasses import replace
from typing import Any

import numpy as np
from jaxtyping import Float, Float32

from densecavoid.foresight.future import Elsewhere, unheeding
from densecavoid.frames import CameraConfig, Command, LidarConfig, SensorFrame, Truth, require
from densecavoid.sim.config import SimConfig
from densecavoid.sim.floorplan import FloorPlan
from densecavoid.sim.mjcf import world_mjcf
from densecavoid.sim.spec import Scenario, WorldSpec
from densecavoid.sim.world import Simulator

# Its functions come from a compiled module that type checkers do not see.
mujoco: Any = importlib.import_module("mujoco")

_CELLAR_M = -100.0
"""Parts of people who are not there are kept so far below the ground."""
_SOLID, _GLASS = 0, 1
"""Groups of geoms: sensors look through glass, and the robot can hit it all the same."""


class MujocoWorld:
    """One world that (scenario, seed) draws, as MuJoCo has it: the same that `Simulator.reset` makes of them."""

    def __init__(self, scenario: Scenario, seed: int, config: SimConfig | None = None) -> None:
        """Builds the world, with the robot at its start.

        Args:
            scenario: Its people must not react to the robot, nor appear when it comes near.
            seed: As for `Simulator.reset`.
            config: Sensors, robot, clock, and people's pace and motion model. Exact sensors and ideal wheels only.

        Raises:
            ValueError: naming what this body has not.
        """
        self.config = config = config or SimConfig()
        for name, value in (("dynamics", "ideal"), ("sensors", "clean"), ("people", "scripted")):
            require(getattr(config, name) == value, f"SimConfig.{name}", getattr(config, name), f"{value!r} in MuJoCo")
        for sensor in (config.lidar, config.camera):
            clock = config.sensor_clock(sensor)
            require(clock == (1, 0), f"{type(sensor).__name__} (every, late)", clock, "(1, 0) control steps, in MuJoCo")
        self.spec = spec = scenario.spawn(np.random.default_rng(seed))
        reacts = spec.appearance is not None or (spec.replay is not None and spec.replay.reactive)
        require(not reacts, "people of", spec.scenario, "people who do not react to the robot, in MuJoCo")
        # MuJoCo collides with a mesh's convex hull, not with its triangles.
        require(not spec.floor_plan.meshes, "things of", spec.scenario, "no meshes, in MuJoCo")

        self._crowd = Simulator(Elsewhere(scenario), 1, replace(unheeding(config), control_dt_s=config.physics_dt_s))
        self._crowd.reset(np.array([seed], np.int64))
        self._model = _model(spec, config, self._crowd.body_cylinders(0))
        self._data = mujoco.MjData(self._model)
        self._robot = self._model.body("robot").id
        self._first_part = self._model.ngeom - math.prod(self._crowd.body_cylinders(0).shape[:2])
        self._lidar = _Rays(config.lidar, _lidar_directions(config.lidar))
        self._camera = _Rays(config.camera, _camera_directions(config.camera))
        self._ticks = 0
        self.velocity = (0.0, 0.0)
        """Linear (m/s) and angular (rad/s), as commanded and limited."""
        self.outcome = ""
        """How the episode has ended, in the words of `benchmark.episode.OUTCOMES`; empty while it goes on."""
        self.collided_with = ""
        """What was hit: `box-3`, `pillar-0`, `person-7`."""
        self._data.qpos[:] = spec.start_pose
        self._place()

    # -- the episode ---------------------------------------------------------------------------------------------------

    def step(self, command: Command) -> None:
        """Carries out a command (of a batch of one) for one control step, or until the episode ends.

        Raises:
            ValueError: if a velocity is NaN or infinite, or the batch has the wrong size.
        """
        require(len(command.linear_velocity) == 1, "commands", len(command.linear_velocity), "one")
        velocities = float(command.linear_velocity[0]), float(command.angular_velocity[0])
        for _ in range(self.config.sub_steps):
            self.advance(*velocities)

    def advance(self, linear: float, angular: float) -> None:
        """One physics step: people first, then the robot; nothing once the episode has ended.

        Args:
            linear: m/s, limited to what the robot can.
            angular: rad/s, alike.
        """
        require(math.isfinite(linear) and math.isfinite(angular), "command", (linear, angular), "finite velocities")
        if self.outcome:
            return
        robot, dt = self.config.robot, self.config.physics_dt_s
        linear = min(max(linear, 0.0), robot.max_linear_velocity)
        angular = min(max(angular, -robot.max_angular_velocity), robot.max_angular_velocity)
        self.velocity = linear, angular
        still = np.zeros(1, np.float32)
        self._crowd.step(Command(still, still))
        # Wheels roll along the mean heading of the step; off the exact arc by (angular dt)^2 / 24 of the way.
        heading = self._data.qpos[2] + 0.5 * angular * dt
        self._data.qvel[:] = linear * math.cos(heading), linear * math.sin(heading), angular
        mujoco.mj_integratePos(self._model, self._data.qpos, self._data.qvel, dt)
        self._ticks += 1
        self._place()
        self._judge()

    def sense(self) -> SensorFrame:
        """What the sensors give now: a batch of one, in arrays of its own."""
        lidar, camera = self.config.lidar, self.config.camera
        scan_m = self._cast(self._lidar, lidar.max_range_m)
        scan_m[scan_m > lidar.max_range_m] = np.inf
        depth_m = self._cast(self._camera, camera.max_range_m)
        depth_m[(depth_m < camera.min_range_m) | (depth_m > camera.max_range_m)] = np.nan
        pose = self.robot_pose[None]
        return SensorFrame(
            time_s=np.array([self.time_s]),
            scan_m=scan_m[None],
            depth_m=depth_m.reshape(1, camera.height, camera.width),
            odom_pose=pose,
            velocity=np.array([self.velocity], np.float32),
            goal_odom=np.array([self.spec.goal]),
            truth=Truth(pose, self._crowd.people()),
        )

    @property
    def time_s(self) -> float:
        """Since the start of the episode."""
        return self._ticks * self.config.physics_dt_s

    @property
    def robot_pose(self) -> Float[np.ndarray, "3"]:
        """x, y (m) and yaw (rad, in [-pi, pi)) in the world."""
        x, y, yaw = self._data.qpos
        return np.array([x, y, (yaw + math.pi) % (2 * math.pi) - math.pi])

    @property
    def goal_distance_m(self) -> float:
        """From the robot's centre to the goal."""
        return math.dist(self._data.qpos[:2], self.spec.goal)

    # -- inside --------------------------------------------------------------------------------------------------------

    def _place(self) -> None:
        """Puts everybody's parts where they are now, and lets MuJoCo work out where everything is and touches."""
        parts = self._crowd.body_cylinders(0).reshape(-1, 5)
        here = parts[:, 2] > 0
        z_min, z_max = parts[:, 3], parts[:, 4]
        model, first = self._model, self._first_part
        self._data.mocap_pos[:, :2] = parts[:, :2]
        self._data.mocap_pos[:, 2] = np.where(here, (z_min + z_max) / 2, _CELLAR_M)
        half = np.where(
            here[:, None], np.stack([parts[:, 2], (z_max - z_min) / 2], axis=1), model.geom_size[first:, :2]
        )
        if not np.array_equal(half, model.geom_size[first:, :2]):
            # Another person in this slot. What MuJoCo searches by was made when the model was: a part that outgrows
            # its old bounds would be invisible beyond them.
            model.geom_size[first:, :2] = half
            model.geom_rbound[first:] = np.hypot(half[:, 0], half[:, 1])
            model.geom_aabb[first:, 3:] = half[:, [0, 0, 1]]
            model.bvh_aabb[model.body_bvhadr[model.geom_bodyid[first:]], 3:] = half[:, [0, 0, 1]]
        mujoco.mj_fwdPosition(model, self._data)

    def _judge(self) -> None:
        """Whether the episode has ended (BENCHMARK, How an episode ends): one step can do several, in this order."""
        if self._data.ncon > 0:
            contact = self._data.contact[0]
            hit = contact.geom1 if self._model.geom_bodyid[contact.geom1] != self._robot else contact.geom2
            name = self._model.geom(int(hit)).name
            self.outcome, self.collided_with = "collision", "-".join(name.split("-")[:2])
        elif self.goal_distance_m < self.spec.goal_distance_m:
            self.outcome = "success"
        elif self.time_s >= self.spec.time_limit_s - 1e-9:
            self.outcome = "timeout"

    def _cast(self, rays: _Rays, farthest: float) -> Float32[np.ndarray, "n"]:
        """Along each ray in units of its direction; inf where it meets nothing. Ranges a little beyond count too."""
        site = self._model.site(rays.name).id
        directions = np.ascontiguousarray(rays.unit @ self._data.site_xmat[site].reshape(3, 3).T)
        groups = np.ones(6, np.uint8)
        groups[_GLASS] = 0
        mujoco.mj_multiRay(
            self._model,
            self._data,
            self._data.site_xpos[site],
            directions.ravel(),
            groups,
            True,
            self._robot,
            rays.hit,
            rays.distance,
            None,
            len(rays.hit),
            (farthest + 0.5) * rays.longest,
        )
        return np.where(rays.hit < 0, np.inf, rays.distance / rays.length).astype(np.float32)


class _Rays:
    """The rays of one sensor in its own frame (x ahead, y left, z up), and room for what they meet."""

    def __init__(self, config: LidarConfig | CameraConfig, directions: Float[np.ndarray, "n 3"]) -> None:
        self.name = _site_name(config)
        self.length = np.linalg.norm(directions, axis=1)
        self.longest = float(self.length.max())
        self.unit = directions / self.length[:, None]
        self.hit, self.distance = np.zeros(len(directions), np.int32), np.zeros(len(directions))


def _site_name(config: LidarConfig | CameraConfig) -> str:
    return "lidar" if isinstance(config, LidarConfig) else "camera"


def _lidar_directions(config: LidarConfig) -> Float[np.ndarray, "rays 3"]:
    angles = config.angles_rad
    return np.stack([np.cos(angles), np.sin(angles), np.zeros_like(angles)], axis=1)


def _camera_directions(config: CameraConfig) -> Float[np.ndarray, "pixels 3"]:
    """Of length 1 along the optical axis, so that a distance in their units is a depth."""
    left, up = np.meshgrid(config.column_slopes, config.row_slopes)
    return np.stack([np.ones_like(left), left, up], axis=-1).reshape(-1, 3)


def _model(spec: WorldSpec, config: SimConfig, bodies: Float[np.ndarray, "people parts 5"]) -> Any:
    """A compiled model: what stands there, the robot on three joints, and a mocap body for each part of each person.

    The robot's one geom is as wide as the collision rule says, so that a contact is a collision; sensors leave it out.
    """
    model = mujoco.MjSpec.from_string(world_mjcf(spec.floor_plan))
    for geom in model.worldbody.geoms:
        if geom.type == mujoco.mjtGeom.mjGEOM_PLANE:
            # Rays are cast at a body only if they may meet the bounds of its solids, which planes are not part of:
            # beside the walls there would be no ground.
            body = model.worldbody.add_body(name=geom.name)
            plane = body.add_geom(type=geom.type, size=geom.size, pos=geom.pos)
            plane.alt.type, plane.alt.euler = geom.alt.type, geom.alt.euler
            _make_thing(plane, hittable=False)
            model.delete(geom)
        else:
            _make_thing(geom, hittable=True)
    for name in _glass_boxes(spec.floor_plan):
        model.geom(name).group = _GLASS

    robot, tall = model.worldbody.add_body(name="robot"), config.robot.height_m
    for kind, axis in (("mjJNT_SLIDE", (1, 0, 0)), ("mjJNT_SLIDE", (0, 1, 0)), ("mjJNT_HINGE", (0, 0, 1))):
        robot.add_joint(type=getattr(mujoco.mjtJoint, kind), axis=axis)
    size = (spec.collision_distance_m, tall / 2, 0.0)
    hull = robot.add_geom(name="robot", type=mujoco.mjtGeom.mjGEOM_CYLINDER, size=size, pos=(0, 0, tall / 2))
    hull.contype, hull.conaffinity = 1, 0
    for sensor in (config.lidar, config.camera):
        half_pitch = sensor.mount_pitch_rad / 2
        robot.add_site(
            name=_site_name(sensor),
            pos=(sensor.mount_x_m, 0.0, sensor.mount_height_m),
            quat=(math.cos(half_pitch), 0.0, math.sin(half_pitch), 0.0),
        )
    for person, parts in enumerate(bodies):
        for part in range(len(parts)):
            body = model.worldbody.add_body(name=f"person-{person}-{part}", mocap=True)
            # Some size: the right one, and the place, come with every step.
            size = (0.1, 0.1, 0.0)
            _make_thing(body.add_geom(name=body.name, type=mujoco.mjtGeom.mjGEOM_CYLINDER, size=size), hittable=True)
    return model.compile()


def _make_thing(geom: Any, hittable: bool) -> None:
    """Something that the robot meets (or not), and that meets nothing else."""
    geom.contype, geom.conaffinity, geom.group = 0, int(hittable), _SOLID


def _glass_boxes(plan: FloorPlan) -> Sequence[str]:
    return [f"box-{i}" for i, material in enumerate(plan.box_materials) if material == "glass"]
