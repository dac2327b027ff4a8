"""Tracks: the filter against matrices, people who cross, hide and stand, evidence, two sensors, and wrong input."""

from __future__ import annotations

import math

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from densecavoid.frames import CameraConfig, LidarConfig
from densecavoid.perception.detections import MAX_DETECTIONS, Detections, allocate_detections
from densecavoid.perception.kalman import imm_begin, imm_correct, imm_predict, kalman_correct, kalman_predict
from densecavoid.perception.people_around import turns_per_s
from densecavoid.perception.tracker import Sighting, Tracker
from densecavoid.perception.tracker_settings import MAX_UNSEEN_S, TrackerSettings
from densecavoid.perception.tracks import HISTORY, MAX_TRACKS
from densecavoid.perception.visibility import depth_view, lidar_view
from densecavoid.sim._jit import kernel

CAMERA, LIDAR = CameraConfig(), LidarConfig()
DT = 0.1
MANNER = TrackerSettings(steady_std=0.1, turning_std=1.5, turns_per_s=0.3, steadies_per_s=1.0)


def found(*worlds, std=0.05, confidence=0.95) -> Detections:
    """Detections at places, a list a world."""
    detections = allocate_detections(len(worlds))
    for b, places in enumerate(worlds):
        n = len(places)
        detections.count[b] = n
        if n:
            detections.pos[b, :n] = places
        detections.std_m[b, :n], detections.confidence[b, :n] = std, confidence
    return detections


def camera(detections: Detections, depth_m: float | np.ndarray = 4.99) -> Sighting:
    """What a camera found, before a background or an image."""
    image = np.empty((len(detections.count), CAMERA.height, CAMERA.width), np.float32)
    image[:] = depth_m
    return Sighting(detections, depth_view(image, CAMERA))


def lidar(detections: Detections, range_m: float | np.ndarray = np.inf) -> Sighting:
    scan = np.empty((len(detections.count), LIDAR.num_rays), np.float32)
    scan[:] = range_m
    return Sighting(detections, lidar_view(scan, LIDAR))


def run(tracker: Tracker, sightings, pose=(0.0, 0.0, 0.0)):
    worlds = len(tracker.tracks.next_id)
    return tracker.update(np.tile(np.array(pose, float), (worlds, 1)), DT, sightings)


def confirmed(tracker: Tracker, b: int = 0) -> np.ndarray:
    return np.flatnonzero(tracker.tracks.confirmed[b])


def test_the_filter_is_the_textbook_one_in_4_x_4_matrices():
    rng = np.random.default_rng(0)
    eye = np.eye(2)
    transition = np.block([[eye, DT * eye], [0 * eye, eye]])
    push = np.vstack([0.5 * DT**2 * eye, DT * eye])
    noise = 1.0**2 * push @ push.T
    measure = np.hstack([eye, 0 * eye])
    mean, cov = rng.normal(size=4), np.block([[0.3 * eye, 0.1 * eye], [0.1 * eye, 0.8 * eye]])
    state, shared = mean.copy(), np.array([0.3, 0.1, 0.8])
    for _ in range(30):
        z, std = rng.normal(size=2), rng.uniform(0.02, 0.3)
        kalman_predict(state, shared, DT, 1.0)
        kalman_correct(state, shared, z[0], z[1], std)
        mean, cov = transition @ mean, transition @ cov @ transition.T + noise
        innovation = measure @ cov @ measure.T + std**2 * eye
        gain = cov @ measure.T @ np.linalg.inv(innovation)
        mean, cov = mean + gain @ (z - measure @ mean), (np.eye(4) - gain @ measure) @ cov
        np.testing.assert_allclose(state, mean, rtol=1e-9)
        np.testing.assert_allclose(shared, [cov[0, 0], cov[0, 2], cov[2, 2]], rtol=1e-9)


@kernel
def through(modes, state, covariance, places, std, dt, manner, told):
    """Both models through measured places, moment by moment."""
    imm_begin(modes, state, covariance, 0.2)
    for k in range(len(places)):
        imm_predict(modes, state, covariance, dt, manner)
        imm_correct(modes, state, covariance, places[k, 0], places[k, 1], std)
        for i in range(7):
            told[k, i] = state[i] if i < 4 else covariance[i - 4]
        told[k, 7] = modes[0, 7]


