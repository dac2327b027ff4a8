"""In what order samples are learned from. The order is drawn over the samples of all processes, each of which then
takes those that it holds, so that it does not depend on how many processes there are.
"""

from __future__ import annotations

from collections.abc import Iterator
from typing import NamedTuple

import torch
from jaxtyping import Bool, Int64
from torch import Tensor

from densecavoid.learning.peers import Peers
from densecavoid.learning.rollout import Rollout


class Minibatch(NamedTuple):
    """Samples of one gradient step."""

    own: Int64[Tensor, "n"]
    """This process' part of them: indices into its flattened rollout."""
    size: int
    """How many there are in all processes."""
    other_half: Bool[Tensor, "n"]
    """A half of all samples, the other one in the next pass."""


def minibatches(
    rollout: Rollout, epochs: int, size: int, generator: torch.Generator, peers: Peers
) -> Iterator[Minibatch]:
    """Passes over the samples of all processes, each in a new order.

    Args:
        rollout: of this process.
        epochs: number of passes.
        size: about so many samples of all processes in a minibatch.
        generator: in the same state in all processes, on the rollout's device.
        peers: the processes.
    """
    device, N = rollout.reward.device, rollout.num_worlds
    total = N * peers.count
    samples = rollout.num_steps * peers.count
    count = max(1, round(samples / size))
    for epoch in range(epochs):
        order = torch.randperm(samples, generator=generator, device=device)
        for index in order.tensor_split(count):
            # Samples are numbered step by step, world by world, over the worlds of all processes.
            time, world = index // total, index % total
            own, other_half = index, (time + world + epoch) % 2 == 1
            if peers.count > 1:
                held = world // N == peers.rank
                own, other_half = (time * N + world % N)[held], other_half[held]
            yield Minibatch(own, len(index), other_half)
