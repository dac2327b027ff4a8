"""What the machine can do for training: threads, memory, arithmetic. Nothing here changes results beyond rounding."""

from __future__ import annotations

import ctypes
import os
import sys

import torch

from densecavoid.sim._jit import available_threads

_M_TRIM_THRESHOLD, _M_MMAP_THRESHOLD = -1, -3
_LARGEST_BLOCK = 32 * 2**20  # glibc takes no larger threshold


def keep_memory() -> bool:
    """Lets freed memory be used again instead of being handed back and asked for anew.

    A minibatch's activations are blocks of some megabytes, which glibc maps from the system and gives back each time:
    an update of the compact network then spends 40 % of its time in page faults.

    Returns:
        Whether the C library took it; others than glibc do well by themselves.
    """
    if not sys.platform.startswith("linux"):
        return False
    mallopt = getattr(ctypes.CDLL(None), "mallopt", None)
    return bool(
        mallopt and mallopt(_M_MMAP_THRESHOLD, _LARGEST_BLOCK) and mallopt(_M_TRIM_THRESHOLD, 16 * _LARGEST_BLOCK)
    )


def prepare(threads: int, device: torch.device) -> None:
    """Sets torch up for this process.

    Args:
        threads: of torch; 0 is an equal share of the cores among the processes of this machine.
        device: where the network lives.
    """
    keep_memory()
    local = int(os.environ.get("LOCAL_WORLD_SIZE", "1"))
    torch.set_num_threads(threads or max(1, available_threads() // local))
    if device.type == "cuda":
        torch.backends.cuda.matmul.allow_tf32 = True
        torch.backends.cudnn.allow_tf32 = True
