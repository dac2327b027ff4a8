"""Experience: T steps of N worlds in preallocated tensors, and the loop that fills them from a Gymnasium vector
environment with SAME_STEP autoreset. No learning here.
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass, field
from typing import Any

import numpy as np
import torch
from gymnasium.vector import AutoresetMode, VectorEnv
from jaxtyping import Bool, Float, Float32
from torch import Tensor

from densecavoid.frames import Observation, require
from densecavoid.policy.distribution import DiagonalGaussian
from densecavoid.policy.network import ActorCritic, ObservationTensors
from densecavoid.policy.sensors import mask_observation


@dataclass
class Episodes:
    """The episodes that ended during a rollout."""

    scenario: list[str] = field(default_factory=list)
    success: list[bool] = field(default_factory=list)
    collision: list[bool] = field(default_factory=list)
    total_reward: list[float] = field(default_factory=list)
    length: list[int] = field(default_factory=list)


@dataclass
class Rollout:
    """T steps of N worlds. Images stay uint8."""

    observation: ObservationTensors
    """Each [T, N, ...]."""
    action: Float32[Tensor, "T N 2"]
    """As sampled, before the environment clips."""
    log_prob: Float32[Tensor, "T N"]
    value: Float32[Tensor, "T N"]
    next_value: Float32[Tensor, "T N"]
    reward: Float32[Tensor, "T N"]
    terminated: Bool[Tensor, "T N"]
    truncated: Bool[Tensor, "T N"]
    episodes: Episodes = field(default_factory=Episodes)
    reward_terms: dict[str, float] = field(default_factory=dict)
    """Mean of each unscaled term a step."""

    @staticmethod
    def allocate(steps: int, observation: Observation, device: torch.device) -> Rollout:
        """Storage for `steps` steps of observations like the given one."""
        N = observation.lidar.shape[0]
        stored = (torch.from_numpy(np.asarray(array)) for array in observation)

        def numbers(*shape: int) -> Tensor:
            return torch.zeros(steps, N, *shape, device=device)

        def flags() -> Tensor:
            return torch.zeros(steps, N, dtype=torch.bool, device=device)

        return Rollout(
            observation=ObservationTensors(
                *(torch.zeros((steps, *x.shape), dtype=x.dtype, device=device) for x in stored)
            ),
            action=numbers(2),
            log_prob=numbers(),
            value=numbers(),
            next_value=numbers(),
            reward=numbers(),
            terminated=flags(),
            truncated=flags(),
        )

    @property
    def num_steps(self) -> int:
        """Environment steps held, over all worlds."""
        return self.reward.numel()


class Collector:
    """Steps the worlds with the current policy. Owns the latest observation, so rollouts leave no gap."""

    def __init__(self, env: VectorEnv, num_steps: int, sensors: str, reward_scale: float, device: torch.device) -> None:
        mode = env.metadata.get("autoreset_mode")
        require(mode == AutoresetMode.SAME_STEP, "the environment's autoreset_mode", mode, "AutoresetMode.SAME_STEP")
        self.env = env
        self.sensors = sensors
        self.reward_scale = reward_scale
        self.device = device
        self.num_steps = num_steps
        self.observation: Observation | None = None
        self._storage: Rollout | None = None

    def reset(self, seed: int) -> None:
        """Start all worlds afresh."""
        observation, _ = self.env.reset(seed=seed)
        self.observation = self._masked(observation, copy=True)

    def collect(
        self,
        network: ActorCritic,
        generator: torch.Generator,
        on_step: Callable[[], None] = lambda: None,
    ) -> Rollout:
        """One rollout. The tensors returned are reused by the next call.

        Args:
            network: acts and values; not changed.
            generator: source of the actions' noise, on the collector's device.
            on_step: called after each step of all worlds, for progress.
        """
        if self.observation is None:
            raise RuntimeError("Collector.reset must be called before Collector.collect")
        if self._storage is None:
            self._storage = Rollout.allocate(self.num_steps, self.observation, self.device)
        rollout = self._storage
        rollout.episodes = Episodes()
        terms: dict[str, float] = {}
        final_places: list[tuple[int, int]] = []
        final_observations: list[Observation] = []
        with torch.no_grad():
            for t in range(self.num_steps):
                for stored, array in zip(rollout.observation, self.observation, strict=True):
                    stored[t].copy_(torch.from_numpy(array))
                output = network(ObservationTensors(*(stored[t] for stored in rollout.observation)))
                policy = DiagonalGaussian(output.mean, network.log_std)
                action = policy.sample(generator)
                rollout.action[t] = action
                rollout.log_prob[t] = policy.log_prob(action)
                rollout.value[t] = output.value

                observation, reward, terminated, truncated, infos = self.env.step(action.cpu().numpy())
                rollout.reward[t] = torch.from_numpy(np.asarray(reward, dtype=np.float32)) * self.reward_scale
                rollout.terminated[t] = torch.from_numpy(np.asarray(terminated))
                rollout.truncated[t] = torch.from_numpy(np.asarray(truncated))
                for name, values in infos.get("reward_terms", {}).items():
                    terms[name] = terms.get(name, 0.0) + float(np.mean(values))
                for n in np.flatnonzero(truncated & ~terminated):
                    final_places.append((t, int(n)))
                    final_observations.append(self._masked(_add_axis(infos["final_obs"][n]), copy=True))
                _record_episodes(rollout.episodes, infos)
                self.observation = self._masked(observation, copy=False)
                on_step()

            # The environment reuses its buffers: what must outlast the next step, across rollouts too, is copied.
            self.observation = Observation(*(array.copy() for array in self.observation))
            rollout.next_value[:-1] = rollout.value[1:]
            rollout.next_value[-1] = network.value(self._to_device(self.observation))
            if final_places:
                joined = Observation(*(np.concatenate(arrays) for arrays in zip(*final_observations, strict=True)))
                times, worlds = (
                    torch.tensor(indices, device=self.device) for indices in zip(*final_places, strict=True)
                )
                rollout.next_value[times, worlds] = network.value(self._to_device(joined))
        rollout.reward_terms = {name: total / self.num_steps for name, total in terms.items()}
        return rollout

    def _to_device(self, observation: Observation) -> ObservationTensors:
        return ObservationTensors(*(torch.from_numpy(array).to(self.device) for array in observation))

    def _masked(self, observation: dict[str, Any], copy: bool) -> Observation:
        arrays = (observation[name] for name in Observation._fields)
        return mask_observation(Observation(*(np.array(a) if copy else np.asarray(a) for a in arrays)), self.sensors)


def explained_variance(value: Float[Tensor, "T N"], returns: Float[Tensor, "T N"]) -> float:
    """1 - Var(returns - value) / Var(returns): 1 is a perfect critic, 0 one that knows only the mean."""
    variance = returns.var()
    return float(1.0 - (returns - value).var() / variance) if variance > 0 else float("nan")


def _add_axis(observation: dict[str, Any]) -> dict[str, Any]:
    return {name: np.asarray(array)[None] for name, array in observation.items()}


def _record_episodes(episodes: Episodes, infos: dict[str, Any]) -> None:
    if "episode" not in infos:
        return
    ended = infos["episode"]
    for n in np.flatnonzero(infos["_episode"]):
        episodes.scenario.append(str(ended["scenario"][n]))
        episodes.success.append(bool(ended["success"][n]))
        episodes.collision.append(bool(ended["collision"][n]))
        episodes.total_reward.append(float(ended["return"][n]))
        episodes.length.append(int(ended["length"][n]))
