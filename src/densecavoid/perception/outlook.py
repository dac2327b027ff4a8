"""What each command would be worth, in the next seconds, in the world as the robot perceives it.

People go on as they move now, what stands is what lidar and camera have shown (`static_map`). Every place, heading and
moment that the robot can reach within the horizon is given a value, backwards from the end, where the length of the way
left to the goal counts. No learning, and no knowledge but the sensors': what tracking and planning alone are worth.

The programme is that of `foresight.value_field`, with foreseen people in place of known ones and a window that moves
with the robot in place of the whole world.
"""

from __future__ import annotations

import math
from dataclasses import dataclass
from functools import cache

import numpy as np
from jaxtyping import Bool, Float32, Float64

from densecavoid.foresight.field_kernels import SPEEDS, TURNS, steps_of_commands, steps_of_moments
from densecavoid.frames import COMMAND_GRID, RobotConfig, require
from densecavoid.perception.outlook_kernels import (
    SIDE_BY_SIDE,
    Around,
    Lattice,
    Room,
    Rules,
    find_spans,
    make_room,
    worth_of_commands,
)
from densecavoid.perception.rolling_grid import CELL_M
from densecavoid.sim._jit import available_threads, for_worlds, threads_for


@dataclass(frozen=True)
class OutlookConfig:
    """What is foreseen, and what is good. Reaching the goal is worth 1.

    Set by hand on training worlds, where costs of people from half to six times as much made no difference that 64
    worlds show, after a look at why it stood still in some unfiltered worlds of `dense-static`.
    `python benchmarks/tune_baselines.py lookahead` looks for better ones.
    """

    horizon_s: float = 5.6
    """So far ahead people are foreseen."""
    hold_s: float = 0.4
    """A moment: how long a command is held."""
    cell_m: float = 0.1
    discount: float = 0.9975
    """Of a tenth of a second."""
    slip: float = 0.05
    """Share of moments in which any command is carried out instead: narrow ways are worth less than wide ones."""
    collision: float = -0.5
    """What a collision is worth."""
    body_m: float = 0.30
    """From the robot's centre to what it must not come nearer to: the paper's collision distance,"""
    margin_m: float = 0.02
    """and so much more."""
    near_person_m: float = 0.3
    """Nearer than this beyond that is unwelcome beside people,"""
    near_person_risk: float = 0.035
    """and up to so likely a collision in each moment, less the farther away (squared)."""
    turned_risk: float = 0.15
    """Likelier by so much, in each half moment, beside somebody who has surely taken another course by then. As likely
    as that is, they are less likely where they would be otherwise."""
    turned_reach: float = 0.5
    """Of the way that they walk until then, by which what is beside them grows when they surely have."""
    near_thing_m: float = 0.25
    """Nearer than this beside things, time counts more,"""
    near_thing_slower: float = 2.0
    """by up to so many times. On the ways beyond the horizon as within it: what costs only within, waits."""
    beyond_slower: float = 1.5
    """So many times what it takes to go and turn is reckoned beyond the horizon. What promised more than driving can
    keep would have the robot wait for good: it would always be better to go later."""
    doubt_m_s: float = 0.1
    """By which the unwelcome distance grows with the time until then, however steadily people walk."""
    goal_m: float = 0.25
    """Nearer to the goal is there; the rules ask for .3 m."""

    def __post_init__(self) -> None:
        for name in ("horizon_s", "hold_s", "cell_m", "body_m", "near_person_m", "near_thing_m", "goal_m"):
            value = getattr(self, name)
            require(value > 0 and math.isfinite(value), f"OutlookConfig.{name}", value, "positive")
        for name in ("margin_m", "turned_reach", "near_thing_slower", "doubt_m_s"):
            value = getattr(self, name)
            require(value >= 0 and math.isfinite(value), f"OutlookConfig.{name}", value, "0 or more")
        for name in ("near_person_risk", "turned_risk"):
            require(0 <= getattr(self, name) <= 1, f"OutlookConfig.{name}", getattr(self, name), "in [0, 1]")
        require(0 < self.discount < 1, "OutlookConfig.discount", self.discount, "in (0, 1)")
        require(0 <= self.slip < 1, "OutlookConfig.slip", self.slip, "in [0, 1)")
        require(1 <= self.beyond_slower < 10, "OutlookConfig.beyond_slower", self.beyond_slower, "in [1, 10)")
        require(-1 <= self.collision <= 0, "OutlookConfig.collision", self.collision, "in [-1, 0]")
        require(
            2 * self.hold_s <= self.horizon_s <= 20 * self.hold_s,
            "OutlookConfig.horizon_s",
            self.horizon_s,
            f"2 to 20 moments of {self.hold_s} s",
        )


OBSERVED = OutlookConfig(horizon_s=5.5, hold_s=0.5, cell_m=0.15)
"""Coarser, and several times as fast, for what a policy is told: in 48 worlds its best command was worth .0004 less
than the best of the finer one, in the eyes of that."""


_PARTS = 4
"""Of a moment, in which a command that is held now must not come too near: so it cuts no corners."""


