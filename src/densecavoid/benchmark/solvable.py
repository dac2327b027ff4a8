"""Which test worlds can be solved at all: judged once by the planner, kept in the user's cache, the same for everybody.

A navigator is measured on the first worlds of a scenario that the planner finds a way through (BENCHMARK).
"""

from __future__ import annotations

import hashlib
import json
import os
from collections.abc import Callable, Iterable, Sequence
from dataclasses import dataclass, replace
from functools import cache
from pathlib import Path

import numpy as np

from densecavoid.benchmark.metrics import DEFINITION
from densecavoid.foresight.planner import Judgement, Plan, judge_worlds
from densecavoid.frames import require
from densecavoid.scenarios.recorded import Hermes, TrackFile
from densecavoid.scenarios.recordings import hermes_path
from densecavoid.sim._jit import source_digest, user_cache
from densecavoid.sim.config import SimConfig
from densecavoid.sim.spec import Scenario

WORLDS_PER_TASK = 10
TRIES_PER_WORLD = 5
"""A scenario of which fewer than one world in so many can be solved gives fewer worlds than were asked for."""

Seeds = tuple[int, ...]
JudgeMany = Callable[[Scenario, Sequence[Seeds], SimConfig], Iterable[tuple[Seeds, list[Judgement]]]]
"""Judges many shares of worlds, in any order, on whatever engine."""


@dataclass(frozen=True)
class Admission:
    """The worlds of a scenario that navigators are measured on."""

    seeds: Seeds
    tried: int
    """Worlds that were judged to find them; all of them where nothing is left out."""
    filtered: bool
    """Whether worlds without a way were left out."""
    solved: int
    """Of the tried."""
    judgements: dict[int, Judgement]
    """Of each of `seeds`."""

    @property
    def share(self) -> float:
        """Of worlds that the planner finds a way through."""
        return self.solved / self.tried


def plain(scenario: Scenario) -> Scenario:
    """The same worlds with people who do not react."""
    if isinstance(scenario, Hermes | TrackFile) and scenario.reactive:
        return replace(scenario, reactive=False)
    return scenario


def is_filtered(scenario: Scenario, config: SimConfig) -> bool:
    """Whether only solvable worlds count: always, but among recorded people who make way (BENCHMARK, Real crowds)."""
    if isinstance(scenario, Hermes | TrackFile):
        return not scenario.reactive and config.people == "scripted"
    return True


def judge_here(
    scenario: Scenario, shares: Sequence[Seeds], config: SimConfig
) -> Iterable[tuple[Seeds, list[Judgement]]]:
    """One share after the other, in this process."""
    for seeds in shares:
        yield seeds, judge_worlds(scenario, seeds, config)


def admit(
    scenario: Scenario,
    config: SimConfig,
    first_seed: int,
    count: int,
    judge_many: JudgeMany = judge_here,
    on_worlds: Callable[[int], None] | None = None,
) -> Admission:
    """The first `count` worlds from `first_seed` on that can be solved.

    Args:
        scenario: Whose worlds.
        config: Whose pace, motion model, robot and clock count; that people react, or wheels slip, does not.
        first_seed: Worlds are tried one seed after the other.
        count: How many are wanted; fewer come where hardly any can be solved.
        judge_many: What does the work.
        on_worlds: Is told how many more worlds have been judged.
    """
    require(count >= 1, "count", count, "at least 1")
    filtered, judged = is_filtered(scenario, config), plain(scenario)
    folder = _folder(judged, config)
    known: dict[int, Judgement] = {}
    next_seed, limit = first_seed, first_seed + (TRIES_PER_WORLD * count if filtered else count)

    def good() -> list[int]:
        return [seed for seed in sorted(known) if not filtered or known[seed].plan is not None]

    while (missing := count - len(good())) > 0 and next_seed < limit:
        batch = range(next_seed, min(next_seed + missing, limit))
        next_seed = batch.stop
        unknown = []
        for seed in batch:
            judgement = _read(folder / f"{seed}.json")
            if judgement is None:
                unknown.append(seed)
            else:
                known[seed] = judgement
        if on_worlds is not None:
            on_worlds(len(batch) - len(unknown))
        shares = [tuple(unknown[k : k + WORLDS_PER_TASK]) for k in range(0, len(unknown), WORLDS_PER_TASK)]
        for seeds, judgements in judge_many(judged, shares, config) if shares else ():
            for seed, judgement in zip(seeds, judgements, strict=True):
                known[seed] = judgement
                _write(folder / f"{seed}.json", judgement)
            if on_worlds is not None:
                on_worlds(len(seeds))
    seeds = tuple(good()[:count])
    # How many were tried must not depend on how many were asked for at once.
    tried = [seed for seed in sorted(known) if len(seeds) < count or seed <= seeds[-1]]
    solved = sum(known[seed].plan is not None for seed in tried)
    return Admission(seeds, len(tried), filtered, solved, {seed: known[seed] for seed in seeds})


def judgement_of(scenario: Scenario, seed: int, config: SimConfig) -> Judgement:
    """What is known of one world; from the cache if it has been judged before."""
    judged = plain(scenario)
    path = _folder(judged, config) / f"{seed}.json"
    judgement = _read(path)
    if judgement is None:
        (judgement,) = judge_worlds(judged, [seed], config)
        _write(path, judgement)
    return judgement


@cache
def _versions() -> str:
    own = ("future", "lattice", "planner")
    return source_digest("sim", "scenarios", *(f"foresight/{name}.py" for name in own))


def _folder(scenario: Scenario, config: SimConfig) -> Path:
    """Where the judgements of these worlds are kept: another folder whenever anything that they depend on changes."""
    counts = (config.pace, config.motion, config.robot, config.control_dt_s, config.physics_dt_s)
    identity = hashlib.sha256(repr((DEFINITION, _versions(), scenario, counts)).encode())
    if isinstance(scenario, Hermes):
        identity.update(hermes_path(scenario.data, scenario.run).read_bytes())
    elif isinstance(scenario, TrackFile):
        identity.update(scenario.path.read_bytes())
    name = "".join(letter if letter.isalnum() or letter in "-." else "-" for letter in scenario.name)
    return user_cache() / "worlds" / f"{name}-{identity.hexdigest()[:16]}"


def _read(path: Path) -> Judgement | None:
    """None where there is no such file, or not a whole one."""
    try:
        kept = json.loads(path.read_text(encoding="utf-8"))
        plan = None
        if kept["time_s"] is not None:
            rows = np.array(kept["commands"], np.float64)
            plan = Plan(np.repeat(rows[:, :2], rows[:, 2].astype(int), axis=0), kept["time_s"])
        return Judgement(plan, kept["density_per_m2"])
    except (OSError, ValueError, KeyError, IndexError, TypeError):
        return None


def _write(path: Path, judgement: Judgement) -> None:
    """The old file or the new, never half of one, whoever else writes. That nothing can be kept is no failure."""
    rows: list[list[float]] = []
    for linear, angular in [] if judgement.plan is None else judgement.plan.commands.tolist():
        if rows and rows[-1][:2] == [linear, angular]:
            rows[-1][2] += 1
        else:
            rows.append([linear, angular, 1])
    kept = {
        "time_s": None if judgement.plan is None else judgement.plan.time_s,
        "density_per_m2": judgement.density_per_m2,
        "commands": rows,
    }
    partial = path.with_name(f"{path.name}.{os.getpid()}.part")
    try:
        path.parent.mkdir(parents=True, exist_ok=True)
        partial.write_text(json.dumps(kept), encoding="utf-8")
        os.replace(partial, path)
    except OSError:
        partial.unlink(missing_ok=True)
