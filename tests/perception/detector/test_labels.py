"""Labels of people: boxes against corners projected with matrices, visible shares of scenes that are known."""

from __future__ import annotations

import dataclasses
import math

import numpy as np
import pytest
from standing import view_of

from densecavoid.frames import CameraConfig
from densecavoid.perception.detections import MAX_DETECTIONS
from densecavoid.perception.detector.encoding import encode_images
from densecavoid.perception.detector.labels import person_box
from densecavoid.perception.detector.views import ViewsConfig, take_views
from densecavoid.perception.detector.worlds import (
    PeopleAmongThings,
    held_out_rooms,
    held_out_worlds,
    training_rooms,
    training_worlds,
)
from densecavoid.perception.projection import body_box, camera_view
from densecavoid.sim.floorplan import FloorPlan

CAMERA = CameraConfig()


def test_a_level_cameras_box_is_the_prediction_frames():
    rng = np.random.default_rng(0)
    for _ in range(200):
        forward, left = rng.uniform(-1, 6), rng.uniform(-3, 3)
        radius, height = rng.uniform(0.2, 0.33), rng.uniform(1.5, 1.9)
        expected = body_box(forward, left, radius, height, camera_view(CAMERA))
        found = person_box(forward, left, radius, height, camera_view(CAMERA))
        np.testing.assert_allclose(found, expected, atol=1e-9)


@pytest.mark.parametrize("pitch", [-0.15, 0.1])
def test_a_pitched_cameras_box_holds_the_body_projected_by_a_matrix(pitch):
    radius, height, mount = 0.25, 1.7, 0.5
    focal_x, focal_y = CAMERA.focal_px
    # Rows: the camera's forward, left and up axes in the robot's frame; positive pitch looks down.
    axes = np.array([[math.cos(pitch), 0, -math.sin(pitch)], [0, 1, 0], [math.sin(pitch), 0, math.cos(pitch)]])
    for forward, left in ((3.0, 0.4), (2.0, -0.8), (4.5, 1.5)):
        angle = np.linspace(0, 2 * np.pi, 721)
        ring = forward + radius * np.cos(angle), left + radius * np.sin(angle)

        def pixels(x, y, z, axes=axes):
            depth, aside, up = axes @ np.stack([x, y, np.full_like(x, z - mount)])
            return 40 - focal_x * aside / depth, 30 - focal_y * up / depth

        columns = np.concatenate([pixels(*ring, z)[0] for z in (0.0, height)])
        foot, top = (float(pixels(np.array([forward]), np.array([left]), z)[1][0]) for z in (0.0, height))
        expected = columns.min(), top, columns.max(), foot
        camera = dataclasses.replace(CAMERA, mount_height_m=mount, mount_pitch_rad=pitch)
        found = person_box(forward, left, radius, height, camera_view(camera))
        np.testing.assert_allclose(found, expected, atol=0.05)


def only(views):
    assert views.num_people[0] == 1
    return views.box[0, 0], float(views.share[0, 0]), views.place[0, 0]


def test_somebody_alone_is_seen_whole():
    box, share, place = only(view_of([(3.0, 0.4)]))
    np.testing.assert_allclose(box, body_box(3.0, 0.4, 0.25, 1.7, camera_view(CAMERA)), atol=1e-3)
    np.testing.assert_allclose(place, [3.0, 0.4], atol=1e-6)
    assert share > 0.97


def test_near_people_reach_beyond_the_image_and_are_seen_whole_all_the_same():
    box, share, _ = only(view_of([(2.0, 0.0)]))
    assert box[1] == 0.0 and share > 0.97


def test_half_behind_a_box_half_is_seen():
    plan = FloorPlan()
    plan.box(2.0, 0.5, 0.1, 1.0, z_max=2.5)  # from y = 0 to the left
    _, share, _ = only(view_of([(3.0, 0.0)], plan))
    assert share == pytest.approx(0.5, abs=0.06)


