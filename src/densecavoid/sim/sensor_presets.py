"""Scanners and depth cameras that robots carry, by name, at their native resolutions. Figures are the datasheets'.

A policy's sensors have the sizes it was trained with; `dataclasses.replace(preset, width=80, height=60)` gives a
camera of the same view at another resolution.
"""

from __future__ import annotations

import math

from densecavoid.frames import CameraConfig, LidarConfig, choose

LIDARS: dict[str, LidarConfig] = {
    # Hokuyo URG-04LX: 1,024 steps a turn, 682 of them over 240 degrees, to 4,095 mm, a scan in 100 ms.
    "hokuyo-urg04": LidarConfig(
        num_rays=683, fov_rad=682 * 2 * math.pi / 1024, max_range_m=4.095, min_range_m=0.06, rate_hz=10.0
    ),
    # Slamtec RPLIDAR A2M8 (datasheet rev. 2.5): .15 to 12 m, 8,000 samples a second at 10 Hz, so .45 degrees apart.
    "rplidar-a2": LidarConfig(
        num_rays=800, fov_rad=799 * 2 * math.pi / 800, max_range_m=12.0, min_range_m=0.15, rate_hz=10.0, sweep_s=0.1
    ),
}
CAMERAS: dict[str, CameraConfig] = {
    # Orbbec Astra: 640x480 at 30 Hz, 60 by 49.5 degrees, .6 to 8 m. (The paper uses 1.4 to 5 m: CameraConfig().)
    "astra": CameraConfig(
        width=640,
        height=480,
        fov_horizontal_rad=math.radians(60.0),
        fov_vertical_rad=math.radians(49.5),
        min_range_m=0.6,
        max_range_m=8.0,
        rate_hz=30.0,
    ),
    # Intel RealSense D435 (D400 series datasheet): 848x480 at 30 Hz and up, 87 by 58 degrees, nearest depth .195 m at
    # that resolution, used to about 10 m.
    "realsense-d435": CameraConfig(
        width=848,
        height=480,
        fov_horizontal_rad=math.radians(87.0),
        fov_vertical_rad=math.radians(58.0),
        min_range_m=0.195,
        max_range_m=10.0,
        rate_hz=30.0,
    ),
}


def lidar_preset(name: str) -> LidarConfig:
    """The scanner of that name.

    Raises:
        ValueError: naming those there are.
    """
    return LIDARS[choose("lidar", name, tuple(LIDARS))]


def camera_preset(name: str) -> CameraConfig:
    """The depth camera of that name.

    Raises:
        ValueError: naming those there are.
    """
    return CAMERAS[choose("camera", name, tuple(CAMERAS))]
