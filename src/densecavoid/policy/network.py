"""The four-branch network of the paper (Fig. 3) and a compact one of the same plan, as torch modules. Neither sampling
nor losses: those are in `distribution` and `densecavoid.learning`.

Inputs are the arrays of `frames.Observation` as they are stored (uint8 images), so that what crosses memory stays
small; scaling to order one happens inside and therefore also inside every exported file:

- camera / 255 (nearness), (255 - prediction) / 255 (a person is 1, an empty frame is all 0),
- goal distance / 5 m, at most 2 (10 m: farther than anything is seen); goal bearing in radians as it is,
- velocities as fractions of the robot's limits,
- what commands are worth as it is, and as exp(-loss / scale) of the loss against the best on several scales.
"""

from __future__ import annotations

import math
from typing import NamedTuple

import torch
from jaxtyping import Float32
from torch import Tensor, nn

from densecavoid.frames import COMMAND_GRID, require
from densecavoid.policy.distribution import DiagonalGaussian, GridChoice
from densecavoid.policy.encoder import Encoder, ObservationTensors, PeopleEncoder, feed, linears
from densecavoid.policy.moments import RunningMoments
from densecavoid.policy.network_config import (
    PRESETS,
    ConvConfig,
    NetworkConfig,
    count_mflop,
)

__all__ = [
    "PRESETS",
    "ActorCritic",
    "ConvConfig",
    "NetworkConfig",
    "ObservationTensors",
    "PolicyOutput",
    "count_mflop",
    "count_parameters",
    "preferred_dtype",
]

_GOAL_DISTANCE_SCALE_M = 5.0
_GOAL_DISTANCE_LIMIT = 2.0


class PolicyOutput(NamedTuple):
    """What one pass gives."""

    policy: DiagonalGaussian | GridChoice
    """Of commands (v m/s, w rad/s)."""
    value: Float32[Tensor, "B"]
    """Expected return, in units of the scaled reward."""


