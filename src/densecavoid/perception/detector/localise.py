"""From boxes in a depth image to places on the ground: which depth is the person's, and where their axis stands."""

from __future__ import annotations

import math

import numpy as np

from densecavoid.frames import CameraConfig
from densecavoid.perception.detections import Detections, allocate_detections
from densecavoid.perception.detector.card import PlaceError
from densecavoid.perception.detector.decode import Boxes
from densecavoid.perception.projection import ahead_per_depth, camera_view, rise_per_depth
from densecavoid.sim._jit import kernel

ADULT_RADIUS_M, ADULT_HEIGHT_M = 0.255, 1.71
"""Means (FACTS, Crowds), where a box does not tell."""
_SURFACE_TO_AXIS_M = 0.09
"""From the middle of what is seen of a body to its axis; measured in simulated worlds."""
_BODY_TRUST = 0.5
"""Of what a box says about a body's size, against the mean of adults: the least-squares share in simulated worlds."""
_CUT_PX = 1.0  # a box that ends so near the image's edge may go on beyond it
_MIDDLE = 0.7  # share of the box's width whose depths count fully; beyond it are arms and the gaps beside them
_BESIDE_WEIGHT = 0.3  # of depths to either side of it: all that is seen of somebody half hidden
_FARTHEST_OFF = 3.0  # a surface this many standard deviations from where it is expected is somebody else's
_GROUND_M = 0.15  # what is lower may be ground
_BIN_M = 0.1
_NUM_BINS = 128
_BODY_DEPTH_M = 0.35  # what lies so far from the middle of a body's surface, and in its box, is its too
_SPREAD_BINS = 2  # a body's surface lies within so many bins of its middle
_HEAD_ROOM_PX = 3.0  # heads so near the image's upper edge may be cut by it
# How well a box's edges tell the distance: standard deviations of its logarithm by width, by height, of the whole at
# least, and of an edge (px); measured in training worlds.
_WIDTH_LOG_STD, _HEIGHT_LOG_STD, _LEAST_LOG_STD, _EDGE_STD_PX = 0.09, 0.05, 0.05, 0.6
_WIDER = 1.04  # boxes of the network than the bodies in them


@kernel
def _expected_distance(box, cut_left, cut_right, view, low, high):
    """Distance ahead of the camera (m) that a box's width, foot and head agree on, and its logarithm's deviation."""
    weight = 1.0 / 0.5**2  # somewhere between the camera's ranges
    total = weight * math.log(math.sqrt(low * high))
    if not cut_left and not cut_right:
        share = 1.0 / _WIDTH_LOG_STD**2
        weight += share
        total += share * math.log(2.0 * _WIDER * ADULT_RADIUS_M * view.focal_x / max(box[2] - box[0], 1.0))
    for foot in range(2):
        v = box[3] if foot else box[1]
        if v < _HEAD_ROOM_PX or v > view.rows - _CUT_PX:
            continue
        rise, ahead = rise_per_depth(view, v), ahead_per_depth(view, v)
        level = -view.height_m if foot else ADULT_HEIGHT_M - view.height_m
        if rise * level <= 0.0 or abs(rise) < 1e-3:
            continue
        size_std = 0.0 if foot else _HEIGHT_LOG_STD
        deviation = math.hypot(size_std, _EDGE_STD_PX / (abs(rise) * view.focal_y))
        share = 1.0 / deviation**2
        weight += share
        total += share * math.log(level / rise * ahead)
    return math.exp(total / weight), 1.0 / math.sqrt(weight)


@kernel
def _surface_distance(depth, taken, box, view, expected, deviation):
    """Distance ahead of the camera (m) of the surface that fills the box about where it is expected.

    Of the distances in the box the densest cluster is taken, weighted by how well it agrees with the expectation, so
    that neither who stands before the person nor the wall behind is taken for them. `taken` marks the pixels of surer
    boxes' people, which do not count; this one's are added to it.

    Returns:
        The distance, the share of the box that shows it, and 0; where nothing near the expectation has a depth, the
        distance expected of the surface, 0, and the expectation's standard deviation (m).
    """
    rows, width = depth.shape
    middle, half = 0.5 * (box[0] + box[2]), 0.5 * _MIDDLE * (box[2] - box[0])
    first, last = max(0, int(box[0])), min(width, math.ceil(box[2]))
    top, bottom = max(0, int(box[1])), min(rows, math.ceil(box[3]))
    count, total = np.zeros(_NUM_BINS), np.zeros(_NUM_BINS)
    whole = 0.0
    for r in range(top, bottom):
        rise, ahead = rise_per_depth(view, r + 0.5), ahead_per_depth(view, r + 0.5)
        for c in range(first, last):
            weight = 1.0 if abs(c + 0.5 - middle) <= half else _BESIDE_WEIGHT
            whole += weight
            d = depth[r, c]
            if taken[r, c] or not d > 0.0 or view.height_m + d * rise < _GROUND_M:
                continue
            k = int(d * ahead / _BIN_M)
            if k < _NUM_BINS:
                count[k] += weight
                total[k] += weight * d * ahead
    spread = math.hypot(deviation, _LEAST_LOG_STD)
    best, found, seen = 0.0, expected - _SURFACE_TO_AXIS_M, 0.0
    for k in range(_NUM_BINS):
        near, sum_near = 0.0, 0.0
        for j in range(max(0, k - _SPREAD_BINS), min(_NUM_BINS, k + _SPREAD_BINS + 1)):
            near += count[j]
            sum_near += total[j]
        if near == 0.0:
            continue
        off = math.log(max(sum_near / near + _SURFACE_TO_AXIS_M, 1e-3) / expected) / spread
        score = near * math.exp(-0.5 * off * off)
        if abs(off) < _FARTHEST_OFF and score > best:
            best, found, seen = score, sum_near / near, near
    for r in range(top, bottom):
        ahead = ahead_per_depth(view, r + 0.5)
        for c in range(first, last):
            taken[r, c] |= abs(depth[r, c] * ahead - found) < _BODY_DEPTH_M
    return found, seen / max(whole, 1.0), 0.0 if seen > 0.0 else deviation * expected


