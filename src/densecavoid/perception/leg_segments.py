"""Cuts a lidar scan into segments that may be legs, and describes their shape and surroundings.

The features are of the kind that Arras, Martinez Mozos and Burgard (Using Boosted Features for the Detection of People
in 2D Range Data, ICRA 2007) list: size, roundness, straightness, jumps at either side, distance.
"""

from __future__ import annotations

import math

import numpy as np

from densecavoid.sim._jit import inner, kernel

FEATURES = (
    "width_m",  # from the first return to the last
    "depth_m",  # farthest return from the line between these, towards the scanner positive
    "spread_m",  # rms distance from the centroid
    "line_rms_m",  # rms distance from the best line
    "circle_radius_m",  # of the best circle (Kasa's fit), at most 1
    "circle_rms_m",  # rms distance from it
    "distance_m",
    "filled",  # returns over rays across the segment's width at its distance
    "jump_right_m",  # range of what lies beside the first return, less its own, within 2 m either way
    "jump_left_m",
    "nearest_m",  # to the centroid of the nearest other segment of a leg's size, at most 1
    "beside_m",  # to the nearest return that is not of the segment, at most 1
)
MIN_RETURNS = 3
MAX_WIDTH_M = 0.50
MAX_SEGMENTS = 128
LINK_M = 0.10
"""Returns farther from each other than this, or three rays' spacing, belong to different segments."""
_NEAREST_M = 0.1  # nearer returns are the robot's own
_JUMP_M = 2.0
_NEIGHBOURS = 3  # segments to either side that are looked at for another leg


@kernel
def find_segments(ranges, cos, sin, increment, max_range, points, bounds):
    """Cuts one scan into segments of at least `MIN_RETURNS` returns, no wider than `MAX_WIDTH_M`.

    Args:
        ranges: [rays] m; what is not finite or beyond `max_range` is no return.
        cos, sin: [rays] of the rays' angles.
        points: [rays, 2], written: the returns in the scanner's frame, NaN without a return.
        bounds: [MAX_SEGMENTS, 3], written: first and last ray of each segment, and its number of returns.

    Returns:
        How many segments.
    """
    num_rays, count = len(ranges), 0
    first, last, returns = -1, -1, 0
    for r in range(num_rays + 1):
        ends = r == num_rays
        if not ends:
            distance = ranges[r]
            if not _NEAREST_M < distance < max_range:  # NaN is not
                points[r, 0] = points[r, 1] = np.nan
                continue
            points[r, 0], points[r, 1] = distance * cos[r], distance * sin[r]
        if first >= 0:
            apart = np.inf
            if not ends and r - last <= 2:  # one lost return does not split a leg
                apart = math.hypot(points[r, 0] - points[last, 0], points[r, 1] - points[last, 1])
            if apart <= max(LINK_M, 3.0 * increment * ranges[last]):
                last, returns = r, returns + 1
                continue
            width = math.hypot(points[last, 0] - points[first, 0], points[last, 1] - points[first, 1])
            if returns >= MIN_RETURNS and width <= MAX_WIDTH_M and count < len(bounds):
                bounds[count, 0], bounds[count, 1], bounds[count, 2] = first, last, returns
                count += 1
        first = last = r
        returns = 1
    return count


@inner
def _jump(ranges, edge, step, max_range):
    """Range of the ray beside a segment's edge, less the edge's own."""
    beside = edge + step
    if not 0 <= beside < len(ranges):
        return 0.0
    other = ranges[beside]
    if not _NEAREST_M < other < max_range:
        other = max_range
    return min(max(other - ranges[edge], -_JUMP_M), _JUMP_M)


