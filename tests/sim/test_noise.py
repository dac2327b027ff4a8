"""`real` sensors: each error has the size that its configuration says, and the world itself stays as it is."""

from __future__ import annotations

import dataclasses
import math

import numpy as np
import pytest

from densecavoid.benchmark.runner import BenchmarkConfig
from densecavoid.frames import CameraConfig, Command, LidarConfig
from densecavoid.scenarios import make_scenario
from densecavoid.sim import noise
from densecavoid.sim.floorplan import FloorPlan
from densecavoid.sim.noise import SensorNoiseConfig
from densecavoid.sim.spec import WorldSpec
from densecavoid.sim.world import SimConfig, Simulator
from densecavoid.viz.run import RunConfig

NONE = SensorNoiseConfig(**dict.fromkeys(SensorNoiseConfig.__dataclass_fields__, 0.0))
LIDAR, CAMERA = LidarConfig(), CameraConfig()


def scans(exact: np.ndarray, errors: SensorNoiseConfig, count: int, lidar: LidarConfig = LIDAR) -> np.ndarray:
    """The exact scan as a real scanner gives it `count` times."""
    given = np.tile(exact.astype(np.float32), (count, 1))
    for k in range(count):
        noise.spoil_scan(given[k], np.empty_like(given[k]), np.uint64(1000 + k), noise.scan_noise(errors, lidar))
    return given


def images(exact: np.ndarray, errors: SensorNoiseConfig, count: int, camera: CameraConfig = CAMERA) -> np.ndarray:
    """The exact image as a real camera gives it `count` times."""
    given = np.tile(exact.astype(np.float32), (count, 1, 1))
    for k in range(count):
        noise.spoil_depth(given[k], np.uint64(1000 + k), noise.depth_noise(errors, camera))
    return given


@pytest.mark.parametrize("range_m", [0.5, 1.0, 2.0, 3.5])
def test_range_noise_grows_with_distance(range_m):
    given = scans(np.full(512, range_m), dataclasses.replace(NONE, lidar_range_share=0.005), 200)
    assert given.std() == pytest.approx(0.005 * max(range_m, 1.0), rel=0.02)
    assert given.mean() == pytest.approx(range_m, abs=1e-4)
    by_ray, by_scan = given.mean(axis=0).std(), given.mean(axis=1).std()
    assert by_ray < 0.12 * given.std() and by_scan < 0.08 * given.std()  # neither rays nor scans err together


def test_ranges_come_in_steps_and_some_not_at_all():
    given = scans(np.full(512, 2.3456), SensorNoiseConfig(), 200)
    returned = given[np.isfinite(given)].astype(float)
    np.testing.assert_allclose(returned * 1000, np.round(returned * 1000), atol=1e-3)
    assert np.isinf(given).mean() == pytest.approx(0.005, rel=0.1)


def test_what_is_nearer_than_a_scanner_can_see_gives_no_range():
    lidar = LidarConfig(min_range_m=0.15)
    assert np.isinf(scans(np.full(64, 0.1), NONE, 1, lidar)).all()
    assert np.isfinite(scans(np.full(64, 0.2), NONE, 1, lidar)).all()


def test_beams_on_an_edge_give_ranges_between_its_sides_as_often_as_they_are_cut():
    exact = np.where(np.arange(512) < 256, 1.0, 3.0)
    given = scans(exact, dataclasses.replace(NONE, lidar_beam_rad=0.01), 4000)
    changed = np.abs(given - exact) > 1e-6
    spacing = LIDAR.fov_rad / (LIDAR.num_rays - 1)
    np.testing.assert_allclose(changed[:, [255, 256]].mean(axis=0), 0.005 / spacing, rtol=0.06)
    assert not changed[:, :255].any() and not changed[:, 257:].any()
    assert given[changed[:, 255], 255].min() > 1.0 and given[:, 255].max() <= 2.0
    assert given[:, 256].min() >= 2.0


