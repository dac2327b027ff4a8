"""Speed of the simulator: environment steps, sensors and steps beside other engines, memory, many worlds and people.

python benchmarks/simulator.py [--json FILE] [--worlds 64] [--seconds 5]
"""

from __future__ import annotations

import argparse
import json
import math
import platform
import time
from collections.abc import Callable
from dataclasses import dataclass
from pathlib import Path
from statistics import median

import numpy as np

from densecavoid.env import DenseCAvoidVectorEnv
from densecavoid.frames import Command, LidarConfig
from densecavoid.scenarios.free_space import free_points
from densecavoid.sim._jit import available_threads
from densecavoid.sim.floorplan import FloorPlan
from densecavoid.sim.people import PARTS, WANDERING
from densecavoid.sim.spec import Crowd, WorldSpec
from densecavoid.sim.world import SimConfig, Simulator

PEOPLE, OBSTACLES = 15, 40
HALL_M = 16.0
CROWDS = (15, 50, 150, 500)
SCALING_WORLDS = 16
MANY_WORLDS = (64, 1024, 4096)
PEER_WORLDS = 8
"""Each peer casts the rays of this many of the simulator's worlds."""


@dataclass(frozen=True)
class BusyHall:
    """A hall with wandering people and 40 boxes and pillars, all of them in every world; as dense for any crowd."""

    people: int = PEOPLE

    @property
    def name(self) -> str:
        return "busy-hall"

    def spawn(self, rng: np.random.Generator) -> WorldSpec:
        side = HALL_M * math.sqrt(self.people / PEOPLE)
        plan = FloorPlan()
        plan.room(0.0, 0.0, side, side)
        area = (0.8, 0.8, side - 0.8, side - 0.8)
        for i, (x, y) in enumerate(free_points(rng, plan, area, OBSTACLES, 0.5, apart_m=1.2)):
            if i % 2:
                plan.pillar(float(x), float(y), rng.uniform(0.1, 0.3))
            else:
                plan.box(float(x), float(y), rng.uniform(0.2, 0.6), rng.uniform(0.2, 0.6), rng.uniform(0, 3.14))
        start, goal = free_points(rng, plan, area, 2, 0.6, apart_m=5.0)
        pos = free_points(rng, plan, area, self.people, 0.4, apart_m=0.7, away_from=(start[0], start[1]), away_m=1.5)
        goals = free_points(rng, plan, area, self.people, 0.4)
        crowd = Crowd.draw(rng, pos, goals, 0.5, 0.15, WANDERING, area, 0.1)
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


def median_us(call: Callable[[], object], seconds: float) -> float:
    """Median time of a call in microseconds; at least five calls after one that does not count.

    Processor time, so that whatever else runs on the machine does not count; for calls on one thread.
    """
    call()
    durations = []
    end = time.perf_counter() + seconds
    while len(durations) < 5 or time.perf_counter() < end:
        start = time.process_time()
        call()
        durations.append(time.process_time() - start)
    return median(durations) * 1e6


def busy_simulator(people: int, worlds: int) -> Simulator:
    """Worlds on one thread, with their people in mid-stride."""
    simulator = Simulator(BusyHall(people), worlds, SimConfig(threads=1))
    simulator.reset(np.arange(worlds))
    for _ in range(5):
        simulator.step(Command(np.full(worlds, 0.2, np.float32), np.zeros(worlds, np.float32)))
    return simulator


def compare_with_peers(simulator: Simulator, seconds: float) -> dict[str, float]:
    """Time to sense one world (lidar and depth, the same rays), ours and theirs, one thread each; prints them.

    Returns:
        `ray_speedup_mujoco` and `ray_speedup_pybullet`; empty where they are not installed.
    """
    try:
        from peers.ray_engines import MujocoRays, PybulletRays, camera_rays, lidar_rays
    except ModuleNotFoundError as error:
        print(f"sensors beside MuJoCo and PyBullet: skipped, {error.name} is not installed")
        return {}
    lidar, camera = simulator.config.lidar, simulator.config.camera
    theirs: dict[str, list[float]] = {"mujoco": [], "pybullet": [], "pybullet, rendered depth": []}
    share = seconds / (PEER_WORLDS * 6)
    for b in range(PEER_WORLDS):
        plan, bodies, pose = simulator.floor_plan(b), simulator.body_cylinders(b), simulator.robot_pose[b]
        rays = (*lidar_rays(lidar, pose), lidar.max_range_m), (*camera_rays(camera, pose), camera.max_range_m)
        exact, bullet = MujocoRays(plan, bodies), PybulletRays(plan, bodies)
        theirs["mujoco"].append(sum(median_us(exact.caster(*part), share) for part in rays))
        scan, image = (median_us(bullet.caster(*part), share) for part in rays)
        theirs["pybullet"].append(scan + image)
        theirs["pybullet, rendered depth"].append(scan + median_us(bullet.depth_image(camera, pose), share))
        bullet.close()
    ours = median_us(simulator.sense, seconds / 2) / simulator.num_worlds
    solids = len(simulator.floor_plan(0).boxes) + len(simulator.floor_plan(0).cylinders) + PARTS * PEOPLE
    count = lidar.num_rays + camera.width * camera.height
    print(f"{ours:9.1f} us to sense a world  (one thread, {count} rays, {solids} solids)")
    for name, times in theirs.items():
        print(f"{median(times):9.1f} us by {name}: {median(times) / ours:.0f} times ours")
    pybullet = min(median(times) for name, times in theirs.items() if name.startswith("pybullet"))
    return {"ray_speedup_mujoco": median(theirs["mujoco"]) / ours, "ray_speedup_pybullet": pybullet / ours}


