"""Environments whose reward knows the future: what a step gained or lost of the value that the place had.

The reward of a step is `UNIT` times (discount V(after) - V(before)), with V of `foresight.value_field`, 1 at the goal,
less at a collision, 0 when time is up. Added up and discounted over an episode that is what its end is worth less what
its start was (Ng, Harada, Russell 1999): the best policy is the one that ends best, but each step says at once how good
it was.
"""

from __future__ import annotations

from typing import Any

import numpy as np

from densecavoid.env.environments import DenseCAvoidVectorEnv
from densecavoid.frames import COMMAND_GRID, require
from densecavoid.learning.foreseen_worlds import ForeseenWorlds

UNIT = 20.0
"""Reward of the goal, as the paper's (`RewardConfig.goal`)."""


class ForeseenVectorEnv(DenseCAvoidVectorEnv):
    """As its base, with worlds, rewards and `command_values` [B, 25] in its observations from somebody who knows the
    future. `infos["reward_terms"]` stays the paper's.
    """

    def __init__(self, worlds: ForeseenWorlds, num_envs: int, **kwargs: Any) -> None:
        """
        Args:
            worlds: filled.
            num_envs, kwargs: as the base's.
        """
        super().__init__(worlds, num_envs, **kwargs)
        sim = self.task.simulator.config
        require(
            sim.people == "scripted",
            "SimConfig.people",
            sim.people,
            "'scripted': who reacts has no future of their own",
        )
        self.worlds = worlds
        self.commands = COMMAND_GRID * [sim.robot.max_linear_velocity, sim.robot.max_angular_velocity]
        self._slots = np.zeros(num_envs, np.int64)
        self._value = np.zeros(num_envs)

    def reset(
        self, *, seed: int | list[int | None] | None = None, options: dict[str, Any] | None = None
    ) -> tuple[dict[str, np.ndarray], dict[str, Any]]:
        """As the base's."""
        result = super().reset(seed=seed, options=options)
        self._begin(np.arange(self.num_envs))
        self._value = self._values()
        return self._with_values(result[0]), result[1]

    def step(
        self, actions: np.ndarray
    ) -> tuple[dict[str, np.ndarray], np.ndarray, np.ndarray, np.ndarray, dict[str, Any]]:
        """As the base's; the observations in `final_obs` have no command values."""
        before = self._value
        observation, _, terminated, truncated, infos = super().step(actions)
        ended = np.flatnonzero(terminated | truncated)
        self._begin(ended)
        self._value = self._values()
        values = self.worlds.config.values
        after = values.discount * self._value
        if len(ended) > 0:
            outcome = infos["episode"]
            collision = np.where(outcome["collision"], values.collision, 0.0)
            after[ended] = np.where(outcome["success"], 1.0, collision)[ended]
        reward = (UNIT * (after - before)).astype(np.float32)
        # Nothing is worth anything once time is up: what a state could still have brought is not to be added.
        terminated, truncated = terminated | truncated, np.zeros_like(truncated)
        return self._with_values(observation), reward, terminated, truncated, infos

    def state_dict(self) -> dict[str, np.ndarray]:
        """As the base's."""
        return super().state_dict() | {"slots": self._slots.copy(), "value": self._value.copy()}

    def load_state_dict(self, arrays: dict[str, np.ndarray]) -> None:
        """As the base's; `worlds` must hold what it held."""
        super().load_state_dict(arrays)
        self._slots, self._value = np.array(arrays["slots"]), np.array(arrays["value"])

    def _begin(self, which: np.ndarray) -> None:
        """Notes where the worlds came from that were just drawn, one after the other."""
        for b in which:
            self._slots[b] = self.worlds.drawn.popleft()
        assert not self.worlds.drawn, "worlds were drawn that no environment began"

    def _values(self) -> np.ndarray:
        simulator = self.task.simulator
        return self.worlds.fields.of_poses(self._slots, simulator.robot_pose, simulator.time_s)

    def _with_values(self, observation: dict[str, np.ndarray]) -> dict[str, np.ndarray]:
        simulator, fields = self.task.simulator, self.worlds.fields
        values = fields.of_commands(self._slots, simulator.robot_pose, simulator.time_s, self.commands)
        return {**observation, "command_values": values.astype(np.float32)}