class ActorCritic(nn.Module):
    """The policy and the critic.

    The policy is a Gaussian with the same standard deviation in every state, or chooses among `COMMAND_GRID`: then the
    probability of a command falls with what it is worth less than the best, and the network corrects that.
    """

    def __init__(self, config: NetworkConfig) -> None:
        super().__init__()
        self.config = config
        self.actor_encoder = Encoder(config)
        self.critic_encoder = None if config.shared_encoder else Encoder(config)
        self.people_encoder = PeopleEncoder(config) if config.privileged else None
        features, told = self.actor_encoder.num_features, config.people_features
        self.actor_hidden = linears(features + (told if config.people == "actor" else 0), (config.head_features,))
        self.critic_hidden = linears(features + (told if config.privileged else 0), (config.head_features,))
        self.actor_output = nn.Linear(config.head_features, len(COMMAND_GRID) if config.chooses else 2)
        self.critic_output = nn.Linear(config.head_features, 1)
        self.log_std = None if config.chooses else nn.Parameter(torch.tensor(config.initial_std).log())
        self.range_moments = RunningMoments(config.num_rays) if config.normalise_inputs else None
        self.state_moments = RunningMoments(config.num_state_features) if config.normalise_inputs else None
        self.value_moments = RunningMoments(1) if config.normalise_values else None
        self.register_buffer("min_log_std", torch.tensor(config.min_std).log(), persistent=False)
        self.min_log_std: Tensor
        self.register_buffer(
            "limits", torch.tensor([config.max_linear_velocity, config.max_angular_velocity]), persistent=False
        )
        self.limits: Tensor
        grid = torch.tensor(COMMAND_GRID, dtype=torch.float32) * self.limits
        self.register_buffer("grid", grid, persistent=False)
        self.grid: Tensor
        for module in self.modules():
            if isinstance(module, nn.Conv1d | nn.Conv2d | nn.Linear):
                nn.init.orthogonal_(module.weight, math.sqrt(2.0))
                nn.init.zeros_(module.bias)  # type: ignore[arg-type]
        # A small last layer makes the first policy the same everywhere, so that no input is favoured by chance.
        nn.init.orthogonal_(self.actor_output.weight, 0.01)
        nn.init.orthogonal_(self.critic_output.weight, 1.0)

    def forward(
        self, observation: ObservationTensors, people: Float32[Tensor, "B K numbers"] | None = None
    ) -> PolicyOutput:
        """Policy and value, in one pass of the encoder where it is shared.

        Args:
            observation: what the sensors give.
            people: the true people, where the configuration is privileged.
        """
        ranges, state = self.numbers(observation)
        told = self._told(people)
        features = self.actor_encoder(observation, ranges, state)
        critic_features = features if self.critic_encoder is None else self.critic_encoder(observation, ranges, state)
        policy = self._policy(features, observation.worth, told)
        return PolicyOutput(policy, self._value(critic_features, told))

    def command(
        self, observation: ObservationTensors, people: Float32[Tensor, "B K numbers"] | None = None
    ) -> Float32[Tensor, "B 2"]:
        """The likeliest command (v m/s, w rad/s) alone."""
        return self.policy(observation, people).mode

    def policy(
        self, observation: ObservationTensors, people: Float32[Tensor, "B K numbers"] | None = None
    ) -> DiagonalGaussian | GridChoice:
        """The policy alone: what a robot runs."""
        told = self._told(people) if self.config.people == "actor" else None
        features = self.actor_encoder(observation, *self.numbers(observation))
        return self._policy(features, observation.worth, told)

    def value(
        self, observation: ObservationTensors, people: Float32[Tensor, "B K numbers"] | None = None
    ) -> Float32[Tensor, "B"]:
        """The critic alone."""
        encoder = self.critic_encoder or self.actor_encoder
        return self._value(encoder(observation, *self.numbers(observation)), self._told(people))

    def numbers(
        self, observation: ObservationTensors
    ) -> tuple[Float32[Tensor, "B scans rays"], Float32[Tensor, "B state"]]:
        """Ranges, and goal and velocity, scaled to order one and normalised where the configuration says so."""
        ranges, state = self.raw_numbers(observation)
        if self.range_moments is not None and self.state_moments is not None:
            ranges, state = self.range_moments.normalise(ranges), self.state_moments.normalise(state)
        return ranges, self.config.state_gain * state

    def raw_numbers(
        self, observation: ObservationTensors
    ) -> tuple[Float32[Tensor, "B scans rays"], Float32[Tensor, "B state"]]:
        """What the running moments of the inputs are taken of."""
        lidar, falloff = observation.lidar.float(), self.config.lidar_falloff
        ranges = torch.exp(-falloff * lidar) if falloff > 0 else lidar
        distance = (observation.goal[:, :1] / _GOAL_DISTANCE_SCALE_M).clamp(max=_GOAL_DISTANCE_LIMIT)
        bearing = observation.goal[:, 1:]
        direction = (bearing.cos(), bearing.sin()) if self.config.goal_direction else (bearing,)
        return ranges, torch.cat([distance, *direction, observation.velocity / self.limits], dim=1)

    def _told(self, people: Tensor | None) -> Tensor | None:
        if self.people_encoder is None:
            return None
        require(people is not None, "people", None, f"the true people, for people={self.config.people!r}")
        return self.people_encoder(people)

    def _policy(self, features: Tensor, worth: Tensor, told: Tensor | None) -> DiagonalGaussian | GridChoice:
        if told is not None and self.config.people == "actor":
            features = torch.cat([features, told], dim=1)
        raw = self.actor_output(feed(features, self.actor_hidden))
        if self.log_std is None:
            lost = worth.amax(dim=1, keepdim=True) - worth
            return GridChoice(torch.log_softmax(raw - lost / self.config.indifference, dim=1), self.grid)
        linear = self.config.max_linear_velocity * torch.sigmoid(raw[:, :1])
        angular = self.config.max_angular_velocity * torch.tanh(raw[:, 1:])
        return DiagonalGaussian(torch.cat([linear, angular], dim=1), self.log_std)

    def _value(self, features: Tensor, told: Tensor | None) -> Tensor:
        if told is not None:
            features = torch.cat([features, told], dim=1)
        value = self.critic_output(feed(features, self.critic_hidden)).squeeze(1)
        if self.value_moments is not None:
            value = self.value_moments.restore(value)
        return value

    def follow_returns(self, count: Tensor, mean: Tensor, variance: Tensor) -> None:
        """Takes the moments of new returns (each [1], over all processes) into those of the critic, whose last layer is
        rescaled so that it goes on giving the same values (van Hasselt et al. 2016, Pop-Art).
        """
        moments = self.value_moments
        if moments is None:
            return
        old_mean, old_std = moments.mean.clone(), moments.std.clone()
        moments.merge(count, mean, variance)
        with torch.no_grad():
            self.critic_output.weight.mul_(old_std / moments.std)
            self.critic_output.bias.mul_(old_std).add_(old_mean - moments.mean).div_(moments.std)

    def set_std(self, std: tuple[float, float]) -> None:
        """The Gaussian's standard deviations (m/s, rad/s), as they are from now on. A choice has none to set."""
        if self.log_std is not None:
            with torch.no_grad():
                self.log_std.copy_(torch.tensor(std).log())

    def raise_std_to_floor(self) -> None:
        """Call after each optimiser step. A clamp in the forward pass would cut the gradient that could raise it."""
        if self.log_std is not None:
            with torch.no_grad():
                self.log_std.copy_(torch.maximum(self.log_std, self.min_log_std))

    def set_compute_dtype(self, dtype: torch.dtype) -> None:
        """Precision of the branches' arithmetic (weights, heads and losses stay float32)."""
        for encoder in self.encoders:
            encoder.compute_dtype = dtype

    def set_patch_products(self, enabled: bool) -> None:
        """See `Encoder`."""
        for encoder in self.encoders:
            encoder.patch_products = enabled

    @property
    def encoders(self) -> list[Encoder]:
        return [self.actor_encoder] if self.critic_encoder is None else [self.actor_encoder, self.critic_encoder]


def count_parameters(config: NetworkConfig) -> int:
    """Weights and biases of what the robot runs: branches, head and mean (no critic)."""
    with torch.device("meta"):
        network = ActorCritic(config)
    actor = [network.actor_encoder, network.actor_hidden, network.actor_output]
    if config.people == "actor" and network.people_encoder is not None:
        actor.append(network.people_encoder)
    return sum(parameter.numel() for module in actor for parameter in module.parameters())


def preferred_dtype(device: torch.device) -> torch.dtype:
    """bfloat16 where the processor multiplies it natively (AVX-512 BF16, AMX, CUDA), float32 elsewhere."""
    if device.type == "cuda":
        return torch.bfloat16 if torch.cuda.is_bf16_supported() else torch.float32
    return torch.bfloat16 if torch.cpu.get_capabilities().get("avx512_bf16", False) else torch.float32
