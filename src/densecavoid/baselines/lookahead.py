"""Dynamic programming over the next seconds, in the world as the robot perceives it.

People go on as they move now (tracks), what stands is what lidar and camera have shown (`perception.static_map`). Every
place, heading and moment that the robot can reach within the horizon is given a value, backwards from the end, where
the length of the way left to the goal counts; the command that leads to the best is driven for one control step. No
learning, and no knowledge but the sensors': what prediction and planning alone are worth, beside a policy.

The programme is that of `foresight.value_field`, with foreseen people in place of known ones and a window that moves
with the robot in place of the whole world.
"""

from __future__ import annotations

import math
from dataclasses import dataclass
from typing import Literal

import numpy as np
from jaxtyping import Bool, Int

from densecavoid.baselines.lookahead_kernels import FRAME, Around, Rules, worth_of_commands
from densecavoid.baselines.surroundings import PeopleAround
from densecavoid.foresight.field_kernels import steps_of_commands
from densecavoid.foresight.value_field import COMMAND_GRID, SPEEDS, TURNS
from densecavoid.frames import CameraConfig, Command, LidarConfig, RobotConfig, SensorFrame, goal_polar, require
from densecavoid.perception.rolling_grid import CELL_M
from densecavoid.perception.static_map import CELLS, StaticMap
from densecavoid.perception.ways import WayRules
from densecavoid.sim._jit import for_worlds


@dataclass(frozen=True)
class LookaheadConfig:
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
    near_person_cost: float = 0.05
    """and costs up to so much a moment, less the farther away (squared),"""
    near_thing_m: float = 0.25
    """Nearer than this beside things, time counts more,"""
    near_thing_slower: float = 2.0
    """by up to so many times. On the ways beyond the horizon as within it: what costs only within, waits."""
    beyond_slower: float = 1.5
    """So many times what it takes to go and turn is reckoned beyond the horizon. What promised more than driving can
    keep would have the robot wait for good: it would always be better to go later."""
    doubt_m_s: float = 0.1
    """By which the unwelcome distance grows with the time until then: people change their mind."""
    standing_m_s: float = 0.12
    """Who is slower stands for good."""
    goal_m: float = 0.25
    """Nearer to the goal is there; the rules ask for .3 m."""

    def __post_init__(self) -> None:
        for name in ("horizon_s", "hold_s", "cell_m", "body_m", "near_person_m", "near_thing_m", "goal_m"):
            value = getattr(self, name)
            require(value > 0 and math.isfinite(value), f"LookaheadConfig.{name}", value, "positive")
        for name in ("margin_m", "near_person_cost", "near_thing_slower", "doubt_m_s", "standing_m_s"):
            value = getattr(self, name)
            require(value >= 0 and math.isfinite(value), f"LookaheadConfig.{name}", value, "0 or more")
        require(0 < self.discount < 1, "LookaheadConfig.discount", self.discount, "in (0, 1)")
        require(0 <= self.slip < 1, "LookaheadConfig.slip", self.slip, "in [0, 1)")
        require(1 <= self.beyond_slower < 10, "LookaheadConfig.beyond_slower", self.beyond_slower, "in [1, 10)")
        require(-1 <= self.collision <= 0, "LookaheadConfig.collision", self.collision, "in [-1, 0]")
        require(
            2 * self.hold_s <= self.horizon_s <= 20 * self.hold_s,
            "LookaheadConfig.horizon_s",
            self.horizon_s,
            f"2 to 20 moments of {self.hold_s} s",
        )


