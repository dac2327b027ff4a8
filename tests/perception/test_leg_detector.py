"""Legs in scans: segments measured by hand, pairs, people in simulated and real scans, and the classifier."""

from __future__ import annotations

import math
from pathlib import Path
from typing import Any

import numpy as np
import pytest

from densecavoid.frames import LidarConfig
from densecavoid.perception.evaluation import legs as evaluation
from densecavoid.perception.leg_recordings import empty_rooms, followed_person, half_of, labelled_legs
from densecavoid.perception.leg_segments import FEATURES
from densecavoid.perception.leg_training import CHOSEN_ON, TRAINED_ON, fit_forest, save_forest, segments
from densecavoid.perception.legs import LegDetector, leg_confidence, load_forest, shipped_forest

LIDAR = LidarConfig(num_rays=721, fov_rad=math.radians(240), max_range_m=8.0)
LEG_M = 0.06


def scan(*discs, behind_m: float = np.inf) -> np.ndarray:
    """Ranges to discs (x, y, radius) from the origin, by hand."""
    ranges = np.full(LIDAR.num_rays, behind_m)
    for x, y, radius in discs:
        along = x * np.cos(LIDAR.angles_rad) + y * np.sin(LIDAR.angles_rad)
        across = x * np.sin(LIDAR.angles_rad) - y * np.cos(LIDAR.angles_rad)
        hit = (np.abs(across) < radius) & (along > 0)
        ranges[hit] = np.minimum(ranges[hit], (along - np.sqrt(np.maximum(radius**2 - across**2, 0)))[hit])
    return ranges.astype(np.float32)


def person(x: float, y: float, half_stride: float = 0.14) -> tuple:
    return (x, y + half_stride, LEG_M), (x, y - half_stride, LEG_M)


def described(ranges: np.ndarray) -> list[dict[str, float]]:
    rows, _ = segments(ranges.astype(float), LIDAR)
    return [dict(zip(FEATURES, row, strict=True)) for row in rows]


def people(ranges: np.ndarray, pose=(0.0, 0.0, 0.0)) -> tuple[np.ndarray, np.ndarray]:
    out = LegDetector(LIDAR).detect(ranges[None], np.array([pose]))
    return out.pos[0, : out.count[0]].copy(), out.confidence[0, : out.count[0]].copy()


def test_a_disc_is_one_segment_of_its_width_radius_and_distance():
    (found,) = described(scan((2.0, 0.5, 0.08), behind_m=4.0))
    distance = math.hypot(2.0, 0.5)
    assert found["width_m"] == pytest.approx(0.16, abs=2 * distance * math.radians(240) / 720)
    assert found["circle_radius_m"] == pytest.approx(0.08, rel=0.02)
    assert found["circle_rms_m"] < 1e-4
    assert distance - 0.08 < found["distance_m"] < distance
    assert 0.4 * 0.08 < found["depth_m"] < 0.08  # towards the scanner
    assert found["jump_left_m"] == pytest.approx(2.0, abs=0.1) and found["jump_right_m"] == pytest.approx(2.0, abs=0.1)
    assert found["nearest_m"] == 1.0 and found["filled"] == pytest.approx(1.0, abs=0.1)


def test_a_flat_board_is_straight_and_a_wall_is_no_segment():
    bearing = LIDAR.angles_rad
    board = np.where(np.abs(np.tan(bearing)) < 0.1, 2.0 / np.cos(bearing), np.inf)
    (found,) = described(board)
    assert found["width_m"] == pytest.approx(0.4, abs=0.03) and found["line_rms_m"] < 1e-6
    assert found["circle_radius_m"] == 1.0 and abs(found["depth_m"]) < 1e-6
    wall = np.where(np.abs(bearing) < 1.2, 2.0 / np.cos(bearing), np.inf)
    assert described(wall) == []


def test_two_legs_know_of_each_other_and_a_lost_ray_splits_none():
    ranges = scan(*person(2.0, 0.0))
    legs = described(ranges)
    assert [leg["nearest_m"] for leg in legs] == pytest.approx([0.28, 0.28], abs=0.02)
    ranges[np.flatnonzero(np.isfinite(ranges))[4]] = np.nan
    assert len(described(ranges)) == 2


