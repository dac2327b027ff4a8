"""The robot's senses as pictures: right way round, right colours."""

from __future__ import annotations

import numpy as np

from densecavoid.frames import CameraConfig, LidarConfig
from densecavoid.viz import theme
from densecavoid.viz.panels import LidarPicture, depth_picture, prediction_picture


def test_depth_is_brighter_where_nearer_and_grey_where_unknown():
    depth = np.full((60, 80), np.nan, np.float32)
    depth[:, :20], depth[:, 20:40] = 1.5, 4.8
    picture = np.asarray(depth_picture(depth, CameraConfig(), (160, 120))).astype(int)
    near, far, unknown = picture[60, 20], picture[60, 60], picture[60, 120]
    assert near.sum() > far.sum() + 150
    assert tuple(unknown) == theme.NO_DEPTH


def test_prediction_keeps_its_pixels_black_on_white():
    prediction = np.full((60, 80), 255, np.uint8)
    prediction[10:30, 40:60] = 0
    picture = np.asarray(prediction_picture(prediction, (200, 150)).convert("L"))
    assert picture.shape == (150, 200)
    assert (picture[30:70, 105:145] == 0).all()
    assert picture[5, 5] == 255
    assert abs((picture == 0).mean() - 20 * 20 / (60 * 80)) < 0.01


def test_what_is_left_of_the_robot_is_left_on_the_picture_and_ahead_is_up():
    lidar = LidarConfig()
    scan = np.full(512, np.inf, np.float32)
    scan[np.abs(lidar.angles_rad - np.pi / 2).argmin()] = 2.0
    scan[np.abs(lidar.angles_rad).argmin()] = 3.0
    picture = np.asarray(LidarPicture(lidar, (240, 180)).draw(scan)).astype(int)

    def centre_of(colour: theme.Colour) -> np.ndarray:
        return np.argwhere(np.abs(picture - colour).sum(axis=-1) < 40)

    robot = centre_of(theme.ROBOT).mean(axis=0)
    hits = centre_of(theme.LIDAR)
    left = hits[hits[:, 1] < robot[1] - 10].mean(axis=0)
    ahead = hits[hits[:, 1] >= robot[1] - 10].mean(axis=0)
    metre = (robot[1] - left[1]) / 2
    assert abs(left[0] - robot[0]) < 2
    assert abs(ahead[1] - robot[1]) < 2
    assert abs((robot[0] - ahead[0]) / 3 - metre) < 1.5
