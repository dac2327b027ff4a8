"""What every place, heading and moment of a world is worth to a robot that knows everybody's whole future.

Found backwards from the end (dynamic programming): a state is worth what the best command leads to, a little less for
each moment that passes, and less where commands could go wrong. So the robot's best command is known wherever its
policy takes it, not only along one way (`planner`).
"""

from __future__ import annotations

import math
from dataclasses import dataclass

import numpy as np
from jaxtyping import Float, Float32, Int, Int16, Shaped

from densecavoid.foresight import field_kernels as kernels
from densecavoid.foresight.planner import MARGIN_M
from densecavoid.frames import require
from densecavoid.scenarios.free_space import Area, clearance_grid_m
from densecavoid.sim.config import SimConfig
from densecavoid.sim.spec import WorldSpec

_BEYOND_M = 1.5
"""So far around start and goal the robot may go where no walls say more."""
_LARGEST_ROOM_M = 13.0
"""In a longer place only the part between start and goal counts."""
_SETTLED = 1e-3
_MOST_STEPS_S = 60.0


@dataclass(frozen=True)
class FieldConfig:
    """What is good, and how finely it is worked out. Reaching the goal is worth 1."""

    hold_s: float = 0.4
    """A moment: how long a command is held."""
    horizon_s: float = 36.0
    """Until then people are where they will be; afterwards nobody is left."""
    discount: float = 0.9975
    """Of a control step."""
    slip: float = 0.1
    """Share of moments in which any command is carried out instead: narrow ways are worth less than wide ones."""
    collision: float = -0.5
    """What a collision is worth."""
    near_m: float = 0.15
    """Nearer than this beyond a collision is unwelcome,"""
    near_cost: float = 0.005
    """and costs so much a moment beside a person, up to twice that at a thing."""
    still_cells: int = 12_000
    """The most cells of a world in which nothing moves; never smaller than .1 m."""
    moving_cells: int = 4_000
    """The most cells of a world with people who walk; never smaller than .15 m."""

    def __post_init__(self) -> None:
        for name in ("hold_s", "horizon_s", "near_m", "still_cells", "moving_cells"):
            require(getattr(self, name) > 0, f"FieldConfig.{name}", getattr(self, name), "positive")
        require(0 < self.discount <= 1, "FieldConfig.discount", self.discount, "in (0, 1]")
        require(0 <= self.slip < 1, "FieldConfig.slip", self.slip, "in [0, 1)")
        require(-1 <= self.collision <= 0, "FieldConfig.collision", self.collision, "in [-1, 0]")
        require(0 <= self.near_cost < 1, "FieldConfig.near_cost", self.near_cost, "in [0, 1)")


@dataclass(frozen=True)
class ValueField:
    """Values of one world. `values[k, h, i, j]` is after k moments, at heading 2 pi h / H, in the centre of a cell."""

    values: Int16[np.ndarray, "K H X Y"]
    """In units of 1 / `field_kernels.STEPS_OF_SCALE`. A single moment where nothing moves."""
    grid: Float[np.ndarray, "3"]
    """x and y of the first cell's corner, side of a cell (m)."""

    def free_poses(
        self, rng: np.random.Generator, count: int, at_least: float, tries: int = 400
    ) -> list[tuple[float, float, float]]:
        """Up to `count` poses, drawn anew, where an episode may begin that is worth `at_least`."""
        first = self.values[0]
        worth, scale = at_least * kernels.STEPS_OF_SCALE, kernels.STEPS_OF_SCALE
        headings, rows, columns = first.shape
        poses: list[tuple[float, float, float]] = []
        for h, i, j in zip(
            rng.integers(headings, size=tries),
            rng.integers(rows, size=tries),
            rng.integers(columns, size=tries),
            strict=True,
        ):
            # A place where some heading is as bad as a collision leaves no room to turn.
            if len(poses) < count and first[h, i, j] >= worth and first[:, i, j].min() > -0.2 * scale:
                x, y = self.grid[:2] + (np.array([i, j]) + 0.5) * self.grid[2]
                poses.append((float(x), float(y), 2.0 * math.pi * int(h) / headings))
        return poses