def follow(places: np.ndarray, std: float) -> np.ndarray:
    told = np.empty((len(places), 8))
    through(
        np.zeros((3, 8)), np.array([*places[0], 0.0, 0.0]), np.array([0.01, 0.0, 0.5]), places, std, DT, MANNER, told
    )
    return told


def test_two_models_together_are_the_textbook_ones_in_matrices():
    """Where x and y are the same, so are their covariances, which the tracker supposes always."""
    rng = np.random.default_rng(0)
    line = np.cumsum(0.05 + 0.1 * rng.normal(size=60) ** 3)
    transition, push = np.array([[1.0, DT], [0.0, 1.0]]), np.array([0.5 * DT**2, DT])
    stay = np.exp(-DT * np.array([0.3, 1.0]))
    switch = np.array([[stay[0], 1 - stay[0]], [1 - stay[1], stay[1]]])
    means, covs = np.array([[line[0], 0.0]] * 2), np.array([np.diag([0.01, 0.5])] * 2)
    chance, std = np.array([0.8, 0.2]), 0.05
    told = follow(np.stack([line, line], axis=1), std)
    for z, state in zip(line, told, strict=True):
        ahead = chance @ switch
        share = switch * chance[:, None] / ahead  # of model i in what goes into model j
        mixed = share.T @ means
        off = means[:, None] - mixed[None]
        covs = np.einsum("ij,iab->jab", share, covs) + np.einsum("ij,ija,ijb->jab", share, off, off)
        means = mixed @ transition.T
        covs = transition @ covs @ transition.T + np.array([0.1, 1.5])[:, None, None] ** 2 * np.outer(push, push)
        innovation = covs[:, 0, 0] + std**2
        missed = z - means[:, 0]
        chance = ahead * np.exp(-(missed**2) / innovation) / innovation  # of x and of y
        chance /= chance.sum()
        gain = covs[:, :, 0] / innovation[:, None]
        means = means + gain * missed[:, None]
        covs = covs - gain[:, :, None] * covs[:, :1]
        np.testing.assert_allclose(state[[0, 2]], chance @ means, rtol=1e-9)
        off = means - chance @ means
        together = np.einsum("i,iab->ab", chance, covs) + np.einsum("i,ia,ib->ab", chance, off, off)
        np.testing.assert_allclose(state[4:7], together[[0, 0, 1], [0, 1, 1]], rtol=1e-9, atol=1e-12)
        assert state[7] == pytest.approx(chance[0], rel=1e-6)


def test_the_velocity_of_who_walks_on_is_better_known_than_one_model_knows_it_and_a_turn_is_followed():
    rng = np.random.default_rng(1)
    wrong, alone, late = [], [], []
    for _ in range(50):
        velocity = np.where(np.arange(90)[:, None] < 60, [0.5, 0.0], [0.0, 0.5])
        places = np.cumsum(DT * velocity, axis=0) + rng.normal(0, 0.04, (90, 2))
        told = follow(places, 0.04)
        wrong.append(np.hypot(*(told[40:60, 2:4] - velocity[40:60]).T))
        late.append(np.hypot(*(told[72, 2:4] - velocity[72])))
        state, covariance = np.array([*places[0], 0.0, 0.0]), np.array([0.01, 0.0, 0.5])
        for k, place in enumerate(places[:60]):
            kalman_predict(state, covariance, DT, 1.0)
            kalman_correct(state, covariance, *place, 0.04)
            if k >= 40:
                alone.append(np.hypot(*(state[2:] - velocity[k])))
    assert np.median(wrong) < 0.6 * np.median(alone)
    assert np.median(late) < 0.15  # 1.2 s after a right angle


def test_how_often_people_turn_is_told_from_how_they_have_moved():
    """In the first of two worlds they walk straight on, in the second they turn by up to right angles every 2 s."""
    rng = np.random.default_rng(2)
    tracker, places = Tracker(2), np.array([[[4.0, -1.0], [6.0, 1.0]]] * 2)
    heading, told = np.zeros((2, 2)), []
    for step in range(150):
        if step % 20 == 19:
            heading[1] += rng.uniform(0.5, 1.6, 2) * rng.choice([-1, 1], 2)
        places = places + 0.5 * DT * np.stack([np.cos(heading), np.sin(heading)], axis=-1)
        run(tracker, [camera(found(*(places + rng.normal(0, 0.03, places.shape)), std=0.03))])
        told.append(turns_per_s(tracker.tracks))
    often = np.array(told)
    assert (often[:10] == 0.0).all()  # as long as nothing is known
    assert often[-1, 0] == 0.0 and 0.3 < often[-1, 1] < 2.0
    tracker.reset(np.array([False, True]))
    assert (turns_per_s(tracker.tracks) == 0.0).all()


