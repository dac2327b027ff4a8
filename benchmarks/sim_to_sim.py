"""Sim to sim: the same policy in the same worlds, in the project's simulator and in MuJoCo, which nobody tuned for.

python benchmarks/sim_to_sim.py [--scenario NAME] [--episodes N] [--seed N] [--navigator NAME] [--through policy|node]
    [--data PATH] [--json FILE]

The worlds are the benchmark's (solvable ones). MuJoCo casts the rays of both sensors, moves the robot and finds the
collisions; people walk the same ways. `--through node` puts the nodes' whole loop between sensors and wheels: messages,
watchdog, policy, safety filter at 20 Hz, with the Turtlebot 2's settings.
"""

from __future__ import annotations

import argparse
import importlib.util
import json
import tempfile
import time
from collections import Counter
from collections.abc import Callable, Sequence
from dataclasses import dataclass, replace
from pathlib import Path
from typing import Any

import numpy as np

from densecavoid.benchmark.navigators import make_navigator, policy_sha256
from densecavoid.benchmark.rollout import run_episodes
from densecavoid.benchmark.runner import TEST_SEEDS_START
from densecavoid.benchmark.solvable import admit
from densecavoid.benchmark.statistics import paired_bootstrap, wilson_interval
from densecavoid.frames import Navigator
from densecavoid.policy.folder_export import export_folder
from densecavoid.robot.config import load_settings
from densecavoid.robot.node_loop import NodeLoop
from densecavoid.scenarios import make_scenario
from densecavoid.sim.config import SimConfig
from densecavoid.sim.spec import Scenario
from densecavoid.sim.world import Simulator

GOAL = 0.05
"""The success rates should be no farther apart."""


@dataclass(frozen=True)
class Ending:
    """How an episode ended."""

    seed: int
    outcome: str
    duration_s: float


def in_mujoco(scenario: Scenario, config: SimConfig, navigator: Navigator, seeds: Sequence[int]) -> list[Ending]:
    """An episode for each seed, in MuJoCo."""
    from densecavoid.robot.mujoco_world import MujocoWorld

    endings = []
    for seed in seeds:
        world = MujocoWorld(scenario, seed, config)
        navigator.reset(np.ones(1, np.bool_))
        while not world.outcome:
            world.step(navigator.act(world.sense()))
        endings.append(Ending(seed, world.outcome, world.time_s))
    return endings


def in_simulator(scenario: Scenario, config: SimConfig, navigator: Navigator, seeds: Sequence[int]) -> list[Ending]:
    """An episode for each seed, in the project's simulator."""
    episodes = run_episodes(Simulator(scenario, 1, config), navigator, seeds)
    return [Ending(episode.seed, episode.outcome, episode.duration_s) for episode in episodes]


def compared(ours: Sequence[Ending], theirs: Sequence[Ending]) -> dict[str, Any]:
    """Both rates, and what differs, world by world."""
    success = [np.array([float(e.outcome == "success") for e in endings]) for endings in (ours, theirs)]
    difference = paired_bootstrap(success[1], success[0])
    both = [(a, b) for a, b in zip(ours, theirs, strict=True) if a.outcome == b.outcome == "success"]
    apart_s = [abs(a.duration_s - b.duration_s) for a, b in both]
    result: dict[str, Any] = {}
    for name, endings, share in (("simulator", ours, success[0]), ("mujoco", theirs, success[1])):
        outcomes = Counter(ending.outcome for ending in endings)
        result[name] = {
            "success": float(share.mean()),
            "success_ci95": list(wilson_interval(outcomes["success"], len(endings))),
            "collision": outcomes["collision"] / len(endings),
            "timeout": outcomes["timeout"] / len(endings),
            "episodes": [[ending.seed, ending.outcome, round(ending.duration_s, 2)] for ending in endings],
        }
    return result | {
        "worlds": len(ours),
        "difference": difference.mean,
        "difference_ci95": [difference.low, difference.high],
        "same_outcome": sum(a.outcome == b.outcome for a, b in zip(ours, theirs, strict=True)) / len(ours),
        "time_to_goal_apart_s_median": float(np.median(apart_s)) if apart_s else None,
    }


def table(result: dict) -> str:
    """The result in words."""
    lines = [f"{'':12}{'success':>24}{'collision':>11}{'timeout':>9}"]
    for name in ("simulator", "mujoco"):
        row = result[name]
        low, high = row["success_ci95"]
        success = f"{row['success']:.3f} [{low:.2f}, {high:.2f}]"
        lines.append(f"{name:12}{success:>24}{row['collision']:11.3f}{row['timeout']:9.3f}")
    low, high = result["difference_ci95"]
    within = "within" if abs(result["difference"]) <= GOAL else "NOT within"
    lines.append(f"mujoco - simulator: {result['difference']:+.3f} [{low:+.3f}, {high:+.3f}], {within} {GOAL}")
    lines.append(f"{result['worlds']} worlds, the same outcome in {result['same_outcome']:.0%} of them")
    return "\n".join(lines)


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--scenario", default="dense-ped")
    parser.add_argument("--episodes", type=int, default=100)
    parser.add_argument("--seed", type=int, default=0, help="of the first world that is tried")
    parser.add_argument("--navigator", default="densecavoid", help="a name, or a policy's .onnx file")
    parser.add_argument("--through", choices=("policy", "node"), default="policy")
    parser.add_argument("--data", type=Path, help="folder of the recordings, for hermes:<run>")
    parser.add_argument("--json", type=Path)
    args = parser.parse_args()
    if importlib.util.find_spec("mujoco") is None:
        print("sim to sim: skipped, mujoco is not installed (pip install 'densecavoid[mujoco]')")
        return
    scenario, config = make_scenario(args.scenario, args.data), SimConfig(threads=1)
    begin = time.perf_counter()
    seeds = admit(scenario, config, TEST_SEEDS_START + args.seed, args.episodes).seeds
    with tempfile.TemporaryDirectory() as scratch:
        if args.through == "node":
            folder, _ = export_folder(args.navigator, Path(scratch) / "exported")
            navigator: Navigator = NodeLoop(folder, load_settings("turtlebot2"), config.lidar, config.camera)
            config = replace(config, control_dt_s=navigator.control_dt_s)
        else:
            navigator = make_navigator(args.navigator, config.robot)
        bodies: tuple[Callable[..., list[Ending]], ...] = (in_simulator, in_mujoco)
        endings = [drive(scenario, config, navigator, seeds) for drive in bodies]
    result = {
        "scenario": args.scenario,
        "navigator": navigator.name,
        "policy_sha256": policy_sha256(navigator),
        "through": args.through,
        **compared(*endings),
        "wall_s": time.perf_counter() - begin,
    }
    print(f"{navigator.name} in {args.scenario}, {result['wall_s']:.0f} s")
    print(table(result))
    if args.json:
        args.json.write_text(json.dumps(result, indent=1) + "\n")


if __name__ == "__main__":
    main()
