"""The figures of BENCHMARK.md on episodes made by hand."""

from __future__ import annotations

import math

import numpy as np
import pytest
from episodes import DT_S, episode, straight

from densecavoid.benchmark.metrics import episode_metrics, mean_absolute_jerk, summarise, turn_sign_changes


def test_a_straight_success():
    figures = episode_metrics(episode(straight(4.75, 5.0), "success"))
    assert figures.success and not figures.collision and not figures.timeout and not figures.frozen
    assert figures.path_length_m == pytest.approx(4.75)
    assert figures.time_to_goal_s == pytest.approx(5.0)
    # Shorter than the straight line to the goal's centre, which is as good as it gets.
    assert figures.spl == 1.0
    assert figures.clearance_people_m is None
    assert figures.personal_space == 0.0


def test_spl_of_a_detour_by_hand():
    """3 m and 4 m at right angles towards a goal 5 m away: 5 / 7."""
    legs = np.concatenate([straight(3.0, 3.0), [[3.0, 4.0 * k / 40] for k in range(1, 41)]])
    assert episode_metrics(episode(legs, "success", (3.0, 4.0))).spl == pytest.approx(5 / 7)
    assert episode_metrics(episode(legs, "success", (3.0, 4.0)), shortest_m=6.0).spl == pytest.approx(6 / 7)
    assert episode_metrics(episode(legs, "timeout", (3.0, 4.0))).spl == 0.0


@pytest.mark.parametrize(
    ("person", "approached", "at_fault", "walked_into"),
    [(False, False, True, False), (True, True, True, False), (True, False, False, True)],
)
def test_a_collision_is_at_fault_or_walked_into(person, approached, at_fault, walked_into):
    record = episode(straight(2.0, 2.0), "collision", collided_person=person, robot_approached=approached)
    figures = episode_metrics(record)
    assert figures.collision and figures.time_to_goal_s is None
    assert (figures.at_fault, figures.walked_into) == (at_fault, walked_into)


def test_success_is_no_fault_whatever_came_before():
    figures = episode_metrics(episode(straight(4.8, 5.0), "success", robot_approached=True, collided_person=True))
    assert not figures.at_fault and not figures.walked_into


def standing_at_2_m(instants: int) -> np.ndarray:
    """2 m at 1 m/s, a pause, and on."""
    onwards = np.column_stack([np.linspace(2.0, 5.0, 31), np.zeros(31)])
    return np.concatenate([straight(2.0, 2.0), np.tile([2.0, 0.0], (instants, 1)), onwards])


def test_standing_for_ten_seconds_is_frozen():
    assert episode_metrics(episode(standing_at_2_m(101))).frozen


def test_standing_for_less_than_ten_seconds_is_not():
    assert not episode_metrics(episode(standing_at_2_m(90))).frozen


def test_oscillating_is_frozen_though_the_robot_moves():
    times = DT_S * np.arange(150)
    circle = np.column_stack([0.14 * np.cos(2 * times), 0.14 * np.sin(2 * times)])
    figures = episode_metrics(episode(circle))
    assert figures.frozen
    assert figures.path_length_m > 3


def test_creeping_is_not_frozen():
    """.031 m/s makes .31 m in 10 s."""
    assert not episode_metrics(episode(straight(0.031 * 30, 30.0))).frozen
    assert episode_metrics(episode(straight(0.029 * 30, 30.0))).frozen


def test_a_quarter_of_an_hour_does_not_make_a_short_episode_frozen():
    assert not episode_metrics(episode(np.zeros((100, 2)))).frozen


def test_an_instant_at_which_the_goal_is_reached_is_not_frozen():
    """A way there and back in 10 s that ends at the goal: the net displacement is small only at that instant."""
    out = straight(3.0, 5.0)
    record = np.concatenate([out, out[-2::-1]])
    assert not episode_metrics(episode(record, "success", (0.1, 0.0))).frozen
    assert episode_metrics(episode(record, "timeout", (0.1, 0.0))).frozen


