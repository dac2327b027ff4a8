"""What a scenario hands to the simulator: one world as it stands at the start of an episode."""

from __future__ import annotations

from dataclasses import dataclass, field
from typing import Protocol, runtime_checkable

import numpy as np
from jaxtyping import Float, Int

from densecavoid.frames import require
from densecavoid.sim.crowds.recording import Recording
from densecavoid.sim.floorplan import FloorPlan
from densecavoid.sim.people import sample_bodies

NET_PLACES, NET_LINKS = 64, 6
"""The most places of a net, and links of a place."""


@dataclass(frozen=True)
class WalkNet:
    """Places and which of them are joined by a straight free way: how wanderers get about among inner walls.

    Whoever arrives at a place goes on to one of its links at random, and back only where there is no other. A change of
    mind is to turn round.
    """

    places: Float[np.ndarray, "M 3"]
    """Rows (x, y, spread): each visitor heads for a point of their own within `spread` of it."""
    links: Int[np.ndarray, "M L"]
    """Places joined to each; -1 fills up."""

    def __post_init__(self) -> None:
        count = len(self.places)
        require(2 <= count <= NET_PLACES, "WalkNet.places", f"{count} places", f"2 to {NET_PLACES}")
        require(bool(np.isfinite(self.places).all()), "WalkNet.places", self.places, "finite")
        require(self.links.shape[0] == count, "WalkNet.links", self.links.shape, f"a row for each of {count} places")
        require(self.links.shape[1] <= NET_LINKS, "WalkNet.links", self.links.shape, f"at most {NET_LINKS} a place")
        known = bool(((self.links >= -1) & (self.links < count)).all())
        require(known, "WalkNet.links", self.links, f"-1 or a place below {count}")
        require(
            bool((self.links[:, 0] >= 0).all()), "WalkNet.links", self.links, "one or more a place, first in its row"
        )


@dataclass(frozen=True)
class Crowd:
    """People at the start of an episode, and what each is about to do (`people.STANDING`, ...)."""

    pos: Float[np.ndarray, "P 2"]
    goal: Float[np.ndarray, "P 2"]
    preferred_speed: Float[np.ndarray, "P"]
    radius_m: Float[np.ndarray, "P"]
    height_m: Float[np.ndarray, "P"]
    behaviour: Int[np.ndarray, "P"]
    wander_area: tuple[float, float, float, float] = (0.0, 0.0, 0.0, 0.0)
    """x_min, y_min, x_max, y_max in which wanderers choose their places."""
    changes_of_mind_per_s: float = 0.0
    """How often a wanderer chooses a new place before reaching the last one."""
    heading_rad: Float[np.ndarray, "P"] | None = None
    """Where each looks at first; None: towards the goal."""
    group: Int[np.ndarray, "P"] | None = None
    """People of one number, 0 or more, belong together; -1 is alone. None: everybody is."""
    entrance: Float[np.ndarray, "P 2"] | None = None
    """Where circulating people come in again after they have arrived; None: where they began."""
    net: WalkNet | None = None
    """Places in sight of one another, for wanderers who have a leg."""
    leg: Int[np.ndarray, "P 2"] | None = None
    """Place of the net that each comes from, and the one they go to; -1: not on the net. None: nobody is."""

    def __post_init__(self) -> None:
        count = len(self.pos)
        for name in ("heading_rad", "group", "entrance"):
            value = getattr(self, name)
            if value is not None:
                require(len(value) == count, f"Crowd.{name}", f"{len(value)} long", f"{count}, one for each position")
                require(bool(np.isfinite(value).all()), f"Crowd.{name}", value, "finite")
        require((self.net is None) == (self.leg is None), "Crowd.leg", self.leg, "given with a net, and only then")
        if self.net is not None and self.leg is not None:
            require(self.leg.shape == (count, 2), "Crowd.leg", self.leg.shape, f"({count}, 2)")
            known = bool(((self.leg >= -1) & (self.leg < len(self.net.places))).all())
            require(known, "Crowd.leg", self.leg, "-1 or a place of the net")
        for name in ("goal", "preferred_speed", "radius_m", "height_m", "behaviour"):
            value = getattr(self, name)
            require(len(value) == count, f"Crowd.{name}", f"{len(value)} long", f"{count}, one for each position")
        for name in ("pos", "goal", "preferred_speed", "radius_m", "height_m"):
            require(bool(np.isfinite(getattr(self, name)).all()), f"Crowd.{name}", getattr(self, name), "finite")
        wide = bool(((self.radius_m > 0.1) & (self.radius_m <= 0.45)).all())
        require(wide, "Crowd.radius_m", self.radius_m, "above 0.1 m, at most 0.45 m")
        require(bool((self.preferred_speed >= 0).all()), "Crowd.preferred_speed", self.preferred_speed, "0 or more")

    @property
    def size(self) -> int:
        return len(self.pos)

    @property
    def first_heading_rad(self) -> Float[np.ndarray, "P"]:
        """Where each looks at first: as given, or towards the goal."""
        if self.heading_rad is not None:
            return self.heading_rad
        way = self.goal - self.pos
        return np.arctan2(way[:, 1], way[:, 0])

    @staticmethod
    def nobody() -> Crowd:
        """An empty crowd."""
        none = np.zeros(0)
        return Crowd(np.zeros((0, 2)), np.zeros((0, 2)), none, none, none, np.zeros(0, np.int64))

    @staticmethod
    def draw(
        rng: np.random.Generator,
        pos: Float[np.ndarray, "P 2"],
        goal: Float[np.ndarray, "P 2"],
        speed_mean: float,
        speed_std: float,
        behaviour: int,
        wander_area: tuple[float, float, float, float] = (0.0, 0.0, 0.0, 0.0),
        changes_of_mind_per_s: float = 0.0,
    ) -> Crowd:
        """People of adult size at the given places with speeds N(mean, std) clipped to [.15, 1.6] m/s (BENCHMARK)."""
        radius_m, height_m = sample_bodies(rng, len(pos))
        speed = np.clip(rng.normal(speed_mean, speed_std, len(pos)), 0.15, 1.6)
        kind = np.full(len(pos), behaviour)
        return Crowd(pos, goal, speed, radius_m, height_m, kind, wander_area, changes_of_mind_per_s)


