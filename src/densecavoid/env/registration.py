"""The environments' names in Gymnasium. Does not import them: Gymnasium does, when one is made."""

from __future__ import annotations

import gymnasium as gym

from densecavoid.scenarios import names


def environment_id(scenario: str) -> str:
    """The registered Gymnasium id of a scenario: `densecavoid/dense-ped-v0`."""
    return f"densecavoid/{scenario.replace(':', '-').replace('.', '_')}-v0"


def register_environments() -> None:
    """Makes every scenario that needs no data known to `gymnasium.make` and `gymnasium.make_vec`."""
    for name in names():
        if environment_id(name) not in gym.registry:
            gym.register(
                id=environment_id(name),
                entry_point="densecavoid.env.environments:DenseCAvoidEnv",
                vector_entry_point="densecavoid.env.environments:DenseCAvoidVectorEnv",
                kwargs={"scenario": name},
            )