@kernel
def describe_segment(ranges, points, increment, max_range, first, last, returns, out, centre):
    """Writes a segment's features, but for the last two, into `out` [FEATURES] and its centroid into `centre` [2]."""
    mean_x = mean_y = 0.0
    for r in range(first, last + 1):
        if points[r, 0] == points[r, 0]:
            mean_x += points[r, 0]
            mean_y += points[r, 1]
    mean_x, mean_y = mean_x / returns, mean_y / returns
    centre[0], centre[1] = mean_x, mean_y
    chord_x, chord_y = points[last, 0] - points[first, 0], points[last, 1] - points[first, 1]
    width = math.hypot(chord_x, chord_y)
    xx = xy = yy = 0.0
    xq = yq = qq = 0.0  # moments with q = x^2 + y^2, about the centroid
    depth = 0.0
    for r in range(first, last + 1):
        if points[r, 0] != points[r, 0]:
            continue
        x, y = points[r, 0] - mean_x, points[r, 1] - mean_y
        q = x * x + y * y
        xx, xy, yy = xx + x * x, xy + x * y, yy + y * y
        xq, yq, qq = xq + x * q, yq + y * q, qq + q
        # Rays go counter-clockwise: the scanner is on the left of the line from the first return to the last.
        from_first_x, from_first_y = points[r, 0] - points[first, 0], points[r, 1] - points[first, 1]
        off = (chord_x * from_first_y - chord_y * from_first_x) / max(width, 1e-6)
        if abs(off) > abs(depth):
            depth = off
    # Smallest eigenvalue of the scatter: squared distances from the best line.
    half_trace = 0.5 * (xx + yy)
    off_line = max(half_trace - math.sqrt(max(half_trace**2 - (xx * yy - xy * xy), 0.0)), 0.0)
    # Kasa's circle about the centroid: minimises sum (x^2 + y^2 - a x - b y - c)^2.
    determinant = xx * yy - xy * xy
    radius, residual = 1.0, math.sqrt(off_line / returns)
    if determinant > 1e-12:
        a, b = (xq * yy - yq * xy) / determinant, (yq * xx - xq * xy) / determinant
        radius = math.sqrt(0.25 * (a * a + b * b) + qq / returns)
        if radius < 1.0:
            residual = 0.0
            for r in range(first, last + 1):
                if points[r, 0] == points[r, 0]:
                    x, y = points[r, 0] - mean_x - 0.5 * a, points[r, 1] - mean_y - 0.5 * b
                    residual += (math.hypot(x, y) - radius) ** 2
            residual = math.sqrt(residual / returns)
    distance = math.hypot(mean_x, mean_y)
    out[0], out[1], out[2] = width, depth, math.sqrt(qq / returns)
    out[3], out[4], out[5] = math.sqrt(off_line / returns), min(radius, 1.0), residual
    out[6], out[7] = distance, returns * increment * distance / (width + increment * distance)
    out[8], out[9] = _jump(ranges, first, -1, max_range), _jump(ranges, last, 1, max_range)


@kernel
def describe_surroundings(points, bounds, centres, count, features):
    """Adds to each segment's features how near the nearest other segment is, and the nearest other return."""
    num_rays = len(points)
    for k in range(count):
        nearest = beside = 1.0
        for other in range(max(k - _NEIGHBOURS, 0), min(k + _NEIGHBOURS + 1, count)):
            if other != k and features[other, 0] < 0.3:
                apart = math.hypot(centres[other, 0] - centres[k, 0], centres[other, 1] - centres[k, 1])
                nearest = min(nearest, apart)
        for edge, step in ((bounds[k, 0], -1), (bounds[k, 1], 1)):
            for away in range(1, 9):
                r = edge + step * away
                if 0 <= r < num_rays and points[r, 0] == points[r, 0]:
                    apart = math.hypot(points[r, 0] - points[edge, 0], points[r, 1] - points[edge, 1])
                    beside = min(beside, apart)
        features[k, 10], features[k, 11] = nearest, beside


@kernel
def describe_scan(ranges, cos, sin, increment, max_range, points, bounds, centres, features):
    """Segments of one scan and their features; the arrays as in the functions above.

    Returns:
        How many segments.
    """
    count = find_segments(ranges, cos, sin, increment, max_range, points, bounds)
    for k in range(count):
        first, last, returns = bounds[k, 0], bounds[k, 1], bounds[k, 2]
        describe_segment(ranges, points, increment, max_range, first, last, returns, features[k], centres[k])
    describe_surroundings(points, bounds, centres, count, features)
    return count