@kernel
def place_boxes(boxes, depth, view, low, high, place, body, shown, guess, cut):
    """Fills, for boxes [N, 4], surest first, of one depth image [rows, width] in m (NaN: none):

    place [N, 2] metres ahead and to the left of the robot's centre; body [N, 2] radius and height in m, NaN where the
    image cuts them; shown [N] share of the box that shows the person; guess [N] standard deviation (m) of a distance
    told by the box alone, 0 where a surface tells; cut [N] whether a side of the image cuts the box.
    """
    rows, width = depth.shape
    taken = np.zeros((rows, width), np.bool_)
    for i in range(boxes.shape[0]):
        box = boxes[i]
        cut_left, cut_right = box[0] < _CUT_PX, box[2] > width - _CUT_PX
        expected, deviation = _expected_distance(box, cut_left, cut_right, view, low, high)
        surface, shown[i], guess[i] = _surface_distance(depth, taken, box, view, expected, deviation)
        # Sides of a box are tangents to the body's disc; where one is out of the image, the other tells.
        left = math.atan((0.5 * width - box[0]) / view.focal_x)
        right = math.atan((0.5 * width - box[2]) / view.focal_x)
        half = math.asin(min(1.0, ADULT_RADIUS_M / max(surface, ADULT_RADIUS_M)))
        bearing = 0.5 * (left + right)
        if cut_left and not cut_right:
            bearing = max(bearing, right + half)
        elif cut_right and not cut_left:
            bearing = min(bearing, left - half)
        forward = surface + _SURFACE_TO_AXIS_M * math.cos(bearing)
        cut[i] = cut_left or cut_right
        place[i, 0], place[i, 1] = forward + view.ahead_m, forward * math.tan(bearing)
        distance = forward / math.cos(bearing)
        radius = distance * math.sin(0.5 * (left - right))
        body[i, 0] = np.nan if cut[i] else ADULT_RADIUS_M + _BODY_TRUST * (radius - ADULT_RADIUS_M)
        height = view.height_m + forward / ahead_per_depth(view, box[1]) * rise_per_depth(view, box[1])
        body[i, 1] = np.nan if box[1] < _CUT_PX else ADULT_HEIGHT_M + _BODY_TRUST * (height - ADULT_HEIGHT_M)


def place_std_m(
    error: PlaceError,
    distance_m: np.ndarray,
    confidence: np.ndarray,
    shown: np.ndarray,
    guess: np.ndarray,
    cut: np.ndarray,
) -> np.ndarray:
    """Standard deviation of x and of y of each place, as `PlaceError` says, and what guesses add.

    Arrays are [N], as `place_boxes` fills them.
    """
    terms = error.floor_m, error.per_m2 * distance_m**2, error.unsure_m * (1.0 - confidence), guess
    more = error.hidden_m * (1.0 - shown) ** 3, error.cut_m * cut
    return np.sqrt(sum(np.square(term) for term in (*terms, *more)))


def localise(
    boxes: Boxes, depth_m: np.ndarray, camera: CameraConfig, error: PlaceError, odom_pose: np.ndarray
) -> Detections:
    """Where the people in the boxes stand; the surest, where there are more than a `Detections` holds.

    Args:
        boxes: in pixels of the depth image, cut at its edges.
        depth_m: f32 [rows, width], NaN where there is none.
        camera: where it is on the robot, and what it sees.
        error: tells how far to trust a place.
        odom_pose: x, y, yaw of the robot.

    Returns:
        A batch of one.
    """
    found = allocate_detections(1)
    count = min(len(boxes.confidence), found.pos.shape[1])
    place, body = np.empty((count, 2)), np.empty((count, 2))
    shown, guess, cut = np.empty(count), np.empty(count), np.zeros(count, np.bool_)
    place_boxes(
        boxes.box[:count],
        depth_m,
        camera_view(camera),
        float(camera.min_range_m),
        float(camera.max_range_m),
        place,
        body,
        shown,
        guess,
        cut,
    )
    cos, sin = math.cos(odom_pose[2]), math.sin(odom_pose[2])
    distance = np.hypot(place[:, 0] - camera.mount_x_m, place[:, 1])
    found.pos[0, :count, 0] = odom_pose[0] + cos * place[:, 0] - sin * place[:, 1]
    found.pos[0, :count, 1] = odom_pose[1] + sin * place[:, 0] + cos * place[:, 1]
    found.body[0, :count] = body
    found.confidence[0, :count] = boxes.confidence[:count]
    found.std_m[0, :count] = place_std_m(error, distance, found.confidence[0, :count], shown, guess, cut)
    found.count[0] = count
    return found
