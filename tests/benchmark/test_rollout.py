"""Episodes driven in the real simulator."""

from __future__ import annotations

import dataclasses
import json
import math

import numpy as np
import pytest

from densecavoid.baselines import GoToGoal
from densecavoid.benchmark.episode_file import write_episode
from densecavoid.benchmark.metrics import episode_metrics
from densecavoid.benchmark.rollout import run_episodes
from densecavoid.frames import Command
from densecavoid.scenarios import make_scenario
from densecavoid.sim.world import Simulator

SEEDS = [5, 3, 8, 1, 9, 2, 7]


class Stubborn:
    """Drives straight on, and tells how it was used."""

    name = "stubborn"
    privileged = False

    def __init__(self) -> None:
        self.resets = 0

    def reset(self, which):
        self.resets += int(which.sum())

    def act(self, frame):
        still = np.zeros(frame.num_worlds, np.float32)
        return Command(still + 1, still)


def episodes(num_worlds: int, scenario: str = "random-sparse-ped", **options):
    return run_episodes(Simulator(make_scenario(scenario), num_worlds), GoToGoal(), SEEDS, **options)


def test_a_seed_gives_the_same_episode_however_many_worlds_run_beside_it():
    for alone, beside in zip(episodes(1), episodes(3), strict=True):
        assert alone.seed == beside.seed
        assert alone.outcome == beside.outcome
        for field in ("time_s", "pose_w", "velocity", "command", "clearance_m", "clearance_people_m", "goal_w"):
            np.testing.assert_array_equal(getattr(alone, field), getattr(beside, field), err_msg=field)


def test_more_worlds_than_seeds_are_no_trouble():
    few, many = episodes(3), episodes(12)
    assert [e.seed for e in many] == SEEDS
    assert [episode_metrics(e) for e in few] == [episode_metrics(e) for e in many]


def test_the_record_is_what_the_robot_did():
    """Ideal wheels: the pose follows from the commands, and the outcome from the pose and the clearance.

    The last step may end before its time, at the goal or in a collision.
    """
    for record in episodes(2):
        np.testing.assert_allclose(record.velocity[1:-1], record.command[:-1], atol=1e-6)
        np.testing.assert_allclose(np.diff(record.time_s), 0.1, atol=1e-9)
        length = np.linalg.norm(np.diff(record.pose_w[:-1, :2], axis=0), axis=1)
        linear, angular = record.command[:-1].T
        np.testing.assert_allclose(length, 0.1 * linear * np.sinc(0.1 * angular / 2 / np.pi), atol=1e-6)
        to_goal = np.linalg.norm(record.pose_w[:, :2] - record.goal_w, axis=1)
        assert (to_goal[:-1] >= 0.30).all()
        assert (record.clearance_m[:-1] > 0.30 - 1e-6).all()
        assert (record.outcome == "success") == (to_goal[-1] < 0.30 and record.clearance_m[-1] > 0.30)
        assert (record.outcome == "collision") == (record.clearance_m[-1] <= 0.30)


def test_collisions_with_walls_are_told_from_those_with_people():
    (wall,) = run_episodes(Simulator(make_scenario("dense-static"), 1), Stubborn(), [4])
    assert wall.outcome == "collision" and not wall.collided_person
    assert episode_metrics(wall).at_fault
    met = run_episodes(Simulator(make_scenario("corridor-15"), 4), Stubborn(), range(8))
    assert any(record.outcome == "collision" and record.collided_person for record in met)


def test_every_episode_resets_its_navigator_once_and_is_told_of_once():
    navigator, told = Stubborn(), []
    run_episodes(Simulator(make_scenario("dense-static"), 2), navigator, SEEDS, on_episode=told.append)
    assert navigator.resets == len(SEEDS)
    assert sorted(record.seed for record in told) == sorted(SEEDS)


def test_on_step_sees_each_step_before_it_is_done():
    seen = []
    simulator = Simulator(make_scenario("random-goal"), 1)
    (record,) = run_episodes(
        simulator, GoToGoal(), [3], on_step=lambda sim, frame, command: seen.append(sim.robot_pose[0].copy())
    )
    np.testing.assert_array_equal(seen, record.pose_w[:-1])


def test_people_are_kept_when_asked_for():
    record = episodes(2, keep_people=True)[0]
    assert record.people is not None
    assert len(np.unique(record.people.id)) == 10
    track = record.people.of(int(record.people.id[0]))
    np.testing.assert_array_equal(track.instant, np.arange(len(record.time_s)))
    assert np.linalg.norm(np.diff(track.pos_w, axis=0), axis=1).max() < 0.25
    assert episodes(2)[0].people is None


def test_episode_file_is_strict_json_with_the_whole_trajectory(tmp_path):
    (record,) = run_episodes(Simulator(make_scenario("dense-static"), 1), GoToGoal(), [5])
    path = tmp_path / "made" / "episode.json"
    write_episode(path, record)

    def refuse(constant: str):
        raise AssertionError(f"{constant} is no JSON")

    written = json.loads(path.read_text(), parse_constant=refuse)
    assert written["scenario"] == "dense-static"
    assert written["navigator"] == "go-to-goal"
    assert written["seed"] == 5
    assert written["definition"] == "1"
    assert written["outcome"] == record.outcome
    assert written["metrics"]["clearance_people_m"] is None
    assert written["metrics"]["path_length_m"] == pytest.approx(episode_metrics(record).path_length_m, abs=1e-6)
    trajectory = written["trajectory"]
    assert set(trajectory) == {"t", "x", "y", "yaw", "v", "w", "clearance"}
    assert {len(column) for column in trajectory.values()} == {len(record.time_s)}
    np.testing.assert_allclose(trajectory["x"], record.pose_w[:, 0], atol=1e-6)
    assert trajectory["clearance"][0] is None
    assert math.isclose(trajectory["clearance"][-1], record.clearance_m[-1], abs_tol=1e-6)
    assert [item.name for item in path.parent.iterdir()] == ["episode.json"]


def test_an_episode_whose_columns_do_not_fit_is_refused():
    record = episodes(2)[0]
    shorter = {name: getattr(record, name)[:-1] for name in ("command", "clearance_m", "clearance_people_m")}
    with pytest.raises(ValueError, match=r"rows of Episode\.command"):
        dataclasses.replace(record, **shorter)
