"""DenseCAvoid: drive a robot through dense crowds, from raw sensors to commands."""

from densecavoid.env import make, make_vec, register_environments
from densecavoid.frames import Command, Navigator, SensorFrame

register_environments()

__all__ = ["Command", "Navigator", "SensorFrame", "make", "make_vec"]