@dataclass(frozen=True)
class Appearance:
    """People who are not there until the robot has come some way, and then stand across its path (Robot Freezing)."""

    trigger_distance_m: float
    """They appear when the robot is this far from its start."""
    distance_m: float
    """From the robot's centre to the nearest body surface at that moment; they stand on a line across +x."""

    def __post_init__(self) -> None:
        for name in ("trigger_distance_m", "distance_m"):
            require(getattr(self, name) > 0, f"Appearance.{name}", getattr(self, name), "positive")


@dataclass(frozen=True)
class Replay:
    """Recorded people and the moment of the recording at which the episode starts."""

    recording: Recording
    start_s: float
    reactive: bool = False
    """Each keeps the recorded way as an intention and makes way for the robot and for others."""


@dataclass(frozen=True)
class WorldSpec:
    """One world at the start of an episode. World frame, metres, radians."""

    scenario: str
    floor_plan: FloorPlan
    start_pose: tuple[float, float, float]
    goal: tuple[float, float]
    crowd: Crowd = field(default_factory=Crowd.nobody)
    time_limit_s: float = 60.0
    collision_distance_m: float = 0.30
    """From the robot's centre to a surface: .30 is the paper's rule, the robot's radius the contact rule."""
    goal_distance_m: float = 0.30
    waypoints: Float[np.ndarray, "W 2"] = field(default_factory=lambda: np.zeros((0, 2)))
    """Places on the way to the goal that the reward may praise (paper, Reward Function)."""
    appearance: Appearance | None = None
    replay: Replay | None = None

    def __post_init__(self) -> None:
        numbers = (*self.start_pose, *self.goal)
        require(bool(np.isfinite(numbers).all()), "WorldSpec start and goal", numbers, "finite")
        require(self.time_limit_s > 0, "WorldSpec.time_limit_s", self.time_limit_s, "positive")
        require(self.collision_distance_m > 0, "WorldSpec.collision_distance_m", self.collision_distance_m, "positive")

    @property
    def people_slots(self) -> int:
        """How many people may be in the world at once."""
        return self.crowd.size if self.replay is None else self.replay.recording.max_people


@runtime_checkable
class Scenario(Protocol):
    """A family of worlds."""

    @property
    def name(self) -> str: ...

    def spawn(self, rng: np.random.Generator) -> WorldSpec:
        """One world of the family, the same for the same state of `rng`."""
        ...
