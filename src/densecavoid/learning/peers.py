"""The processes that train one policy together: what each must tell the others so that all decide alike. torchrun
starts them; one process alone is the same with nobody to tell.
"""

from __future__ import annotations

import os
from collections.abc import Callable, Iterator, Sequence
from contextlib import contextmanager
from dataclasses import dataclass
from datetime import timedelta
from typing import Any, TypeVar

import torch
import torch.distributed as dist
from jaxtyping import Float
from torch import Tensor

T = TypeVar("T")


class PeerLostError(RuntimeError):
    """Another process of the training no longer answers."""


@dataclass(frozen=True)
class Peers:
    """This process among `count` of them. All methods must be called by all processes, in the same order."""

    rank: int = 0
    count: int = 1

    @property
    def is_first(self) -> bool:
        """Whether this process writes files and talks to the user."""
        return self.rank == 0

    def sum(self, tensor: Tensor) -> Tensor:
        """The tensor summed over all processes, in place; the same bits everywhere.

        Raises:
            PeerLostError: if another process is gone.
        """
        if self.count > 1:
            self._ask(lambda: dist.all_reduce(tensor))
        return tensor

    def sum_gradients(self, parameters: Sequence[torch.nn.Parameter]) -> None:
        """Sums gradients over all processes, in one message; a parameter without one counts as zero."""
        if self.count == 1:
            return
        gradients = [p.grad if p.grad is not None else torch.zeros_like(p) for p in parameters]
        joined = self.sum(torch.cat([gradient.flatten() for gradient in gradients]))
        for parameter, gradient, total in zip(
            parameters, gradients, joined.split([gradient.numel() for gradient in gradients]), strict=True
        ):
            parameter.grad = total.view_as(gradient)

    def moments(self, x: Float[Tensor, "N *size"]) -> tuple[Tensor, Tensor, Tensor]:
        """Number [1], mean and variance [*size] (of the population) over all rows of all processes."""
        rows = x.double()
        size = rows[:1].numel()
        sums = torch.cat([rows.new_tensor([len(rows)]), rows.sum(0).flatten(), rows.square().sum(0).flatten()])
        self.sum(sums)
        count, total, squares = sums.split([1, size, size])
        mean = total / count
        variance = (squares / count - mean.square()).clamp(min=0)
        return count.float(), mean.float().view(x.shape[1:]), variance.float().view(x.shape[1:])

    def gather(self, value: T) -> list[T]:
        """Everybody's value, in the order of ranks; plain values and arrays."""
        if self.count == 1:
            return [value]
        values: list[Any] = [None] * self.count
        self._ask(lambda: dist.all_gather_object(values, value))
        return values

    def any(self, flag: bool) -> bool:
        """Whether it is true of some process."""
        return any(self.gather(flag)) if self.count > 1 else flag

    def _ask(self, call: Callable[[], object]) -> None:
        try:
            call()
        except RuntimeError as error:
            raise PeerLostError(
                f"process {self.rank} of {self.count} lost the others ({str(error).splitlines()[0]}): one of them "
                "has ended or can no longer be reached"
            ) from error


@contextmanager
def join_peers(device: torch.device, timeout_s: float = 600.0) -> Iterator[Peers]:
    """The processes that torchrun started (NCCL between GPUs, gloo else), or this one alone.

    Args:
        device: where tensors live.
        timeout_s: silence after which a peer counts as lost; longer than the longest rollout.
    """
    if int(os.environ.get("WORLD_SIZE", "1")) == 1:
        yield Peers()
        return
    backend = "nccl" if device.type == "cuda" else "gloo"
    if device.type == "cuda":
        torch.cuda.set_device(int(os.environ.get("LOCAL_RANK", "0")))
    dist.init_process_group(backend, timeout=timedelta(seconds=timeout_s))
    try:
        yield Peers(dist.get_rank(), dist.get_world_size())
    finally:
        dist.destroy_process_group()
