"""Scans of where people will be, beside the intersection of every ray with every circle."""

from __future__ import annotations

import math

import numpy as np
import pytest
from gymnasium.spaces import Dict

from densecavoid import make_vec
from densecavoid.env.observation import ObserverConfig
from densecavoid.frames import NUM_SCANS, LidarConfig
from densecavoid.perception.foretold_scans import REACH_M, draw_foretold_scans
from densecavoid.perception.prediction_frame import Expected
from densecavoid.sim.world import SimConfig

RAYS, FOV = 64, math.radians(240)


def intersections(expected: Expected, pose: np.ndarray, b: int) -> np.ndarray:
    """[H, rays] by solving the quadratic of each ray and circle."""
    horizons = expected.pos.shape[1]
    scans = np.ones((horizons, RAYS))
    for k in range(horizons):
        for r, angle in enumerate(pose[b, 2] + np.linspace(-FOV / 2, FOV / 2, RAYS)):
            ray = np.array([math.cos(angle), math.sin(angle)])
            for n in range(expected.first[b], expected.first[b + 1]):
                to, radius = expected.pos[n, k] - pose[b, :2], expected.body[n, 0]
                along, inside = to @ ray, radius**2 - to @ to + (to @ ray) ** 2
                if to @ to <= radius**2:
                    scans[k, r] = 0.0
                elif inside >= 0 and along > 0:
                    scans[k, r] = min(scans[k, r], (along - math.sqrt(inside)) / REACH_M)
    return scans


@pytest.mark.parametrize("seed", range(5))
def test_each_ray_ends_at_the_first_of_those_who_are_expected(seed: int) -> None:
    rng = np.random.default_rng(seed)
    pos = rng.uniform(-7, 7, (9, 3, 2))
    body = np.stack([rng.uniform(0.2, 0.4, 9), np.full(9, 1.7)], axis=1)
    pose = rng.uniform(-1, 1, (2, 3)) * [1, 1, math.pi]
    pos[0, 0] = pose[0, :2] + [0.1, 0.0]  # the robot would stand in somebody
    pos[1] = np.nan
    expected = Expected(pos, np.zeros((9, 3, 3)), body, np.array([0, 5, 9]))
    scans = np.full((2, 3, RAYS), 0.5, np.float32)
    draw_foretold_scans(0, 2, np.ones(2, np.bool_), scans, expected, pose, FOV)
    for b in range(2):
        np.testing.assert_allclose(scans[b], intersections(expected, pose, b), atol=2e-6)
    assert (scans < 1).any() and (scans == 1).any()


def test_worlds_without_a_new_frame_keep_theirs() -> None:
    scans = np.full((2, 1, RAYS), 0.5, np.float32)
    nobody = Expected(np.zeros((0, 1, 2)), np.zeros((0, 1, 3)), np.zeros((0, 2)), np.zeros(3, np.int64))
    draw_foretold_scans(0, 2, np.array([True, False]), scans, nobody, np.zeros((2, 3)), FOV)
    assert (scans[0] == 1.0).all() and (scans[1] == 0.5).all()


def test_observations_have_them_behind_the_lidars_own_and_they_look_ahead() -> None:
    """Somebody who comes along the corridor is nearer in the scan of two seconds from now than in that of a tenth."""
    sim = SimConfig(threads=1)
    observer = ObserverConfig(sim.lidar, sim.camera, people_from="boxes", foretold_s=(0.1, 2.0), threads=1)
    env = make_vec("dense-ped", 8, sim=sim, observer=observer)
    seen, _ = env.reset(seed=3)
    for _ in range(30):
        seen, *_ = env.step(np.zeros((8, 2)))
    shape = (NUM_SCANS + 2, LidarConfig().num_rays)
    assert isinstance(env.single_observation_space, Dict)
    assert env.single_observation_space["lidar"].shape == shape and seen["lidar"].shape == (8, *shape)
    now, then = seen["lidar"][:, NUM_SCANS], seen["lidar"][:, NUM_SCANS + 1]
    nearest_now, nearest_then = REACH_M * now.min(axis=1), REACH_M * then.min(axis=1)
    known = nearest_now < REACH_M
    assert known.sum() >= 4
    assert (nearest_then[known] < nearest_now[known] - 0.2).mean() > 0.7


@pytest.mark.parametrize("times", [(0.0, 1.0), (2.0, 1.0), (6.0,)])
def test_times_that_make_no_sense_are_refused(times: tuple[float, ...]) -> None:
    with pytest.raises(ValueError, match="foretold_s"):
        ObserverConfig(foretold_s=times)
