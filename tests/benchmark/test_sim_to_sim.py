"""Sim to sim: a robot that its sensors do not lead ends alike in both bodies, and the comparison counts as by hand."""

from __future__ import annotations

import pytest

pytest.importorskip("mujoco")

import sim_to_sim
from densecavoid.baselines.go_to_goal import GoToGoal
from densecavoid.scenarios import make_scenario
from densecavoid.sim.config import SimConfig
from sim_to_sim import Ending, compared, in_mujoco, in_simulator


@pytest.mark.parametrize("name", ["dense-ped", "random-sparse-ped"])
def test_who_drives_straight_on_ends_alike_in_both(name: str) -> None:
    scenario, config, seeds = make_scenario(name), SimConfig(threads=1), range(20, 26)
    ours = in_simulator(scenario, config, GoToGoal(), seeds)
    theirs = in_mujoco(scenario, config, GoToGoal(), seeds)
    assert [ending.outcome for ending in theirs] == [ending.outcome for ending in ours]
    assert [ending.seed for ending in theirs] == list(seeds)
    for a, b in zip(ours, theirs, strict=True):
        # The simulator counts whole control steps, MuJoCo's world the physics steps until the end.
        assert -1e-6 <= a.duration_s - b.duration_s <= config.control_dt_s


def test_rates_and_their_difference_are_counted_by_world() -> None:
    ends = ["success", "success", "collision", "timeout"]
    ours = [Ending(seed, outcome, 10.0) for seed, outcome in enumerate(ends)]
    theirs = [Ending(seed, outcome, 12.5) for seed, outcome in enumerate(["success", *ends[1:3], "success"])]
    result = compared(ours, theirs)
    assert (result["worlds"], result["same_outcome"]) == (4, 0.75)
    assert result["difference"] == pytest.approx(0.25)
    assert result["time_to_goal_apart_s_median"] == pytest.approx(2.5)
    assert result["simulator"]["success"] == 0.5 and result["mujoco"]["success"] == 0.75
    assert result["simulator"]["collision"] == result["simulator"]["timeout"] == 0.25
    assert "NOT within 0.05" in sim_to_sim.table(result)
    assert "+0.000 [+0.000, +0.000], within 0.05" in sim_to_sim.table(compared(ours, ours))
