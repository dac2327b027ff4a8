"""In what order samples are learned from. The order is drawn over the samples of all processes, each of which then
takes those that it holds, so that it does not depend on how many processes there are.
"""

from __future__ import annotations

from collections.abc import Iterator

import torch
from jaxtyping import Int64
from torch import Tensor

from densecavoid.learning.peers import Peers
from densecavoid.learning.rollout import Rollout


def minibatches(
    rollout: Rollout, epochs: int, size: int, generator: torch.Generator, peers: Peers
) -> Iterator[tuple[Int64[Tensor, "n"], int]]:
    """Passes over the samples of all processes, each in a new order.

    Args:
        rollout: of this process.
        epochs: number of passes.
        size: about so many samples of all processes in a minibatch.
        generator: in the same state in all processes, on the rollout's device.
        peers: the processes.

    Yields:
        This process' samples of the next minibatch (indices into its flattened rollout), and how many samples the
        minibatch has in all processes.
    """
    device, N = rollout.reward.device, rollout.num_worlds
    total = N * peers.count
    samples = rollout.num_steps * peers.count
    count = max(1, round(samples / size))
    for _ in range(epochs):
        order = torch.randperm(samples, generator=generator, device=device)
        for index in order.tensor_split(count):
            own = index
            if peers.count > 1:
                # Samples are numbered step by step, world by world, over the worlds of all processes.
                time, world = index // total, index % total - peers.rank * N
                held = (world >= 0) & (world < N)
                own = (time * N + world)[held]
            yield own, len(index)
