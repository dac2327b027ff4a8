"""What the robot's own senses look like: the depth image, the prediction frame and the scan, as small pictures."""

from __future__ import annotations

import math

import numpy as np
from jaxtyping import Float32, UInt8
from PIL import Image, ImageDraw

from densecavoid.frames import CameraConfig, LidarConfig
from densecavoid.viz import theme

SUPERSAMPLING = 3


def depth_picture(
    depth_m: Float32[np.ndarray, "height width"], camera: CameraConfig, size_px: tuple[int, int]
) -> Image.Image:
    """A depth image, near bright and far dark; grey where there is no depth."""
    nearness = (camera.max_range_m - depth_m) / (camera.max_range_m - camera.min_range_m)
    return _crisp(theme.depth_colours(nearness), size_px)


def prediction_picture(prediction: UInt8[np.ndarray, "height width"], size_px: tuple[int, int]) -> Image.Image:
    """A prediction frame as it is: black where a person is expected, on white."""
    return _crisp(np.repeat(prediction[..., None], 3, axis=-1), size_px)


class LidarPicture:
    """Draws scans from above with the robot looking up: how far it is free, and what was hit."""

    def __init__(self, lidar: LidarConfig, size_px: tuple[int, int]) -> None:
        self._lidar = lidar
        width, height = (SUPERSAMPLING * side for side in size_px)
        # A scanner sees behind itself by this much of its range (all of it beyond a half circle's 90 degrees each way).
        behind = max(0.0, -math.cos(lidar.fov_rad / 2)) if lidar.fov_rad > math.pi else 0.12
        span = 1.0 + behind
        self._pixels_per_m = min(width / 2.1, height / (span * 1.06)) / lidar.max_range_m
        top = (height - span * lidar.max_range_m * self._pixels_per_m) / 2
        self._centre = np.array([width / 2, top + lidar.max_range_m * self._pixels_per_m])
        angles = lidar.angles_rad
        self._directions = np.stack([-np.sin(angles), -np.cos(angles)], axis=-1)  # [rays, 2] right, down
        self._background = self._empty((width, height))

    def draw(self, scan_m: Float32[np.ndarray, "rays"]) -> Image.Image:
        """The picture of one scan."""
        image = self._background.copy()
        draw = ImageDraw.Draw(image)
        hit = np.isfinite(scan_m)
        ranges = np.where(hit, scan_m, self._lidar.max_range_m)[:, None]
        rim = self._centre + ranges * self._directions * self._pixels_per_m
        outline = np.concatenate([self._centre[None], rim])
        draw.polygon(outline.ravel().tolist(), fill=theme.FREE_SPACE)
        self._rings(draw)
        r = 1.1 * SUPERSAMPLING
        for x, y in rim[hit].tolist():
            draw.ellipse((x - r, y - r, x + r, y + r), fill=theme.LIDAR)
        (x, y), r = self._centre.tolist(), 0.18 * self._pixels_per_m
        draw.ellipse((x - r, y - r, x + r, y + r), fill=theme.ROBOT)
        return image.reduce(SUPERSAMPLING)

    def _empty(self, size: tuple[int, int]) -> Image.Image:
        image = Image.new("RGB", size, theme.CARD)
        draw = ImageDraw.Draw(image)
        self._pie(draw, self._lidar.max_range_m, fill=theme.GRID)
        return image

    def _rings(self, draw: ImageDraw.ImageDraw) -> None:
        for radius_m in range(1, math.floor(self._lidar.max_range_m) + 1):
            start, end = self._angles_on_picture()
            draw.arc(self._circle(radius_m), start, end, fill=theme.BORDER, width=SUPERSAMPLING)

    def _pie(self, draw: ImageDraw.ImageDraw, radius_m: float, fill: theme.Colour) -> None:
        start, end = self._angles_on_picture()
        draw.pieslice(self._circle(radius_m), start, end, fill=fill)

    def _angles_on_picture(self) -> tuple[float, float]:
        """Degrees clockwise from the right, as Pillow counts: straight ahead is up, 270."""
        half = math.degrees(self._lidar.fov_rad) / 2
        return 270 - half, 270 + half

    def _circle(self, radius_m: float) -> tuple[float, float, float, float]:
        (x, y), r = self._centre.tolist(), radius_m * self._pixels_per_m
        return x - r, y - r, x + r, y + r


def _crisp(pixels: UInt8[np.ndarray, "height width 3"], size_px: tuple[int, int]) -> Image.Image:
    """Enlarged with square pixels, which a reader can count, whatever the ratio."""
    height, width = pixels.shape[:2]
    whole = max(1, math.ceil(max(size_px[0] / width, size_px[1] / height)))
    enlarged = Image.fromarray(pixels).resize((width * whole, height * whole), Image.Resampling.NEAREST)
    return enlarged.resize(size_px, Image.Resampling.BOX)