@pytest.mark.parametrize("depth_m", [1.5, 3.0, 4.5])
def test_depth_noise_grows_with_the_square_of_the_distance(depth_m):
    errors = dataclasses.replace(NONE, camera_floor_m=0.0012, camera_per_m2=0.0019)
    given = images(np.full((60, 80), depth_m), errors, 20)
    assert given.std() == pytest.approx(0.0012 + 0.0019 * (depth_m - 0.4) ** 2, rel=0.02)
    assert given.mean() == pytest.approx(depth_m, abs=2e-4)


def test_depth_comes_in_steps_of_the_disparity_and_has_holes():
    errors = dataclasses.replace(NONE, camera_disparity_step=0.00285, camera_dropout=0.01)
    given = images(np.broadcast_to(np.linspace(3.9, 4.1, 80), (60, 80)), errors, 10)
    steps = np.unique(given[np.isfinite(given)])
    np.testing.assert_allclose(np.diff(steps), 0.00285 * 16, rtol=0.06)
    assert np.isnan(given).mean() == pytest.approx(0.01, rel=0.1)


def test_near_things_cast_a_shadow_without_depth_on_one_side():
    exact = np.full((480, 640), 4.0)
    exact[:, 300:400] = 1.5
    camera = CameraConfig(width=640, height=480)
    given = images(exact, dataclasses.replace(NONE, camera_baseline_m=0.075), 1, camera)[0]
    parallax = camera.focal_px[0] * 0.075
    width = parallax * (1 / 1.5 - 1 / 4.0)
    lost = np.isnan(given[100])
    assert lost.sum() == pytest.approx(width, abs=1.5)
    assert lost[300 - lost.sum() : 300].all()


def test_depth_edges_jump_to_the_other_side_and_nowhere_else():
    exact = np.where(np.arange(640) < 320, 2.0, 4.0) + np.zeros((480, 1))
    camera = CameraConfig(width=640, height=480)
    given = images(exact, dataclasses.replace(NONE, camera_edge_px=0.85), 20, camera)
    changed = given != exact.astype(np.float32)
    np.testing.assert_allclose(changed[..., [319, 320]].mean(axis=(0, 1)), 0.85 / math.sqrt(2 * math.pi), rtol=0.05)
    assert not changed[..., :319].any() and not changed[..., 321:].any()


class OpenGround:
    """Nothing at all, the robot heading along x."""

    name = "open-ground"

    def spawn(self, rng: np.random.Generator) -> WorldSpec:
        return WorldSpec("open-ground", FloorPlan(), (0.0, 0.0, 0.0), (50.0, 0.0))


def after_ten_metres(errors: SensorNoiseConfig, angular: float, worlds: int = 400) -> tuple[np.ndarray, np.ndarray]:
    """Odometry and true poses of robots that drove for 10 s at 1 m/s."""
    small = {"lidar": LidarConfig(num_rays=2), "camera": CameraConfig(width=2, height=2)}
    sim = Simulator(OpenGround(), worlds, SimConfig(sensors="real", noise=errors, **small))
    sim.reset(np.arange(worlds))
    frame = sim.sense()
    np.testing.assert_array_equal(frame.odom_pose, sim.robot_pose)
    for _ in range(100):
        sim.step(Command(np.ones(worlds, np.float32), np.full(worlds, angular, np.float32)))
        frame = sim.sense()
    assert frame.truth is not None
    np.testing.assert_array_equal(frame.truth.robot_pose_w, sim.robot_pose)
    return frame.odom_pose.copy(), sim.robot_pose.copy()


def test_odometry_without_errors_is_the_truth():
    odometry, truth = after_ten_metres(NONE, 0.3, worlds=3)
    np.testing.assert_allclose(odometry, truth, atol=1e-9)


def test_odometry_errs_by_its_scale_on_a_straight_way():
    odometry, truth = after_ten_metres(dataclasses.replace(NONE, odometry_scale=0.01), 0.0)
    share = odometry[:, 0] / truth[:, 0] - 1
    assert share.std() == pytest.approx(0.01, rel=0.12) and abs(share.mean()) < 0.002
    np.testing.assert_allclose(odometry[:, 1:], truth[:, 1:], atol=1e-9)


