"""What commands are worth in the next seconds, beside searches that share none of the kernels' loops."""

from __future__ import annotations

import itertools
import math

import numpy as np
import pytest

from densecavoid.frames import COMMAND_GRID, RobotConfig
from densecavoid.perception.outlook import OBSERVED, Outlook, OutlookConfig, make_lattice
from densecavoid.perception.outlook_kernels import Around
from densecavoid.perception.rolling_grid import CELL_M
from densecavoid.perception.static_map import CELLS

ROBOT = RobotConfig()
NOBODY = np.zeros((0, 5))


def straight_ways(goal: np.ndarray, grid_from: tuple[float, float, float] = (0.0, 0.0, 0.0)) -> np.ndarray:
    """Lengths to a goal (robot's frame) where nothing is in the way, in a grid that the robot is at a pose in."""
    x, y, yaw = grid_from
    in_grid = (
        x + math.cos(yaw) * goal[0] - math.sin(yaw) * goal[1],
        y + math.sin(yaw) * goal[0] + math.cos(yaw) * goal[1],
    )
    middles = (np.arange(CELLS) + 0.5 - CELLS / 2) * CELL_M
    return np.hypot(middles[:, None] - in_grid[0], middles[None] - in_grid[1]).astype(np.float32)


def around(worlds: list[tuple[tuple[float, float], np.ndarray]], points: np.ndarray | None = None) -> Around:
    """Goals, and people [P, 5]: x, y, velocity x, y, radius; and the same things in each world."""
    B, P = len(worlds), max(len(people) for _, people in worlds)
    persons, there = np.zeros((B, P, 5)), np.zeros((B, P), np.bool_)
    for b, (_, people) in enumerate(worlds):
        persons[b, : len(people)], there[b, : len(people)] = people, True
    goals = np.array([goal for goal, _ in worlds])
    things = np.zeros((0, 2)) if points is None else points
    return Around(
        goals,
        np.repeat(things[None], B, axis=0).astype(np.float32),
        np.full(B, len(things)),
        persons[..., :2].copy(),
        persons[..., 2:4].copy(),
        persons[..., 4].copy(),
        there,
        np.zeros(B),
        np.stack([straight_ways(goal) for goal in goals]),
        np.zeros((B, 3)),
    )


def look(outlook: Outlook, known: Around) -> np.ndarray:
    B = len(known.goal)
    out = np.full((B, len(COMMAND_GRID)), np.nan, np.float32)
    outlook.look(known, np.ones(B, np.bool_), out)
    return out


def worth(config: OutlookConfig, goal: tuple[float, float], people: np.ndarray) -> np.ndarray:
    return look(Outlook(config, ROBOT, 1), around([(goal, people)]))[0]


def test_values_are_asked_for_where_a_robot_can_get_to_and_nowhere_else() -> None:
    lattice, commands, _ = make_lattice(2.0, 0.5, 0.15, 1.0, 0.4)
    headings, size_x = lattice.spans.shape[1:3]
    reached: set[tuple[int, int, int]] = set()
    for v, w in commands:
        turned = 0.5 * w
        chord = 0.5 * v * (math.sin(turned / 2) / (turned / 2) if turned else 1.0)
        i = math.floor((chord * math.cos(turned / 2) - lattice.x0) / 0.15 - 0.5)
        j = math.floor((chord * math.sin(turned / 2) - lattice.y0) / 0.15 - 0.5)
        h = math.floor(turned / (2 * math.pi / headings))
        reached |= {((h + a) % headings, i + b, j + c) for a, b, c in itertools.product(range(2), repeat=3)}
    for k in range(1, 5):
        for h, i in itertools.product(range(headings), range(size_x)):
            row = [j for at_h, at_i, j in reached if (at_h, at_i) == (h, i)]
            assert tuple(lattice.spans[k, h, i]) == ((min(row), max(row) + 1) if row else (0, 0))
        following: set[tuple[int, int, int]] = set()
        for h, i, j in reached:
            for off_i, off_j, later in lattice.offsets[h]:
                for b, c in itertools.product(range(2), repeat=2):
                    following.add((int(later), int(i + off_i + b), int(j + off_j + c)))
        reached = following


@pytest.mark.parametrize(("hold_s", "cell_m"), [(0.5, 0.15), (0.4, 0.1)])
def test_to_stand_still_leads_to_the_very_state_that_the_robot_is_in(hold_s: float, cell_m: float) -> None:
    """Otherwise, between cells, it leads to several at once, of which each then does what is best there; to wait is
    then worth more than anything done now, for ever (dense-static: a sixth of the worlds)."""
    lattice, commands, path = make_lattice(10 * hold_s, hold_s, cell_m, 1.0, 0.4)
    assert -lattice.x0 / cell_m - 0.5 == pytest.approx(round(-lattice.x0 / cell_m - 0.5), abs=1e-9)
    assert -lattice.y0 / cell_m - 0.5 == pytest.approx(round(-lattice.y0 / cell_m - 0.5), abs=1e-9)
    standing = (commands == 0).all(axis=1).argmax()
    assert not path[standing].any()


