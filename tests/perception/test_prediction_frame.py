"""The prediction frame, hard and soft, at one and at several horizons, against rays and dice of its own."""

from __future__ import annotations

import dataclasses
import math

import numpy as np
import pytest

from densecavoid.frames import CameraConfig
from densecavoid.perception.prediction_frame import Expected, draw_prediction, shades
from densecavoid.perception.projection import MIN_DEPTH_M, camera_view

CAMERAS = {
    "level": CameraConfig(),
    "down": CameraConfig(mount_pitch_rad=0.25, mount_x_m=0.1, mount_height_m=0.8),
    "up": CameraConfig(mount_pitch_rad=-0.2, mount_x_m=-0.1),
}
PEOPLE = [  # x, y, radius, height
    (3.0, 0.5, 0.25, 1.7),
    (2.0, -0.9, 0.30, 1.9),
    (4.2, 0.8, 0.20, 1.5),
    (1.1, 0.3, 0.25, 0.3),
    (-2.0, 0.0, 0.25, 1.7),
]
POSE = np.array([0.2, -0.1, 0.1])
NOW = np.zeros(1)


def expecting(people, horizons=1, covariance=(0.0, 0.0, 0.0)):
    """The people in the second of three worlds, others in the first and in the third."""
    rows = np.array([(1.5, 0.0, 0.3, 1.7), *people, (1.5, 0.0, 0.3, 1.7)])
    return Expected(
        pos=np.repeat(rows[:, None, :2], horizons, axis=1),
        covariance=np.tile(covariance, (len(rows), horizons, 1)),
        body=rows[:, 2:].copy(),
        first=np.array([0, 1, 1 + len(people), 2 + len(people)]),
    )


def draw(expected, camera, pose=POSE, command=(0.0, 0.0), horizons=NOW, soft=False):
    image = np.full((camera.height, camera.width), 77, np.uint8)
    shade = shades(len(horizons))
    draw_prediction(image, expected, 1, pose, *command, horizons, shade, camera_view(camera), soft)
    return image


def rays(camera):
    """Of each pixel: forward, left, up in the robot's upright axes, scaled to forward 1."""
    left, up = np.meshgrid(camera.column_slopes, camera.row_slopes)
    pitch = camera.mount_pitch_rad
    forward, up = math.cos(pitch) + up * math.sin(pitch), up * math.cos(pitch) - math.sin(pitch)
    return left / forward, up / forward


def meets(camera, pose, x, y, radius, height):
    """Pixels whose rays come within `radius` of the axis at (x, y), no higher there than the body."""
    slope, rise = rays(camera)
    off_x, off_y = x - pose[0], y - pose[1]
    forward = math.cos(pose[2]) * off_x + math.sin(pose[2]) * off_y - camera.mount_x_m
    left = math.cos(pose[2]) * off_y - math.sin(pose[2]) * off_x
    aside = np.abs(left - slope * forward) / np.sqrt(1 + slope**2)
    z = camera.mount_height_m + rise * forward
    return (forward >= MIN_DEPTH_M) & (aside <= radius) & (z >= 0) & (z <= height)


@pytest.mark.parametrize("camera", CAMERAS.values(), ids=CAMERAS)
def test_black_exactly_where_a_ray_meets_somebody(camera):
    taken = np.any([meets(camera, POSE, *person) for person in PEOPLE], axis=0)
    assert 300 < taken.sum() < 3000
    np.testing.assert_array_equal(draw(expecting(PEOPLE), camera), np.where(taken, 0, 255))


def test_camera_stands_where_the_robot_will_have_driven():
    command, horizon = (1.0, 0.4), 0.4
    # by hand: an arc of radius v / w = 2.5 m, turned by .16 rad
    pose = np.array([2.5 * math.sin(0.16), 2.5 * (1 - math.cos(0.16)), 0.16])
    camera = CAMERAS["level"]
    image = draw(expecting(PEOPLE), camera, np.zeros(3), command, np.array([horizon]))
    taken = np.any([meets(camera, pose, *person) for person in PEOPLE], axis=0)
    np.testing.assert_array_equal(image, np.where(taken, 0, 255))


