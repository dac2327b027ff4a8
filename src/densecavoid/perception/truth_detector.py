"""People's boxes from ground truth, for those whom the camera really shows. Stands in for a detector; privileged.

A person counts as seen when enough of their trunk has the right depth in the image: hidden, too near, too far and
outside people are missed, as a detector would miss them.
"""

from __future__ import annotations

import math

from densecavoid.perception.projection import body_box, pixel_span
from densecavoid.sim._jit import kernel

MIN_VISIBLE_FRACTION = 1.0 / 3.0
_DEPTH_MARGIN_M = 0.1
_TRUNK = (0.45, 0.80)  # of body height: where all of the box's width is body


@kernel
def visible_fraction(image, forward, left, radius, height, focal_x, focal_y, camera_height):
    """Share of the trunk's box (the part outside the image included) that shows a surface at the trunk's depth."""
    rows, width = image.shape
    u_min, _, u_max, _ = body_box(forward, left, radius, height, focal_x, focal_y, width, rows, camera_height)
    if u_max <= u_min:
        return 0.0
    v_min = 0.5 * rows - focal_y * (_TRUNK[1] * height - camera_height) / forward
    v_max = 0.5 * rows - focal_y * (_TRUNK[0] * height - camera_height) / forward
    first, last = pixel_span(u_min, u_max, width)
    top, bottom = pixel_span(v_min, v_max, rows)
    nearest, farthest = forward - radius - _DEPTH_MARGIN_M, forward + radius + _DEPTH_MARGIN_M
    seen = 0
    for v in range(top, bottom):
        for u in range(first, last):
            depth = image[v, u]
            seen += nearest <= depth <= farthest
    # Pixels of the trunk within the image's rows but all its columns: one cut by the image's side is seen in part.
    whole = (u_max - u_min) * max(bottom - top, 1)
    return seen / whole


@kernel
def detect_from_truth(image, pose, pos, radius, height, active, focal_x, focal_y, camera_height, out):
    """Writes the visible people of one world into `out` [D, 4]: x, y in the frame of `pose`, radius, height (m).

    Returns:
        How many were written.
    """
    count = 0
    cos, sin = math.cos(pose[2]), math.sin(pose[2])
    for i in range(pos.shape[0]):
        if not active[i] or count == out.shape[0]:
            continue
        off_x, off_y = pos[i, 0] - pose[0], pos[i, 1] - pose[1]
        forward, left = cos * off_x + sin * off_y, cos * off_y - sin * off_x
        fraction = visible_fraction(image, forward, left, radius[i], height[i], focal_x, focal_y, camera_height)
        if fraction >= MIN_VISIBLE_FRACTION:
            out[count, 0], out[count, 1] = forward, left
            out[count, 2], out[count, 3] = radius[i], height[i]
            count += 1
    return count