def test_half_out_of_the_image_half_is_seen_and_the_box_is_cut():
    edge = 3.0 * math.tan(CAMERA.fov_horizontal_rad / 2)
    box, share, _ = only(view_of([(3.0, -edge)]))
    assert share == pytest.approx(0.5, abs=0.1)
    assert box[2] == 80.0 and box[0] > 70


@pytest.mark.parametrize("place", [(6.0, 0.0), (-2.0, 0.0), (1.0, 2.0), (0.9, 0.0)])
def test_beyond_the_cameras_range_or_view_nobody_is_labelled(place):
    assert view_of([place]).num_people[0] == 0


def test_a_camera_ahead_of_the_centre_and_looking_down_labels_the_place_from_the_robots_centre():
    camera = dataclasses.replace(CAMERA, mount_x_m=0.2, mount_height_m=0.6, mount_pitch_rad=0.1)
    box, share, place = only(view_of([(3.2, 0.0)], camera=camera))
    np.testing.assert_allclose(place, [3.2, 0.0], atol=1e-6)
    u_min, v_min, u_max, v_max = person_box(3.0, 0.0, 0.25, 1.7, camera_view(camera))
    np.testing.assert_allclose(box, [u_min, max(v_min, 0.0), u_max, v_max], atol=1e-3)
    assert share > 0.97


def test_views_are_the_same_for_the_same_seed_and_hold_people_of_all_kinds():
    config = ViewsConfig(images_a_world=2, worlds_at_once=8)
    views, again = (take_views(training_worlds(), 30, 5, config) for _ in range(2))
    for a, b in zip(views, again, strict=True):
        np.testing.assert_array_equal(a, b)
    assert not np.array_equal(take_views(training_worlds(), 30, 6, config).depth_mm, views.depth_mm)
    assert len(np.unique(views.mount[:, 1])) > 1
    present = np.arange(MAX_DETECTIONS) < views.num_people[:, None]
    share, box = views.share[present], views.box[present]
    assert len(share) > 10 and share.min() > 0 and share.max() <= 1
    assert (box >= 0).all() and (box[:, 2] <= 80).all() and (box[:, 3] <= 60).all()
    assert (box[:, 2:] > box[:, :2]).all()


def test_images_without_anybody_can_be_left_out():
    config = ViewsConfig(images_a_world=2, worlds_at_once=8, keep_empty=0.01)
    assert (take_views(PeopleAmongThings(), 20, 1, config).num_people > 0).mean() > 0.8


def test_no_held_out_scenario_is_trained_on():
    trained = set(training_worlds().name.split("+")) | {training_rooms().name}
    assert trained.isdisjoint(held_out_worlds().name.split("+"))
    assert held_out_rooms().name not in trained


def test_the_encoding_says_how_near_whether_and_how_high():
    depth = np.full((1, 60, 80), np.nan, np.float32)
    depth[0, 10, 5], depth[0, 50, 70], depth[0, 20, 0], depth[0, 21, 0] = 1.4, 5.0, 1.39, 5.01
    pitch, mount = 0.1, 0.5
    images = encode_images(depth, np.array([[0.0, mount, pitch]]), CAMERA)
    assert images.shape == (1, 3, 64, 80)
    near, there, high = images[0]
    assert np.flatnonzero(there).tolist() == [12 * 80 + 5, 52 * 80 + 70]
    assert near[12, 5] == pytest.approx(1.0) and near[52, 70] == pytest.approx(0.0, abs=1e-6)
    for row, d in ((10, 1.4), (50, 5.0)):
        up = (30 - (row + 0.5)) / CAMERA.focal_px[1]
        expected = (mount + d * (up * math.cos(pitch) - math.sin(pitch))) / 2.0
        assert high[row + 2, 5 if row == 10 else 70] == pytest.approx(expected, abs=1e-5)
    assert (images[:, :, ~(there > 0)] == 0).all()
