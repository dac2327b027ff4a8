"""The filter between whoever drives and the wheels; usable alone around any velocity command. NumPy only."""

from densecavoid.safety.approach import NOBODY, PeopleNear
from densecavoid.safety.config import ApproachConfig, FreezeConfig, SafetyConfig, VelocityRange, ZoneConfig
from densecavoid.safety.filter import SafeCommand, SafetyFilter
from densecavoid.safety.shapes import scan_points

__all__ = [
    "NOBODY",
    "ApproachConfig",
    "FreezeConfig",
    "PeopleNear",
    "SafeCommand",
    "SafetyConfig",
    "SafetyFilter",
    "VelocityRange",
    "ZoneConfig",
    "scan_points",
]
