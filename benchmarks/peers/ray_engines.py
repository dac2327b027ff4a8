"""Rays cast by MuJoCo and by PyBullet through a world of the simulator, for comparing values and speed with ours."""

from __future__ import annotations

import importlib
import math
from collections.abc import Callable
from typing import Any, NamedTuple

import numpy as np
import pybullet
from jaxtyping import Float, Int
from scipy.spatial.transform import Rotation

from densecavoid.frames import CameraConfig, LidarConfig
from densecavoid.sim.floorplan import FloorPlan
from densecavoid.sim.mjcf import world_mjcf

# Its functions come from a compiled module that type checkers do not see.
mujoco: Any = importlib.import_module("mujoco")


class Hits(NamedTuple):
    """Where rays end."""

    distance: Float[np.ndarray, "n"]
    """In units of each ray's direction; inf where it meets nothing."""
    solid: Int[np.ndarray, "n"]
    """Which solid it met, in the engine's own numbers; -1: none."""


def lidar_rays(config: LidarConfig, pose: Float[np.ndarray, "3"]) -> tuple[np.ndarray, np.ndarray]:
    """Origin [3] and unit directions [rays, 3] of a scanner on a robot at `pose`, in the world frame."""
    angles = config.angles_rad
    turn = Rotation.from_euler("ZY", [pose[2], config.mount_pitch_rad])
    return _mount(config, pose), turn.apply(np.stack([np.cos(angles), np.sin(angles), 0 * angles], axis=1))


def camera_rays(config: CameraConfig, pose: Float[np.ndarray, "3"]) -> tuple[np.ndarray, np.ndarray]:
    """Origin [3] and directions [height * width, 3] of a camera on a robot at `pose`, in the world frame.

    The directions have length 1 along the optical axis, so a distance in their units is a depth.
    """
    left, up = np.meshgrid(config.column_slopes, config.row_slopes)
    turn = Rotation.from_euler("ZY", [pose[2], config.mount_pitch_rad])
    return _mount(config, pose), turn.apply(np.stack([np.ones_like(left), left, up], axis=-1).reshape(-1, 3))


def _mount(config: LidarConfig | CameraConfig, pose: Float[np.ndarray, "3"]) -> np.ndarray:
    x, y, yaw = pose
    ahead = config.mount_x_m
    return np.array([x + ahead * math.cos(yaw), y + ahead * math.sin(yaw), config.mount_height_m])


class MujocoRays:
    """`mj_multiRay` in one world, on one thread."""

    def __init__(self, plan: FloorPlan, bodies: Float[np.ndarray, "people parts 5"]) -> None:
        self.model = mujoco.MjModel.from_xml_string(world_mjcf(plan, bodies))
        self._data = mujoco.MjData(self.model)
        mujoco.mj_forward(self.model, self._data)

    def caster(self, origin: np.ndarray, directions: np.ndarray, farthest: float) -> Callable[[], Hits]:
        """A call that casts these rays to `farthest` units of their directions, with all preparation done here."""
        count = len(directions)
        length = np.linalg.norm(directions, axis=1)
        unit = np.ascontiguousarray(directions / length[:, None]).ravel()
        solid, distance = np.zeros(count, np.int32), np.zeros(count)
        cutoff = farthest * float(length.max())

        def cast() -> Hits:
            mujoco.mj_multiRay(
                self.model, self._data, origin, unit, None, True, -1, solid, distance, None, count, cutoff
            )
            return Hits(np.where(solid < 0, np.inf, distance / length), solid.copy())

        return cast


