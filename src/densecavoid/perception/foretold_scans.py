"""Where people are expected some seconds from now, in the form of scans: how far it is to the nearest of them.

The prediction frame shows one moment to the front, in the camera's view. These show several moments over the lidar's
whole field of view, people alone and the rest left out, all from where the robot is now: beside the lidar's scan that
is a picture of the gaps that open and close.
"""

from __future__ import annotations

import math

import numpy as np

from densecavoid.sim._jit import kernel

REACH_M = 6.0
"""The scans' greatest range: that of 1."""


@kernel
def draw_foretold_scans(first, last, which, scans, expected, pose, fov):
    """Fills `scans` of the marked worlds.

    Args:
        which: bool [B].
        scans: f32 [B, H, rays] fractions of `REACH_M`, 1 where nobody is expected.
        expected: an `Expected` at the H times.
        pose: f64 [B, 3] x, y, yaw of the robots in the odometry frame.
        fov: of the scans, rad; rays from -fov / 2 to fov / 2.
    """
    rays = scans.shape[2]
    increment = fov / (rays - 1)
    for b in range(first, last):
        if not which[b]:
            continue
        scans[b, :, :] = 1.0
        cos, sin = math.cos(pose[b, 2]), math.sin(pose[b, 2])
        for n in range(expected.first[b], expected.first[b + 1]):
            radius = expected.body[n, 0]
            for k in range(scans.shape[1]):
                off_x, off_y = expected.pos[n, k, 0] - pose[b, 0], expected.pos[n, k, 1] - pose[b, 1]
                x, y = cos * off_x + sin * off_y, cos * off_y - sin * off_x
                away = math.sqrt(x * x + y * y)
                if not away - radius < REACH_M:  # NaN is not
                    continue
                if away <= radius:  # then the robot would be inside
                    scans[b, k, :] = 0.0
                    continue
                bearing, half = math.atan2(y, x), math.asin(radius / away)
                # The bearings of a body behind the robot lie on both sides of the seam.
                for turn in range(-1, 2):
                    middle = bearing + 2.0 * math.pi * turn
                    from_ray = max(math.ceil((middle - half + 0.5 * fov) / increment), 0)
                    to_ray = min(math.floor((middle + half + 0.5 * fov) / increment), rays - 1)
                    for r in range(from_ray, to_ray + 1):
                        off = r * increment - 0.5 * fov - middle
                        aside = away * math.sin(off)
                        distance = away * math.cos(off) - math.sqrt(max(radius * radius - aside * aside, 0.0))
                        scans[b, k, r] = min(scans[b, k, r], np.float32(distance / REACH_M))
