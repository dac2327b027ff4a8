"""Lidar and depth camera against a slow loop that knows nothing of prisms: planes and circles in float64."""

from __future__ import annotations

import math

import numpy as np
import pytest

from densecavoid.frames import CameraConfig, Command, LidarConfig
from densecavoid.scenarios import make_scenario
from densecavoid.sim.floorplan import WALL_HEIGHT_M, FloorPlan
from densecavoid.sim.people import PARTS
from densecavoid.sim.spec import WorldSpec
from densecavoid.sim.world import SimConfig, Simulator


class OneWorld:
    """A scenario of a single given world."""

    name = "one"

    def __init__(self, plan: FloorPlan, start=(0.0, 0.0, 0.0), goal=(50.0, 0.0), **kwargs) -> None:
        self.spec = WorldSpec("one", plan, start, goal, **kwargs)

    def spawn(self, rng: np.random.Generator) -> WorldSpec:
        return self.spec


def simulate(plan: FloorPlan, config: SimConfig | None = None, **kwargs) -> Simulator:
    sim = Simulator(OneWorld(plan, **kwargs), 1, config)
    sim.reset(np.zeros(1, np.int64))
    return sim


def slow_ray(origin, direction, boxes, cylinders) -> float:
    """Nearest hit of a ray with solids, each face by itself: the four sides, top and bottom of boxes and cylinders."""
    o, d = np.array(origin, float), np.array(direction, float)
    hits = [(z - o[2]) / d[2] for z in (0.0, WALL_HEIGHT_M) if d[2] != 0]
    for x, y, yaw, half_length, half_width, z0, z1 in boxes:
        axes = np.array([[math.cos(yaw), math.sin(yaw), 0], [-math.sin(yaw), math.cos(yaw), 0], [0, 0, 1]])
        low, high = np.array([-half_length, -half_width, z0]), np.array([half_length, half_width, z1])
        start, along = axes @ (o - [x, y, 0]), axes @ d
        for axis in range(3):
            for face in (low[axis], high[axis]):
                if abs(along[axis]) > 1e-12:
                    t = (face - start[axis]) / along[axis]
                    point, others = start + t * along, np.arange(3) != axis
                    if ((low <= point) & (point <= high))[others].all():
                        hits.append(t)
    for x, y, r, z0, z1 in cylinders:
        if r <= 0:
            continue
        a, b = d[0] ** 2 + d[1] ** 2, 2 * ((o[0] - x) * d[0] + (o[1] - y) * d[1])
        c = (o[0] - x) ** 2 + (o[1] - y) ** 2 - r * r
        if b * b >= 4 * a * c:
            sides = [(-b + sign * math.sqrt(b * b - 4 * a * c)) / (2 * a) for sign in (-1, 1)]
            hits += [t for t in sides if z0 <= o[2] + t * d[2] <= z1]
        caps = [(z - o[2]) / d[2] for z in (z0, z1) if d[2] != 0]
        hits += [t for t in caps if (o[0] + t * d[0] - x) ** 2 + (o[1] + t * d[1] - y) ** 2 <= r * r]
    return min((t for t in hits if t > 0), default=math.inf)


def solids(sim: Simulator, b: int):
    """Every box and cylinder of a world, people's parts included."""
    plan = sim.floor_plan(b)
    parts = sim._state.cylinders[b, : PARTS * sim._state.pos.shape[1]].astype(float)
    return plan.boxes, np.vstack([plan.cylinders, parts])


def share_that_agrees(fast: np.ndarray, slow: np.ndarray) -> float:
    same = np.isclose(fast, slow, atol=2e-3, rtol=0, equal_nan=True) | ((fast == np.inf) & (slow == np.inf))
    return float(same.mean())


@pytest.mark.parametrize("name", ["dense-static", "random-sparse-ped", "dense-ped"])
def test_lidar_agrees_with_a_slow_loop(name):
    lidar = LidarConfig(num_rays=128)
    sim = Simulator(make_scenario(name), 2, SimConfig(lidar=lidar))
    sim.reset(np.array([5, 6]))
    sim.step(Command(np.full(2, 0.4), np.full(2, 0.3)))
    scan = sim.sense().scan_m
    for b in range(2):
        x, y, yaw = sim.robot_pose[b]
        boxes, cylinders = solids(sim, b)
        slow = np.array(
            [
                slow_ray((x, y, 0.26), (math.cos(yaw + a), math.sin(yaw + a), 0.0), boxes, cylinders)
                for a in lidar.angles_rad
            ]
        )
        slow[slow > lidar.max_range_m] = np.inf
        assert share_that_agrees(scan[b], slow) >= 0.99  # float32 may decide otherwise right at an edge


