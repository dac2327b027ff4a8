"""The worlds of guided training: drawn by number, each with the value field of somebody who knows its future.

Worlds are built in other processes ahead of their use, and handed out by number, so that a run does not depend on how
fast they are built. A field holds for every start in its world: many episodes begin somewhere else than the scenario's.
"""

from __future__ import annotations

import math
import multiprocessing
import signal
from collections import deque
from concurrent.futures import Future, ProcessPoolExecutor
from dataclasses import dataclass, field, replace
from typing import Any

import numpy as np

from densecavoid.foresight.future import foresee, unheeding
from densecavoid.foresight.value_field import FieldConfig, FieldStack, ValueField, value_field
from densecavoid.frames import require
from densecavoid.scenarios import TRAINING
from densecavoid.scenarios.mixture import Mixture
from densecavoid.scenarios.registry import TrainingScenario
from densecavoid.sim._jit import available_threads
from densecavoid.sim.config import SimConfig
from densecavoid.sim.spec import WorldSpec

_STARTS, _WORTH_STARTING = 12, 0.15
_FROM_PERSON_M, _FROM_GOAL_M = 0.75, 1.0
"""Episodes begin at least so far from a person's middle, and from the goal."""
_APPEARED_AHEAD_M = (2.5, 5.5)
_TRIES = 100
_BYTES_A_NUMBER = 2


@dataclass(frozen=True)
class ForesightConfig:
    """Guided training: worlds whose future is known to whoever rewards the policy, though not to the policy."""

    steps: int = 0
    """Environment steps for which the policy learns directly what each command is worth, before PPO; 0: not guided, the
    paper's reward and curriculum."""
    critic_alone: bool = False
    """In these steps the critic alone learns, as is right for a policy that begins well (`choose_commands`)."""
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
    """In these steps; it sinks to a fifth."""
    noise_persistence: float = 0.8
    """As the run's, in these steps."""
    serious: float = 0.05
    """A command that is worth less than the best by this much or more is as bad as any."""
    evenness: float = 0.015
    """Situations in which commands differ by less than this count less."""
    steadiness: float = 0.1
    """What it counts to turn the other way, where a collision counts 1."""
    values: FieldConfig = field(default_factory=FieldConfig)
    """Its discount takes the place of `ppo.discount`, which weighs the paper's reward."""

    def __post_init__(self) -> None:
        require(self.steps >= 0, "ForesightConfig.steps", self.steps, "0 or more")
        for name in ("worlds", "memory_mb", "learning_rate", "serious", "evenness", "epochs"):
            require(getattr(self, name) > 0, f"ForesightConfig.{name}", getattr(self, name), "positive")
        for name in ("renewed", "processes", "steadiness"):
            require(getattr(self, name) >= 0, f"ForesightConfig.{name}", getattr(self, name), "0 or more")
        require(
            min(self.shares) >= 0 and sum(self.shares) > 0,
            "ForesightConfig.shares",
            self.shares,
            "not negative, some above 0",
        )
        low, high = self.levels
        require(0 <= low <= high <= 1, "ForesightConfig.levels", self.levels, "two in [0, 1], in order")
        require(
            0 <= self.noise_persistence < 1, "ForesightConfig.noise_persistence", self.noise_persistence, "in [0, 1)"
        )
        require(0 <= self.own_starts <= 1, "ForesightConfig.own_starts", self.own_starts, "in [0, 1]")
        for name in ("first_std", "last_std"):
            require(min(getattr(self, name)) > 0, f"ForesightConfig.{name}", getattr(self, name), "positive")

    def std(self, steps_done: int) -> tuple[float, float]:
        """Standard deviations (m/s, rad/s) after so many environment steps."""
        done = min(1.0, steps_done / self.steps)
        first, last = self.first_std, self.last_std
        return (1 - done) * first[0] + done * last[0], (1 - done) * first[1] + done * last[1]


