"""Things that the camera saw and may not see any more: too near for it, or beside it.

A lidar at shin height sees a table's legs, a camera its top, but only from 1.4 m on. What the camera sees is therefore
noted in a grid of cells that moves with the robot (marked and cleared, as the obstacle layer of a costmap), and shown
as one more scan. Only what was seen in the same place for a while is remembered: people who walk leave no trail.
"""

from __future__ import annotations

import math

import numpy as np
from jaxtyping import Bool, Float32

from densecavoid.frames import CameraConfig, LidarConfig, RobotConfig, SensorFrame
from densecavoid.perception.projection import CameraView, camera_view, from_camera
from densecavoid.perception.rolling_grid import CELL_M, LOWEST_M, find_nearest_things, move_grids, sees_past
from densecavoid.sim._jit import for_worlds, kernel, threads_for

CELLS = 64
"""Along each side of the grid; a power of two."""
STEADY_FRAMES = 10
"""Frames in which something must have been seen in a cell. Walking people are gone before."""
_COUNTED = 255


@kernel
def _remember(
    first,
    last,
    which,
    depth,
    pose,
    view,
    depth_limits,
    heights,
    scan_shape,
    counts,
    centre,
    nearest,
    scan,
):
    """Marks and clears cells, and shows what is remembered as a scan.

    Args:
        which: worlds that have a new frame.
        depth: f32 [B, rows, width] along the optical axis (m).
        pose: f64 [B, 3] of the robot.
        view: of the camera.
        depth_limits: least and greatest depth (m).
        heights: of things, from and to (m).
        scan_shape: field of view (rad), greatest range (m), and how far ahead the lidar stands (m).
        counts: u8 [B, CELLS, CELLS] frames in which each cell was seen to be taken; changed. Cells lie as in a
            `rolling_grid`.
        centre: i64 [B, 2] number of the cell that the robot is in; changed.
        nearest: f64 [B, width, 2] room to work.
        scan: f32 [B, rays] fraction of the greatest range, 1 where nothing is remembered; written.
    """
    half, mask = CELLS // 2, CELLS - 1
    fov, reach, lidar_ahead = scan_shape
    rays = scan.shape[1]
    rays_per_rad = (rays - 1) / fov
    for b in range(first, last):
        if not which[b]:
            continue
        move_grids(counts[b : b + 1], centre[b], pose[b])
        find_nearest_things(nearest[b], depth[b], view, depth_limits, heights)
        cos, sin = math.cos(pose[b, 2]), math.sin(pose[b, 2])
        scan[b, :] = 1.0
        for i in range(centre[b, 0] - half, centre[b, 0] + half):
            for j in range(centre[b, 1] - half, centre[b, 1] + half):
                if counts[b, i & mask, j & mask] == 0:
                    continue
                forward, left = from_camera(view, pose[b], (i + 0.5) * CELL_M, (j + 0.5) * CELL_M)
                if sees_past(nearest[b], view, forward, left, depth_limits[0]):
                    counts[b, i & mask, j & mask] = 0
                    continue
                if counts[b, i & mask, j & mask] >= STEADY_FRAMES:
                    x, y = forward + view.ahead_m - lidar_ahead, left
                    distance = math.sqrt(x * x + y * y)
                    if distance < CELL_M or distance >= reach:
                        continue
                    bearing, half_width = math.atan2(y, x), math.atan2(0.7 * CELL_M, distance)
                    low = math.ceil((bearing - half_width + 0.5 * fov) * rays_per_rad)
                    high = math.floor((bearing + half_width + 0.5 * fov) * rays_per_rad)
                    near = np.float32(distance / reach)
                    for r in range(max(low, 0), min(high, rays - 1) + 1):
                        scan[b, r] = min(scan[b, r], near)
        before_i, before_j = np.int64(-1), np.int64(-1)
        for u in range(view.width):
            x, y = nearest[b, u, 0] + view.ahead_m, nearest[b, u, 1]
            if x * x + y * y < (half - 1) * (half - 1) * CELL_M * CELL_M:
                i = math.floor((pose[b, 0] + cos * x - sin * y) / CELL_M) & mask
                j = math.floor((pose[b, 1] + sin * x + cos * y) / CELL_M) & mask
                if (i != before_i or j != before_j) and counts[b, i, j] < _COUNTED:
                    counts[b, i, j] += 1
                before_i, before_j = i, j


class ThingsRemembered:
    """One grid a world."""

    def __init__(
        self,
        lidar: LidarConfig,
        camera: CameraConfig,
        num_worlds: int,
        threads: int,
        robot: RobotConfig = RobotConfig(),
    ) -> None:
        self._view: CameraView = camera_view(camera)
        self._depth_limits = float(camera.min_range_m), float(camera.max_range_m)
        self._heights = LOWEST_M, float(robot.height_m)
        self._scan_shape = float(lidar.fov_rad), float(lidar.max_range_m), float(lidar.mount_x_m)
        self._threads = threads
        self._counts = np.zeros((num_worlds, CELLS, CELLS), np.uint8)
        self._centre = np.zeros((num_worlds, 2), np.int64)
        self._nearest = np.zeros((num_worlds, camera.width, 2))

    def reset(self, which: Bool[np.ndarray, "B"]) -> None:
        """Forgets what was seen in the marked worlds."""
        self._counts[which] = 0

    def update(self, frame: SensorFrame, which: Bool[np.ndarray, "B"], scan: Float32[np.ndarray, "B rays"]) -> None:
        """Takes in the next frame of the marked worlds, and writes what is remembered there as `scan`: fractions of
        the lidar's greatest range, 1 where nothing is.
        """
        for_worlds(
            _remember,
            len(which),
            threads_for(which, self._threads),
            which,
            frame.depth_m,
            frame.odom_pose,
            self._view,
            self._depth_limits,
            self._heights,
            self._scan_shape,
            self._counts,
            self._centre,
            self._nearest,
            scan,
        )

    def state_dict(self) -> dict[str, np.ndarray]:
        """The memory of all worlds, as arrays."""
        return {"counts": self._counts.copy(), "centre": self._centre.copy()}

    def load_state_dict(self, arrays: dict[str, np.ndarray]) -> None:
        """Goes on from a `state_dict`."""
        self._counts, self._centre = np.array(arrays["counts"]), np.array(arrays["centre"])