def test_people_who_cross_one_metre_apart_keep_their_labels():
    rng = np.random.default_rng(1)
    for _ in range(10):
        tracker, first = Tracker(1), None
        for step in range(60):
            t = DT * step
            a, b = [4.5, -2.4 + 0.8 * t], [3.5, 2.4 - 0.8 * t]  # they pass at t = 3 s
            places = np.array([a, b]) + rng.normal(0, 0.05, (2, 2))
            tracks = run(tracker, [camera(found(places[:: rng.choice([-1, 1])]))])
            assert len(confirmed(tracker)) == 2
            by_x = tracks.id[0, confirmed(tracker)[np.argsort(-tracks.state[0, confirmed(tracker), 0])]].tolist()
            first = first or by_x
            assert by_x == first


def test_a_velocity_is_learnt():
    tracker = Tracker(1)
    for step in range(40):
        run(tracker, [camera(found([[5.0 - 0.08 * step, 1.0 - 0.05 * step]]))])
    (t,), tracks = confirmed(tracker), tracker.tracks
    np.testing.assert_allclose(tracks.state[0, t, 2:], [-0.8, -0.5], atol=0.05)
    assert tracks.hits[0, t] == 40


def test_a_person_hidden_for_two_seconds_is_the_same_person_after_it():
    tracker = Tracker(1)
    hidden = np.full((1, CAMERA.height, CAMERA.width), 1.5, np.float32)  # somebody stands right before the camera
    for step in range(50):
        place = [[3.5, 1.5 - 0.05 * step]]
        seen = step < 15 or step >= 35
        run(tracker, [camera(found(place)) if seen else camera(found([]), hidden)])
        if step >= 1:
            assert len(confirmed(tracker)) == 1 and tracker.tracks.id[0, confirmed(tracker)[0]] == 0
    assert tracker.tracks.next_id[0] == 1


def test_who_ought_to_be_seen_and_is_not_is_given_up_soon_and_the_hidden_late():
    def steps_until_gone(depth) -> int:
        tracker = Tracker(1)
        for _ in range(20):
            run(tracker, [camera(found([[3.0, 0.0]]))])
        for step in range(100):
            run(tracker, [camera(found([]), depth)])
            if not tracker.tracks.live[0].any():
                return step + 1
        return 100

    in_plain_view, hidden = steps_until_gone(4.9), steps_until_gone(1.5)
    assert 3 <= in_plain_view <= 8
    assert hidden == pytest.approx(MAX_UNSEEN_S / DT, abs=1)


def test_a_standing_person_keeps_still_while_the_robot_turns_in_place():
    """Detections come in the robot's frame; what the odometry says of the turn takes it out."""
    tracker, rng = Tracker(1), np.random.default_rng(2)
    for step in range(60):
        yaw = 0.04 * (step % 30 - 15)
        seen = np.array([3.0 * math.cos(-yaw), 3.0 * math.sin(-yaw)]) + rng.normal(0, 0.03, 2)  # robot frame
        place = [math.cos(yaw) * seen[0] - math.sin(yaw) * seen[1], math.sin(yaw) * seen[0] + math.cos(yaw) * seen[1]]
        run(tracker, [camera(found([place]))], (0.0, 0.0, yaw))
    (t,), tracks = confirmed(tracker), tracker.tracks
    assert np.hypot(*tracks.state[0, t, 2:]) < 0.15
    np.testing.assert_allclose(tracks.state[0, t, :2], [3.0, 0.0], atol=0.05)


def test_one_unsure_detection_is_nobody_and_many_are_somebody():
    tracker = Tracker(1)
    run(tracker, [camera(found([[3.0, 0.0]], confidence=0.5))])
    assert tracker.tracks.live[0].any() and not len(confirmed(tracker))
    for _ in range(4):
        run(tracker, [camera(found([[3.0, 0.0]], confidence=0.5))])
    assert len(confirmed(tracker)) == 1
    doubtful = Tracker(1)
    for _ in range(20):
        run(doubtful, [camera(found([[3.0, 0.0]], confidence=0.1))])
        assert not len(confirmed(doubtful))


