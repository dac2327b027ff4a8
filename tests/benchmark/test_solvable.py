"""Which worlds are admitted: the first solvable ones, the same whoever asks, judged once."""

from __future__ import annotations

import numpy as np
import pytest

from densecavoid.benchmark import solvable
from densecavoid.benchmark.solvable import admit, judgement_of
from densecavoid.foresight.planner import Judgement, Plan
from densecavoid.scenarios import make_scenario
from densecavoid.sim.config import SimConfig

CONFIG = SimConfig(threads=1)
SCENARIO = make_scenario("random-goal")


@pytest.fixture(autouse=True)
def own_cache(tmp_path, monkeypatch):
    monkeypatch.setattr(solvable, "user_cache", lambda: tmp_path)
    return tmp_path


def judged_by(solvable_seed, asked: list[int]):
    """An engine for which a world can be solved when its seed says so."""

    def judge_many(scenario, shares, config):
        for seeds in reversed(list(shares)):
            asked.extend(seeds)
            plan = Plan(np.array([[0.5, -0.1], [0.5, -0.1], [0.3, 0.4]], np.float32).astype(float), 0.3)
            yield seeds, [Judgement(plan if solvable_seed(seed) else None, 0.25) for seed in seeds]

    return judge_many


def test_the_first_solvable_worlds_are_admitted_in_order():
    admission = admit(SCENARIO, CONFIG, 100, 12, judged_by(lambda seed: seed % 3 == 0, []))
    assert admission.seeds == tuple(range(102, 138, 3))
    # 100 to 135, of which twelve can be solved.
    assert (admission.tried, admission.solved) == (36, 12) and admission.share == pytest.approx(1 / 3)


def test_more_worlds_begin_with_the_fewer_and_are_judged_once():
    asked: list[int] = []
    judge_many = judged_by(lambda seed: seed % 2 == 0, asked)
    few = admit(SCENARIO, CONFIG, 0, 5, judge_many)
    many = admit(SCENARIO, CONFIG, 0, 20, judge_many)
    assert many.seeds[:5] == few.seeds
    assert len(asked) == len(set(asked))
    again = admit(SCENARIO, CONFIG, 0, 5, judge_many)
    assert (again.seeds, again.tried, again.share) == (few.seeds, few.tried, few.share)


def test_a_judgement_survives_the_cache(own_cache):
    first = admit(SCENARIO, CONFIG, 7, 1, judged_by(lambda seed: True, [])).judgements[7]
    second = judgement_of(SCENARIO, 7, CONFIG)
    assert first.plan is not None and second.plan is not None
    np.testing.assert_array_equal(first.plan.commands, second.plan.commands)
    assert (first.plan.time_s, first.density_per_m2) == (second.plan.time_s, second.density_per_m2)


def test_half_a_file_is_judged_again(own_cache):
    asked: list[int] = []
    admit(SCENARIO, CONFIG, 7, 1, judged_by(lambda seed: True, asked))
    (path,) = own_cache.rglob("7.json")
    path.write_text(path.read_text()[:20])
    admit(SCENARIO, CONFIG, 7, 1, judged_by(lambda seed: True, asked))
    assert asked == [7, 7]


def test_other_people_are_other_worlds_but_the_same_people_who_react_are_not():
    asked: list[int] = []
    judge_many = judged_by(lambda seed: True, asked)
    for config in (CONFIG, SimConfig(pace="rush"), SimConfig(people="reactive"), SimConfig(dynamics="dynamic")):
        admit(SCENARIO, config, 0, 3, judge_many)
    assert len(asked) == 6


def test_where_nothing_can_be_solved_the_search_ends():
    admission = admit(SCENARIO, CONFIG, 0, 4, judged_by(lambda seed: False, []))
    assert admission.seeds == () and admission.tried == 20 and admission.share == 0.0


def test_recorded_people_who_make_way_are_not_filtered(data_dir):
    scenario = make_scenario("hermes:bo-360-050-050:reactive", data_dir)
    admission = admit(scenario, CONFIG, 0, 6, judged_by(lambda seed: seed == 3, []))
    assert admission.seeds == tuple(range(6)) and not admission.filtered and admission.solved == 1