def test_several_horizons_get_lighter_and_the_first_stays_in_front():
    camera, horizons = CAMERAS["level"], np.array([0.1, 0.4, 1.2])
    expected = expecting([PEOPLE[0]], horizons=3)
    for k in range(3):
        expected.pos[1, k] = 3.0, 0.5 - 0.2 * k
    image = draw(expected, camera, horizons=horizons, command=(0.5, 0.0))
    wanted = np.full(image.shape, 255)
    for k, shade in ((2, 170), (1, 85), (0, 0)):
        pose = POSE + 0.5 * horizons[k] * np.array([math.cos(POSE[2]), math.sin(POSE[2]), 0.0])
        wanted[meets(camera, pose, 3.0, 0.5 - 0.2 * k, 0.25, 1.7)] = shade
    assert len(np.unique(wanted)) == 4
    np.testing.assert_array_equal(image, wanted)


@pytest.mark.parametrize("camera", CAMERAS.values(), ids=CAMERAS)
def test_soft_form_without_uncertainty_is_the_hard_form(camera):
    expected = expecting(PEOPLE, horizons=2)
    horizons = np.array([0.1, 0.9])
    hard, soft = (draw(expected, camera, command=(0.3, 0.2), horizons=horizons, soft=soft) for soft in (False, True))
    np.testing.assert_array_equal(hard, soft)


def share_free(camera, people, covariance, throws=1500):
    """Share of dice for which nobody takes a pixel, people taken one by one."""
    rng = np.random.default_rng(0)
    spread = np.linalg.cholesky([[covariance[0], covariance[1]], [covariance[1], covariance[2]]])
    free = np.ones((camera.height, camera.width))
    for x, y, radius, height in people:
        dice = np.array([x, y]) + rng.standard_normal((throws, 2)) @ spread.T
        free *= 1 - np.mean([meets(camera, POSE, die[0], die[1], radius, height) for die in dice], axis=0)
    return free


def test_soft_form_is_the_probability_that_nobody_takes_the_pixel():
    camera, covariance = CameraConfig(width=40, height=30), (0.09, 0.0, 0.04)
    ahead = [(POSE[0] + 3.0, POSE[1], 0.25, 1.7)]
    expected = expecting(ahead, covariance=covariance)
    image = draw(expected, camera, pose=np.array([*POSE[:2], 0.0]), soft=True) / 255.0
    turned = np.array([*POSE[:2], math.pi / 2])  # and the same seen by a robot that has turned, and the world with it
    expected.pos[1, 0] = POSE[0], POSE[1] + 3.0
    expected.covariance[1, 0] = covariance[::-1]
    np.testing.assert_array_equal(draw(expected, camera, pose=turned, soft=True) / 255.0, image)
    rng, slope, rise = np.random.default_rng(0), *rays(camera)
    forward = 3.0 + 0.3 * rng.standard_normal((1500, 1, 1))
    aside = np.abs(0.2 * rng.standard_normal((1500, 1, 1)) - slope * forward) / np.sqrt(1 + slope**2)
    z = camera.mount_height_m + rise * forward
    taken = np.mean((forward >= MIN_DEPTH_M) & (aside <= 0.25) & (z >= 0) & (z <= 1.7), axis=0)
    assert taken.max() > 0.5 and np.abs(image - (1 - taken)).max() < 0.05  # dice err by .013


@pytest.mark.parametrize("camera", ["level", "down"])
@pytest.mark.parametrize("covariance", [(0.04, 0.0, 0.01), (0.2, -0.1, 0.1)])
def test_soft_form_errs_little_by_taking_row_and_column_as_independent(camera, covariance):
    camera = dataclasses.replace(CAMERAS[camera], width=40, height=30)
    free = share_free(camera, PEOPLE[:3], covariance)
    image = draw(expecting(PEOPLE[:3], covariance=covariance), camera, soft=True) / 255.0
    assert np.abs(image - free).mean() < 0.02 and np.abs(image - free).max() < 0.15
    assert free.min() < 0.6