def test_legs_make_people_where_they_stand_in_the_odometry_frame():
    found, confidence = people(scan(*person(2.0, 0.3), *person(3.0, -1.0), behind_m=6.0))
    np.testing.assert_allclose(found[np.argsort(found[:, 0])], [[2.0, 0.3], [3.0, -1.0]], atol=0.04)
    assert (confidence > 0.8).all()
    x, y, yaw = 1.0, -2.0, 0.7
    turned, _ = people(scan(*person(2.0, 0.3)), (x, y, yaw))
    expected = [x + math.cos(yaw) * 2.0 - math.sin(yaw) * 0.3, y + math.sin(yaw) * 2.0 + math.cos(yaw) * 0.3]
    np.testing.assert_allclose(turned, [expected], atol=0.04)


def test_people_side_by_side_keep_their_own_legs():
    found, _ = people(scan(*person(2.0, -0.3, 0.1), *person(2.0, 0.3, 0.1), behind_m=6.0))
    np.testing.assert_allclose(found[np.argsort(found[:, 1])], [[2.0, -0.3], [2.0, 0.3]], atol=0.05)


@pytest.mark.parametrize("value", [np.nan, np.inf, -np.inf, 0.0, -1.0, 1e30])
def test_a_scan_without_returns_shows_nobody(value):
    assert len(people(np.full(LIDAR.num_rays, value, np.float32))[0]) == 0


def test_scans_of_another_lidar_are_refused():
    with pytest.raises(ValueError, match="scan_m"):
        LegDetector(LIDAR).detect(np.zeros((1, 100), np.float32), np.zeros((1, 3)))


def test_each_world_is_looked_at_alone_and_only_if_marked():
    scans = np.stack([scan(*person(2.0, 0.2 * k), behind_m=5.0) for k in range(6)])
    detector, poses = LegDetector(LIDAR, 6, threads=2), np.zeros((6, 3))
    out = detector.detect(scans, poses)
    for b in range(6):
        alone = LegDetector(LIDAR).detect(scans[b : b + 1], poses[:1])
        np.testing.assert_array_equal(out.pos[b, : out.count[b]], alone.pos[0, : alone.count[0]])
    before = out.pos.copy()
    detector.detect(scans[::-1].copy(), poses, np.array([True] + 5 * [False]))
    np.testing.assert_array_equal(out.pos[1:], before[1:])


def test_the_forest_is_scikit_learns(tmp_path):
    pytest.importorskip("sklearn")
    from sklearn.ensemble import GradientBoostingClassifier

    rng = np.random.default_rng(0)
    rows = rng.normal(size=(600, len(FEATURES)))
    truth = rows[:, 0] * rows[:, 3] + 0.5 * rows[:, 5] > 0.2
    save_forest(fit_forest(rows, truth, np.ones(600), 12, 3, 0), tmp_path / "forest.npz")
    forest = load_forest(tmp_path / "forest.npz")
    theirs = GradientBoostingClassifier(
        n_estimators=12, max_depth=3, learning_rate=0.25, subsample=0.7, min_samples_leaf=20, random_state=0
    ).fit(rows, truth)
    queries = rng.normal(size=(200, len(FEATURES)))
    ours = [leg_confidence(forest, row) for row in queries]
    np.testing.assert_allclose(ours, theirs.predict_proba(queries)[:, 1], atol=1e-5)


def test_a_forest_of_other_features_is_refused(tmp_path):
    np.savez(tmp_path / "old.npz", features=np.array(["width_m"]))
    with pytest.raises(ValueError, match=r"features of old\.npz"):
        load_forest(tmp_path / "old.npz")


