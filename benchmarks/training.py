"""Speed of training beside Stable-Baselines3's PPO, and where the time goes.

python benchmarks/training.py [--json FILE] [--network compact] [--worlds 64] [--rounds 5]

Both sides step the same worlds with the same network and settings, each in a process of its own, one iteration in turn,
so that what else the machine does meets both. Speeds are medians of iterations; `cpu` ones count processor time and do
not depend on what else runs. Stable-Baselines3 is measured with all worlds handed over at once (the example's adapter),
which is the fastest way it has; with `--singles` also with single environments, as its users begin.
"""

from __future__ import annotations

import argparse
import importlib.util
import json
import os
import subprocess
import sys
import time
from pathlib import Path
from statistics import median
from typing import TYPE_CHECKING, Any, Protocol

if TYPE_CHECKING:
    from densecavoid.learning.config import TrainConfig

SCENARIO, LEVEL = "random-pedestrians", 0.5
ROLLOUT = 64
EXAMPLES = Path(__file__).resolve().parents[1] / "examples"


class Side(Protocol):
    """One of the two that are compared."""

    def iterate(self) -> int:
        """Collects a rollout, learns from it, and says how many environment steps that were."""
        ...


def settings(network: str, worlds: int) -> TrainConfig:
    """What both sides are told: no early stop, so that both take the same number of gradient steps."""
    from densecavoid.learning.config import TrainConfig
    from densecavoid.learning.curriculum import CurriculumConfig
    from densecavoid.learning.ppo import PPOConfig

    return TrainConfig(
        network=network,  # type: ignore[arg-type]
        num_envs=worlds,
        steps_per_rollout=ROLLOUT,
        stage=SCENARIO,
        curriculum=CurriculumConfig(initial_level=LEVEL, threshold=1.0),
        ppo=PPOConfig(target_kl=0.0, schedule="fixed"),
    )


class Ours:
    """The trainer of this package."""

    def __init__(self, network: str, worlds: int) -> None:
        from densecavoid.learning.trainer import Trainer

        self.trainer = Trainer(settings(network, worlds))

    def iterate(self) -> int:
        self.trainer.iterate()
        return self.trainer.steps_per_iteration


class StableBaselines3:
    """Its PPO, with the compact network in torch's own layers."""

    def __init__(self, network: str, worlds: int) -> None:
        if network != "compact":
            raise ValueError(f"Stable-Baselines3 is given the compact network, not {network!r}")
        sys.path.insert(0, str(EXAMPLES))
        import stable_baselines3_ppo as example

        config = settings(network, worlds)
        ppo = config.ppo
        self.steps = worlds * ROLLOUT
        self.ppo = example.make_ppo(
            self._worlds(config),
            n_steps=ROLLOUT,
            batch_size=ppo.minibatch_size,
            n_epochs=ppo.epochs,
            learning_rate=ppo.learning_rate,
            gamma=ppo.discount,
            gae_lambda=ppo.trace_decay,
            clip_range=ppo.clip,
            vf_coef=ppo.value_weight,
            ent_coef=ppo.entropy_weight,
            max_grad_norm=ppo.max_gradient_norm,
            seed=0,
            device=config.torch_device,
        )

    def _worlds(self, config: TrainConfig) -> Any:
        import stable_baselines3_ppo as example

        from densecavoid.learning.worlds import make_training_envs
        from densecavoid.scenarios import TRAINING

        return example.BatchedWorlds(make_training_envs(config, TRAINING[SCENARIO].at_level(LEVEL))[0])

    def iterate(self) -> int:
        self.ppo.learn(self.steps, reset_num_timesteps=False)
        return self.steps


class StableBaselines3Singles(StableBaselines3):
    """The same with single environments, as `make_vec_env` makes them: what its users write first."""

    def _worlds(self, config: TrainConfig) -> Any:
        from stable_baselines3.common.vec_env import DummyVecEnv

        from densecavoid.env import DenseCAvoidEnv
        from densecavoid.learning.worlds import observer_config
        from densecavoid.scenarios import TRAINING

        scenario, observer = TRAINING[SCENARIO].at_level(LEVEL), observer_config(config)
        return DummyVecEnv([lambda: DenseCAvoidEnv(scenario, config.sim, observer)] * config.num_envs)


SIDES = {"ours": Ours, "sb3": StableBaselines3, "sb3_singles": StableBaselines3Singles}


def work(side: str, network: str, worlds: int) -> None:
    """A side's process: one iteration for each line of input, answered with steps, seconds and processor seconds."""
    chosen: Side = SIDES[side](network, worlds)
    chosen.iterate()
    print(json.dumps({"ready": True}), flush=True)
    for _ in sys.stdin:
        wall, cpu = time.perf_counter(), time.process_time()
        steps = chosen.iterate()
        record = {"steps": steps, "wall_s": time.perf_counter() - wall, "cpu_s": time.process_time() - cpu}
        print(json.dumps(record), flush=True)


class Worker:
    """A side in its own process."""

    def __init__(self, side: str, network: str, worlds: int) -> None:
        command = [sys.executable, __file__, "--side", side, "--network", network, "--worlds", str(worlds)]
        self.process = subprocess.Popen(command, stdin=subprocess.PIPE, stdout=subprocess.PIPE, text=True)
        self._answer()

    def iterate(self) -> dict[str, float]:
        assert self.process.stdin is not None
        self.process.stdin.write("\n")
        self.process.stdin.flush()
        return self._answer()

    def close(self) -> None:
        assert self.process.stdin is not None
        self.process.stdin.close()
        self.process.wait()

    def _answer(self) -> dict[str, float]:
        assert self.process.stdout is not None
        line = self.process.stdout.readline()
        if not line:
            raise RuntimeError(f"the process of {self.process.args} ended with {self.process.wait()}")
        return json.loads(line)


