"""DenseCAvoid: drive a robot through dense crowds, from raw sensors to commands."""

from __future__ import annotations

from typing import TYPE_CHECKING

from densecavoid._lazy import attribute_of, register_with_gymnasium

if TYPE_CHECKING:
    from densecavoid.benchmark.evaluate import evaluate
    from densecavoid.env import make, make_vec
    from densecavoid.frames import Command, Navigator, SensorFrame
    from densecavoid.policy.navigator import load_policy

__all__ = ["Command", "Navigator", "SensorFrame", "evaluate", "load_policy", "make", "make_vec"]

# Imported when asked for: a robot uses a small part of the package and must be up within a second.
_HOMES = {
    "Command": "densecavoid.frames",
    "Navigator": "densecavoid.frames",
    "SensorFrame": "densecavoid.frames",
    "evaluate": "densecavoid.benchmark.evaluate",
    "load_policy": "densecavoid.policy.navigator",
    "make": "densecavoid.env",
    "make_vec": "densecavoid.env",
}


def __getattr__(name: str) -> object:
    return attribute_of(__name__, _HOMES, name)


def __dir__() -> list[str]:
    return __all__


register_with_gymnasium()