def test_who_has_not_passed_the_people_after_thirty_seconds_is_frozen():
    """Sidling along people at x = 4, who appeared at 3 s, fast enough not to be frozen otherwise."""
    times = DT_S * np.arange(400)
    sidling = np.column_stack([np.minimum(times, 2.0), 0.05 * times])
    assert not episode_metrics(episode(sidling)).frozen
    assert episode_metrics(episode(sidling, spawn_time_s=3.0, spawn_line_x=4.0)).frozen
    assert not episode_metrics(episode(sidling, spawn_time_s=3.0, spawn_line_x=1.9)).frozen
    assert not episode_metrics(episode(sidling, spawn_time_s=12.0, spawn_line_x=4.0)).frozen


def test_personal_space_is_the_share_of_time_within_45_cm_of_a_body():
    near = np.array([1.0, 0.46, 0.44, 0.35, 0.44, 0.5, 2.0, 3.0, 4.0, 5.0])
    figures = episode_metrics(episode(straight(1.0, 1.0), clearance_people_m=near))
    assert figures.personal_space == pytest.approx(0.3)
    assert figures.clearance_people_m == 0.35


def test_jerk_of_a_cubic_is_its_constant_third_derivative():
    """x = j t^3 / 6 has v = j t^2 / 2, whose central second difference is exactly j."""
    times = DT_S * np.arange(30)
    assert mean_absolute_jerk(times, -0.5 * 1.7 * times**2) == pytest.approx(1.7)
    assert mean_absolute_jerk(times, 0.3 * times) == pytest.approx(0.0, abs=1e-9)


def test_sign_changes_ignore_trembling():
    assert turn_sign_changes(np.array([0.3, 0.01, -0.01, 0.2, -0.3, 0.0, -0.2, 0.4])) == 2
    assert turn_sign_changes(np.array([0.01, -0.01, 0.01])) == 0


def test_a_cell_counts_every_episode_once_and_averages_what_has_a_meaning():
    success = episode(straight(4.75, 5.0), "success", velocity=np.tile([1.0, 0.1], (51, 1)))
    detour = np.concatenate([straight(3.0, 3.0), [[3.0, 4.0 * k / 40] for k in range(1, 41)]])
    turns = np.column_stack([np.ones(21), np.where(np.arange(21) % 2 == 0, 0.3, -0.3)])
    hit = episode(
        straight(2.0, 2.0),
        "collision",
        collided_person=True,
        velocity=turns,
        clearance_people_m=np.linspace(1.0, 0.3, 20),
    )
    cell = summarise(
        [
            episode_metrics(success),
            episode_metrics(episode(detour, "success", (3.0, 4.0))),
            episode_metrics(hit),
            episode_metrics(episode(np.zeros((200, 2)))),
        ]
    )
    rates = {
        name: cell[name] for name in ("success", "collision", "walked_into", "collision_at_fault", "timeout", "frozen")
    }
    assert rates == {
        "success": 0.5,
        "collision": 0.25,
        "walked_into": 0.25,
        "collision_at_fault": 0.0,
        "timeout": 0.25,
        "frozen": 0.25,
    }
    assert cell["path_length_m"] == pytest.approx((4.75 + 7) / 2)
    assert cell["time_to_goal_s"] == pytest.approx((5 + 7) / 2)
    assert cell["spl"] == pytest.approx((1 + 5 / 7) / 4)
    assert cell["clearance_people_m"] == pytest.approx(0.3)
    assert cell["w_sign_changes_per_m"] == pytest.approx(20 / (4.75 + 7 + 2))
    low, high = cell["success_ci95"]  # type: ignore[misc]
    assert low < 0.5 < high


def test_a_cell_without_success_or_people_says_that_it_does_not_know():
    cell = summarise([episode_metrics(episode(np.zeros((30, 2))))])
    assert cell["path_length_m"] is None and cell["time_to_goal_s"] is None and cell["clearance_people_m"] is None
    assert cell["w_sign_changes_per_m"] is None
    assert not any(isinstance(value, float) and not math.isfinite(value) for value in cell.values())


def test_an_unknown_outcome_is_refused():
    with pytest.raises(ValueError, match="unknown outcome 'won'"):
        episode(straight(1.0, 1.0), "won")
