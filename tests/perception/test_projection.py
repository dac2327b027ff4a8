"""How bodies appear in the image, against dense clouds of points projected through a pinhole camera."""

from __future__ import annotations

import math

import numpy as np
import pytest

from densecavoid.frames import CameraConfig
from densecavoid.perception.projection import (
    ahead_per_depth,
    body_box,
    body_sides,
    camera_view,
    from_camera,
    image_height,
    rise_per_depth,
)

CAMERAS = {
    "level": CameraConfig(),
    "down": CameraConfig(mount_pitch_rad=0.3, mount_x_m=-0.12, mount_height_m=0.9),
    "up": CameraConfig(mount_pitch_rad=-0.2, mount_x_m=0.1, mount_height_m=0.3),
}
PLACES = [(2.0, 0.0), (3.0, 1.2), (4.5, -2.0), (1.0, 0.4)]
RADIUS, HEIGHT = 0.25, 1.7


def pinhole(camera: CameraConfig, points: np.ndarray) -> np.ndarray:
    """Pixels (u, v) of points (forward, left, up) from the camera in the robot's upright axes, by a rotation matrix."""
    pitch = camera.mount_pitch_rad
    to_camera = np.array([[math.cos(pitch), 0, -math.sin(pitch)], [0, 1, 0], [math.sin(pitch), 0, math.cos(pitch)]])
    depth, left, up = to_camera @ points.reshape(-1, 3).T
    fx, fy = camera.focal_px
    return np.stack([camera.width / 2 - fx * left / depth, camera.height / 2 - fy * up / depth], axis=1)


def cylinder(camera: CameraConfig, forward: float, left: float) -> np.ndarray:
    angle, z = np.meshgrid(np.linspace(0, 2 * math.pi, 1_500), np.linspace(0, HEIGHT, 20))
    x, y = forward + RADIUS * np.cos(angle), left + RADIUS * np.sin(angle)
    return np.stack([x, y, z - camera.mount_height_m], axis=-1)


@pytest.mark.parametrize("camera", CAMERAS.values(), ids=CAMERAS)
@pytest.mark.parametrize("place", PLACES)
def test_sides_touch_the_cylinder_at_every_height(camera, place):
    view = camera_view(camera)
    right, left = body_sides(*place, RADIUS)
    pixels = pinhole(camera, cylinder(camera, *place))
    reach = view.focal_x * np.array([ahead_per_depth(view, v) for v in pixels[:, 1]])
    inside = camera.width / 2 - pixels[:, 0]  # left of the middle
    np.testing.assert_array_less(inside - left * reach, 1e-9)
    np.testing.assert_array_less(right * reach - inside, 1e-9)
    assert (left * reach - inside).min() < 0.01 and (inside - right * reach).min() < 0.01


@pytest.mark.parametrize("camera", CAMERAS.values(), ids=CAMERAS)
@pytest.mark.parametrize("place", PLACES)
def test_top_and_bottom_are_those_of_the_axis(camera, place):
    _, v_min, _, v_max = body_box(*place, RADIUS, HEIGHT, camera_view(camera))
    ends = pinhole(camera, np.array([[*place, z - camera.mount_height_m] for z in (HEIGHT, 0.0)]))
    np.testing.assert_allclose((v_min, v_max), ends[:, 1], atol=1e-9)


@pytest.mark.parametrize("camera", CAMERAS.values(), ids=CAMERAS)
@pytest.mark.parametrize("place", PLACES)
def test_box_bounds_the_rectangle_that_faces_the_camera(camera, place):
    right, left = body_sides(*place, RADIUS)
    corners = [
        [place[0], slope * place[0], z - camera.mount_height_m] for slope in (right, left) for z in (0.0, HEIGHT)
    ]
    pixels = pinhole(camera, np.array(corners))
    box = body_box(*place, RADIUS, HEIGHT, camera_view(camera))
    np.testing.assert_allclose(box, [*pixels.min(axis=0), *pixels.max(axis=0)], atol=1e-9)


@pytest.mark.parametrize("camera", CAMERAS.values(), ids=CAMERAS)
def test_rays_of_a_row_rise_as_its_image_height_says(camera):
    view = camera_view(camera)
    for v in (0.5, 17.0, 59.5):
        slope = rise_per_depth(view, v) / ahead_per_depth(view, v)
        assert image_height(view, slope) == pytest.approx(v, abs=1e-9)
        assert pinhole(camera, np.array([1.0, 0.0, slope]))[0, 1] == pytest.approx(v, abs=1e-9)


def test_nobody_behind_or_on_the_camera_has_a_box():
    for place in ((-2.0, 0.0), (0.2, 0.0), (0.1, 3.0)):
        for camera in CAMERAS.values():
            u_min, _, u_max, _ = body_box(*place, RADIUS, HEIGHT, camera_view(camera))
            assert u_max < u_min


def test_what_a_steep_camera_has_behind_it_is_not_seen_upside_down():
    view = camera_view(CameraConfig(mount_pitch_rad=1.0, mount_height_m=0.5))
    _, top, _, bottom = body_box(0.5, 0.0, 0.2, 1.9, view)  # the head is behind the image plane
    assert top < -view.rows < bottom


def test_places_are_taken_from_where_the_camera_is():
    view = camera_view(CAMERAS["up"])
    forward, left = from_camera(view, np.array([1.0, 2.0, math.pi / 2]), 0.5, 5.0)
    assert (forward, left) == pytest.approx((2.9, 0.5))
