"""What the planner of the next seconds computes, beside searches that share none of its loops."""

from __future__ import annotations

import itertools
import math

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from densecavoid.baselines.lookahead import Lookahead, LookaheadConfig, reachable
from densecavoid.baselines.lookahead_kernels import Around, worth_of_commands
from densecavoid.benchmark.rollout import run_episodes
from densecavoid.foresight.value_field import COMMAND_GRID
from densecavoid.frames import RobotConfig
from densecavoid.scenarios import make_scenario
from densecavoid.sim.world import SimConfig, Simulator

ROBOT = RobotConfig()


@settings(max_examples=60, deadline=None)
@given(st.lists(st.tuples(st.floats(0, 1), st.floats(-0.4, 0.4)), min_size=13, max_size=13))
def test_no_robot_leaves_the_cells_that_count_as_reachable(commands: list[tuple[float, float]]) -> None:
    hold_s, cell = 0.4, 0.1
    boxes = reachable(14, 40, hold_s, cell, ROBOT)
    x = y = yaw = 0.0
    for k, (v, w) in enumerate(commands, 1):
        for _ in range(40):
            yaw += w * hold_s / 40
            x, y = x + v * hold_s / 40 * math.cos(yaw), y + v * hold_s / 40 * math.sin(yaw)
        first_i, last_i, first_j, last_j, turned = boxes[k]
        # With a neighbour on either side, between which values are interpolated.
        assert first_i < math.floor(x / cell) and math.floor(x / cell) + 1 < last_i
        assert first_j < math.floor(y / cell) and math.floor(y / cell) + 1 < last_j
        assert abs(yaw) / (2 * math.pi / 40) <= turned


def worth(navigator: Lookahead, goal: tuple[float, float], people: np.ndarray) -> np.ndarray:
    """Of the navigator's commands in an empty place with people [P, 5]: x, y, velocity x, y, radius."""
    out = np.zeros((1, len(COMMAND_GRID)))
    nothing, P = np.zeros((1, 1, 2), np.float32), len(people)
    around = Around(
        np.array([goal]),
        nothing,
        np.zeros(1, np.int64),
        people[None, :, :2].copy(),
        people[None, :, 2:4].copy(),
        people[None, :, 4].copy(),
        np.ones((1, P), np.bool_),
    )
    n = navigator
    worth_of_commands(0, 1, around, n._steps, n._commands, n._boxes, n._shape, n._rules, out)
    return out[0]


def searched_worth(
    config: LookaheadConfig, command: np.ndarray, goal: tuple[float, float], people: np.ndarray
) -> float:
    """The best of all sequences of nine held commands after the first, driven exactly; people are met at the ends of
    moments, as the planner does it."""
    moments, hold_s = round(config.horizon_s / config.hold_s), config.hold_s
    per_s = 10 * math.log(config.discount)
    best = -1.0
    held = [np.array([v, w * 0.4]) for v in (1.0, 0.5, 0.0) for w in (1, 0, -1)]
    for rest in itertools.product(held, repeat=moments - 1):
        x = y = yaw = 0.0
        value = None
        for k, (v, w) in enumerate((command, *rest), 1):
            for _ in range(8):
                x, y = (
                    x + v * hold_s / 8 * math.cos(yaw + w * hold_s / 16),
                    y + v * hold_s / 8 * math.sin(yaw + w * hold_s / 16),
                )
                yaw += w * hold_s / 8
            for person in people:
                apart = math.hypot(*(person[:2] + k * hold_s * person[2:4] - (x, y)))
                if apart < person[4] + config.body_m + config.margin_m and k < moments:
                    value = config.collision * math.exp(per_s * hold_s * (k - 1))
            if value is not None:
                break
        if value is None:
            off = abs((math.atan2(goal[1] - y, goal[0] - x) - yaw + math.pi) % (2 * math.pi) - math.pi)
            way_s = math.dist(goal, (x, y)) + 0.6 * off / 0.4
            value = math.exp(per_s * ((moments - 1) * hold_s + config.beyond_slower * way_s))
        best = max(best, value)
    return best


@pytest.mark.parametrize("seed", range(6))
def test_commands_are_worth_what_a_search_over_all_sequences_finds(seed: int) -> None:
    rng = np.random.default_rng(seed)
    config = LookaheadConfig(horizon_s=1.6, slip=0.0, near_person_cost=0.0)
    navigator = Lookahead(config=config, threads=1)
    bearing, goal_m = rng.uniform(-2, 2), rng.uniform(3, 9)
    goal = goal_m * math.cos(bearing), goal_m * math.sin(bearing)
    people = np.zeros((2, 5))
    people[:, :2] = rng.uniform([1.2, -0.8], [2.2, 0.8], (2, 2))
    people[:, 2:4], people[:, 4] = rng.uniform(-0.8, 0.2, (2, 2)), 0.25
    found = worth(navigator, goal, people)
    for c in rng.choice(len(COMMAND_GRID), 4, replace=False):
        expected = searched_worth(config, COMMAND_GRID[c] * [1.0, 0.4], goal, people)
        # Where ways part around somebody, a value between cells is a mixture of both.
        assert found[c] == pytest.approx(expected, abs=0.06), COMMAND_GRID[c]


def test_who_comes_head_on_is_avoided_in_time() -> None:
    """Of two who come along the way, one a little to the left: the robot turns right, long before they meet."""
    navigator = Lookahead(threads=1)
    found = worth(navigator, (10.0, 0.0), np.array([[4.0, 0.1, -0.6, 0.0, 0.25], [4.5, 0.6, -0.6, 0.0, 0.25]]))
    assert COMMAND_GRID[found.argmax()][0] > 0 and COMMAND_GRID[found.argmax()][1] < 0


@pytest.mark.parametrize("bearing", [math.pi, -3.0, 2.0, -1.0])
def test_nothing_is_put_off(bearing: float) -> None:
    """However long the turn that the way begins with: standing, to do so later, is worth less."""
    found = worth(Lookahead(threads=1), (7.0 * math.cos(bearing), 7.0 * math.sin(bearing)), np.zeros((0, 5)))
    assert abs(COMMAND_GRID[found.argmax()][1]) == 1.0
    assert found.max() > found[(COMMAND_GRID == 0).all(axis=1)].item() + 0.001


@pytest.mark.slow
def test_most_dense_corridors_are_crossed() -> None:
    """With people as its own detector and tracker see them."""
    episodes = run_episodes(Simulator(make_scenario("dense-ped"), 10, SimConfig()), Lookahead(), list(range(10)))
    assert np.mean([episode.outcome == "success" for episode in episodes]) >= 0.7


@pytest.mark.parametrize(
    "values",
    [{"horizon_s": 0.5}, {"slip": 1.0}, {"cell_m": 0.0}, {"near_person_cost": -1.0}, {"beyond_slower": 0.9}],
)
def test_settings_that_make_no_sense_are_refused(values: dict[str, float]) -> None:
    with pytest.raises(ValueError, match=next(iter(values))):
        LookaheadConfig(**values)


def test_a_robot_too_fast_for_the_cells_is_refused() -> None:
    with pytest.raises(ValueError, match="hold_s"):
        Lookahead(RobotConfig(max_linear_velocity=2.0))