def compare_with_flat_simulators(ours: float, seconds: float) -> dict[str, float]:
    """Whole steps a second of one flat simulator, which has people and a lidar but no depth camera; prints them.

    Returns:
        `speedup_irsim`; empty where it is not installed.
    """
    from peers.flat_simulators import irsim_steps_per_s

    try:
        rate = irsim_steps_per_s(PEOPLE, OBSTACLES, HALL_M, LidarConfig(), seconds)
    except ModuleNotFoundError as error:
        print(f"flat simulators: skipped, {error.name} is not installed (pip install ir-sim)")
        return {}
    print(
        f"{rate:9.0f} steps/s by IR-SIM, with the lidar alone: ours makes {ours / rate:.0f} times as many on one thread"
    )
    return {"speedup_irsim": ours / rate}


def us_per_world_step(people: int, worlds: int, seconds: float) -> float:
    """Time of one step of one world in a batch (people, robot, both sensors; one thread), microseconds."""
    simulator = busy_simulator(people, worlds)
    still = Command(np.zeros(worlds, np.float32), np.zeros(worlds, np.float32))

    def step() -> None:
        simulator.step(still)
        simulator.sense()

    return median_us(step, seconds) / worlds


def worlds_scaling(seconds: float) -> list[dict[str, float]]:
    """Time of a step by the number of worlds."""
    rows: list[dict[str, float]] = []
    for worlds in MANY_WORLDS:
        time_us = us_per_world_step(PEOPLE, worlds, seconds / 4)
        rows.append({"worlds": worlds, "us_per_world_step": time_us})
        print(f"{time_us:9.1f} us a world step in a batch of {worlds}  (one thread, both sensors)")
    return rows


def people_scaling(seconds: float) -> list[dict[str, float]]:
    """Time of a step by the number of people, as dense."""
    rows: list[dict[str, float]] = []
    for people in CROWDS:
        time_us = us_per_world_step(people, SCALING_WORLDS, seconds / 4)
        rows.append({"people": people, "us_per_world_step": time_us})
        print(f"{time_us:9.1f} us a world step with {people} people  (one thread, both sensors)")
    return rows


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0] if __doc__ else None)
    parser.add_argument("--json", type=Path, help="file for the figures")
    parser.add_argument("--worlds", type=int, default=64)
    parser.add_argument("--seconds", type=float, default=5.0, help="for each figure, about")
    args = parser.parse_args()
    results = {}
    for threads in sorted({1, available_threads()}):
        results[threads] = steps_per_second(args.worlds, threads, args.seconds)
        print(f"{results[threads]:9.0f} environment steps/s  ({threads} threads, {args.worlds} worlds, ", end="")
        print(f"{PEOPLE} people, {OBSTACLES} obstacles, lidar and depth camera)")
    simulator = busy_simulator(PEOPLE, args.worlds)
    speedups = compare_with_peers(simulator, args.seconds)
    print(f"{simulator.bytes_per_world:9d} bytes a world  (its last scan and depth image included)")
    speedups |= compare_with_flat_simulators(results[1], args.seconds)
    scaling, batches = people_scaling(args.seconds), worlds_scaling(args.seconds)
    if args.json:
        threads = max(results)
        record = {"env_steps_per_s": results[threads], "threads": threads, "processor": platform.processor()}
        record |= {**speedups, "bytes_per_world": simulator.bytes_per_world, "people_scaling": scaling}
        record |= {"worlds_scaling": batches}
        args.json.write_text(json.dumps(record, indent=1) + "\n", encoding="utf-8")


if __name__ == "__main__":
    main()