def test_odometry_errs_in_turns_and_wanders_from_its_heading():
    odometry, truth = after_ten_metres(dataclasses.replace(NONE, odometry_turn_scale=0.01), 0.1)
    assert (odometry[:, 2] - truth[:, 2]).std() == pytest.approx(0.01 * 1.0, rel=0.12)  # 1 rad turned
    odometry, truth = after_ten_metres(dataclasses.replace(NONE, odometry_walk=0.005), 0.0)
    assert odometry[:, 2].std() == pytest.approx(0.005 * math.sqrt(10.0), rel=0.12)


@pytest.mark.parametrize("name", ["dense-ped", "random-sparse-ped"])
def test_real_sensors_give_the_same_bits_for_any_batch_and_threads_and_however_often_one_looks(name):
    def course(batch: int, threads: int, looks: int) -> tuple[np.ndarray, ...]:
        sim = Simulator(make_scenario(name), batch, SimConfig(sensors="real", threads=threads))
        sim.reset(70 - np.arange(batch))
        for _ in range(10):
            sim.step(Command(np.full(batch, 0.4, np.float32), np.full(batch, 0.2, np.float32)))
            for _ in range(looks):
                sim.sense()
        frame = sim.sense()
        return frame.scan_m[0], frame.depth_m[0], frame.odom_pose[0], sim.people().pos_w[0]

    reference = course(1, 1, 1)
    for arguments in ((5, 1, 1), (6, 2, 1), (1, 1, 3)):
        for a, b in zip(reference, course(*arguments), strict=True):
            np.testing.assert_array_equal(a, b)


def test_noise_does_not_change_the_world_and_is_new_in_every_step_and_episode():
    sims = [Simulator(make_scenario("dense-ped"), 2, SimConfig(sensors=s)) for s in ("clean", "real")]
    for sim in sims:
        sim.reset(np.array([3, 3]))
    scans_then = []
    for _ in range(5):
        for sim in sims:
            sim.step(Command(np.zeros(2, np.float32), np.zeros(2, np.float32)))
        clean, real = (sim.sense() for sim in sims)
        errors = np.full_like(real.scan_m, np.nan)
        scans_then.append(np.subtract(real.scan_m, clean.scan_m, out=errors, where=np.isfinite(clean.scan_m)))
        np.testing.assert_array_equal(sims[0].people().pos_w, sims[1].people().pos_w)
        np.testing.assert_array_equal(sims[0].robot_pose, sims[1].robot_pose)
        np.testing.assert_array_equal(real.scan_m[0], real.scan_m[1])  # the same seed is the same episode
    both = np.isfinite(scans_then[0][0]) & np.isfinite(scans_then[1][0])
    assert (scans_then[0][0] != scans_then[1][0])[both].mean() > 0.5
    sims[1].reset(np.array([3, 4]))
    assert (sims[1].sense().scan_m[0] != sims[1].sense().scan_m[1]).any()


def test_a_saved_simulator_with_real_sensors_goes_on_with_the_same_bits():
    first, second = (Simulator(make_scenario("random-sparse-ped"), 2, SimConfig(sensors="real")) for _ in range(2))
    first.reset(np.array([1, 2]))
    command = Command(np.full(2, 0.3, np.float32), np.full(2, 0.1, np.float32))
    for _ in range(5):
        first.step(command)
        first.sense()
    second.load_state_dict(first.state_dict())
    frames = []
    for sim in (first, second):
        sim.step(command)
        frames.append(sim.sense())
    np.testing.assert_array_equal(frames[0].odom_pose, frames[1].odom_pose)
    np.testing.assert_array_equal(frames[0].depth_m, frames[1].depth_m)


def test_commands_take_real_sensors_and_errors_that_cannot_be_are_refused():
    assert BenchmarkConfig(sensors="real").sim_config(1).sensors == "real"
    assert RunConfig(sensors="real").sensors == "real"
    with pytest.raises(ValueError, match=r"lidar_dropout is 1\.5"):
        SensorNoiseConfig(lidar_dropout=1.5)
    with pytest.raises(ValueError, match="camera_floor_m is nan"):
        SensorNoiseConfig(camera_floor_m=math.nan)
