"""The learning problem: observation, reward with named terms, and the Gymnasium environments around the simulator."""

from __future__ import annotations

from typing import TYPE_CHECKING

from densecavoid._lazy import attribute_of

if TYPE_CHECKING:
    from densecavoid.env.environments import (
        DenseCAvoidEnv,
        DenseCAvoidVectorEnv,
        make,
        make_vec,
    )
    from densecavoid.env.observation import Observer, ObserverConfig
    from densecavoid.env.registration import register_environments
    from densecavoid.env.reward import RewardConfig

__all__ = [
    "DenseCAvoidEnv",
    "DenseCAvoidVectorEnv",
    "Observer",
    "ObserverConfig",
    "RewardConfig",
    "make",
    "make_vec",
    "register_environments",
]

# Imported when asked for: a robot needs the observer, not the simulator.
_HOMES = {
    "DenseCAvoidEnv": "densecavoid.env.environments",
    "DenseCAvoidVectorEnv": "densecavoid.env.environments",
    "Observer": "densecavoid.env.observation",
    "ObserverConfig": "densecavoid.env.observation",
    "RewardConfig": "densecavoid.env.reward",
    "make": "densecavoid.env.environments",
    "make_vec": "densecavoid.env.environments",
    "register_environments": "densecavoid.env.registration",
}


def __getattr__(name: str) -> object:
    return attribute_of(__name__, _HOMES, name)


def __dir__() -> list[str]:
    return __all__
