"""The environments keep Gymnasium's rules, the observation is what the policy expects, the reward is the paper's."""

from __future__ import annotations

import math
import warnings

import gymnasium as gym
import numpy as np
import pytest
from gymnasium.utils.env_checker import check_env

from densecavoid.env import DenseCAvoidEnv, DenseCAvoidVectorEnv, RewardConfig, make, make_vec, register_environments
from densecavoid.env.observation import Observer, ObserverConfig
from densecavoid.env.registration import environment_id
from densecavoid.env.reward import Transition, reward_terms
from densecavoid.frames import SensorFrame, goal_polar, wrap_angle
from densecavoid.scenarios import make_scenario, names
from densecavoid.sim.floorplan import FloorPlan
from densecavoid.sim.spec import WorldSpec


class Straight:
    """A goal straight ahead, two waypoints before it, a wall behind it; short enough to time out."""

    name = "straight"

    def __init__(self, goal_x=3.0, time_limit_s=60.0, wall_x=None, waypoints=()) -> None:
        plan = FloorPlan()
        if wall_x is not None:
            plan.box(wall_x, 0.0, 0.1, 4.0, z_max=2.0)
        points = np.array(waypoints, float).reshape(-1, 2)
        self.spec = WorldSpec(
            "straight", plan, (0.0, 0.0, 0.0), (goal_x, 0.0), time_limit_s=time_limit_s, waypoints=points
        )

    def spawn(self, rng):
        return self.spec


def ahead(batch: int, speed: float = 1.0) -> np.ndarray:
    return np.tile(np.array([speed, 0.0], np.float32), (batch, 1))


@pytest.mark.parametrize("name", names())
def test_single_environment_passes_gymnasiums_checker(name):
    register_environments()
    with warnings.catch_warnings():
        warnings.filterwarnings("ignore", ".*spec.*")
        check_env(gym.make(environment_id(name)).unwrapped, skip_render_check=True)


@pytest.mark.parametrize("name", names())
def test_vector_environment_steps_within_its_spaces(name):
    env = make_vec(name, 5, seed=3)
    observation, _ = env.reset(seed=3)
    rng = np.random.default_rng(0)
    for _ in range(30):
        assert env.observation_space.contains(observation)
        assert not any(np.isnan(value).any() for value in observation.values())
        observation, reward, terminated, truncated, _ = env.step(rng.uniform([0, -0.4], [1, 0.4], (5, 2)))
        assert reward.shape == terminated.shape == truncated.shape == (5,)
        assert np.isfinite(reward).all()


def test_gymnasium_makes_the_vector_environment():
    register_environments()
    env = gym.make_vec(environment_id("dense-ped"), num_envs=3)
    assert isinstance(env.unwrapped, DenseCAvoidVectorEnv)
    assert env.metadata["autoreset_mode"] == gym.vector.AutoresetMode.SAME_STEP


def test_success_terminates_and_hands_out_the_true_final_observation():
    env = DenseCAvoidVectorEnv(Straight(goal_x=1.05), 2)
    env.reset(seed=0)
    for _ in range(7):
        _, _, terminated, truncated, infos = env.step(ahead(2))
        assert not terminated.any() and "final_obs" not in infos
    observation, reward, terminated, truncated, infos = env.step(ahead(2))
    assert terminated.all() and not truncated.any()
    assert infos["_final_obs"].all()
    assert infos["final_obs"][0]["goal"][0] == pytest.approx(0.30, abs=1e-5)  # where the episode ended
    assert observation["goal"][0, 0] == pytest.approx(1.05)  # where the next begins
    assert reward == pytest.approx(20.0)
    assert infos["episode"]["success"].all() and infos["episode"]["length"].tolist() == [8, 8]
    assert infos["episode"]["return"] == pytest.approx(20.0 + 2.5 * 0.7)


def test_time_limit_truncates_and_does_not_terminate():
    env = DenseCAvoidVectorEnv(Straight(time_limit_s=0.5), 2)
    env.reset(seed=0)
    for _ in range(4):
        env.step(ahead(2, 0.0))
    _, _, terminated, truncated, infos = env.step(ahead(2, 0.0))
    assert truncated.all() and not terminated.any()
    assert not infos["episode"]["success"].any() and not infos["episode"]["collision"].any()


