"""The prediction frame: dark on white where people are expected in the camera image (paper, Fig. 2b).

The image is the one the camera will have then: the robot moves on along its arc. A pixel is taken when its ray meets a
person's upright rectangle (`projection`): in a level camera people are black boxes, as in the paper.

Several horizons share one frame: each is drawn as the camera will stand at its own time, the nearest black and later
ones ever lighter, and of two that meet in a pixel the darker one, which comes first, stays.

The soft form does not draw where people are expected but how likely: 255 less 255 times the probability that anybody
takes the pixel, from the positions' covariances. Without uncertainty it is the hard form.
"""

from __future__ import annotations

import math
from typing import NamedTuple

import numpy as np

from densecavoid.perception.projection import (
    MIN_DEPTH_M,
    ahead_per_depth,
    body_rows,
    body_sides,
    from_camera,
    pixel_span,
    rise_per_depth,
)
from densecavoid.sim._jit import inner, kernel
from densecavoid.sim.robot import drive

FREE = np.uint8(255)
_LEAST_STD_M = 1e-6
_NEVER_STD = 4.0  # this many standard deviations off is as good as never: a 30,000th


class Expected(NamedTuple):
    """Where people are expected at each horizon, those of all worlds one after another."""

    pos: np.ndarray  # f64 [N, H, 2] x, y in the odometry frame, m
    covariance: np.ndarray  # f64 [N, H, 3] of x, of x and y, of y, m2
    body: np.ndarray  # f64 [N, 2] radius, height, m
    first: np.ndarray  # i64 [B + 1]: those of world b are first[b] to first[b + 1] (excluded)


def shades(horizons: int) -> np.ndarray:
    """Brightness of each horizon, u8 [H]: the first is black, the others are even steps towards white."""
    return (255 * np.arange(horizons) // horizons).astype(np.uint8)


@inner
def _shade_body(image, forward, left, radius, height, view, shade):
    """Writes `shade` where one body is."""
    right_side, left_side = body_sides(forward, left, radius)
    if left_side < right_side:
        return
    v_min, v_max = body_rows(forward, height, view)
    top, bottom = pixel_span(v_min, v_max, view.rows)
    for v in range(top, bottom):
        reach = view.focal_x * ahead_per_depth(view, v + 0.5)
        first, last = pixel_span(
            0.5 * view.width - reach * left_side, 0.5 * view.width - reach * right_side, view.width
        )
        for u in range(first, last):
            image[v, u] = shade


@inner
def _below(value, mean, std):
    """Probability that a Gaussian is below `value`."""
    off = (value - mean) / std
    if off > _NEVER_STD:
        return 1.0
    return 0.5 * math.erfc(-0.7071067811865476 * off) if off > -_NEVER_STD else 0.0


@inner
def _taken_rows(rows, forward, std, height, view):
    """Probability for each row that the body is so far ahead that its rays pass neither over nor under it."""
    over, under = height - view.height_m, view.height_m
    for v in range(view.rows):
        rise = rise_per_depth(view, v + 0.5) / ahead_per_depth(view, v + 0.5)
        nearest, farthest = MIN_DEPTH_M, np.inf if over >= 0.0 else 0.0
        if rise > 0.0:
            farthest = over / rise
        elif rise < 0.0:
            nearest, farthest = max(MIN_DEPTH_M, over / rise), under / -rise
        rows[v] = max(0.0, _below(farthest, forward, std) - _below(nearest, forward, std))


@inner
def _taken_columns(columns, forward, left, variance, radius, reach, view):
    """Probability for each column of a row that the vertical plane of its rays comes within `radius` of the axis."""
    for u in range(view.width):
        slope = (0.5 * view.width - (u + 0.5)) / reach
        per_m = 1.0 / math.sqrt(1.0 + slope * slope)
        aside = (left - slope * forward) * per_m
        spread = (variance[2] - 2.0 * slope * variance[1] + slope * slope * variance[0]) * per_m * per_m
        std = max(math.sqrt(max(spread, 0.0)), _LEAST_STD_M)
        if abs(aside) - radius > _NEVER_STD * std:
            columns[u] = 0.0
        else:
            columns[u] = _below(radius, aside, std) - _below(-radius, aside, std)


@inner
def _free_of_body(free, rows, columns, forward, left, variance, radius, height, view):
    """Multiplies `free` [height, width] by the probability that one body leaves each pixel free.

    Row and column are taken as independent: one depends on how far the body is, the other on how far aside. Beside
    dice the brightness then errs by .003 (standard deviations of .2 m) to .014 (.45 m) on average, and by .13 at worst.
    """
    std = max(math.sqrt(variance[0]), _LEAST_STD_M)
    if forward + _NEVER_STD * std < MIN_DEPTH_M:
        return
    _taken_rows(rows, forward, std, height, view)
    for v in range(view.rows):
        if v == 0 or view.sin_pitch != 0.0:  # a level camera's rows are alike
            reach = view.focal_x * ahead_per_depth(view, v + 0.5)
            _taken_columns(columns, forward, left, variance, radius, reach, view)
        if rows[v] > 0.0:
            for u in range(view.width):
                free[v, u] *= 1.0 - rows[v] * columns[u]


@inner
def _turned(covariance, yaw, variance):
    """The covariance (x, xy, y) in axes that are turned by `yaw`."""
    cos, sin = math.cos(yaw), math.sin(yaw)
    xx, xy, yy = covariance[0], covariance[1], covariance[2]
    variance[0] = cos * cos * xx + 2.0 * cos * sin * xy + sin * sin * yy
    variance[1] = cos * sin * (yy - xx) + (cos * cos - sin * sin) * xy
    variance[2] = sin * sin * xx - 2.0 * cos * sin * xy + cos * cos * yy


@kernel
def draw_prediction(image, expected, b, pose, linear, angular, horizons_s, shade, view, soft):
    """Fills `image` [height, width] for world b.

    Args:
        expected: an `Expected`, at the times `horizons_s` [H] from now.
        pose: x, y, yaw of the robot in the odometry frame, now.
        linear, angular: the robot's velocity (m/s, rad/s), which it keeps.
        shade: brightness of each horizon, as `shades`.
        view: a `CameraView`.
        soft: whether uncertainty is drawn.
    """
    for v in range(view.rows):
        for u in range(view.width):
            image[v, u] = FREE
    then, variance = np.empty(3), np.empty(3)
    free = np.empty((view.rows if soft else 0, view.width))
    rows, columns = np.empty(view.rows), np.empty(view.width)
    for k in range(horizons_s.shape[0] - 1, -1, -1):  # what comes first is painted last, over the rest
        for axis in range(3):
            then[axis] = pose[axis]
        drive(then, linear, angular, horizons_s[k])
        for v in range(free.shape[0]):
            for u in range(view.width):
                free[v, u] = 1.0
        for n in range(expected.first[b], expected.first[b + 1]):
            forward, left = from_camera(view, then, expected.pos[n, k, 0], expected.pos[n, k, 1])
            radius, height = expected.body[n, 0], expected.body[n, 1]
            if soft:
                _turned(expected.covariance[n, k], then[2], variance)
                _free_of_body(free, rows, columns, forward, left, variance, radius, height, view)
            else:
                _shade_body(image, forward, left, radius, height, view, shade[k])
        darkness = 255.0 - shade[k]
        for v in range(free.shape[0]):
            for u in range(view.width):
                image[v, u] = min(image[v, u], np.uint8(255.5 - darkness * (1.0 - free[v, u])))
