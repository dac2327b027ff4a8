"""Depth images as the network sees them: three channels, padded so that both grids fit. No torch."""

from __future__ import annotations

import numpy as np

from densecavoid.frames import CameraConfig
from densecavoid.sim._jit import kernel

CHANNELS = 3
"""Nearness (1 at the camera's least range, 0 at its greatest and where there is no depth), whether there is depth (1 or
0), and height above the ground over 2 m (0 where there is no depth): height tells a head from a ceiling, whatever the
camera's mount."""
PADDING_ROWS = 2
"""Without depth, above and below: 60 rows become 64, which strides of 4 and 8 divide."""
_HEIGHT_SCALE_M = 2.0


@kernel
def encode_depth(depth, min_range, max_range, camera_height, pitch, row_slope, out):
    """Fills `out` f32 [3, rows + 4, width] for an image [rows, width] in m, NaN where there is no depth."""
    rows, width = depth.shape
    scale = np.float32(1.0 / (max_range - min_range))
    cos, sin = np.float32(np.cos(pitch)), np.float32(np.sin(pitch))
    zero, one = np.float32(0.0), np.float32(1.0)
    for k in range(CHANNELS):
        for r in range(PADDING_ROWS):
            out[k, r] = zero
            out[k, rows + PADDING_ROWS + r] = zero
    for r in range(rows):
        rise = np.float32((row_slope[r] * cos - sin) / _HEIGHT_SCALE_M)
        above = np.float32(camera_height / _HEIGHT_SCALE_M)
        for c in range(width):
            d = depth[r, c]
            inside = (d >= min_range) & (d <= max_range)  # NaN is not
            near = scale * (max_range - d)
            out[0, r + PADDING_ROWS, c] = near if inside else zero
            out[1, r + PADDING_ROWS, c] = one if inside else zero
            out[2, r + PADDING_ROWS, c] = above + rise * d if inside else zero


@kernel
def encode_all(depth, mount, min_range, max_range, row_slope, out):
    """`encode_depth` of N images with mounts [N, 3] (ahead, height, pitch) into `out` [N, 3, rows + 4, width]."""
    for n in range(depth.shape[0]):
        encode_depth(depth[n], min_range, max_range, mount[n, 1], mount[n, 2], row_slope, out[n])


def encode_images(depth_m: np.ndarray, mount: np.ndarray, camera: CameraConfig) -> np.ndarray:
    """The network's input f32 [N, 3, rows + 4, width].

    Args:
        depth_m: f32 [N, rows, width], NaN where there is no depth.
        mount: [N, 3] metres ahead of the robot's centre, height (m) and pitch (rad) of each image's camera.
        camera: size, field of view and ranges of all of them.
    """
    count, rows, width = depth_m.shape
    out = np.empty((count, CHANNELS, rows + 2 * PADDING_ROWS, width), np.float32)
    slopes = camera.row_slopes.astype(np.float32)
    low, high = np.float32(camera.min_range_m), np.float32(camera.max_range_m)
    encode_all(np.asarray(depth_m, np.float32), np.asarray(mount, np.float64), low, high, slopes, out)
    return out