def reachable(moments: int, headings: int, hold_s: float, cell_m: float, robot: RobotConfig) -> Int[np.ndarray, "M 5"]:
    """Where a robot that starts at the middle of cell (0, 0), looking along x, can be after each moment: first and last
    cell (excluded) along x and y, and headings that it can have turned. Neighbours between which values are
    interpolated are among them.
    """
    fastest, turning = robot.max_linear_velocity, robot.max_angular_velocity
    boxes = np.zeros((moments, 5), np.int64)
    for k in range(moments):
        turned = turning * hold_s * k
        # Farthest aside: turn as far as a right angle, then go straight. Farthest back: turn round, go straight.
        aside = fastest / turning * (1.0 - math.cos(min(turned, math.pi / 2)) + max(turned - math.pi / 2, 0.0))
        back = fastest / turning * max(turned - math.pi, 0.0)
        boxes[k, 0] = -math.ceil(back / cell_m) - 2
        boxes[k, 1] = math.ceil(fastest * hold_s * k / cell_m) + 3
        boxes[k, 3] = math.ceil(aside / cell_m) + 3
        boxes[k, 2] = 1 - boxes[k, 3]
        boxes[k, 4] = min(k + 1, headings // 2 - 1)
    return boxes


class Lookahead:
    """Satisfies `frames.Navigator`."""

    def __init__(
        self,
        robot: RobotConfig = RobotConfig(),
        lidar: LidarConfig = LidarConfig(),
        camera: CameraConfig = CameraConfig(),
        config: LookaheadConfig | None = None,
        source: Literal["tracks", "truth"] = "tracks",
        threads: int = 0,
    ) -> None:
        """
        Args:
            robot: whose limits and height count.
            lidar, camera: whose frames it will be given.
            config: what is good.
            source: of people: tracked ones, or all there are.
            threads: over the worlds; 0 takes all cores.

        Raises:
            ValueError: if the robot moves too far in a moment for the size of the cells.
        """
        self.config = config = config or LookaheadConfig()
        self.robot = robot
        self.name = "lookahead" if source == "tracks" else "lookahead-privileged"
        self._sensors, self._threads = (lidar, camera), threads
        self._people = PeopleAround(source, lidar, camera, standing=True)
        self._map = StaticMap(lidar, camera, robot, 1, threads)
        self._commands = COMMAND_GRID * [robot.max_linear_velocity, robot.max_angular_velocity]
        headings = 2 * max(2, round(math.pi / (robot.max_angular_velocity * config.hold_s)))
        step = robot.max_linear_velocity * config.hold_s
        require(
            step < (FRAME - 1) * config.cell_m,
            "LookaheadConfig.hold_s",
            config.hold_s,
            f"shorter than {FRAME - 1} cells of {config.cell_m} m at {robot.max_linear_velocity} m/s",
        )
        turn = 2.0 * math.pi / headings
        held = np.array([(v * robot.max_linear_velocity, w * turn / config.hold_s, w) for v in SPEEDS for w in TURNS])
        self._steps = steps_of_commands(held, headings, config.hold_s, config.cell_m)
        moments = round(config.horizon_s / config.hold_s)
        boxes = reachable(moments, headings, config.hold_s, config.cell_m, robot)
        behind, right = int(FRAME - boxes[:, 0].min()), int(FRAME - boxes[:, 2].min())
        self._shape = behind + int(boxes[:, 1].max()) + FRAME, right + int(boxes[:, 3].max()) + FRAME, behind, right
        self._boxes = boxes + np.array([behind, behind, right, right, 0])
        self._rules = Rules(
            cell_m=config.cell_m,
            moments=moments,
            hold_s=config.hold_s,
            discount=config.discount ** (10.0 * config.hold_s),
            slip=config.slip,
            collision=config.collision,
            body_m=config.body_m,
            margin_m=config.margin_m,
            near_person_m=config.near_person_m,
            near_person_cost=config.near_person_cost,
            near_thing_m=config.near_thing_m,
            near_thing_slower=config.near_thing_slower,
            beyond_slower=config.beyond_slower,
            doubt_m_s=config.doubt_m_s,
            goal_m=config.goal_m,
            # A gap is worth waiting for if ways lead through it: only such as the window's cells, too, let through.
            ways=WayRules(
                thing_m=config.body_m + config.margin_m + 0.5 * config.cell_m,
                body_m=config.body_m,
                near_m=config.near_thing_m,
                near_slower=config.near_thing_slower,
                standing_m_s=config.standing_m_s,
                cells=CELLS,
                cell_m=CELL_M,
            ),
            max_linear=robot.max_linear_velocity,
            max_angular=robot.max_angular_velocity,
        )

    @property
    def privileged(self) -> bool:
        """Whether it reads ground truth."""
        return self._people.privileged

    def reset(self, which: Bool[np.ndarray, "B"]) -> None:
        """Forgets the marked worlds; their number sets the batch size."""
        self._people.reset(which)
        if len(which) != len(self._map.count):
            self._map = StaticMap(*self._sensors, self.robot, len(which), self._threads)
        else:
            self._map.reset(which)

    def act(self, frame: SensorFrame) -> Command:
        """The command for each world.

        Raises:
            ValueError: for a frame of another number of worlds than `reset` announced, or without the truth needed.
        """
        require(frame.num_worlds == len(self._map.count), "worlds", frame.num_worlds, f"{len(self._map.count)}")
        people = self._people.see(frame)
        self._map.update(frame, people, np.ones(frame.num_worlds, np.bool_))
        distance, bearing = goal_polar(frame.odom_pose, frame.goal_odom)
        goal = distance[:, None] * np.stack([np.cos(bearing), np.sin(bearing)], axis=1)
        around = Around(
            goal, self._map.points, self._map.count, people.pos_r, people.vel_r, people.radius_m, people.there
        )
        worth = np.zeros((frame.num_worlds, len(self._commands)))
        how = self._steps, self._commands, self._boxes, self._shape, self._rules
        for_worlds(worth_of_commands, frame.num_worlds, self._threads, around, *how, worth)
        chosen = self._commands[worth.argmax(axis=1)].astype(np.float32)
        return Command(chosen[:, 0], chosen[:, 1])