@pytest.mark.parametrize(
    ("changes", "what"),
    [
        ({"feature": np.full((2, 3), 99, np.int8)}, "features in"),
        ({"feature": np.full((2, 3), -1, np.int8)}, "features in"),
        ({"value": np.zeros((2, 3), np.float32)}, "shapes in"),
        ({"threshold": np.full((2, 3), np.nan, np.float32)}, "finite"),
        ({"value": np.array([["a"]])}, "numbers"),
        ({"value": np.array([None])}, "bytes of array"),
        ({"threshold": np.zeros((1200, 1200), np.float32)}, "at most"),
    ],
)
def test_a_forest_that_would_look_beyond_its_arrays_is_refused(changes: dict[str, np.ndarray], what: str, tmp_path):
    good: dict[str, Any] = {
        "features": np.array(FEATURES),
        "feature": np.zeros((2, 3), np.int8),
        "threshold": np.zeros((2, 3), np.float32),
        "value": np.zeros((2, 4), np.float32),
        "base": np.float64(0.0),
    }
    np.savez_compressed(tmp_path / "good.npz", allow_pickle=True, **good)
    assert load_forest(tmp_path / "good.npz").feature.shape == (2, 3)
    np.savez_compressed(tmp_path / "bad.npz", allow_pickle=True, **(good | changes))
    with pytest.raises(ValueError, match=what):
        load_forest(tmp_path / "bad.npz")


def test_positions_are_judged_one_to_one_within_half_a_metre():
    found = np.array([[0.0, 0.0], [0.1, 0.0], [3.0, 0.0], [5.0, 0.0]])
    judged = evaluation.match(
        found, np.full(4, 0.9), np.array([[0.0, 0.05], [3.4, 0.0], [9.0, 0.0]]), np.array([[5.2, 0.0]])
    )
    assert judged.right.tolist() == [1.0, 0.0, 1.0]  # the last is of somebody who does not count
    summary = judged.summary()
    assert summary["precision"] == pytest.approx(2 / 3) and summary["recall"] == pytest.approx(2 / 3)
    assert summary["false_per_scan"] == 1.0 and summary["error_m"] == pytest.approx(0.225)


def test_average_precision_is_the_area_under_the_curve():
    found = evaluation.Found(np.array([0.9, 0.8, 0.7, 0.6]), np.array([1.0, 0.0, 1.0, 0.0]), np.full(4, 0.1), 4, 1)
    assert found.summary()["ap"] == pytest.approx(0.25 * 1.0 + 0.25 * 2 / 3)


def test_people_in_simulated_crowds_are_found():
    summary = evaluation.in_simulation("dense-ped", shipped_forest(), worlds=3).summary()
    assert summary["precision"] > 0.93 and summary["recall"] > 0.75 and summary["error_m"] < 0.05


@pytest.fixture(scope="module")
def recordings(data_dir: Path) -> Path:
    if not any((data_dir / "leg_tracker").glob("*_extracted.npz")):
        pytest.skip(f"no leg_tracker/*_extracted.npz in {data_dir}")
    return data_dir


def test_real_people_are_found(recordings):
    tests = [one for one in labelled_legs(recordings) if one.name not in TRAINED_ON + CHOSEN_ON]
    summary = evaluation.pooled([evaluation.on_recording(one, shipped_forest(), False) for one in tests]).summary()
    assert summary["precision"] > 0.93 and summary["recall"] > 0.70 and summary["error_m"] < 0.1


def test_a_person_followed_outdoors_is_found(recordings):
    if not (recordings / "leg_tracker" / "person_following_outdoor_1.npz").is_file():
        pytest.skip("no leg_tracker/person_following_outdoor_1.npz")
    recording = followed_person(recordings)
    assert sum(map(len, recording.labels)) == 6179
    part = half_of(recording, first=False)
    part = half_of(part, first=True)  # a quarter is enough
    assert evaluation.on_recording(part, shipped_forest(), everywhere=False).summary()["recall"] > 0.8


def test_empty_rooms_show_fewer_people_than_the_rule_of_thumb_sees(recordings):
    pytest.importorskip("rosbags")
    if not (recordings / "leg_tracker" / "negative_2.bag").is_file():
        pytest.skip("no leg_tracker/negative_2.bag")
    rooms = empty_rooms(recordings)
    assert [len(room.time_s) for room in rooms] == [435, 435, 434]
    room = half_of(half_of(rooms[0], first=False), first=False)
    ours, rule = (
        evaluation.on_recording(room, forest, everywhere=True).summary()["false_per_scan"]
        for forest in (shipped_forest(), evaluation.rule_of_thumb())
    )
    assert ours < 0.5 * rule


def test_a_folder_without_recordings_is_refused(tmp_path):
    with pytest.raises(ValueError, match="no leg_tracker"):
        labelled_legs(tmp_path)