def test_standing_legs_are_furniture_until_they_walk_or_the_camera_sees_them():
    tracker, rng = Tracker(1), np.random.default_rng(3)
    for _ in range(60):
        run(tracker, [lidar(found([rng.normal([1.0, 0.5], 0.03)], confidence=0.9))])
        assert not len(confirmed(tracker))
    run(tracker, [camera(found([[1.0, 0.5]])), lidar(found([[1.0, 0.5]]))])
    assert len(confirmed(tracker)) == 1
    walker = Tracker(1)
    for step in range(12):
        run(walker, [lidar(found([[1.0 + 0.08 * step, 0.5]], confidence=0.9))])
    assert len(confirmed(walker)) == 1


def test_legs_and_camera_make_one_track_and_the_legs_refine_it():
    rng = np.random.default_rng(4)
    truth, alone, both = np.array([2.5, 0.3]), Tracker(200), Tracker(200)
    for _ in range(8):
        boxes = found(*truth + rng.normal(0, 0.12, (200, 1, 2)), std=0.15)
        legs = found(*truth + rng.normal(0, 0.05, (200, 1, 2)), std=0.05)
        run(alone, [camera(boxes)])
        run(both, [camera(boxes), lidar(legs, 2.4)])
    assert (both.tracks.confirmed.sum(axis=1) == 1).mean() > 0.985  # gross errors of boxes can be somebody, for a while
    errors = [np.hypot(*(tracker.tracks.state[:, 0, :2] - truth).T).mean() for tracker in (alone, both)]
    assert errors[1] < 0.6 * errors[0]


def test_a_body_is_the_sensors_where_it_tells_and_typical_where_not():
    tracker = Tracker(1)
    run(tracker, [lidar(found([[1.0, 0.0]]))])
    assert tracker.tracks.body[0, 0] == pytest.approx([0.255, 1.71])
    boxes = found([[1.0, 0.0]])
    boxes.body[0, 0] = 0.3, 1.9
    run(tracker, [camera(boxes)])
    assert tracker.tracks.body[0, 0] == pytest.approx([0.3, 1.9])


def test_the_history_has_the_places_of_the_last_seconds_in_order():
    tracker = Tracker(1)
    tracks = tracker.tracks
    for step in range(50):
        run(tracker, [camera(found([[5.0 - 0.05 * step, 0.0]]))])
        assert tracks.history_count[0, 0] == min(step + 1, HISTORY)
    np.testing.assert_allclose(tracks.history[0, 0, :, 0], 5.0 - 0.05 * (50 - HISTORY + np.arange(HISTORY)), atol=0.03)
    np.testing.assert_array_equal(tracks.history[0, 0, -1], tracks.state[0, 0, :2].astype(np.float32))


def test_a_slow_clock_fills_the_history_at_its_own_rate():
    fast, slow = Tracker(1), Tracker(1)
    pose = np.zeros((1, 3))
    for step in range(40):
        fast.update(pose, 0.05, [camera(found([[3.0, 0.02 * step]]))])
    for step in range(7):
        slow.update(pose, 0.3, [camera(found([[3.0, 0.12 * step]]))])
    assert fast.tracks.history_count[0, 0] == 20  # 1.95 s
    assert slow.tracks.history_count[0, 0] == 19  # 1.8 s
    steps = np.diff(slow.tracks.history[0, 0, -8:, 1])
    np.testing.assert_allclose(steps, 0.04, atol=0.015)


def test_worlds_do_not_depend_on_each_other_or_on_the_threads():
    rng = np.random.default_rng(5)
    places = rng.uniform([1.5, -2.0], [5.0, 2.0], (16, 8, 2))
    together, apart = Tracker(16, threads=2), [Tracker(1) for _ in range(16)]
    for _ in range(15):
        places += rng.normal(0, 0.05, places.shape)
        run(together, [camera(found(*places))])
        for b in range(16):
            run(apart[b], [camera(found(places[b]))])
    for name, array in together.tracks._asdict().items():
        np.testing.assert_array_equal(array, np.concatenate([getattr(t.tracks, name) for t in apart]), err_msg=name)