@dataclass(frozen=True)
class AnyLevel:
    """A training scenario at any level, with those who would appear suddenly standing there from the start."""

    scenario: TrainingScenario
    levels: tuple[float, float]

    @property
    def name(self) -> str:
        return self.scenario.name

    def spawn(self, rng: np.random.Generator) -> WorldSpec:
        spec = self.scenario.at_level(float(rng.uniform(*self.levels))).spawn(rng)
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
    """The world of that number; drawn again until there is somewhere to begin.

    Raises:
        ValueError: if there never is, saying what was wrong with the last one.
    """
    worlds = Mixture(tuple(AnyLevel(stage, config.levels) for stage in TRAINING.values()), config.shares)
    sim = replace(sim, threads=1)
    wrong: ValueError | None = None
    for attempt in range(_TRIES):
        drawn = int(np.random.SeedSequence([seed, number, attempt]).generate_state(1, np.uint64)[0] >> np.uint64(1))
        try:
            (future,) = foresee(worlds, [drawn], sim)
            known = value_field(future.spec, future.bodies, sim, config.values)
        except ValueError as error:
            wrong = error  # no room for so many people and things
            continue
        poses = known.free_poses(np.random.default_rng([seed, number]), 10 * _STARTS, _WORTH_STARTING)
        starts = [pose for pose in poses if _may_begin(pose, future.spec)][:_STARTS]
        if starts:
            # The same world again leaves the generator as the simulator must find it.
            rng = np.random.default_rng(drawn)
            spec = worlds.spawn(rng)
            return ForeseenWorld(number, spec, dict(rng.bit_generator.state), known, starts)
    raise ValueError(f"none of {_TRIES} worlds of foreseen training has a place to begin; the last: {wrong}")


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
        self.fields = FieldStack(config.worlds, config.memory_mb * 1024 * 1024 // _BYTES_A_NUMBER, config.values)
        self.drawn: deque[int] = deque()
        self._held: list[ForeseenWorld | None] = [None] * config.worlds
        self._taken = 0  # worlds, ever: number n is or was in slot n % worlds
        # Not forked: a copy of a process with threads may hang.
        self._builders = ProcessPoolExecutor(
            config.processes or available_threads(),
            mp_context=multiprocessing.get_context("spawn"),
            initializer=_leave_stopping_to_the_run,
        )
        self._building: deque[Future[ForeseenWorld]] = deque()

    def fill(self) -> None:
        """Builds the first worlds."""
        self._take(self.config.worlds)

    def renew(self) -> None:
        """Replaces the oldest."""
        self._take(self.config.renewed)

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
        """Which worlds are held; whoever does not hold them builds them anew on loading."""
        return {"numbers": [world.number for world in self._held if world is not None]}

    def load_state_dict(self, state: dict[str, Any]) -> None:
        """Builds the worlds that were held and are not."""
        numbers = [int(number) for number in state["numbers"]]
        held = {world.number for world in self._held if world is not None}
        building = [self._submit(number) for number in numbers if number not in held]
        for world in building:
            self._put(world.result())
        if building:
            self._building.clear()  # what comes next is other worlds than were ordered
        self._taken = max(numbers) + 1

    def close(self) -> None:
        """Ends the processes that build."""
        self._builders.shutdown(wait=False, cancel_futures=True)

    def _take(self, count: int) -> None:
        """Puts the next worlds into their slots, and has those of the next renewal built meanwhile."""
        self._order(count)
        for _ in range(count):
            self._put(self._building.popleft().result())
        self._taken += count
        self._order(self.config.renewed)

    def _order(self, count: int) -> None:
        """Sees to it that so many worlds are being built."""
        while len(self._building) < count:
            self._building.append(self._submit(self._taken + len(self._building)))

    def _submit(self, number: int) -> Future[ForeseenWorld]:
        return self._builders.submit(build_world, self.seed, number, self.config, self.sim)

    def _put(self, world: ForeseenWorld) -> None:
        slot = world.number % self.config.worlds
        try:
            self.fields.put(slot, world.field)
        except MemoryError as error:
            held, room = self.config.worlds, self.config.memory_mb
            raise MemoryError(f"{error}: hold fewer than {held} worlds, or raise memory_mb from {room}") from error
        # The field is in the stack now.
        self._held[slot] = replace(world, field=ValueField(world.field.values[:0], world.field.grid))
