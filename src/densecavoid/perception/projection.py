"""How a person's body appears in a level camera: the box around an upright cylinder on the ground."""

from __future__ import annotations

import math

from densecavoid.sim._jit import kernel

MIN_DEPTH_M = 0.3
"""Bodies nearer than this along the optical axis have no useful box: they would fill the image."""


@kernel
def body_box(forward, left, radius, height, focal_x, focal_y, width, rows, camera_height):
    """Image box of a body whose axis stands `forward` and `left` of the camera (m).

    The sides are the tangents to the body's disc; top and bottom are taken at the depth of its axis.

    Returns:
        (u_min, v_min, u_max, v_max) in pixels, not clipped to the image; an empty box (u_max < u_min) for nothing.
    """
    distance = math.sqrt(forward * forward + left * left)
    if forward < MIN_DEPTH_M or distance <= radius:
        return 0.0, 0.0, -1.0, -1.0
    bearing, half_width = math.atan2(left, forward), math.asin(radius / distance)
    limit = 0.5 * math.pi - 1e-3
    u_min = 0.5 * width - focal_x * math.tan(min(bearing + half_width, limit))
    u_max = 0.5 * width - focal_x * math.tan(max(bearing - half_width, -limit))
    v_min = 0.5 * rows - focal_y * (height - camera_height) / forward
    v_max = 0.5 * rows + focal_y * camera_height / forward
    return u_min, v_min, u_max, v_max


@kernel
def pixel_span(low, high, size):
    """First and one-past-last pixel whose centre lies in [low, high]."""
    return max(0, math.ceil(low - 0.5)), min(size, math.floor(high - 0.5) + 1)
