"""Scores of the tracker in simulated crowds: who counts, what frame they are in, and what perfect eyes reach."""

from __future__ import annotations

import math

import numpy as np
import pytest

from densecavoid.baselines import GoToGoal
from densecavoid.frames import LidarConfig, People, Truth
from densecavoid.perception.detections import allocate_detections
from densecavoid.perception.evaluation import tracker as evaluation
from densecavoid.perception.evaluation.tracking_cost import crowd, scan_of_legs
from densecavoid.perception.evaluation.tracking_sources import NoisyTruthSource
from densecavoid.perception.legs import LegDetector
from densecavoid.sim.world import SimConfig


def test_people_are_where_a_robot_that_has_drifted_sees_them():
    pos = np.array([[[2.0, 3.0]]], np.float32)
    one = np.ones((1, 1), np.float32)
    people = People(pos, 0 * pos, one, one, one > 0, one.astype(np.int32))
    truth = Truth(np.array([[2.0, 1.0, math.pi / 2]]), people)  # 2 m straight ahead
    place = evaluation.to_odometry(truth, np.array([[5.0, 5.0, math.pi]]))
    np.testing.assert_allclose(place, [[[3.0, 5.0]]], atol=1e-6)


def moment(places, hidden_s) -> evaluation.Moment:
    none = allocate_detections(1)
    image, scan = np.zeros((1, 2, 2), np.float32), np.zeros((1, 2), np.float32)
    person = np.arange(len(places))[None]
    return evaluation.Moment(
        np.zeros(1, int), np.zeros((1, 3)), image, scan, none, None, person, np.array([places]), np.array([hidden_s])
    )


def test_who_is_far_or_was_never_visible_does_not_count_nor_do_tracks_of_them():
    people = moment([[1.0, 0.0], [3.0, 0.0], [4.9, 0.0], [6.0, 0.0], [0.0, 2.0]], [0.0, np.inf, 0.0, 0.0, 4.0])
    tracks = np.array([[1.1, 0.0], [3.1, 0.0], [5.1, 0.0], [6.0, 0.0], [0.0, -3.0], [0.0, 2.1]])
    frame = evaluation._counted(people, 0, np.arange(6), tracks, math.inf)
    assert frame.person.tolist() == [0, 2, 4]
    assert frame.track.tolist() == [0, 2, 4, 5]  # 4 follows nobody
    in_view = evaluation._counted(people, 0, np.arange(6), tracks, 1.0)
    assert in_view.person.tolist() == [0, 2]
    assert in_view.track.tolist() == [0, 2, 4]


@pytest.mark.parametrize("name", ["missed", "std_m", "false_per_image"])
def test_impossible_errors_are_refused(name):
    with pytest.raises(ValueError, match=name):
        NoisyTruthSource(1, **{name: -0.1})  # pyright: ignore[reportArgumentType]


def test_perfect_eyes_lose_nobody_in_view_and_blind_ones_find_nobody():
    run = evaluation.TrackingRun(2, 25, legs=False, sim=SimConfig(sensors="real", threads=1))
    eyes = NoisyTruthSource(2, missed=0.0, std_m=0.0, false_per_image=0.0)
    scores = evaluation.evaluate_tracker(GoToGoal(), eyes, ("dense-ped",), run)
    assert scores["all"] == scores["dense-ped"] and scores["all"]["people"] > 50
    assert scores["all"]["mota_in_view"] > 0.75 and scores["all"]["idf1_in_view"] > 0.85
    assert scores["all"]["error_m"] < 0.05 and scores["all"]["switches"] == 0
    blind = evaluation.evaluate_tracker(
        GoToGoal(), NoisyTruthSource(2, missed=1.0, false_per_image=0.0), ("dense-ped",), run
    )
    assert blind["all"]["mota"] == 0.0 and blind["all"]["people"] == scores["all"]["people"]


def test_the_crowd_that_costs_are_measured_with_is_the_one_announced():
    lidar = LidarConfig()
    for count in (2, 8, 32):
        assert len(crowd(count)) == count
    out = LegDetector(lidar).detect(scan_of_legs(crowd(4), lidar)[None], np.zeros((1, 3)))
    found = out.pos[0, : out.count[0]]
    in_view = [place for place in crowd(4) if abs(math.atan2(place[1], place[0])) < math.radians(110)]
    assert len(found) == len(in_view) > 0
    for place in in_view:
        assert np.hypot(*(found - place).T).min() < 0.08
