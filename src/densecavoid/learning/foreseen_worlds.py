"""The worlds of guided training: drawn by number, each with the value field of somebody who knows its future.

Worlds are built in other processes ahead of their use, and handed out by number, so that a run does not depend on how
fast they are built. A field holds for every start in its world: many episodes begin somewhere else than the scenario's.
"""

from __future__ import annotations

import math
import multiprocessing
import signal
from collections import deque
from collections.abc import Sequence
from concurrent.futures import Future, ProcessPoolExecutor
from dataclasses import dataclass, field, replace
from typing import Any

import numpy as np

from densecavoid.foresight.future import foresee, unheeding
from densecavoid.foresight.value_field import FieldConfig, FieldStack, ValueField, value_field
from densecavoid.frames import require
from densecavoid.scenarios import TRAINING
from densecavoid.sim._jit import available_threads
from densecavoid.sim.config import SimConfig
from densecavoid.sim.spec import WorldSpec

_STARTS, _WORTH_STARTING = 12, 0.15
_FROM_PERSON_M, _FROM_GOAL_M = 0.75, 1.0
"""Episodes begin at least so far from a person's middle, and from the goal."""
_APPEARED_AHEAD_M = (2.5, 5.5)
_BYTES_A_NUMBER = 2


@dataclass(frozen=True)
class ForesightConfig:
    """Guided training: worlds whose future is known to whoever rewards the policy, though not to the policy."""

    steps: int = 0
    """Environment steps for which the policy learns directly what each command is worth, before PPO; 0: not guided, the
    paper's reward and curriculum."""
    discount: float = 0.9975
    """Of a control step, in place of `ppo.discount`, which weighs the paper's reward."""
    worlds: int = 320
    """How many are held at once."""
    memory_mb: int = 3_500
    """The most that their values may take."""
    renewed: int = 2
    """Of them, the oldest, replaced after each rollout."""
    shares: tuple[float, float, float, float] = (0.06, 0.34, 0.22, 0.38)
    """Of the four stages' scenarios among the worlds."""
    levels: tuple[float, float] = (0.3, 1.0)
    """Between these lies each world's difficulty. From .6 on, test worlds were met less well (docs/training.md)."""
    own_starts: float = 0.5
    """Share of episodes that begin where the scenario says; the others begin anywhere."""
    processes: int = 0
    """That build worlds; 0: one for each core."""
    first_std: tuple[float, float] = (0.25, 0.2)
    """Standard deviations (m/s, rad/s) of what is tried at the beginning,"""
    last_std: tuple[float, float] = (0.15, 0.12)
    """and at the end of these steps."""
    epochs: int = 2
    """Passes over each rollout in these steps."""
    learning_rate: float = 7e-4
    """In these steps; it sinks to half."""
    evenness: float = 0.1
    """Situations in which commands differ by less than this count less."""
    values: FieldConfig = field(default_factory=FieldConfig)

    def __post_init__(self) -> None:
        require(self.steps >= 0, "ForesightConfig.steps", self.steps, "0 or more")
        require(0 < self.discount <= 1, "ForesightConfig.discount", self.discount, "in (0, 1]")
        for name in ("worlds", "memory_mb", "learning_rate", "evenness", "epochs"):
            require(getattr(self, name) > 0, f"ForesightConfig.{name}", getattr(self, name), "positive")
        for name in ("renewed", "processes"):
            require(getattr(self, name) >= 0, f"ForesightConfig.{name}", getattr(self, name), "0 or more")
        require(
            min(self.shares) >= 0 and sum(self.shares) > 0,
            "ForesightConfig.shares",
            self.shares,
            "not negative, some above 0",
        )
        low, high = self.levels
        require(0 <= low <= high <= 1, "ForesightConfig.levels", self.levels, "two in [0, 1], in order")
        require(0 <= self.own_starts <= 1, "ForesightConfig.own_starts", self.own_starts, "in [0, 1]")
        for name in ("first_std", "last_std"):
            require(min(getattr(self, name)) > 0, f"ForesightConfig.{name}", getattr(self, name), "positive")

    def std(self, steps_done: int) -> tuple[float, float]:
        """Standard deviations (m/s, rad/s) after so many environment steps."""
        done = min(1.0, steps_done / self.steps)
        first, last = self.first_std, self.last_std
        return (1 - done) * first[0] + done * last[0], (1 - done) * first[1] + done * last[1]


@dataclass(frozen=True)
class AnyStage:
    """All training scenarios at any level, with those who would appear suddenly standing there from the start."""

    shares: tuple[float, ...]
    levels: tuple[float, float]

    @property
    def name(self) -> str:
        return "any-stage"

    def spawn(self, rng: np.random.Generator) -> WorldSpec:
        share = np.array(self.shares) / sum(self.shares)
        stage = tuple(TRAINING.values())[int(rng.choice(len(share), p=share))]
        spec = stage.at_level(float(rng.uniform(*self.levels))).spawn(rng)
        if spec.appearance is None:
            return spec
        # Where they appear depends on the robot's way; to one that starts near them they have just appeared.
        pos = spec.crowd.pos.copy()
        pos[:, 0] = spec.start_pose[0] + rng.uniform(*_APPEARED_AHEAD_M)
        facing = np.full(len(pos), math.pi)
        return replace(spec, crowd=replace(spec.crowd, pos=pos, goal=pos, heading_rad=facing), appearance=None)


@dataclass(frozen=True)
class ForeseenWorld:
    """A world with its field, and where episodes in it may begin."""

    number: int
    spec: WorldSpec
    random_state: dict[str, Any]
    """Of the generator after it drew the world: what comes after it decides what people do."""
    field: ValueField
    starts: list[tuple[float, float, float]]


