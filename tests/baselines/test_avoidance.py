"""The maths of the classical navigators, against other implementations, slow loops and values by hand."""

from __future__ import annotations

import math

import numpy as np
import pytest
from scipy.spatial import ConvexHull

from densecavoid.baselines.frozone import convex_hull, distance_to_zone, least_turns
from densecavoid.baselines.orca import choose_velocities, followable
from densecavoid.baselines.surroundings import ScanPoints
from densecavoid.baselines.unicycle import TurningConfig, follow_velocity
from densecavoid.frames import LidarConfig, RobotConfig
from densecavoid.perception.people_around import People
from densecavoid.sim.robot import drive

ROBOT = RobotConfig()
slow_drive = getattr(drive, "py_func")  # noqa: B009 (numba's, of which type checkers do not know)


def test_orca_of_a_robot_that_moves_any_way_is_that_of_its_authors():
    """Against the authors' own implementation, each agent's velocity in turn; without the limits of wheels."""
    pyrvo = pytest.importorskip("pyrvo")
    rng = np.random.default_rng(3)
    dt, horizon, radius, limit = 0.1, 3.0, 0.35, 1.2
    for _ in range(40):
        count = int(rng.integers(2, 9))
        pos, vel = rng.uniform(0, 5.0, (count, 2)), rng.normal(0, 0.6, (count, 2))
        wish = rng.normal(0, 0.8, (count, 2))
        theirs = pyrvo.RVOSimulator(dt, 20.0, 10, horizon, horizon, radius, limit)
        for p, v, w in zip(pos.tolist(), vel.tolist(), wish.tolist(), strict=True):
            agent = theirs.add_agent(tuple(p))
            theirs.set_agent_velocity(agent, tuple(v))
            theirs.set_agent_pref_velocity(agent, tuple(w))
        theirs.do_step()
        # Each agent as a world of its own, the others as its people.
        others = np.array([[j for j in range(count) if j != i] for i in range(count)])
        ours = np.zeros((count, 2))
        choose_velocities(
            wish,
            vel,
            pos[others] - pos[:, None],
            vel[others],
            np.full(others.shape, radius),
            np.ones(others.shape, bool),
            np.full((count, 1, 2), np.nan),
            np.zeros((0, 4)),
            limit,
            dt,
            (radius, radius, horizon, horizon, 0.5, 20.0),
            10,
            ours,
        )
        expected = [theirs.get_agent_velocity(agent) for agent in range(count)]
        np.testing.assert_allclose(ours, [(v.x, v.y) if hasattr(v, "x") else tuple(v) for v in expected], atol=1e-3)


@pytest.mark.parametrize("error_m", [0.05, 0.1, 0.2])
def test_what_orca_may_choose_the_robot_follows_within_the_error(error_m):
    """Drives towards velocities at the edge of the allowed set until the heading is right, and looks at the line that
    a robot free of wheels would have moved on."""
    planes = followable(error_m, ROBOT, TurningConfig())
    for angle in np.linspace(0.0, math.pi, 60):
        direction = np.array([math.cos(angle), math.sin(angle)])
        reach = ((planes[:, :2] * planes[:, 2:]).sum(axis=1)) / np.minimum(planes[:, 2:] @ direction, -1e-9)
        speed = reach.min()
        assert speed <= 1.0 + 1e-6
        pose, worst = np.zeros(3), 0.0
        for _ in range(120):
            left = direction @ [math.cos(pose[2]), math.sin(pose[2])], math.atan2(direction[1], direction[0]) - pose[2]
            wish = speed * np.array([[left[0], math.sin(left[1])]])
            command = follow_velocity(wish, np.zeros(1), ROBOT)
            slow_drive(pose, float(command.linear_velocity[0]), float(command.angular_velocity[0]), 0.1)
            worst = max(worst, abs(pose[0] * direction[1] - pose[1] * direction[0]))
        assert worst < error_m


