"""Promises of the curriculum."""

from __future__ import annotations

import json

import pytest

pytest.importorskip("torch")

from densecavoid.learning.curriculum import STAGES, Curriculum, CurriculumConfig


def feed(curriculum: Curriculum, successes: int, failures: int, scenario: str | None = None) -> bool:
    outcomes = [True] * successes + [False] * failures
    return curriculum.update([scenario or curriculum.stage] * len(outcomes), outcomes)


def test_the_stages_are_those_of_the_paper_in_its_order() -> None:
    assert STAGES == ("random-goal", "cluttered-static", "random-pedestrians", "dense-random-pedestrians")


def test_difficulty_rises_when_enough_of_a_full_window_succeed() -> None:
    curriculum = Curriculum(CurriculumConfig(window=10, threshold=0.8, level_step=0.1))
    assert not feed(curriculum, 7, 2), "nine episodes are not a window"
    assert not feed(curriculum, 0, 1), "seven of ten are too few"
    assert curriculum.level == 0.0
    curriculum = Curriculum(CurriculumConfig(window=10, threshold=0.8, level_step=0.1))
    assert feed(curriculum, 8, 2)
    assert curriculum.level == 0.1


def test_the_window_slides_and_is_emptied_by_a_promotion() -> None:
    curriculum = Curriculum(CurriculumConfig(window=4, threshold=0.75, level_step=0.5))
    assert not feed(curriculum, 0, 4)
    assert not feed(curriculum, 2, 0)
    assert feed(curriculum, 1, 0), "the last four hold three successes"
    assert curriculum.level == 0.5
    assert not curriculum.window_full
    assert not feed(curriculum, 3, 0), "episodes of the easier level do not count again"


def test_ten_steps_of_a_tenth_reach_one_and_the_next_stage_follows() -> None:
    curriculum = Curriculum(CurriculumConfig(window=5, level_step=0.1))
    levels = []
    while curriculum.stage == "random-goal":
        levels.append(curriculum.level)
        assert feed(curriculum, 5, 0)
    assert levels == pytest.approx([0.1 * k for k in range(11)])
    assert levels[-1] == 1.0
    assert (curriculum.stage, curriculum.level) == ("cluttered-static", 0.0)


def test_episodes_of_stages_to_come_do_not_count() -> None:
    curriculum = Curriculum(CurriculumConfig(window=5))
    assert not feed(curriculum, 50, 0, scenario="dense-random-pedestrians")
    assert curriculum.levels == [0.0] * 4


def test_a_stage_that_is_not_mastered_is_passed_when_patience_ends_and_goes_on_rising() -> None:
    curriculum = Curriculum(CurriculumConfig(window=5, patience=20))
    assert not feed(curriculum, 0, 19)
    assert feed(curriculum, 0, 1)
    assert (curriculum.stage, curriculum.level) == ("cluttered-static", 0.0)
    assert curriculum.mixture()[0] == ("random-goal", 0.0, pytest.approx(0.3))
    assert feed(curriculum, 5, 0, scenario="random-goal")
    assert curriculum.mixture()[0] == ("random-goal", 0.1, pytest.approx(0.3))
    assert (curriculum.stage, curriculum.level) == ("cluttered-static", 0.0)
    assert not feed(curriculum, 0, 19), "patience counts the episodes of each stage from its own first"


def test_simpler_stages_stay_in_the_mixture() -> None:
    curriculum = Curriculum(CurriculumConfig(window=1, level_step=1.0, simpler_share=0.3))
    assert curriculum.mixture() == (("random-goal", 0.0, 1.0),)
    for _ in range(4):
        assert feed(curriculum, 1, 0)
    mixture = curriculum.mixture()
    assert [(part.scenario, part.level) for part in mixture] == [
        ("random-goal", 1.0),
        ("cluttered-static", 1.0),
        ("random-pedestrians", 0.0),
    ]
    assert [part.weight for part in mixture] == pytest.approx([0.15, 0.15, 0.7])
    scenario = curriculum.scenario()
    assert [each.name for each in scenario.scenarios] == [part.scenario for part in mixture]
    assert scenario.weights == tuple(part.weight for part in mixture)
    assert scenario.scenarios[2].level == 0.0  # type: ignore[attr-defined]


def test_the_last_stage_at_full_difficulty_stays() -> None:
    curriculum = Curriculum(CurriculumConfig(window=1, level_step=1.0), stages=("random-pedestrians",))
    assert feed(curriculum, 1, 0)
    assert not feed(curriculum, 1, 0)
    assert (curriculum.stage, curriculum.level) == ("random-pedestrians", 1.0)


def test_a_saved_curriculum_goes_on_where_it_was() -> None:
    config = CurriculumConfig(window=4, level_step=0.5)
    first = Curriculum(config)
    feed(first, 4, 0)
    feed(first, 2, 1)
    second = Curriculum(config)
    second.load_state_dict(json.loads(json.dumps(first.state_dict())))
    assert second.state_dict() == first.state_dict()
    assert feed(first, 1, 0) == feed(second, 1, 0)
    assert second.mixture() == first.mixture()


def test_an_unknown_stage_is_named() -> None:
    with pytest.raises(ValueError, match="unknown stage 'dense-ped'"):
        Curriculum(CurriculumConfig(), stages=("dense-ped",))