class PybulletRays:
    """PyBullet's `rayTestBatch` in one world, on one thread; close it after use."""

    def __init__(self, plan: FloorPlan, bodies: Float[np.ndarray, "people parts 5"], scale: float = 1.0) -> None:
        """Builds the world.

        Args:
            scale: Bullet's units a metre. It ends its search for a cylinder's surface .01 units before it, which at
                scale 1 shows as ranges up to 2.4 mm too short where rays graze; at scale 100 this vanishes.
        """
        self._scale = scale
        self._client = pybullet.connect(pybullet.DIRECT)
        self._plane([0, 0, 1], 0.0)
        if math.isfinite(plan.ceiling_m):
            self._plane([0, 0, -1], plan.ceiling_m)
        for x, y, yaw, half_length, half_width, z_min, z_max in plan.boxes:
            half = [scale * half_length, scale * half_width, scale * (z_max - z_min) / 2]
            shape = pybullet.createCollisionShape(pybullet.GEOM_BOX, halfExtents=half, physicsClientId=self._client)
            self._place(shape, (x, y, (z_min + z_max) / 2), yaw)
        for x, y, radius, z_min, z_max in np.vstack([plan.cylinders, bodies.reshape(-1, 5)]):
            if radius > 0:
                shape = pybullet.createCollisionShape(
                    pybullet.GEOM_CYLINDER,
                    radius=scale * radius,
                    height=scale * (z_max - z_min),
                    physicsClientId=self._client,
                )
                self._place(shape, (x, y, (z_min + z_max) / 2), 0.0)

        for mesh, x, y, z, yaw in plan.meshes:
            shape = pybullet.createCollisionShape(
                pybullet.GEOM_MESH,
                vertices=(scale * mesh.vertices.astype(np.float64)).tolist(),
                indices=mesh.faces.ravel().tolist(),
                flags=pybullet.GEOM_FORCE_CONCAVE_TRIMESH,
                physicsClientId=self._client,
            )
            self._place(shape, (x, y, z), yaw)

    def _plane(self, normal: list[int], z: float) -> None:
        shape = pybullet.createCollisionShape(pybullet.GEOM_PLANE, planeNormal=normal, physicsClientId=self._client)
        self._place(shape, (0.0, 0.0, z), 0.0)

    def _place(self, shape: int, centre: tuple[float, float, float], yaw: float) -> None:
        pybullet.createMultiBody(
            0,
            shape,
            basePosition=[self._scale * value for value in centre],
            baseOrientation=pybullet.getQuaternionFromEuler([0, 0, yaw]),
            physicsClientId=self._client,
        )

    def caster(self, origin: np.ndarray, directions: np.ndarray, farthest: float) -> Callable[[], Hits]:
        """A call that casts these rays to `farthest` units of their directions, with all preparation done here."""
        start = self._scale * origin
        ends = (start + self._scale * farthest * directions).tolist()
        starts = np.broadcast_to(start, directions.shape).tolist()
        limit = pybullet.MAX_RAY_INTERSECTION_BATCH_SIZE

        def cast() -> Hits:
            rows = []
            for first in range(0, len(ends), limit):
                part = slice(first, first + limit)
                rows += pybullet.rayTestBatch(starts[part], ends[part], numThreads=1, physicsClientId=self._client)
            solid = np.array([row[0] for row in rows])
            fraction = np.array([row[2] for row in rows])
            return Hits(np.where(solid < 0, np.inf, farthest * fraction), solid)

        return cast

    def depth_image(self, config: CameraConfig, pose: Float[np.ndarray, "3"]) -> Callable[[], np.ndarray]:
        """A call that renders the depth buffer [height, width] of a level camera with PyBullet's software renderer."""
        eye = np.array([pose[0], pose[1], config.mount_height_m])
        ahead = eye + np.array([math.cos(pose[2]), math.sin(pose[2]), 0.0])
        view = pybullet.computeViewMatrix(
            (self._scale * eye).tolist(), (self._scale * ahead).tolist(), [0, 0, 1], physicsClientId=self._client
        )
        aspect = math.tan(config.fov_horizontal_rad / 2) / math.tan(config.fov_vertical_rad / 2)
        projection = pybullet.computeProjectionMatrixFOV(
            math.degrees(config.fov_vertical_rad), aspect, 0.05 * self._scale, config.max_range_m * self._scale
        )

        def render() -> np.ndarray:
            image = pybullet.getCameraImage(
                config.width,
                config.height,
                viewMatrix=view,
                projectionMatrix=projection,
                renderer=pybullet.ER_TINY_RENDERER,
                physicsClientId=self._client,
            )
            return np.asarray(image[3])

        return render

    def close(self) -> None:
        """Frees the engine's world."""
        pybullet.disconnect(physicsClientId=self._client)
