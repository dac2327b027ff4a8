"""Drives a navigator through seeds, several worlds at a time, and records each episode. It judges nothing."""

from __future__ import annotations

from collections.abc import Callable, Sequence

import numpy as np
from jaxtyping import Float

from densecavoid.benchmark.episode import Episode, PeopleTracks
from densecavoid.benchmark.oracle import Oracle
from densecavoid.frames import Command, Navigator, People, SensorFrame, require
from densecavoid.sim.world import Simulator

OnStep = Callable[[Simulator, SensorFrame, Command], None]
"""Called before each control step with the frame that the navigator saw and the command it gave."""


def run_episodes(
    simulator: Simulator,
    navigator: Navigator,
    seeds: Sequence[int],
    on_step: OnStep | None = None,
    on_episode: Callable[[Episode], None] | None = None,
    keep_people: bool = False,
) -> list[Episode]:
    """Runs one episode for each seed; a world that ends takes the next seed.

    What a seed gives does not depend on the other seeds, nor on how many worlds the simulator holds, as long as the
    navigator treats its worlds apart.

    Args:
        simulator: Its worlds are reset; on return they are as the last episodes left them.
        navigator: Reset world by world.
        seeds: One an episode.
        on_step: Sees every control step of the batch, to film it.
        on_episode: Is told of each episode as it ends.
        keep_people: Whether the episodes keep people's tracks, for pictures.

    Returns:
        The episodes, in the order of the seeds.
    """
    require(len(seeds) > 0, "seeds", list(seeds), "at least one")
    num_worlds = simulator.num_worlds
    episodes: dict[int, Episode] = {}
    # The place in `seeds` that each world is at; None for a world that has nothing left to do.
    places: list[int | None] = [b if b < len(seeds) else None for b in range(num_worlds)]
    waiting = iter(range(num_worlds, len(seeds)))
    # Worlds beyond the number of seeds run along unrecorded: they cost time, and nothing comes of them.
    world_seeds = np.array([seeds[b if b < len(seeds) else 0] for b in range(num_worlds)], np.int64)
    renewed = np.ones(num_worlds, bool)
    simulator.reset(world_seeds)
    recorders = [_Recorder() for _ in range(num_worlds)]

    while True:
        instants = _instants(simulator)
        people = simulator.people() if keep_people else None
        for b in range(num_worlds):
            if renewed[b]:
                recorders[b] = _Recorder()
                recorders[b].record_instant(instants[b], people, b)
        if renewed.any():
            if isinstance(navigator, Oracle):
                navigator.foretell(simulator, world_seeds, renewed)
            navigator.reset(renewed)
        frame = simulator.sense()
        command = navigator.act(frame)
        if on_step is not None:
            on_step(simulator, frame, command)
        simulator.step(command)

        instants, steps, done = _instants(simulator), _steps(simulator, command), simulator.done
        people = simulator.people() if keep_people else None
        renewed[:] = False
        for b, place in enumerate(places):
            if place is None:
                continue
            recorders[b].record_step(steps[b])
            recorders[b].record_instant(instants[b], people, b)
            if not done[b]:
                continue
            episodes[place] = recorders[b].episode(simulator, b, navigator.name, int(seeds[place]))
            if on_episode is not None:
                on_episode(episodes[place])
            places[b] = following = next(waiting, None)
            if following is not None:
                world_seeds[b] = seeds[following]
                renewed[b] = True
        if len(episodes) == len(seeds):
            return [episodes[place] for place in range(len(seeds))]
        if renewed.any():
            simulator.reset(world_seeds, renewed)


def _instants(simulator: Simulator) -> Float[np.ndarray, "B 6"]:
    """Time, pose and velocity of each robot."""
    return np.column_stack([simulator.time_s, simulator.robot_pose, simulator.robot_velocity])


def _steps(simulator: Simulator, command: Command) -> Float[np.ndarray, "B 4"]:
    """What was asked of each robot in the last control step, and how near things and people were."""
    return np.column_stack([*command, simulator.clearance_m, simulator.clearance_people_m])


class _Recorder:
    """Collects one episode in one world."""

    def __init__(self) -> None:
        self._instants: list[Float[np.ndarray, "6"]] = []
        self._steps: list[Float[np.ndarray, "4"]] = []
        self._people: list[tuple[np.ndarray, ...]] = []

    def record_step(self, step: Float[np.ndarray, "4"]) -> None:
        self._steps.append(step)

    def record_instant(self, instant: Float[np.ndarray, "6"], people: People | None, b: int) -> None:
        if people is not None:
            here = people.active[b]
            row = np.full(here.sum(), len(self._instants), np.int32)
            self._people.append((row, people.id[b, here], people.pos_w[b, here], people.radius_m[b, here]))
        self._instants.append(instant)

    def episode(self, simulator: Simulator, b: int, navigator: str, seed: int) -> Episode:
        """The episode that has just ended in world b."""
        # One step can do several: the collision counts (BENCHMARK.md: success is "no collision before").
        outcome = "collision" if simulator.collided[b] else "success" if simulator.succeeded[b] else "timeout"
        instants, steps = np.array(self._instants), np.array(self._steps)
        people = PeopleTracks(*map(np.concatenate, zip(*self._people, strict=True))) if self._people else None
        return Episode(
            scenario=simulator.scenario_name[b],
            navigator=navigator,
            seed=seed,
            outcome=outcome,
            collided_person=outcome == "collision" and int(simulator.collided_person[b]) >= 0,
            robot_approached=bool(simulator.fault[b]),
            time_s=instants[:, 0],
            pose_w=instants[:, 1:4],
            velocity=instants[:, 4:6],
            command=steps[:, :2],
            clearance_m=steps[:, 2],
            clearance_people_m=steps[:, 3],
            goal_w=simulator.goal[b].copy(),
            spawn_time_s=float(simulator.spawn_time_s[b]),
            spawn_line_x=float(simulator.spawn_line_x[b]),
            floor_plan=simulator.floor_plan(b),
            people=people,
        )
