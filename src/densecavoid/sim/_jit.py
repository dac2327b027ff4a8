"""How hot loops are compiled and spread over threads: one cache for all kernels, one pool for all batches."""

from __future__ import annotations

import atexit
import hashlib
import itertools
import multiprocessing
import os
import subprocess
import sys
from collections.abc import Callable
from concurrent.futures import ThreadPoolExecutor
from functools import cache
from pathlib import Path
from typing import Any

import numba
import numpy as np

PACKAGE = Path(__file__).resolve().parents[1]


def source_digest(*parts: str) -> str:
    """Of the source of the package's rooms and files (`sim`, `foresight/planner.py`, ...): what was made by other
    versions of them is not to be used again."""
    source = hashlib.sha256()
    for part in parts:
        path = PACKAGE / part
        for file in sorted(path.rglob("*.py")) if path.is_dir() else [path]:
            source.update(file.read_bytes())
    return source.hexdigest()[:16]


def user_cache() -> Path:
    """The user's folder for what can be made again."""
    return Path(os.environ.get("XDG_CACHE_HOME") or Path.home() / ".cache") / "densecavoid"


def _cache_folder() -> Path:
    """Where compiled kernels are kept: one place a user, a folder for each version of the package's source.

    Numba looks only at a kernel's own file to see whether it changed, not at the files of the kernels it calls.
    """
    return user_cache() / f"kernels-{source_digest('sim', 'scenarios', 'perception', 'env')}"


_HELPER = "DENSECAVOID_COMPILES_SENSORS"

if not os.environ.get("NUMBA_CACHE_DIR"):
    numba.config.CACHE_DIR = str(_cache_folder())  # type: ignore[attr-defined]


def kernels_are_compiled() -> bool:
    """Whether an earlier process has compiled kernels of this version; the first use takes some seconds otherwise."""
    folder = Path(numba.config.CACHE_DIR)  # type: ignore[attr-defined]
    return folder.is_dir() and any(folder.rglob("kernels.advance*.nbc"))


@cache
def share_compilation() -> None:
    """At the very first use, says that compiling takes a while, and lets a second process compile what sensors and
    perception need while this one compiles how worlds move. It finds the result in the cache."""
    if kernels_are_compiled() or multiprocessing.parent_process() is not None or os.environ.get(_HELPER):
        return
    print("densecavoid: compiling for this machine, once: about half a minute.", file=sys.stderr, flush=True)
    if available_threads() > 1:
        command, nobody = [sys.executable, "-m", "densecavoid.compile_sensors"], subprocess.DEVNULL
        environment = os.environ | {_HELPER: "1", "NUMBA_CACHE_DIR": numba.config.CACHE_DIR}  # type: ignore[attr-defined]
        helper = subprocess.Popen(command, env=environment, stdin=nobody, stdout=nobody, stderr=nobody)
        atexit.register(helper.kill)


# NaN and infinity keep their meaning: rays that meet nothing are infinite, pixels without depth are NaN.
_FASTMATH = {"nsz", "arcp", "contract", "afn", "reassoc"}


_OPTIONS: dict[str, Any] = {
    "cache": True,
    "nogil": True,
    "fastmath": _FASTMATH,
    "error_model": "numpy",
    "no_cfunc_wrapper": True,
}
_VIEW_OPTIONS: dict[str, Any] = _OPTIONS | {"no_cpython_wrapper": True}
_INNER_OPTIONS: dict[str, Any] = _VIEW_OPTIONS | {"forceinline": True, "_nrt": False}


def kernel(function: Callable) -> Callable:
    """Compiles `function` for threads (it runs without the interpreter lock), with the result cached on disk."""
    return numba.njit(**_OPTIONS)(function)


def inner(function: Callable) -> Callable:
    """Compiles a function that only kernels call (Python must not) and that allocates nothing.

    Without a way in from Python it compiles faster, and without numba's reference counts it runs faster: counting each
    row of an array that is looked at takes longer than looking. It becomes part of its callers, because handing on a
    whole `WorldState` takes long too.
    """
    return numba.njit(**_INNER_OPTIONS)(function)


def views(function: Callable) -> Callable:
    """As `inner`, for functions that give out rows of arrays, which must be counted."""
    return numba.njit(**_VIEW_OPTIONS)(function)


@cache
def _pool(threads: int) -> ThreadPoolExecutor:
    return ThreadPoolExecutor(threads, thread_name_prefix="densecavoid")


_FEW_WORLDS = 3


def available_threads() -> int:
    """Cores this process may use."""
    return len(os.sched_getaffinity(0)) if hasattr(os, "sched_getaffinity") else os.cpu_count() or 1


def threads_for(which: np.ndarray, threads: int) -> int:
    """Threads for the marked worlds alone: to wake another one takes longer than to look at two or three worlds."""
    return threads if np.count_nonzero(which) > _FEW_WORLDS else 1


def for_worlds(function: Callable, num_worlds: int, threads: int, *args: object) -> None:
    """Runs `function(first, last, *args)` over all worlds, split evenly among `threads`.

    Worlds share nothing that is written, so the result does not depend on the number of threads.
    """
    threads = min(threads or available_threads(), num_worlds)
    if threads <= 1:
        function(0, num_worlds, *args)
        return
    bounds = [num_worlds * i // threads for i in range(threads + 1)]
    jobs = [_pool(threads - 1).submit(function, first, last, *args) for first, last in itertools.pairwise(bounds[1:])]
    function(bounds[0], bounds[1], *args)
    for job in jobs:
        job.result()
