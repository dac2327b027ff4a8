"""What stands around the robot, from lidar and camera: a grid of cells that moves with it, without people.

Cells are marked where a ray ends and cleared where rays pass (as the obstacle layer of a costmap). A lidar at shin
height sees a table's legs, a camera its top, but only from 1.4 m on: what the camera saw is kept apart, and cleared by
the camera alone. What is nearer to somebody who is tracked than their body reaches is theirs: people leave no trail.
"""

from __future__ import annotations

import math

import numpy as np
from jaxtyping import Bool, Float32, Int

from densecavoid.frames import CameraConfig, LidarConfig, RobotConfig, SensorFrame
from densecavoid.perception.people_around import People
from densecavoid.perception.projection import CameraView, camera_view, from_camera
from densecavoid.perception.rolling_grid import CELL_M, LOWEST_M, find_nearest_things, move_grids, sees_past
from densecavoid.sim._jit import for_worlds, inner, kernel, threads_for

CELLS = 128
"""Along each side of the grid; a power of two."""
MOST_POINTS = 2048
_LIMB_M = 0.2  # so far beyond a person's radius their legs and arms reach
_HIT, _MOST, _TAKEN = 2, 4, 2  # evidence of a frame in which a ray ended in a cell, the most, and from when it counts
_STEADY_FRAMES = 8  # in which the camera must have seen something in a cell: walkers who are not tracked are gone then
_PASSED = 1
_PARTS = 100.0


@inner
def _is_somebodys(x, y, people, radius, there):
    """Whether a place (m, robot's frame) belongs to one of those who are `there`."""
    for p in range(there.shape[0]):
        if there[p]:
            off_x, off_y, reach = x - people[p, 0], y - people[p, 1], radius[p] + _LIMB_M
            if off_x * off_x + off_y * off_y < reach * reach:
                return True
    return False


@inner
def _note(places, x, y):
    """Notes where in its cell a place is (cells from the odometry's origin)."""
    i, j = math.floor(x), math.floor(y)
    at = places[i & (CELLS - 1), j & (CELLS - 1)]
    at[0], at[1] = np.int8((x - i) * _PARTS), np.int8((y - j) * _PARTS)


@inner
def _trace(seen, places, scan, angles, pose, mount_x, max_range):
    """Marks the cells [CELLS, CELLS] that rays pass with `_PASSED`, those that they end in with `_HIT` noting where."""
    mask = CELLS - 1
    from_x = (pose[0] + math.cos(pose[2]) * mount_x) / CELL_M
    from_y = (pose[1] + math.sin(pose[2]) * mount_x) / CELL_M
    for ends in range(2):  # ends last: what one ray hits another may pass by closely
        for r in range(scan.shape[0]):
            if not scan[r] > 0.0:  # NaN is not
                continue
            cos, sin = math.cos(pose[2] + angles[r]), math.sin(pose[2] + angles[r])
            length = min(scan[r], max_range) / CELL_M
            if ends and scan[r] < max_range:
                x, y = from_x + cos * length, from_y + sin * length
                seen[math.floor(x) & mask, math.floor(y) & mask] = _HIT
                _note(places, x, y)
            elif not ends:
                for k in range(int(length - 0.5)):
                    seen[math.floor(from_x + cos * k) & mask, math.floor(from_y + sin * k) & mask] = _PASSED


