"""How a crowd enters a world at the start of an episode: places, speeds, groups, and who thinks what of the robot."""

from __future__ import annotations

import numpy as np
from jaxtyping import Float, Int8

from densecavoid.sim.config import SimConfig
from densecavoid.sim.people import ABSENT, BLOCK, CIRCULATING, IGNORE, STANDING, YIELD
from densecavoid.sim.spec import Crowd
from densecavoid.sim.state import WorldState

CURIOUS_S = 10.0
"""For so long a curious person stays in the robot's way; then they make way as others do."""
SPEED_LIMITS = (0.15, 1.6)
PACE = {"brisk": (1.0, 0.2), "rush": (1.34, 0.26)}
"""Mean and standard deviation of everybody's speed, m/s (BENCHMARK, The four tests)."""
_ATTITUDE_STREAM, _PACE_STREAM = 1, 2
# Generators of their own, made of the world's own seed: a world stays the same world whatever its people are like.


def place_crowd(
    state: WorldState, b: int, crowd: Crowd, config: SimConfig, reactive: bool, waits: bool, rng: np.random.Generator
) -> None:
    """Fills the people's part of world b.

    Args:
        reactive: recorded people keep their way as an intention, and so can think of the robot.
        waits: nobody is there before the robot has come some way (`WorldSpec.appearance`).
    """
    there = slice(0, crowd.size)
    heading = crowd.first_heading_rad
    state.behaviour[b] = ABSENT
    if not waits:
        state.behaviour[b, there] = crowd.behaviour
    state.phase[b, there] = rng.uniform(0.0, 2 * np.pi, crowd.size)
    state.random[b] = rng.integers(2**63, dtype=np.uint64)
    seed = int(state.random[b])

    group = np.full(crowd.size, -1) if crowd.group is None else crowd.group
    preferred = common_speeds(_speeds(crowd, config, seed), group)
    speed = np.where(crowd.behaviour == STANDING, 0.0, preferred)
    state.group[b] = -1
    state.group[b, there] = compact_groups(group)
    state.preferred_speed[b, there] = preferred
    state.pos[b, there], state.person_goal[b, there] = crowd.pos, crowd.goal
    state.vel[b] = 0.0
    state.vel[b, there] = speed[:, None] * np.stack([np.cos(heading), np.sin(heading)], axis=1)
    state.heading[b, there] = heading
    state.radius[b, there], state.height[b, there] = crowd.radius_m, crowd.height_m
    state.person_id[b] = -1
    state.person_id[b, there] = np.arange(crowd.size)
    state.next_id[b] = crowd.size
    state.entrance[b] = np.nan
    entrance = crowd.pos if crowd.entrance is None else crowd.entrance
    state.entrance[b, there] = np.where((crowd.behaviour == CIRCULATING)[:, None], entrance, np.nan)
    state.wander_area[b] = crowd.wander_area
    state.change_rate[b] = crowd.changes_of_mind_per_s
    state.attitude[b] = draw_attitudes(config, reactive, seed, state.pos.shape[1])
    state.curious_s[b] = CURIOUS_S
    state.leg[b] = -1
    if crowd.net is not None and crowd.leg is not None:
        state.net_links[b] = -1
        state.net_places[b, : len(crowd.net.places)] = crowd.net.places
        state.net_links[b, : len(crowd.net.places), : crowd.net.links.shape[1]] = crowd.net.links
        state.leg[b, there] = crowd.leg


def draw_attitudes(config: SimConfig, reactive: bool, seed: int, count: int) -> Int8[np.ndarray, "count"]:
    """What the people in each slot think of the robot; the first ones the same whatever the number of slots."""
    if config.people != "mixed":
        yields = reactive or config.people == "reactive"
        return np.full(count, YIELD if yields else IGNORE, np.int8)
    shares = config.shares
    draw = np.random.default_rng((seed, _ATTITUDE_STREAM)).random(count)
    attitude = np.full(count, BLOCK, np.int8)
    attitude[draw < shares.ignore + shares.makes_way] = YIELD
    attitude[draw < shares.ignore] = IGNORE
    return attitude


def _speeds(crowd: Crowd, config: SimConfig, seed: int) -> Float[np.ndarray, "P"]:
    """What the scenario says, or drawn anew at the pace asked for."""
    if config.pace == "scenario":
        return np.asarray(crowd.preferred_speed, np.float64)
    drawn = np.random.default_rng((seed, _PACE_STREAM)).normal(*PACE[config.pace], crowd.size)
    return np.clip(drawn, *SPEED_LIMITS)


def common_speeds(speed: Float[np.ndarray, "P"], group: np.ndarray) -> Float[np.ndarray, "P"]:
    """Those who walk together walk as their slowest member does."""
    common = speed.copy()
    for number in np.unique(group[group >= 0]):
        common[group == number] = speed[group == number].min()
    return common


def compact_groups(group: np.ndarray) -> np.ndarray:
    """The same groups numbered 0, 1, 2, ...; -1 stays."""
    _, numbers = np.unique(group[group >= 0], return_inverse=True)
    compact = np.full(len(group), -1, np.int16)
    compact[group >= 0] = numbers
    return compact
