"""Experience: T steps of N worlds in preallocated tensors. No learning, and no environments: `collector` fills them."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, field
from operator import itemgetter
from typing import Any

import numpy as np
import torch
from jaxtyping import Bool, Float32
from torch import Tensor

from densecavoid.frames import Observation
from densecavoid.policy.network import ObservationTensors


@dataclass
class Episodes:
    """The episodes that ended during a rollout, in the order of step and world."""

    step: list[int] = field(default_factory=list)
    world: list[int] = field(default_factory=list)
    """Number among the worlds of all processes."""
    scenario: list[str] = field(default_factory=list)
    success: list[bool] = field(default_factory=list)
    collision: list[bool] = field(default_factory=list)
    total_reward: list[float] = field(default_factory=list)
    length: list[int] = field(default_factory=list)

    def record(self, step: int, first_world: int, infos: dict[str, Any]) -> None:
        """Takes in what a vector environment says about episodes that ended in this step."""
        if "episode" not in infos:
            return
        ended = infos["episode"]
        for n in np.flatnonzero(infos["_episode"]):
            self.step.append(step)
            self.world.append(first_world + int(n))
            self.scenario.append(str(ended["scenario"][n]))
            self.success.append(bool(ended["success"][n]))
            self.collision.append(bool(ended["collision"][n]))
            self.total_reward.append(float(ended["return"][n]))
            self.length.append(int(ended["length"][n]))

    @staticmethod
    def joined(parts: Sequence[Episodes]) -> Episodes:
        """All of them, in the order of step and world: the same whoever simulated which world."""
        rows = [row for part in parts for row in zip(*vars(part).values(), strict=True)]
        rows.sort(key=itemgetter(0, 1))
        columns = [list(column) for column in zip(*rows, strict=True)]
        return Episodes(*columns) if columns else Episodes()


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
    people: Float32[Tensor, "T N K numbers"] | None = None
    """The true people, for a privileged critic or a teacher."""
    teacher_mean: Float32[Tensor, "T N 2"] | None = None
    """What the teacher would have done, while there is one."""
    command_values: Float32[Tensor, "T N C"] | None = None
    """What each of a grid of commands was worth, in foreseen worlds."""
    episodes: Episodes = field(default_factory=Episodes)
    """Of all processes."""
    reward_terms: dict[str, float] = field(default_factory=dict)
    """Mean of each unscaled term a step."""

    @staticmethod
    def allocate(
        steps: int,
        observation: Observation,
        people: np.ndarray | None,
        device: torch.device,
        lidar_dtype: torch.dtype,
    ) -> Rollout:
        """Storage for `steps` steps of observations (all worlds of this process) like the given one."""
        N = observation.lidar.shape[0]

        def numbers(*shape: int) -> Tensor:
            return torch.zeros(steps, N, *shape, device=device)

        def flags() -> Tensor:
            return torch.zeros(steps, N, dtype=torch.bool, device=device)

        def like(name: str, array: np.ndarray) -> Tensor:
            dtype = lidar_dtype if name == "lidar" else torch.from_numpy(np.asarray(array)).dtype
            return torch.zeros((steps, *array.shape), dtype=dtype, device=device)

        return Rollout(
            observation=ObservationTensors(*(like(name, array) for name, array in observation._asdict().items())),
            action=numbers(2),
            log_prob=numbers(),
            value=numbers(),
            next_value=numbers(),
            reward=numbers(),
            terminated=flags(),
            truncated=flags(),
            people=None if people is None else numbers(*people.shape[1:]),
        )

    @property
    def num_steps(self) -> int:
        """Environment steps held, over all worlds of this process."""
        return self.reward.numel()

    @property
    def num_worlds(self) -> int:
        """N"""
        return self.reward.shape[1]

    def flat_observation(self) -> ObservationTensors:
        """Views with time and world as one axis."""
        return ObservationTensors(*(stored.flatten(0, 1) for stored in self.observation))


def take(
    observation: ObservationTensors, people: Tensor | None, index: Tensor
) -> tuple[ObservationTensors, Tensor | None]:
    """Those samples of flat observations and people."""
    batch = ObservationTensors(*(tensor.index_select(0, index) for tensor in observation))
    return batch, None if people is None else people.flatten(0, 1).index_select(0, index)