@cache
def make_lattice(
    horizon_s: float, hold_s: float, cell_m: float, max_linear: float, max_angular: float
) -> tuple[Lattice, Float64[np.ndarray, "K 2"], Float64[np.ndarray, "K S 3"]]:
    """Where a robot with these limits can be in the next moments, the commands that it chooses among now, and the poses
    on the way of each while it is held (m, m, rad)."""
    moments = round(horizon_s / hold_s)
    is_half = np.repeat([speed not in (0.0, 1.0) for speed in SPEEDS], len(TURNS))
    steps = steps_of_moments(max_linear, max_angular, hold_s, cell_m)[:, np.argsort(is_half, kind="stable")]
    headings = len(steps)
    cells = np.floor(steps[..., :2])
    u, v = np.moveaxis(steps[..., :2] - cells, -1, 0)
    weights = np.stack([(1 - u) * (1 - v), (1 - u) * v, u * (1 - v), u * v], axis=-1).astype(np.float32)
    halfway = np.rint(0.5 * steps[..., :2]).astype(np.int64)
    offsets = np.concatenate([cells, steps[..., 2:]], axis=-1).astype(np.int64)
    # A window that nothing can leave; then what of it is never needed is cut off.
    half = math.ceil(max_linear * hold_s * moments / cell_m) + moments + 3
    commands = COMMAND_GRID * [max_linear, max_angular]
    held_s = hold_s * np.arange(1, _PARTS + 1) / _PARTS
    held = [steps_of_commands(np.insert(commands, 2, 0.0, axis=1), 1, time_s, cell_m)[0, :, :2] for time_s in held_s]
    path = np.concatenate([cell_m * np.stack(held, axis=1), (commands[:, 1:] * held_s)[..., None]], axis=2)
    # The robot is in the middle of a cell: to stand still leads to the very state that it is in. Between cells it would
    # lead to several at once, of which each then does what is best there: that seems better than anything done now.
    place = np.floor(held[-1]).astype(np.int64) + half
    turned = np.floor(commands[:, 1] * hold_s / (2.0 * math.pi) * headings).astype(np.int64)
    firsts = [(int(h + more) % headings, *at) for at, h in zip(place, turned, strict=True) for more in range(2)]
    spans = np.zeros((moments + 1, headings, 2 * half, 2), np.int32)
    find_spans(spans, offsets, np.array(firsts, np.int64))
    used = spans[..., 0] < spans[..., 1]
    rows = np.flatnonzero(used.any(axis=(0, 1)))
    first_i, first_j = int(rows[0]), int(spans[..., 0][used].min())
    spans = np.where(used[..., None], spans - first_j, 0)[:, :, first_i : rows[-1] + 1]
    x0, y0 = (first_i - half - 0.5) * cell_m, (first_j - half - 0.5) * cell_m
    boxes = np.zeros((moments + 1, 4), np.int64)
    for box, reached in zip(boxes[1:], spans[1:], strict=True):
        some = np.flatnonzero((reached[..., 0] < reached[..., 1]).any(axis=0))
        empty = reached[..., 0] == reached[..., 1]
        box[:] = some[0], some[-1] + 1, np.where(empty, 2 * half, reached[..., 0]).min(), reached[..., 1].max()
    spans = np.ascontiguousarray(spans, np.int32)
    lattice = Lattice(x0, y0, offsets, weights, halfway, int((~is_half).sum()), int(spans.max()), boxes, spans)
    return lattice, commands, path


class Outlook:
    """For robots of one kind. Remembers nothing from one moment to the next."""

    def __init__(self, config: OutlookConfig, robot: RobotConfig, threads: int = 0) -> None:
        """
        Args:
            config: what is good.
            robot: whose limits count.
            threads: over the worlds; 0 takes all cores.
        """
        self._threads = threads
        limits = float(robot.max_linear_velocity), float(robot.max_angular_velocity)
        self._lattice, self.commands, self._path = make_lattice(config.horizon_s, config.hold_s, config.cell_m, *limits)
        self._room: Room | None = None  # of the size that looks have asked for
        self._rules = Rules(
            cell_m=config.cell_m,
            moments=round(config.horizon_s / config.hold_s),
            hold_s=config.hold_s,
            discount=config.discount ** (10.0 * config.hold_s),
            slip=config.slip,
            collision=config.collision,
            body_m=config.body_m,
            margin_m=config.margin_m,
            near_person_m=config.near_person_m,
            near_person_risk=config.near_person_risk,
            turned_risk=config.turned_risk,
            turned_reach=config.turned_reach,
            near_thing_m=config.near_thing_m,
            near_thing_slower=config.near_thing_slower,
            beyond_slower=config.beyond_slower,
            doubt_m_s=config.doubt_m_s,
            goal_m=config.goal_m,
            way_cell_m=CELL_M,
            max_linear=limits[0],
            max_angular=limits[1],
        )

    def look(self, around: Around, which: Bool[np.ndarray, "B"], out: Float32[np.ndarray, "B K"]) -> None:
        """Writes what each of `commands` is worth in the marked worlds."""
        threads = min(threads_for(which, self._threads) or available_threads(), len(which))
        wide = min(len(which), SIDE_BY_SIDE)
        if self._room is None or len(self._room.ground) < threads or self._room.ground.shape[1] < wide:
            self._room = make_room(self._lattice, threads, wide)
        args = self._room, which, around, self._lattice, self._path, self._rules, out
        for_worlds(worth_of_commands, threads, threads, threads, *args)
