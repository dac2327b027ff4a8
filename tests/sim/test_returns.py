"""What real sensors lose to dark and grazing surfaces, and what glass returns: by hand, and by counting."""

from __future__ import annotations

import dataclasses
import math

import numpy as np
import pytest

from densecavoid.frames import CameraConfig, Command, LidarConfig
from densecavoid.sim.floorplan import FloorPlan
from densecavoid.sim.noise import SensorNoiseConfig
from densecavoid.sim.spec import WorldSpec
from densecavoid.sim.world import SimConfig, Simulator

NONE = SensorNoiseConfig(**dict.fromkeys(SensorNoiseConfig.__dataclass_fields__, 0.0))
LIDAR = LidarConfig(sweep_s=0.0)


class OneWorld:
    name = "one"

    def __init__(self, plan: FloorPlan, start: tuple[float, float, float] = (0.0, 0.0, 0.0)) -> None:
        self.spec = WorldSpec("one", plan, start, (50.0, 0.0), collision_distance_m=0.18)

    def spawn(self, rng: np.random.Generator) -> WorldSpec:
        return self.spec


def simulate(plan: FloorPlan, noise: SensorNoiseConfig | None = None, worlds: int = 1, **config) -> Simulator:
    """Real sensors with these errors alone; exact ones without."""
    sensors = "clean" if noise is None else "real"
    sim = Simulator(
        OneWorld(plan), worlds, SimConfig(sensors=sensors, noise=noise or NONE, **{"lidar": LIDAR, **config})
    )
    sim.reset(np.arange(worlds))
    return sim


def wall(distance_m: float, material: str) -> FloorPlan:
    plan = FloorPlan()
    plan.box(distance_m + 0.5, 0.0, 1.0, 30.0, z_max=2.5, material=material)
    return plan


def test_exact_sensors_look_through_glass_and_the_robot_hits_it():
    plan = wall(3.0, "plaster")
    plan.wall(1.0, -5.0, 1.0, 5.0, 0.02, "glass")
    sim = simulate(plan)
    frame = sim.sense()
    assert frame.scan_m[0, 255:257].mean() == pytest.approx(3.0, abs=1e-3)
    assert frame.depth_m[0, 25, 40] == pytest.approx(3.0, abs=1e-4)
    assert sim.clearance_m[0] == pytest.approx(0.99, abs=1e-6)
    for _ in range(10):
        sim.step(Command(np.ones(1, np.float32), np.zeros(1, np.float32)))
    assert sim.collided[0]


@pytest.mark.parametrize("peak", [0.3, 0.95])
def test_glass_returns_as_often_as_documented(peak):
    plan = wall(3.0, "plaster")
    plan.wall(1.0, -5.0, 1.0, 5.0, 0.02, "glass")
    noise = dataclasses.replace(NONE, lidar_glass=peak, camera_glass=peak, glass_angle_rad=0.14)
    frame = simulate(plan, noise, worlds=400).sense()
    pane = np.abs(frame.scan_m - 0.99 / np.cos(LIDAR.angles_rad)) < 1e-3
    for angle in (0.0, 0.1, 0.2):
        rays = np.abs(np.abs(LIDAR.angles_rad) - angle) < 0.02
        expected = (peak * np.exp(-((LIDAR.angles_rad[rays] / 0.14) ** 2))).mean()
        assert pane[:, rays].mean() == pytest.approx(expected, abs=0.03)
    beyond = np.abs(np.abs(LIDAR.angles_rad) - 0.5) < 0.02
    np.testing.assert_allclose(
        frame.scan_m[:, beyond], np.broadcast_to(3.0 / np.cos(LIDAR.angles_rad[beyond]), (400, beyond.sum())), rtol=1e-4
    )
    near = CameraConfig(min_range_m=0.5)
    image = simulate(plan, noise, worlds=200, camera=near).sense().depth_m
    middle = image[:, 29:31, 39:41]
    assert (np.abs(middle - 0.99) < 1e-3).mean() == pytest.approx(peak, abs=0.05)
    assert (np.abs(middle - 3.0) < 1e-3).mean() == pytest.approx(1 - peak, abs=0.05)


@pytest.mark.parametrize(("material", "infrared"), [("plaster", 0.8), ("wood", 0.6), ("black", 0.04)])
def test_dark_walls_are_lost_beyond_the_distance_that_their_reflectance_gives(material, infrared):
    """By hand: reflectance / distance^2 = 1 / reach^2, blurred by a tenth of the distance."""
    lost_at = 3.0 * math.sqrt(infrared)
    noise = dataclasses.replace(NONE, lidar_reach=3.0 / LIDAR.max_range_m, camera_reach_m=3.0)
    ahead = np.abs(LIDAR.angles_rad) < 0.02
    camera = CameraConfig(min_range_m=0.2)
    for distance, seen in ((0.88 * lost_at, 1.0), (1.12 * lost_at, 0.0)):
        frame = simulate(wall(distance, material), noise, worlds=20, camera=camera).sense()
        assert np.isfinite(frame.scan_m[:, ahead]).mean() == seen
        assert np.isfinite(frame.depth_m[:, 29:31, 39:41]).mean() == seen


