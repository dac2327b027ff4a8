"""Where the benchmark's work is done: in this process, on this machine's cores, or on a Ray cluster. Always the same
results: an engine hands out work and brings it back, in whatever order."""

from __future__ import annotations

import logging
import multiprocessing
import signal
from collections.abc import Callable, Iterable, Iterator
from concurrent.futures import ProcessPoolExecutor, as_completed
from contextlib import contextmanager
from typing import Any, Protocol, TypeVar, runtime_checkable

from densecavoid.frames import require

TaskT = TypeVar("TaskT")
ResultT = TypeVar("ResultT")


@runtime_checkable
class Engine(Protocol):
    """Does tasks."""

    @property
    def threads(self) -> int:
        """For the simulator of a task, as in SimConfig: 0 takes all cores."""
        ...

    def map(self, function: Callable[[TaskT], ResultT], tasks: Iterable[TaskT]) -> Iterator[tuple[TaskT, ResultT]]:
        """Each task with its result, as they come. Functions and tasks must be importable elsewhere."""
        ...


class _Here:
    threads = 0

    def map(self, function: Callable[[Any], Any], tasks: Iterable[Any]) -> Iterator[tuple[Any, Any]]:
        for task in tasks:
            yield task, function(task)


class _Processes:
    threads = 1

    def __init__(self, pool: ProcessPoolExecutor) -> None:
        self._pool = pool

    def map(self, function: Callable[[Any], Any], tasks: Iterable[Any]) -> Iterator[tuple[Any, Any]]:
        waiting = {self._pool.submit(function, task): task for task in tasks}
        for future in as_completed(waiting):
            yield waiting[future], future.result()


class _Ray:
    threads = 1

    def __init__(self, ray: Any) -> None:
        self._ray = ray

    def map(self, function: Callable[[Any], Any], tasks: Iterable[Any]) -> Iterator[tuple[Any, Any]]:
        # A task that dies with its node is done again on another one.
        remote = self._ray.remote(num_cpus=1, max_retries=3)(function)
        waiting = {remote.remote(task): task for task in tasks}
        while waiting:
            (done,), _ = self._ray.wait(list(waiting), num_returns=1)
            yield waiting.pop(done), self._ray.get(done)


@contextmanager
def open_engine(workers: int, ray_address: str | None = None) -> Iterator[Engine]:
    """An engine, which is closed again at the end.

    Args:
        workers: Processes on this machine; one works in this process, with all cores for the simulator.
        ray_address: Of a Ray cluster instead: `auto` for the one that this machine belongs to, `local` for one of this
            machine alone, or HOST:PORT. Its machines need the same version of this package, and the same recordings
            at the same place.

    Raises:
        ValueError: when Ray is not installed, or there is no such cluster.
    """
    require(workers >= 1, "workers", workers, "at least 1")
    if ray_address is not None:
        try:
            import ray  # pyright: ignore[reportMissingImports] # an extra
        except ModuleNotFoundError:
            raise ValueError("--ray needs Ray: pip install 'densecavoid[cluster]'") from None
        try:
            ray.init(address=ray_address, log_to_driver=False, logging_level=logging.WARNING)
        except ConnectionError as error:
            raise ValueError(f"no Ray cluster at {ray_address!r}: {error}") from None
        try:
            yield _Ray(ray)
        finally:
            ray.shutdown()
        return
    if workers == 1:
        yield _Here()
        return
    # `spawn`, because Numba's and ONNX Runtime's threads do not survive a fork.
    context = multiprocessing.get_context("spawn")
    pool = ProcessPoolExecutor(workers, mp_context=context, initializer=_die_on_interrupt)
    try:
        yield _Processes(pool)
    except BaseException:
        pool.shutdown(wait=False, cancel_futures=True)
        raise
    pool.shutdown()


def _die_on_interrupt() -> None:
    """Ctrl-C reaches the workers too; the parent says what happened, they need not."""
    signal.signal(signal.SIGINT, signal.SIG_DFL)