def value_field(
    spec: WorldSpec, bodies: Float32[np.ndarray, "T N 3"], sim: SimConfig, config: FieldConfig = FieldConfig()
) -> ValueField:
    """Works out one world.

    Args:
        spec: The world; people who appear when the robot comes near are not foreseen.
        bodies: Its people (`future.Future.bodies`): x, y and radius after each physics step.
        sim: Its robot and clock.
        config: What is good.

    Raises:
        ValueError: if the goal is inside a thing.
    """
    moves = len(bodies) > 1 and bodies.shape[1] > 0 and bool((bodies != bodies[:1]).any())
    area = _area_of(spec)
    size_m2 = (area[2] - area[0]) * (area[3] - area[1])
    finest_m, cells = (0.15, config.moving_cells) if moves else (0.1, config.still_cells)
    cell = max(finest_m, math.sqrt(size_m2 / cells))
    grid = np.array([area[0], area[1], cell])
    need = spec.collision_distance_m + MARGIN_M
    clearance = clearance_grid_m(spec.floor_plan, area, cell, need + config.near_m + cell)
    ground = _ground(clearance, grid, spec, need)
    cost = 2 * config.near_cost * np.clip((need + config.near_m - clearance) / config.near_m, 0.0, 1.0)
    steps = _steps(sim.robot.max_linear_velocity, sim.robot.max_angular_velocity, config.hold_s, cell)
    framed = (len(steps), ground.shape[0] + 2 * kernels.FRAME, ground.shape[1] + 2 * kernels.FRAME)
    inside = (slice(None), slice(kernels.FRAME, -kernels.FRAME), slice(kernels.FRAME, -kernels.FRAME))
    values = np.full(framed, config.collision, np.float32)
    values[inside] = 0.0
    best, total, cost = np.zeros(framed, np.float32), np.zeros(framed, np.float32), cost.astype(np.float32)
    people = np.zeros(ground.shape, np.uint8)

    discount = config.discount ** (config.hold_s / sim.control_dt_s)

    def one_moment_before() -> float:
        kernels.back_up(values, best, total, steps)
        weights = (discount, config.slip, config.collision, config.near_cost)
        return kernels.settle(values, best, total, ground, cost, people, steps.shape[1], *weights)

    def place_people(row: int) -> None:
        kernels.mark_people(people, bodies[row], area[0], area[1], cell, need, config.near_m)

    if not moves and bodies.size > 0:
        place_people(0)
    for _ in range(round(_MOST_STEPS_S / config.hold_s)):
        if one_moment_before() < _SETTLED:
            break
    moments = int(config.horizon_s / config.hold_s) + 1 if moves else 1
    kept = np.zeros((moments, len(steps) // 2, *ground.shape), np.int16)
    if not moves:
        kernels.keep(kept[0], values)
        return ValueField(kept, grid)
    rows = config.hold_s / sim.physics_dt_s
    for k in reversed(range(moments)):
        place_people(min(max(round(k * rows) - 1, 0), len(bodies) - 1))
        one_moment_before()
        kernels.keep(kept[k], values)
    return ValueField(kept, grid)


class FieldStack:
    """The fields of several worlds in one block of memory, to be looked up for many robots at once."""

    def __init__(self, slots: int, numbers: int, config: FieldConfig) -> None:
        """
        Args:
            slots: most fields at once.
            numbers: most values of all of them together; two bytes each.
            config: that the fields were made with.
        """
        require(slots >= 1, "slots", slots, "at least 1")
        self.config = config
        self._flat = np.zeros(numbers, np.int16)
        # Where each begins, and its moments, headings, rows and columns; without moments: nothing is there.
        self._shapes = np.zeros((slots, 5), np.int64)
        self._grids = np.ones((slots, 3))

    def put(self, slot: int, field: ValueField) -> None:
        """Takes the place of what is in a slot.

        Raises:
            MemoryError: if there is no stretch of memory left that is long enough; the slot is then empty.
        """
        values = field.values.reshape(-1)
        self._shapes[slot] = 0
        first = self._gap(len(values))
        self._flat[first : first + len(values)] = values
        self._shapes[slot] = first, *field.values.shape
        self._grids[slot] = field.grid

    def of_poses(
        self, slots: Int[np.ndarray, "B"], poses: Float[np.ndarray, "B 3"], time_s: Shaped[np.ndarray, "B"]
    ) -> Float[np.ndarray, "B"]:
        """What it is worth to be there then."""
        out = np.empty(len(slots))
        kernels.values_of_poses(*self._arrays, slots, poses, time_s / self.config.hold_s, out)
        return out

    def of_commands(
        self,
        slots: Int[np.ndarray, "B"],
        poses: Float[np.ndarray, "B 3"],
        time_s: Shaped[np.ndarray, "B"],
        commands: Float[np.ndarray, "C 2"],
    ) -> Float[np.ndarray, "B C"]:
        """What it is worth to hold each command (m/s, rad/s) for a moment, and to know the best ones from then on."""
        out = np.empty((len(slots), len(commands)))
        hold_s = self.config.hold_s
        kernels.values_of_commands(*self._arrays, slots, poses, time_s / hold_s, commands, hold_s, out)
        return out

    @property
    def _arrays(self) -> tuple[np.ndarray, np.ndarray, np.ndarray, float]:
        return self._flat, self._shapes, self._grids, self.config.collision

    def _gap(self, size: int) -> int:
        """Where the first free stretch of that length begins."""
        sizes = self._shapes[:, 1:].prod(axis=1)
        used = np.flatnonzero(sizes)
        first = 0
        for slot in used[np.argsort(self._shapes[used, 0])]:
            if self._shapes[slot, 0] - first >= size:
                return first
            first = int(self._shapes[slot, 0] + sizes[slot])
        if len(self._flat) - first < size:
            raise MemoryError(f"no room for {size:,} values among {len(self._flat):,}")
        return first


def _area_of(spec: WorldSpec) -> Area:
    """The rectangle in which the robot may want to be."""
    ends = np.array([spec.start_pose[:2], spec.goal])
    low, high = ends.min(axis=0) - _BEYOND_M, ends.max(axis=0) + _BEYOND_M
    centre, reach = spec.floor_plan.boxes[:, :2], spec.floor_plan.box_reach
    if len(centre) > 0:
        first, last = (centre - reach).min(axis=0), (centre + reach).max(axis=0)
        for axis in (0, 1):
            if last[axis] - first[axis] < _LARGEST_ROOM_M:
                low[axis], high[axis] = first[axis], last[axis]
    return float(low[0]), float(low[1]), float(high[0]), float(high[1])


def _ground(
    clearance: Float[np.ndarray, "X Y"], grid: Float[np.ndarray, "3"], spec: WorldSpec, need_m: float
) -> Shaped[np.ndarray, "X Y"]:
    centres = [grid[axis] + (np.arange(clearance.shape[axis]) + 0.5) * grid[2] for axis in (0, 1)]
    to_goal = np.hypot(centres[0][:, None] - spec.goal[0], centres[1][None] - spec.goal[1])
    ground = np.where(clearance < need_m, kernels.BLOCKED, kernels.FREE).astype(np.uint8)
    ground[(to_goal < spec.goal_distance_m) & (ground == kernels.FREE)] = kernels.GOAL
    require(bool((ground == kernels.GOAL).any()), f"the goal of {spec.scenario}", spec.goal, "a free place")
    return ground


def _steps(max_linear: float, max_angular: float, hold_s: float, cell: float) -> Float[np.ndarray, "H C 3"]:
    """`steps_of_moments`, whose headings are even in number because every second one is kept."""
    require(
        max_linear * hold_s < (kernels.FRAME - 1) * cell,
        "FieldConfig.hold_s",
        hold_s,
        f"shorter than {kernels.FRAME - 1} cells of {cell:.2f} m at {max_linear} m/s",
    )
    return kernels.steps_of_moments(max_linear, max_angular, hold_s, cell)