def test_grazing_beams_are_lost():
    """A wall 1 m to the left: at angle a from its normal it is 1 / cos(a) away and returns cos(a)^3 of the light."""
    plan = FloorPlan()
    plan.box(0.0, 1.5, 30.0, 1.0, z_max=2.5, material="plaster")
    noise = dataclasses.replace(NONE, lidar_reach=1.8 / LIDAR.max_range_m)
    scan = simulate(plan, noise, worlds=50).sense().scan_m
    limit = math.acos((1.0 / (0.8 * 1.8**2)) ** (1 / 3))
    from_normal = np.abs(LIDAR.angles_rad - math.pi / 2)
    assert np.isfinite(scan[:, from_normal < limit - 0.1]).all()
    assert np.isinf(scan[:, (from_normal > limit + 0.1) & (LIDAR.angles_rad > 0)]).all()


def test_a_sweep_measures_each_ray_from_where_the_scanner_then_was():
    """Against exact scanners that stand where the moving one was at the moment of each ray."""
    plan = FloorPlan()
    plan.room(-3.0, -2.0, 3.5, 2.5)
    plan.pillar(1.5, 1.0, 0.2)
    plan.box(1.8, -0.9, 0.5, 0.7, 0.4)
    lidar = LidarConfig(sweep_s=0.1, num_rays=121, mount_x_m=0.1)
    linear, angular = 1.0, 0.4
    sim = simulate(plan, NONE, lidar=lidar)
    for _ in range(5):
        sim.step(Command(np.full(1, linear, np.float32), np.full(1, angular, np.float32)))
    swept, (x, y, yaw) = sim.sense().scan_m[0], sim.robot_pose[0]
    exact = simulate(plan, lidar=lidar).sense().scan_m[0]
    still = Simulator(OneWorld(plan, (float(x), float(y), float(yaw))), 1, SimConfig(lidar=lidar))
    still.reset(np.zeros(1, np.int64))
    moved = 0
    for r, time_s in enumerate(np.linspace(-lidar.sweep_s, 0.0, lidar.num_rays)):
        then = yaw + angular * time_s
        chord = (yaw + then) / 2  # of the arc driven since
        start = (x + linear * time_s * math.cos(chord), y + linear * time_s * math.sin(chord), then)
        then_sim = Simulator(OneWorld(plan, start), 1, SimConfig(lidar=lidar))
        then_sim.reset(np.zeros(1, np.int64))
        exact = then_sim.sense().scan_m[0]
        around = exact[max(r - 1, 0) : r + 2]
        if np.isfinite(around).all() and np.ptp(around) < 0.2:  # away from edges
            assert swept[r] == pytest.approx(exact[r], abs=0.004)
            moved += abs(swept[r] - still.sense().scan_m[0, r]) > 0.01
    assert moved > 30  # the motion shows


def test_a_sweep_sees_people_where_they_then_were():
    from densecavoid.sim.people import TRAVERSING
    from densecavoid.sim.spec import Crowd

    one = np.ones(1)
    crowd = Crowd(
        np.array([[2.2, 0.0]]), np.array([[-9.0, 0.0]]), 1.0 * one, 0.25 * one, 1.7 * one, np.array([TRAVERSING])
    )

    class Oncoming:
        name = "oncoming"

        def spawn(self, rng: np.random.Generator) -> WorldSpec:
            return WorldSpec("oncoming", FloorPlan(), (0.0, 0.0, 0.0), (50.0, 0.0), crowd)

    def nearest(sweep_s: float) -> tuple[float, int]:
        lidar = LidarConfig(sweep_s=sweep_s)
        sim = Simulator(Oncoming(), 1, SimConfig(sensors="real", noise=NONE, lidar=lidar))
        sim.reset(np.zeros(1, np.int64))
        sim.step(Command(np.zeros(1, np.float32), np.zeros(1, np.float32)))
        scan = sim.sense().scan_m[0]
        return float(scan.min()), int(np.argmin(scan))

    (at_once, _), (swept, ray) = nearest(0.0), nearest(0.2)
    age = 0.2 * (1 - ray / 511)
    assert swept - at_once == pytest.approx(1.0 * age, abs=0.005)
