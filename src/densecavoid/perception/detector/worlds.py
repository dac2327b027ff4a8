"""Which worlds detectors are trained on and measured in: families of scenarios that share none."""

from __future__ import annotations

import dataclasses
from dataclasses import dataclass

import numpy as np

from densecavoid.scenarios.cluttered_static import ClutteredStatic
from densecavoid.scenarios.free_space import free_points
from densecavoid.scenarios.levelled import Levelled
from densecavoid.scenarios.mixture import Mixture
from densecavoid.scenarios.registry import PLACES, TESTING, TRAINING
from densecavoid.sim.people import STANDING, WANDERING
from densecavoid.sim.spec import Crowd, Scenario, WorldSpec

_BODY_ROOM_M = 0.4
_FROM_ROBOT_M = 0.9
_GLASS_CHANCE = 0.3


@dataclass(frozen=True)
class AnyLevel:
    """A scenario with a level, at a level drawn anew for each world, from `least` on."""

    scenario: Levelled
    least: float = 0.0

    @property
    def name(self) -> str:
        return getattr(self.scenario, "name", type(self.scenario).__name__)

    def spawn(self, rng: np.random.Generator) -> WorldSpec:
        scenario = self.scenario.at_level(float(rng.uniform(self.least, 1.0)))
        assert isinstance(scenario, Scenario)
        return scenario.spawn(rng)


@dataclass(frozen=True)
class PeopleAmongThings:
    """Rooms of boxes, pillars, tables, chairs and at times a pane of glass, in which people stand and walk about."""

    most_people: int = 16

    @property
    def name(self) -> str:
        return "people-among-things"

    def spawn(self, rng: np.random.Generator) -> WorldSpec:
        spec = ClutteredStatic(level=float(rng.uniform(0.2, 0.9))).spawn(rng)
        plan = spec.floor_plan
        x0, y0, x1, y1 = _extent(spec)
        inside = (x0 + 0.5, y0 + 0.5, x1 - 0.5, y1 - 0.5)
        if rng.random() < _GLASS_CHANCE:
            _put_up_glass(rng, spec, inside)
        wanted = int(rng.integers(1, self.most_people + 1))
        start = (spec.start_pose[0], spec.start_pose[1])
        for count in range(wanted, 0, -2):  # fewer, where there is no room for so many
            try:
                pos = free_points(rng, plan, inside, count, _BODY_ROOM_M, 0.6, start, _FROM_ROBOT_M)
                goal = free_points(rng, plan, inside, count, _BODY_ROOM_M)
            except ValueError:
                continue
            crowd = Crowd.draw(rng, pos, goal, float(rng.uniform(0.3, 1.2)), 0.3, WANDERING, inside, 0.1)
            standing = rng.random(count) < 0.4
            heading = rng.uniform(-np.pi, np.pi, count)
            kinds = np.where(standing, STANDING, WANDERING)
            crowd = dataclasses.replace(crowd, behaviour=kinds, heading_rad=heading)
            return dataclasses.replace(spec, scenario=self.name, crowd=crowd)
        return dataclasses.replace(spec, scenario=self.name)


def _extent(spec: WorldSpec) -> tuple[float, float, float, float]:
    """Of the outer walls' centres, about."""
    boxes = spec.floor_plan.packed().boxes
    low, high = boxes[:, :2].min(axis=0), boxes[:, :2].max(axis=0)
    return float(low[0]), float(low[1]), float(high[0]), float(high[1])


def _put_up_glass(rng: np.random.Generator, spec: WorldSpec, inside: tuple[float, float, float, float]) -> None:
    """A pane across a part of the room, beside the robot's start and goal: people are seen through it, or not."""
    start, goal = np.array(spec.start_pose[:2]), np.array(spec.goal)
    for _ in range(10):
        middle = rng.uniform(inside[:2], inside[2:])
        away = rng.uniform(-np.pi, np.pi)
        half = rng.uniform(0.5, 1.2) * np.array([np.cos(away), np.sin(away)])
        ends = np.array([middle - half, middle + half])
        spots = np.linspace(ends[0], ends[1], 9)
        if min(np.hypot(*(spots - place).T).min() for place in (start, goal)) > 0.8:
            (x0, y0), (x1, y1) = ends.tolist()
            spec.floor_plan.wall(x0, y0, x1, y1, 0.02, "glass")
            return


def training_worlds() -> Mixture:
    """The four scenarios of training, the places, and people among things; at random levels.

    Rooms full of pillars, chairs and boxes without anybody have their share: what stands there looks most like people.
    """
    mixed: list[tuple[Scenario, float]] = [(PeopleAmongThings(), 4.0), (AnyLevel(ClutteredStatic(), 0.5), 3.0)]
    weight = {"random-goal": 0.5, "random-pedestrians": 2.0, "dense-random-pedestrians": 4.0}
    mixed += [(AnyLevel(TRAINING[name]), share) for name, share in weight.items()]
    mixed += [(AnyLevel(scenario), 0.6) for scenario in PLACES.values()]
    return Mixture(tuple(scenario for scenario, _ in mixed), tuple(w for _, w in mixed))


def training_rooms() -> Scenario:
    """Full rooms without people, for false alarms."""
    return ClutteredStatic(level=1.0)


def held_out_worlds() -> Mixture:
    """The benchmark's tests with people: none of their scenarios is trained on."""
    names = [name for name in TESTING if name != "dense-static"]
    weights = tuple(1 / 3 if name.startswith("robot-freezing") else 1.0 for name in names)
    return Mixture(tuple(TESTING[name] for name in names), weights)


def held_out_rooms() -> Scenario:
    """The benchmark's rooms without people, for false alarms."""
    return TESTING["dense-static"]
