"""What the camera saw stays where it is when the camera looks elsewhere, and goes when the camera sees that it went."""

from __future__ import annotations

import math

import numpy as np
import pytest

from densecavoid.env.observation import Observer, ObserverConfig
from densecavoid.frames import CameraConfig, Command, LidarConfig, SensorFrame
from densecavoid.perception.memory import CELLS, STEADY_FRAMES, ThingsRemembered
from densecavoid.perception.rolling_grid import CELL_M, LOWEST_M
from densecavoid.sim.floorplan import FloorPlan
from densecavoid.sim.people import TRAVERSING
from densecavoid.sim.spec import Crowd
from densecavoid.sim.world import SimConfig, Simulator
from scene import Scene

ONE = np.ones(1, np.bool_)
LIDAR, SMALL = LidarConfig(num_rays=64), CameraConfig(width=12, height=8)


def frame(depth: np.ndarray, pose: tuple[float, float, float], camera: CameraConfig = SMALL) -> SensorFrame:
    image = np.broadcast_to(depth.astype(np.float32), (1, camera.height, camera.width)).copy()
    return SensorFrame(
        time_s=np.zeros(1),
        scan_m=np.full((1, LIDAR.num_rays), np.inf, np.float32),
        depth_m=image,
        odom_pose=np.array([pose]),
        velocity=np.zeros((1, 2), np.float32),
        goal_odom=np.zeros((1, 2)),
    )


def drive(scene: Scene, v: float, w: float, steps: int) -> tuple[Simulator, Observer]:
    sim = Simulator(scene, 1, SimConfig(threads=1))
    sim.reset(np.zeros(1, np.int64))
    observer = Observer(ObserverConfig(people_from="nothing", remembers=True, threads=1), 1)
    observer.observe(sim.sense())
    for _ in range(steps):
        sim.step(Command(np.array([v], np.float32), np.array([w], np.float32)))
        observer.observe(sim.sense())
    return sim, observer


def test_a_table_is_remembered_when_it_is_too_near_for_the_camera() -> None:
    plan = FloorPlan()
    plan.table(3.0, 0.0, 0.8, 1.2)  # its front edge at x = 2.6, legs at the corners
    sim, observer = drive(Scene(plan), 0.5, 0.0, 36)
    ahead = observer.config.lidar.num_rays // 2
    x = float(sim.robot_pose[0, 0])
    assert 2.6 - x < 0.9
    scan = observer._lidar[0] * observer.config.lidar.max_range_m
    assert scan[2, ahead] > 1.5, "the lidar looks between the legs"
    assert scan[0, ahead] == pytest.approx(2.6 - x, abs=0.12)
    angles = observer.config.lidar.angles_rad
    beside = (np.abs(angles) < 0.4) & (scan[0] < 4.0)
    assert np.abs(scan[0, beside] * np.cos(angles[beside]) - (2.6 - x)).max() < 0.2


def test_what_is_beside_the_robot_stays_where_it_was() -> None:
    plan = FloorPlan()
    plan.box(2.0, 0.0, 0.3, 0.3, z_max=1.0)
    sim, observer = drive(Scene(plan), 0.0, 0.4, 36)
    yaw = float(sim.robot_pose[0, 2])
    assert yaw > 1.4
    angles, scan = observer.config.lidar.angles_rad, observer._lidar[0, 0]
    seen = scan < 1.0
    assert seen.any() and np.abs(angles[seen] + yaw).max() < 0.2
    assert scan[seen].min() * 4.0 == pytest.approx(1.85, abs=0.15)


def test_people_who_walk_by_leave_no_trail() -> None:
    pos = np.array([[2.2, -2.0]])
    crowd = Crowd(
        pos, pos + np.array([0.0, 6.0]), np.array([0.6]), np.array([0.25]), np.array([1.7]), np.array([TRAVERSING])
    )
    _, observer = drive(Scene(FloorPlan(), crowd), 0.0, 0.0, 80)
    assert (observer._lidar[0, 0] == 1.0).all()
    # Somebody who comes nearer than the camera sees.
    pos = np.array([[4.0, 0.1]])
    crowd = Crowd(
        pos, pos - np.array([6.0, 0.0]), np.array([0.4]), np.array([0.25]), np.array([1.7]), np.array([TRAVERSING])
    )
    for steps in range(60, 100, 5):
        _, observer = drive(Scene(FloorPlan(), crowd), 0.0, 0.0, steps)
        assert (observer._lidar[0, 0] == 1.0).all(), steps