def compare(sides: list[str], network: str, worlds: int, rounds: int) -> dict[str, dict[str, float]]:
    """Median environment steps a second of each side, by wall clock and by processor time."""
    workers = {side: Worker(side, network, worlds) for side in sides}
    records: dict[str, list[dict[str, float]]] = {side: [] for side in sides}
    for _ in range(rounds):
        for side, worker in workers.items():
            records[side].append(worker.iterate())
    for worker in workers.values():
        worker.close()
    return {
        side: {clock: median(each["steps"] / each[f"{clock}_s"] for each in found) for clock in ("wall", "cpu")}
        for side, found in records.items()
    }


def peak_gflops() -> float:
    """Of a matrix product in float32 on all threads: the best of several."""
    import torch

    one, other, best = torch.rand(1024, 1024), torch.rand(1024, 1024), float("inf")
    for _ in range(20):
        start = time.perf_counter()
        torch.mm(one, other)
        best = min(best, time.perf_counter() - start)
    return 2 * 1024**3 / best / 1e9


def profile(network: str, worlds: int, rounds: int) -> dict[str, float]:
    """Where an iteration's time goes, and how long the network's arithmetic alone would take at the measured peak."""
    import torch
    from torch.utils.flop_counter import FlopCounterMode

    from densecavoid.learning.collector import Collector
    from densecavoid.learning.rollout import take

    trainer = Ours(network, worlds).trainer
    spent = {"simulator": 0.0, "network looks": 0.0}

    def timed(name: str, call: Any) -> Any:
        def measured(*args: Any, **kwargs: Any) -> Any:
            start = time.perf_counter()
            result = call(*args, **kwargs)
            spent[name] += time.perf_counter() - start
            return result

        return measured

    trainer.iterate()
    for env in trainer.envs:
        env.step = timed("simulator", env.step)
    look = Collector._act
    trainer.collector._act = timed("network looks", look.__get__(trainer.collector))  # type: ignore[method-assign]
    records, peaks = [], []
    for _ in range(rounds):
        peaks.append(peak_gflops())
        records.append(trainer.iterate())
    steps = trainer.steps_per_iteration
    update_s = sum(record["time/update_s"] for record in records)
    total_s = update_s + sum(record["time/collect_s"] for record in records)
    assert trainer.collector._storage is not None
    rollout, batch = trainer.collector._storage, trainer.config.ppo.minibatch_size
    observation, people = take(rollout.flat_observation(), rollout.people, torch.arange(batch))
    with FlopCounterMode(display=False) as counter, torch.no_grad():
        trainer.network(observation, people)
    forward = counter.get_total_flops() / batch
    with FlopCounterMode(display=False) as counter:
        output = trainer.network(observation, people)
        (output.mean.sum() + output.value.sum()).backward()
    learn = counter.get_total_flops() / batch * trainer.config.ppo.epochs
    arithmetic_s = rounds * steps * (forward + learn) / (max(peaks) * 1e9)
    trainer.close()
    return {
        "us_per_step": 1e6 * total_s / rounds / steps,
        **{f"share of {name}": seconds / total_s for name, seconds in spent.items()},
        "share of learning": update_s / total_s,
        "mflop_per_step": (forward + learn) / 1e6,
        "peak_gflops": max(peaks),
        "times the network's arithmetic": total_s / arithmetic_s,
    }


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--json", type=Path, help="file for the figures")
    parser.add_argument("--network", choices=("compact", "paper"), default="compact")
    parser.add_argument("--worlds", type=int, default=64)
    parser.add_argument("--rounds", type=int, default=5, help="iterations of each side")
    parser.add_argument("--singles", action="store_true", help="compare with single environments too")
    parser.add_argument("--side", choices=tuple(SIDES), help=argparse.SUPPRESS)
    args = parser.parse_args()
    if importlib.util.find_spec("torch") is None:
        print("left out: training needs torch (pip install 'densecavoid[train]')")
        return
    if args.side:
        work(args.side, args.network, args.worlds)
        return
    peer = importlib.util.find_spec("stable_baselines3") is not None and args.network == "compact"
    sides = ["ours", *(["sb3"] if peer else []), *(["sb3_singles"] if peer and args.singles else [])]
    speeds = compare(sides, args.network, args.worlds, args.rounds)
    record: dict[str, Any] = {"network": args.network, "worlds": args.worlds, "cores": os.cpu_count()}
    for side, speed in speeds.items():
        print(f"{side:>11}: {speed['wall']:7.0f} environment steps/s trained, {speed['cpu']:7.0f} a processor second")
        record |= {f"env_steps_per_s{'' if side == 'ours' else '_' + side}": speed["wall"]}
        record |= {f"env_steps_per_cpu_s{'' if side == 'ours' else '_' + side}": speed["cpu"]}
    for side in sides[1:]:
        for clock, name in (("wall", f"speedup_{side}"), ("cpu", f"speedup_{side}_cpu")):
            record[name] = speeds["ours"][clock] / speeds[side][clock]
            print(f"{record[name]:7.2f} times {side} by {clock} time")
    record["profile"] = profile(args.network, args.worlds, args.rounds)
    for name, value in record["profile"].items():
        print(f"{value:9.2f} {name}")
    if args.json:
        args.json.write_text(json.dumps(record, indent=1) + "\n", encoding="utf-8")


if __name__ == "__main__":
    main()
