"""Points and shapes about the robot: which points lie in a polygon or circle, moved along with the robot or not."""

from __future__ import annotations

import numpy as np
from jaxtyping import Bool, Float

from densecavoid.frames import require


def in_polygon(points: Float[np.ndarray, "*n 2"], polygon: Float[np.ndarray, "corners 2"]) -> Bool[np.ndarray, "*n"]:
    """Whether each point lies inside, by the crossings of a ray to the right (even-odd rule)."""
    inside = np.zeros(points.shape[:-1], np.bool_)
    x, y = points[..., 0], points[..., 1]
    before = np.roll(polygon, 1, axis=0)
    for (x1, y1), (x2, y2) in zip(before, polygon, strict=True):
        if y1 == y2:
            continue
        crosses = (y1 > y) != (y2 > y)
        inside ^= crosses & (x < x1 + (y - y1) * ((x2 - x1) / (y2 - y1)))
    return inside


def count_inside(points: Float[np.ndarray, "n 2"], polygon: tuple[tuple[float, float], ...], radius_m: float) -> int:
    """How many points lie in a polygon, or, where it has no corners, in a circle about the origin."""
    if not polygon:
        return int(np.count_nonzero(np.hypot(points[:, 0], points[:, 1]) <= radius_m))
    return int(np.count_nonzero(in_polygon(points, np.array(polygon))))


def scan_points(
    ranges_m: Float[np.ndarray, "rays"],
    angles_rad: Float[np.ndarray, "rays"],
    mount_x_m: float = 0.0,
) -> Float[np.ndarray, "n 2"]:
    """Returns of a scan as points in the robot's frame; rays without one are left out.

    Raises:
        ValueError: if there are not as many angles as ranges.
    """
    require(ranges_m.shape == angles_rad.shape, "angles_rad", angles_rad.shape, f"{ranges_m.shape}, as the ranges")
    hit = np.isfinite(ranges_m)
    ranges, angles = ranges_m[hit].astype(np.float64), angles_rad[hit]
    return np.stack([mount_x_m + ranges * np.cos(angles), ranges * np.sin(angles)], axis=1)
