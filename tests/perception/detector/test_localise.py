"""From boxes to places: true boxes of people who stand where a test put them, alone, half hidden, and at the edge."""

from __future__ import annotations

import dataclasses
import math

import numpy as np
import pytest
from standing import view_of

from densecavoid.frames import CameraConfig
from densecavoid.perception.detections import Detections
from densecavoid.perception.detector.card import PlaceError
from densecavoid.perception.detector.decode import Boxes
from densecavoid.perception.detector.localise import localise
from densecavoid.sim.floorplan import FloorPlan

CAMERA = CameraConfig()


def place_of(views, camera=CAMERA, pose=(0.0, 0.0, 0.0), error=None) -> Detections:
    count = views.num_people[0]
    boxes = Boxes(views.box[0, :count], np.full(count, 0.9, np.float32), np.zeros(count, np.int32))
    return localise(boxes, views.depth_m[0], camera, error or PlaceError(), np.array(pose))


@pytest.mark.parametrize("place", [(2.0, 0.0), (3.0, 0.8), (4.0, -1.5), (4.7, 0.3)])
@pytest.mark.parametrize("sensors", ["clean", "real"])
def test_somebody_in_full_view_is_placed_within_seven_centimetres(place, sensors):
    found = place_of(view_of([place], sensors=sensors))
    assert found.count.tolist() == [1]
    np.testing.assert_allclose(found.pos[0, 0], place, atol=0.07)
    assert found.body[0, 0, 0] == pytest.approx(0.25, abs=0.02)


def test_height_is_told_where_the_head_is_in_the_image():
    assert place_of(view_of([(4.0, 0.0)])).body[0, 0, 1] == pytest.approx(1.7, abs=0.05)
    assert np.isnan(place_of(view_of([(2.0, 0.0)])).body[0, 0, 1])


def test_a_mount_ahead_and_a_pitch_change_nothing():
    camera = dataclasses.replace(CAMERA, mount_x_m=0.2, mount_height_m=0.7, mount_pitch_rad=0.12)
    found = place_of(view_of([(3.5, 0.5)], camera=camera), camera)
    np.testing.assert_allclose(found.pos[0, 0], [3.5, 0.5], atol=0.07)


def test_whoever_stands_before_or_behind_is_not_taken_for_the_person():
    plan = FloorPlan()
    plan.box(4.8, 0.0, 0.1, 4.0, z_max=2.4)  # a wall behind
    plan.box(2.0, 0.25, 0.1, 0.5, z_max=2.4)  # half of the person is behind this
    found = place_of(view_of([(3.2, 0.0)], plan))
    np.testing.assert_allclose(found.pos[0, 0], [3.2, 0.0], atol=0.15)


def test_two_who_overlap_each_get_their_own_distance():
    views = view_of([(2.0, 0.0), (3.5, 0.35)])
    found = place_of(views)
    order = np.argsort(found.pos[0, :2, 0])
    np.testing.assert_allclose(found.pos[0, order], [[2.0, 0.0], [3.5, 0.35]], atol=0.12)


def test_cut_by_the_images_side_the_side_in_view_tells():
    edge = 3.0 * math.tan(CAMERA.fov_horizontal_rad / 2)
    for sign in (1.0, -1.0):
        found = place_of(view_of([(3.0, sign * (edge + 0.05))]))
        np.testing.assert_allclose(found.pos[0, 0], [3.0, sign * (edge + 0.05)], atol=0.12)
        assert np.isnan(found.body[0, 0, 0])


def test_places_are_in_the_odometry_frame():
    views = view_of([(3.0, 0.5)])
    here, there = place_of(views), place_of(views, pose=(1.0, 2.0, math.pi / 2))
    forward, left = here.pos[0, 0]
    np.testing.assert_allclose(there.pos[0, 0], [1.0 - left, 2.0 + forward], atol=1e-9)


def test_claimed_errors_are_the_roots_of_their_terms():
    views = view_of([(3.0, 0.0)])
    distance = np.hypot(*place_of(views).pos[0, 0])
    nothing = PlaceError(0.0, 0.0, 0.0, 0.0, 0.0)
    for change, expected in (
        ({"floor_m": 0.3}, 0.3),
        ({"per_m2": 0.01}, 0.01 * distance**2),
        ({"unsure_m": 2.0}, 2.0 * (1 - np.float32(0.9))),
        ({"cut_m": 1.0}, 0.0),
        ({"floor_m": 0.3, "unsure_m": 4.0}, 0.5),
    ):
        found = place_of(views, error=dataclasses.replace(nothing, **change))
        assert found.std_m[0, 0] == pytest.approx(expected, abs=1e-6)
    hidden = dataclasses.replace(nothing, hidden_m=1.0)
    plan = FloorPlan()
    plan.box(2.0, 0.35, 0.1, 0.7, z_max=2.5)
    assert place_of(view_of([(3.0, 0.0)], plan), error=hidden).std_m[0, 0] > place_of(views, error=hidden).std_m[0, 0]


def test_a_box_without_any_depth_still_gets_a_place():
    views = view_of([(3.0, 0.0)])
    nothing = np.full_like(views.depth_mm, 0)
    found = place_of(views._replace(depth_mm=nothing))
    assert np.isfinite(found.pos[0, 0]).all() and 2.0 < found.pos[0, 0, 0] < 4.5
