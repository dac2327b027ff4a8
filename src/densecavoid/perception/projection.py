"""How people appear in a camera that looks ahead, level or pitched: each is an upright rectangle that faces it.

The rectangle stands on the ground, as wide as the body's disc looks and as high as the body. A level camera shows a
box, a pitched one a trapezoid with level top and bottom.
"""

from __future__ import annotations

import math
from typing import NamedTuple

from densecavoid.frames import CameraConfig
from densecavoid.sim._jit import kernel

MIN_DEPTH_M = 0.3
"""Bodies nearer than this have no useful box: they would fill the image."""
_GRAZING = (
    1e-2  # least depth (of a point one metre ahead) that is still drawn; behind it rays run along the image plane
)


class CameraView(NamedTuple):
    """A `CameraConfig` as the kernels of perception read it."""

    focal_x: float
    focal_y: float
    width: int
    rows: int
    height_m: float
    ahead_m: float
    cos_pitch: float
    sin_pitch: float


def camera_view(config: CameraConfig) -> CameraView:
    """Where the camera is and how it looks."""
    focal_x, focal_y = config.focal_px
    return CameraView(
        float(focal_x),
        float(focal_y),
        config.width,
        config.height,
        float(config.mount_height_m),
        float(config.mount_x_m),
        math.cos(config.mount_pitch_rad),
        math.sin(config.mount_pitch_rad),
    )


@kernel
def from_camera(view, pose, x, y):
    """Metres (forward, left) along the ground from the camera on a robot at `pose` (x, y, yaw) to (x, y)."""
    cos, sin = math.cos(pose[2]), math.sin(pose[2])
    off_x, off_y = x - pose[0], y - pose[1]
    return cos * off_x + sin * off_y - view.ahead_m, cos * off_y - sin * off_x


@kernel
def ahead_per_depth(view, v):
    """Metres along the ground a metre of depth, of the rays through image height `v` (px; .5: the first row's centre).

    Their rise is `rise_per_depth`; both follow from turning a ray (1, left, up) of the camera about the robot's y axis.
    """
    return view.cos_pitch + (0.5 * view.rows - v) / view.focal_y * view.sin_pitch


@kernel
def rise_per_depth(view, v):
    """Metres upward a metre of depth of the rays through image height `v`."""
    return (0.5 * view.rows - v) / view.focal_y * view.cos_pitch - view.sin_pitch


@kernel
def image_height(view, rise):
    """Image height v (px) of what is `rise` metres above the camera a metre ahead along the ground.

    What is beside or behind the image plane is moved to just before it.
    """
    depth = max(view.cos_pitch - rise * view.sin_pitch, _GRAZING)
    return 0.5 * view.rows - view.focal_y * (view.sin_pitch + rise * view.cos_pitch) / depth


@kernel
def body_sides(forward, left, radius):
    """Left per forward, along the ground, of the two tangents to a body's disc: (rightmost, leftmost).

    Args:
        forward, left: from the camera to the body's axis (m).

    Returns:
        An empty pair (1, -1) for a body that has no useful box.
    """
    distance = math.sqrt(forward * forward + left * left)
    if forward < MIN_DEPTH_M or distance <= radius:
        return 1.0, -1.0
    bearing, half_width = math.atan2(left, forward), math.asin(radius / distance)
    limit = 0.5 * math.pi - 1e-3
    return math.tan(max(bearing - half_width, -limit)), math.tan(min(bearing + half_width, limit))


@kernel
def body_rows(forward, height, view):
    """Image heights (top, bottom) of a body whose axis is `forward` metres ahead, not clipped to the image."""
    return image_height(view, (height - view.height_m) / forward), image_height(view, -view.height_m / forward)


@kernel
def body_box(forward, left, radius, height, view):
    """Image box of a body whose axis stands `forward` and `left` of the camera (m, along the ground).

    Returns:
        (u_min, v_min, u_max, v_max) in pixels, not clipped to the image; an empty box (u_max < u_min) for nothing.
    """
    right_side, left_side = body_sides(forward, left, radius)
    if left_side < right_side:
        return 0.0, 0.0, -1.0, -1.0
    top, bottom = body_rows(forward, height, view)
    at_top, at_bottom = ahead_per_depth(view, top), ahead_per_depth(view, bottom)
    u_min = 0.5 * view.width - view.focal_x * max(left_side * at_top, left_side * at_bottom)
    u_max = 0.5 * view.width - view.focal_x * min(right_side * at_top, right_side * at_bottom)
    return u_min, top, u_max, bottom


@kernel
def pixel_span(low, high, size):
    """First and one-past-last pixel whose centre lies in [low, high]."""
    return max(0, math.ceil(low - 0.5)), min(size, math.floor(high - 0.5) + 1)