def test_what_went_away_is_forgotten_and_reset_forgets_all() -> None:
    things, scan = ThingsRemembered(LIDAR, SMALL, 1, 1), np.zeros((1, LIDAR.num_rays), np.float32)
    for _ in range(STEADY_FRAMES):
        things.update(frame(np.array(2.0), (0.0, 0.0, 0.0)), ONE, scan)
        assert (scan == 1.0).all(), "not yet steady"
    things.update(frame(np.array(2.0), (0.0, 0.0, 0.0)), ONE, scan)
    assert scan.min() * 4.0 == pytest.approx(2.0, abs=0.1)
    things.update(frame(np.array(4.0), (0.0, 0.0, 0.0)), ONE, scan)
    assert (scan == 1.0).all()
    for _ in range(STEADY_FRAMES + 1):
        things.update(frame(np.array(2.0), (0.0, 0.0, 0.0)), ONE, scan)
    things.reset(ONE)
    things.update(frame(np.array(np.nan), (0.0, 0.0, 0.0)), ONE, scan)
    assert (scan == 1.0).all()


class SlowMemory:
    """The same rules over a dictionary of cells, each with its own number."""

    def __init__(self) -> None:
        self.counts: dict[tuple[int, int], int] = {}

    def update(self, depth: np.ndarray, pose: tuple[float, float, float]) -> np.ndarray:
        x, y, yaw = pose
        cos, sin, half = math.cos(yaw), math.sin(yaw), CELLS // 2
        centre = math.floor(x / CELL_M), math.floor(y / CELL_M)
        self.counts = {
            cell: count
            for cell, count in self.counts.items()
            if all(-half <= cell[a] - centre[a] < half for a in (0, 1))
        }
        rise = SMALL.mount_height_m + depth * SMALL.row_slopes[:, None]
        taken = (depth >= SMALL.min_range_m) & (depth <= SMALL.max_range_m) & (rise > LOWEST_M) & (rise < 0.8)
        nearest = np.where(taken, depth, np.inf).min(axis=0)
        scan = np.ones(LIDAR.num_rays)
        for (i, j), count in list(self.counts.items()):
            dx, dy = (i + 0.5) * CELL_M - x, (j + 0.5) * CELL_M - y
            forward, left = cos * dx + sin * dy, cos * dy - sin * dx
            if forward > SMALL.min_range_m + CELL_M:
                slope = left / forward
                edges = (SMALL.width / 2 - np.arange(SMALL.width + 1)) / SMALL.focal_px[0]
                u = int(np.searchsorted(-edges, -slope, side="right")) - 1
                if 0 <= u < SMALL.width and nearest[u] > forward + 1.5 * CELL_M:
                    del self.counts[i, j]
                    continue
            distance = math.hypot(forward, left)
            if count >= STEADY_FRAMES and CELL_M <= distance < LIDAR.max_range_m:
                covered = np.abs(LIDAR.angles_rad - math.atan2(left, forward)) <= math.atan(0.7 * CELL_M / distance)
                scan[covered] = np.minimum(scan[covered], distance / LIDAR.max_range_m)
        before = None
        for u in range(SMALL.width):
            forward, left = nearest[u], nearest[u] * SMALL.column_slopes[u]
            if math.hypot(forward, left) < (half - 1) * CELL_M:
                cell = (
                    math.floor((x + cos * forward - sin * left) / CELL_M),
                    math.floor((y + sin * forward + cos * left) / CELL_M),
                )
                if cell != before:
                    self.counts[cell] = self.counts.get(cell, 0) + 1
                before = cell
        return scan


@pytest.mark.parametrize("seed", range(4))
def test_a_slow_loop_remembers_the_same(seed: int) -> None:
    rng = np.random.default_rng(seed)
    things, slow = ThingsRemembered(LIDAR, SMALL, 1, 1), SlowMemory()
    scan, pose, remembered = np.zeros((1, LIDAR.num_rays), np.float32), np.zeros(3), 0
    depth = np.zeros((SMALL.height, SMALL.width), np.float32)
    for step in range(600):
        if step % 15 == 0:
            deep = rng.uniform(1.0, 5.5, (1, SMALL.width)) + rng.uniform(0.0, 0.3, depth.shape)
            depth = deep.astype(np.float32)
            pose += rng.uniform(-1.0, 1.0, 3)
        pose += rng.uniform(-1e-3, 1e-3, 3)
        at = (float(pose[0]), float(pose[1]), float(pose[2]))
        things.update(frame(depth, at), ONE, scan)
        expected = slow.update(depth, at)
        remembered += int((expected < 1.0).sum())
        np.testing.assert_allclose(scan[0], expected, atol=1e-6)
    assert remembered > 100
