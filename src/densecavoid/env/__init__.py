"""The learning problem: observation, reward with named terms, and the Gymnasium environments around the simulator."""

from densecavoid.env.environments import DenseCAvoidEnv, DenseCAvoidVectorEnv, make, make_vec, register_environments
from densecavoid.env.observation import Observer, ObserverConfig
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
