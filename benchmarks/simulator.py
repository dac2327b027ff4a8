"""Environment steps a second: people, robot, both sensors, perception, reward and resets, 15 people and 40 obstacles.

python benchmarks/simulator.py [--json FILE] [--worlds 64] [--seconds 5]
"""

from __future__ import annotations

import argparse
import json
import platform
import time
from dataclasses import dataclass
from pathlib import Path
from statistics import median

import numpy as np

from densecavoid.env import DenseCAvoidVectorEnv
from densecavoid.scenarios.free_space import free_points
from densecavoid.sim._jit import available_threads
from densecavoid.sim.floorplan import FloorPlan
from densecavoid.sim.people import WANDERING
from densecavoid.sim.spec import Crowd, WorldSpec
from densecavoid.sim.world import SimConfig

PEOPLE, OBSTACLES = 15, 40
HALL_M = 16.0


@dataclass(frozen=True)
class BusyHall:
    """A hall with 15 wandering people and 40 boxes and pillars, all of them in every world."""

    @property
    def name(self) -> str:
        return "busy-hall"

    def spawn(self, rng: np.random.Generator) -> WorldSpec:
        plan = FloorPlan()
        plan.room(0.0, 0.0, HALL_M, HALL_M)
        area = (0.8, 0.8, HALL_M - 0.8, HALL_M - 0.8)
        for i, (x, y) in enumerate(free_points(rng, plan, area, OBSTACLES, 0.5, apart_m=1.2)):
            if i % 2:
                plan.pillar(float(x), float(y), rng.uniform(0.1, 0.3))
            else:
                plan.box(float(x), float(y), rng.uniform(0.2, 0.6), rng.uniform(0.2, 0.6), rng.uniform(0, 3.14))
        start, goal = free_points(rng, plan, area, 2, 0.6, apart_m=5.0)
        pos = free_points(rng, plan, area, PEOPLE, 0.4, apart_m=0.7, away_from=(start[0], start[1]), away_m=1.5)
        crowd = Crowd.draw(rng, pos, free_points(rng, plan, area, PEOPLE, 0.4), 0.5, 0.15, WANDERING, area, 0.1)
        return WorldSpec("busy-hall", plan, (start[0], start[1], rng.uniform(-3, 3)), (goal[0], goal[1]), crowd)


def steps_per_second(worlds: int, threads: int, seconds: float) -> float:
    """Median over five spells of steps with random commands, resets included."""
    env = DenseCAvoidVectorEnv(BusyHall(), worlds, SimConfig(threads=threads), seed=1)
    env.reset()
    rng = np.random.default_rng(0)
    actions = rng.uniform([0.0, -0.4], [1.0, 0.4], (256, worlds, 2)).astype(np.float32)
    for action in actions[:20]:
        env.step(action)
    rates = []
    for _ in range(5):
        count, start = 0, time.perf_counter()
        while time.perf_counter() - start < seconds / 5:
            env.step(actions[count % 256])
            count += 1
        rates.append(count * worlds / (time.perf_counter() - start))
    return median(rates)


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0] if __doc__ else None)
    parser.add_argument("--json", type=Path)
    parser.add_argument("--worlds", type=int, default=64)
    parser.add_argument("--seconds", type=float, default=5.0)
    args = parser.parse_args()
    results = {}
    for threads in sorted({1, available_threads()}):
        results[threads] = steps_per_second(args.worlds, threads, args.seconds)
        print(f"{results[threads]:9.0f} environment steps/s  ({threads} threads, {args.worlds} worlds, ", end="")
        print(f"{PEOPLE} people, {OBSTACLES} obstacles, lidar and depth camera)")
    if args.json:
        threads = max(results)
        record = {"env_steps_per_s": results[threads], "threads": threads, "processor": platform.processor()}
        args.json.write_text(json.dumps(record, indent=1) + "\n", encoding="utf-8")


if __name__ == "__main__":
    main()
