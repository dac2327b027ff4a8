"""People's places from ground truth, for those whom the camera really shows. Stands in for a detector; privileged.

A person counts as seen when enough of their trunk has the right depth in the image: hidden, too near, too far and
outside people are missed, as a detector would miss them.
"""

from __future__ import annotations

import math

import numpy as np

from densecavoid.perception.projection import (
    MIN_DEPTH_M,
    ahead_per_depth,
    body_sides,
    from_camera,
    image_height,
    pixel_span,
)
from densecavoid.sim._jit import kernel

MIN_VISIBLE_FRACTION = 1.0 / 3.0
EXACT_STD_M, EXACT_CONFIDENCE = 0.05, 0.99
"""What the tracker is told: less than nothing, because people sway as they walk."""
_DEPTH_MARGIN_M = 0.1
_TRUNK = (0.45, 0.80)  # of body height: where all of the box's width is body


@kernel
def visible_fraction(image, forward, left, radius, height, view):
    """Share of the trunk (what is aside of the image included) that shows a surface at the trunk's depth.

    Args:
        image: depth [height, width], m.
        forward, left: from the camera to the body's axis (m, along the ground).
        view: a `CameraView`.
    """
    right_side, left_side = body_sides(forward, left, radius)
    if left_side < right_side:
        return 0.0
    v_min = image_height(view, (_TRUNK[1] * height - view.height_m) / forward)
    v_max = image_height(view, (_TRUNK[0] * height - view.height_m) / forward)
    top, bottom = pixel_span(v_min, v_max, view.rows)
    nearest, farthest = forward - radius - _DEPTH_MARGIN_M, forward + radius + _DEPTH_MARGIN_M
    seen, whole = 0, 0.0
    for v in range(top, bottom):
        per_depth = ahead_per_depth(view, v + 0.5)
        reach = view.focal_x * per_depth
        first, last = pixel_span(
            0.5 * view.width - reach * left_side, 0.5 * view.width - reach * right_side, view.width
        )
        # All columns count, those beyond the image too: a trunk cut by the image's side is seen in part.
        whole += reach * (left_side - right_side)
        for u in range(first, last):
            seen += nearest <= image[v, u] * per_depth <= farthest
    return seen / whole if whole > 0.0 else 0.0


@kernel
def visible_people(image, pose, people, b, view):
    """Visible share of everybody in world b, f64 [P]; 0 for those who are not there.

    Args:
        image: depth [height, width], m.
        pose: x, y, yaw of the robot in the world.
        people: a `frames.People`.
    """
    shares = np.zeros(people.pos_w.shape[1])
    for i in range(len(shares)):
        if people.active[b, i]:
            forward, left = from_camera(view, pose, people.pos_w[b, i, 0], people.pos_w[b, i, 1])
            if forward >= MIN_DEPTH_M:
                shares[i] = visible_fraction(image, forward, left, people.radius_m[b, i], people.height_m[b, i], view)
    return shares


@kernel
def find_exactly(first, last, which, depth, true_pose, odom_pose, people, view, out):
    """Writes the visible people of each marked world into `out` (`Detections`), where they are to the millimetre.

    Args:
        depth: [B, height, width] what the camera shows, m.
        true_pose, odom_pose: [B, 3] the robot in the world, and where it believes to be.
        people: a `frames.People`.
    """
    for b in range(first, last):
        if not which[b]:
            continue
        pose = odom_pose[b]
        cos, sin = math.cos(pose[2]), math.sin(pose[2])
        count = 0
        for i in range(people.pos_w.shape[1]):
            if not people.active[b, i] or count == out.pos.shape[1]:
                continue
            forward, left = from_camera(view, true_pose[b], people.pos_w[b, i, 0], people.pos_w[b, i, 1])
            radius, height = people.radius_m[b, i], people.height_m[b, i]
            if forward < MIN_DEPTH_M:
                continue
            if visible_fraction(depth[b], forward, left, radius, height, view) >= MIN_VISIBLE_FRACTION:
                ahead = forward + view.ahead_m
                out.pos[b, count, 0] = pose[0] + cos * ahead - sin * left
                out.pos[b, count, 1] = pose[1] + sin * ahead + cos * left
                out.std_m[b, count], out.confidence[b, count] = EXACT_STD_M, EXACT_CONFIDENCE
                out.body[b, count, 0], out.body[b, count, 1] = radius, height
                count += 1
        out.count[b] = count