@pytest.mark.parametrize("name", ["dense-static", "random-sparse-ped", "dense-ped"])
def test_depth_agrees_with_a_slow_loop(name):
    camera = CameraConfig(width=32, height=24)
    sim = Simulator(make_scenario(name), 2, SimConfig(camera=camera))
    sim.reset(np.array([7, 8]))
    sim.step(Command(np.full(2, 0.4), np.full(2, 0.3)))
    depth = sim.sense().depth_m
    for b in range(2):
        x, y, yaw = sim.robot_pose[b]
        boxes, cylinders = solids(sim, b)
        slow = np.full((24, 32), np.nan)
        for v, up in enumerate(camera.row_slopes):
            for u, left in enumerate(camera.column_slopes):
                ray = (math.cos(yaw) - left * math.sin(yaw), math.sin(yaw) + left * math.cos(yaw), up)
                t = slow_ray((x, y, 0.40), ray, boxes, cylinders)
                slow[v, u] = t if camera.min_range_m <= t <= camera.max_range_m else np.nan
        assert share_that_agrees(depth[b], slow) >= 0.99


def test_wall_two_metres_ahead_by_hand():
    plan = FloorPlan()
    plan.box(2.5, 0.0, 1.0, 20.0, z_max=2.5)
    frame = simulate(plan).sense()
    lidar = LidarConfig()
    ahead = np.abs(lidar.angles_rad) < math.radians(55)
    np.testing.assert_allclose(frame.scan_m[0, ahead], 2.0 / np.cos(lidar.angles_rad[ahead]), rtol=1e-4)
    assert np.isinf(frame.scan_m[0, np.abs(lidar.angles_rad) > math.radians(65)]).all()
    # the optical-axis depth of a wall across it is the same everywhere, floor nearer than 2 m aside
    assert frame.depth_m[0, 20:35] == pytest.approx(np.full((15, 80), 2.0), abs=1e-5)


def test_floor_depth_by_hand():
    depth = simulate(FloorPlan()).sense().depth_m[0]
    camera = CameraConfig()
    for row, slope in enumerate(camera.row_slopes):
        floor = 0.40 / -slope if slope < 0 else (WALL_HEIGHT_M - 0.40) / slope
        expected = floor if 1.4 <= floor <= 5.0 else np.nan
        np.testing.assert_allclose(depth[row], expected, rtol=1e-5)


def test_table_is_legs_to_the_lidar_and_a_top_to_the_camera():
    plan = FloorPlan()
    plan.table(2.5, 0.0, 1.0, 1.0, height=0.60)
    frame = simulate(plan).sense()
    ahead = np.abs(LidarConfig().angles_rad) < math.radians(15)
    seen = np.isfinite(frame.scan_m[0, ahead]).mean()
    assert 0.0 < seen < 0.4
    row = int(30 - (0.58 - 0.40) / 2.0 * CameraConfig().focal_px[1])
    assert np.isfinite(frame.depth_m[0, row, 30:50]).all()
    assert frame.depth_m[0, row, 40] == pytest.approx(2.0, abs=1e-3)


def test_nothing_behind_the_scanner_leaks_to_the_front():
    plan = FloorPlan()
    plan.pillar(-1.0, 0.0, 0.3)
    frame = simulate(plan).sense()
    assert np.isinf(frame.scan_m).all()


def test_what_lies_right_behind_is_seen_on_both_ends_of_a_full_scan():
    plan = FloorPlan()
    plan.pillar(-1.0, 0.0, 0.3)
    scan = simulate(plan, SimConfig(lidar=LidarConfig(num_rays=361, fov_rad=2 * math.pi))).sense().scan_m[0]
    assert scan[0] == pytest.approx(0.7, abs=1e-5)
    assert scan[-1] == pytest.approx(0.7, abs=1e-5)
    assert np.isinf(scan[100:261]).all()
