"""Rays against upright prisms: the maths that the lidar and the depth camera share.

Every solid is a convex footprint times a range of heights, so a ray meets it in two steps: the interval in which the
ray is above the footprint, then the part of it between bottom and top. Coordinates are relative to the sensor; `t` is
in units of the ray's direction. A miss is an empty interval (entry after exit).

All loops over rays run from 0 over slices, and choose without branches: only such loops are vectorised (an index that
might be negative, or a condition that might skip a division, is enough to lose a factor of ten).
"""

from __future__ import annotations

import math

import numpy as np

from densecavoid.sim._jit import inner

MISS = np.float32(np.inf)
_TINY = np.float32(1e-12)


@inner
def disc_interval(centre_x, centre_y, radius, dir_x, dir_y):
    """Entry and exit of a ray from the origin through a disc."""
    length_2 = dir_x * dir_x + dir_y * dir_y
    along = centre_x * dir_x + centre_y * dir_y
    # The lateral offset, not |c|^2 - (c.d)^2, keeps float32 accurate for thin discs far away.
    across = centre_x * dir_y - centre_y * dir_x
    discriminant = radius * radius * length_2 - across * across
    half = math.sqrt(max(discriminant, np.float32(0.0)))
    scale = np.float32(1.0) / length_2
    leave = (along + half) * scale
    return (along - half) * scale, leave if discriminant >= np.float32(0.0) else -MISS


@inner
def rectangle_interval(local_x, local_y, half_length, half_width, dir_x, dir_y):
    """Entry and exit of a ray through a rectangle, both given in the rectangle's own frame (slab method)."""
    safe_x = dir_x if abs(dir_x) > _TINY else _TINY
    safe_y = dir_y if abs(dir_y) > _TINY else _TINY
    inv_x, inv_y = np.float32(1.0) / safe_x, np.float32(1.0) / safe_y
    x_near, x_far = (-half_length - local_x) * inv_x, (half_length - local_x) * inv_x
    y_near, y_far = (-half_width - local_y) * inv_y, (half_width - local_y) * inv_y
    x_min, x_max = (x_near, x_far) if x_near < x_far else (x_far, x_near)
    y_min, y_max = (y_near, y_far) if y_near < y_far else (y_far, y_near)
    entry = x_min if x_min > y_min else y_min
    leave = x_max if x_max < y_max else y_max
    return entry, leave


@inner
def prism_distance(entry, leave, dir_z, z_min, z_max):
    """Distance to a prism whose footprint the ray crosses in [entry, leave]; heights are relative to the sensor.

    A sensor inside the prism is at distance 0.
    """
    start = max(entry, np.float32(0.0))
    z_start = start * dir_z
    # Where the ray starts above the top (or below the bottom), it can only come in through that face.
    face = z_max if z_start > z_max else z_min
    t_face = face / (dir_z if abs(dir_z) > _TINY else _TINY)
    between = (z_start >= z_min) & (z_start <= z_max)
    hit = (leave >= start) & (between | ((t_face >= start) & (t_face <= leave)))
    t = start if between else t_face
    return t if hit else MISS