def test_collision_terminates_with_the_paper_penalty():
    env = DenseCAvoidEnv(Straight(wall_x=1.05))
    env.reset(seed=0)
    for _ in range(6):
        _, _, terminated, _, _ = env.step(ahead(1)[0])
        assert not terminated
    _, reward, terminated, truncated, info = env.step(ahead(1)[0])
    assert terminated and not truncated and info["collision"]
    assert info["reward_terms"]["collision"] == -20.0
    assert reward == pytest.approx(sum(info["reward_terms"].values()))


def test_a_waypoint_pays_once():
    env = DenseCAvoidVectorEnv(Straight(goal_x=6.0, waypoints=[(1.0, 0.1), (2.0, 0.0)]), 1)
    env.reset(seed=0)
    paid = [env.step(ahead(1))[4]["reward_terms"]["waypoint"][0] for _ in range(30)]
    assert sum(paid) == pytest.approx(20.0) and max(paid) == 10.0


def transition(**changes) -> Transition:
    one, no = np.ones(1), np.zeros(1, bool)
    base = Transition(3.0 * one, 2.9 * one, no, no, no, 0.0 * one, 0.0 * one, 2.0 * one, 1.0 * one)
    return base._replace(**{k: np.array([v]) for k, v in changes.items()})


def test_reward_terms_by_hand():
    published, text = RewardConfig(safe_distance_threshold_m=0.8), RewardConfig(form="text")

    def term(config, name, **changes):
        return reward_terms(config, transition(**changes))[name][0]

    assert term(published, "progress") == pytest.approx(0.25)
    assert term(published, "progress", succeeded=True) == 0.0
    assert term(published, "goal", succeeded=True) == 20.0
    assert term(published, "waypoint", reached_waypoint=True) == 10.0
    assert term(published, "collision", collided=True) == -20.0
    assert term(published, "oscillation", angular_before=-0.2, angular=0.2) == pytest.approx(-0.04)
    assert term(published, "oscillation", angular_before=0.3, angular=0.4) == 0.0
    assert term(text, "oscillation", angular_before=0.4, angular=0.4) == pytest.approx(-0.04)
    assert term(published, "safe_distance", clearance_m=0.5) == pytest.approx(-0.03)
    assert term(published, "safe_distance", clearance_m=1.0) == 0.0
    assert term(text, "safe_distance", lidar_shortfall_m=1.5) == pytest.approx(-0.15)


def frame(scan: float, depth: float, pose=(0.0, 0.0, 0.0)) -> SensorFrame:
    return SensorFrame(
        time_s=np.zeros(1),
        scan_m=np.full((1, 512), scan, np.float32),
        depth_m=np.full((1, 60, 80), depth, np.float32),
        odom_pose=np.array([pose]),
        velocity=np.zeros((1, 2), np.float32),
        goal_odom=np.array([[0.0, 2.0]]),
    )


def test_observation_by_hand():
    observer = Observer(ObserverConfig(people_from="nothing"), 1)
    first = observer.observe(frame(2.0, 1.4))
    assert (first.lidar == 0.5).all() and (first.camera == 255).all()
    assert first.goal[0] == pytest.approx([2.0, math.pi / 2])
    second = observer.observe(frame(math.inf, 5.0, pose=(0.0, 1.0, math.pi / 2)))
    assert (second.lidar[0, :2] == 0.5).all() and (second.lidar[0, 2] == 1.0).all()
    assert (second.camera == 1).all()
    assert second.goal[0] == pytest.approx([1.0, 0.0], abs=1e-6)
    third = observer.observe(frame(1.0, math.nan))
    assert (third.lidar[0, 0] == 0.5).all() and (third.lidar[0, 2] == 0.25).all()
    assert (third.camera == 0).all()
    observer.reset(np.ones(1, bool))
    assert (observer.observe(frame(1.0, 2.0)).lidar == 0.25).all()


