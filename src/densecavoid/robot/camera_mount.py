"""Where a depth camera sits on the robot: as the settings say it, or as TF does. Not where the policy's camera sat in
simulation, which is `CameraConfig`'s; `reprojection.py` brings images from one to the other.
"""

from __future__ import annotations

import math
from dataclasses import dataclass

import numpy as np
from jaxtyping import Float

from densecavoid.frames import CameraConfig, require

_SAME_M, _SAME_RAD = 0.01, math.radians(0.5)
"""Nearer to one another, two places give the same image: a fraction of one of the policy's pixels (.75 degrees)."""
_OPTICAL_IN_LINK = np.array([[0.0, 0.0, 1.0], [-1.0, 0.0, 0.0], [0.0, -1.0, 0.0]])
"""Columns: an optical frame's axes (right, down, ahead) in the camera's own (ahead, left, up), by REP-103."""
_STEEP = math.cos(math.radians(45.0))


@dataclass(frozen=True)
class CameraMount:
    """A camera's place in the base's frame, which lies on the floor (base_footprint, REP-120). The angles are those of
    a URDF's `rpy`: turned about the base's x axis (roll), then its y axis (pitch), then its z axis (yaw)."""

    height_m: float
    x_m: float = 0.0
    """Ahead of the base."""
    y_m: float = 0.0
    """To its left."""
    pitch_rad: float = 0.0
    """Positive looks down, as `CameraConfig.mount_pitch_rad`."""
    yaw_rad: float = 0.0
    """Positive looks left."""
    roll_rad: float = 0.0
    """Positive lowers the camera's right side; pi: it hangs upside down."""

    def __post_init__(self) -> None:
        for name in ("x_m", "y_m"):
            require(abs(getattr(self, name)) < 5.0, f"CameraMount.{name}", getattr(self, name), "on the robot")
        require(0.0 < self.height_m < 5.0, "CameraMount.height_m", self.height_m, "in (0, 5) m")
        for name, most in (("pitch_rad", math.pi / 2), ("yaw_rad", math.pi), ("roll_rad", math.pi)):
            value = getattr(self, name)
            require(abs(value) <= most + 1e-6, f"CameraMount.{name}", value, f"at most {most:.4f} either way")

    @staticmethod
    def of(camera: CameraConfig) -> CameraMount:
        """Where a simulated camera sits."""
        return CameraMount(camera.mount_height_m, camera.mount_x_m, pitch_rad=camera.mount_pitch_rad)

    @staticmethod
    def from_transform(transform: Float[np.ndarray, "4 4"], frame: str) -> CameraMount:
        """Where TF has a camera.

        An image's frame should be an optical one (z ahead, x right, y down; sensor_msgs/Image), and not all drivers
        keep to that. Taken for a plain one (x ahead, z up) is a frame that is not called optical and whose z axis is
        nearer to the vertical than to the horizontal: as an optical one it would look at the floor or the ceiling.

        Args:
            transform: pose of the image's frame in the base's, homogeneous.
            frame: its name.

        Raises:
            ValueError: if that is no place on a robot.
        """
        turn = transform[:3, :3]
        if "optical" in frame or abs(turn[2, 2]) < _STEEP:
            turn = turn @ _OPTICAL_IN_LINK.T
        x, y, z = (float(value) for value in transform[:3, 3])
        return CameraMount(
            z,
            x,
            y,
            pitch_rad=math.atan2(-turn[2, 0], math.hypot(turn[0, 0], turn[1, 0])),
            yaw_rad=math.atan2(turn[1, 0], turn[0, 0]),
            roll_rad=math.atan2(turn[2, 1], turn[2, 2]),
        )

    @property
    def pos_m(self) -> Float[np.ndarray, "3"]:
        """In the base's frame."""
        return np.array([self.x_m, self.y_m, self.height_m])

    @property
    def rotation(self) -> Float[np.ndarray, "3 3"]:
        """Columns: the camera's axes (ahead, left, up) in the base's frame."""
        (cr, sr), (cp, sp), (cy, sy) = (
            (math.cos(angle), math.sin(angle)) for angle in (self.roll_rad, self.pitch_rad, self.yaw_rad)
        )
        return np.array(
            [
                [cy * cp, cy * sp * sr - sy * cr, cy * sp * cr + sy * sr],
                [sy * cp, sy * sp * sr + cy * cr, sy * sp * cr - cy * sr],
                [-sp, cp * sr, cp * cr],
            ]
        )

    def is_as(self, other: CameraMount) -> bool:
        """Whether both are within 1 cm and .5 degrees of one another."""
        cos = 0.5 * (float(np.trace(self.rotation.T @ other.rotation)) - 1.0)
        apart_m = float(np.linalg.norm(self.pos_m - other.pos_m))
        return apart_m <= _SAME_M and math.acos(min(max(cos, -1.0), 1.0)) <= _SAME_RAD

    def __str__(self) -> str:
        degrees = (math.degrees(angle) for angle in (self.roll_rad, self.pitch_rad, self.yaw_rad))
        return f"x {self.x_m:.3f}, y {self.y_m:.3f}, height {self.height_m:.3f} m, rpy " + ", ".join(
            f"{angle:.1f}" for angle in degrees
        )