@kernel
def _update(
    first,
    last,
    which,
    scan,
    angles,
    depth,
    pose,
    people,
    radius,
    there,
    view,
    limits,
    grids,
    places,
    centre,
    seen,
    nearest,
    points,
    count,
):
    """Marks and clears cells, and lists those that are taken.

    Args:
        which: bool [B] worlds.
        people, radius, there: [B, P, 2], [B, P], [B, P] in the robot's frame.
        limits: where the lidar stands ahead and its range (m), least and greatest depth (m), heights from and to (m).
        grids: u8 [B, 2, CELLS, CELLS] evidence of the lidar, and frames in which the camera saw each cell taken;
            changed. Cells lie as in a `rolling_grid`.
        places: i8 [B, CELLS, CELLS, 2] where in the cell something was last seen, `_PARTS` a cell; changed.
        centre: i64 [B, 2] number of the cell that the robot is in; changed.
        seen, nearest: room to work.
        points: f32 [B, N, 2] what was seen in cells that are taken (m, robot's frame), `count` [B]; written.
    """
    half, mask = CELLS // 2, CELLS - 1
    mount_x, max_range, depth_limits, heights = limits
    for b in range(first, last):
        if not which[b]:
            continue
        lidar, camera = grids[b, 0], grids[b, 1]
        move_grids(grids[b], centre[b], pose[b])
        seen[b, :, :] = 0
        _trace(seen[b], places[b], scan[b], angles, pose[b], mount_x, max_range)
        find_nearest_things(nearest[b], depth[b], view, depth_limits, heights)
        cos, sin = math.cos(pose[b, 2]), math.sin(pose[b, 2])
        before_i, before_j = np.int64(-1), np.int64(-1)
        for u in range(view.width):
            x, y = nearest[b, u, 0] + view.ahead_m, nearest[b, u, 1]
            if x * x + y * y < (half - 1) * (half - 1) * CELL_M * CELL_M:
                at_x, at_y = (pose[b, 0] + cos * x - sin * y) / CELL_M, (pose[b, 1] + sin * x + cos * y) / CELL_M
                i, j = math.floor(at_x) & mask, math.floor(at_y) & mask
                new = (i != before_i or j != before_j) and camera[i, j] < 255
                if new and not _is_somebodys(x, y, people[b], radius[b], there[b]):
                    camera[i, j] += 1
                    if lidar[i, j] == 0:
                        _note(places[b], at_x, at_y)
                before_i, before_j = i, j
        n = 0
        for i in range(centre[b, 0] - half, centre[b, 0] + half):
            for j in range(centre[b, 1] - half, centre[b, 1] + half):
                at_i, at_j = i & mask, j & mask
                evidence = lidar[at_i, at_j]
                if seen[b, at_i, at_j] == _HIT:
                    evidence = min(evidence + _HIT, _MOST)
                elif seen[b, at_i, at_j] == _PASSED and evidence > 0:
                    evidence -= 1
                lidar[at_i, at_j] = evidence
                if evidence < _TAKEN and camera[at_i, at_j] == 0:
                    continue
                part_x, part_y = (places[b, at_i, at_j, 0] + 0.5) / _PARTS, (places[b, at_i, at_j, 1] + 0.5) / _PARTS
                off_x, off_y = (i + part_x) * CELL_M - pose[b, 0], (j + part_y) * CELL_M - pose[b, 1]
                x, y = cos * off_x + sin * off_y, cos * off_y - sin * off_x
                if camera[at_i, at_j] > 0:
                    forward, left = from_camera(view, pose[b], (i + 0.5) * CELL_M, (j + 0.5) * CELL_M)
                    if sees_past(nearest[b], view, forward, left, depth_limits[0]):
                        camera[at_i, at_j] = 0
                if evidence < _TAKEN and camera[at_i, at_j] < _STEADY_FRAMES:
                    continue
                if _is_somebodys(x, y, people[b], radius[b], there[b]):
                    lidar[at_i, at_j] = camera[at_i, at_j] = 0
                elif n < points.shape[1]:
                    points[b, n, 0], points[b, n, 1] = x, y
                    n += 1
        count[b] = n


class StaticMap:
    """One grid a world."""

    def __init__(
        self,
        lidar: LidarConfig,
        camera: CameraConfig,
        robot: RobotConfig,
        num_worlds: int,
        threads: int = 0,
    ) -> None:
        """
        Args:
            lidar, camera: whose frames it will be given.
            robot: what begins above its height is in nobody's way.
            num_worlds: B.
            threads: over the worlds; 0 takes all cores.
        """
        self._angles = lidar.angles_rad
        self._view: CameraView = camera_view(camera)
        depth_limits = float(camera.min_range_m), float(camera.max_range_m)
        heights = LOWEST_M, float(robot.height_m)
        self._limits = float(lidar.mount_x_m), float(lidar.max_range_m), depth_limits, heights
        self._threads = threads
        self._grids = np.zeros((num_worlds, 2, CELLS, CELLS), np.uint8)
        self._places = np.zeros((num_worlds, CELLS, CELLS, 2), np.int8)
        self._centre = np.zeros((num_worlds, 2), np.int64)
        self._seen = np.zeros((num_worlds, CELLS, CELLS), np.uint8)
        self._nearest = np.zeros((num_worlds, camera.width, 2))
        self.points: Float32[np.ndarray, "B N 2"] = np.zeros((num_worlds, MOST_POINTS, 2), np.float32)
        """What was seen in each cell that is taken (m, robot's frame),"""
        self.count: Int[np.ndarray, "B"] = np.zeros(num_worlds, np.int64)
        """and how many there are."""

    def reset(self, which: Bool[np.ndarray, "B"]) -> None:
        """Forgets the marked worlds."""
        self._grids[which] = 0
        self.count[which] = 0

    def update(self, frame: SensorFrame, people: People, which: Bool[np.ndarray, "B"]) -> None:
        """Takes in the next frame of the marked worlds.

        Args:
            frame: of the sensors.
            people: who is known.
            which: worlds.
        """
        for_worlds(
            _update,
            len(self.count),
            threads_for(which, self._threads),
            which,
            frame.scan_m,
            self._angles,
            frame.depth_m,
            frame.odom_pose,
            people.pos_r,
            people.radius_m,
            people.there,
            self._view,
            self._limits,
            self._grids,
            self._places,
            self._centre,
            self._seen,
            self._nearest,
            self.points,
            self.count,
        )

    def state_dict(self) -> dict[str, np.ndarray]:
        """The maps of all worlds, as arrays; `points` come with the next frame."""
        return {"grids": self._grids.copy(), "places": self._places.copy(), "centre": self._centre.copy()}

    def load_state_dict(self, arrays: dict[str, np.ndarray]) -> None:
        """Goes on from a `state_dict`."""
        self._grids, self._places = np.array(arrays["grids"]), np.array(arrays["places"])
        self._centre = np.array(arrays["centre"])
