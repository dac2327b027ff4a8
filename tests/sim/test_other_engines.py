"""Lidar and depth camera against engines that nobody here wrote: MuJoCo's and PyBullet's rays in the same scenes."""

from __future__ import annotations

import numpy as np
import pytest

pytest.importorskip("mujoco")
pytest.importorskip("pybullet")

from densecavoid.frames import CameraConfig, Command, LidarConfig
from densecavoid.scenarios import make_scenario
from densecavoid.sim.people import LEFT_TRUNK
from densecavoid.sim.world import SimConfig, Simulator
from peers.ray_engines import Hits, MujocoRays, PybulletRays, camera_rays, lidar_rays

SCENARIOS = ("dense-static", "random-sparse-ped", "dense-ped", "corridor-15", "dense-random-pedestrians")
TOLERANCE_M = 2e-3
JUMP_M = 0.05
"""Neighbouring values that differ by more than this, or by a tenth of the range, do not belong to one surface."""


DEFAULT = SimConfig(threads=1)
MOUNTED = SimConfig(
    threads=1,
    lidar=LidarConfig(mount_x_m=0.12, mount_height_m=0.35, mount_pitch_rad=0.12),
    camera=CameraConfig(mount_x_m=-0.1, mount_height_m=1.1, mount_pitch_rad=0.35, min_range_m=0.3),
)
"""Off the robot's centre, the camera high and looking down."""


def scene(name: str, seed: int, config: SimConfig = DEFAULT) -> Simulator:
    """A world of the scenario with its people in mid-stride."""
    sim = Simulator(make_scenario(name), 1, config)
    sim.reset(np.array([seed]))
    drive = np.random.default_rng(seed).uniform([0.0, -0.4], [1.0, 0.4])
    for _ in range(8):
        if not sim.done[0]:  # a robot that has collided may be driven on, with its sensors inside of things
            sim.step(Command(np.full(1, drive[0], np.float32), np.full(1, drive[1], np.float32)))
    return sim


def at_silhouette(hits: Hits, shape: tuple[int, ...]) -> np.ndarray:
    """Rays with a neighbour (in a scan: two; in an image: four) that meets another solid, or the same one elsewhere."""
    distance, solid = hits.distance.reshape(shape), hits.solid.reshape(shape)
    finite = np.where(np.isfinite(distance), distance, 1e3)
    edge = np.zeros(shape, bool)
    for axis in range(len(shape)):
        here, there = [[slice(None)] * len(shape) for _ in range(2)]
        here[axis], there[axis] = slice(None, -1), slice(1, None)
        a, b = tuple(here), tuple(there)
        jump = np.abs(finite[a] - finite[b]) > np.maximum(JUMP_M, 0.1 * np.minimum(finite[a], finite[b]))
        differs = (solid[a] != solid[b]) | jump
        edge[a] |= differs
        edge[b] |= differs
    return edge


def agrees(ours: np.ndarray, theirs: np.ndarray, least: float, most: float) -> np.ndarray:
    """Values within the tolerance, where ours has none for what is out of range."""
    same = np.isclose(ours, theirs, rtol=0.0, atol=TOLERANCE_M)
    out_of_range = (theirs < least + TOLERANCE_M) | (theirs > most - TOLERANCE_M)
    return np.where(np.isfinite(ours), same, out_of_range)


def compare(
    names: tuple[str, ...], seeds: range, config: SimConfig = DEFAULT
) -> dict[tuple[str, str], tuple[float, float]]:
    """(engine, sensor) -> share of values away from silhouettes that agree, and share of values that are so."""
    verdicts: dict[tuple[str, str], list[np.ndarray]] = {}
    for name in names:
        for seed in seeds:
            sim = scene(name, seed, config)
            lidar, camera, pose = sim.config.lidar, sim.config.camera, sim.robot_pose[0]
            frame = sim.sense()
            sensors = {
                "lidar": (*lidar_rays(lidar, pose), frame.scan_m[0], 0.0, lidar.max_range_m),
                "depth": (*camera_rays(camera, pose), frame.depth_m[0], camera.min_range_m, camera.max_range_m),
            }
            exact = MujocoRays(sim.floor_plan(0), sim.body_cylinders(0))
            bullet = PybulletRays(sim.floor_plan(0), sim.body_cylinders(0), scale=100.0)
            for sensor, (origin, directions, ours, least, most) in sensors.items():
                casts = {
                    "mujoco": exact.caster(origin, directions, most + 0.5)(),
                    "pybullet": bullet.caster(origin, directions, most + 0.5)(),
                }
                edge = np.logical_or(*(at_silhouette(hits, ours.shape) for hits in casts.values()))
                for engine, hits in casts.items():
                    good = agrees(ours, hits.distance.reshape(ours.shape), least, most)
                    verdicts.setdefault((engine, sensor), []).append(np.stack([good, ~edge]).reshape(2, -1))
            bullet.close()
    shares = {}
    for key, parts in verdicts.items():
        good, away = np.concatenate(parts, axis=1)
        shares[key] = (float(good[away].mean()), float(away.mean()))
    return shares


def check(shares: dict[tuple[str, str], tuple[float, float]]) -> None:
    assert len(shares) == 4
    for key, (agreed, compared) in shares.items():
        assert agreed >= 0.999, (key, agreed)
        assert compared >= 0.5, (key, compared)  # what is called an edge is the exception


@pytest.mark.parametrize("config", [DEFAULT, MOUNTED], ids=["default", "mounted"])
def test_rays_agree_with_mujoco_and_pybullet(config):
    check(compare(SCENARIOS, range(1, 2), config))


@pytest.mark.slow
@pytest.mark.parametrize("config", [DEFAULT, MOUNTED], ids=["default", "mounted"])
def test_rays_agree_with_mujoco_and_pybullet_in_a_hundred_scenes(config):
    check(compare(SCENARIOS, range(100, 120), config))


def test_people_and_furniture_are_all_in_the_exported_world():
    sim = scene("dense-random-pedestrians", 3)
    plan, bodies = sim.floor_plan(0), sim.body_cylinders(0)
    model = MujocoRays(plan, bodies).model
    parts = bodies[bodies[..., 2] > 0]
    assert model.ngeom == 2 + len(plan.boxes) + len(plan.cylinders) + len(parts)
    names = [model.geom(i).name for i in range(model.ngeom)]
    person = names.index("person-0-left-trunk")
    x, y, radius, z_min, z_max = bodies[0, LEFT_TRUNK]
    np.testing.assert_allclose(model.geom_pos[person], [x, y, (z_min + z_max) / 2], rtol=1e-12)
    np.testing.assert_allclose(model.geom_size[person, :2], [radius, (z_max - z_min) / 2], rtol=1e-12)