def _leave_stopping_to_the_run() -> None:
    """A terminal's Ctrl-C reaches all processes: the run saves first, and needs its builders for that."""
    for number in (signal.SIGINT, signal.SIGTERM):
        signal.signal(number, signal.SIG_IGN)


def build_world(seed: int, number: int, config: ForesightConfig, sim: SimConfig) -> ForeseenWorld:
    """The world of that number; drawn again until there is somewhere to begin."""
    worlds = AnyStage(config.shares, config.levels)
    sim = replace(sim, threads=1)
    values = replace(config.values, discount=config.discount ** (config.values.hold_s / sim.control_dt_s))
    for attempt in range(100):
        drawn = int(np.random.SeedSequence([seed, number, attempt]).generate_state(1, np.uint64)[0] >> np.uint64(1))
        try:
            (future,) = foresee(worlds, [drawn], sim)
            rng = np.random.default_rng(drawn)
            spec = worlds.spawn(rng)
            known = value_field(spec, future.bodies, sim, values)
        except ValueError:
            continue  # no room for so many people and things
        poses = known.free_poses(np.random.default_rng([seed, number]), 10 * _STARTS, _WORTH_STARTING)
        starts = [pose for pose in poses if _may_begin(pose, spec)][:_STARTS]
        if starts:
            return ForeseenWorld(number, spec, dict(rng.bit_generator.state), known, starts)
    raise ValueError(f"none of 100 worlds with shares {config.shares} and levels {config.levels} has a place to begin")


def _may_begin(pose: tuple[float, float, float], spec: WorldSpec) -> bool:
    people = spec.crowd.pos
    near = len(people) > 0 and np.hypot(*(people - pose[:2]).T).min() < _FROM_PERSON_M
    return not near and math.dist(pose[:2], spec.goal) > _FROM_GOAL_M


class ForeseenWorlds:
    """Holds worlds in numbered slots, and replaces the oldest. Itself a scenario, which draws among them.

    Environments of one process share it: which slots their worlds came from stands in `drawn`, in the order of drawing.
    """

    name = "foreseen"

    def __init__(self, config: ForesightConfig, sim: SimConfig, seed: int) -> None:
        """Starts to build; `fill` waits for it."""
        self.config = config
        self.sim = unheeding(sim)
        self.seed = seed
        self.fields = FieldStack(config.worlds, config.memory_mb * 1024 * 1024 // _BYTES_A_NUMBER, sim, config.values)
        self.drawn: deque[int] = deque()
        self._held: list[ForeseenWorld | None] = [None] * config.worlds
        self._next_number = self._next_slot = 0
        # Not forked: a copy of a process with threads may hang.
        self._builders = ProcessPoolExecutor(
            config.processes or available_threads(),
            mp_context=multiprocessing.get_context("spawn"),
            initializer=_leave_stopping_to_the_run,
        )
        self._building: deque[Future[ForeseenWorld]] = deque()

    def fill(self) -> None:
        """Builds the first worlds."""
        self._take(range(self.config.worlds))

    def renew(self) -> None:
        """Replaces the oldest."""
        self._take([(self._next_slot + k) % self.config.worlds for k in range(self.config.renewed)])

    def spawn(self, rng: np.random.Generator) -> WorldSpec:
        """One of the worlds, with a start."""
        slot = int(rng.integers(self.config.worlds))
        world = self._held[slot]
        assert world is not None
        start = world.spec.start_pose
        if rng.random() >= self.config.own_starts:
            start = world.starts[int(rng.integers(len(world.starts)))]
        self.drawn.append(slot)
        rng.bit_generator.state = world.random_state
        return replace(world.spec, start_pose=start)

    def state_dict(self) -> dict[str, Any]:
        """Which worlds are held; they are built anew on loading."""
        return {
            "numbers": [world.number for world in self._held if world is not None],
            "next_number": self._next_number - len(self._building),
            "next_slot": self._next_slot,
        }

    def load_state_dict(self, state: dict[str, Any]) -> None:
        """Builds the worlds that were held."""
        building = [self._submit(int(number)) for number in state["numbers"]]
        for slot, world in enumerate(building):
            self._put(slot, world.result())
        self._building.clear()
        self._next_number, self._next_slot = int(state["next_number"]), int(state["next_slot"])

    def close(self) -> None:
        """Ends the processes that build."""
        self._builders.shutdown(wait=False, cancel_futures=True)

    def _take(self, slots: Sequence[int]) -> None:
        """Puts the next worlds into these slots, and has as many more built meanwhile."""
        while len(self._building) < len(slots):
            self._order()
        for slot in slots:
            self._put(slot, self._building.popleft().result())
            self._next_slot = (slot + 1) % self.config.worlds
        for _ in range(self.config.renewed):
            self._order()

    def _order(self) -> None:
        self._building.append(self._submit(self._next_number))
        self._next_number += 1

    def _submit(self, number: int) -> Future[ForeseenWorld]:
        return self._builders.submit(build_world, self.seed, number, self.config, self.sim)

    def _put(self, slot: int, world: ForeseenWorld) -> None:
        try:
            self.fields.put(slot, world.field)
        except MemoryError as error:
            held, room = self.config.worlds, self.config.memory_mb
            raise MemoryError(f"{error}: hold fewer than {held} worlds, or raise memory_mb from {room}") from error
        # The field is in the stack now.
        self._held[slot] = replace(world, field=ValueField(world.field.values[:0], world.field.grid))