def test_a_velocity_straight_ahead_is_driven_as_it_is_and_one_behind_is_turned_to():
    command = follow_velocity(np.array([[0.7, 0.0], [-0.5, 0.1], [0.0, 0.0]]), np.array([0.0, 0.0, -1.0]), ROBOT)
    np.testing.assert_allclose(command.linear_velocity, [0.7, 0.0, 0.0], atol=1e-5)
    np.testing.assert_allclose(command.angular_velocity, [0.0, 0.4, -0.4], atol=1e-6)


def test_hull_and_distance_against_scipy():
    rng = np.random.default_rng(5)
    for count in (3, 4, 7, 12):
        points = rng.normal(0, 1, (count, 2))
        hull = np.zeros((count, 2))
        size = convex_hull(points, count, hull)
        expected = ConvexHull(points)
        assert {tuple(row) for row in hull[:size]} == {tuple(points[k]) for k in expected.vertices}
        for x, y in rng.normal(0, 2, (30, 2)):
            inside = (expected.equations @ [x, y, 1.0]).max() <= 0
            corners = points[expected.vertices]
            edge = np.linspace(corners, np.roll(corners, -1, axis=0), 4001).reshape(-1, 2)
            away = 0.0 if inside else np.hypot(edge[:, 0] - x, edge[:, 1] - y).min()
            assert distance_to_zone(x, y, hull, size) == pytest.approx(away, abs=1e-3)


def test_the_least_turn_passes_a_single_person_at_the_tangent():
    """2 m ahead, .25 m wide, .35 m to be kept: the tangent to a disc of .6 m is at asin(.6 / 2)."""
    turn = np.zeros(2)
    aside = math.atan2(0.05, 2.0)
    points = np.array([[[2.0, 0.05]], [[2.0, -0.05]]])
    least_turns(points, np.ones(2, np.int64), np.full(2, 0.25), np.ones(2), 3.0, 0.35, 1.2, 0.01, turn)
    np.testing.assert_allclose(turn, [aside - math.asin(0.3), math.asin(0.3) - aside], atol=0.012)
    least_turns(points, np.ones(2, np.int64), np.full(2, 0.25), np.ones(2), 3.0, 0.35, 0.1, 0.01, turn)
    assert np.isnan(turn).all()
    least_turns(points, np.zeros(2, np.int64), np.full(2, 0.25), np.ones(2), 3.0, 0.35, 1.2, 0.01, turn)
    assert (turn == 0.0).all()


def test_scan_points_are_the_nearest_of_their_sectors_and_not_peoples():
    """A slow loop over random scans; whoever is known is not seen again."""
    lidar = LidarConfig(num_rays=240)
    rng = np.random.default_rng(1)
    scan = rng.uniform(0.5, 4.0, (2, 240)).astype(np.float32)
    scan[rng.random((2, 240)) < 0.4] = np.inf
    found = ScanPoints(lidar, 24).of(scan)
    for b in range(2):
        for s in range(24):
            rays = range(10 * s, 10 * s + 10)
            best = min(rays, key=lambda r: scan[b, r])
            expected = scan[b, best] * np.array([math.cos(lidar.angles_rad[best]), math.sin(lidar.angles_rad[best])])
            if np.isfinite(scan[b, best]):
                np.testing.assert_allclose(found[b, s], expected, atol=1e-6)
            else:
                assert np.isnan(found[b, s]).all()
    ahead = np.full((1, 240), 2.0, np.float32)
    one = np.ones((1, 1))
    known = People(np.array([[[2.2, 0.0]]]), np.zeros((1, 1, 2)), 0.25 * one, one > 0, np.zeros(1))
    points = ScanPoints(lidar, 24).of(ahead, known)[0]
    angle = np.degrees(np.arctan2(points[:, 1], points[:, 0]))
    assert np.nanmin(np.abs(angle)) > 5.0 and np.isfinite(points).all(axis=1).sum() >= 20
