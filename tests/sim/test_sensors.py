"""Sensors that are not the default: presets, native resolutions, mounts, rates and latencies."""

from __future__ import annotations

import dataclasses
import math

import numpy as np
import pytest

from densecavoid.frames import CameraConfig, Command, LidarConfig
from densecavoid.scenarios import make_scenario
from densecavoid.sim.floorplan import FloorPlan
from densecavoid.sim.sensor_presets import CAMERAS, LIDARS, camera_preset, lidar_preset
from densecavoid.sim.spec import WorldSpec
from densecavoid.sim.world import SimConfig, Simulator


class WallAhead:
    """A wall across the way, its face 3 m ahead of the robot."""

    name = "wall-ahead"

    def spawn(self, rng: np.random.Generator) -> WorldSpec:
        plan = FloorPlan()
        plan.box(3.5, 0.0, 1.0, 40.0, z_max=2.5)
        return WorldSpec("wall-ahead", plan, (0.0, 0.0, 0.0), (50.0, 0.0))


def facing_the_wall(config: SimConfig, worlds: int = 1) -> Simulator:
    sim = Simulator(WallAhead(), worlds, config)
    sim.reset(np.zeros(worlds, np.int64))
    return sim


def drive(sim: Simulator, linear: float) -> None:
    sim.step(Command(np.full(sim.num_worlds, linear, np.float32), np.zeros(sim.num_worlds, np.float32)))


@pytest.mark.parametrize("name", LIDARS)
def test_every_lidar_preset_sees_the_wall(name):
    config = lidar_preset(name)
    scan = facing_the_wall(SimConfig(lidar=config)).sense().scan_m[0]
    assert scan.shape == (config.num_rays,)
    ahead = np.abs(config.angles_rad) < math.radians(40)
    np.testing.assert_allclose(scan[ahead], 3.0 / np.cos(config.angles_rad[ahead]), rtol=1e-4)


@pytest.mark.parametrize("name", CAMERAS)
def test_every_camera_preset_sees_the_wall_at_its_native_resolution(name):
    config = camera_preset(name)
    depth = facing_the_wall(SimConfig(camera=config)).sense().depth_m[0]
    assert depth.shape == (config.height, config.width)
    np.testing.assert_allclose(depth[config.height // 2 - 3], 3.0, atol=1e-5)


def test_an_unknown_preset_names_those_there_are():
    with pytest.raises(ValueError, match="rplidar-a2"):
        lidar_preset("sick")
    with pytest.raises(ValueError, match="realsense-d435"):
        camera_preset("kinect")


@pytest.mark.parametrize(("width", "height"), [(400, 360), (640, 480)])
def test_pixels_of_a_finer_image_are_those_of_the_coarse_one_where_they_look_the_same_way(width, height):
    fine = SimConfig(camera=CameraConfig(width=width, height=height))
    coarse = dataclasses.replace(fine, camera=CameraConfig(width=width // 5, height=height // 5))
    images = []
    for config in (fine, coarse):
        sim = Simulator(make_scenario("dense-static"), 1, config)
        sim.reset(np.array([4]))
        images.append(sim.sense().depth_m[0])
    np.testing.assert_allclose(images[0][2::5, 2::5], images[1], rtol=1e-4)  # centres of 5 x 5 blocks


@pytest.mark.parametrize("name", ["dense-static", "random-sparse-ped"])
def test_the_general_camera_agrees_with_the_level_one_as_pitch_vanishes(name):
    level, almost = (SimConfig(camera=CameraConfig(mount_pitch_rad=pitch)) for pitch in (0.0, 1e-7))
    images = []
    for config in (level, almost):
        sim = Simulator(make_scenario(name), 4, config)
        sim.reset(np.arange(4))
        images.append(sim.sense().depth_m)
    same = np.isclose(*images, atol=1e-4, equal_nan=True)
    assert same.mean() > 0.9995


def test_a_camera_that_looks_down_sees_the_floor_where_trigonometry_puts_it():
    camera = CameraConfig(mount_pitch_rad=0.6, mount_height_m=1.0, min_range_m=0.1)
    depth = facing_the_wall(SimConfig(camera=camera)).sense().depth_m[0]
    for row in (40, 50, 59):
        below = 0.6 - math.atan(camera.row_slopes[row])
        expected = 1.0 / math.sin(below) * math.cos(below - 0.6)
        np.testing.assert_allclose(depth[row], expected, rtol=1e-5)


def test_a_sensor_ahead_of_the_centre_is_nearer_to_what_is_ahead():
    config = SimConfig(lidar=LidarConfig(mount_x_m=0.1), camera=CameraConfig(mount_x_m=-0.2))
    frame = facing_the_wall(config).sense()
    assert frame.scan_m[0, [255, 256]] == pytest.approx(2.9, abs=1e-4)
    assert frame.depth_m[0, 28, 40] == pytest.approx(3.2, abs=1e-5)


@pytest.mark.parametrize(
    ("rate_hz", "latency_s", "ages"),
    [
        (0.0, 0.2, [0, 1, 2, 2, 2, 2, 2, 2]),
        (5.0, 0.0, [0, 1, 0, 1, 0, 1, 0, 1]),
        (5.0, 0.1, [0, 1, 2, 1, 2, 1, 2, 1]),
        (30.0, 0.0, [0, 0, 0, 0, 0, 0, 0, 0]),
    ],
)
def test_a_frame_is_as_old_as_rate_and_latency_say(rate_hz, latency_s, ages):
    lidar = LidarConfig(num_rays=3, rate_hz=rate_hz, latency_s=latency_s)
    sim = facing_the_wall(SimConfig(lidar=lidar, camera=CameraConfig(rate_hz=rate_hz, latency_s=latency_s)))
    for step, age in enumerate(ages):
        frame = sim.sense()
        assert frame.scan_m[0, 1] == pytest.approx(3.0 - 0.1 * (step - age), abs=1e-4), step
        assert frame.depth_m[0, 28, 40] == pytest.approx(3.0 - 0.1 * (step - age), abs=1e-4), step
        drive(sim, 1.0)


def test_a_new_episode_forgets_late_frames_of_the_last_and_a_saved_one_keeps_them():
    sim, other = (facing_the_wall(SimConfig(lidar=LidarConfig(num_rays=3, latency_s=0.3)), 2) for _ in range(2))
    for _ in range(6):
        sim.sense()
        drive(sim, 1.0)
    other.load_state_dict(sim.state_dict())
    np.testing.assert_array_equal(sim.sense().scan_m, other.sense().scan_m)
    sim.reset(np.zeros(2, np.int64), np.array([False, True]))
    np.testing.assert_allclose(sim.sense().scan_m[:, 1], [2.7, 3.0], atol=1e-4)


def test_sensors_that_cannot_be_are_refused_by_name():
    with pytest.raises(ValueError, match=r"latency_s is 0\.05"):
        SimConfig(lidar=LidarConfig(latency_s=0.05))
    with pytest.raises(ValueError, match=r"rate_hz is 7\.0"):
        SimConfig(camera=CameraConfig(rate_hz=7.0))
    with pytest.raises(ValueError, match="mount_pitch_rad"):
        CameraConfig(mount_pitch_rad=1.3)