def test_the_poses_on_the_way_are_those_of_small_steps() -> None:
    _, commands, path = make_lattice(2.0, 0.5, 0.15, 1.0, 0.4)
    for (v, w), poses in zip(commands, path, strict=True):
        x = y = 0.0
        for n in range(1, 1001):
            yaw = w * 0.5 * (n - 0.5) / 1000
            x, y = x + v * 0.0005 * math.cos(yaw), y + v * 0.0005 * math.sin(yaw)
            if n % 250 == 0:
                np.testing.assert_allclose(poses[n // 250 - 1], [x, y, w * 0.5 * n / 1000], atol=1e-6)


def test_worlds_do_not_see_each_other() -> None:
    rng = np.random.default_rng(0)
    worlds = []
    for n in range(11):  # more than are reckoned side by side
        people = np.column_stack([rng.uniform(-2, 4, (n, 2)), rng.uniform(-0.6, 0.6, (n, 2)), np.full(n, 0.25)])
        worlds.append(((float(rng.uniform(2, 8)), float(rng.uniform(-3, 3))), people))
    outlook, points = Outlook(OutlookConfig(), ROBOT, 1), rng.uniform(-3, 5, (6, 2))
    together = look(outlook, around(worlds, points))
    for n, world in enumerate(worlds):
        np.testing.assert_array_equal(look(outlook, around([world], points))[0], together[n])
    some = np.arange(11) % 3 == 1
    out = np.full((11, len(COMMAND_GRID)), 9.0, np.float32)
    outlook.look(around(worlds, points), some, out)
    np.testing.assert_array_equal(out[some], together[some])
    assert (out[~some] == 9.0).all()


def test_ways_may_be_of_a_moment_ago() -> None:
    """When the robot was elsewhere and turned otherwise."""
    goal, at = (3.0, 2.0), (0.7, -0.4, 0.9)
    now = around([(goal, NOBODY)])
    before = now._replace(way=straight_ways(np.array(goal), at)[None], way_from=np.array([at]))
    outlook = Outlook(OutlookConfig(), ROBOT, 1)
    np.testing.assert_allclose(look(outlook, before), look(outlook, now), atol=2e-3)


def test_a_gap_wide_enough_is_driven_through_and_a_narrower_one_is_not() -> None:
    """In a wall across the way, 1 m ahead: the robot and a margin need .64 m, and some more between cells."""
    along = np.concatenate([np.arange(-4.0, 0.0, 0.05), np.arange(0.05, 4.0, 0.05)])
    for gap_m, drives in ((1.2, True), (0.5, False)):
        wall = np.column_stack([np.full(len(along), 1.0), along])
        wall = wall[np.abs(wall[:, 1]) > gap_m / 2]
        found = look(Outlook(OutlookConfig(), ROBOT, 1), around([((4.0, 0.0), NOBODY)], wall))[0]
        assert (COMMAND_GRID[found.argmax()][0] == 1.0 and found.max() > 0.8) == drives, gap_m


def test_what_is_passed_on_the_way_counts_and_not_only_where_it_ends() -> None:
    straight = (COMMAND_GRID == [1.0, 0.0]).all(axis=1).argmax()
    for aside_m, drives in ((0.29, False), (0.33, True)):  # half of a moment ahead
        found = look(Outlook(OBSERVED, ROBOT, 1), around([((4.0, 0.0), NOBODY)], np.array([[0.25, aside_m]])))[0]
        assert (found[straight] > 0.8) == drives, aside_m
    # In the middle of the second moment, between walls on both sides.
    along = np.arange(0.0, 4.0, 0.05)
    for half_gap_m, drives in ((0.29, False), (0.6, True)):
        aside = np.concatenate([-half_gap_m - along, half_gap_m + along])
        wall = np.column_stack([np.full(len(aside), 0.75), aside])
        found = look(Outlook(OBSERVED, ROBOT, 1), around([((4.0, 0.0), NOBODY)], wall))[0]
        assert (COMMAND_GRID[found.argmax()][0] == 1.0 and found.max() > 0.8) == drives, half_gap_m


def searched_worth(config: OutlookConfig, command: np.ndarray, goal: tuple[float, float], people: np.ndarray) -> float:
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
    config = OutlookConfig(horizon_s=1.6, slip=0.0, near_person_risk=0.0)
    bearing, goal_m = rng.uniform(-2, 2), rng.uniform(3, 9)
    goal = goal_m * math.cos(bearing), goal_m * math.sin(bearing)
    people = np.zeros((2, 5))
    people[:, :2] = rng.uniform([1.2, -0.8], [2.2, 0.8], (2, 2))
    people[:, 2:4], people[:, 4] = rng.uniform(-0.8, 0.2, (2, 2)), 0.25
    found = worth(config, goal, people)
    for c in rng.choice(len(COMMAND_GRID), 4, replace=False):
        expected = searched_worth(config, COMMAND_GRID[c] * [1.0, 0.4], goal, people)
        # Where ways part around somebody, a value between cells is a mixture of both.
        assert found[c] == pytest.approx(expected, abs=0.06), COMMAND_GRID[c]


def test_who_has_far_to_go_weighs_commands_as_who_has_a_little_less_far() -> None:
    people = np.array([[3.0, 0.2, -0.5, 0.0, 0.25]])
    far, farther = (worth(OutlookConfig(), (goal_m, 0.0), people) for goal_m in (20.0, 1000.0))
    np.testing.assert_allclose(farther, far, atol=0.005)
    assert far.max() - far.min() > 0.05


def test_who_comes_head_on_is_avoided_in_time() -> None:
    """Of two who come along the way, one a little to the left: the robot turns right, long before they meet."""
    found = worth(OutlookConfig(), (10.0, 0.0), np.array([[4.0, 0.1, -0.6, 0.0, 0.25], [4.5, 0.6, -0.6, 0.0, 0.25]]))
    assert COMMAND_GRID[found.argmax()][0] > 0 and COMMAND_GRID[found.argmax()][1] < 0


def test_where_people_turn_they_are_less_surely_where_they_would_be_and_more_likely_beside() -> None:
    straight = (COMMAND_GRID == [1.0, 0.0]).all(axis=1).argmax()
    # Somebody comes towards the robot between walls; somebody stands beside its way.
    walls = np.concatenate([np.column_stack([np.arange(-1, 9, 0.1), np.full(100, y)]) for y in (-0.6, 0.6)])
    comes, stands = np.array([[4.0, 0.0, -0.5, 0.0, 0.25]]), np.array([[1.5, 0.75, 0.0, 0.0, 0.25]])
    for people, points, risk, sign in ((comes, walls, 0.0, 1.0), (stands, None, 0.15, -1.0)):
        outlook = Outlook(OutlookConfig(near_person_risk=0.0, turned_risk=risk), ROBOT, 1)
        known = around([((9.0, 0.0), people)], points)
        found = [look(outlook, known._replace(turns_per_s=np.array([often])))[0, straight] for often in (0.0, 0.1, 0.4)]
        assert (sign * np.diff(found) > 0.003).all(), found


@pytest.mark.parametrize("bearing", [math.pi, -3.0, 2.0, -1.0])
def test_nothing_is_put_off(bearing: float) -> None:
    """However long the turn that the way begins with: standing, to do so later, is worth less."""
    found = worth(OutlookConfig(), (7.0 * math.cos(bearing), 7.0 * math.sin(bearing)), NOBODY)
    assert abs(COMMAND_GRID[found.argmax()][1]) == 1.0
    assert found.max() > found[(COMMAND_GRID == 0).all(axis=1)].item() + 0.001


@pytest.mark.parametrize(
    "values",
    [
        {"horizon_s": 0.5},
        {"slip": 1.0},
        {"cell_m": 0.0},
        {"near_person_risk": -1.0},
        {"turned_risk": 1.1},
        {"beyond_slower": 0.9},
    ],
)
def test_settings_that_make_no_sense_are_refused(values: dict[str, float]) -> None:
    with pytest.raises(ValueError, match=next(iter(values))):
        OutlookConfig(**values)


def test_a_goal_is_not_reached_where_somebody_stands_then_and_is_beside_things() -> None:
    goal, straight = (1.6, 0.0), (COMMAND_GRID == [1.0, 0.0]).all(axis=1).argmax()
    on_it, leaves = [1.8, 0.0, 0.0, 0.0, 0.25], [1.8, 0.0, 1.0, 0.0, 0.25]
    blocked, free = (worth(OutlookConfig(), goal, np.array([person])) for person in (on_it, leaves))
    assert COMMAND_GRID[blocked.argmax()][0] == 0.0 and blocked.max() < 0.9
    assert free.argmax() == straight and free[straight] > 0.95
    beside = look(Outlook(OutlookConfig(), ROBOT, 1), around([(goal, NOBODY)], np.array([[1.9, 0.0]])))[0]
    assert beside.argmax() == straight and beside[straight] > 0.95