def test_only_marked_worlds_go_on_and_are_forgotten():
    tracker, pose = Tracker(2), np.zeros((2, 3))
    which = np.array([True, False])
    tracker.update(pose, DT, [camera(found([[3.0, 0.0]], [[3.0, 0.0]]))], which)
    assert tracker.tracks.live.sum(axis=1).tolist() == [1, 0]
    tracker.reset(which)
    assert not tracker.tracks.live.any() and not tracker.tracks.confirmed.any()


def test_a_saved_tracker_goes_on_as_if_nothing_had_happened():
    def go_on(tracker: Tracker) -> None:
        for step in range(10, 20):
            run(tracker, [camera(found([[3.0, 0.05 * step], [4.0, -0.05 * step]]))])

    one = Tracker(1)
    for step in range(10):
        run(one, [camera(found([[3.0, 0.05 * step], [4.0, -0.05 * step]]))])
    other = Tracker(1)
    other.load_state_dict(one.state_dict())
    go_on(one)
    go_on(other)
    for name, array in one.state_dict().items():
        np.testing.assert_array_equal(array, other.state_dict()[name], err_msg=name)
    with pytest.raises(ValueError, match="saved worlds"):
        Tracker(2).load_state_dict(one.state_dict())
    older = {name: array for name, array in one.state_dict().items() if name != "watched_s"}
    with pytest.raises(ValueError, match=r"lack is \['watched_s'\]"):
        other.load_state_dict(older)


@settings(max_examples=40, deadline=None)
@given(st.integers(0, 2**32 - 1))
def test_whatever_comes_in_the_tracks_stay_finite_and_their_ids_apart(seed):
    rng = np.random.default_rng(seed)
    tracker, ids = Tracker(2), [set(), set()]
    for _ in range(25):
        detections = allocate_detections(2)
        detections.count[:] = rng.integers(-3, MAX_DETECTIONS + 20, 2)  # too few, too many
        for array in (detections.pos, detections.std_m, detections.body, detections.confidence):
            array[:] = rng.normal(0.0, 3.0, array.shape)
            odd = rng.random(array.shape) < 0.05
            array[odd] = rng.choice([np.nan, np.inf, -np.inf, 1e300, -1e300, 0.0], odd.sum())
        pose = rng.normal(0, 2, 3)
        pose[rng.random(3) < 0.02] = np.nan
        depth = rng.uniform(0, 6, (2, CAMERA.height, CAMERA.width)).astype(np.float32)
        ranges = rng.choice(np.array([np.nan, np.inf, 1.0, 3.0], np.float32), (2, LIDAR.num_rays))
        tracks = run(tracker, [camera(detections, depth), lidar(detections, ranges)], pose)
        for b in range(2):
            live = tracks.live[b]
            assert len(set(tracks.id[b, live].tolist())) == live.sum()
            for array in (tracks.state, tracks.covariance, tracks.body, tracks.existence, tracks.history):
                assert np.isfinite(array[b, live]).all()
            assert (tracks.covariance[b, live, 0] > 0).all()
            assert not (tracks.confirmed[b] & ~live).any()
            born = set(tracks.id[b, live].tolist()) - ids[b]
            assert all(new >= len(ids[b]) and new > max(ids[b], default=-1) for new in born), "an id was used again"
            ids[b] |= born


def test_more_people_than_slots_leave_the_surest():
    tracker = Tracker(1)
    sure = [[2.0 + 0.8 * (k % 8), -1.5 + 0.8 * (k // 8)] for k in range(MAX_TRACKS)]
    for _ in range(5):
        run(tracker, [camera(found(sure))])
        run(tracker, [lidar(found([[20.0, float(k)] for k in range(32)], confidence=0.6), 0.5)])
    assert len(confirmed(tracker)) == MAX_TRACKS


@pytest.mark.parametrize("dt", [-0.1, math.nan, math.inf])
def test_an_impossible_time_step_is_refused(dt):
    with pytest.raises(ValueError, match="dt_s"):
        Tracker(1).update(np.zeros((1, 3)), dt, [])


def test_people_who_never_turn_or_never_walk_on_again_are_refused():
    with pytest.raises(ValueError, match="turns_per_s, steadies_per_s"):
        Tracker(1, settings=TrackerSettings(turns_per_s=0.0))
