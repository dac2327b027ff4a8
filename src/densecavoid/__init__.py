"""DenseCAvoid: drive a robot through dense crowds, from raw sensors to commands."""

from densecavoid.benchmark.evaluate import evaluate
from densecavoid.env import make, make_vec, register_environments
from densecavoid.frames import Command, Navigator, SensorFrame
from densecavoid.policy.navigator import load_policy

register_environments()

__all__ = ["Command", "Navigator", "SensorFrame", "evaluate", "load_policy", "make", "make_vec"]