def test_frames_that_do_not_fit_are_refused():
    observer = Observer(ObserverConfig(), 1)
    with pytest.raises(ValueError, match="ground truth"):
        observer.observe(frame(2.0, 2.0))
    with pytest.raises(ValueError, match=r"scan_m is \(1, 512\), expected \(2, 512\)"):
        Observer(ObserverConfig(people_from="nothing"), 2).observe(frame(2.0, 2.0))


def test_a_saved_environment_goes_on_with_the_same_bits():
    first, second = make_vec("random-sparse-ped", 3), make_vec("random-sparse-ped", 3)
    first.reset(seed=11)
    rng = np.random.default_rng(1)
    for _ in range(40):
        first.step(rng.uniform([0, -0.4], [1, 0.4], (3, 2)))
    second.load_state_dict(first.state_dict())
    for _ in range(60):
        action = rng.uniform([0, -0.4], [1, 0.4], (3, 2))
        a, b = first.step(action), second.step(action)
        for name in a[0]:
            np.testing.assert_array_equal(a[0][name], b[0][name])
        np.testing.assert_array_equal(a[1], b[1])
        np.testing.assert_array_equal(a[2], b[2])


def test_worlds_do_not_depend_on_the_batch_size():
    small, large = make_vec("dense-ped", 1), make_vec("dense-ped", 4)
    a, b = small.reset(seed=5)[0], large.reset(seed=5)[0]
    np.testing.assert_array_equal(a["camera"][0], b["camera"][0])
    np.testing.assert_array_equal(a["goal"][0], b["goal"][0])


def test_make_takes_a_scenario_or_its_name():
    assert make("dense-ped").observation_space == make(make_scenario("dense-ped")).observation_space


def test_angles_and_goals_by_hand():
    np.testing.assert_allclose(wrap_angle(np.array([math.pi, -3.5 * math.pi, 0.1])), [-math.pi, math.pi / 2, 0.1])
    distance, bearing = goal_polar(np.array([[1.0, 1.0, math.pi]]), np.array([[0.0, 0.0]]))
    assert distance[0] == pytest.approx(math.sqrt(2)) and bearing[0] == pytest.approx(math.pi / 4)


def test_the_truth_about_people_is_that_of_the_simulator_in_the_robots_frame() -> None:
    env = DenseCAvoidVectorEnv("random-sparse-ped", 3, seed=4, true_people=4)
    observation, _ = env.reset(seed=4)
    for _ in range(3):
        observation, *_ = env.step(np.tile(np.array([0.5, 0.2], np.float32), (3, 1)))
    assert env.single_observation_space["people"].shape == (4, 6)  # type: ignore[index]
    simulator = env.task.simulator
    for b in range(3):
        x, y, yaw = simulator.robot_pose[b]
        people = simulator.people()
        expected = []
        for i in np.flatnonzero(people.active[b]):
            (px, py), (vx, vy) = people.pos_w[b, i], people.vel_w[b, i]
            ahead, moved = complex(px - x, py - y), complex(vx, vy)
            turned = [vector * complex(np.exp(-1j * yaw)) for vector in (ahead, moved)]
            numbers = [part for vector in turned for part in (vector.real, vector.imag)]
            expected.append([abs(ahead), *numbers, people.radius_m[b, i], 1.0])
        nearest = np.array(sorted(expected)[:4])[:, 1:]
        np.testing.assert_allclose(observation["people"][b], nearest, atol=1e-5)


def test_where_nobody_is_the_truth_is_all_zeros() -> None:
    observation, _ = DenseCAvoidVectorEnv("random-goal", 2, true_people=3).reset(seed=0)
    assert not observation["people"].any() and observation["people"].shape == (2, 3, 6)


def test_worlds_do_not_depend_on_how_they_are_grouped() -> None:
    whole = DenseCAvoidVectorEnv("random-sparse-ped", 4, seed=9)
    parts = [DenseCAvoidVectorEnv("random-sparse-ped", 2, seed=9, first_world=first) for first in (0, 2)]
    together, _ = whole.reset(seed=9)
    apart = [part.reset(seed=9)[0] for part in parts]
    for name, array in together.items():
        assert np.array_equal(array, np.concatenate([each[name] for each in apart])), name
